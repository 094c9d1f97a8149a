r"""Systematic errors as unknowns: sizes that are estimated beside beams and planes.

A freed error of size a has a Gaussian prior of mean zero and standard deviation p: the plausible size,
a half width, over the root of three, as in limits and plans. Errors of the hand poses move the
recorded poses, R exp(a omega) and t + a R u; all others shorten the readings by a f. A corrected
recording is calibrated as any other: rejected readings, scales of the noise and of range errors belong
to it. With its residuals e of noise sigma, their derivatives A by the sizes, and what the other
unknowns leave of A (`projection`), the sizes are estimated by steps

    a <- a - inv(I) (A_perp' e / sigma^2 + a / p^2),    I = A_perp' A_perp / sigma^2 + 1 / p^2.

Both are repeated until the sizes stay (variable projection: Kaufman, BIT 1975). The covariance of the
sizes is inv(I). Beams and planes have C + M inv(I) M', where C is their covariance for known sizes, and
M = -inv(J' J) J' A is how they follow the sizes.

Where f depends on beams and planes, as for the incidence, it is taken at the solution, and its own
derivatives are neglected: they are a part a / range of the others. For an incidence error of 1 mm at
350 mm this moved beams by 0.02 standard deviations, and changed standard deviations by 2 %.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray, frozen
from ..data.noise import LEAST_SIGMA, Noise
from ..errors import CalibrationWarning, InputError
from ..estimation.options import CalibrationOptions
from ..estimation.selection import Selection, select
from ..model.effects import EFFECTS
from ..model.effects.effect import OnPlanes, SeenStations
from ..model.effects.plausible import how_to_state
from ..model.equation import residuals_or_infinite
from ..model.families import modelled
from ..model.geometry import skew
from ..model.joint import JointCovariance, plane_steps
from ..model.sensor_limits import Sensor
from ..quantities import MOST_ROUNDS
from ..text import count
from .calibration_data import FreedEffect
from .messages import warned
from .problem import Problem, linear_rows
from .projection import FreedColumns, Moves, Projection
from .systematic import subject_in_words

MOST_FREED = 200
"""Unknown sizes at most: every one has a column of all readings, and all are known together."""

Member = tuple[str, str]
"""Code of an error, and whom or what this unknown of it concerns: the name of its size."""


class Freed(NamedTuple):
    """The freed errors at a solution, in units of their priors' sigmas.

    Attributes
    ----------
    columns : FreedColumns
        At the readings that were used.
    subjects : tuple of str
        Whom or what each concerns; empty for everything.
    prior : (q,)
        Sigmas of the priors [m, or a part].
    covariance : (q, q)
        Of the sizes.
    moves : Moves
        How beams and planes follow the sizes; in the order of the readings.
    settled : bool
        Whether the sizes came to rest.
    """

    columns: FreedColumns
    subjects: tuple[str, ...]
    prior: FloatArray
    covariance: FloatArray
    moves: Moves
    settled: bool

    @property
    def rank(self) -> int:
        """How many sizes the readings determine: the trace of their resolution matrix."""
        return round(len(self.covariance) - float(np.trace(self.covariance)))

    def grown(self, joint: JointCovariance) -> JointCovariance:
        """Return a covariance for known sizes with what these add, in the order of the readings."""
        beams, planes = self.moves
        return joint.following(beams[modelled(joint.terms)], planes, self.covariance)

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (q,) of the sizes."""
        return np.asarray(self.prior * np.sqrt(np.diagonal(self.covariance)))

    def less_certain(self, more: FloatArray) -> "Freed":
        """Return the same with `more` covariance (q, q) of the sizes; none where it is empty."""
        return self._replace(covariance=self.covariance + more) if more.size else self

    def reports(
        self, problem: Problem, joint: JointCovariance, growth: float
    ) -> tuple[FreedEffect, ...]:
        """Return the sizes with their standard deviations, `growth` times as large.

        `joint` is the covariance of beams and planes that they have grown, with names.
        """
        covariance = growth**2 * self.prior[:, None] * self.covariance
        i, p = (
            [index for _, index in part] for part in (problem.names.beams, problem.names.planes)
        )
        planes, centres = self.moves.planes[p], joint.origins - problem.origins[p]
        follow = plane_steps(joint.plane_bases, centres, planes).reshape(-1, len(covariance))
        follow = np.concatenate((self.moves.beams[i][modelled(joint.terms)], follow))
        # A size is determined where the readings lower the variance of its prior to below this part:
        # then they say more of it than the prior.
        determined = np.diagonal(self.covariance) < 0.5
        known = (covariance * self.prior, covariance @ follow.T, determined)
        sigma = np.sqrt(np.diagonal(known[0]))
        parts = (self.prior * self.columns.size, sigma, self.prior, *known)
        rows = zip(self.columns.codes, self.subjects, *parts, strict=True)
        return tuple(
            FreedEffect(
                code=code,
                subject=subject,
                unit=EFFECTS[code].unit,
                size=float(size),
                sigma=float(sigma),
                prior_sigma=float(prior),
                determined=bool(determined),
                of_effects=frozen(of_effects),
                of_mounts=frozen(of_mounts),
            )
            for code, subject, size, sigma, prior, of_effects, of_mounts, determined in rows
        )

    def warnings(self, effects: tuple[FreedEffect, ...]) -> tuple[CalibrationWarning, ...]:
        """Return what there is to warn of: sizes that are undetermined, or did not come to rest."""
        undetermined = [effect for effect in effects if not effect.determined]
        found = []
        for code in dict.fromkeys(effect.code for effect in undetermined):
            first, *others = [effect for effect in undetermined if effect.code == code]
            words = first.words + (
                f"; and {count(len(others), 'more size')} of it" if others else ""
            )
            found.append(CalibrationWarning("effect-undetermined", words, {"code": code}))
        if not self.settled:
            found.append(warned("effects-unsettled"))
        return tuple(found)


