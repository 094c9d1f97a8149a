"""What a survey leaves undetermined, in words: by the kind of its motion, by circles, or one by one."""

from collections.abc import Iterator, Mapping

import numpy as np

from ..arrays import FloatArray
from ..data.readings import Readings
from ..estimation.estimate import Estimate
from ..estimation.survey_rows import Rows
from ..model.families import BEAM, FAMILIES, PLANE, bases
from ..model.known import BODY
from ..model.sensors.mounted import SENSOR
from ..model.targets.sphere import SPHERE
from ..observability.poor_motion import COUNTED_TURN, SIGNIFICANT, PoorMotion, named, poor_motion
from ..observability.wording import WORTH_A_WORD, Kind, OpenPart, vector_words

ON_ONE_CIRCLE = 0.02
"""Normals are on one circle about a direction if their spread along it is below this."""
CURE_OF_A_CIRCLE = "tilt it by another angle, or add a second plane"
"""What determines a sensor whose normals lie on one circle."""


def open_words(
    rows: Rows, found: Estimate, null: FloatArray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Say what moves along directions that are undetermined, and what determines it.

    Parameters
    ----------
    rows : Rows
    found : Estimate
    null : (N, q)
        Orthonormal, in natural units.

    Returns
    -------
    undetermined, advice : tuples of str
    """
    if not null.shape[1]:
        return (), ()
    parts = tuple(_parts(rows, found.values, null))
    motion = motion_of(rows)
    circles = tuple(on_one_circle(rows, found.values)) if motion is None else ()
    if len(circles) == null.shape[1]:
        return circles, (CURE_OF_A_CIRCLE,)
    errors = any(part.quantity == "range error" for part in parts)
    leans = motion is None or _leans(rows, found, motion)
    mount = SENSOR.name if rows.survey.shots else BEAM.name
    return named(motion, parts, leans=leans, k1_free=errors, mount=mount)


def _leans(rows: Rows, found: Estimate, motion: PoorMotion) -> bool:
    """Tell whether a target is known to look different at other heights: a leaning plane, a ball."""
    for target, number in _numbers(rows).items():
        if target[0] != PLANE.name:
            return True
        n, up = found.values[PLANE.name][target[1], :3], motion.upright[number]
        slope = up @ bases(n)
        sigma = np.sqrt(slope @ found.marginal(*target)[:2, :2] @ slope)
        # It is NaN where the lean is undetermined.
        if abs(n @ up) > np.sin(COUNTED_TURN) and abs(n @ up) > SIGNIFICANT * sigma:
            return True
    return False


def _numbers(rows: Rows) -> dict[tuple[str, int], int]:
    """Return numbers of the targets, in the order in which they are seen."""
    return {x: n for n, x in enumerate(dict.fromkeys(item.target for item in rows.items))}


def motion_of(rows: Rows) -> PoorMotion | None:
    """Return the kind of a motion that is poor before any targets; None of any other."""
    # A reading for each target and station only says where the hand was before it.
    numbers = _numbers(rows)
    seen = sorted({(numbers[item.target], item.station) for item in rows.items})
    plane, station = np.array(seen).T
    of = rows.survey.stations
    readings = Readings(
        station,
        np.zeros_like(station),
        plane,
        np.full(len(seen), rows.length),
        of.world_R_hand[station],
        of.world_t_hand[station],
        1,
        len(numbers),
    )
    return poor_motion(readings)


def _parts(rows: Rows, values: Mapping[str, FloatArray], null: FloatArray) -> Iterator[OpenPart]:
    """Yield what directions (N, q), orthonormal in natural units, move of every mount and target."""
    of = rows.places()
    for family, place in of.place.items():
        for member, first in enumerate(place.tolist()):
            x = values[family][member]
            moved = np.zeros((FAMILIES[family].dim, null.shape[1]))
            moved[of.free[family]] = null[first + np.arange(len(of.free[family]))]
            kind, name, quantities = _quantities(rows, family, member, x, moved)
            for quantity, columns in quantities.items():
                axes, size, _ = np.linalg.svd(columns, full_matrices=False)
                axes = axes[:, size > WORTH_A_WORD]
                if axes.shape[1]:
                    yield OpenPart(kind, name, quantity, axes)


def _quantities(
    rows: Rows, family: str, member: int, x: FloatArray, moved: FloatArray
) -> tuple[Kind, str, dict[str, FloatArray]]:
    """Return kind and name of a variable, and what steps (dim, q) of it are, by quantity."""
    if family == SENSOR.name:
        R = x[:9].reshape(3, 3)
        parts = {"location": R @ moved[3:6], "turn": R @ moved[:3], "range error": moved[6:]}
        return "sensor", rows.survey.shots[member].name, parts
    if family == BEAM.name:
        direction = bases(x[3:6]) @ moved[3:5]
        parts = {"location": moved[:3], "direction": direction, "range error": moved[5:]}
        return "beam", rows.survey.beam_names[member], parts
    if family == PLANE.name:
        parts = {"normal": bases(x[:3]) @ moved[:2], "offset": moved[2:]}
        return "plane", _name_of(rows, family, member), parts
    if family == BODY.name:
        return "body", f"of {rows.bodies[member].of[0]}", {"place": moved}
    kind: Kind = "sphere" if family == SPHERE.name else "point"
    parts = {"place": moved[:3], "radius": moved[3:]}
    return kind, _name_of(rows, family, member), parts


def _name_of(rows: Rows, family: str, member: int) -> str:
    """Return the name of a target without its kind."""
    return rows.label((family, member)).partition(":")[2]


def on_one_circle(rows: Rows, values: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield sensors that saw one plane whose normals, in their frame, lie on one circle."""
    stations = rows.survey.stations
    for member, shots in enumerate(rows.survey.shots):
        own = [i for i in rows.items if (i.family, i.member) == (SENSOR.name, member)]
        planes = {i.target for i in own}
        if len(planes) != 1 or next(iter(planes))[0] != PLANE.name:
            continue
        n = values[PLANE.name][next(iter(planes))[1], :3]
        station = [i.station for i in own]
        X = values[SENSOR.name][member, :9].reshape(3, 3)
        m = np.einsum("sij,i->sj", stations.world_R_hand[station], n) @ X
        spread, axes = np.linalg.svd(m - m.mean(axis=0), full_matrices=False)[1:]
        if spread[-1] < ON_ONE_CIRCLE * np.sqrt(len(m)):
            yield (
                f"{shots.name} saw its plane at one angle to the direction "
                f"{vector_words(axes[-1])} of its own frame "
                "throughout, as on a cone or in turns about one axis: its shift along it and the "
                "offset of the plane are one number"
            )
