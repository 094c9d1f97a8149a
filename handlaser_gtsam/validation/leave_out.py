"""Parts of a recording that the rest of it predicts.

A part is a plane or another target, or a random choice of the stations. The same types hold what was
found of beams before planes and of surveys.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, IntArray
from ..data.value import Value
from ..errors import HandlaserError
from ..progress import tell
from .other_recording import HoldOut
from .prediction import Prediction, SurveyPrediction

PART_LEFT_OUT = 0.3
"""Part of the stations that a random split predicts; before planes, of the stations of every plane."""
USUAL_SPLITS = 5
"""Random splits of the stations: enough to see how predictions scatter; each takes a calibration."""
Predicted = HoldOut | Prediction | SurveyPrediction
"""How the rest predicts a part."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LeftOut(Value):
    """A part of a recording, and how a calibration without it predicts it.

    Attributes
    ----------
    name : str
        The label of a target, or the number of a random split.
    result : HoldOut, Prediction, SurveyPrediction or None
        A `HoldOut` of a plane that beams see, a `Prediction` of a random split of such a recording, a
        `SurveyPrediction` of any part of a survey. None where there is no prediction.
    message : str
        Why there is none.
    """

    name: str
    result: Predicted | None
    message: str = ""

    @property
    def p_value(self) -> float:
        """Probability that chance makes the part differ more from the rest; NaN without a test."""
        found = self.result
        return found.p_value if isinstance(found, HoldOut | SurveyPrediction) else math.nan


def leave_out(
    targets: Mapping[str, BoolArray],
    splits: Iterable[BoolArray],
    of_target: Callable[[BoolArray], Predicted],
    of_split: Callable[[BoolArray], Predicted],
    total: int,
    *,
    kind: str = "",
) -> tuple[tuple[LeftOut, ...], tuple[LeftOut, ...]]:
    """Predict targets, and random splits, from what is left without each.

    Parameters
    ----------
    targets : mapping of str to (M,) of bool
        The stations before each target.
    splits : iterable of (M,) of bool
        The stations that each leaves out.
    of_target, of_split : callable
        Predict such stations from the others; a HandlaserError says why that cannot be.
    total : int
        How many steps the progress counts, with what precedes and follows.
    kind : str
        What precedes the name of a target in the progress.

    Returns
    -------
    targets, splits : tuple of LeftOut
    """

    def predicted(name: str, predict: Callable[[BoolArray], Predicted], out: BoolArray) -> LeftOut:
        try:
            return LeftOut(name, predict(out))
        except HandlaserError as error:
            return LeftOut(name, None, str(error))

    found, drawn = [], []
    for done, (name, out) in enumerate(targets.items(), 1):
        tell("leave-out", done, total, f"without {kind}{name}")
        found.append(predicted(name, of_target, out))
    for number, out in enumerate(splits, 1):
        tell("leave-out", len(targets) + number, total, f"split {number}")
        drawn.append(predicted(f"{number}", of_split, out))
    return tuple(found), tuple(drawn)


def drawn(groups: IntArray, rng: np.random.Generator) -> BoolArray:
    """Return which of N stations, or stops, a random split leaves out: 30 % of every group (N,)."""
    out = np.zeros(len(groups), dtype=bool)
    for group in np.unique(groups):
        members = rng.permutation(np.flatnonzero(groups == group))
        out[members[: round(PART_LEFT_OUT * len(members))]] = True
    return out
