r"""What is known before the next stations, a Gaussian about a calibration; and what they would say.

The residuals of one station before plane p are A x, with x the deviation of the unknowns and A (B, U)
whitened by the covariance of the station's readings (see `model.weighting`); only the columns of the
beams and of that plane are not zero. What is known after it follows by `choice.updated`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import InputError
from ..estimation.errors_by_pose import ErrorsByPose, SizesByPose, poses_from_mean
from ..model.effects import EFFECTS, OF_READINGS, OF_STATIONS
from ..model.effects.effect import Everywhere, SeenStations
from ..model.families import BEAM, DIRECTION, LOCATION, PLANE, POSE, RANGE_ERROR, modelled
from ..model.joint import beam_lifts, beams_lift
from ..model.weighting import Variances, covariance_roots, reading_sigmas, whitening
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..results.spots import spot_of
from ..validation.simulate import Stations, predicted_readings
from .bounds import Plate, plate_of
from .goal import PlannedMount

UNKNOWN_LENGTH = 0.1
"""Standard deviation of a length that the readings alone have to determine [m]: too large to say
anything, and small enough that rounding does not matter."""
UNKNOWN_ANGLE = 0.5
"""The same of an angle [rad]."""
UNKNOWN_PLANE = np.array([UNKNOWN_ANGLE, UNKNOWN_ANGLE, UNKNOWN_LENGTH])
COMPARED_DRAWS = 4
"""Draws of a belief, or of bounds, at which stations are compared: more change no choice much."""


class ByPose(NamedTuple):
    """Errors of the hand that change with its pose, which stations to come have, too.

    Attributes
    ----------
    size : (6,)
        Standard deviations of turns [rad] and shifts [m] by metre and radian.
    of : (S, 3, 3) and (S, 3)
        Poses of the hand in the recording, from whose mean they change.
    counted : (U, 36)
        G of `choice`, of the recording.
    """

    size: FloatArray
    of: tuple[FloatArray, FloatArray]
    counted: FloatArray


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian over B beams and P planes, and the noise of the readings to come.

    Attributes
    ----------
    mean : Parameters
        World frame.
    covariance : (U, U)
        What the next calibration starts from. U = E + 7 B + 3 P tangent coordinates: the sizes of
        `errors`, seven of `BEAM` a beam, (tangent of n, offset at the plane's origin) a plane. A
        range error that is not modelled has zero rows.
    beam_bases : (B, 3, 2), plane_bases : (P, 3, 2)
        Tangent bases of directions and normals.
    origins : (P, 3)
        Where the offset of each plane is taken [m].
    variances : Variances
        Sigmas of the readings; `pose` is one covariance (1, 6, 6), or None for exact poses.
    plane_names : tuple of str
    spread : (U, U)
        How far the truth may be from the mean. It differs from `covariance` in what a person knows
        and the calibration does not use: where a plate stands roughly.
    errors : tuple of str
        Codes of freed systematic errors, which are unknowns. A size that goes with a power of the
        reading is that at one metre.
    turned_from : (3, 3)
        Mean orientation of the hand in the recording behind it, from which errors of turns count.
    bent_from : (P, 3) and float, or None
        Middle of each plate and squared distance [m^2] from which a curvature counts; None where no
        error is an unknown.
    uncounted : tuple of str
        Codes of freed errors of which the next stations are taken to have none, because it depends on
        when and before which other stations they are measured, or on new plates.
    by_pose : ByPose, optional
        `covariance` is without what these errors add.
    """

    mean: Parameters
    covariance: FloatArray
    beam_bases: FloatArray
    plane_bases: FloatArray
    origins: FloatArray
    variances: Variances
    plane_names: tuple[str, ...]
    spread: FloatArray
    errors: tuple[str, ...] = ()
    turned_from: FloatArray = field(default_factory=lambda: np.eye(3))
    bent_from: tuple[FloatArray, float] | None = None
    uncounted: tuple[str, ...] = ()
    by_pose: ByPose | None = None

    @property
    def beams(self) -> int:
        """The number of beams."""
        return len(self.mean.locations)

    @property
    def first_plane(self) -> int:
        """The number of unknowns of errors and beams, before the planes."""
        return len(self.errors) + BEAM.dim * self.beams

    def mounts(self, reading: float) -> list[PlannedMount]:
        """Return what a goal asks of every beam, its spot at a reading [m]."""
        mounts, beams = [], np.hstack(self.mean.beams)
        for i, (beam, lift) in enumerate(zip(beams, beam_lifts(self.beam_bases), strict=True)):
            own = np.eye(BEAM.dim, len(self.covariance), len(self.errors) + BEAM.dim * i)
            spot = spot_of(beam, reading)[1] @ lift @ own
            mounts.append(PlannedMount(own[LOCATION], own[DIRECTION][None], spot))
        return mounts

    def draw(self, rng: np.random.Generator) -> Parameters:
        """Return beams and planes drawn from the spread."""
        (root,) = covariance_roots(self.spread[None])
        return self.moved(root @ rng.standard_normal(len(root)))

    def moved(self, x: FloatArray) -> Parameters:
        """Return beams and planes that differ from the mean by tangent coordinates x (U,)."""
        beam = x[len(self.errors) : self.first_plane].reshape(-1, BEAM.dim)
        plane = x[self.first_plane :].reshape(-1, PLANE.dim)
        mean = self.mean
        turned = np.einsum("bij,bj->bi", self.beam_bases, beam[:, DIRECTION])
        tilted = np.einsum("pij,pj->pi", self.plane_bases, plane[:, :2])
        normals = model.normalized(mean.normals + tilted)
        heights = (mean.normals * self.origins).sum(axis=1) + mean.offsets + plane[:, 2]
        return Parameters(
            mean.locations + beam[:, LOCATION],
            model.normalized(mean.directions + turned),
            mean.range_errors + beam[:, RANGE_ERROR],
            normals,
            heights - (normals * self.origins).sum(axis=1),
        )

    def about(self, mean: Parameters) -> "Belief":
        """Return the belief with the same covariance about another mean nearby."""
        return replace(
            self,
            mean=mean,
            beam_bases=transported(self.beam_bases, mean.directions),
            plane_bases=transported(self.plane_bases, mean.normals),
        )

    def before(self, plates: Mapping[str, Plate], *, only: bool = False) -> "Belief":
        """Return the belief with plates that nothing was read of yet; `only` with them, if asked."""
        keep = 0 if only else len(self.plane_names)
        known = self.first_plane + PLANE.dim * keep
        n = np.array([plate.normal for plate in plates.values()]).reshape(-1, 3)
        points = np.array([plate.point for plate in plates.values()]).reshape(-1, 3)
        bounds = [(x.tilt, x.tilt, x.within) for x in plates.values()]
        unknown, bent, by_pose = np.tile(UNKNOWN_PLANE, len(plates)), self.bent_from, self.by_pose
        if by_pose is not None:
            counted = np.pad(by_pose.counted[:known], ((0, len(unknown)), (0, 0)))
            by_pose = by_pose._replace(counted=counted)
        return replace(
            self,
            by_pose=by_pose,
            bent_from=bent and (np.concatenate((bent[0][:keep], points)), bent[1]),
            mean=replace(
                self.mean,
                normals=np.concatenate((self.mean.normals[:keep], n)),
                offsets=np.concatenate((self.mean.offsets[:keep], -(n * points).sum(axis=1))),
            ),
            covariance=block_diag(self.covariance[:known, :known], np.diag(unknown**2)),
            plane_bases=np.concatenate((self.plane_bases[:keep], model.tangent_basis(n))),
            origins=np.concatenate((self.origins[:keep], points)),
            plane_names=(*self.plane_names[:keep], *plates),
            # Bounds are taken for two standard deviations.
            spread=block_diag(self.spread[:known, :known], np.diag((0.5 * np.ravel(bounds)) ** 2)),
        )

    def plates(self) -> list[Plate]:
        """Return the planes as plates, each about the foot of its origin."""
        planes = zip(self.mean.normals, self.mean.offsets.tolist(), self.origins, strict=True)
        return [plate_of(n, b, origin) for n, b, origin in planes]


