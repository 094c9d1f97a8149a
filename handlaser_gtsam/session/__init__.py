"""Recalibration as planes are added: a calibration that grows, and knows what each plane taught it."""

from .reports import Change, Comparison, Update
from .session import Session

__all__ = ["Change", "Comparison", "Session", "Update"]
