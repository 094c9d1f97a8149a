"""The settings of iSAM2: thresholds in natural units, and steps that reach every variable."""

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors.keys import BeamKeys

WITH_THE_OTHERS = 0.05
"""What has moved by more than this part of its threshold is linearised anew once another must be."""
NEVER = 1_000_000_000
"""Updates between relinearisations of iSAM2's own: the session says when to linearise."""


def thresholds(
    part: float, length: float, beams: tuple[BeamKeys, ...], terms: tuple[int, ...]
) -> dict[str, FloatArray]:
    """Return by how much the variables of each letter may move before they are linearised anew."""
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
    """Return parameters with which only `IncrementalGraph` decides when to linearise anew."""
    fine = gtsam.ISAM2ThresholdMap()
    for letter, threshold in thresholds.items():
        fine.insert((letter, WITH_THE_OTHERS * threshold))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(fine)
    parameters.relinearizeSkip = NEVER
    steps = gtsam.ISAM2GaussNewtonParams()
    steps.setWildfireThreshold(0.0)
    parameters.setOptimizationParams(steps)
    return parameters


def letter(key: int) -> str:
    """Return the letter of a key, to which iSAM2 has one threshold."""
    return chr(gtsam.symbolChr(key))
