"""How well a calibration agrees with readings that it has not seen: of single planes, or of splits.

A reading that was rejected as an outlier of the whole recording stays rejected.
"""

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.recording import Recording
from ..data.survey import Survey
from ..errors import InputError, SolverError
from ..estimation.options import CalibrationOptions
from ..pipeline import calibrate, calibrate_from
from ..progress import Listener, tell, told_to
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from .leave_out import USUAL_SPLITS, drawn, leave_out
from .other_recording import HoldOut, hold_out
from .prediction import Prediction, predict, reconstruction
from .simulate import generator
from .survey import validate_survey
from .validation import Validation


def validate(
    recording: Recording | Survey,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    *,
    splits: int = USUAL_SPLITS,
    rng: np.random.Generator | None = None,
    progress: Listener | None = None,
) -> Validation:
    """Validate the calibration of a recording by leaving parts of it out.

    A survey is solved again by SciPy, too.

    Parameters
    ----------
    recording : Recording or Survey
        Beams before planes; or sensors of many rays, spheres, points and relations (then there are no
        options).
    noise : Noise, optional
    options : CalibrationOptions, optional
    splits : int
        Random 70/30 splits.
    rng : numpy.random.Generator, optional
        Chooses the splits; the same ones each time where not given.
    progress : callable, optional
        Called with a `Progress` before every calibration, and in every phase of each.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        The whole recording gives no calibration.
    """
    require_count("splits", splits, 0, 10**9)
    rng, noise = generator(rng), Noise() if noise is None else noise
    with told_to(progress):
        if isinstance(recording, Survey):
            if options is not None:
                raise InputError("options with a survey", "its own fields, such as free")
            return validate_survey(recording, noise, splits, rng)
        require_kind("recording", recording, Recording)
        options = CalibrationOptions() if options is None else options
        planes = recording.plane_names if len(recording.plane_names) > 1 else ()
        total = 2 + len(planes) + splits
        tell("leave-out", 0, total, "everything")
        whole = _ended(calibrate(recording, noise, options))
        if whole.status != "converged":
            raise SolverError(f"no calibration to validate: {whole.message}")
        kept = whole.used_in(recording)
        # Errors that are unknowns are taken out of all readings as the whole recording has them.
        keep = replace(options, outliers="keep", free=())

        def rest(out: BoolArray) -> Calibration:
            found = _ended(calibrate(*_part(kept, noise, ~out), keep))
            if found.status != "converged":
                raise SolverError(found.message)
            return found

        def of_plane(out: BoolArray) -> HoldOut:
            others, (held, seen) = rest(out), _part(kept, noise, out)
            seen = others.noise(seen) if others.noise_estimate else seen
            return hold_out(Mounts.of(others), held, seen)

        def of_split(out: BoolArray) -> Prediction:
            return predict(rest(out), *_part(kept, noise, out))

        labels = np.array(kept.plane_labels)
        stations = {plane: labels == plane for plane in planes}
        draws = (drawn(kept.plane_of_station, rng) for _ in range(splits))
        parts = leave_out(stations, draws, of_plane, of_split, total, kind="plane ")
        tell("leave-out", total - 1, total, "without range error")
        bare = _ended(
            calibrate_from(whole.parameters(), kept, noise, replace(keep, range_error="none"))
        )
        chosen, without = (reconstruction(one, kept) for one in (whole, bare))
        both = () if chosen is None or without is None else (chosen, without)
        return Validation(whole, *parts, both)


def _ended(calibration: Calibration) -> Calibration:
    """Return a calibration; Ctrl-C in it ends everything."""
    if calibration.interrupted:
        raise KeyboardInterrupt
    return calibration


def _part(recording: Recording, noise: Noise, stations: BoolArray) -> tuple[Recording, Noise]:
    """Return some stations, with their beams that read anything, and their noise."""
    rows = np.flatnonzero(stations & ~np.isnan(recording.ranges).all(axis=1))
    S = noise.pose_covariance
    seen = noise if S is None or S.ndim == 2 else replace(noise, pose_covariance=S[rows])
    return recording.part(rows), seen
