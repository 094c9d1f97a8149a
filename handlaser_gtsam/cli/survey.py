"""What verbs do with a survey: other sensors, targets, and relations."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..text import count

if TYPE_CHECKING:
    from ..data.survey import Survey
    from ..errors import CalibrationWarning
    from ..files.logs.format import LogReport
    from ..files.rig_toml import Rig


def read_stated(rig: "Rig", path: Path, stated: Sequence[str]) -> "Survey | tuple[LogReport, Rig]":
    """Read a recording or a survey; refuse what is stated and does not count with the latter.

    Raises
    ------
    InputError
    """
    from ..data.survey import Survey
    from ..files.input_reading import read_any_kind

    read = read_any_kind(rig, path)
    if not isinstance(read, Survey):
        return read
    fields = {
        "max_incidence_deg": rig.sensor.max_incidence < math.pi / 2.0,
        "incidence_sigma_mm": rig.noise.incidence_sigma > 0.0,
        "rms_mm in [limits]": rig.limits.rms is not None,
    }
    found = [*stated, *(name for name, given in fields.items() if given)]
    if found:
        words = f"{', '.join(found)}, with sensors of many rays, other targets or relations"
        expected = "it with beams before planes only (errors of a sensor are `free` in [[sensors]])"
        raise InputError(words, expected, path)
    return read


def require_outputs_of(
    outputs: Mapping[str, Path | None], rig: "Rig", inputs: Sequence[Path | None]
) -> None:
    """Refuse files to write, by their options, that are an input, or that a rig file has read.

    Raises
    ------
    InputError
        Also a name that `points` with a * would take for the table of another station.
    """
    from ..files.writing import require_outputs

    require_outputs(outputs, (*inputs, *rig.log.files))
    if rig.survey is None:
        return
    require_outputs(outputs, rig.survey.files)
    for option, path in outputs.items():
        if path is not None and rig.survey.reads(path):
            found = f"{option} with a name that points in [[sensors]] takes for a table of points"
            raise InputError(found, "another name, or another folder", path)


def converted_survey(
    path: Path, rig: "Rig", out: Path | None
) -> tuple[list[str], "tuple[CalibrationWarning, ...]"]:
    """Read a log of poses with the sensors of a rig file, and write its stations where asked to.

    Returns lines of what was read, and warnings.

    Raises
    ------
    InputError
        Also a bag, which has no table of points that would stay as it is.
    """
    from ..files.logs.bags import is_bag
    from ..files.recording_csv import write_stations
    from ..files.survey_reading import read_survey

    if is_bag(path):
        expected = "a log of poses beside tables of points; the other verbs take bags as they are"
        raise InputError("a bag, with sensors of many rays", expected, path)
    require_outputs_of({"--out": out}, rig, ())
    survey = read_survey(path, rig)
    if survey.beam_names:
        found = "a recording with ranges of beams, which is no log of poses"
        raise InputError(found, "it as it is: other verbs take it", path)
    if out is not None:
        write_stations(out, survey.stations)
    sensors, points = len(survey.shots), sum(len(shots.reading) for shots in survey.shots)
    words = f"{count(len(survey.stations), 'station')}, {count(sensors, 'sensor')}, "
    words += f"{count(len(set(survey.stations.plane_labels)), 'target')}, {count(points, 'point')}"
    return [words, *survey.lines], survey.warnings
