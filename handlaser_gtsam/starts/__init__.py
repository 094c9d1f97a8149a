"""Starts that nobody has to guess: closed form from pure translations, and a sweep for any motion."""

from .choice import Start, find_start

__all__ = ["Start", "find_start"]
