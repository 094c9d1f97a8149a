"""What a session says about what happened to it."""

from dataclasses import dataclass

from ..arrays import FloatArray
from ..data.value import Value
from ..model.sensor import Rejected
from .drift import Moved


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison(Value):
    """The incremental estimate against a batch solution.

    Of the same readings, with the same range-error terms and range sigma; `Session.settle` compares
    with a calibration that chooses all of these by itself.

    Attributes
    ----------
    largest : float
        Largest difference of a coordinate of a beam, in its standard deviations.
    largest_sigma : float
        Largest relative difference of a standard deviation.
    message : str
        What followed from it; empty where the two agree and nothing was chosen anew.
    """

    largest: float
    largest_sigma: float
    message: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Update(Value):
    """What adding a recording did.

    Attributes
    ----------
    planes : tuple of str
        That joined, or got further stations.
    waiting : tuple of str
        Planes whose readings do not determine them yet; everything, until the beams are determined.
    information : float
        What the readings taught about the beams [nats]: half the growth of the logarithm of the
        determinant of their information; NaN for the first calibration, and where a comparison with
        the batch solution changed weights or terms.
    sigma, before : (B, 8) or None
        Standard deviations of the beams (x, y, z, vx, vy, vz, k1, k2) now, and before; None where there
        is no calibration.
    message : str
        Why there is no calibration yet, or that it was begun anew; empty otherwise.
    rejected : tuple of Rejected
        New readings that the others contradict; they are kept, and not used.
    moved : Moved or None
        The beam that the planes so far show to have moved, and since when.
    doubtful : tuple of str
        Planes that do not fit, whichever beam has moved a little. They wait, and take no part, unless
        outliers are to be kept; `moved` names the beam without which they would fit, if there is one.
    comparison : Comparison or None
        With the batch solution, where it was due.
    """

    planes: tuple[str, ...]
    waiting: tuple[str, ...]
    information: float
    sigma: FloatArray | None
    before: FloatArray | None
    message: str = ""
    rejected: tuple[Rejected, ...] = ()
    moved: Moved | None = None
    doubtful: tuple[str, ...] = ()
    comparison: Comparison | None = None
