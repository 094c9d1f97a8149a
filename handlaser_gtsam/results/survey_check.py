"""What a survey holds, and what its motion can determine, before sizes of noise are learned.

Readings only say where the targets are, up to what most shots agree on: whether stations lie on a cone
depends on that. Rank and directions are those of the rows there, with noise as stated, else as shots
show it inside, and with errors of the hand as are usual.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.readings import Readings
from ..data.survey import Known, Survey, normal_label
from ..data.value import Value
from ..errors import InputError
from ..estimation.estimate import Estimate, information_axes, judged, least_information
from ..estimation.survey import GROSS, SurveyState, first_state, misfits
from ..estimation.survey_rows import Rows, rows_of
from ..model.families import BEAM, FAMILIES, PLANE, bases
from ..model.known import BODY
from ..model.sensors.mounted import ERRORS, SENSOR
from ..model.targets.sphere import SPHERE
from ..observability.motion import PlaneMotion, motion_before
from ..observability.poor_motion import COUNTED_TURN, SIGNIFICANT, PoorMotion, named, poor_motion
from ..observability.wording import WORTH_A_WORD, Kind, OpenPart
from ..quantities import IN_DEG, IN_MM, NEGLIGIBLE
from ..text import count
from .survey import CURE_OF_A_CIRCLE, on_one_circle

RANGE_ERRORS = frozenset((*ERRORS, "k1", "k2"))
"""Coordinates that do not count among the unknowns that a motion has to determine."""


NEAR_THE_HAND = 10.0
"""Mounts are held to the hand by so many typical ranges (1 sigma), which hides nothing undetermined."""
ANY_TURN = 1e3
"""Standard deviation [rad] of turns that says nothing of them."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SensorHeld(Value):
    """What a survey holds of a sensor or a beam, and how well it would be known.

    Attributes
    ----------
    name, kind : str
        Kind of the sensor, or "beam".
    shots, points, on_target : int
        Readings of a beam count as shots; points that belong to the shape of their target.
    lost : int
        Shots with too few points on their target.
    location_sigma, rotation_sigma : float
        Largest standard deviations of a coordinate in the hand [m], and of a turn [rad]; infinite where
        it is undetermined.
    """

    name: str
    kind: str
    shots: int
    points: int
    on_target: int
    lost: int
    location_sigma: float
    rotation_sigma: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyCheck(Value):
    """What a survey holds and determines.

    Attributes
    ----------
    sensors : tuple of SensorHeld
    targets : tuple of PlaneMotion
    numbers, unknowns : int
        What all shots say, and what is to be found, without range errors.
    undetermined : tuple of str
        In words.
    exactly : bool
        Whether all of it is undetermined whatever the noise is; else some, or all, at this noise only.
    advice : tuple of str
        What would determine it.
    misfit : float
        Typical misfit of a shot in standard deviations; NaN where no start was found.
    """

    sensors: tuple[SensorHeld, ...]
    targets: tuple[PlaneMotion, ...]
    numbers: int
    unknowns: int
    undetermined: tuple[str, ...]
    exactly: bool
    advice: tuple[str, ...]
    misfit: float

    @property
    def fits(self) -> bool:
        """Whether most shots fit where the motion was judged."""
        return not self.misfit > GROSS


