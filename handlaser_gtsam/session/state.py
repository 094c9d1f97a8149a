"""Everything a session knows once there is a calibration, and what follows from it; never changed.

Planes that join are fitted beside the beams, and judged. Every plane is remembered by its information
on the beams for each set of noise scales (`LinearReadings`), counted from beams that all share.
The graph holds the most probable scales. Unknown scales are integrated over as in the batch solution:
that changes the mean; the change follows from the sums over the planes, and is added to the estimate of
iSAM2. The covariance is that of these sums, as in a batch solution. A new plane therefore costs the
same however many there are.
"""

from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..arrays import BoolArray, FloatArray
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Order, Readings, join
from ..errors import HandlaserError, InputError
from ..estimation.joint_solution import settle
from ..estimation.learning_scales import (
    LearnedScales,
    ScaleProblem,
    beam_posterior,
    integrated_over,
)
from ..estimation.options import CalibrationOptions
from ..estimation.selection import Selection
from ..estimation.solution import Solution, covariance_of_determined, posterior
from ..model.families import (
    BEAM,
    MOUNT_DIM,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    count_unknowns,
)
from ..model.joint import beams_lift
from ..model.sensor_limits import FLAT, OUTSIDE, within_incidence
from ..model.weighting import weighed
from ..outliers.reading_tests import price
from ..pipeline import calibrate_from
from ..quantities import FAR_SIGMAS, MOST_ROUNDS, SAME_OPTIMUM
from ..results.assemble import assemble
from ..results.calibration import Calibration
from ..results.problem import Problem
from ..results.warnings import contradicted_sigmas
from ..solvers.isam import BeamState, GraphPart, IncrementalGraph
from ..validation.other_recording import BeamDrift
from .config import SessionConfig
from .contents import Contents, PlaneContents, arranged
from .moved_beam import search
from .plane import FittedPlane, fit_plane
from .reports import Comparison

