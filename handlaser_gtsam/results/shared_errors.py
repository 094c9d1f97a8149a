r"""Errors of the hand that stations of one stop share: put into the covariance.

The error of a robot is the same again where its hand has hardly moved: where a programme is run before
one plate after another, or several times before one. The estimate x = K e weighs the readings e as if
each station had an error of its own, and hardly loses by that. But its covariance is K C K', where
stations i and j of one stop have the covariance U_i U_j' of their common error. With b_i = K_b U_i of
the beams, and c_i = K_p U_i of the plane p of station i for known beams, these grow:

    cov(beams)                        by sum b_i b_j',   i and j of one stop, i other than j,
    cov(p, beams), for known beams    by sum c_i b_j',   i before p,
    cov(p, q), for known beams        by sum c_i c_j',   i before p, j before q.

All is counted in units of the covariances for independent errors, because these may be integrated over
scales of the noise. Errors that change with the pose (`errors_by_pose`) are added beside, as columns
that beams and planes follow.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import coo_array, csr_array

from ..arrays import FloatArray, IntArray, renumbered
from ..data.recording import Recording
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import CalibrationWarning
from ..estimation.errors_by_pose import ErrorsByPose, SizesByPose
from ..model.families import BEAM, OF_DIRECTION, PLANE, POSE, modelled
from ..model.joint import JointCovariance, beams_lift
from ..model.weighting import moved_with_poses
from ..quantities import KNOWN, MANY_OUTLIERS, TINY
from .dependence import INDEPENDENT, Dependence
from .messages import warned
from .projection import LinearRows, Moves, Projection

COUPLED_PLANES = 100
"""With more planes their covariance with each other for known beams, which grows with the square of
their number, stays that for independent errors."""
BY_POSE = "errors-by-pose"
"""Code of the warning that errors of the hand change with its pose, or may."""
FLICKER = 3.0
"""Poses that differ by less than this multiple of the errors of the hand are of one stop: an arm errs
alike over centimetres, and recorded poses flicker by less than it errs."""


class SharedErrors(NamedTuple):
    """What beams and planes have in common because stations share errors of the hand.

    In the order of the readings, each in units of its standard deviations for independent errors: along
    the columns of a root of its covariance.

    Attributes
    ----------
    beams : (nb, nb)
        Covariance of the modelled coordinates of all beams, less that for independent errors.
    across : (P, 3, nb)
        Of planes, for known beams, with the beams.
    planes : (P, 3, 3)
        Of each plane, for known beams, less that for independent errors.
    coupling : (P, 3, P, 3) or None
        The same, and of planes with each other; None where there are more than `COUPLED_PLANES`.
    growth : float
        The largest ratio of a standard deviation of a beam to that for independent errors.
    plane_growth : float
        By how much means before a plane are less certain, because its stops are visited again: of all
        stops together, by the typical part of the hand in the errors.
    freed : (q, q) or empty
        By what the covariance of systematic errors that are unknowns is larger, in units of the sigmas
        of their priors.
    moved : (N, 6)
        How residuals follow errors of unit variance of their poses [m].
    station, stop : (N,)
        Where each was read.
    root : (nb, nb)
        These columns of the beams: any multiple of a root of their covariance for independent errors at
        the most probable scales of the noise.
    taken : float
        How many degrees of freedom more the unknowns take of chi2, because they follow errors of stops.
    by_pose : ErrorsByPose or None
        Errors that change with the pose. But for `freed`, all above is without these.
    moves : Moves or None
        How beams and planes follow them, in columns of unit variance.
    """

    beams: FloatArray = np.empty((0, 0))
    across: FloatArray = np.empty((0, 3, 0))
    planes: FloatArray = np.empty((0, 3, 3))
    coupling: FloatArray | None = None
    growth: float = 1.0
    plane_growth: float = 1.0
    freed: FloatArray = np.empty((0, 0))
    moved: FloatArray = np.empty((0, 6))
    station: IntArray = np.empty(0, np.intp)
    stop: IntArray = np.empty(0, np.intp)
    root: FloatArray = np.empty((0, 0))
    taken: float = 0.0
    by_pose: ErrorsByPose | None = None
    moves: Moves | None = None

    @property
    def any(self) -> bool:
        """Whether any stations share errors of their stop."""
        return self.beams.size > 0

    @property
    def sizes_by_pose(self) -> SizesByPose | None:
        """How large errors that change with the pose are; None where the hand does not err."""
        return None if self.by_pose is None else self.by_pose.sizes

    def variances(self, heavy: FloatArray) -> FloatArray:
        """Return heavy' C heavy (q, q) for columns (N, q); C is what stations of a stop share."""
        each = [_products(heavy, self.moved, at) for at in (self.stop, self.station)]
        return np.asarray(each[0] - each[1])

    def beyond(self, together: Dependence) -> Dependence:
        """Return what errors that go together in time are more than this, which explains some of it."""
        explained, sizes = self.growth, self.sizes_by_pose
        if sizes is not None and sizes.is_seen:
            explained = math.sqrt(explained**2 + sizes.growth**2 - 1.0)
        growth = max(together.growth / explained, 1.0)
        of_planes = max(together.plane_growth / self.plane_growth, growth)
        if of_planes == 1.0:
            return INDEPENDENT
        return together._replace(growth=growth, plane_growth=of_planes)

    def understated(self, dof: int) -> float:
        """Return by how much a variance of the noise is larger than one that residuals say.

        Unknowns follow errors that are shared, and take as much more of chi2.
        """
        return max(dof / max(dof - self.taken, 1.0), 1.0)

    def following_poses(self, joint: JointCovariance) -> JointCovariance:
        """Return a covariance with what errors add that change with the pose."""
        if self.moves is None:
            return joint
        beams, planes = self.moves
        coupled = len(planes) <= COUPLED_PLANES
        active = beams[modelled(joint.terms)]
        return joint.following(active, planes, np.eye(beams.shape[2]), coupled=coupled)

    def grown(self, joint: JointCovariance) -> JointCovariance:
        """Return the covariance with what stops share; `joint` is for independent errors."""
        if not self.any:
            return joint
        L, own = _carried(self.root, joint.beams), np.linalg.cholesky(joint.planes)
        P, nb = len(own), len(L)
        beams, across = joint.beams + L @ self.beams @ L.T, own @ self.across @ L.T
        known = np.linalg.solve(beams, across.reshape(-1, nb).T).T.reshape(across.shape)
        alone = own @ self.planes @ np.swapaxes(own, 1, 2) - known @ np.swapaxes(across, 1, 2)
        coupling = joint.coupling
        if self.coupling is not None:
            mixed = (own @ self.coupling.reshape(P, PLANE.dim, -1)).reshape(-1, P, PLANE.dim)
            mixed = np.einsum("nqc,qdc->nqd", mixed, own).reshape(P * PLANE.dim, -1)
            mixed -= known.reshape(-1, nb) @ across.reshape(-1, nb).T
            mixed = mixed.reshape(P, PLANE.dim, P, PLANE.dim)
            mixed[np.arange(P), :, np.arange(P)] = 0.0
            coupling = mixed if coupling is None else coupling + mixed
        return replace(
            joint,
            beams=beams,
            response=joint.response - known,
            planes=joint.planes + alone,
            coupling=coupling,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class InCommon(Value):
    """What errors that stations have in common add to the covariance of beams alone.

    Attributes
    ----------
    lift : (B, 8, nb)
        From tangent coordinates of the beams to their numbers.
    root : (nb, nb)
        Of the covariance without these errors.
    stops : (nb, nb)
        What stops have in common, along the columns of the root.
    factor : float
        On both: because errors go together in time, or because the noise was estimated too small.
    more : (nb, nb)
        What errors add that change with the pose.
    """

    lift: FloatArray
    root: FloatArray
    stops: FloatArray
    factor: float
    more: FloatArray

    @classmethod
    def of(
        cls,
        alone: JointCovariance,
        with_stops: JointCovariance,
        whole: JointCovariance,
        factor: float,
    ) -> "InCommon":
        """Return what is between the covariance for independent errors and the `whole` one."""
        root = _root(alone.beams)
        half = solve_triangular(root, with_stops.beams - alone.beams, lower=True)
        stops = solve_triangular(root, half.T, lower=True)
        lift = beams_lift(alone.beam_bases, alone.terms).reshape(-1, BEAM.size, len(root))
        return cls(lift, root, stops, factor, whole.beams - factor * with_stops.beams)

    def arranged(self, order: Sequence[int]) -> "InCommon":
        """Return the same with the numbers of the beams in another order."""
        return replace(self, lift=self.lift[order])

    def grown(self, covariance: FloatArray, directions: FloatArray) -> FloatArray:
        """Return a covariance (8 B, 8 B) of beams with directions (B, 3), and these errors.

        What stops have in common is a part of the errors that stations would have by themselves, and
        becomes smaller with them; what changes with the pose stays.
        """
        lift = self.lift.copy()
        for of_beam, v in zip(lift[:, OF_DIRECTION], directions, strict=True):
            # The nearest tangent bases of directions that have moved since.
            U, size, V = np.linalg.svd(of_beam - np.outer(v, v @ of_beam), full_matrices=False)
            of_beam[:] = U[:, size > KNOWN] @ V[size > KNOWN]
        flat = lift.reshape(-1, len(self.root))
        own = flat.T @ covariance @ flat
        root = _carried(self.root, own)
        whole = self.factor * (own + root @ self.stops @ root.T) + self.more
        return np.asarray(flat @ whole @ flat.T)

    @property
    def of_poses(self) -> FloatArray:
        """What errors of the hand poses in common make of the covariance (8 B, 8 B)."""
        whole = self.factor * self.root @ self.stops @ self.root.T + self.more
        flat = self.lift.reshape(-1, len(whole))
        return np.asarray(flat @ whole @ flat.T)


def warnings_of(sizes: SizesByPose | None) -> tuple[CalibrationWarning, ...]:
    """Return what to say of errors by pose that were learned: few of them show."""
    if sizes is None or not sizes.learned:
        return ()
    values = {"shift": sizes.shift, "turn": sizes.turn, "growth": sizes.growth}
    if sizes.is_seen:
        return (warned("errors-by-pose", values),)
    return (warned("errors-by-pose:guessed", values),) if sizes.guess_decides else ()


def _products(heavy: FloatArray, moved: FloatArray, at: IntArray) -> FloatArray:
    """Return heavy' C heavy (q, q) for errors of C that are one for all rows (N,) at the same place."""
    q = heavy.shape[1]
    of_place = csr_array((np.ones(len(at)), (at, np.arange(len(at)))))
    sums = of_place @ (heavy[:, :, None] * moved[:, None]).reshape(len(at), -1)
    columns = np.asarray(sums).reshape((-1, q, POSE.dim)).swapaxes(0, 1).reshape(q, -1)
    return np.asarray(columns @ columns.T)


NOTHING_SHARED = SharedErrors()
"""Of stations that are all elsewhere, or whose poses do not err."""


def _root(covariance: FloatArray) -> FloatArray:
    """Return a lower root of a covariance of numbers of different units."""
    unit = np.sqrt(np.diagonal(covariance))
    root: FloatArray = cholesky(covariance / np.outer(unit, unit), lower=True)
    return unit[:, None] * root


def _carried(root: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the root of another covariance to which a root is carried, in whatever order numbers are.

    It is T root, with the symmetric T that makes T root root' T the other covariance, in units of its
    standard deviations. With a root K of that, it is K times the orthogonal part of K' root.
    """
    unit, K = np.sqrt(np.diagonal(covariance)), _root(covariance)
    U, _, V = np.linalg.svd((K / unit[:, None]).T @ (root / unit[:, None]))
    return np.asarray(K @ U @ V)


class Stops(NamedTuple):
    """Where the hand stood.

    Attributes
    ----------
    stop : (M,)
        Number of the stop of each station of a recording that was read; zero for others.
    visits : float
        How many stations there are at a stop before one plane, on average.
    again : int
        How often the hand comes back to a stop before the same plane.
    stations : int
        How many were read.
    """

    stop: IntArray
    visits: float
    again: int
    stations: int

    @property
    def warnings(self) -> tuple[CalibrationWarning, ...]:
        """What to say where the size of errors that come again was learned, or they are not counted."""
        if self.again <= MANY_OUTLIERS * self.stations:
            return ()
        return (warned("repeated-stops", {"again": self.again, "stations": self.stations}),)


def stops_of(
    recording: Recording, read: IntArray, errors: tuple[float, float], pose: FloatArray
) -> Stops | None:
    """Return where the hand stood; None where it came to no stop again.

    Parameters
    ----------
    recording : Recording
    read : (S,)
        Stations with readings.
    errors : (float, float)
        Shift [m] and turn [rad] by which the hand errs, as stated or as is usual.
    pose : (M, 6, 6)
        Covariances of its poses, which may be learned.
    """
    labels = tuple(recording.plane_labels[j] for j in read.tolist())
    stations = StationList(recording.world_R_hand[read], recording.world_t_hand[read], labels)
    variances = np.diagonal(pose, axis1=1, axis2=2).reshape(-1, 2, 3).mean(axis=(0, 2))
    turn, shift = np.sqrt(variances).tolist()
    found = stations.stops(FLICKER * max(errors[0], shift), FLICKER * max(errors[1], turn))
    if len(np.unique(found)) == len(found):
        return None
    stop = np.zeros(len(recording.plane_labels), dtype=np.intp)
    stop[read] = found
    at = np.stack((found, recording.plane_of_station[read]))
    stops = np.unique(at, axis=1).shape[1]
    comes = int((np.diff(at, axis=1, prepend=-1) != 0).any(axis=0).sum())
    return Stops(stop, len(read) / stops, comes - stops, len(read))


def shared_errors(rows: LinearRows, pose: FloatArray, stops: Stops) -> SharedErrors:
    """Return what follows from errors that stations share; `pose` (M, 6, 6) by stations of the rows."""
    moved = moved_with_poses(rows.linear.pose, pose, rows.readings.station)
    stop = stops.stop[rows.position]
    moved *= _pose_factor(rows, moved, stop)[:, None]
    return _shared(rows, moved, stop, stops.visits)


def _pose_factor(rows: LinearRows, moved: FloatArray, stop: IntArray) -> FloatArray:
    """Return the factor (N,) on errors of poses that what a beam reads on its visits to a stop says.

    One where no stop is visited again before the same plane, and where readings scatter there as is
    expected. Single beams do not show which errors are of poses and which of readings; on several
    visits to a stop, errors of the pose are the same.
    """
    readings = rows.readings
    where = (stop * readings.planes + readings.plane) * readings.beams + readings.beam
    _, group, count = np.unique(where, return_inverse=True, return_counts=True)
    more, some = int((count - 1).sum()), count[group] > 1
    of_pose, variance = (moved**2).sum(axis=1), _variances(rows, moved)
    if more == 0 or not of_pose[some].any():
        return np.ones(len(readings))
    e = rows.residual
    off = e - (np.bincount(group, e) / count)[group]
    own = float((off**2).sum()) / more
    expected = float((variance - of_pose)[some].mean())
    # A variance of `more` degrees of freedom is known to this part of itself.
    if abs(own - expected) < 2.0 * math.sqrt(2.0 / more) * max(own, expected):
        return np.ones(len(readings))
    left = max(float(variance[some].mean()) - own, 0.0)
    # An error of a pose is no larger than all that its station errs by.
    parts = np.bincount(readings.station, of_pose / np.maximum(variance - of_pose, TINY))
    most = 1.0 + 1.0 / np.maximum(parts, TINY)
    square = np.minimum(left / float(of_pose[some].mean()), most)
    return np.asarray(np.sqrt(square)[readings.station])


def _variances(rows: LinearRows, moved: FloatArray) -> FloatArray:
    """Return the variances (N,) of the residuals, those by errors of the poses included."""
    own = (rows.how.sigma / rows.how.root) ** 2
    # Of single beams errors of the pose count as noise of the reading.
    return np.asarray(own + (moved**2).sum(axis=1) if rows.how.is_coupled else own)


def _shared(rows: LinearRows, moved: FloatArray, row_stop: IntArray, visits: float) -> SharedErrors:
    """Return what follows from errors that move residuals by `moved` (N, 6), alike at a stop (N,)."""
    projection = Projection(rows, rows.prior)
    root = _root(projection.beam_inverse[np.ix_(*2 * (projection.beam_inverse.any(axis=0),))])
    b, c, plane, stop = _followed(rows, projection, root, moved, row_stop)
    P, nb = rows.readings.planes, b.shape[1]
    sums = np.zeros((int(stop.max()) + 1, nb, POSE.dim))
    np.add.at(sums, stop, b)
    others = sums[stop] - b
    flat, other = (one.swapaxes(0, 1).reshape(nb, -1) for one in (b, others))
    beams = flat @ other.T
    across = np.zeros((P, PLANE.dim, nb))
    np.add.at(across, plane, c @ np.swapaxes(others, 1, 2))
    # Stations before one plane at one stop go together.
    number, place = np.unique(plane * len(sums) + stop, return_inverse=True)
    of_plane, at_stop = number // len(sums), number % len(sums)
    together = np.zeros((len(number), PLANE.dim, POSE.dim))
    np.add.at(together, place, c)
    planes = np.zeros((P, PLANE.dim, PLANE.dim))
    np.add.at(planes, of_plane, together @ np.swapaxes(together, 1, 2))
    np.add.at(planes, plane, -c @ np.swapaxes(c, 1, 2))
    coupling = None
    if P <= COUPLED_PLANES:
        shape = P * PLANE.dim, len(sums) * POSE.dim
        row = PLANE.dim * of_plane[:, None, None] + np.arange(PLANE.dim)[:, None]
        column = POSE.dim * at_stop[:, None, None] + np.arange(POSE.dim)
        places = [at.ravel() for at in np.broadcast_arrays(row, column)]
        blocks = coo_array((together.ravel(), places), shape=shape).tocsr()
        coupling = (blocks @ blocks.T).toarray().reshape(P, PLANE.dim, P, PLANE.dim)
        coupling[np.arange(P), :, np.arange(P)] = planes
    # The mean of n visits has the variance s^2 / n + p^2 of reading and pose, not (s^2 + p^2) / n.
    of_pose = np.median((moved**2).sum(axis=1) / _variances(rows, moved))
    of_planes = float(np.sqrt(1.0 + (visits - 1.0) * of_pose))
    at = rows.readings.station, row_stop
    of_freed = np.empty((0, 0))
    if rows.freed.codes:
        inverse, heavy = projection.freed_inverse, projection.freed_heavy
        differ = _products(heavy, moved, row_stop) - _products(heavy, moved, at[0])
        of_freed = inverse @ differ @ inverse
    ratios = ((root @ beams) * root).sum(axis=1) / (root**2).sum(axis=1)
    growth = float(np.sqrt(1.0 + max(ratios.max(), 0.0)))
    parts = beams, across, planes, coupling, growth, of_planes, of_freed
    taken = float(np.trace(beams) + np.einsum("paa->", planes))
    return SharedErrors(*parts, moved, *at, root, taken)


def with_errors_by_pose(
    shared: SharedErrors, projection: Projection, more: ErrorsByPose
) -> SharedErrors:
    """Return what stations share, errors that change with the pose of the hand beside it."""
    if not more.moved.any():
        return shared._replace(by_pose=more)
    gradient = [projection.J.T @ projection.how.weighed(F) for F in more.columns]
    moved = projection.following(np.concatenate(gradient, axis=1))
    alone = projection.how.sigma**2 * np.diagonal(projection.beam_inverse)
    used = np.flatnonzero(alone)
    ratios = (moved[used] ** 2).sum(axis=1) / alone[used]
    freed = shared.freed
    if projection.freed.codes:
        gains = [projection.freed_inverse @ (projection.freed_heavy.T @ F) for F in more.columns]
        whole = np.concatenate(gains, axis=1)
        freed = whole @ whole.T + (freed if freed.size else 0.0)
    return shared._replace(
        by_pose=more.grown(float(np.sqrt(1.0 + ratios.max()))),
        moves=projection.moves(moved),
        freed=freed,
    )


def _followed(
    rows: LinearRows,
    projection: Projection,
    root: FloatArray,
    moved: FloatArray,
    stop: IntArray,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return how beams, and planes for known beams, follow the errors of S stations that share a stop.

    Returns
    -------
    beams : (S, nb, 6)
    planes : (S, 3, 6)
        Of the own plane.
    plane, stop : (S,)
    """
    readings, sigma = rows.readings, rows.how.sigma
    _, first, station = np.unique(readings.station, return_index=True, return_inverse=True)
    shared = np.bincount(stop[first])[stop[first]] > 1
    some = np.flatnonzero(shared[station])
    at, plane = renumbered(station[some]), readings.plane[first][shared]
    products = rows.J[some, :, None] * rows.how.weighed(moved)[some, None]
    of_beams = np.zeros((len(plane), readings.beams, BEAM.dim, POSE.dim))
    c = np.zeros((len(plane), PLANE.dim, POSE.dim))
    np.add.at(of_beams, (at, readings.beam[some]), products[:, : BEAM.dim])
    np.add.at(c, at, products[:, BEAM.dim :])
    b = of_beams.reshape(len(plane), -1, POSE.dim)
    b -= np.einsum("spi,spa->sia", projection.response[plane], c)
    # With the covariance L L' of the unknowns, inv(L) L L' = L'. Lower roots of the planes are the same
    # in these units wherever their offsets are taken.
    used = np.flatnonzero(projection.beam_inverse.any(axis=0))
    of_plane = np.linalg.cholesky(projection.plane_inverse)
    b, c = root.T @ b[:, used] / sigma, np.swapaxes(of_plane, 1, 2)[plane] @ c / sigma
    return b, c, plane, renumbered(stop[first][shared])
