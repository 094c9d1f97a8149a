"""iSAM2 behind a small class that is never left half-updated, and what goes into it and comes out.

Planes join one by one; the beams stay in the root of the Bayes tree, so that an update with one plane
eliminates little else again. What was measured of GTSAM 4.3, and how it is met:

- an exception inside `update` leaves the object half-updated: every change works on a copy and gives
  a new graph; the old one stays as it was;
- the default relinearisation threshold ignores moves of a mount in millimetres: each kind of variable
  has a threshold in its natural unit. iSAM2 would relinearise the variables one by one, and a
  beam takes all readings with it each time: here all are relinearised as soon as one must be;
- all Values are copied for every Python factor unless the linearisation point is held: it is;
- marginals are in the tangent bases of the linearisation point: they are lifted from there;
- it is not thread-safe: a graph and those that follow from it share one lock.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from threading import RLock

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Beams, Parameters
from ..errors import GrazingBeamError
from ..factors import RangeBlock, evaluated_together, range_factor
from ..factors.keys import BeamKeys, plane_key
from ..model.families import BEAM
from ..model.joint import beams_lift
from ..quantities import MOST_ROUNDS
from .graph import parameters_of, start_values


@dataclass(frozen=True, slots=True)
class BeamState:
    """Beams of a session with their covariance.

    Attributes
    ----------
    locations, directions : (B, 3)
    range_errors : (B, 2)
    covariance : (8 B, 8 B)
        Ambient, over the numbers of every beam.
    information : float
        Logarithm of the determinant of the tangent information [nats], up to the units.
    """

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    covariance: FloatArray
    information: float

    @property
    def beams(self) -> Beams:
        """The estimate without its covariance."""
        return self.locations, self.directions, self.range_errors

    def sigmas(self) -> FloatArray:
        """Return the standard deviations (B, 8)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, BEAM.size)

    def apart(self, beams: Beams, sigmas: FloatArray) -> tuple[float, float]:
        """Return how far another estimate is: largest difference of a coordinate and of a sigma.

        Parameters
        ----------
        beams : Beams
        sigmas : (B, 8)
            Standard deviations of that estimate: the unit of the first number; the second is relative.
        """
        seen = sigmas > 0.0
        difference = np.abs(np.hstack(self.beams) - np.hstack(beams))[seen] / sigmas[seen]
        relative = np.abs(self.sigmas()[seen] / sigmas[seen] - 1.0)
        return float(difference.max()), float(relative.max())


@dataclass(frozen=True, slots=True)
class GraphPart:
    """What one plane brings into the graph, or what the beams bring that begin it.

    Attributes
    ----------
    blocks : RangeBlocks
        Each with a whitening; none in the part of the beams, which has priors alone.
    others : factors
        Priors of the hand poses of a plane; of the range errors of the beams.
    start : gtsam.Values
        Start of its variables; variables that are in the graph already keep their values.
    """

    blocks: tuple[RangeBlock, ...]
    others: tuple[gtsam.NonlinearFactor, ...]
    start: gtsam.Values


RELINEARIZED = 2e-4
"""Variables that have moved by more than this part of their natural units are relinearised."""
FINE_PART = 0.05
"""Once one variable must be relinearised, all are that have moved by this part of their threshold."""


