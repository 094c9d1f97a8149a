"""What a survey leaves undetermined, in words: by the kind of its motion, by circles, or one by one."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import cast

import numpy as np

from ..arrays import FloatArray
from ..data.screening import BY_CHANCE
from ..data.survey import RAY_ERRORS
from ..estimation.estimate import Estimate
from ..estimation.survey_mirror import motion_of, numbers_of
from ..estimation.survey_rows import SurveyRows, blocks_of
from ..model.distributions import FEW_DEGREES
from ..model.families import BEAM, DIRECTION, FAMILIES, PLANE, RANGE_ERROR, bases, pose_of
from ..model.relation import BODY
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets.sphere import SPHERE
from ..observability.motion import COUNTED_TURN, PoorMotion, named
from ..observability.wording import (
    MOUNTED,
    WORTH_A_WORD,
    Kind,
    OpenPart,
    open_sentence,
    vector_words,
)
from ..quantities import FAR_SIGMAS, IN_DEG, NEGLIGIBLE
from ..text import some
from .lines import NAMES_IN_LINE
from .messages import said

CURE_OF_A_CIRCLE = "tilt it by another angle, or add a second plane"
"""What determines a sensor whose normals lie on one circle."""
CURE_OF_A_LINE = "see the ball off the middle of the view, to several sides of it"
"""What determines a sensor for which the middles of balls lie on one line."""

MORE_STATIONS = "measure at more stations"
"""What determines more where numbers are hardly more than unknowns: the first advice, where the hand
turns about two axes."""
NOT_OF_MOTION = frozenset((*RAY_ERRORS, *BEAM.coordinates[RANGE_ERROR]))
"""Coordinates that do not count among the unknowns that a motion has to determine."""


def open_words(
    rows: SurveyRows, found: Estimate, null: FloatArray, images: Mapping[tuple[str, int], float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Say what moves along directions that are undetermined, and what determines it.

    Parameters
    ----------
    rows : SurveyRows
    found : Estimate
    null : (N, q)
        Orthonormal, in natural units.
    images : mapping
        Turn [rad] of each (family, number) to its mirror image, where that fits as well.

    Returns
    -------
    undetermined, advice : tuples of str
    """
    what, cures = _words_of_images(rows, images)
    parts = tuple(_parts(rows, found.values, null))
    within = set(_within_their_cones(rows, found)) if rows.survey.cones.any() else set()
    unheard = [p for p in parts if p.quantity == "direction" and p.name in within]
    if unheard:
        names = some([part.name for part in unheard], 6)
        what += (said("open:cone", names=names),)
        cures += (said("cure:cone", angle=rows.survey.cones.max()),)
        parts = tuple(part for part in parts if part not in unheard)
    if not parts:
        return what, cures
    motion = motion_of(rows)
    circles = tuple(_on_one_circle(rows, found.values)) if motion is None else ()
    turned = {p.name: p for p in parts if p.quantity == "turn" and p.axes.shape[1] == 1}
    on_line = _on_one_line(rows, found.values)
    numbers, unknowns = counts_of(rows)
    enough = numbers >= unknowns
    lines = {name: words for name, words in on_line.items() if enough and name in turned}
    if motion is None and len(circles) + len(lines) == null.shape[1]:
        why = (CURE_OF_A_CIRCLE, circles), (CURE_OF_A_LINE, lines)
        return (*circles, *lines.values()), tuple(cure for cure, said_of in why if said_of)
    if lines:
        what, cures = (*what, *lines.values()), (*cures, CURE_OF_A_LINE)
        parts = tuple(p for p in parts if p.quantity != "turn" or p.name not in lines)
    if motion is not None and motion.turning and _mounts_are_stated(rows, parts):
        up = vector_words(motion.axis)
        return (said("open:stated", up=up), *what), (said("cure:stated", up=up), *cures)
    level = {} if motion is None else _level(rows, found, motion, images)
    if motion is not None and level:
        names = some([f"{kind} {name}" for name, kind in level.items()], NAMES_IN_LINE)
        up, one = vector_words(motion.axis), len(level) == 1
        lean, them = ("it leans", "it") if one else ("they lean", "them")
        what = (said("open:level", names=names, up=up, lean=lean), *what)
        cures = (*cures, said("cure:level", them=them, up=up))
        parts = tuple(part for part in parts if part.kind in MOUNTED and part.name not in level)
        if not parts:
            return what, cures
    errors = any(part.quantity == "range error" for part in parts)
    leans = motion is None or _leans(rows, found, motion, images)
    mount = SENSOR.name if rows.survey.shots else BEAM.name
    moving, others = named(motion, parts, leans=leans, k1_free=errors, mount=mount, enough=enough)
    if not enough:
        return (*moving, *what), (MORE_STATIONS, *cures, *(others if motion is not None else ()))
    if motion is None and numbers < unknowns + FEW_DEGREES:
        # The hand turns about two axes, and that is not what is missing most.
        return (*moving, *what), (MORE_STATIONS, *cures, *others)
    return (*moving, *what), (*cures, *others)


