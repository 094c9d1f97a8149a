"""Targets: what rays meet, and where; one file each."""