REWEIGHED_MOVE = 5e-4
"""Weights, and the information of planes, are updated once the beams have moved by this part of their
natural units: 1 rad, the typical range, a relative change of the range. The probability of scales
depends on how well all planes fit, which is known to second order in such a move."""
LEAST_CHANGES = 4
"""Changes between two comparisons with the batch solution at least: a comparison takes its time."""
GROSS_ERROR = 0.02
"""Prior probability that a reading is a gross error."""
DISPLACED = 1e-3
"""Prior probability that a beam is displaced between two planes."""
METHOD = "incremental"
CONTRADICTED = "contradicted by the beams and the other readings"
OUTLIERS_AGAIN = "outliers chosen again"


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

    @classmethod
    def of(
        cls, batch: Calibration, contents: Contents, noise: Noise, options: CalibrationOptions
    ) -> "SessionState":
        """Return the state that begins with a calibration, converged, of the contents.

        Raises
        ------
        InputError
            The undamped steps of iSAM2 lead nowhere: the readings hardly determine the beams.
        """
        config, restarted = SessionConfig.of(batch, noise, options), contents.restarted
        return begun_or_refused(restarted(batch.fit.rejected), config, batch.parameters().beams)

    def __getstate__(self) -> dict[str, object]:
        """Return the attributes: what follows from them may hold factors that GTSAM cannot pickle."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def with_shared(self) -> BeamState:
        """The beams with all scales integrated over, and errors that stations have in common."""
        state, shared = self.integrated, self.config.shared
        if shared is None:
            return state
        # The covariance is in the tangents of the graph's directions, as that of a batch solution is.
        grown = shared.grown(state.covariance, self.state.directions)
        return replace(state, covariance=grown)

    @cached_property
    def integrated(self) -> BeamState:
        """The beams with all scales integrated over, which the graph has at the most probable ones."""
        state, config, learned = self.state, self.config, self.config.learned
        if learned is None:
            return state
        pieces = [plane.information for plane in self.contents.fitted.values()]
        total = sum(pieces[1:], start=pieces[0])
        terms, count = config.terms, len(config.names)
        here, both = (beam_posterior(part, self.at[2], learned) for part in (total[:1], total[1:]))
        mean, covariance, _, solution = integrated_over(learned, here, both)
        lift = beams_lift(model.tangent_basis(self.at[1]), [terms] * count) * config.unit
        step = (lift @ (mean - solution)).reshape(count, -1)
        # From the tangents where planes are linearised to the tangents of the state, which are those of
        # a batch solution.
        across = np.tile(np.eye(BEAM.size), (count, 1, 1))
        v = state.directions
        across[:, OF_DIRECTION, OF_DIRECTION] -= v[:, :, None] * v[:, None, :]
        lift = block_diag(*across) @ lift
        return replace(
            state,
            locations=state.locations + step[:, OF_LOCATION],
            directions=model.normalized(v + step[:, OF_DIRECTION]),
            range_errors=state.range_errors + step[:, OF_RANGE_ERROR],
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
    def parameters(self) -> Parameters:
        """Beams and planes of the graph, each plane in its frame, in the order of the contents."""
        place = {number: index for index, number in enumerate(self.graph.planes)}
        order = [place[number] for number in self.contents.numbers.values()]
        return self.graph.parameters().part(np.arange(len(self.config.names)), order)

    @cached_property
    def problem(self) -> Problem:
        """The planes in the graph as one problem, with rejected readings.

        Planes are as the contents order them, beams as the config does.
        """
        contents, config = self.contents, self.config
        whole = join([plane.recording for plane in contents.inside.values()])
        recording = arranged(whole, config.names)
        origins = np.array([plane.origin for plane in contents.fitted.values()])
        readings, sensor = config.readings(recording), config.options.sensor
        sizes = len(recording.plane_labels), len(recording.beam_names), len(recording.plane_names)
        order = Order(*map(np.arange, sizes))  # readings are numbered as in the recording
        noise = config.noise.without(config.contradicted)
        return Problem(recording, readings, order, origins, noise, sensor)

    def used(self, reason: str | None = None) -> BoolArray:
        """Return which readings (N,) of the problem are not rejected, for any reason or for one."""
        problem, rejected = self.problem, self.contents.rejected
        out = {(r.station, r.sensor) for r in rejected if reason in (None, r.reason)}
        stations, beams = problem.recording.station_names, problem.recording.beam_names
        pairs = zip(problem.readings.station.tolist(), problem.readings.beam.tolist(), strict=True)
        return np.array([(stations[j], beams[i]) not in out for j, i in pairs], dtype=bool)

    @cached_property
    def solution(self) -> Solution:
        """Their batch solution from the present estimate, with the scales integrated over."""
        return solved(self.config, *self.estimate())

    def calibration(self) -> Calibration:
        """Return the batch solution as a calibration, with readings that are not used."""
        problem, solution = self.problem, self.solution
        tried = ((METHOD, float(np.sqrt(np.mean(solution.at.residual**2)))),)
        used, outside, flat = map(self.used, (None, OUTSIDE, FLAT))
        gone = self.config.contradicted
        chosen = Selection(used, ~outside, ~flat, METHOD, tried, solution, gone)
        found = assemble(problem, chosen)
        of_noise = contradicted_sigmas(
            self.config.noise, gone, found.fit.range_sigma, found.noise_estimate
        )
        return replace(found, warnings=(*of_noise, *found.warnings))

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes, every plane in its frame."""
        return self.problem.chosen(self.used()), self.parameters

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate."""
        found = self.solution
        joint = found.joint if found.posterior is None else found.posterior.joint
        if joint is None:
            origins = np.zeros_like(self.problem.origins)
            where = found.parameters, found.at.sigma, origins
            joint = covariance_of_determined(found.observability, *where)
        sigmas = np.sqrt(np.diagonal(joint.matrix(planes=[]))).reshape(-1, BEAM.size)
        return Comparison(*self.integrated.apart(found.best.beams, sigmas))

    def learned(self) -> SessionConfig:
        """Return the config that everything so far calls for: scales, and a range sigma not given."""
        config, learned = self.config, self.config.learned
        if learned is not None:
            readings, parameters = self.estimate()
            problem = scale_problem(config, learned, readings, parameters)
            learned = problem.learned(problem.mode(learned.mode))
            sigma, dof = float(learned.variances().range_sigma[0]), config.sigma_dof
            if np.isfinite(dof):  # priors of range errors say as much as these are unknowns
                terms = config.terms if config.prior is None else 0
                dof = float(max(len(readings) - count_unknowns(readings, terms), 1))
            return replace(config, learned=learned, sigma=sigma, sigma_dof=dof)
        if config.noise.range_sigma is not None:
            return config
        found = self.solution
        dof = float(max(found.dof, 1))
        sigma = config.sigma * float(np.sqrt(found.chi2 / dof))
        return replace(config, sigma=sigma, sigma_dof=dof)

    def compared_if_due(self) -> tuple["SessionState", Comparison | None]:
        """Compare with the batch solution where that is due; return what follows from it."""
        due = max(LEAST_CHANGES, len(self.contents.inside) // 4)
        far = self.state.apart(self.compared.beams, self.compared.sigmas())[0] > FAR_SIGMAS
        if self.changes < due and not far:
            return self, None
        new, config = self, self.learned()
        changes = config.changes(self.config)
        if changes:
            new = self._begun_with(self.contents, config, self.state.beams)
            excluded = tuple(new.contents.excluded)
            if excluded:  # they may fit beside the new scales
                new, _, _ = new.changed(new.contents.included(), excluded)
        judged = new.rejudged()
        if judged is not new:
            new, changes = judged, changes | {"outliers": OUTLIERS_AGAIN}
        comparison = new.compare()
        if max(comparison.largest, comparison.largest_sigma) > SAME_OPTIMUM:
            changes |= {"from-batch": "restarted from the batch solution, which it had left"}
            beams = new.solution.parameters.beams
            new = self._begun_with(new.contents, new.config, beams)
        planes = len(new.contents.inside)
        config = replace(new.config, shared=new.calibration().shared)
        new = replace(new, config=config, compared=new.state, changes=0, learned_with=planes)
        return new, replace(comparison, changes=changes)

    def rejudged(self) -> "SessionState":
        """Return the state with readings judged by the present beams; itself where that changes none.

        A plane that came early was judged by beams that were hardly known.
        """
        if not self.config.reject:
            return self
        contents, names = self.contents, []
        for name, own in self.contents.inside.items():
            kept = tuple(one for one in own.rejected if one.reason != CONTRADICTED)
            bad = None if own.fitted is None else own.fitted.outliers(own.used(), self.state)
            if len(kept) < len(own.rejected) or (bad is not None and bad.any()):
                names.append(name)
                contents = contents.with_planes({name: replace(own, rejected=kept)})
        if not names:
            return self
        again, _, misfits = self.joined(contents, tuple(names))
        if misfits or set(again.rejected) == set(self.contents.rejected):
            return self
        return self.changed(contents, tuple(names))[0]

    def rather_gross(self, moved: BeamDrift) -> "SessionState":
        """Return the state from a calibration of everything where no beam moved; itself otherwise.

        Gross errors among the first planes lead to wrong beams, by which other readings are judged, and
        beside which a good beam seems to move. So everything is calibrated without a move, and with the
        one that was found, both with all readings judged again: that with the less unlikely residuals,
        gross errors and move is believed. A move that cannot be calibrated yet stands.
        """
        batch, config = self.calibrated()
        rejected = {(one.station, one.sensor) for one in self.contents.rejected}
        same = rejected == {(one.station, one.sensor) for one in batch.fit.rejected}
        if same or batch.status != "converged":
            return self
        with suppress(InputError):
            recording = self.contents.split(moved.name, moved.since).recording()
            split = calibrate_from(None, recording, config.known, config.options)
            distance = recording.ranges[~np.isnan(recording.ranges)]
            without, beside = (
                one.fit.chi2 + price_of_gross(one.fit.outliers, distance, config.sigma)
                for one in (batch, split)
            )
            beside += price_of_move(len(distance), len(config.names))
            if split.status != "unobservable" and without < beside:
                return SessionState.of(batch, self.contents, config.noise, config.options)
        return self

    def calibrated(self) -> tuple[Calibration, SessionConfig]:
        """Return the batch calibration of everything, and what all planes have in common after it."""
        noise, options = self.config.noise, self.config.options
        batch = calibrate_from(None, self.contents.recording(), noise, options)
        if batch.interrupted:
            raise KeyboardInterrupt
        return batch, SessionConfig.of(batch, noise, options)

    def recalibrated(self) -> tuple["SessionState", Comparison]:
        """Calibrate everything, compare, and take over scales and outliers that differ."""
        batch, config = self.calibrated()
        if batch.status != "converged":
            words = f"everything together does not converge: {batch.message}"
            return self, replace(self.compare(), changes={"not-converged": words})
        changes = config.changes(self.config)
        contents = self.contents.restarted(batch.fit.rejected)
        out = [{(r.station, r.sensor) for r in each.rejected} for each in (contents, self.contents)]
        if out[0] != out[1]:
            changes |= {"outliers": OUTLIERS_AGAIN}
        if self.contents.excluded:
            changes |= {"excluded-planes": "planes that did not fit taken in again"}
        new = self
        if changes:  # from the estimate so far, not from what it is to be compared with
            order = [self.config.names.index(name) for name in batch.beams]
            r, v, k = (array[order] for array in self.state.beams)
            new = begun_or_refused(contents, config, (r, v, k))
        shared = config.shared
        if shared is not None:
            shared = shared.arranged([config.names.index(name) for name in new.config.names])
        config = replace(new.config, shared=shared)
        new = replace(new, config=config, learned_with=len(new.contents.inside))
        return new, Comparison(*config.apart(new.with_shared, batch), changes)

    def moved(self, *, recently: bool = False) -> BeamDrift | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        planes = self.contents.consistent
        moved = search(self.config, planes, recently=recently)
        # A beam without which planes that were excluded would fit has moved far, and so has one that
        # lost nearly all its readings.
        excluded = self.contents.excluded.items()
        plane, beam = next((far for far in excluded if far[1]), self.contents.lost)
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
            As `joined` has them.

        Raises
        ------
        InputError
            The beams would not be determined.
        """
        config, before = self.config, self.contents.numbers
        contents, joined, inconsistent = self.joined(contents, planes)
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
                new = replace(new, graph=graph, state=state)
                if not is_near(config, new.at, state.beams):  # weights and information there
                    new = new.begun(state.beams)
            except RuntimeError:  # iSAM2 takes undamped steps: the batch solver does not
                new = new.solved_at_once()
        fewer = gone or contents.readings < self.contents.readings
        if fewer and not new.solution.observability.full:
            raise undetermined()
        return new, joined, inconsistent

    def joined(
        self, contents: Contents, names: tuple[str, ...]
    ) -> tuple[Contents, tuple[str, ...], tuple[str, ...]]:
        """Join planes to the beams as they are, or take out those that are not determined.

        Parameters
        ----------
        contents : Contents
            With the changes of these planes in them.
        names : tuple of str

        Returns
        -------
        Contents
            With outliers rejected, and planes that are not determined out of the graph.
        joined : tuple of str
            Planes that joined.
        inconsistent : tuple of str
            Planes that do not fit, whichever beam has moved a little. They are excluded, or join all
            the same where nothing is to be rejected.
        """
        config, state, joined, inconsistent = self.config, self.state, list[str](), list[str]()
        for name in names:
            if name not in contents.planes:
                continue
            own = contents.planes[name]
            origin = None if own.fitted is None else own.fitted.origin
            fitted = fit_plane(config, own.used(), self.at, origin)
            if fitted is None:
                contents = contents.with_planes({name: own.taken_out()})
                continue
            flat = ~within_incidence(fitted.readings, fitted.parameters, config.options.sensor)
            # A plane that all of its readings meet so flat keeps them.
            bad = fitted.mask(own.used(), flat & ~flat.all())
            own, fitted = _less(own, fitted, bad, FLAT) or (own, fitted)
            if config.reject:
                # Unless a beam that has moved explains them, readings that contradict others are out.
                less = _less(own, fitted, fitted.outliers(own.used(), state), CONTRADICTED)
                if less is not None and not _rather_moved(contents, name, fitted, less[1], state):
                    own, fitted = less
            if not fitted.fits:
                inconsistent.append(name)
                if config.reject:
                    culprit = fitted.culprit(own.used(), state)
                    contents = contents.with_planes({name: own.taken_out(culprit)})
                    continue
            free = max(contents.numbers.values(), default=-1) + 1
            number = free if own.number is None else own.number
            own = replace(own, number=number, fitted=fitted, culprit=None)
            contents = contents.with_planes({name: own})
            joined.append(name)
        return contents, tuple(joined), tuple(inconsistent)

    def begun(self, beams: Beams) -> "SessionState":
        """Return the same from a new graph, which begins with some beams."""
        new = begin(self.contents, self.config, beams)
        return replace(
            new, compared=self.compared, learned_with=self.learned_with, changes=self.changes
        )

    def solved_at_once(self) -> "SessionState":
        """Return the same from a batch solution of the contents, beside the present beams.

        Where that leads nowhere at the present scales, which earlier planes gave, everything is
        calibrated again.

        Raises
        ------
        InputError
            The beams are not determined, or the estimate does not settle.
        """
        config, beams = self.config, self.state.beams
        try:
            new = replace(self, contents=fitted_planes(self.contents, config, beams))
            fitted = new.contents.fitted.values()
            if not fitted:
                raise RuntimeError("no plane is left")
            normals = np.concatenate([plane.parameters.normals for plane in fitted])
            offsets = np.concatenate([plane.parameters.offsets for plane in fitted])
            start = Parameters(*beams, normals, offsets)
            found = solved(config, new.problem.chosen(new.used()), start)
            begun = self.begun(found.parameters.beams)
            if not config.determines(begun.state):
                raise RuntimeError("too few planes are left")
        except (RuntimeError, HandlaserError) as error:
            return self._begun_from_batch(error)
        return begun

    def _begun_with(
        self, contents: Contents, config: SessionConfig, beams: Beams
    ) -> "SessionState":
        """Return a state as `begin` does, or from the calibration of everything.

        Raises
        ------
        InputError
            The beams are not determined, or the estimate does not settle.
        """
        try:
            return begin(contents, config, beams)
        except RuntimeError as error:  # iSAM2 takes undamped steps: the batch solver does not
            return replace(self, contents=contents)._begun_from_batch(error)

    def _begun_from_batch(self, why: Exception) -> "SessionState":
        """Return the same from the calibration of everything, with scales that are learned again.

        Raises
        ------
        InputError
            The beams are not determined, which `why` says, or the estimate does not settle.
        """
        try:
            batch, config = self.calibrated()
        except InputError as error:
            raise undetermined(f" ({why})") from error
        if batch.status == "unobservable":
            raise undetermined(f" ({why})") from why
        if batch.status != "converged":
            found = f"a change after which everything together does not converge ({batch.message})"
            raise InputError(found, "planes that agree") from why
        contents = self.contents.restarted(batch.fit.rejected)
        try:
            return begin(contents, config, batch.parameters().beams)
        except RuntimeError as error:
            found = f"a change after which a session does not arrive ({error})"
            remedy = "planes that agree; calibrate everything at once to see which do not"
            raise InputError(found, remedy) from error


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


