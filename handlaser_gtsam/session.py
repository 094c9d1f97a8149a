"""Recalibration as planes are added: a calibration that grows, and knows what each plane taught it.

The first recordings are collected until they determine the beams; from that calibration on, every plane
joins an iSAM2 graph in milliseconds. A plane that its readings do not determine waits for more of
them.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from .arrays import FloatArray, IntArray
from .calibration import Calibration
from .covariance import covariance
from .diagnosis.hold_out import fit_planes
from .errors import GrazingBeamError, InputError
from .factors import RangeBlock
from .graph import station_blocks
from .keys import beam_keys, plane_key
from .mounts import Mounts
from .noise import Noise
from .options import CalibrationOptions, RangeError
from .parameters import Parameters
from .pipeline import calibrate
from .recording import Readings, Recording, join
from .solvers.incremental import BeamState, IncrementalGraph, IncrementalOptions
from .solvers.reduction import whitened_normal_equations
from .solving import solve
from .weighting import Variances, Whitening

MOVED = 3e-3
"""Weights are taken anew when the beams have moved by this part of their natural units since: 1 rad,
the typical range, a relative change of the range."""
MOST_SIGMA = 0.1
"""A plane is determined when all its standard deviations are below this part of their units."""


@dataclass(frozen=True, slots=True)
class Update:
    """What adding a recording did.

    Attributes
    ----------
    planes : tuple of str
        That joined, or got further stations.
    waiting : tuple of str
        Planes whose readings do not determine them yet; everything, until the beams are determined.
    information : float
        What the readings taught about the beams [nats]: half the growth of the logarithm of the
        determinant of their information; NaN for the first calibration.
    sigma, before : (B, 8) or None
        Standard deviations of the beams (x, y, z, vx, vy, vz, k1, k2) now, and before; None where there
        is no calibration.
    message : str
        Why there is no calibration yet; empty where there is one.
    """

    planes: tuple[str, ...]
    waiting: tuple[str, ...]
    information: float
    sigma: FloatArray | None
    before: FloatArray | None
    message: str = ""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The incremental estimate against the batch solution of the same readings.

    Attributes
    ----------
    largest : float
        Largest difference of a coordinate of a beam, in its standard deviations.
    largest_sigma : float
        Largest relative difference of a standard deviation.
    """

    largest: float
    largest_sigma: float


