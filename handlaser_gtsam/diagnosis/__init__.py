"""What a calibration can and cannot know, and how to check it."""