def begun_or_refused(contents: Contents, config: SessionConfig, beams: Beams) -> SessionState:
    """Do as `begin`, and refuse what does not settle.

    Raises
    ------
    InputError
        The undamped steps of iSAM2 lead nowhere: the readings hardly determine the beams.
    """
    try:
        return begin(contents, config, beams)
    except RuntimeError as error:
        raise undetermined(f" ({error})") from error


def solved(config: SessionConfig, readings: Readings, start: Parameters) -> Solution:
    """Return the batch solution of readings at the scales of a config, which are integrated over."""
    learned, options = config.learned, config.options
    if config.prior is None and options.range_error == "auto":
        options = replace(options, range_error="k1k2")
    found = settle(readings, start, config.known, options, prior=config.prior).finished()
    if learned is None or not found.observability.full:
        return found
    integrated = posterior(scale_problem(config, learned, readings, found.parameters), learned)
    return replace(found, posterior=integrated, scales=integrated.scales)


def scale_problem(
    config: SessionConfig, learned: LearnedScales, readings: Readings, at: Parameters
) -> ScaleProblem:
    """Return the scales that are learned as a problem about some parameters."""
    stations = int(readings.station.max()) + 1
    readings, _ = weighed(readings, at, config.variances.for_stations(stations), config.terms)
    base, scales = learned.base.for_stations(stations), learned.scales
    of = at, readings, config.terms, base, scales, learned.linearity
    return ScaleProblem(*of, length=learned.length)


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


