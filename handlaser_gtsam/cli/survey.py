"""What verbs read and write that take recordings of beams, and surveys: other sensors or targets."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    from ..data.survey import Survey
    from ..files.logs.format import LogReport
    from ..files.rig_toml import Rig


def read_stated(rig: "Rig", path: Path, stated: Sequence[str]) -> "tuple[Survey | LogReport, Rig]":
    """Read a recording or a survey; refuse what is stated and does not count with the latter.

    Raises
    ------
    InputError
    """
    from ..data.survey import Survey
    from ..files.input_reading import read_any_kind

    read, rig = read_any_kind(rig, path)
    if not isinstance(read, Survey):
        return read, rig
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
    return read, rig


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
