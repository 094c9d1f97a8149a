"""Everything a session knows once there is a calibration, and what follows from it; never changed.

Unknown scales are integrated over as in the batch solution.
Every plane is remembered by its information on the beams for each set of noise scales
(`estimation.information`), counted from beams that all share. The graph holds the most probable scales.
Integrating over all scales changes mean and covariance; both changes follow from the sums over the
planes, and are added to the estimate of iSAM2. So the cost of a new plane does not grow.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings
from ..errors import HandlaserError, InputError
from ..estimation.information import Information, LinearReadings
from ..estimation.mixture import BeamPosterior
from ..factors import RangeBlock
from ..factors.keys import plane_key, pose_key
from ..model.families import DIRECTION, LOCATION, RANGE_ERROR
from ..model.joint import beams_lift
from ..quantities import MOST_ROUNDS
from ..results.calibration import Calibration
from ..solvers.graph import parameters_of
from ..solvers.isam import BeamState, GraphPart, IncrementalGraph
from .batch import BatchProblem
from .config import SessionConfig
from .contents import Contents
from .drift import DriftHistory, turns
from .fitted import FittedPlane, fit_plane
from .joining import factors_of, fitted_planes, history_of, join_planes
from .reports import Comparison, Moved

REWEIGHED_MOVE = 3e-3
"""Weights, and the information of planes, are updated once the beams have moved by this part of their
natural units: 1 rad, the typical range, a relative change of the range."""
REWEIGHED_MOVE_OF_SCALES = 5e-4
"""The same move where scales are integrated over: their probability depends on how well all planes fit,
which is known to second order in such a move."""
TRUSTED_PLANES = 4
"""With fewer planes in the graph none is excluded: the first planes may have begun with wrong beams."""


@dataclass(frozen=True, eq=False)
class SessionState:
    """The calibration of a session, and how it came about.

    Attributes
    ----------
    contents : Contents
    config : SessionConfig
    graph : IncrementalGraph
    factors : mapping of int to GraphPart
        Factors of every plane in the graph, by its number.
    state : BeamState
        The beams of the graph.
    compared : BeamState
        The beams of the last comparison with the batch solution.
    changes : int
        Number of changes since that comparison.
    history : DriftHistory
        Counted from the beams behind the weights.
    inconsistent : frozenset of str
        Planes in the graph that do not fit, whatever has moved.
    learned_with : int
        Planes behind the scales that were learned last, and a range sigma that was not given.
    sums : mapping of str to Information
        What each plane knows for all scales; empty where none are integrated over.
    """

    contents: Contents
    config: SessionConfig
    graph: IncrementalGraph
    factors: Mapping[int, GraphPart]
    state: BeamState
    compared: BeamState
    changes: int
    history: DriftHistory
    inconsistent: frozenset[str]
    learned_with: int
    sums: Mapping[str, Information] = field(default_factory=dict)

    @cached_property
    def integrated(self) -> BeamState:
        """The beams with all scales integrated over, which the graph has at the most probable ones."""
        state, history, learned = self.state, self.history, self.config.learned
        if learned is None or not self.sums:
            return state
        # What is known beside the planes is so whatever the noise is.
        total = sum(self.sums.values(), start=history.known[None])
        terms, members = learned.terms, self.config.members
        k = history.beams[2][:, :terms] * np.array([1.0, learned.length])[:terms]
        here, both = (
            BeamPosterior(part, k, learned.widest, members) for part in (total[:1], total[1:])
        )
        mixture = both.mixture(learned.along(here.worst_known()).grid, learned.log_weight)
        mean, covariance = here.conditional(learned.range_error)
        unit = history.unit
        step = ((mixture.mean - mean) * unit).reshape(len(state.locations), -1)
        change = (mixture.covariance - covariance) * np.outer(unit, unit)
        bases = model.tangent_basis(history.beams[1])
        lift = beams_lift(bases, [terms] * len(bases))
        k = state.range_errors.copy()
        k[:, :terms] += step[:, RANGE_ERROR]
        turned = np.einsum("bij,bj->bi", bases, step[:, DIRECTION])
        # The history has other tangents than the state, which has the tangents of a batch solution:
        # project along every beam out of the coordinates (8,).
        across = np.tile(np.eye(8), (len(state.directions), 1, 1))
        across[:, 3:6, 3:6] -= state.directions[:, :, None] * state.directions[:, None, :]
        project = block_diag(*across)
        return replace(
            state,
            locations=state.locations + step[:, LOCATION],
            directions=model.normalized(state.directions + turned),
            range_errors=k,
            covariance=project @ (state.covariance + lift @ change @ lift.T) @ project,
        )

    @property
    def trusted(self) -> bool:
        """Whether planes that were excluded are rather at fault than the beams as they are.

        A few planes may have begun with the wrong beams; many that agree on one beam speak for a move.
        """
        inside, excluded = len(self.contents.numbers), self.contents.excluded
        culprits = set(excluded.values())
        agree = len(culprits) == 1 and "" not in culprits
        return inside >= TRUSTED_PLANES and (len(excluded) <= 0.5 * inside or agree)

    def inside(self) -> BatchProblem:
        """Return the planes in the graph as one problem, at the present estimate."""
        graph, contents = self.graph, self.contents
        place = {number: index for index, number in enumerate(graph.planes)}
        order = [place[number] for number in contents.numbers.values()]
        parameters = graph.parameters().part(np.arange(len(self.config.names)), order)
        problem = BatchProblem(contents, self.config, parameters)
        if self.config.poses != "estimated":
            return problem
        poses, names = gtsam.Values(), problem.recording.station_names
        for j in np.unique(problem.readings.station[problem.used]).tolist():
            key = pose_key(contents.station_numbers[names[j]])
            poses.insert(pose_key(j), graph.pose(key))
        return replace(problem, poses=poses)

    def calibration(self) -> Calibration:
        """Return the calibration at the present estimate; nothing is solved again."""
        return self.inside().calibration()

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes, every plane in its frame."""
        inside = self.inside()
        return inside.local_readings(), inside.parameters

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate."""
        return self.inside().compared(self.integrated)

    def moved(self, *, recently: bool = False) -> Moved | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        epochs = self.history.recent() if recently else None
        moved = self.history.search(self.config.sigma_dof, epochs)
        # A beam without which planes that were excluded would fit has moved far.
        excluded = self.contents.excluded.items()
        plane, beam = next((far for far in excluded if far[1]), ("", ""))
        if beam and moved is None:
            return Moved(beam, plane, np.nan, 0.0, np.full(3, np.nan), np.nan)
        if moved is None or moved.beam != beam:
            return moved
        order = list(self.contents.planes)
        return replace(moved, since=min(moved.since, plane, key=order.index))

    def changed(
        self, contents: Contents, planes: tuple[str, ...]
    ) -> tuple["SessionState", tuple[str, ...], tuple[str, ...]]:
        """Return the state with `contents`, in which only `planes` differ from the present ones.

        Returns
        -------
        SessionState
        joined, inconsistent : tuples of str
            As `join_planes` has them.

        Raises
        ------
        InputError
            The beams would not be determined.
        """
        config = self.config
        contents, history, joined, inconsistent = join_planes(
            config, self.state, contents, self.history, planes
        )
        if set(planes) & set(self.contents.numbers):  # a new plane takes nothing away
            used = [contents.planes[plane].used().beam_names for plane in contents.numbers]
            lost = [name for name in config.names if not any(name in seen for seen in used)]
            if lost:
                raise InputError(f"no reading left of beam {', '.join(lost)}", "some of every beam")
        inside, fresh = contents.numbers, factors_of(contents, joined)
        gone = [number for plane, number in self.contents.numbers.items() if plane not in inside]
        kept = {number: of_plane for number, of_plane in self.factors.items() if number not in gone}
        new = replace(
            self,
            contents=contents,
            factors={**kept, **fresh},
            history=history,
            changes=self.changes + 1,
            inconsistent=(self.inconsistent - set(planes)) | set(inconsistent),
            sums={plane: sums for plane, sums in self.sums.items() if plane in inside}
            | _sums(joined, self.history),
        )
        if fresh or gone:
            try:
                fine, determines = bool(new.inconsistent), config.determines
                graph, state = new.graph.changed(fresh, gone, None, determines, fine=fine)
                new = replace(new, graph=graph, state=state).reweighed()
            except RuntimeError:  # iSAM2 takes undamped steps: the batch solver does not
                new = new.solved_at_once()
        if gone and not config.links and not new.inside().solution().observability.full:
            raise undetermined()
        return new, tuple(joined), inconsistent

    def solved_at_once(self) -> "SessionState":
        """Return the same from a batch solution of the contents, beside the present beams.

        Raises
        ------
        InputError
            The beams are not determined.
        """
        fitted = fitted_planes(self.contents, self.config, self.state.beams)
        try:
            if not fitted:
                raise RuntimeError("no plane is left")
            contents = self.contents.numbered({plane: p.origin for plane, p in fitted.items()})
            normals = np.concatenate([p.parameters.normals for p in fitted.values()])
            offsets = np.concatenate([p.parameters.offsets for p in fitted.values()])
            parameters = Parameters(*self.state.beams, normals, offsets)
            _, _, solved = BatchProblem(contents, self.config, parameters).solved()
            begun = begin(self.contents, self.config, solved.beams)
            if not self.config.determines(begun.state):
                raise RuntimeError("too few planes are left")
        except (RuntimeError, HandlaserError) as error:
            raise undetermined(f" ({error})") from error
        return replace(
            begun, compared=self.compared, changes=self.changes, learned_with=self.learned_with
        )

    def reweighed(self) -> "SessionState":
        """Return the same with weights and history of the present beams, where these have moved."""
        config, beams = self.config, self.state.beams
        limit = REWEIGHED_MOVE if config.learned is None else REWEIGHED_MOVE_OF_SCALES
        shift, turn, stretch = (
            np.abs(a - b) for a, b in zip(beams, self.history.beams, strict=True)
        )
        stretched = stretch @ [1.0, config.length]
        if max(shift.max() / config.length, turn.max(), stretched.max()) < limit:
            return self
        fitted = {}
        for plane in self.contents.numbers:
            contents = self.contents.planes[plane]
            refitted = fit_plane(config, contents.used(), beams, contents.origin)
            if refitted is None:
                return self
            fitted[plane] = refitted
        history = DriftHistory.empty(config, beams)
        for plane in self.history.pieces:
            history = history.with_plane(plane, fitted[plane].information(history))
        now = replace(self, history=history)
        if not config.weights_depend:
            return now
        factors = factors_of(self.contents, fitted)
        graph, state = self.graph.changed(factors, fine=bool(self.inconsistent))
        sums = _sums(fitted, history)
        return replace(now, graph=graph, factors=factors, state=state, sums=sums)

    def __reduce__(self) -> tuple[object, ...]:
        """Let the state be copied and pickled: the graph is rebuilt, linearised where it is."""
        known = {one.name: getattr(self, one.name) for one in fields(self)}
        point, planes = self.graph.linearization_point(), [plane_key(n) for n in self.factors]
        poses = _poses_of(block for of_plane in self.factors.values() for block in of_plane.blocks)
        known["graph"] = (
            parameters_of(point, self.config.beams, planes),
            {key: point.atPose3(key) for key in poses},
        )
        known["factors"] = {n: (part.blocks, part.others) for n, part in self.factors.items()}
        return _restored, (known,)


def _restored(known: dict[str, Any]) -> SessionState:
    """Return a state from its fields, of which the graph is where all variables are linearised."""
    config, (parameters, poses), factors = known["config"], known["graph"], {}
    planes = zip(parameters.normals, parameters.offsets, known["factors"].items(), strict=True)
    for normal, offset, (number, (blocks, others)) in planes:
        values = gtsam.Values()
        values.insert(plane_key(number), gtsam.OrientedPlane3(gtsam.Unit3(normal), offset))
        for key in _poses_of(blocks):
            values.insert(key, poses[key])
        factors[number] = GraphPart(blocks, others, values)
    graph = IncrementalGraph(config.beams, config.terms, config.length, config.incremental)
    fine = bool(known["inconsistent"])
    graph, _ = graph.changed(factors, (), config.start(parameters.beams), fine=fine)
    return SessionState(**{**known, "graph": graph, "factors": factors})


def begin(contents: Contents, config: SessionConfig, beams: Beams) -> SessionState:
    """Return a new graph of every plane that is determined beside `beams`.

    Raises
    ------
    RuntimeError
        GTSAM calls the system indeterminate, or the estimate does not settle.
    """
    fitted = fitted_planes(contents, config, beams)
    contents = contents.numbered({plane: plane_fit.origin for plane, plane_fit in fitted.items()})
    factors = factors_of(contents, fitted)
    history, inconsistent = history_of(config, beams, fitted)
    graph = IncrementalGraph(config.beams, config.terms, config.length, config.incremental)
    graph, state = graph.changed(factors, (), config.start(beams), fine=bool(inconsistent))
    sums, known = _sums(fitted, history), (history, inconsistent, len(fitted))
    now = SessionState(contents, config, graph, factors, state, state, 0, *known, sums)
    for _ in range(MOST_ROUNDS):
        before, now = now, now.reweighed()
        if now is before:
            break
    return replace(now, compared=now.state)


def _sums(fitted: Mapping[str, FittedPlane], history: DriftHistory) -> dict[str, Information]:
    """Return what planes know for all sets of noise scales, counted as in a history.

    Nothing where no scales are learned.
    """
    sums: dict[str, Information] = {}
    learned = history.config.learned
    if learned is None:
        return sums
    for name, plane in fitted.items():
        readings, at = plane.readings, plane.parameters
        variances = learned.base.for_stations(int(readings.station.max()) + 1)
        rows = LinearReadings(at, readings, learned.terms, learned.length, variances)
        points = [learned.mode, *learned.points]
        information, _ = rows.information([learned.scales.noise(u) for u in points])
        # The unknowns there are turn (x - shift).
        turn, shift = turns(at.directions, history), history.coordinates(at.beams)
        matrix, vector = turn.T @ information.matrix @ turn, information.vector @ turn
        constant = information.constant - vector @ shift - 0.5 * (matrix @ shift) @ shift
        sums[name] = Information(matrix, vector + matrix @ shift, constant)
    return sums


def _poses_of(blocks: Iterable[RangeBlock]) -> list[int]:
    """Return the keys of the hand poses that are variables of some blocks, each once."""
    return list(dict.fromkeys(block.pose for block in blocks if block.pose is not None))


def undetermined(why: str = "") -> InputError:
    """Return the error of a change that takes away what determines the beams."""
    change = f"a change after which the beams are undetermined{why}"
    return InputError(change, "planes that determine them")