def prior_sizes(free: tuple[str, ...], sensor: Sensor, largest: float) -> dict[str, float]:
    """Return the sigma of the prior [m, or a part] of each freed error, from its plausible size.

    That is a half width; a uniform error has a third of its square as its variance. What is plausible
    of cells does not depend on the kind of the sensor, which need not be stated then.

    Raises
    ------
    InputError
        An error of which no plausible size is known, or of which none above zero is plausible.
    """
    plausible, sizes = sensor.plausible_sizes(largest), {}
    for code in free:
        size = plausible.get(code, EFFECTS[code].of_cell)
        if not size:
            known = "no plausible size" if size is None else "a plausible size of zero"
            found = f"free {code}, of which there is {known}"
            raise InputError(found, f"in the rig file, {how_to_state(code)}")
        sizes[code] = size / math.sqrt(3.0)
    return sizes


def with_freed(
    problem: Problem, selection: Selection, noise: Noise, options: CalibrationOptions
) -> tuple[Problem, Selection, Freed | None]:
    """Return the corrected problem, its solution, and the freed errors of the options.

    They are as given, without freed errors, where the solution has no minimum at which everything else
    is determined.

    Parameters
    ----------
    problem : Problem
        As it was recorded.
    selection : Selection
        Its solution, as if there were no such errors.
    noise : Noise
        In the order of the readings.
    options : CalibrationOptions

    Raises
    ------
    InputError
        More unknown sizes than `MOST_FREED`, or none at all.
    """
    largest = float(problem.readings.distance[selection.used].max())
    prior = prior_sizes(options.free, options.sensor, largest)
    recorded = problem
    size: dict[Member, float] = {}
    rank = 0
    for _ in range(MOST_ROUNDS):
        at = selection.solution.at
        if at.status != "converged" or not selection.solution.observability.full:
            return problem, selection, None
        errors = _Errors(recorded, problem, selection, prior, size)
        freed, step = errors.estimated(rank)
        if not np.isfinite(step).all():
            return problem, selection, None
        known, rank = np.sqrt(np.diagonal(freed.covariance)), freed.rank
        # The step is far below what shows in any standard deviation.
        settled = bool((np.abs(step) < 1e-5 * known).all())
        if settled:
            break
        size = dict(zip(errors.members, (freed.columns.size + step).tolist(), strict=True))
        try:
            corrected = errors.corrected(size)
            readings = corrected.readings.seen_from(problem.origins)
            start, used = selection.solution.parameters, selection.used
            again = select(corrected.recording, readings, noise, options, start, used)
        except InputError:  # sizes beyond sense leave readings that no sensor gives
            break
        problem = corrected
        selection = replace(again, method=selection.method, tried=selection.tried)
    return problem._replace(more=freed.rank), selection, freed._replace(settled=settled)


