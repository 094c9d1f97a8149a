"""What a systematic error is: its column of derivatives, and its plausible size.

Words and plausible sizes of all of them stand in `effects.toml`, by their codes.

A column is the derivative of the residuals e = s - g(d) (`model`) by the size of the error, at zero.
With n the normal that points away from the sensor and c = -1 / (n_H . v), a surface that lies h farther
along n changes e by c h, a reading that is f too long by -g'(d) f, and a true hand pose that is xi
beside the recorded one by -J xi.

An effect of all readings has one column or several. An effect of single planes has one column, as if
it were everywhere, and for every member the rows in which it counts.

An effect can be an unknown of the calibration as well (`results.freed`). Errors of the hand poses then
move the poses themselves; all others make the readings longer, by their column over the column of
readings that are too long.
"""

import pkgutil
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ...data.parameters import Parameters
from ...data.readings import Readings
from ...data.recording import Recording
from ...quantities import IN_MM, IN_PERCENT
from ..equation import Linearization, Scene, linearize, residuals, scene
from ..weighting import slopes

STATED = tomllib.loads((pkgutil.get_data(__name__, "effects.toml") or b"").decode())
"""Words and plausible sizes of each systematic error by its code."""


class SeenStations:
    """Readings at a solution, as the effects see them.

    Parameters
    ----------
    at : Parameters
    readings : Readings
        Sorted, every plane in a frame amid its own stations.
    position : (N,)
        Order in time of each reading's station in the recording.
    channel : (B,)
        Which column of the recording each beam is.
    middle : (3, 3), optional
        Orientation of the hand from which turns count; the mean of the stations where not given.
    plates : (P, 3) and float, optional
        Middle of each plate, and the squared distance from there of the farthest spot [m^2]; taken
        from the spots where not given.
    recorded : Recording, optional
        All stations, also those without a reading that counts; those seen where not given.

    Attributes
    ----------
    held : (B, 2) of bool
        Which terms of the range errors the model holds at zero.
    """

    def __init__(
        self,
        at: Parameters,
        readings: Readings,
        position: IntArray,
        channel: IntArray,
        middle: FloatArray | None = None,
        plates: tuple[FloatArray, float] | None = None,
        recorded: Recording | None = None,
    ) -> None:
        self.recorded = recorded
        self.at, self.readings, self.position, self.channel = at, readings, position, channel
        if middle is not None:
            self.middle = middle
        if plates is not None:
            self.plates = plates
        self.held = np.zeros(at.range_errors.shape, dtype=bool)

    @cached_property
    def time(self) -> FloatArray:
        """From 0 at the first station of the recording to 1 at the last (N,)."""
        return np.asarray(self.position / max(int(self.position.max()), 1))

    @cached_property
    def scene(self) -> Scene:
        """The readings with their beams and planes."""
        return scene(self.at, self.readings)

    @cached_property
    def longer(self) -> FloatArray:
        """Derivatives (N,) by readings that are too long."""
        return -slopes(self.at, self.readings)

    @cached_property
    def linear(self) -> Linearization:
        """Derivatives by planes, beams and hand poses."""
        return linearize(self.scene, self.readings.level, with_pose=True)

    @cached_property
    def first(self) -> tuple[IntArray, IntArray]:
        """A row of every station that has readings (S,), and which of these each row is of (N,)."""
        _, row, station = np.unique(self.readings.station, return_index=True, return_inverse=True)
        return row, station

    @cached_property
    def middle(self) -> FloatArray:
        """Orientation (3, 3) of the hand from which turns count."""
        return np.asarray(self.rotations.mean().as_matrix())

    @cached_property
    def rotations(self) -> Rotation:
        """Orientations of the hand at every station (S,)."""
        return Rotation.from_matrix(self.readings.world_R_hand[self.first[0]])

    @cached_property
    def spots(self) -> FloatArray:
        """Where the beams meet their planes (N, 3) [m]."""
        return np.asarray(self.linear.normal / self.linear.offset[:, None])

    @cached_property
    def plates(self) -> tuple[FloatArray, float]:
        """The middle (P, 3) of each plate, and the squared distance of the farthest spot [m^2]."""
        middles = self.readings.plane_means(self.spots)
        square = ((self.spots - middles[self.readings.plane]) ** 2).sum(axis=1)
        return middles, max(float(square.max()), np.finfo(float).tiny)

    @cached_property
    def expected(self) -> FloatArray:
        """Predicted readings (N,) [m]."""
        d = self.readings.distance
        return np.asarray(d - residuals(self.scene, d) / self.longer)

    def by_poses(self, twists: FloatArray) -> FloatArray:
        """Return derivatives (N, c) by hands that are (omega, u) (S, 6, c) beside their poses."""
        return -np.asarray(np.einsum("ni,nic->nc", self.linear.pose, twists[self.first[1]]))


