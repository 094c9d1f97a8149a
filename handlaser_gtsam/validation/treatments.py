"""How a study solves many recordings: one by one by `calibrate`, or together by the reduction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.parameters import Beams
from ..data.recording import Recording
from ..data.value import Value
from ..errors import HandlaserError
from ..estimation.many_recordings import solve_many
from ..estimation.options import CalibrationOptions
from ..pipeline import calibrate


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimated(Value):
    """Beams of one recording as a treatment estimates them.

    Attributes
    ----------
    beams : Beams
        Locations (B, 3), directions (B, 3) and range errors (B, 2).
    covariances : (B, 8, 8)
        Of (x, y, z, vx, vy, vz, k1, k2) of every beam; NaN where it has none.
    status : str
        "converged", or what it is instead.
    iterations : int
    codes : tuple of str
        Of warnings.
    """

    beams: Beams
    covariances: FloatArray
    status: str
    iterations: int
    codes: tuple[str, ...] = ()


def calibrate_each(
    recordings: Sequence[Recording],
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
) -> list[Estimated | HandlaserError]:
    """Solve recordings one after the other by `calibrate`."""
    estimates: list[Estimated | HandlaserError] = []
    for recording in recordings:
        try:
            result = calibrate(recording, noise, options)
        except HandlaserError as error:
            estimates.append(error)
            continue
        none = np.full((8, 8), np.nan)
        covariances = [
            none if beam.covariance is None else beam.covariance for beam in result.beams.values()
        ]
        codes = tuple(warning.code for warning in result.warnings)
        beams = result.parameters().beams
        estimates.append(
            Estimated(beams, np.array(covariances), result.status, result.iterations, codes)
        )
    return estimates


def reduce_together(
    recordings: Sequence[Recording], noise: Noise, terms: int = 0
) -> list[Estimated | HandlaserError]:
    """Solve recordings together by `solve_many`: those with readings at the same places at once."""
    shapes: dict[tuple[object, ...], list[int]] = {}
    for i, recording in enumerate(recordings):
        read = (~np.isnan(recording.ranges)).tobytes()
        shapes.setdefault((read, recording.beam_names, recording.plane_labels), []).append(i)
    estimates: dict[int, Estimated | HandlaserError] = {}
    for members in shapes.values():
        try:
            solved = solve_many([recordings[i] for i in members], noise, terms)
        except HandlaserError as error:
            estimates |= dict.fromkeys(members, error)
            continue
        for k, i in enumerate(members):
            status = "converged" if solved.converged[k] else "stalled"
            beams = solved.parameters[k].beams
            estimates[i] = Estimated(
                beams, solved.covariances[k], status, int(solved.iterations[k])
            )
    return [estimates[i] for i in range(len(recordings))]