def check_survey(survey: Survey, noise: Noise | None = None) -> SurveyCheck:
    """Say what a survey holds, and what its motion leaves undetermined.

    Raises
    ------
    InputError
        No shot has enough points on its target.
    """
    rows = rows_of(survey)
    targets = tuple(_targets(rows))
    numbers = sum(1 if item.shot is None else len(item.shot.reading) for item in rows.items)
    numbers += 2 * sum(item.target[0] == "point" for item in rows.items)
    names = rows.places().names
    unknowns = sum(name.rpartition(".")[2] not in RANGE_ERRORS for name in names)
    # A search wanders along what is undetermined by metres, at no cost, and derivatives with it.
    whose = [f"sensor:{one.name}" for one in survey.shots]
    whose += [f"beam:{name}" for name in survey.beam_names]
    near = NEAR_THE_HAND * rows.length
    holds = [
        Known("mount", (one,), sigma=near, sigma_angle=ANY_TURN, pose=np.eye(4)) for one in whose
    ]
    try:
        state, _, _ = first_state(replace(rows, known=(*rows.known, *holds)), noise or Noise())
    except InputError as error:
        if not rows.items:
            raise
        said = ((error.found,), True, (error.expected,), np.nan)
        return SurveyCheck(tuple(_held(rows, None)), targets, numbers, unknowns, *said)
    state = replace(state, relations=[one for one in state.relations if one[0] not in holds])
    problem, _ = state.problem()
    information, axes, _ = information_axes(problem, problem.blocks, state.values)
    exact = information < NEGLIGIBLE**2 * information.max()
    weak = ~exact & (information < least_information(information))
    found = judged(problem, problem.blocks, dict(state.values))
    undetermined, advice = _words(state, found, axes[:, exact | weak])
    if numbers < unknowns:
        advice = (*advice, "measure at more stations")
    return SurveyCheck(
        tuple(_held(rows, found)),
        targets,
        numbers,
        unknowns,
        undetermined,
        # On a cone, only the noise in the tilt of the target makes it look determined.
        not weak.any() or CURE_OF_A_CIRCLE in advice,
        advice,
        float(np.median(misfits(state))),
    )


def _held(rows: Rows, found: Estimate | None) -> Iterator[SensorHeld]:
    """Yield what there is of each sensor and beam."""
    survey = rows.survey
    entities = [(SENSOR.name, i, one.name, str(one.kind)) for i, one in enumerate(survey.shots)]
    entities += [(BEAM.name, i, name, BEAM.name) for i, name in enumerate(survey.beam_names)]
    for family, member, name, kind in entities:
        own = [item for item in rows.items if (item.family, item.member) == (family, member)]
        points = len(survey.shots[member].reading) if family == SENSOR.name else len(own)
        on_target = sum(1 if item.points is None else len(item.points) for item in own)
        lost = sum(family == SENSOR.name and i == member for i, _ in rows.lost)
        shots = len({item.station for item in own}) + lost
        shift = turn = np.inf
        if found is not None and own:
            C = found.marginal(family, member)
            if family == SENSOR.name:
                R = found.values[family][member, :9].reshape(3, 3)
                C = C[:6, :6]
                C = np.block(
                    [[R @ C[3:, 3:] @ R.T, np.zeros((3, 3))], [np.zeros((3, 3)), C[:3, :3]]]
                )
            sigma = np.nan_to_num(np.sqrt(np.diagonal(C)[:6]), nan=np.inf)
            shift, turn = float(sigma[:3].max()), float(sigma[3 : 6 if kind != "beam" else 5].max())
        yield SensorHeld(name, kind, shots, points, on_target, lost, shift, turn)


def _targets(rows: Rows) -> Iterator[PlaneMotion]:
    """Yield the motion before each target that was read."""
    survey, of = rows.survey, rows.survey.stations
    labels = np.array([normal_label(label) for label in of.plane_labels])
    entities = [(SENSOR.name, i) for i in range(len(survey.shots))]
    entities += [(BEAM.name, i) for i in range(len(survey.beam_names))]
    for label in dict.fromkeys(labels[sorted({item.station for item in rows.items})].tolist()):
        at = np.flatnonzero(labels == label)
        read = {(i.family, i.member, i.station) for i in rows.items if labels[i.station] == label}
        counts = [sum(key[:2] == entity for key in read) for entity in entities]
        names = [of.station_names[j] for j in at]
        yield motion_before(
            label, of.world_R_hand[at], of.world_t_hand[at], names, np.array(counts)
        )


