"""Recalibration as planes are added: a calibration that grows, and knows what each plane taught it."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .reports import Comparison as Comparison
    from .reports import Update as Update
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