class IncrementalGraph:
    """Beams and planes under iSAM2; never changed: a change gives a new one.

    A graph can be pickled and copied: it is eliminated again, linearised where it is.

    Parameters
    ----------
    beams : BeamKeys, each
    terms : int
        Range-error terms of every beam.
    length : float
        The typical range [m], for natural units.
    """

    def __init__(self, beams: Sequence[BeamKeys], terms: int, length: float) -> None:
        self.beams, self.terms, self.length = tuple(beams), terms, length
        self._keys = [key for beam in beams for key in beam.variables]
        units = {
            "r": [length] * 3,
            "v": [1.0] * 2,
            "k": [1.0, 1.0 / length][:terms],
            "p": [1.0, 1.0, length],
            "x": [1.0] * 3 + [length] * 3,
        }
        self._thresholds = {
            letter: RELINEARIZED * np.array(unit) for letter, unit in units.items() if unit
        }
        self._unit = BEAM.number_units(length)
        self._isam = gtsam.ISAM2(_isam_parameters(self._thresholds))
        self._view = self._isam.getLinearizationPoint()
        self._factors: dict[int, tuple[int, ...]] = {}
        self._parts: dict[int, GraphPart] = {}
        self._of_beams: tuple[gtsam.NonlinearFactor, ...] = ()
        self._lock = RLock()

    def __reduce__(self) -> tuple[object, ...]:
        """Return what a copy is made of: GTSAM pickles its own factors and poses, but no values."""
        with self._lock:
            at = parameters_of(self._view, self.beams, [plane_key(n) for n in self._parts])
            poses = {key: self._view.atPose3(key) for key in self._poses()}
            parts = {n: (part.blocks, part.others) for n, part in self._parts.items()}
        kept = self.beams, self.terms, self.length, self._of_beams
        return _restored, (kept, at, poses, parts)

    @property
    def planes(self) -> tuple[int, ...]:
        """Numbers of the planes that are in."""
        return tuple(self._parts)

    def changed(
        self,
        added: Mapping[int, GraphPart],
        without: Iterable[int] = (),
        beams: GraphPart | None = None,
        accept: Callable[[BeamState], bool] | None = None,
        *,
        fine: bool = False,
    ) -> tuple["IncrementalGraph", BeamState]:
        """Return the graph with planes added and others taken out, and its beams.

        Parameters
        ----------
        added : mapping
            By the number of the plane. What a plane brought before is taken out first.
        without : numbers
            Planes that leave.
        beams : GraphPart, optional
            Where the beams start, the first time.
        accept : callable, optional
            Asked before the change takes place.
        fine : bool
            Whether to relinearise for much smaller moves: where readings do not fit, the optimum
            depends on every Jacobian by as much as they are off. Always done where beams are hardly
            known, for their standard deviations then depend on where they were linearised.

        Raises
        ------
        RuntimeError
            GTSAM calls the system indeterminate, the estimate does not settle, a step leads to a beam
            that grazes its plane, or it is not accepted.
        """
        with self._lock:
            new = self._copy()
            gone = {*without, *(number for number in added if number in self._factors)}
            try:
                new._exchange(added, gone, beams)
                new._settle(FINE_PART if fine else 1.0)
                state = new.state()
                # A beam is hardly known to a hundredth of its natural units.
                if not fine and (state.sigmas() > 0.01 * new._unit).any():
                    new._settle(FINE_PART)
                    state = new.state()
            except (GrazingBeamError, RuntimeError) as error:  # steps of iSAM2 are undamped
                # GTSAM's own words are a page on linear systems.
                singular = "Indeterminate" in str(error)
                words = "GTSAM calls the system indeterminate" if singular else str(error)
                raise RuntimeError(words) from error
            if accept is not None and not accept(state):
                raise RuntimeError("too few planes are left")
        return new, state

    def state(self) -> BeamState:
        """Return the beams as they are now."""
        with self._lock:
            S = self._isam.jointMarginalCovariance(self._keys).fullMatrix()
            # The beams alone: the estimate of all variables would cost time in their number.
            values, delta = gtsam.Values(), self._isam.getDelta()
            for beam in self.beams:
                r, v, k = beam.location, beam.direction, beam.range_error
                values.insert(r, self._view.atPoint3(r) + delta.at(r))
                values.insert(v, unit3=self._view.atUnit3(v).retract(delta.at(v)))
                if k is not None:
                    values.insert(k, self._view.atVector(k) + delta.at(k))
            bases = np.array([self._view.atUnit3(beam.direction).basis() for beam in self.beams])
        scale = np.sqrt(np.diagonal(S))
        sound = np.isfinite(scale).all() and scale.all()
        sign, size = np.linalg.slogdet(S / np.outer(scale, scale)) if sound else (0.0, 0.0)
        if sign <= 0:
            raise RuntimeError("the beams are not determined")
        lift = beams_lift(bases, [self.terms] * len(bases))
        return BeamState(
            *parameters_of(values, self.beams, ()).beams,
            lift @ S @ lift.T,
            -float(size + 2.0 * np.log(scale).sum()),
        )

    def parameters(self) -> Parameters:
        """Return beams, and planes in the order of `planes`, each in the frame of its blocks."""
        with self._lock:
            values = self._isam.calculateEstimate()
        return parameters_of(values, self.beams, [plane_key(number) for number in self.planes])

    @property
    def blocks(self) -> list[RangeBlock]:
        """The blocks of all planes."""
        return [block for part in self._parts.values() for block in part.blocks]

    def _copy(self) -> "IncrementalGraph":
        new = object.__new__(IncrementalGraph)
        new.__dict__.update(self.__dict__)
        new._factors, new._parts = dict(self._factors), dict(self._parts)
        new._isam = gtsam.ISAM2(self._isam)
        new._view = new._isam.getLinearizationPoint()
        return new

    def _exchange(
        self, added: Mapping[int, GraphPart], gone: Iterable[int], beams: GraphPart | None
    ) -> None:
        """Let planes leave, and others join; with the beams the first time."""
        old = [index for number in gone for index in self._factors.pop(number)]
        for number in gone:
            del self._parts[number]
        self._parts |= added
        if not self._parts:
            raise RuntimeError("no plane is left")
        graph, start, sizes = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        for part in added.values():
            for block in part.blocks:
                sigma = 1.0 if block.whitening is None else block.whitening.sigma
                graph.push_back(range_factor(block, sigma))
            for factor in part.others:
                graph.push_back(factor)
            sizes.append(len(part.blocks) + len(part.others))
            new = gtsam.Values(part.start)
            for key in part.start.keys():  # noqa: SIM118
                if self._isam.valueExists(key):
                    new.erase(key)
            start.insert(new)
        if beams is not None:
            self._of_beams = beams.others
            start.insert(beams.start)
            for factor in beams.others:
                graph.push_back(factor)
        indices = list(self._update(graph, start, old).getNewFactorsIndices())
        ends = np.cumsum([0, *sizes]).tolist()
        for number, a, e in zip(added, ends, ends[1:], strict=False):
            self._factors[number] = tuple(indices[a:e])

    def _update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        start: gtsam.Values,
        old: list[int],
        *,
        relinearize: bool = False,
    ) -> gtsam.ISAM2Result:
        groups = gtsam.KeyGroupMap()
        for key in self._keys:
            groups.insert2(key, 1)  # eliminated last: all other variables are in group 0
        with evaluated_together(self.blocks):
            return self._isam.update(graph, start, old, groups, None, None, relinearize)

    def _settle(self, part: float) -> None:
        """Relinearise until nothing has moved by a part of its threshold."""
        # GTSAM's order of the variables is by letter, then by number.
        beams = {letter: len(self.beams) for letter in "rvk" if letter in self._thresholds}
        count = beams | {"p": len(self._parts), "x": len(self._poses())}
        limits = [np.tile(self._thresholds[letter], count[letter]) for letter in sorted(count)]
        limit = part * np.concatenate(limits)
        for _ in range(MOST_ROUNDS):
            if (np.abs(self._isam.getDelta().vector()) <= limit).all():
                return
            self._update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [], relinearize=True)
        raise RuntimeError("the estimate does not settle")

    def _poses(self) -> set[int]:
        """Return the keys of the hand poses that are variables."""
        return {block.pose for block in self.blocks if block.pose is not None}


