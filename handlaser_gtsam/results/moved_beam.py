r"""A beam, or the tool with all beams, that was moved amid a recording, from some station on.

With e the residuals and A the derivatives by the mount of a beam in the rows from that station on, both
without what all other unknowns explain and weighed by the noise, a move makes chi2 fall by

    e'A (A'A)^+ A'e,    F = (fall / q) / ((chi2 - fall) / (dof - q)),

with q the rank of A'A. A plate that was moved and a tool frame that changed are compared by the same
test, and so are systematic errors that were found: a beam has moved only if it explains more, by
Schwarz's criterion (Annals of Statistics 6(2), 1978). Readings that were rejected count again, because
readings before a large move do not fit the readings after it; as gross errors, an unknown each, they
are a rival by the same criterion, and so are the largest residuals of a tenth of the readings. Where
what a move leaves is correlated in time, N readings tell what N / g independent ones do, with g the
growth of the variance of a mean: what varies slowly looks like a step, too.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray, evenly
from ..errors import CalibrationWarning, GrazingBeamError
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.damped_search import LevenbergOptions, search
from ..model.distributions import SINGLE_LEVEL, chi2_sf, f_sf, p_words
from ..model.effects.displaced import LEAST_STATIONS, MOST_SPLITS
from ..model.families import BEAM, MOUNT_DIM, OF_DIRECTION
from ..model.joint import beam_lifts
from ..model.weighting import Variances, whitening
from ..quantities import MANY_OUTLIERS, MOST_ROUNDS, NEGLIGIBLE, NUMBERS_AT_ONCE, TEN_TIMES, TINY
from ..solvers.beam_problem import beam_problem
from .calibration_data import Beam, Fit
from .dependence import dependence
from .messages import warned
from .problem import Problem
from .projection import LinearRows, Projection
from .spots import radius, spot_of
from .systematic import SystematicError
from .warnings import DISPLACED

PLATE, TOOL = -1, -2
"""In place of the number of a beam."""
ROUGH = 3.0
"""Noise learned as more than this many times what is usual may stand for a tool that was moved."""


class Suspect(NamedTuple):
    """Rows whose derivatives by some unknowns count from a station on.

    Attributes
    ----------
    beam : int
        Which beam would have moved; `PLATE` of a plate, `TOOL` of the tool frame.
    rows : (n,)
        Of the readings that it concerns.
    J : (n, c)
        Derivatives.
    """

    beam: int
    rows: IntArray
    J: FloatArray


class Move(NamedTuple):
    """What a suspect explains if it moved at its best station.

    Attributes
    ----------
    one : Suspect
    position : int
        Of the first station after the move, in the recording.
    size : (c,)
    rank : int
        How many coordinates of the move the readings tell.
    share, left : float
        Part of the squares of the residuals that it explains, and what of them remains [m^2].
    columns : (N, c)
        Derivatives of all residuals by the move.
    dof : float
        Degrees of freedom of the residuals without the move.
    tests : int
        How many stations were tried, of everything that may have moved.
    """

    one: Suspect
    position: int
    size: FloatArray
    rank: int
    share: float
    left: float
    columns: FloatArray
    dof: float = 0.0
    tests: int = 0

    @property
    def p_value(self) -> float:
        """Of the F test, without a correction for how many were looked for."""
        rank, rest = max(self.rank, 1), max(self.dof - self.rank, 1.0)
        return float(f_sf(self.share / rank / max(1.0 - self.share, NEGLIGIBLE) * rest, rank, rest))

    @property
    def criterion(self) -> float:
        """Schwarz's, beside no move: the lowest explains best."""
        return _criterion(self.share, self.dof, self.rank)

    @property
    def clear(self) -> bool:
        """Whether it is no chance of one among the stations, beams and plates that were looked at."""
        return self.p_value * self.tests < SINGLE_LEVEL


