"""Many recordings of one shape, solved together by the reduction: for studies and designs.

Noise is taken as given, every reading counts, and a start that is given is believed: nothing is
searched for, rejected or learned. `calibrate` does all that for one recording.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.recording import Recording
from ..errors import InputError
from ..model.beams_on_planes import values_of
from ..model.damped_search import LevenbergOptions
from ..model.families import PLANE
from ..model.joint import beam_lifts
from ..model.reduced_information import eliminated
from ..model.weighting import Variances, Whitening, unequal, weighed
from ..solvers.beam_problem import SolvedMany, beam_problem, solve_together
from ..starts import find_start


def solve_many(
    recordings: Sequence[Recording],
    noise: Noise,
    terms: int = 2,
    starts: Sequence[Parameters] | None = None,
    prior: RangeErrorPrior | None = None,
    options: LevenbergOptions | None = None,
) -> SolvedMany:
    """Solve recordings of one shape together.

    Parameters
    ----------
    recordings : K Recordings
        With readings of the same beams and planes at the same stations.
    noise : Noise
        With a range sigma and the errors of the poses.
    terms : int
        Range-error terms of every beam: 0, 1 or 2.
    starts : K Parameters, optional
        Planes in the world frame; found for each recording where not given.
    prior : RangeErrorPrior, optional
    options : LevenbergOptions, optional

    Raises
    ------
    InputError
        No recordings, or of different shapes; noise that is not given.
    GrazingBeamError
        A beam grazes its plane where the weights are taken.
    """
    readings = _of_one_shape(recordings)
    origins = [one.plane_means(one.world_t_hand) for one in readings]
    local = [one.seen_from(there) for one, there in zip(readings, origins, strict=True)]
    variances = _variances(noise, recordings[0], terms)
    sigma = float(variances.range_sigma[0])
    if starts is None:
        begun = [find_start(one, sigma).parameters for one in local]
    else:
        begun = [at.seen_from(there) for at, there in zip(starts, origins, strict=True)]
    # With equal weights first, then with the weights at the solution where they differ.
    weights: float | list[Whitening] = sigma
    solved = solve_together(local, begun, terms, weights, prior, options)
    plain = local
    if any(unequal(variances, terms, one) for one in plain):
        for _ in range(2):  # each update leaves a thousandth of the error before
            both = [
                weighed(one, parameters, variances, terms)
                for parameters, one in zip(solved.parameters, plain, strict=True)
            ]
            local, weights = (list(part) for part in zip(*both, strict=True))
            solved = solve_together(local, solved.parameters, terms, weights, prior, options)
    world = (at.seen_from(-there) for at, there in zip(solved.parameters, origins, strict=True))
    covariances = _beam_covariances(local, solved, terms, weights, prior)
    return replace(solved, parameters=tuple(world), covariances=covariances)


def _beam_covariances(
    readings: Sequence[Readings],
    solved: SolvedMany,
    terms: int,
    noise: float | Sequence[Whitening],
    prior: RangeErrorPrior | None,
) -> FloatArray:
    """Return the covariances (K, B, 8, 8) of the beams, NaN where the information is singular."""
    problem, block = beam_problem(readings, terms, noise, prior=prior, local=PLANE.name)
    normal = problem.normal(block.centred(values_of(solved.parameters)))
    S = eliminated(
        normal.matrix, normal.border, normal.local, normal.gradient, normal.local_gradient
    ).matrix
    unit = 1.0 / np.sqrt(np.einsum("kii->ki", S))
    inverse = _inverses(S * unit[:, :, None] * unit[:, None, :])
    inverse *= unit[:, :, None] * unit[:, None, :] * (problem.unit**2)[:, None, None]
    copies, beams = len(S), block.beams
    width, each = S.shape[1] // beams, np.arange(beams)
    blocks = inverse.reshape(copies, beams, width, beams, width)[:, each, :, each]
    bases = model.tangent_basis(np.concatenate([p.directions for p in solved.parameters]))
    lifts = beam_lifts(bases)[:, :, :width]
    lifts = lifts.reshape(copies, beams, 8, width).swapaxes(0, 1)
    return np.asarray((lifts @ blocks @ lifts.swapaxes(-1, -2)).swapaxes(0, 1))


def _inverses(matrices: FloatArray) -> FloatArray:
    """Return the inverses of a stack (K, n, n), NaN of those that are singular."""
    inverses = np.full_like(matrices, np.nan)
    for inverse, matrix in zip(inverses, matrices, strict=True):
        with contextlib.suppress(np.linalg.LinAlgError):
            inverse[:] = np.linalg.inv(matrix)
    return inverses


def _of_one_shape(recordings: Sequence[Recording]) -> list[Readings]:
    """Return the readings of all recordings, or refuse what is of different shapes."""
    if not isinstance(recordings, Sequence) or not recordings:
        raise InputError("no recordings", "a sequence of one or more")
    for recording in recordings:
        require_kind("a recording", recording, Recording)
    readings = [recording.readings() for recording in recordings]
    names = {(recording.beam_names, recording.plane_names) for recording in recordings}
    places = {(r.station.tobytes(), r.beam.tobytes(), r.plane.tobytes()) for r in readings}
    if len(names) > 1 or len(places) > 1:
        expected = "the same beams, planes, stations and places of readings in all"
        raise InputError("recordings of different shapes", expected)
    return readings


def _variances(noise: Noise, recording: Recording, terms: int) -> Variances:
    """Return the given noise; refuse what is not given."""
    require_kind("noise", noise, Noise)
    if terms not in (0, 1, 2):
        raise InputError(f"{terms!r} range-error terms", "0, 1 or 2")
    if noise.range_sigma is None or not (noise.poses_uncertain or noise.poses_exact):
        raise InputError(
            "noise that is not given", "a range sigma and the sigmas of the poses, zero if exact"
        )
    stations = len(recording.plane_labels)
    pose = noise.pose_covariances(stations) if noise.poses_uncertain else None
    ranges = np.full(len(recording.beam_names), noise.range_sigma)
    return Variances(ranges, noise.incidence_sigma, pose)