def transported(bases: FloatArray, directions: FloatArray) -> FloatArray:
    """Return tangent bases (N, 3, 2) moved to neighbouring unit vectors (N, 3)."""
    along = np.einsum("ni,nij->nj", directions, bases)
    moved = bases - directions[:, :, None] * along[:, None, :]
    first = model.normalized(moved[:, :, 0])
    second = moved[:, :, 1] - (moved[:, :, 1] * first).sum(axis=1, keepdims=True) * first
    return np.stack((first, model.normalized(second)), axis=2)


def belief_of(calibration: Calibration | Mounts) -> Belief:
    """Return what a calibration knows of beams and its last planes, and the noise behind it.

    Freed errors that a station has by itself are unknowns beside them. Mounts know no planes.

    Raises
    ------
    InputError
        The calibration leaves something undetermined, so that there is no covariance; or it has freed
        errors and no recording.
    """
    pose = calibration.pose_covariance
    pose = None if pose is None else pose[None]
    if isinstance(calibration, Mounts):
        r, v, k = calibration.locations, calibration.directions, calibration.range_errors
        bases, nothing = model.tangent_basis(v), np.empty((0, 3))
        lift = beams_lift(bases, [2] * len(bases))
        covariance = lift.T @ calibration.covariance @ lift
        mean = Parameters(r, v, k, nothing, np.empty(0))
        noise = Variances(calibration.range_sigma, pose=pose)
        no_bases = np.empty((0, 3, 2))
        return Belief(mean, covariance, bases, no_bases, nothing, noise, (), covariance)
    joint, effects = calibration.covariance, calibration.effects
    if joint is None or calibration.status != "converged":
        raise InputError(
            f"a calibration that is {calibration.status.replace('_', ' ')}",
            "a converged one; plan without a calibration for a first motion",
        )
    # Planes of a calibration before which stations are planned, from the last: the plate of earlier
    # ones has hardly stayed where it was.
    last = slice(max(len(joint.plane_names) - 16, 0), None)
    names, mean = joint.plane_names[last], calibration.parameters()
    mean = replace(mean, normals=mean.normals[last], offsets=mean.offsets[last])
    counted = [number for number, effect in enumerate(effects) if effect.code in OF_STATIONS]
    S = joint.matrix(planes=names, ambient=False)
    turned_from, bent_from = np.eye(3), None
    if counted:
        S, turned_from, (middles, square) = _with_freed(calibration, counted, S, len(joint.beams))
        bent_from = middles[last], square
    # Range errors that are not modelled have rows of zeros.
    beams = modelled(joint.terms).ravel()
    known = np.pad(beams, (len(counted), PLANE.dim * len(names)), constant_values=True)
    covariance = np.zeros((len(known), len(known)))
    covariance[np.ix_(known, known)] = S
    belief = Belief(
        mean,
        covariance=covariance,
        beam_bases=joint.beam_bases,
        plane_bases=joint.plane_bases[last],
        origins=joint.origins[last],
        variances=replace(calibration.reading_variances, pose=pose),
        plane_names=names,
        spread=covariance,
        errors=tuple(effects[number].code for number in counted),
        turned_from=turned_from,
        bent_from=bent_from,
        uncounted=tuple(dict.fromkeys(e.code for e in effects if e.code not in OF_STATIONS)),
    )
    recording, sizes = calibration.recording, calibration.errors_by_pose
    if recording is None or sizes is None or names != recording.plane_names:
        return belief
    return _with_errors_by_pose(belief, calibration.used_in(recording), sizes)


