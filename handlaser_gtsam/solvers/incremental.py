"""iSAM2 behind a small class that is never left half-updated.

Planes join one by one; the beams stay in the root of the Bayes tree, so that an update with one plane
eliminates little else anew. What was measured of GTSAM 4.3, and how it is met:

- an exception inside `update` leaves the object half-updated: every update works on a copy, which takes
  the place of the old one only when it has succeeded;
- the default relinearisation threshold ignores moves of a mount in millimetres: each kind of variable
  has a threshold in its natural unit;
- all Values are copied for every Python factor unless the linearisation point is held: it is;
- marginals are in the tangent bases of the linearisation point: they are lifted from there;
- it is not thread-safe: there is one lock.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from threading import RLock

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors import RangeBlock, range_factor
from ..joint import beam_lift
from ..keys import BeamKeys, plane_key
from ..parameters import Parameters

BEAMS_LAST = 1
ROUNDS = 15
"""Of relinearisation after a change: more mean that too little is determined."""


@dataclass(frozen=True, slots=True)
class IncrementalOptions:
    """Controls of the incremental solver.

    Attributes
    ----------
    relinearize : float
        A variable is linearised anew when it has moved by more than this part of its natural unit:
        1 rad, the typical range, 1 for k1 and the inverse of the range for k2.
    """

    relinearize: float = 2e-4


@dataclass(frozen=True, slots=True)
class BeamState:
    """Beams as iSAM2 has them.

    Attributes
    ----------
    locations, directions : (B, 3)
    range_errors : (B, 2)
    covariance : (8 B, 8 B)
        Ambient, over (x, y, z, vx, vy, vz, k1, k2) of every beam.
    information : float
        Logarithm of the determinant of the tangent information [nats, up to the units].
    """

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    covariance: FloatArray
    information: float


class IncrementalGraph:
    """Beams and planes under iSAM2.

    Parameters
    ----------
    beams : BeamKeys, each
    terms : tuple of int
        Range-error terms of each beam: the same for all, for iSAM2 has one threshold a letter.
    length : float
        The typical range [m], for natural units.
    options : IncrementalOptions, optional
    """

    def __init__(
        self,
        beams: Sequence[BeamKeys],
        terms: tuple[int, ...],
        length: float,
        options: IncrementalOptions | None = None,
    ) -> None:
        self.beams, self.terms = tuple(beams), terms
        self._keys = [
            key
            for beam in beams
            for key in (beam.location, beam.direction, beam.range_error)
            if key is not None
        ]
        if len(set(terms)) > 1:
            raise ValueError(f"terms {terms}; expected the same number for every beam")
        most = max(terms)
        settings = _isam_parameters(options or IncrementalOptions(), length, most)
        self._isam = gtsam.ISAM2(settings)
        self._view = self._isam.getLinearizationPoint()
        self._factors: dict[int, tuple[int, ...]] = {}
        self._lock = RLock()

    @property
    def planes(self) -> tuple[int, ...]:
        """Numbers of the planes that are in."""
        return tuple(self._factors)

    def change(
        self,
        added: Sequence[tuple[int, RangeBlock]],
        start: gtsam.Values,
        without: Iterable[int] = (),
        accept: Callable[[BeamState], bool] | None = None,
    ) -> BeamState:
        """Add blocks by the number of their plane, take out all blocks of other planes.

        Parameters
        ----------
        added : sequence of (int, RangeBlock)
            Of the plane with that number; each block with a whitening.
        start : gtsam.Values
            Variables that are new: planes, and the beams the first time.
        without : numbers
            Planes whose present blocks are taken out; they may be added again.
        accept : callable, optional
            Asked before the change takes place.

        Returns
        -------
        BeamState
            After the change.

        Raises
        ------
        RuntimeError
            GTSAM calls the system indeterminate, the estimate does not settle, or it is not accepted;
            nothing has changed.
        """
        graph = gtsam.NonlinearFactorGraph()
        for _, block in added:
            sigma = 1.0 if block.whitening is None else block.whitening.sigma
            graph.push_back(range_factor(block, sigma))
        gone = set(without)
        with self._lock:
            isam, view = self._copy()
            old = [index for plane in gone for index in self._factors[plane]]
            kept = {p for p in self._factors if p not in gone} | {plane for plane, _ in added}
            if not kept:
                raise RuntimeError("no plane is left")
            indices = self._update(isam, graph, start, old)
            for _ in range(ROUNDS):
                if not self._relinearized(isam):
                    break
            else:
                raise RuntimeError("the estimate does not settle")
            state = self._state(isam)
            if accept is not None and not accept(state):
                raise RuntimeError("too few planes are left")
            factors = {p: found for p, found in self._factors.items() if p not in gone}
            for (plane, _), index in zip(added, indices, strict=True):
                factors[plane] = (*factors.get(plane, ()), index)
            self._isam, self._view, self._factors = isam, view, factors
        return state

    def state(self) -> BeamState:
        """Return the beams as they are now."""
        with self._lock:
            return self._state(self._isam)

    def parameters(self) -> Parameters:
        """Return beams, and planes in the order of `planes`, each in the frame of its blocks."""
        with self._lock:
            values = self._isam.calculateEstimate()
            numbers = self.planes
        planes = [values.atOrientedPlane3(plane_key(number)) for number in numbers]
        r, v, k = self._read(values)
        return Parameters(
            r,
            v,
            k,
            np.array([plane.normal().point3() for plane in planes]).reshape(-1, 3),
            np.array([plane.distance() for plane in planes]),
        )

    def plane_covariance(self, number: int) -> FloatArray:
        """Return the covariance (4, 4) of (n, b) of a plane, in the frame of its blocks."""
        with self._lock:
            S = self._isam.marginalCovariance(plane_key(number))
            basis = self._view.atOrientedPlane3(plane_key(number)).normal().basis()
        lift = np.zeros((4, 3))
        lift[:3, :2], lift[3, 2] = basis, 1.0
        covariance: FloatArray = lift @ S @ lift.T
        return covariance

    def _copy(self) -> tuple[gtsam.ISAM2, gtsam.Values]:
        isam = gtsam.ISAM2(self._isam)
        return isam, isam.getLinearizationPoint()

    def _update(
        self,
        isam: gtsam.ISAM2,
        graph: gtsam.NonlinearFactorGraph,
        start: gtsam.Values,
        old: list[int],
    ) -> list[int]:
        groups = gtsam.KeyGroupMap()
        for key in self._keys:
            groups.insert2(key, BEAMS_LAST)
        result = isam.update(graph, start, old, groups, None, None, False)
        return list(result.getNewFactorsIndices())

    def _relinearized(self, isam: gtsam.ISAM2) -> bool:
        """Update with nothing new; tell whether a variable was linearised anew."""
        groups = gtsam.KeyGroupMap()
        for key in self._keys:
            groups.insert2(key, BEAMS_LAST)
        empty = gtsam.NonlinearFactorGraph()
        result = isam.update(empty, gtsam.Values(), [], groups, None, None, False)
        return bool(result.getVariablesRelinearized())

    def _read(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray, FloatArray]:
        k = np.zeros((len(self.beams), 2))
        for i, (beam, terms) in enumerate(zip(self.beams, self.terms, strict=True)):
            if beam.range_error is not None:
                k[i, :terms] = values.atVector(beam.range_error)
        r = np.array([values.atPoint3(beam.location) for beam in self.beams])
        v = np.array([values.atUnit3(beam.direction).point3() for beam in self.beams])
        return r, v, k

    def _state(self, isam: gtsam.ISAM2) -> BeamState:
        values = gtsam.Values()
        for beam in self.beams:
            for key in (beam.location, beam.direction, beam.range_error):
                if key is not None:
                    _copy_one(isam, key, beam, values)
        S = isam.jointMarginalCovariance(self._keys).fullMatrix()
        scale = np.sqrt(np.diagonal(S))
        if not (np.isfinite(scale).all() and scale.all()):
            raise RuntimeError("the beams are not determined")
        sign, size = np.linalg.slogdet(S / np.outer(scale, scale))
        if sign <= 0:
            raise RuntimeError("the beams are not determined")
        point = isam.getLinearizationPoint()
        lift = np.zeros((8 * len(self.beams), len(S)))
        first = 0
        for i, (beam, terms) in enumerate(zip(self.beams, self.terms, strict=True)):
            own = beam_lift(point.atUnit3(beam.direction).basis(), terms)
            lift[8 * i : 8 * i + 8, first : first + 5 + terms] = own
            first += 5 + terms
        return BeamState(
            *self._read(values), lift @ S @ lift.T, -float(size + 2.0 * np.log(scale).sum())
        )


def _copy_one(isam: gtsam.ISAM2, key: int, beam: BeamKeys, values: gtsam.Values) -> None:
    """Copy the estimate of one variable; the estimate of all would cost time in their number."""
    if key == beam.location:
        values.insert(key, isam.calculateEstimatePoint3(key))
    elif key == beam.direction:
        values.insert(key, isam.calculateEstimate([key]).atUnit3(key))
    else:
        values.insert(key, isam.calculateEstimateVector(key))


def _isam_parameters(options: IncrementalOptions, length: float, terms: int) -> gtsam.ISAM2Params:
    part = options.relinearize
    units = {
        "r": [length] * 3,
        "v": [1.0, 1.0],
        "p": [1.0, 1.0, length],
        "x": [1.0] * 3 + [length] * 3,
    }
    if terms:
        units["k"] = [1.0, 1.0 / length][:terms]
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, unit in units.items():
        thresholds.insert((letter, part * np.array(unit)))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    steps = gtsam.ISAM2GaussNewtonParams()
    steps.setWildfireThreshold(0.0)
    parameters.setOptimizationParams(steps)
    return parameters