class Everywhere:
    """Members that concern all readings.

    Parameters
    ----------
    columns : (N, c)
    mix : (c, m), optional
        Of which columns each member is the sum; each is one by itself where it is not given.
    since : (m,), optional
        Position in the recording from which on each member counts; -1 for the whole of it, as where it
        is not given.
    beam : (m,), optional
        The one beam that each member concerns; -1 for all, as where it is not given.
    parts : tuple of str, optional
        What each column is of, where there are several.
    """

    def __init__(
        self,
        columns: FloatArray,
        mix: FloatArray | None = None,
        since: IntArray | None = None,
        parts: tuple[str, ...] = ("",),
        beam: IntArray | None = None,
    ) -> None:
        self.columns, self.parts = columns, parts
        self.mix = np.eye(columns.shape[1]) if mix is None else mix
        every = np.full(self.mix.shape[1], -1)
        self.since, self.beam = (every if one is None else one for one in (since, beam))


@dataclass(frozen=True, slots=True)
class OnPlanes:
    """Members that concern one plane each.

    Attributes
    ----------
    column : (N,)
        As if the error were everywhere.
    plane, beam, since : (m,)
        Of every member: its plane, the one beam it concerns (-1 for all), and the position in the
        recording of the first station it concerns. It counts from there on.
    """

    column: FloatArray
    plane: IntArray
    beam: IntArray
    since: IntArray

    def column_of(self, member: int, stations: SeenStations) -> FloatArray:
        """Return the column (N,) of one member."""
        readings, beam = stations.readings, self.beam[member]
        counts = (readings.plane == self.plane[member]) & (stations.position >= self.since[member])
        if beam >= 0:
            counts &= readings.beam == beam
        return np.where(counts, self.column, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """One kind of systematic error.

    Attributes
    ----------
    code : str
    members : callable, optional
        Returns its columns at the stations; None of an error that no recording can show.
    twists : callable, optional
        Of an error of the hand poses: returns what moves the hands (omega, u) (S, 6, c) from their
        recorded poses, one a unit of size.
    bends : callable, optional
        Of an error of the hand poses: the same, one a square of size, which comes on top.
    phrase, remedy, reveal, confounded, anywhere : str
        The words for it.
    unit, of_sensor, of_cell, power, least_beams, is_k1, term, across, in_order, of_mean
        As in `effects.toml`, where they are stated.
    """

    code: str
    members: Callable[[SeenStations], Everywhere | OnPlanes] | None = None
    twists: Callable[[SeenStations], FloatArray] | None = None
    bends: Callable[[SeenStations], FloatArray] | None = None
    phrase: str
    remedy: str
    reveal: str = ""
    confounded: str = "the unknowns of the calibration in this recording"
    anywhere: str = ""
    unit: str = "m"
    of_sensor: Mapping[str, float] = field(default_factory=dict)
    of_cell: float | None = None
    power: int | None = None
    least_beams: int = 1
    is_k1: bool = False
    term: int | None = None
    across: bool = False
    in_order: bool = False
    of_mean: bool = False

    def at(self, stations: SeenStations) -> Everywhere | OnPlanes | None:
        """Return its members at the stations; None where no recording can show it."""
        return None if self.members is None else self.members(stations)

    @property
    def can_be_freed(self) -> bool:
        """Whether a recording can show it, and it is no unknown by another option."""
        return self.term is None and self.members is not None

    def concerns(self, stations: SeenStations) -> bool:
        """Tell whether there can be such an error of these beams and this model."""
        held = self.term is None or bool(stations.held[:, self.term].any())
        return held and stations.readings.beams >= self.least_beams

    def with_size(self, size: float, subject: str | None = None) -> str:
        """Return the phrase with a size, and a subject: any one where none is meant."""
        whose = self.anywhere if subject is None else subject
        return self.phrase.format(size=size_in_words(size, self.unit), subject=whose)

    def without_size(self, subject: str | None = None) -> str:
        """Return the phrase for an error of unknown size, of a subject or of any one."""
        phrase = self.phrase.replace(" by {size}", "").replace(" of {size}", "")
        return phrase.format(subject=self.anywhere if subject is None else subject)

    def plausible(self, kind: str, measuring_range: float) -> float | None:
        """Return its largest plausible size [unit] for a kind of sensor; None where none is known."""
        if self.of_cell is not None:
            return self.of_cell
        return self.of_sensor[kind] * measuring_range if self.of_sensor else None


def size_in_words(size: float, unit: str) -> str:
    """Return a size with two digits, in mm or percent."""
    return f"{size * IN_MM:.2g} mm" if unit == "m" else f"{size * IN_PERCENT:.2g} %"