def fitted_planes(contents: Contents, config: SessionConfig, at: Beams) -> Contents:
    """Return the contents with every plane in that `at` determines and that is not excluded."""
    number, planes = 0, {}
    for name, plane in contents.planes.items():
        fitted = None
        if plane.culprit is None:
            fitted = fit_plane(config, plane.used(), at)
        planes[name] = replace(plane, number=None if fitted is None else number, fitted=fitted)
        number += fitted is not None
    return contents.with_planes(planes)


def _less(
    own: PlaneContents, fitted: FittedPlane, bad: BoolArray | None, reason: str
) -> tuple[PlaneContents, FittedPlane] | None:
    """Return contents and plane with readings (M, B) rejected; None for none, or too few left."""
    if bad is None or not bad.any():
        return None
    less = own.less(bad, reason)
    again = fit_plane(fitted.config, less.used(), fitted.parameters.beams, fitted.origin)
    return None if again is None else (less, again)


def _rather_moved(
    contents: Contents, name: str, fitted: FittedPlane, again: FittedPlane, state: BeamState
) -> bool:
    """Tell whether a beam has moved rather than that the rejected readings are gross errors.

    The explanation with the larger fall of chi2 beyond its price is believed.
    """
    own = replace(contents.planes[name], fitted=fitted)
    planes = contents.with_planes({name: own}).fitted
    planes = {plane: one for plane, one in planes.items() if one.fits or plane == name}
    moved = search(fitted.config, planes, recently=True)
    if moved is None:
        return False
    d, sigma = fitted.readings.distance, fitted.whitening.sigma
    gone = len(d) - len(again.readings.distance)
    of_beam = fitted.readings.beam == fitted.config.names.index(moved.name)
    if (
        gone == of_beam.sum()
        and not np.isin(again.readings.beam, fitted.readings.beam[of_beam]).any()
    ):
        return True  # of a far move the fall of chi2 is known to a part of itself only
    gross = fitted.misfit(state) - again.misfit(state)
    gross -= price_of_gross(gone, d, sigma)
    move = moved.statistic - price_of_move(len(d), len(fitted.config.names))
    return bool(move > gross)


def price_of_gross(count: int, distance: FloatArray, range_sigma: float) -> float:
    """Return by how much chi2 has to fall for some gross errors among readings (N,) [m].

    One that is anything within the span W of the readings costs 2 ln(W / (sqrt(2 pi) sigma)), and twice
    the logarithm of how rare it is.
    """
    return 2.0 * count * (max(price(distance, range_sigma), 0.0) - float(np.log(GROSS_ERROR)))


def price_of_move(readings: int, beams: int) -> float:
    """Return by how much chi2 has to fall for a beam that has moved.

    By ln N for each of its unknowns, and twice the logarithm of how rare it is.
    """
    return float(MOUNT_DIM * np.log(readings) + 2.0 * np.log(beams / DISPLACED))