def _words(
    state: SurveyState, found: Estimate, null: FloatArray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Say what moves along directions (N, q) that are undetermined, and what determines them."""
    if not null.shape[1]:
        return (), ()
    rows, parts = state.rows, tuple(_parts(state, null))
    motion = poor_motion(_readings(rows))
    at = {name: x[0] for name, x in state.values.items()}
    circles = tuple(on_one_circle(rows, at)) if motion is None else ()
    if len(circles) == null.shape[1]:
        return circles, (CURE_OF_A_CIRCLE,)
    errors = any(part.quantity == "range error" for part in parts)
    leans = motion is None or _leans(state, found, motion)
    return named(motion, parts, leans=leans, k1_free=errors, mount=SENSOR.name)


def _leans(state: SurveyState, found: Estimate, motion: PoorMotion) -> bool:
    """Tell whether a target is known to look different at other heights: a leaning plane, a ball."""
    for target, number in _numbers(state.rows).items():
        if target[0] != PLANE.name:
            return True
        n, up = state.values[PLANE.name][0, target[1], :3], motion.upright[number]
        slope = up @ bases(n)
        sigma = np.sqrt(slope @ found.marginal(*target)[:2, :2] @ slope)
        # It is NaN where the lean is undetermined.
        if abs(n @ up) > np.sin(COUNTED_TURN) and abs(n @ up) > SIGNIFICANT * sigma:
            return True
    return False


def _numbers(rows: Rows) -> dict[tuple[str, int], int]:
    """Return numbers of the targets, in the order in which they are seen."""
    return {x: n for n, x in enumerate(dict.fromkeys(item.target for item in rows.items))}


def _readings(rows: Rows) -> Readings:
    """Return a reading for each target and station, which only says where the hand was before it."""
    numbers = _numbers(rows)
    seen = sorted({(numbers[item.target], item.station) for item in rows.items})
    plane, station = np.array(seen).T
    of = rows.survey.stations
    return Readings(
        station,
        np.zeros_like(station),
        plane,
        np.full(len(seen), rows.length),
        of.world_R_hand[station],
        of.world_t_hand[station],
        1,
        len(numbers),
    )


def _parts(state: SurveyState, null: FloatArray) -> Iterator[OpenPart]:
    """Yield what directions (N, q), orthonormal in natural units, move of every mount and target."""
    rows, of = state.rows, state.rows.places()
    for family, place in of.place.items():
        for member, first in enumerate(place.tolist()):
            x = state.values[family][0, member]
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


def check_lines(check: SurveyCheck) -> Iterator[str]:
    """Yield what a check says, a line a sensor and a target."""
    for one in check.sensors:
        words = f"{one.kind} {one.name}: {one.shots} "
        words += "readings" if one.kind == BEAM.name else "shots"
        if one.kind != BEAM.name:
            words += f" of {one.points} points, {one.on_target} of them on their target"
        words += f", {one.lost} with too few there" if one.lost else ""
        if np.isfinite(one.location_sigma):
            sigmas = (
                f"{one.location_sigma * IN_MM:.2g} mm and {one.rotation_sigma * IN_DEG:.2g} deg"
            )
            words += f"; to be known to {sigmas} (1 sigma)"
        yield words
    names = [one.name for one in check.sensors]
    for target in check.targets:
        unread = [name for name, n in zip(names, target.readings, strict=True) if n == 0]
        words = f"{count(target.orientations, 'orientation')}, turns about "
        words += "1 axis" if target.axes == 1 else f"{target.axes} axes"
        words += f"; not read by {', '.join(unread)}" if unread else ""
        yield f"{target.name}, {target.stations} stations: {words}"
    yield (
        f"{check.numbers} numbers that shots say for {check.unknowns} unknowns, without range errors"
    )
    if not check.fits:
        yield (
            f"most shots do not fit each other (by {check.misfit:.2g} standard deviations): is the "
            "pose format right, and are labels? What follows is judged where they fit best"
        )
    if not check.undetermined:
        yield "the motion determines everything before the targets that there are"
