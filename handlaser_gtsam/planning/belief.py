"""What is known of beams and planes before the next stations: a Gaussian about a calibration."""

from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..errors import InputError
from ..model.weighting import Variances
from ..results.calibration import Calibration

BEAM, PLANE = 7, 3
"""Unknowns of a beam (location, tangent of the direction, k1, k2) and of a plane (tangent, offset)."""


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian over B beams and P planes, and the noise of the readings to come.

    Attributes
    ----------
    mean : Parameters
        World frame.
    covariance : (U, U)
        U = 7 B + 3 P tangent coordinates: (r, tangent of v, k1, k2) a beam, (tangent of n, offset at
        the plane's origin) a plane. A range error that is not modelled has zero rows.
    beam_bases : (B, 3, 2), plane_bases : (P, 3, 2)
        Tangent bases of directions and normals.
    origins : (P, 3)
        Where the offset of each plane is taken [m].
    variances : Variances
        Sigmas of the readings; `pose` is one covariance (1, 6, 6), or None for exact poses.
    plane_names : tuple of str
    """

    mean: Parameters
    covariance: FloatArray
    beam_bases: FloatArray
    plane_bases: FloatArray
    origins: FloatArray
    variances: Variances
    plane_names: tuple[str, ...]

    @property
    def beams(self) -> int:
        """How many beams there are."""
        return len(self.mean.locations)

    @property
    def of_beams(self) -> int:
        """How many unknowns the beams have; those of the planes follow."""
        return BEAM * self.beams

    def draw(self, rng: np.random.Generator) -> Parameters:
        """Return beams and planes drawn from the Gaussian."""
        values, axes = np.linalg.eigh(self.covariance)
        x = axes @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        beam, plane = x[: self.of_beams].reshape(-1, BEAM), x[self.of_beams :].reshape(-1, PLANE)
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
        """Return the belief with the same covariance about another mean."""
        return replace(
            self,
            mean=mean,
            beam_bases=model.tangent_basis(mean.directions),
            plane_bases=model.tangent_basis(mean.normals),
        )


def belief_of(calibration: Calibration) -> Belief:
    """Return what a calibration knows of beams and planes, and the noise it found or was given.

    Raises
    ------
    InputError
        The calibration determines not everything, so that there is no covariance.
    """
    joint = calibration.covariance
    if joint is None:
        raise InputError(
            f"a calibration that is {calibration.status.replace('_', ' ')}",
            "one with a covariance; plan without a calibration for a first motion",
        )
    small = joint.matrix(ambient=False)
    beams, planes = len(joint.beam_names), len(joint.plane_names)
    keep = np.concatenate(
        [BEAM * i + np.arange(5 + terms) for i, terms in enumerate(joint.terms)]
        + [BEAM * beams + np.arange(PLANE * planes)]
    )
    covariance = np.zeros((BEAM * beams + PLANE * planes,) * 2)
    covariance[np.ix_(keep, keep)] = small
    return Belief(
        calibration.parameters(),
        covariance,
        joint.beam_bases,
        joint.plane_bases,
        joint.origins,
        noise_of(calibration),
        joint.plane_names,
    )


def noise_of(calibration: Calibration) -> Variances:
    """Return what the readings of further stations err by."""
    beams = len(calibration.beams)
    pose = calibration.pose_covariance
    pose = None if pose is None else pose[None]
    found = calibration.variances
    if found is None:
        return Variances(np.full(beams, calibration.fit.range_sigma), pose=pose)
    return Variances(found.range_sigma, found.incidence_sigma, pose)
