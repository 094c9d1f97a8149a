"""What goes in, checked and frozen: recordings, noise, parameters; what a column really holds."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .parameters import RangeErrorPrior as RangeErrorPrior
    from .readings import Readings as Readings
    from .readings import Regressors as Regressors
    from .recording import HasMatrix as HasMatrix
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