def _with_errors_by_pose(belief: Belief, used: Recording, sizes: SizesByPose) -> Belief:
    """Return a belief whose covariance is without errors of some sizes that change with the pose.

    Of the readings that were used. With P what is left of S, that is P + P G G'P; so that

        P = S - L L',  L = S G inv(I + K),  K + K^2 = G'S G.
    """
    if sizes.growth <= 1.0:
        return belief
    read = ~np.isnan(used.ranges).all(axis=1)
    of = used.world_R_hand[read], used.world_t_hand[read]
    size = np.repeat([sizes.turn, sizes.shift], 3)
    nothing = np.zeros((len(belief.covariance), POSE.dim**2))
    rows = recorded_rows(replace(belief, by_pose=ByPose(size, of, nothing)), used)
    A, F = np.split(rows.reshape(-1, rows.shape[-1]), [len(nothing)], axis=1)
    S, G = belief.covariance, A.T @ F
    square, axes = np.linalg.eigh(G.T @ S @ G)
    K = 0.5 * (np.sqrt(1.0 + 4.0 * np.maximum(square, 0.0)) - 1.0)
    L = S @ G @ axes / (1.0 + K)
    return replace(belief, covariance=S - L @ L.T, by_pose=ByPose(size, of, G))


def _with_freed(
    calibration: Calibration, counted: list[int], S: FloatArray, beams: int
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, float]]:
    """Return a covariance S (n, n) with the `counted` freed errors before it.

    S is of `beams` coordinates of all beams, and of the last planes. The other results are
    `turned_from` and `bent_from` of a belief, of all planes.
    """
    recording, effects = calibration.recording, [calibration.effects[number] for number in counted]
    if recording is None:
        raise InputError("freed errors without a recording", "a calibration from its recording")
    used = calibration.used_in(recording)
    largest = float(np.nanmax(used.ranges))
    # A plan counts by how much readings are too long; freed sizes are those that are taken off.
    unit = np.array([-(largest ** -(EFFECTS[e.code].power or 0)) for e in effects])
    of_effects = np.outer(unit, unit) * [effect.of_effects[counted] for effect in effects]
    kept = np.r_[:beams, beams - len(S) : 0]
    across = unit[:, None] * [effect.of_mounts[kept] for effect in effects]
    seen = ~np.isnan(recording.ranges).all(axis=1)
    turned_from = Rotation.from_matrix(recording.world_R_hand[seen]).mean().as_matrix()
    readings, at = used.readings(), calibration.parameters()
    whole = SeenStations(at, readings, readings.station, np.arange(readings.beams))
    return np.block([[of_effects, across], [across.T, S]]), turned_from, whole.plates