class _Errors:
    """The freed errors at a solution: their columns, and what corrects the readings.

    Parameters
    ----------
    recorded, problem : Problem
        As recorded, and as solved.
    selection : Selection
    prior : mapping
        Sigmas by code.
    size : mapping of Member to float
        At which the problem was solved, in these sigmas; zero where it has none.

    Attributes
    ----------
    members : list of Member
    """

    def __init__(
        self,
        recorded: Problem,
        problem: Problem,
        selection: Selection,
        prior: Mapping[str, float],
        size: Mapping[Member, float],
    ) -> None:
        self.recorded, self.problem, self.selection = recorded, problem, selection
        readings, solution = recorded.readings, selection.solution
        local = problem.readings.seen_from(problem.origins)
        # Rejected readings are corrected, too, so that they can be taken back; but an error
        # that is scaled by the largest reading must not be scaled by a wrong one.
        used = readings.distance[selection.used]
        inside = (readings.distance >= used.min()) & (readings.distance <= used.max())
        possible = np.isfinite(residuals_or_infinite(solution.parameters, local))
        self.rows: IntArray = np.flatnonzero(selection.used | (inside & possible))
        still = readings.subset(self.rows)
        moved = replace(local.subset(self.rows), distance=still.distance)
        position = problem.order.stations[still.station]
        channel = problem.order.beams
        seen = SeenStations(solution.parameters, moved, position, channel)
        every = recorded.recording
        before = SeenStations(solution.parameters, still, position, channel, recorded=every)
        columns, longer, twists, bends = [], [], [], []
        self.members: list[Member] = []
        stations = problem.recording.station_names
        for code, sigma in prior.items():
            effect, numbers = EFFECTS[code], len(before.first[0])
            kind = effect.at(seen)
            if isinstance(kind, OnPlanes):
                of_members = zip(kind.plane, kind.beam, kind.since, strict=True)
                members = [
                    (code, subject_in_words(code, *one, problem.names, stations))
                    for one in of_members
                ]
                own = [kind.column_of(member, seen) for member in range(len(members))]
                column = np.array(own).reshape(len(own), len(self.rows)).T
            else:
                assert kind is not None, f"{code} can show"
                column, members = kind.columns, [(code, part) for part in kind.parts]
            still_hand = np.zeros((numbers, 6, len(members)))
            twist = still_hand if effect.twists is None else sigma * effect.twists(before)
            bend = still_hand if effect.bends is None else sigma**2 * effect.bends(before)
            if effect.twists is not None:
                at = np.array([size.get(member, 0.0) for member in members])
                moving = _carried(twist + 2.0 * bend * at, before, seen)
                by_poses, reading = -seen.by_poses(moving), np.zeros_like(column)
            else:
                by_poses = np.zeros_like(column)
                reading = sigma * column / seen.longer[:, None]
            self.members += members
            columns.append(by_poses)
            longer.append(reading)
            twists.append(twist)
            bends.append(bend)
        if not 0 < len(self.members) <= MOST_FREED:
            codes = ", ".join(prior)
            raise InputError(
                f"{len(self.members)} unknown sizes of {codes}",
                f"1 to {MOST_FREED}: free what the recording has, or less",
            )
        self.prior = np.array([prior[member[0]] for member in self.members])
        self.size = np.array([size.get(member, 0.0) for member in self.members])
        self.by_poses, self.longer = np.hstack(columns), np.hstack(longer)
        self.twists, self.bends = (np.concatenate(parts, axis=2) for parts in (twists, bends))
        self.stations = still.station[before.first[0]]

    def estimated(self, rank: int) -> tuple[Freed, FloatArray]:
        """Return the errors, and the step (q,) to the sizes that the residuals show.

        The readings determined `rank` of the sizes.
        """
        problem = self.problem
        used, at = self.selection.used[self.rows], self.size
        codes, subjects = zip(*self.members, strict=True)
        rows = linear_rows(problem._replace(more=rank), self.selection)
        # The slope of the range error is free of the noise of the readings, as everywhere.
        k = rows.at.range_errors[rows.readings.beam]
        slope = 1.0 + k[:, 0] + 2.0 * k[:, 1] * rows.readings.level
        by_sizes = self.by_poses[used] + slope[:, None] * self.longer[used]
        columns = FreedColumns(codes, by_sizes, at)
        projection = Projection(rows, rows.prior)
        rest, pulled, moved = projection.rest(columns.columns)
        sigma = max(rows.how.sigma, LEAST_SIGMA)
        heavy = rows.how.weighed(rest)
        information = (rest.T @ heavy + pulled.T @ pulled) / sigma**2
        score = heavy.T @ rows.residual + pulled.T @ projection.prior_residuals(rows.at)[:, 0]
        covariance = np.asarray(np.linalg.inv(information + np.eye(len(at))), dtype=np.float64)
        step = -covariance @ (score / sigma**2 + at)
        moves = projection.moves(-moved)
        return Freed(columns, subjects, self.prior, covariance, moves, False), step

    def corrected(self, size: Mapping[Member, float]) -> Problem:
        """Return the recorded problem without errors of these sizes."""
        recorded = self.recorded
        readings, order, recording = recorded.readings, recorded.order, recorded.recording
        at = np.array([size[member] for member in self.members])
        distance = readings.distance.copy()
        distance[self.rows] -= self.longer @ at
        twist = self.twists @ at + self.bends @ at**2
        moved = order.stations[self.stations]
        R, t = recording.world_R_hand.copy(), recording.world_t_hand.copy()
        t[moved] += np.einsum("nij,nj->ni", R[moved], twist[:, 3:])
        R[moved] = R[moved] @ Rotation.from_rotvec(twist[:, :3]).as_matrix()
        station, ranges = order.stations[readings.station], recording.ranges.copy()
        ranges[station, order.beams[readings.beam]] = distance
        corrected = replace(recording, ranges=ranges, world_R_hand=R, world_t_hand=t)
        new = replace(readings, distance=distance, world_R_hand=R[station], world_t_hand=t[station])
        return recorded._replace(recording=corrected, readings=new)


def _carried(twists: FloatArray, before: SeenStations, after: SeenStations) -> FloatArray:
    """Return twists (S, 6, c) from the recorded poses as derivatives at poses moved by such twists.

    The right Jacobian of the turn is taken to second order: turns are some hundredths at most.
    """
    R, moved = (one.readings.world_R_hand[one.first[0]] for one in (before, after))
    turned = np.swapaxes(R, 1, 2) @ moved
    phi = skew(Rotation.from_matrix(turned).as_rotvec())
    jacobian = np.eye(3) - phi / 2.0 + phi @ phi / 6.0
    turns = jacobian @ twists[:, :3]
    return np.concatenate((turns, np.swapaxes(turned, 1, 2) @ twists[:, 3:]), axis=1)
