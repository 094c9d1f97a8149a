"""What a session says about what happened to it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..arrays import FloatArray
from ..data.value import Value
from ..model.sensor_limits import Rejected
from ..validation.other_recording import BeamDrift

ChangeCode = Literal[
    "scales", "range-sigma", "outliers", "excluded-planes", "from-batch", "not-converged"
]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison(Value):
    """The incremental estimate against a batch solution.

    Of the same readings, with the same range-error terms and range sigma; `Session.recalibrate`
    compares with a calibration that chooses all of these by itself.

    Attributes
    ----------
    largest : float
        Largest difference of a coordinate of a beam, in its standard deviations.
    largest_sigma : float
        Largest relative difference of a standard deviation.
    changes : mapping of str to str
        What was taken over from the batch solution, in words, by code: `scales` of noise and range
        errors, an estimated `range-sigma`, the choice of `outliers`, `excluded-planes` that take part
        again, or `from-batch`, where the graph had left the batch solution and was restarted from it.
        With `not-converged` nothing was taken over. Empty where the two agree and nothing was chosen
        again.
    """

    largest: float
    largest_sigma: float
    changes: Mapping[ChangeCode, str] = field(default_factory=dict)

    @property
    def message(self) -> str:
        """The changes in words; empty where there are none."""
        return "; ".join(self.changes.values())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Update(Value):
    """What a change of a session did: stations that came or left.

    Attributes
    ----------
    targets : tuple of str
        Planes or other targets that joined, or got further stations.
    waiting : tuple of str
        Targets whose readings do not determine them yet; everything, until the mounts are determined.
    information : float
        Gain of information on the mounts [nats]: half the growth of the logarithm of the determinant of
        their information, below zero where a target leaves. NaN for the first calibration, where
        mounts came, left or are not determined, and where a comparison with the batch solution
        changed weights or terms.
    sigma, before : (n, 8) or (n, 6), or None
        Standard deviations of the mounts now, and before: of beams before planes the eight of their
        numbers (`model.families.BEAM`), of a survey those in `Mount.sigma`, sensors before beams. None
        where there is no calibration.
    message : str
        Why there is no calibration yet, or that it was restarted; empty otherwise.
    rejected : tuple of Rejected
        New readings or shots that do not count; they are kept, and not used.
    moved : BeamDrift or None
        The beam that the planes so far show to have moved, and since when; surveys are not searched.
    inconsistent : tuple of str
        Planes that do not fit, whichever beam has moved a little. They wait, and take no part, unless
        outliers are to be kept; `moved` names the beam without which they would fit, if there is one.
    comparison : Comparison or None
        With the batch solution, where it was due; never where every change is a batch calibration.
    """

    targets: tuple[str, ...]
    waiting: tuple[str, ...]
    information: float
    sigma: FloatArray | None
    before: FloatArray | None
    message: str = ""
    rejected: tuple[Rejected, ...] = ()
    moved: BeamDrift | None = None
    inconsistent: tuple[str, ...] = ()
    comparison: Comparison | None = None