class Session:
    """A calibration to which planes and stations are added.

    Parameters
    ----------
    noise : Noise, optional
        An unknown range sigma is that of the first calibration. One pose covariance for all stations.
    options : CalibrationOptions, optional
        Of the first calibration; its number of range-error terms is kept, the most of any beam for
        all. Poses are exact or marginalised.
    incremental : IncrementalOptions, optional

    Raises
    ------
    InputError
        Poses to be estimated, or a pose covariance a station.
    """

    def __init__(
        self,
        noise: Noise | None = None,
        options: CalibrationOptions | None = None,
        incremental: IncrementalOptions | None = None,
    ) -> None:
        self.noise, self.options = noise or Noise(), options or CalibrationOptions()
        self._incremental = incremental
        if self.options.poses == "estimated":
            raise InputError(
                "poses estimated", "exact or marginalised poses while planes are added"
            )
        S = self.noise.pose_covariance
        if S is not None and S.ndim == 3:
            raise InputError("a pose covariance a station", "one for all stations to come")
        self.options.require_pose_noise(self.noise)
        self._stations: dict[str, Recording] = {}
        self._graph: IncrementalGraph | None = None
        self._state: BeamState | None = None
        self._weighed: BeamState | None = None
        self._numbers: dict[str, int] = {}
        self._origins: dict[str, FloatArray] = {}
        self._names: tuple[str, ...] = ()
        self._sigma = self._length = 0.0

    @property
    def started(self) -> bool:
        """Whether there is a calibration."""
        return self._graph is not None

    @property
    def planes(self) -> tuple[str, ...]:
        """Names of the planes that are in the calibration."""
        return tuple(self._numbers)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the planes that wait for more stations."""
        return tuple(name for name in self._stations if name not in self._numbers)

    def recording(self) -> Recording:
        """Return all stations so far; those that wait included.

        Raises
        ------
        InputError
            There are none.
        """
        if not self._stations:
            raise InputError("an empty session", "a recording added first")
        return join(list(self._stations.values()))

    def add(self, recording: Recording) -> Update:
        """Add the stations of a recording; nothing has changed where an error is raised.

        Raises
        ------
        InputError
            A station name that is there already.
        """
        merged = self._merged(recording)
        known = self.started and set(recording.beam_names) <= set(self._names)
        if not known:
            return self._begin(merged)
        return self._join(merged, recording.plane_names)

    def remove_plane(self, name: str) -> Update:
        """Take a plane and its stations out again.

        Raises
        ------
        InputError
            No such plane, or the beams would not be determined without it.
        """
        if name not in self._stations:
            raise InputError(f"plane {name!r}", f"one of {', '.join(self._stations) or 'none'}")
        rest = {plane: one for plane, one in self._stations.items() if plane != name}
        return self._join(rest, (), gone=(name,))

    def remove_station(self, name: str) -> Update:
        """Take a station out again; its plane waits where the others do not determine it.

        Raises
        ------
        InputError
            No such station, or the beams would not be determined without it.
        """
        for plane, one in self._stations.items():
            if name in one.station_names:
                rows = [j for j, station in enumerate(one.station_names) if station != name]
                if not rows:
                    return self.remove_plane(plane)
                return self._join({**self._stations, plane: one.part(rows)}, (plane,))
        raise InputError(f"station {name!r}", "the name of a station that was added")

    def beams(self) -> Mounts:
        """Return the beams as they are now, without looking at the planes.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        state, graph = self._require()
        return Mounts(
            self._names,
            state.locations,
            state.directions,
            state.range_errors,
            graph.terms,
            state.covariance,
            self._sigma,
        )

    def calibration(self) -> Calibration:
        """Return the batch calibration of all planes that are in; its cost grows with their number.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        _, graph = self._require()
        inside = join([self._stations[name] for name in self._numbers])
        noise = replace(self.noise, range_sigma=self._sigma)
        return calibrate(inside, noise, self._fixed_options(graph.terms[0]))

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return all readings that are in, and beams and planes as they are now.

        Every plane is in a frame of its own amid its stations, with the axes of the world.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        _, graph = self._require()
        inside = join([self._stations[name] for name in self._numbers])
        readings = _arranged(inside, self._names)
        readings = readings.seen_from(np.array([self._origins[name] for name in self._numbers]))
        at = graph.parameters()
        place = {number: index for index, number in enumerate(graph.planes)}
        order = [place[number] for number in self._numbers.values()]
        return readings, replace(at, normals=at.normals[order], offsets=at.offsets[order])

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        state, graph = self._require()
        readings, at = self.estimate()
        noise = replace(self.noise, range_sigma=self._sigma)
        batch = solve(readings, at, graph.terms, noise, self.options)
        S = covariance(batch.problem, batch.result.values).matrix(planes=[])
        found = batch.parameters
        sigma, own = (np.sqrt(np.diagonal(C)).reshape(-1, 8) for C in (S, state.covariance))
        difference = np.hstack(
            (
                state.locations - found.locations,
                state.directions - found.directions,
                state.range_errors - found.range_errors,
            )
        )
        seen = sigma > 0.0
        return Comparison(
            float((np.abs(difference[seen]) / sigma[seen]).max()),
            float(np.abs(own[seen] / sigma[seen] - 1.0).max()),
        )

    def _require(self) -> tuple[BeamState, IncrementalGraph]:
        if self._graph is None or self._state is None:
            raise InputError("a session without calibration", "recordings that determine the beams")
        return self._state, self._graph

    def _fixed_options(self, terms: int) -> CalibrationOptions:
        names: tuple[RangeError, ...] = ("none", "k1", "k1k2")
        name = names[terms]
        return replace(self.options, range_error=name, outliers="keep")

    def _merged(self, recording: Recording) -> dict[str, Recording]:
        """Return the stations by plane with those of `recording`."""
        there = {name for one in self._stations.values() for name in one.station_names}
        twice = next((name for name in recording.station_names if name in there), None)
        if twice is not None:
            raise InputError(f"station {twice!r} twice", "names that are not in the session yet")
        merged = dict(self._stations)
        for index, plane in enumerate(recording.plane_names):
            new = recording.part(np.flatnonzero(recording.plane_of_station == index))
            merged[plane] = join([merged[plane], new]) if plane in merged else new
        return merged

    def _begin(self, stations: dict[str, Recording]) -> Update:
        """Calibrate everything together, and start the graph from there if that converges."""
        together = join(list(stations.values()))
        found = calibrate(together, self.noise, self.options)
        terms = max(beam.terms for beam in found.beams.values())
        if found.status == "converged" and len({b.terms for b in found.beams.values()}) > 1:
            found = calibrate(together, self.noise, self._fixed_options(terms))
        if found.status != "converged":
            if self.started:  # a new beam that is not determined: nothing is lost
                raise InputError(f"a new beam ({found.message})", "readings that determine it")
            self._stations = stations
            return Update((), self.waiting, float("nan"), None, None, found.message)
        kept = np.where(np.isnan(found.fit.residuals), np.nan, together.ranges)
        clean = replace(together, ranges=kept)
        by_plane = {
            plane: clean.part(np.flatnonzero(clean.plane_of_station == index))
            for index, plane in enumerate(clean.plane_names)
        }
        self._start(found, by_plane, terms)
        return Update(tuple(by_plane), (), float("nan"), self._sigmas(), None)

    def _start(self, found: Calibration, stations: dict[str, Recording], terms: int) -> None:
        names = tuple(found.beams)
        beams = [beam_keys(i, terms) for i in range(len(names))]
        length = found.fit.median_reading
        graph = IncrementalGraph(beams, (terms,) * len(names), length, self._incremental)
        at = found.parameters()
        values = gtsam.Values()
        for i, beam in enumerate(beams):
            values.insert(beam.location, at.locations[i])
            values.insert(beam.direction, gtsam.Unit3(at.directions[i]))
            if beam.range_error is not None:
                values.insert(beam.range_error, at.range_errors[i, :terms])
        before = (self._names, self._sigma, self._length)
        self._names, self._sigma, self._length = names, found.fit.range_sigma, length
        try:
            added, numbers, origins = [], {}, {}
            for number, (plane, one) in enumerate(stations.items()):
                fitted = self._fitted(one, (at.locations, at.directions, at.range_errors))
                if fitted is None or not fitted.determined():
                    raise InputError(
                        f"plane {plane} beside a calibration", "a plane that beams meet"
                    )
                added += [(number, block) for block in self._blocks(number, fitted, graph)]
                values.insert(plane_key(number), fitted.plane())
                numbers[plane], origins[plane] = number, fitted.origin
            state = graph.change(added, values)
        except BaseException:
            self._names, self._sigma, self._length = before
            raise
        self._graph, self._state, self._weighed = graph, state, state
        self._stations, self._numbers, self._origins = stations, numbers, origins

    def _join(
        self,
        stations: dict[str, Recording],
        changed: tuple[str, ...],
        gone: tuple[str, ...] = (),
    ) -> Update:
        """Bring the graph to `stations`, in which only some planes differ from those that are in."""
        state, graph = self._require()
        before = self._sigmas()
        numbers, origins = dict(self._numbers), dict(self._origins)
        beams = (state.locations, state.directions, state.range_errors)
        added, values, without, joined = [], gtsam.Values(), [], []
        for plane in changed:
            known = numbers.get(plane)
            fitted = self._fitted(stations[plane], beams, origins.get(plane))
            if known is not None:
                without.append(known)
            if fitted is None or not fitted.determined():
                numbers.pop(plane, None)
                continue
            number = max([*self._numbers.values(), *numbers.values()]) + 1
            number = number if known is None else known
            if known is None:
                values.insert(plane_key(number), fitted.plane())
            added += [(number, block) for block in self._blocks(number, fitted, graph)]
            numbers[plane], origins[plane] = number, fitted.origin
            joined.append(plane)
        without += [numbers.pop(plane) for plane in gone if plane in numbers]
        if added or without:
            try:
                state = graph.change(added, values, without, self._determined)
            except RuntimeError as error:
                raise InputError(
                    f"a change after which the beams are open ({error})",
                    "planes that determine them",
                ) from error
        gain = 0.5 * (state.information - self._require()[0].information)
        self._state, self._stations = state, stations
        self._numbers, self._origins = numbers, origins
        if self._moved():
            self._weigh()
        return Update(tuple(joined), self.waiting, gain, self._sigmas(), before)

    def _moved(self) -> bool:
        """Tell whether the beams have left those behind the weights so far that these differ."""
        state, old = self._state, self._weighed
        if state is None or old is None or not self._weights_differ():
            return False
        shift = float(np.abs(state.locations - old.locations).max()) / self._length
        turn = float(np.abs(state.directions - old.directions).max())
        stretch = np.abs(state.range_errors - old.range_errors) @ [1.0, self._length]
        return max(shift, turn, float(stretch.max())) > MOVED

    def _weights_differ(self) -> bool:
        """Tell whether weights depend on the solution."""
        stretched = self._graph is not None and max(self._graph.terms) > 0
        treated = self.options.treats_poses(self.noise)
        return stretched or treated or self.noise.incidence_sigma > 0.0

    def _weigh(self) -> None:
        """Give all readings the weights of the present beams."""
        state, graph = self._require()
        beams = (state.locations, state.directions, state.range_errors)
        added: list[tuple[int, RangeBlock]] = []
        for plane, number in self._numbers.items():
            fitted = self._fitted(self._stations[plane], beams, self._origins[plane])
            if fitted is None:
                return
            added += [(number, block) for block in self._blocks(number, fitted, graph)]
        self._state = graph.change(added, gtsam.Values(), list(self._numbers.values()))
        self._weighed = state

    def _determined(self, state: BeamState) -> bool:
        """Tell whether the beams are known to a part of their natural units."""
        sigma = np.sqrt(np.diagonal(state.covariance)).reshape(-1, 8)
        length = self._length
        unit = np.array([length] * 3 + [1.0] * 3 + [1.0, 1.0 / length])
        return bool((sigma < MOST_SIGMA * unit).all())

    def _sigmas(self) -> FloatArray | None:
        if self._state is None:
            return None
        return np.sqrt(np.diagonal(self._state.covariance)).reshape(-1, 8)

    def _fitted(
        self,
        one: Recording,
        beams: tuple[FloatArray, FloatArray, FloatArray],
        origin: FloatArray | None = None,
    ) -> "_Fitted | None":
        """Fit the plane of a recording to known beams; None where a beam would graze it."""
        readings = _arranged(one, self._names)
        if origin is None:
            origin = readings.plane_means(readings.world_t_hand)[0]
        readings = readings.seen_from(origin[None])
        pose = None
        if self.options.treats_poses(self.noise):
            pose = self.noise.pose_covariances(len(one.plane_labels))
        ranges = np.full(len(self._names), self._sigma)
        variances = Variances(ranges, self.noise.incidence_sigma, pose)
        try:
            at, how = fit_planes(beams, readings, variances)
        except GrazingBeamError:
            return None
        return _Fitted(readings, at, how, origin)

    def _blocks(self, number: int, fitted: "_Fitted", graph: IncrementalGraph) -> list[RangeBlock]:
        readings = fitted.readings
        rows: IntArray = np.lexsort((readings.beam, readings.station))
        keys = (graph.beams, (plane_key(number),), None)
        return list(station_blocks(readings, fitted.whitening, rows, readings.plane, keys))


def _arranged(recording: Recording, names: tuple[str, ...]) -> Readings:
    """Return the readings with beams numbered as in `names`."""
    readings = recording.readings()
    beam = np.array([names.index(name) for name in recording.beam_names])[readings.beam]
    order = np.lexsort((readings.station, beam, readings.plane))
    return replace(readings, beam=beam, beams=len(names)).subset(order)


@dataclass(frozen=True, slots=True)
class _Fitted:
    """Readings of one plane in its own frame, with the plane that fits them and known beams."""

    readings: Readings
    at: Parameters
    whitening: Whitening
    origin: FloatArray

    def plane(self) -> gtsam.OrientedPlane3:
        return gtsam.OrientedPlane3(gtsam.Unit3(self.at.normals[0]), self.at.offsets[0])

    def determined(self) -> bool:
        """Tell whether the readings alone determine the plane, for known beams."""
        normal = whitened_normal_equations(self.at, self.readings, 0, self.whitening)
        unit = np.array([1.0, 1.0, float(np.median(self.readings.distance))])
        information = normal.plane[0, 0] * np.outer(unit, unit) / self.whitening.sigma**2
        return bool(np.linalg.eigvalsh(information)[0] > MOST_SIGMA**-2)