def counts_of(rows: SurveyRows) -> tuple[int, int]:
    """Return how many numbers all shots say, and how many unknowns a motion has to determine."""
    names = rows.places().names
    unknowns = sum(name.rpartition(".")[2] not in NOT_OF_MOTION for name in names)
    return sum(item.numbers for item in rows.items), unknowns


def unconfirmed_mount(rows: SurveyRows) -> str:
    """Say that no shot can be spared, so that nothing tells the mount from another one; else empty.

    Far from the truth there are minima that fit as many numbers as there are unknowns. The numbers of
    one more shot contradict them. Relations do so, too, and beams are judged one by one.
    """
    if rows.known or not rows.survey.shots:
        return ""
    numbers, unknowns = counts_of(rows)
    largest = max(item.numbers for item in rows.items)
    return "whether another mount fits as well" if numbers - largest < unknowns else ""


def leaves_open(
    numbers: int, unknowns: int, undetermined: tuple[str, ...], advice: tuple[str, ...]
) -> str:
    """Return what the motion, or too few stations, leave open, and what determines it."""
    if advice[:1] != (MORE_STATIONS,):
        return open_sentence(undetermined, advice)
    few = f"too few stations, {numbers} numbers from shots for {unknowns} unknowns, leave open"
    return open_sentence(undetermined, advice, few)


