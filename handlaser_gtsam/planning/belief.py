"""What is known of beams and planes before the next stations: a Gaussian about a calibration."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..errors import InputError
from ..model.joint import beams_lift
from ..model.sensor import Sensor
from ..model.weighting import Variances
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from .bounds import Bounds
from .plate import Plate

BEAM, PLANE = 7, 3
"""Unknowns of a beam (location, tangent of the direction, k1, k2) and of a plane (tangent, offset)."""
UNKNOWN_LENGTH, UNKNOWN_ANGLE = 0.1, 0.5
"""Standard deviations of what the readings alone have to determine [m], [rad]: so large that they
tell nothing, so small that rounding does not matter."""
UNKNOWN_PLANE = (UNKNOWN_ANGLE, UNKNOWN_ANGLE, UNKNOWN_LENGTH)
MOST_PLANES = 16
"""Of a calibration, before which stations are planned."""
UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform number over its half-width."""
LEAST = 1e-9
"""Standard deviation of what is known exactly."""


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian over B beams and P planes, and the noise of the readings to come.

    Attributes
    ----------
    mean : Parameters
        World frame.
    covariance : (U, U)
        What the next calibration starts from. U = 7 B + E + 3 P tangent coordinates: (r, tangent of v,
        k1, k2) a beam, the sizes of `errors`, (tangent of n, offset at the plane's origin) a plane. A
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
        Codes of systematic errors of readings that may be there: stations that tell them are worth it.
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

    @property
    def beams(self) -> int:
        """How many beams there are."""
        return len(self.mean.locations)

    @property
    def of_beams(self) -> int:
        """How many unknowns the beams have."""
        return BEAM * self.beams

    @property
    def before_planes(self) -> int:
        """How many unknowns stand before those of the planes."""
        return self.of_beams + len(self.errors)

    def draw(self, rng: np.random.Generator) -> Parameters:
        """Return beams and planes drawn from the spread."""
        values, axes = np.linalg.eigh(self.spread)
        x = axes @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        return self.moved(x)

    def moved(self, x: FloatArray) -> Parameters:
        """Return beams and planes that differ from the mean by tangent coordinates x (U,)."""
        beam = x[: self.of_beams].reshape(-1, BEAM)
        plane = x[self.before_planes :].reshape(-1, PLANE)
        at = self.mean
        normals = at.normals + np.einsum("pij,pj->pi", self.plane_bases, plane[:, :2])
        normals = model.normalized(normals)
        there = (at.normals * self.origins).sum(axis=1) + at.offsets + plane[:, 2]
        directions = at.directions + np.einsum("bij,bj->bi", self.beam_bases, beam[:, 3:5])
        return Parameters(
            at.locations + beam[:, :3],
            model.normalized(directions),
            at.range_errors + beam[:, 5:],
            normals,
            there - (normals * self.origins).sum(axis=1),
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
        n = np.array([one.normal for one in plates.values()]).reshape(-1, 3)
        points = np.array([one.point for one in plates.values()]).reshape(-1, 3)
        at = replace(
            self.mean,
            normals=np.concatenate((self.mean.normals[:keep], n)),
            offsets=np.concatenate((self.mean.offsets[:keep], -(n * points).sum(axis=1))),
        )
        bounds = [(0.5 * x.tilt, 0.5 * x.tilt, 0.5 * x.within) for x in plates.values()]
        known = self.before_planes + PLANE * keep
        return Belief(
            at,
            _extended(self.covariance[:known, :known], np.tile(UNKNOWN_PLANE, len(plates))),
            self.beam_bases,
            np.concatenate((self.plane_bases[:keep], model.tangent_basis(n))),
            np.concatenate((self.origins[:keep], points)),
            self.variances,
            (*self.plane_names[:keep], *plates),
            _extended(self.spread[:known, :known], np.ravel(bounds)),
            self.errors,
        )


def transported(bases: FloatArray, directions: FloatArray) -> FloatArray:
    """Return tangent bases (N, 3, 2) moved to neighbouring unit vectors (N, 3)."""
    along = np.einsum("ni,nij->nj", directions, bases)
    moved = bases - directions[:, :, None] * along[:, None, :]
    first = model.normalized(moved[:, :, 0])
    second = moved[:, :, 1] - (moved[:, :, 1] * first).sum(axis=1, keepdims=True) * first
    return np.stack((first, model.normalized(second)), axis=2)


def _extended(covariance: FloatArray, sigma: FloatArray) -> FloatArray:
    count = len(covariance)
    found = np.zeros((count + len(sigma),) * 2)
    found[:count, :count] = covariance
    found[count:, count:] = np.diag(np.square(sigma))
    return found


def belief_of(calibration: Calibration | Mounts) -> Belief:
    """Return what a calibration knows of beams and planes, and the noise it found or was given.

    Of the last `MOST_PLANES` planes: the plate of earlier ones has hardly stayed where it was. Mounts
    know no planes.

    Raises
    ------
    InputError
        The calibration leaves something undetermined, so that there is no covariance.
    """
    if isinstance(calibration, Mounts):
        return _of_mounts(calibration)
    joint = calibration.covariance
    if joint is None or calibration.status != "converged":
        raise InputError(
            f"a calibration that is {calibration.status.replace('_', ' ')}",
            "a converged one; plan without a calibration for a first motion",
        )
    names = joint.plane_names[-MOST_PLANES:]
    keep = _kept(joint.terms, len(names))
    covariance = np.zeros((BEAM * len(joint.terms) + PLANE * len(names),) * 2)
    covariance[np.ix_(keep, keep)] = joint.matrix(planes=names, ambient=False)
    at = calibration.parameters()
    last = slice(len(joint.plane_names) - len(names), None)
    return Belief(
        replace(at, normals=at.normals[last], offsets=at.offsets[last]),
        covariance,
        joint.beam_bases,
        joint.plane_bases[last],
        joint.origins[last],
        _noise(calibration),
        names,
        covariance,
    )


def _of_mounts(mounts: Mounts) -> Belief:
    bases = model.tangent_basis(mounts.directions)
    count = len(mounts.names)
    lift = beams_lift(bases, [2] * count)
    covariance = lift.T @ mounts.covariance @ lift
    pose = None if mounts.pose_covariance is None else mounts.pose_covariance[None]
    nothing = np.empty((0, 3))
    return Belief(
        Parameters(mounts.locations, mounts.directions, mounts.range_errors, nothing, np.empty(0)),
        covariance,
        bases,
        np.empty((0, 3, 2)),
        nothing,
        Variances(np.full(count, mounts.range_sigma), pose=pose),
        (),
        covariance,
    )


def _kept(terms: tuple[int, ...], planes: int) -> IntArray:
    """Return the unknowns of a belief that a calibration estimates."""
    first = BEAM * len(terms)
    beams = [BEAM * i + np.arange(5 + count) for i, count in enumerate(terms)]
    return np.concatenate([*beams, np.arange(first, first + PLANE * planes)])


def _noise(calibration: Calibration) -> Variances:
    """Return what the readings of further stations err by."""
    pose = calibration.pose_covariance
    pose = None if pose is None else pose[None]
    found = calibration.variances
    if found is None:
        return Variances(np.full(len(calibration.beams), calibration.fit.range_sigma), pose=pose)
    return Variances(found.range_sigma, found.incidence_sigma, pose)


def belief_about(bounds: Bounds, at: Parameters, variances: Variances, sensor: Sensor) -> Belief:
    """Return what a calibration would start from about some beams and a plate: next to nothing.

    It does not use the bounds; they are the `spread`.
    """
    k = sensor.linearity * np.array([1.0, 1.0 / max(abs(sensor.range_max), LEAST)])
    plate, beams = bounds.plate, len(bounds.locations)
    known = [UNIFORM * bounds.location_within] * 3 + [0.5 * bounds.cone] * 2 + [*k]
    placed = [0.5 * plate.tilt, 0.5 * plate.tilt, UNIFORM * plate.within]
    unknown = [UNKNOWN_LENGTH] * 3 + [UNKNOWN_ANGLE] * 2 + [*k]
    spread = np.concatenate((np.tile(known, beams), placed))
    sigma = np.concatenate((np.tile(unknown, beams), UNKNOWN_PLANE))
    return Belief(
        at,
        np.diag(sigma**2),
        model.tangent_basis(at.directions),
        model.tangent_basis(at.normals),
        plate.point[None],
        variances,
        ("plate",),
        np.diag(np.maximum(spread, LEAST) ** 2),
    )
