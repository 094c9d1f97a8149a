"""Readings and labels that do not belong: which agree, the test of one, and why one was rejected."""