def outlook(
    belief: Belief, stations: Stations
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what stations would read at the mean of the belief, and how far it may be off.

    Returns
    -------
    readings, reading_sigmas : (M, B)
        Predicted readings [m], and what the spread of the belief leaves uncertain of them; noise and
        robot errors included.
    cosines, cosine_sigmas : (M, B)
        The same of the incidence.

    Raises
    ------
    GrazingBeamError, InputError
        As `predicted_readings` does.
    """
    readings, x, columns, rows = _linearized(belief, stations)
    n_hand, v_world = np.einsum("nji,nj->ni", x.R, x.n), np.einsum("nij,nj->ni", x.R, x.v)
    steeper = np.zeros_like(rows)  # derivatives of the cosines
    steeper[:, DIRECTION] = np.einsum("ni,nij->nj", n_hand, belief.beam_bases[readings.beam])
    steeper[:, BEAM.dim : BEAM.dim + 2] = np.einsum(
        "ni,nij->nj", v_world, belief.plane_bases[readings.plane]
    )
    variances, turn = belief.variances.for_stations(len(stations)), 0.0
    if variances.pose is not None:
        turn = float(np.linalg.eigvalsh(variances.pose[0, :3, :3])[-1])
    noise = reading_sigmas(belief.mean, readings, variances) ** 2
    S = belief.spread[columns[:, :, None], columns[:, None]]
    variance, of_cosine = (
        np.maximum(np.einsum("ni,nij,nj->n", J, S, J), 0.0) for J in (rows, steeper)
    )
    found = (
        readings.distance,
        np.sqrt(variance + noise),
        model.cosines(x),
        np.sqrt(of_cosine + turn),
    )
    distance, sigma, cosine, cosine_sigma = (part.reshape(-1, belief.beams) for part in found)
    return distance, sigma, cosine, cosine_sigma


def station_rows(belief: Belief, stations: Stations) -> FloatArray:
    """Return the whitened derivatives A (M, B, U + c) of what stations would read, by all unknowns.

    The last c are by errors of the hand that change with its pose, of unit variance.

    Raises
    ------
    GrazingBeamError, InputError
        As `outlook` does.
    """
    readings, x, columns, derivatives = _linearized(belief, stations)
    rows = np.zeros((len(readings), len(belief.covariance)))
    np.put_along_axis(rows, columns, derivatives, axis=1)
    if belief.errors:
        counted_from = belief.turned_from, belief.bent_from
        each = np.arange(belief.beams)
        seen = SeenStations(belief.mean, readings, readings.station, each, *counted_from)
        for column, code in enumerate(belief.errors):
            if code in OF_READINGS:
                rows[:, column] = OF_READINGS[code](seen, 1.0)
            else:
                found = EFFECTS[code].at(seen)
                assert isinstance(found, Everywhere), "it is of stations"
                rows[:, column] = found.columns[:, 0]
    if belief.by_pose is not None:
        size, of, _ = belief.by_pose
        pose = poses_from_mean(stations.world_R_hand, stations.world_t_hand, of)
        moved = model.linearize(x, readings.distance, with_pose=True).pose * size
        rows = np.hstack((rows, *ErrorsByPose(pose[readings.station], moved).columns))
    how = whitening(belief.mean, readings, belief.variances.for_stations(len(stations)))
    return (how.apply_rows(rows) / how.sigma).reshape(len(stations), belief.beams, -1)


def recorded_rows(belief: Belief, recording: Recording) -> FloatArray:
    """Return the rows (M, B, U + c) of the readings of a recording; its planes are a belief's.

    Of stations where all beams can read at the mean.
    """
    plane = recording.plane_of_station
    n_hand = np.einsum("mji,mj->mi", recording.world_R_hand, belief.mean.normals[plane])
    facing = (n_hand @ belief.mean.directions.T > model.GRAZING_LIMIT).all(axis=1)
    if not facing.any():
        width = 0 if belief.by_pose is None else belief.by_pose.counted.shape[1]
        return np.zeros((0, belief.beams, len(belief.covariance) + width))
    stations = Stations(recording.world_R_hand, recording.world_t_hand, plane)[facing]
    read = ~np.isnan(recording.ranges[facing])
    return np.where(read[..., None], station_rows(belief, stations), 0.0)


def _linearized(
    belief: Belief, stations: Stations
) -> tuple[Readings, model.Scene, IntArray, FloatArray]:
    """Return what stations read at the mean, and how.

    Returns
    -------
    readings, scene
        By stations, and then by beams: N of them.
    columns : (N, 10)
        The unknowns of each reading's beam and plane.
    derivatives : (N, 10)
        Of the residuals by these.
    """
    readings, x = predicted_readings(belief.mean, stations)
    bases = belief.beam_bases[readings.beam], belief.plane_bases[readings.plane]
    at = model.linearize(x, readings.distance)
    derivatives = model.tangent_columns(at, *bases, belief.origins[readings.plane], 2)[:-1].T
    of_beam = len(belief.errors) + BEAM.dim * readings.beam[:, None] + np.arange(BEAM.dim)
    of_plane = belief.first_plane + PLANE.dim * readings.plane[:, None] + np.arange(PLANE.dim)
    return readings, x, np.hstack((of_beam, of_plane)), derivatives
