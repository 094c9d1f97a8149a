r"""Whether a calibration holds for another recording.

The planes of that recording are unknown, the beams b known with covariance P. Near them, with the
planes fitted, the whitened residuals cost (`model.reduction`)

    chi2(b + x) = c + 2 g' x + x' S x,

S being what the recording itself knows of the beams. Beams as calibrated leave the least of
chi2(b + x) + x' inv(P) x; beams that are free leave c - g' S^+ g. The difference is chi-square
distributed with as many degrees of freedom as S has rank if nothing has moved, and what the free
beams leave tells whether noise and model are right. One beam at a time has moved: the same with its
part of P infinite.
"""

from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording
from ..data.value import Value
from ..model.distributions import FEW_DEGREES, chi2_sf, f_sf
from ..model.families import BEAM, DIRECTION, LOCATION, PLANE, modelled
from ..model.joint import beams_lift
from ..model.weighting import Variances, Whitening, covariance_roots, whitening
from ..progress import tell
from ..quantities import KNOWN, MOST_ROUNDS, SINGULAR
from ..results.mounts import Mounts
from ..solvers.beam_problem import linearized, moved
from ..starts.growing import PartialStart, grow


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BeamDrift(Value):
    """Whether one beam has moved since its calibration, or while a session went on.

    Attributes
    ----------
    name : str
    statistic : float
        By how much chi2 falls when this beam alone may have moved.
    p_value : float
        Probability of so large a fall if it has not; in a session if none has, all epochs and beams
        considered.
    shift : (3,)
        By how much its location would have moved [m]; NaN in a session where it has moved so far that
        planes fit only without it.
    turn : float
        By how much its direction would have [rad]; NaN likewise.
    since : str
        The first plane of a session that saw it moved; empty of another recording.
    """

    name: str
    statistic: float
    p_value: float
    shift: FloatArray
    turn: float
    since: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HoldOut(Value):
    """A recording that a calibration did not see.

    Attributes
    ----------
    readings : int
    rms, max_residual : float
        Of the residuals with the calibrated beams and the planes fitted [m].
    chi2, dof : float, int
        Of noise and model, the beams free: near dof if they are right.
    noise_p_value : float
        Probability of a larger chi2 then; NaN where the range sigma was estimated from it.
    drift, drift_dof : float, int
        What the beams as calibrated add to it.
    p_value : float
        Probability of a larger drift if the calibration still holds.
    beams : tuple of BeamDrift
    """

    readings: int
    rms: float
    max_residual: float
    chi2: float
    dof: int
    noise_p_value: float
    drift: float
    drift_dof: int
    p_value: float
    beams: tuple[BeamDrift, ...]


def hold_out(
    mounts: Mounts, recording: Recording, noise: Noise | None = None, *, each_beam: bool = True
) -> HoldOut:
    """Compare calibrated beams with a recording of the same beams.

    Parameters
    ----------
    mounts : Mounts
    recording : Recording
        Its beams must be among the beams of `mounts`; its planes may be any.
    noise : Noise, optional
        An unknown range sigma is taken from the calibration, and what the recording shows where it has
        readings enough. Unknown errors of the poses are taken from the calibration.
    each_beam : bool
        Whether each beam is tested alone, too; that takes long for dozens of beams.

    Raises
    ------
    InputError
        A beam that was not calibrated, or pose covariances of another number of stations.
    GrazingBeamError
        A beam grazes the plane that its readings would have.
    """
    noise = Noise() if noise is None else noise
    require_kind("mounts", mounts, Mounts)
    require_kind("recording", recording, Recording)
    require_kind("noise", noise, Noise)
    tell("hold-out")
    noise = noise.reordered(np.arange(len(recording.plane_labels)))
    mounts = mounts.arranged(recording.beam_names)
    readings = recording.readings()
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    sigma = noise.range_sigma or mounts.range_sigma
    stations, pose = len(recording.plane_labels), None
    if noise.poses_uncertain:
        pose = noise.pose_covariances(stations)
    elif not noise.poses_exact and mounts.pose_covariance is not None:
        pose = np.broadcast_to(mounts.pose_covariance, (stations, 6, 6))
    variances = Variances(np.full(readings.beams, sigma), noise.incidence_sigma, pose)
    beams = (mounts.locations, mounts.directions, mounts.range_errors)
    at, how = fit_planes(beams, readings, variances)
    return _tested(at, readings, how, mounts, each_beam, noise.range_sigma is not None)


