"""The settings of iSAM2: thresholds in natural units, and steps that reach every variable."""

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors.keys import BeamKeys

FINE_PART = 0.05
"""Once one variable must be relinearised, all are that have moved by this part of their threshold."""


def thresholds(
    part: float, length: float, beams: tuple[BeamKeys, ...], terms: tuple[int, ...]
) -> dict[str, FloatArray]:
    """Return by how much the variables of each letter may move before they are relinearised."""
    units = {"p": [1.0, 1.0, length], "x": [1.0] * 3 + [length] * 3}
    for beam, count in zip(beams, terms, strict=True):
        units[letter(beam.location)] = [length] * 3
        units[letter(beam.direction)] = [1.0, 1.0]
        if beam.range_error is not None:
            unit = [1.0, 1.0 / length][:count]
            if len(units.setdefault(letter(beam.range_error), unit)) != count:
                raise ValueError("one letter for range errors of one term and of two")
    return {letter: part * np.array(unit) for letter, unit in units.items()}


def isam_parameters(thresholds: dict[str, FloatArray]) -> gtsam.ISAM2Params:
    """Return parameters with which only `IncrementalGraph` decides when to relinearise."""
    fine = gtsam.ISAM2ThresholdMap()
    for letter, threshold in thresholds.items():
        fine.insert((letter, FINE_PART * threshold))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(fine)
    parameters.relinearizeSkip = int(np.iinfo(np.int32).max)  # iSAM2 never does it by itself
    steps = gtsam.ISAM2GaussNewtonParams()
    steps.setWildfireThreshold(0.0)
    parameters.setOptimizationParams(steps)
    return parameters


def letter(key: int) -> str:
    """Return the letter of a key, to which iSAM2 has one threshold."""
    return chr(gtsam.symbolChr(key))
