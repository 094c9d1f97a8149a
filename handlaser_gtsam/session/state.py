"""Everything a session knows once there is a calibration, and what follows from it; never changed.

Unknown scales are integrated over as in the batch solution.
Every plane is remembered by its information on the beams for each set of noise scales
(`LinearReadings`), counted from beams that all share. The graph holds the most probable scales.
Integrating over all scales changes the mean; the change follows from the sums over the planes, and is
added to the estimate of iSAM2. The covariance is that of these sums, as in a batch solution.
A new plane therefore costs the same however many there are.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings
from ..errors import HandlaserError, InputError
from ..estimation.learning_scales import beam_posterior, integrated_over
from ..model.families import DIRECTION, LOCATION, RANGE_ERROR
from ..model.joint import beams_lift
from ..quantities import MOST_ROUNDS
from ..results.calibration import Calibration
from ..solvers.isam import BeamState, GraphPart, IncrementalGraph
from ..validation.other_recording import BeamDrift
from .batch import BatchProblem
from .config import SessionConfig
from .contents import Contents
from .joining import fitted_planes, join_planes
from .moved_beam import recent, search
from .reports import Comparison

REWEIGHED_MOVE = 5e-4
"""Weights, and the information of planes, are updated once the beams have moved by this part of their
natural units: 1 rad, the typical range, a relative change of the range. The probability of scales
depends on how well all planes fit, which is known to second order in such a move."""


@dataclass(frozen=True, eq=False)
class SessionState:
    """The calibration of a session, and how it came about.

    Attributes
    ----------
    contents : Contents
    config : SessionConfig
    at : Beams
        Beams at which the weights are taken, and about which all planes are linearised.
    graph : IncrementalGraph
    state : BeamState
        The beams of the graph.
    compared : BeamState
        The beams of the last comparison with the batch solution.
    learned_with : int
        Planes behind the scales that were learned last, and a range sigma that was not given.
    changes : int
        Number of changes since the last comparison.
    """

    contents: Contents
    config: SessionConfig
    at: Beams
    graph: IncrementalGraph
    state: BeamState
    compared: BeamState
    learned_with: int
    changes: int = 0

    @cached_property
    def integrated(self) -> BeamState:
        """The beams with all scales integrated over, which the graph has at the most probable ones."""
        state, config, learned = self.state, self.config, self.config.learned
        if learned is None:
            return state
        pieces = [plane.information for plane in self.contents.fitted.values()]
        total = sum(pieces[1:], start=pieces[0])
        terms, count = config.terms, len(config.names)
        parts = total[:1], total[1:]
        here, both = (beam_posterior(part, self.at[2], learned) for part in parts)
        mean, covariance, _, solution = integrated_over(learned, here, both)
        step = ((mean - solution) * config.unit).reshape(count, -1)
        bases = model.tangent_basis(self.at[1])
        k = state.range_errors.copy()
        k[:, :terms] += step[:, RANGE_ERROR]
        turned = np.einsum("bij,bj->bi", bases, step[:, DIRECTION])
        # From the tangents where planes are linearised to the tangents of the state, which are those of
        # a batch solution.
        lift = beams_lift(bases, [terms] * count) * config.unit
        across = np.tile(np.eye(8), (count, 1, 1))
        across[:, 3:6, 3:6] -= state.directions[:, :, None] * state.directions[:, None, :]
        lift = block_diag(*across) @ lift
        return replace(
            state,
            locations=state.locations + step[:, LOCATION],
            directions=model.normalized(state.directions + turned),
            range_errors=k,
            covariance=lift @ covariance @ lift.T,
        )

    @property
    def trusted(self) -> bool:
        """Whether planes that were excluded are rather at fault than the beams as they are.

        A few planes may have begun with the wrong beams; many that agree on one beam speak for a move.
        """
        inside, excluded = len(self.contents.inside), self.contents.excluded
        culprits = set(excluded.values())
        agree = len(culprits) == 1 and "" not in culprits
        return inside >= 4 and (len(excluded) <= 0.5 * inside or agree)

    @cached_property
    def batch(self) -> BatchProblem:
        """The planes in the graph as one problem, from the present estimate."""
        place = {number: index for index, number in enumerate(self.graph.planes)}
        order = [place[number] for number in self.contents.numbers.values()]
        parameters = self.graph.parameters().part(np.arange(len(self.config.names)), order)
        return BatchProblem(self.contents, self.config, parameters)

    def calibration(self) -> Calibration:
        """Return the batch solution, from the present estimate."""
        return self.batch.calibration()

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes, every plane in its frame."""
        return self.batch.local_readings(), self.batch.parameters

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate."""
        beams, sigmas = self.batch.beams()
        return Comparison(*self.integrated.apart(beams, sigmas))

    def learned(self) -> SessionConfig:
        """Return the config that everything so far calls for: scales, and a range sigma not given."""
        config, learned = self.config, self.config.learned
        if learned is not None:
            problem = self.batch.scale_problem(learned)
            learned = problem.learned(problem.mode(learned.mode))
            return replace(config, learned=learned, sigma=float(learned.variances().range_sigma[0]))
        if config.noise.range_sigma is not None:
            return config
        found = self.batch.solution
        scale = np.sqrt(found.chi2 / max(found.dof, 1))
        return replace(config, sigma=config.sigma * float(scale), sigma_dof=float(found.dof))

    def moved(self, *, recently: bool = False) -> BeamDrift | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        planes = self.contents.consistent
        moved = search(self.config, planes, recent(len(planes)) if recently else None)
        # A beam without which planes that were excluded would fit has moved far.
        excluded = self.contents.excluded.items()
        plane, beam = next((far for far in excluded if far[1]), ("", ""))
        if beam and moved is None:
            return BeamDrift(beam, np.nan, 0.0, np.full(3, np.nan), np.nan, plane)
        if moved is None or moved.name != beam:
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
        config, before = self.config, self.contents.numbers
        contents, joined, inconsistent = join_planes(config, self.at, self.state, contents, planes)
        if not before.keys().isdisjoint(planes):  # a new plane takes nothing away
            used = [plane.used().beam_names for plane in contents.inside.values()]
            lost = [name for name in config.names if not any(name in seen for seen in used)]
            if lost:
                raise InputError(f"no reading left of beam {', '.join(lost)}", "some of every beam")
        fresh = parts_of(contents, joined)
        gone = [number for name, number in before.items() if name not in contents.numbers]
        new = replace(self, contents=contents, changes=self.changes + 1)
        if fresh or gone:
            fine = strained(contents)
            try:
                graph, state = self.graph.changed(fresh, gone, None, config.determines, fine=fine)
                new = replace(new, graph=graph, state=state).reweighed()
            except RuntimeError:  # iSAM2 takes undamped steps: the batch solver does not
                new = new.solved_at_once()
        if gone and not new.batch.solution.observability.full:
            raise undetermined()
        return new, joined, inconsistent

    def reweighed(self) -> "SessionState":
        """Return the same with weights and information at the present beams, where these have moved."""
        return self if is_near(self.config, self.at, self.state.beams) else self.begun()

    def begun(self, beams: Beams | None = None) -> "SessionState":
        """Return the same from a new graph, which begins with the present beams or others."""
        new = begin(self.contents, self.config, self.state.beams if beams is None else beams)
        return replace(
            new, compared=self.compared, learned_with=self.learned_with, changes=self.changes
        )

    def solved_at_once(self) -> "SessionState":
        """Return the same from a batch solution of the contents, beside the present beams.

        Raises
        ------
        InputError
            The beams are not determined.
        """
        config, beams = self.config, self.state.beams
        try:
            contents = fitted_planes(self.contents, config, beams)
            fitted = contents.fitted.values()
            if not fitted:
                raise RuntimeError("no plane is left")
            normals = np.concatenate([plane.parameters.normals for plane in fitted])
            offsets = np.concatenate([plane.parameters.offsets for plane in fitted])
            start = Parameters(*beams, normals, offsets)
            begun = self.begun(BatchProblem(contents, config, start).solution.parameters.beams)
            if not config.determines(begun.state):
                raise RuntimeError("too few planes are left")
        except (RuntimeError, HandlaserError) as error:
            raise undetermined(f" ({error})") from error
        return begun


def begin(contents: Contents, config: SessionConfig, beams: Beams) -> SessionState:
    """Return a new graph of every plane that is determined beside `beams`, and not excluded.

    Raises
    ------
    RuntimeError
        GTSAM calls the system indeterminate, or the estimate does not settle.
    """
    for _ in range(MOST_ROUNDS):
        at, contents = beams, fitted_planes(contents, config, beams)
        parts = parts_of(contents, tuple(contents.inside))
        graph, state = config.graph(at, parts, fine=strained(contents))
        beams = state.beams
        if is_near(config, at, beams):
            break
    return SessionState(contents, config, at, graph, state, state, len(parts))


def is_near(config: SessionConfig, beams: Beams, others: Beams) -> bool:
    """Tell whether weights, and the information of planes, may stay those at other beams."""
    shift, turn, stretch = (np.abs(a - b) for a, b in zip(beams, others, strict=True))
    stretched = stretch @ [1.0, config.length]
    return bool(max(shift.max() / config.length, turn.max(), stretched.max()) < REWEIGHED_MOVE)


def strained(contents: Contents) -> bool:
    """Tell whether there are planes in the graph that do not fit, whatever the beams are."""
    return len(contents.consistent) < len(contents.fitted)


def parts_of(contents: Contents, names: tuple[str, ...]) -> dict[int, GraphPart]:
    """Return the factors of some planes in the graph, by their number."""
    parts, stations = {}, contents.station_numbers
    for name in names:
        plane = contents.planes[name]
        if plane.fitted is not None and plane.number is not None:
            parts[plane.number] = plane.fitted.factors(plane.number, stations, plane.used())
    return parts


def undetermined(why: str = "") -> InputError:
    """Return the error of a change that takes away what determines the beams."""
    change = f"a change after which the beams are undetermined{why}"
    return InputError(change, "planes that determine them")
