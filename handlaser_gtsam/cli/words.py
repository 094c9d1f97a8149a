"""What a person sees of plans and validations: texts from the templates of this folder, a line each."""

import math
from collections import Counter
from typing import TYPE_CHECKING

from ..files.exports.rendering import environment
from ..model.distributions import FAMILY_LEVEL, SINGLE_LEVEL, chance, p_words
from ..quantities import IN_DEG, IN_MM
from ..text import count

if TYPE_CHECKING:
    from ..data.station_list import StationList
    from ..planning.goal import Goal
    from ..planning.robot import Robot
    from ..planning.route import Plan
    from ..results.verdict import Verdict
    from ..validation.other_recording import HoldOut
    from ..validation.other_survey import SurveyHoldOut
    from ..validation.validation import Validation

SHOWN_ROWS = 10
"""Rows of the forecast, evenly over the stations, and stations whose poses are shown at most: they fit
on a screen beside the rest."""


def _in(unit: float, value: float, digits: int, most: float = math.inf) -> str:
    """Return a number in a unit; or that it is unknown, at least as large as what is shown at most."""
    known = most == math.inf or (math.isfinite(value) and value * unit < most)
    return f"{value * unit:.{digits}g}" if known else "unknown"


def lines_of(template: str, **values: object) -> list[str]:
    """Return the lines of a template; its filters say numbers, sizes of errors and counts."""
    templates = environment(
        __package__,
        count=count,
        chance=chance,
        p_words=p_words,
        mm=lambda value, *how: _in(IN_MM, value, *how),
        deg=lambda value, *how: _in(IN_DEG, value, *how),
        length_of=lambda vector: math.hypot(*vector),
        size=lambda errors: (
            f"rms {_in(IN_MM, errors.rms, 4)} mm, largest {_in(IN_MM, errors.max_residual, 4)} mm"
        ),
    )
    return templates.get_template(f"{template}.j2").render(**values).splitlines()


def plan_lines(plan: "Plan", goal: "Goal", robot: "Robot | None") -> list[str]:
    """Return where to go, what will be known, whether that is enough, and what ways were checked."""
    from ..planning.route import VIA

    labels, forecast, last = plan.stations.plane_labels, plan.forecast, len(plan.forecast)
    looks = [
        f"{sensor} before {_target(label)}".lstrip()
        for sensor, label, read in zip(
            plan.sensors or [""] * len(labels), labels, plan.read, strict=True
        )
        if read
    ]
    of = "of " if plan.sensors else ""
    shown = {round(last * index / (SHOWN_ROWS - 1)) for index in range(SHOWN_ROWS)}
    return lines_of(
        "plan",
        plan=plan,
        where=", ".join(f"{number} {of}{look}" for look, number in Counter(looks).items()),
        looks=looks if len({*plan.sensors} - {""}) > 1 else [],
        passed=len(labels) - len(plan),
        via=VIA,
        forecast=forecast,
        rows=sorted(shown | {last}),
        most=999.0,  # mm, deg: nothing has determined a standard deviation that is larger
        goal=goal,
        robot=robot,
    )


def _target(label: str) -> str:
    """Return what a label stands for, in words: a plane where it names no kind."""
    return label if ":" in label else f"plane {label}"


def station_lines(stations: "StationList") -> list[str]:
    """Return where the stations of a plan are that is not written; of many, that --out writes them."""
    from ..planning.advice import pose_words

    before = map(_target, stations.plane_labels)
    named = zip(stations.station_names, before, pose_words(stations), strict=True)
    return lines_of("stations", stations=stations, named=named, most=SHOWN_ROWS)


def validation_lines(result: "Validation", verdict: "Verdict", width: int) -> list[str]:
    """Return the lines of a validation, the verdict first."""
    from ..results.calibration import Calibration
    from ..results.description.tables import full_table
    from ..validation.prediction import pooled

    calibration = result.calibration
    lines = lines_of(
        "validation",
        result=result,
        verdict=verdict,
        family_level=FAMILY_LEVEL,
        every=pooled(result.predictions),
    )
    if isinstance(calibration, Calibration):
        tested = calibration.described(verdict).systematic
        lines += full_table("systematic errors", tested, width)
    return lines + [f"WARNING: {warning}" for warning in calibration.warnings]


def hold_out_lines(found: "HoldOut | SurveyHoldOut", words: str = "hold_out") -> list[str]:
    """Return the lines of a hold-out test: whether the calibration holds, and what p means, first."""
    return lines_of(words, found=found, level=SINGLE_LEVEL, family_level=FAMILY_LEVEL)
