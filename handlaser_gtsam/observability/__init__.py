"""What a recording can tell: rank, undetermined parts, the mirror image, the motion it needs."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .rank import Indices as Indices
    from .rank import ObservabilityOptions as ObservabilityOptions
    from .wording import OpenPart as OpenPart
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
