"""Starts that nobody has to guess: closed forms, sweeps for any motion, and a search among outliers."""

from .choice import Effort, Start, find_start

__all__ = ["Effort", "Start", "find_start"]
