"""The report of a calibration as one file: beams before planes, or a survey, which is imported then."""

from pathlib import Path
from typing import TYPE_CHECKING

from ...checks import require_kind
from ...results.calibration import Calibration
from ...results.result import Result
from ..writing import path_of, require_writable, write_text
from .options import ReportOptions
from .page import content_of, page_of, script_of, title_of
from .subject import subject_of

if TYPE_CHECKING:
    from ...results.survey import SurveyCalibration


def write_report(
    path: Path | str,
    calibration: "Calibration | SurveyCalibration",
    options: ReportOptions | None = None,
) -> None:
    """Write the report of a calibration: one HTML file that opens without network.

    Parameters
    ----------
    path : Path or str
    calibration : Calibration or SurveyCalibration
    options : ReportOptions, optional
        Limits, working distance, and where all came from. Of a survey, limits and the recording's file
        stand in the report.

    Raises
    ------
    InputError
        What is no calibration, a file that cannot be written or read, or a working distance that the
        sensor cannot read, or any beside a survey.
    """
    require_kind("calibration", calibration, Result, "handlaser_gtsam.Calibration(...)")
    target = path_of(path)
    require_writable(target)
    write_text(target, report_text(calibration, options or ReportOptions()))


def report_text(calibration: "Calibration | SurveyCalibration", options: ReportOptions) -> str:
    """Return the page; the same calibration and options make the same page.

    Raises
    ------
    InputError
        As `write_report`.
    """
    require_kind("options", options, ReportOptions)
    if not isinstance(calibration, Calibration):
        from .survey import survey_report

        return survey_report(calibration, options)
    subject = subject_of(calibration, options)
    sections, figures, result = content_of(subject)
    title = f"{subject.verdict.opening} · {title_of(options)}"
    return page_of(title, sections, figures, result=result, script=script_of("page.js"))