def fit_planes(
    beams: Beams, readings: Readings, variances: Variances
) -> tuple[Parameters, Whitening]:
    """Return the planes that fit `readings` best for fixed beams (r, v, k), and the whitening there."""
    r, v, k = beams
    at = grow(PartialStart.of(readings, r=r, v=v, k=k), readings)
    unit = PLANE.natural_units(readings.typical_range())
    still = np.zeros((readings.beams, BEAM.dim))
    for _ in range(MOST_ROUNDS):  # the closed-form planes converge quadratically
        how = whitening(at, readings, variances)
        normal, centres = linearized(at, readings, 2, how)
        step = normal.reduced(np.ones(still.size), unit).local_step * unit
        at = moved(at, still, step, centres)
        if np.abs(step).max() < SINGULAR:
            break
    return at, whitening(at, readings, variances)


def _tested(
    at: Parameters, readings: Readings, how: Whitening, mounts: Mounts, each_beam: bool, known: bool
) -> HoldOut:
    """Test the beams as calibrated against readings whose planes were fitted to them.

    Parameters
    ----------
    at : Parameters
        The beams as calibrated, and the planes.
    readings : Readings
    how : Whitening
    mounts : Mounts
    each_beam : bool
        Whether each is to be tested alone, too.
    known : bool
        Whether the range sigma was given; else it is what the readings show.
    """
    # chi2(b + x) = cost + 2 gradient' x + x' information x over the unknowns of the beams, planes
    # fitted, along what the recording determines; in natural units and sigmas.
    normal, _ = linearized(at, readings, 2, how)
    length = readings.typical_range()
    active = modelled(mounts.terms).ravel()
    every = np.tile(BEAM.natural_units(length), readings.beams)
    unit, beam = every[active], np.repeat(np.arange(readings.beams), BEAM.dim)[active]
    reduced = normal.reduced(every, PLANE.natural_units(length), active)
    e = model.residuals(model.scene(at, readings), readings.distance)
    white = how.apply(e)
    cost = float(white @ white) / how.sigma**2
    values, axes = np.linalg.eigh(reduced.matrix / how.sigma**2)
    free = len(readings) - 3 * readings.planes
    along = axes.T @ reduced.gradient / how.sigma**2
    scale, keep = 1.0, values > KNOWN**-2
    # Few readings cannot tell their own sigma: that of the calibration stands for it.
    known = known or free - int(keep.sum()) < FEW_DEGREES
    # In three rounds the scale of the noise and the directions that it determines settle together.
    for _ in range(0 if known else 3):
        rest = cost - float((along[keep] ** 2 / values[keep]).sum())
        scale = rest / (free - int(keep.sum()))
        keep = values / scale > KNOWN**-2
    axes, values, along = axes[:, keep], values[keep] / scale, along[keep] / scale
    information, gradient = (axes * values) @ axes.T, axes @ along
    rank, dof = int(keep.sum()), free - int(keep.sum())
    lift = beams_lift(model.tangent_basis(mounts.directions), mounts.terms)
    covariance = lift.T @ mounts.covariance @ lift / np.outer(unit, unit)

    def least(root: FloatArray, free: FloatArray) -> tuple[float, FloatArray]:
        """Return by how much chi2 falls, and for which x = root z + free y; z' z adds to chi2."""
        A = np.hstack((root, free))
        Q = A.T @ information @ A
        Q[: root.shape[1], : root.shape[1]] += np.eye(root.shape[1])
        b = A.T @ gradient
        z = -np.linalg.pinv(Q, rcond=SINGULAR, hermitian=True) @ b
        return float(-b @ z), A @ z

    def p_value(statistic: float, degrees: int) -> float:
        if degrees == 0:
            return float("nan")
        if known:
            return float(chi2_sf(statistic, degrees))
        return float(f_sf(statistic / degrees, degrees, max(dof, 1)))

    n = len(unit)
    own = covariance_roots(covariance[None])[0]
    held, moved = least(own, own[:, :0])[0], float((along**2 / values).sum())
    chi2, drift = cost / scale - moved, moved - held
    beams = []
    for index, name in enumerate(mounts.names if each_beam else ()):
        mine = beam == index
        (others,) = covariance_roots((own @ own.T)[np.ix_(~mine, ~mine)][None])
        root = np.zeros((n, others.shape[1]))
        root[~mine] = others
        fall, x = least(root, np.eye(n)[:, mine])
        statistic, dx = max(fall - held, 0.0), (x * unit)[mine]
        p = p_value(statistic, min(int(mine.sum()), rank))
        beams.append(
            BeamDrift(name, statistic, p, dx[LOCATION], float(np.linalg.norm(dx[DIRECTION])))
        )
    return HoldOut(
        len(e),
        float(np.sqrt(np.mean(e**2))),
        float(np.abs(e).max()),
        chi2,
        dof,
        float(chi2_sf(chi2, dof)) if known and dof > 0 else float("nan"),
        drift,
        rank,
        p_value(drift, rank),
        tuple(beams),
    )
