"""Readings and labels that do not belong: the test of a reading, starts among gross errors."""
