"""What a recording can tell: rank, undetermined parts, the mirror image, the motion it needs."""