def _restored(
    kept: tuple[tuple[BeamKeys, ...], int, float, tuple[gtsam.NonlinearFactor, ...]],
    at: Parameters,
    poses: dict[int, gtsam.Pose3],
    parts: dict[int, tuple[tuple[RangeBlock, ...], tuple[gtsam.NonlinearFactor, ...]]],
) -> IncrementalGraph:
    """Return a graph from what it was reduced to, linearised at parameters and poses."""
    beams, terms, length, of_beams = kept
    start = start_values(at, beams, tuple(plane_key(number) for number in parts), terms)
    for key, pose in poses.items():
        start.insert(key, pose3=pose)
    graph, nowhere = IncrementalGraph(beams, terms, length), gtsam.Values()
    planes = {number: GraphPart(*part, nowhere) for number, part in parts.items()}
    graph._exchange(planes, (), GraphPart((), of_beams, start))
    return graph


def _isam_parameters(thresholds: dict[str, FloatArray]) -> gtsam.ISAM2Params:
    """Return parameters with which only `IncrementalGraph` decides when to relinearise."""
    fine = gtsam.ISAM2ThresholdMap()
    for letter, threshold in thresholds.items():
        fine.insert((letter, FINE_PART * threshold))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(fine)
    parameters.relinearizeSkip = int(np.iinfo(np.int32).max)  # iSAM2 never does it by itself
    steps = gtsam.ISAM2GaussNewtonParams()
    steps.setWildfireThreshold(0.0)
    parameters.setOptimizationParams(steps)
    return parameters