def moved_beam(
    rows: LinearRows,
    problem: Problem,
    selection: Selection,
    fit: Fit,
    found: Sequence[SystematicError],
    beams: Mapping[str, Beam],
) -> CalibrationWarning | None:
    """Warn of the beam, or the tool, that was moved amid the recording; None where none clearly was.

    Parameters
    ----------
    rows : LinearRows
        Of the readings that were used, at the solution.
    problem : Problem
    selection : Selection
    fit : Fit
    found : SystematicErrors
        That were tested on the same rows.
    beams : mapping of str to Beam
    """
    move, out = None, selection.outliers()
    rough = any(one.sigma > ROUGH * one.usual for one in selection.solution.scales)
    rough = rough or int(out.sum()) > MANY_OUTLIERS * (fit.readings + fit.outliers)
    if out.any() and not rows.freed.codes:
        with suppress(GrazingBeamError):
            readings = problem.chosen(selection.used | out)
            how = whitening(rows.at, readings, _variances(selection.solution, readings.beams))
            position = problem.order.stations[readings.station]
            every = LinearRows(rows.at, readings, how, rows.prior, position, rows.channel)
            move = _likely_move(every, fit.dof + int(out.sum()), fit.range_sigma_given, rough)
            if move is not None and _rather_gross(move, every, selection):
                move = None
    if move is None:
        move = _likely_move(rows, fit.dof, fit.range_sigma_given, rough)
        clearest = max(((one.size / one.sigma) ** 2 for one in found if one.found), default=0.0)
        if move is not None and move.criterion > _criterion(
            clearest / (clearest + max(fit.dof - 1, 1)), fit.dof, 1
        ):
            move = None
    if move is not None and move.one.beam == TOOL:
        return _moved_tool(move, rows, problem, fit, beams)
    if move is None or move.one.beam == PLATE:
        return None
    beam = beams[problem.names.sorted_beams()[move.one.beam]]
    if beam.covariance is None:
        return None
    _, J = spot_of(beam.coordinates, fit.median_reading)
    lifts = beam_lifts(model.tangent_basis(rows.at.directions))
    d = lifts[move.one.beam][:, :MOUNT_DIM] @ move.size
    shift = float(np.linalg.norm(J @ d))
    values: dict[str, float | str] = {
        "target": f"beam {beam.name}",
        "station": problem.recording.station_names[move.position],
        "shift": shift,
        "turn_deg": float(np.degrees(np.linalg.norm(d[OF_DIRECTION]))),
        "p": move.p_value,
        "times": shift / radius(J @ beam.covariance @ J.T),
    }
    return warned(f"{DISPLACED}:beam", values, likely=p_words(move.p_value, 1))


def _moved_tool(
    move: Move, rows: LinearRows, problem: Problem, fit: Fit, beams: Mapping[str, Beam]
) -> CalibrationWarning | None:
    """Warn of a tool that moved a spot by far more than errors of the hand do; None of less.

    Errors of an arm that change with its pose are others before each plate, too.
    """
    turn, shift = move.size[:3], move.size[3:]
    noise, (of_shift, of_turn) = problem.noise, problem.noise.standstill
    of_shift, of_turn = (
        max(of_shift, noise.pose_translation_prior),
        max(of_turn, noise.pose_rotation_prior),
    )
    spots = rows.at.locations + fit.median_reading * rows.at.directions
    shifts = np.linalg.norm(shift + np.cross(turn, spots), axis=1)
    by_hand = np.hypot(of_shift, of_turn * np.linalg.norm(spots, axis=1))
    times = []
    for name, moved in zip(problem.names.sorted_beams(), shifts.tolist(), strict=True):
        covariance = beams[name].covariance
        if covariance is not None:
            _, J = spot_of(beams[name].coordinates, fit.median_reading)
            times.append(moved / radius(J @ covariance @ J.T))
    if not times or (shifts <= TEN_TIMES * by_hand).all():
        return None
    values: dict[str, float | str] = {
        "target": "the tool",
        "station": problem.recording.station_names[move.position],
        "shift": float(shifts.max()),
        "turn_deg": float(np.degrees(np.linalg.norm(turn))),
        "p": move.p_value,
        "times": max(times),
    }
    return warned(f"{DISPLACED}:tool", values, likely=p_words(move.p_value, 1))


def _variances(solution: Solution, beams: int) -> Variances:
    """Return the variances of the readings at a solution, also where all are equal."""
    return solution.variances or Variances(np.full(beams, solution.at.sigma))


def _rather_gross(move: Move, every: LinearRows, selection: Selection) -> bool:
    """Tell whether gross errors, each an unknown, explain what was rejected better than a move.

    A move in place of rejections has to explain what the other readings leave, and all that were
    rejected. Derivatives leave some of a large move of a beam: there the beam before and after it are
    two, which are fitted with all other unknowns (near the end of a recording five unknowns follow a
    gross reading nearly as well).
    """
    solution, rejected = selection.solution, int(selection.outliers().sum())
    total = move.left / (1.0 - move.share) / every.how.sigma**2
    left = move.left / every.how.sigma**2
    # A large move spoils more readings than it has unknowns.
    if move.one.beam >= 0 and rejected > move.rank:
        left = min(left, _apart(move, every, solution))
    gross = _criterion(1.0 - solution.chi2 / total, move.dof, rejected)
    return gross < _criterion(1.0 - left / total, move.dof, move.rank)


