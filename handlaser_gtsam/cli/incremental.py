"""handlaser calibrate --incremental: plane by plane, or target by target, and what each taught."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.recording import Recording
from ..data.survey import Survey, normal_label
from ..errors import CalibrationWarning, InputError
from ..estimation.options import CalibrationOptions
from ..model.effects import EFFECTS
from ..pipeline import calibrate
from ..progress import tell
from ..quantities import IN_MM, IN_PERCENT, SAME_OPTIMUM
from ..results.calibration import Calibration
from ..results.description.tables import Cell, Column, Table, number
from ..results.messages import warned
from ..results.survey import SurveyCalibration
from ..session.reports import Comparison, Update
from ..session.session import Session
from ..session.survey import SurveySession
from ..validation.other_recording import BeamDrift


def plane_by_plane(
    recording: Recording, noise: Noise, options: CalibrationOptions
) -> tuple[Calibration, Recording, Table, Comparison | None]:
    """Feed a recording to a session plane by plane, then compare it with the batch calibration.

    Returns
    -------
    calibration : Calibration
    recording : Recording
        The same stations, in the order of the result.
    taught : Table
        What every plane taught, and how standard deviations fell; the result comes last.
    comparison : Comparison or None
        With the batch calibration; None where the planes did not all join, and the batch stands alone.

    Raises
    ------
    InputError
        As `Session` does, or a free error for which the order of all stations counts, of planes whose
        stations take turns.
    """
    labels = recording.plane_labels
    runs = 1 + sum(one != other for one, other in pairwise(labels))
    if runs > len(recording.plane_names):
        for code in options.free:
            if EFFECTS[code].in_order:
                found = f"--free {code} plane by plane, of planes whose stations take turns"
                raise InputError(found, "all planes at once, which is without --incremental")
    session, updates = Session(noise, options), []
    planes = recording.plane_names
    for index, name in enumerate(planes):
        tell("planes", index, len(planes), f"plane {name}")
        updates.append((name, session.add(recording.plane(name))))
    rows = [
        _row(name, update.information, update.sigma, len(update.rejected), _remark(name, update))
        for name, update in updates
    ]
    tell("planes", len(planes), len(planes), "all at once")
    if not session.started or session.waiting:
        return calibrate(recording, noise, options), recording, _table(rows), None
    moved = session.moved()
    comparison = session.recalibrate()
    if comparison.changes:  # what had moved may have been noise that is known better now
        moved = session.moved()
    recording, result = session.recording(), session.calibration()
    if result.recording is None:
        result = replace(result, recording=recording)
    if moved is not None:
        result = replace(result, warnings=(_warning(moved), *result.warnings))
    sigmas = [beam.sigma for beam in result.beams.values() if beam.sigma is not None]
    if len(sigmas) == len(result.beams):
        rejected = len(result.fit.rejected)
        rows.append(_row("result", None, np.array(sigmas), rejected, comparison.message))
    return result, recording, _table(rows), comparison


def target_by_target(survey: Survey, noise: Noise) -> tuple[SurveyCalibration, Table, Comparison]:
    """Feed a survey to a session target by target, then calibrate all of it at once.

    Returns
    -------
    calibration : SurveyCalibration
        Of all stations at once.
    taught : Table
        What every target taught of the mounts, and how their standard deviations fell.
    comparison : Comparison
        How far target by target and all at once are apart; NaN where one of them has not converged.

    Raises
    ------
    InputError
        As `SurveySession` and `calibrate` do.
    """
    labels = np.array([normal_label(label) for label in survey.stations.plane_labels])
    session, rows = SurveySession(noise, survey.known), []
    names = list(dict.fromkeys(labels.tolist()))
    for index, name in enumerate(names):
        tell("planes", index, len(names), name)
        part = survey.stations_read() & (labels == name)
        if not part.any():
            rows.append(_row(name, None, None, 0, "no reading"))
            continue
        update = session.add(survey.part(part))
        rejected = 0 if session.calibration is None else len(session.calibration.rejected)
        rows.append(_row(name, update.information, update.sigma, rejected, update.message))
    tell("planes", len(names), len(names), "all at once")
    result, last = calibrate(survey, noise), session.calibration
    if last is None or not last.status == result.status == "converged":
        return result, _table(rows, "target"), Comparison(np.nan, np.nan)
    sigmas = np.array([one.sigma for one in result.mounts])
    rows.append(_row("result", None, sigmas, len(result.rejected), ""))
    off = []
    for name, sensor in result.sensors.items():
        mine = last.sensors[name]
        turn = Rotation.from_matrix(sensor.rotation.T @ mine.rotation).as_rotvec()
        off += [*(mine.location - sensor.location) / sensor.location_sigma]
        off += [*turn / sensor.rotation_sigma]
    for name, beam in result.beams.items():
        mine_beam = last.beams[name]
        off += [*(mine_beam.location - beam.location) / beam.location_sigma]
        off += [*(mine_beam.direction - beam.direction) / beam.direction_sigma]
    own = {one.subject: one.sigma for one in last.mounts}
    ratios = np.array([own[one.subject] for one in result.mounts]) / sigmas
    largest = float(np.abs(off).max()), float(np.abs(ratios - 1.0).max())
    return result, _table(rows, "target"), Comparison(*largest)


def _table(rows: Sequence[tuple[Cell, ...]], what: str = "plane") -> Table:
    titles = ("learnt [nats]", "sigma r [mm]", "sigma v [deg]", "rejected")
    columns = Column(what, number=False), *map(Column, titles), Column("notes", number=False)
    return Table(f"{what} by {what}", "", columns, tuple(rows))


def _warning(moved: BeamDrift) -> CalibrationWarning:
    shift, far = float(np.linalg.norm(moved.shift)), bool(np.isnan(moved.turn))
    by = f"by {np.degrees(moved.turn):.2g} deg and {IN_MM * shift:.2g} mm"
    values: dict[str, float | str] = {"beam": moved.name, "since": moved.since}
    values |= {} if far else {"shift_m": shift, "turn_rad": moved.turn}
    return warned("beam-moved", values, how="far" if far else by)


def _row(
    name: str, information: float | None, sigma: FloatArray | None, rejected: int, remark: str
) -> tuple[Cell, ...]:
    largest: tuple[float | None, float | None] = None, None
    if sigma is not None:
        largest = IN_MM * float(sigma[:, :3].max()), float(np.degrees(sigma[:, 3:6].max()))
    sizes = number(information, 2), *(number(value, 4) for value in largest)
    return Cell(name), *sizes, Cell(str(rejected or "")), Cell(remark)


def comparison_words(comparison: Comparison, what: str) -> tuple[str, str]:
    """Say how far plane by plane, or target by target, and all at once are apart.

    And that they are not the same optimum; nothing where they are.
    """
    if np.isnan(comparison.largest):
        return f"{what} by {what} and all at once cannot be compared: one has not converged", ""
    largest = f"{comparison.largest:.2g} standard deviations"
    line = (
        f"{what} by {what} and all at once agree to {largest}; the standard deviations agree to "
        f"{IN_PERCENT * comparison.largest_sigma:.2g} %"
    )
    apart = comparison.largest > SAME_OPTIMUM
    return line, f"{what} by {what} is {largest} from all at once" if apart else ""


def _remark(name: str, update: Update) -> str:
    moved, comparison = update.moved, update.comparison
    words = ["waits for more" if name in update.waiting else ""]
    if moved is not None:
        words.append(f"beam {moved.name} has moved before plane {moved.since}")
    words.append("does not fit, and waits" if update.inconsistent else "")
    words.append("" if comparison is None else comparison.message)
    return "; ".join(filter(None, words))
