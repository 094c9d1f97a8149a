"""Planes and stations held out of a calibration and predicted, without another calibration.

`leave_out.validate` calibrates from nothing for every part that it holds out. Here the calibration is
the start: its choice of readings, its noise and its prior of range errors stay as they are, and a few
Gauss-Newton steps lead to the solution without that part. That takes milliseconds a plane, and is the
same solution where noise and prior are given. Where they were learned from everything, the part that is
held out has contributed to them.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray
from ..checks import require_kind
from ..data.noise import Noise
from ..data.value import Value
from ..errors import GrazingBeamError, InputError, SolverError
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from .hold_out import hold_out
from .leave_out import USUAL_SPLITS, PlaneLeftOut, training_stations
from .parts import WholeSolution
from .prediction import Prediction, predicted

PLANES_SQUARED = 2000
"""Planes that are held out times all planes, at most: as many as take a second or two."""
LEAST_HELD_OUT = 10
"""Planes that are held out at least, however many there are."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HeldOut(Value):
    """How a calibration predicts parts of its own recording when it does not see them.

    Attributes
    ----------
    planes : tuple of PlaneLeftOut
        Empty where there is one plane only; some of more than forty.
    splits : tuple of Prediction
        30 % of the stations of every plane, predicted from the others.
    message : str
        Why nothing was held out; empty where something was.
    """

    planes: tuple[PlaneLeftOut, ...]
    splits: tuple[Prediction, ...]
    message: str = ""


def held_out(calibration: Calibration) -> HeldOut:
    """Predict every plane, and 30 % of all stations several times, from the rest of the recording.

    Of many planes only some are held out, evenly spread: as many as take a second or two. The splits
    are the same each time.

    Returns
    -------
    HeldOut
        Empty, with the reason, where `parts.WholeSolution.of` knows of nothing to hold out.

    Raises
    ------
    InputError
        What is no calibration.
    """
    require_kind("calibration", calibration, Calibration)
    try:
        whole = WholeSolution.of(calibration)
    except SolverError as error:
        return HeldOut((), (), str(error))
    fit, planes = calibration.fit, whole.recording.plane_names
    known = fit.range_sigma_given or bool(calibration.noise_estimate)
    sigma = fit.range_sigma if known else None
    # The cost of one plane that is held out is linear in the number of planes.
    count = len(planes)
    most = 0 if count < 2 else min(max(PLANES_SQUARED // count, LEAST_HELD_OUT), count)
    chosen = np.linspace(0, count - 1, most).round().astype(int)
    left_out = (_plane_held_out(whole, planes[p], sigma) for p in chosen)
    rng = np.random.default_rng(0)
    parts = [training_stations(whole.recording, rng) for _ in range(USUAL_SPLITS)]
    predictions = [_split(whole, training) for training in parts]
    return HeldOut(tuple(left_out), tuple(one for one in predictions if one is not None))


def _plane_held_out(whole: WholeSolution, plane: str, range_sigma: float | None) -> PlaneLeftOut:
    """Return how the beams from all other planes fit one plane; see `hold_out` for an unknown sigma."""
    mine = np.array([label == plane for label in whole.recording.plane_labels])
    try:
        at, joint = whole.known_by(~mine, solve=True)
        held, variances = whole.stations(mine)
        exact = 0.0 if variances.pose is None else None
        noise = Noise(range_sigma, exact, exact, variances.incidence_sigma, variances.pose)
        mounts = Mounts(
            joint.beam_names,
            *at.beams,
            joint.terms,
            joint.matrix(planes=[]),
            float(np.median(variances.range_sigma)),
        )
        return PlaneLeftOut(plane, hold_out(mounts, held, noise, each_beam=False), "")
    except (InputError, SolverError, GrazingBeamError) as error:
        return PlaneLeftOut(plane, None, str(error))


def _split(whole: WholeSolution, training: BoolArray) -> Prediction | None:
    """Return how the other stations are predicted; None where the training stations do not suffice."""
    try:
        at, joint = whole.known_by(training, solve=True)
        test, variances = whole.stations(~training)
        return predicted(at, joint, test, variances)
    except (InputError, SolverError, GrazingBeamError):
        return None