def _apart(move: Move, every: LinearRows, solution: Solution) -> float:
    """Return the chi2 of all readings where the beam that moved is another one afterwards.

    Both have range errors of their own, with the same prior. A move is found in a few steps; gross
    errors would be followed for hundreds.
    """
    readings, beams = every.readings, every.readings.beams
    late = (readings.beam == move.one.beam) & (every.position >= move.position)
    beam = np.where(late, beams, readings.beam)
    rows = np.argsort(beam, kind="stable")
    split = replace(readings.subset(rows), beam=beam[rows], beams=beams + 1)
    of = np.append(np.arange(beams), move.one.beam)
    at = every.at.part(of, np.arange(readings.planes))
    variances, prior = _variances(solution, beams), solution.prior
    variances = replace(variances, range_sigma=variances.range_sigma[of])
    prior = None if prior is None else prior.part(of)
    how = whitening(at, split, variances)
    problem, block = beam_problem([split], solution.terms, [how], prior=prior)
    solver = LevenbergOptions(max_iterations=MOST_ROUNDS)
    return 2.0 * float(search(problem, block.begun([at]), solver).cost[0])


def _likely_move(rows: LinearRows, dof: int, known: bool, rough: bool) -> Move | None:
    """Return the move that explains most of the residuals; None where a beam hardly has moved.

    `known` tells whether the size of the noise was given, `rough` whether it was learned as far larger
    than is usual, or many readings were rejected: then a tool is looked for from every station on.
    """
    heavy = rows.how.weighed(rows.residual[:, None])[:, 0]
    weight, total = rows.how.squares(), float(rows.residual @ heavy)
    if dof <= BEAM.dim or not total > 0.0:
        return None
    everything, beams = np.arange(len(rows.readings)), rows.readings.beams
    own = [np.flatnonzero(rows.readings.beam == beam) for beam in range(beams)]
    suspects = [Suspect(beam, at, rows.J[at, :MOUNT_DIM]) for beam, at in enumerate(own)]
    alone = partial(_falls_alone, rows, heavy, weight)
    tool = Suspect(TOOL, everything, rows.linear.pose)
    falls = list(map(alone, suspects))
    # Alone it explains no more than with the others: most good recordings, whose best of all tests is
    # what chance makes of their number, end here.
    tests, most = sum(tried for _, _, tried in falls), max(fall for fall, _, _ in falls)
    if not tests:
        return None
    if not rough and chi2_sf(MOUNT_DIM * most * dof / total, MOUNT_DIM) * tests > 1.0:
        return None
    others = [*_planes(rows, everything)]
    if beams > 1:  # of a single beam the tool frame is the same
        others.append(tool)
    suspects, falls = [*suspects, *others], [*falls, *map(alone, others)]
    tests = sum(tried for _, _, tried in falls)
    projection = Projection(rows, rows.prior)
    rest = projection.of_residuals(rows)

    def tried(one: Suspect, split: int) -> Move:
        return _tried(one, split, rows, projection, rest)._replace(dof=float(dof), tests=tests)

    # The others explain less even without other unknowns.
    first = sorted(range(len(falls)), key=lambda number: -falls[number][0])[:4]
    moves = [tried(suspects[i], falls[i][1]) for i in first if falls[i][2]]
    # Planes follow a tool that was moved: it shows beside them, and from the right station on only.
    splits = _splits(rows.position, tool)
    if rough and beams > 1 and len(splits):
        splits = splits[evenly(len(splits), max(NUMBERS_AT_ONCE // tool.J.size, MOST_SPLITS))]
        tests += len(splits)
        moves.append(max((tried(tool, i) for i in splits.tolist()), key=lambda move: move.share))
    if not min(moves, key=lambda move: move.criterion).clear:
        return None
    moves = [_narrowed(move, rows, tried) for move in moves]
    best = min(moves, key=lambda move: move.criterion)
    # Or the beam reads something else than one of the planes, wherever and whenever it is measured.
    mine = np.flatnonzero(rows.readings.beam == best.one.beam)
    moves = [best, *(tried(one, 0) for one in _planes(rows, mine))]
    best = min(moves, key=lambda move: move.criterion)
    together = dependence(rows, projection, known=known, found=best.columns)
    best = best._replace(dof=dof / together.plane_growth**2)
    # Or gross errors of a few readings, each an unknown; more of them would follow a move, too.
    shares = np.sort(rest[0] ** 2 / weight / rest[1])[::-1][: int(MANY_OUTLIERS * best.dof)]
    few = any(
        _criterion(share, best.dof, count) < best.criterion
        for count, share in enumerate(shares.cumsum().tolist(), 1)
    )
    return best if best.clear and not few else None


def _planes(rows: LinearRows, own: IntArray) -> Iterator[Suspect]:
    """Yield the planes of some readings, as if these alone saw another one there."""
    for plane in np.unique(rows.readings.plane[own]).tolist():
        there = own[rows.readings.plane[own] == plane]
        yield Suspect(PLATE, there, rows.J[there, BEAM.dim :])


def _splits(position: IntArray, one: Suspect) -> IntArray:
    """Return the positions of stations from which on a suspect may have moved.

    Few stations more than coordinates on a side would follow any errors of their readings.
    """
    times, least = np.unique(position), one.J.shape[1] + LEAST_STATIONS
    return times[least : len(times) - least + 1]


def _narrowed(move: Move, rows: LinearRows, tried: Callable[[Suspect, int], Move]) -> Move:
    """Return a move from the station on from which it explains most, near the one that was tried.

    Readings between the two are no part of the move, and would look like noise that varies slowly.
    """
    near = _splits(rows.position[move.one.rows], move.one)
    some = evenly(len(near), MOST_SPLITS)
    best = int(np.searchsorted(near[some], move.position))
    while len(some) < len(near):
        near = near[some[max(best - 1, 0)] : some[min(best + 1, len(some) - 1)] + 1]
        some = evenly(len(near), MOST_SPLITS)
        moves = [tried(move.one, split) for split in near[some].tolist()]
        best = int(np.argmax([one.share for one in moves]))
        move = moves[best]
    return move


def _falls_alone(
    rows: LinearRows, heavy: FloatArray, weight: FloatArray, one: Suspect
) -> tuple[float, int, int]:
    """Return where most would be explained with no other unknown than the suspect's own.

    By how much chi2 falls an unknown, from which station on, and how many stations were tried. Rows
    from a split on count as a sum; the sums of all splits are running totals.
    """
    position = rows.position[one.rows]
    order = np.argsort(position, kind="stable")
    splits = _splits(position, one)
    splits = splits[evenly(len(splits), MOST_SPLITS)]
    if not splits.size:
        return 0.0, 0, 0
    of, J = one.rows[order], one.J[order]
    J = J / np.maximum(np.sqrt((J**2).sum(axis=0)), TINY)
    first = np.searchsorted(position[order], [position.min(), *splits])
    score = np.add.reduceat(J * heavy[of, None], first)[::-1].cumsum(axis=0)[::-1]
    outer = weight[of, None, None] * J[:, :, None] * J[:, None, :]
    known = np.add.reduceat(outer, first)[::-1].cumsum(axis=0)[::-1]
    late = known[1:]
    share = late @ np.linalg.pinv(known[0], rcond=NEGLIGIBLE, hermitian=True)
    score = score[1:] - share @ score[0]
    inverse = np.linalg.pinv(late - share @ late, rcond=NEGLIGIBLE, hermitian=True)
    falls = np.einsum("ki,kij,kj->k", score, inverse, score) / J.shape[1]
    best = int(falls.argmax())
    return float(falls[best]), int(splits[best]), len(splits)


def _tried(
    one: Suspect,
    split: int,
    rows: LinearRows,
    projection: Projection,
    rest: tuple[FloatArray, float],
) -> Move:
    """Return what a move explains beside all unknowns.

    `rest` are the weighed residuals without what these explain, and their square.
    """
    heavy, total = rest
    columns = np.zeros((len(rows.readings), one.J.shape[1]))
    columns[one.rows] = one.J * (rows.position[one.rows] >= split)[:, None]
    unit = np.maximum(np.sqrt((columns**2).sum(axis=0)), TINY)
    columns /= unit
    weighed = projection.perpendicular(columns)[0]
    # Products with the columns themselves count what the priors bear of them, too.
    values, axes = np.linalg.eigh(columns.T @ weighed)
    kept = values > NEGLIGIBLE  # columns of length 1: the unknowns explain the rest
    along = (columns.T @ heavy) @ axes
    size = -(axes[:, kept] @ (along[kept] / values[kept])) / unit
    fall = float((along[kept] ** 2 / values[kept]).sum())
    rank, by = int(kept.sum()), columns @ axes[:, kept]
    return Move(one, split, size, rank, fall / total, total - fall, by)


def _criterion(share: float, dof: float, unknowns: int) -> float:
    """Return Schwarz's criterion for unknowns that explain a share of chi2, beside none."""
    rest = max(1.0 - share, NEGLIGIBLE)
    return float(dof * np.log(rest) + unknowns * np.log(max(dof, 1.0)))
