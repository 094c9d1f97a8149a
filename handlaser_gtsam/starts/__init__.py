"""Starts that nobody has to guess: closed form from pure translations, and a sweep for any motion."""

from .choice import Effort, Start, find_start

__all__ = ["Effort", "Start", "find_start"]