def _words_of_images(
    rows: SurveyRows, images: Mapping[tuple[str, int], float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Say what has a mirror image in the plane of the motion, and what tells the two apart."""
    kinds = {SENSOR.name: "flat sensor", BEAM.name: "beam"}
    mounts = [one for one in images if one[0] in kinds]
    names = {one: f"{kinds[one[0]]} {_name_of(rows, *one)}" for one in mounts}
    image = "its mirror image in the plane of the motion fits as well"
    if not names and images:
        planes = some([_name_of(rows, *target) for target in images], 6)
        return (f"which way planes {planes} lean: {image}",), (said("cure:mirrored-planes"),)
    # A relation tells the images apart where it makes chi2 of the false one far larger, and of all that
    # is nearer to it than to the true one, where readings with much noise hardly tell a lean.
    cures = [
        said("cure:mirrored-mount", name=name, sigma=0.5 * images[mount] * IN_DEG / FAR_SIGMAS)
        for mount, name in names.items()
    ]
    return tuple(f"which way up {name} is: {image}" for name in names.values()), tuple(cures)


def _mounts_are_stated(rows: SurveyRows, parts: Sequence[OpenPart]) -> bool:
    """Tell whether nothing moves but planes, and mounts that are stated as far as they are known.

    Planes that are seen at fewer than three stops are not: they lack stations.
    """
    stated = {rows.entities(one)[0] for one in rows.known if one.relation == "mount"}
    names = {(family, rows.label((family, member))) for family, member in stated}
    seen = {(item.target, int(rows.stops[item.station])) for item in rows.items}
    stops = Counter(_name_of(rows, *target) for target, _ in seen if target[0] == PLANE.name)
    moved = (
        stops[p.name] >= BY_CHANCE if p.kind == PLANE.name else (p.kind, p.name) in names
        for p in parts
    )
    return bool(names) and all(moved)


def _level(
    rows: SurveyRows,
    found: Estimate,
    motion: PoorMotion,
    images: Mapping[tuple[str, int], float],
) -> dict[str, str]:
    """Return the flat sensors whose rays lie in the plane of a planar motion, with their kinds.

    They cut planes at one height, wherever that is and however the planes lean. A sensor that leans a
    little shows it by the square of its lean.
    """
    if motion.kind != "planar":
        return {}
    level: dict[str, str] = {}
    for member, shots in enumerate(rows.survey.shots):
        own = [i for i in rows.items if i.mount == (SENSOR.name, member)]
        kind = KINDS[shots.kind]
        if not kind.flat or any(i.target[0] != PLANE.name for i in own):
            continue
        across = pose_of(found.values[SENSOR.name][member])[0][:, kind.across]
        lean = float(np.arccos(np.clip(abs(across @ motion.axis), 0.0, 1.0)))
        C = found.marginal(SENSOR.name, member)[:3, :3]
        # It is NaN where the lean is undetermined, or where the mirror image fits as well.
        sigma = float(np.sqrt(np.delete(np.diagonal(C), kind.across).max()))
        known = lean > FAR_SIGMAS * sigma or (SENSOR.name, member) in images
        # Rays that lean less than this [rad] out of the plane of a motion may be level: where the
        # lean is undetermined, noise alone makes it appear so large.
        if lean < COUNTED_TURN or (lean < np.radians(5.0) and not known):
            level[shots.name] = shots.kind
    return level


def _leans(
    rows: SurveyRows,
    found: Estimate,
    motion: PoorMotion,
    images: Mapping[tuple[str, int], float],
) -> bool:
    """Tell whether a target is known to look different at other heights: a leaning plane, a ball."""
    for target, number in numbers_of(rows).items():
        # The mirror image of a plane that leans is another plane.
        if target[0] != PLANE.name or target in images:
            return True
        n, up = found.values[PLANE.name][target[1], :3], motion.upright[number]
        slope = up @ bases(n)
        sigma = np.sqrt(slope @ found.marginal(*target)[:2, :2] @ slope)
        # It is NaN where the lean is undetermined.
        if abs(n @ up) > np.sin(COUNTED_TURN) and abs(n @ up) > FAR_SIGMAS * sigma:
            return True
    return False


def _parts(
    rows: SurveyRows, values: Mapping[str, FloatArray], null: FloatArray
) -> Iterator[OpenPart]:
    """Yield what directions (N, q), orthonormal in natural units, move of every mount and target."""
    of = rows.places()
    for family, place in of.place.items():
        for member, first in enumerate(place.tolist()):
            x = values[family][member]
            moved = np.zeros((FAMILIES[family].dim, null.shape[1]))
            moved[of.free[family]] = null[first + np.arange(len(of.free[family]))]
            for quantity, columns in _quantities(family, x, moved).items():
                axes, size, _ = np.linalg.svd(columns, full_matrices=False)
                axes = axes[:, size > WORTH_A_WORD]
                if axes.shape[1]:
                    yield OpenPart(
                        cast(Kind, family), _name_of(rows, family, member), quantity, axes
                    )


def _quantities(family: str, x: FloatArray, moved: FloatArray) -> dict[str, FloatArray]:
    """Return what steps (dim, q) of a variable are, by quantity."""
    if family == SENSOR.name:
        R, _ = pose_of(x)
        return {"location": R @ moved[3:6], "turn": R @ moved[:3], "range error": moved[6:]}
    if family == BEAM.name:
        direction = bases(x[3:6]) @ moved[3:5]
        return {"location": moved[:3], "direction": direction, "range error": moved[5:]}
    if family == PLANE.name:
        return {"normal": bases(x[:3]) @ moved[:2], "offset": moved[2:]}
    return {"place": moved} if family == BODY.name else {"place": moved[:3], "radius": moved[3:]}


def _name_of(rows: SurveyRows, family: str, member: int) -> str:
    """Return the name of a sensor, a beam or a body, or of a target without its kind."""
    if family == BODY.name:
        return f"of {rows.bodies[member].of[0]}"
    name = rows.names(family)[member]
    return name if family in (SENSOR.name, BEAM.name) else name.partition(":")[2]


def _within_their_cones(rows: SurveyRows, found: Estimate) -> Iterator[str]:
    """Yield the names of cones whose readings all stay the same where their axis turns."""
    values = {name: x[None] for name, x in found.values.items()}
    for member, name in enumerate(rows.survey.beam_names):
        own = [item for item in rows.items if item.mount == (BEAM.name, member)]
        blocks, _ = blocks_of(own, defaultdict(lambda: 1.0), values)
        turned = (block.evaluate(values).columns[DIRECTION] for block in blocks)
        if all((np.abs(columns) <= NEGLIGIBLE * rows.length).all() for columns in turned):
            yield name


def _on_one_circle(rows: SurveyRows, values: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield the shifts of sensors that saw one plane whose normals lie on one circle for them."""
    stations = rows.survey.stations
    for member, shots in enumerate(rows.survey.shots):
        own = [i for i in rows.items if i.mount == (SENSOR.name, member)]
        planes = {i.target for i in own}
        if len(planes) != 1 or next(iter(planes))[0] != PLANE.name:
            continue
        n = values[PLANE.name][next(iter(planes))[1], :3]
        station = [i.station for i in own]
        X, _ = pose_of(values[SENSOR.name][member])
        m = np.einsum("sij,i->sj", stations.world_R_hand[station], n) @ X
        spread, axes = np.linalg.svd(m - m.mean(axis=0), full_matrices=False)[1:]
        # They are on one circle about a direction along which they hardly spread.
        if spread[-1] < np.sin(COUNTED_TURN) * np.sqrt(len(m)):
            direction = vector_words(axes[-1])
            plane = rows.label(own[0].target)
            yield said("open:circle", sensor=shots.name, direction=direction, plane=plane)


def _on_one_line(rows: SurveyRows, values: Mapping[str, FloatArray]) -> dict[str, str]:
    """Return the turns, by name, of sensors that saw balls alone, whose middles are on one line."""
    stations, found = rows.survey.stations, dict[str, str]()
    for member, shots in enumerate(rows.survey.shots):
        own = [i for i in rows.items if i.mount == (SENSOR.name, member)]
        if not own or any(i.target[0] != SPHERE.name for i in own):
            continue
        station = [i.station for i in own]
        middle = values[SPHERE.name][[i.target[1] for i in own], :3]
        R, t = stations.world_R_hand[station], stations.world_t_hand[station]
        X, location = pose_of(values[SENSOR.name][member])
        seen = (np.einsum("sij,si->sj", R, middle - t) - location) @ X
        spread, axes = np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[1:]
        least = np.sin(COUNTED_TURN) * np.sqrt(len(seen)) * rows.length
        if len(spread) == 3 and spread[1] < least <= spread[0]:
            direction = vector_words(axes[0])
            found[shots.name] = said("open:line", sensor=shots.name, direction=direction)
    return found
