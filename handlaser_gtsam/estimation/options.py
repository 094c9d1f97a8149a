"""How to calibrate: one frozen set of options, with defaults that work."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from ..arrays import IntArray
from ..checks import require_bool, require_kind, require_names, require_word
from ..data.noise import Noise
from ..errors import InputError
from ..model.damped_search import LevenbergOptions
from ..model.effects import EFFECTS
from ..model.losses import TUNING, LossName
from ..model.sensor_limits import Sensor
from ..observability.rank import ObservabilityOptions

ChosenPoses = Literal["exact", "marginalised", "estimated"]
Poses = Literal["auto", ChosenPoses]
RangeError = Literal["auto", "none", "k1", "k1k2"]
Outliers = Literal["reject", "keep"]

READINGS_OF_A_SIGMA = 15
"""Readings that a beam needs for a range sigma of its own: fewer leave it uncertain by a third."""
RANGE_ERROR_TERMS: dict[RangeError, int] = {"auto": 2, "none": 0, "k1": 1, "k1k2": 2}


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `calibrate`.

    Attributes
    ----------
    range_error : {"auto", "none", "k1", "k1k2"}
        Range-error terms of every beam. `auto` keeps both under a zero-mean prior whose scales are
        learned from all beams and integrated over; `k1` and `k1k2` are without a prior.
    outliers : {"reject", "keep"}
        Whether readings that the others contradict are rejected, and listed.
    loss : {"gaussian", "huber", "cauchy", "tukey"}
        Loss of the final estimate, reading by reading; the covariance follows it. With a robust loss
        unknown scales are estimated, but not integrated over.
    poses : {"auto", "exact", "marginalised", "estimated"}
        How errors of the hand poses count: not at all, in the weights of the readings of a station
        together, or as a variable a station. `auto` is `exact` where the noise says that poses do not
        err, else `marginalised`. Pose sigmas that the noise does not give are estimated.
    range_sigma_by_beam : bool, optional
        Whether every beam has a range sigma of its own, which is estimated. Where not given, one sigma
        is estimated for all, and one more for each beam that is clearly rougher.
    estimate_noise : bool
        Whether the sigmas of ranges, hand translations and hand rotations are estimated though they are
        given. Given sigmas of the hand are then the scales of their priors; a given range sigma is
        not used in its prior.
    free : tuple of str
        Codes of systematic errors that are unknowns, such as `lag` and `incidence`: estimated beside
        everything else, under a zero-mean prior whose sigma is the plausible size. All others are
        tested for.
    sensor : Sensor
        Readings outside its limits are rejected, and listed; its linearity is the scale of the prior
        of the range errors' scales.
    solver : LevenbergOptions
    observability : ObservabilityOptions

    Raises
    ------
    InputError
        A word that is no option, or a value of another type.
    """

    range_error: RangeError = "auto"
    outliers: Outliers = "reject"
    loss: LossName = "gaussian"
    poses: Poses = "auto"
    range_sigma_by_beam: bool | None = None
    estimate_noise: bool = False
    free: tuple[str, ...] = ()
    sensor: Sensor = field(default_factory=Sensor)
    solver: LevenbergOptions = field(default_factory=LevenbergOptions)
    observability: ObservabilityOptions = field(default_factory=ObservabilityOptions)

    def __post_init__(self) -> None:
        require_word("range_error", self.range_error, RANGE_ERROR_TERMS)
        require_word("outliers", self.outliers, get_args(Outliers))
        require_word("loss", self.loss, TUNING)
        require_word("poses", self.poses, get_args(Poses))
        if self.range_sigma_by_beam is not None:
            require_bool("range_sigma_by_beam", self.range_sigma_by_beam)
        require_bool("estimate_noise", self.estimate_noise)
        require_names("codes of free", self.free)
        for code in self.free:
            if code not in EFFECTS or EFFECTS[code].can_be_freed:
                require_word("free", code, [code for code in EFFECTS if EFFECTS[code].can_be_freed])
            else:
                found = f"free {code}, which no recording tells from {EFFECTS[code].confounded}"
                raise InputError(found, "codes of errors that a recording can show")
        object.__setattr__(self, "free", tuple(dict.fromkeys(self.free)))
        require_kind("sensor", self.sensor, Sensor)
        require_kind("solver", self.solver, LevenbergOptions)
        require_kind("observability", self.observability, ObservabilityOptions)

    @property
    def terms(self) -> int:
        """Range-error terms of every beam."""
        return RANGE_ERROR_TERMS[self.range_error]

    @property
    def linearity(self) -> float | None:
        """Scale of the prior of the range errors' scales; None where range errors have no prior."""
        return self.sensor.linearity if self.range_error == "auto" else None

    def counts_poses(self, noise: Noise) -> bool:
        """Tell whether errors of the hand poses are counted."""
        return self.poses != "exact" and not noise.poses_exact

    def require_consistent(self, noise: Noise) -> None:
        """Refuse options that contradict each other or the noise.

        Raises
        ------
        InputError
        """
        if self.poses == "exact" and self.estimate_noise:
            raise InputError(
                "estimate_noise with exact poses", "another treatment of poses: their noise counts"
            )
        if self.poses in ("marginalised", "estimated") and noise.poses_exact:
            raise InputError(
                f"poses {self.poses} with pose sigmas of zero",
                "pose sigmas above zero, or none at all: they are estimated then",
            )
        if self.free and self.loss != "gaussian":
            raise InputError(f"free errors with a {self.loss} loss", "the gaussian loss with them")

    def require_readings(self, count: IntArray, names: tuple[str, ...]) -> None:
        """Refuse to estimate the sigma of a beam that has few readings (B,).

        Raises
        ------
        InputError
        """
        if not self.range_sigma_by_beam:
            return
        for name, readings in zip(names, count.tolist(), strict=True):
            if readings < READINGS_OF_A_SIGMA:
                raise InputError(
                    f"a range sigma by beam from {readings} readings of beam {name}",
                    f"{READINGS_OF_A_SIGMA} or more; estimate one sigma for all beams",
                )
