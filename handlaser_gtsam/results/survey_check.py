"""What a survey holds, and what its motion can determine, before sizes of noise are learned.

Readings only say where the targets are, up to what most shots agree on: whether stations lie on a cone
depends on that. Rank and directions follow from the rows there, with noise as stated, else as shots
show it inside, and with errors of the hand as are usual.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..data.noise import Noise
from ..data.survey import Survey, normal_label
from ..data.value import Value
from ..errors import CalibrationWarning, InputError
from ..estimation.estimate import Estimate, information_axes, judged, least_information
from ..estimation.survey import SurveyEstimate, estimate_survey, first_fit, first_state
from ..estimation.survey_mirror import best_image, with_images, without_wobble
from ..estimation.survey_outliers import leave_out_gross
from ..estimation.survey_rows import SurveyRows, rows_of
from ..estimation.survey_state import SurveyState
from ..model.distributions import FEW_DEGREES
from ..model.families import BEAM, DIRECTION, LOCATION, pose_of
from ..model.sensors.mounted import SENSOR
from ..observability.motion import PlaneMotion, motion_before
from ..quantities import IN_DEG, IN_MM, NEGLIGIBLE
from ..text import count
from .survey_misfit import (
    FALSE_RELATION,
    MISREAD,
    NO_FIT,
    contradictions,
    first_noise,
    implausible,
    mislabelled,
    misread,
    misspelt,
    no_fit,
    unconfirmed,
    with_causes,
)
from .survey_motion import (
    CURE_OF_A_CIRCLE,
    CURE_OF_A_LINE,
    MORE_STATIONS,
    counts_of,
    leaves_open,
    open_words,
    unconfirmed_mount,
)
from .survey_warnings import many_rejected, off_targets, unread_stations

DOUBTS = (NO_FIT, *MISREAD, FALSE_RELATION)
"""Codes of warnings with which the motion is not judged: the gravest first."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SensorHeld(Value):
    """What a survey holds of a sensor or a beam, and how well it would be known.

    Attributes
    ----------
    name, kind : str
        Kind of the sensor, or "beam".
    shots, points, on_target : int
        Shots that count, as in a calibration; readings of a beam count as shots; points, and those that
        belong to the shape of their target.
    lost : int
        Other shots, with too few points on their target.
    location_sigma, rotation_sigma : float
        Largest standard deviations of a coordinate in the hand [m], and of a turn [rad]; infinite where
        it is undetermined, or where most shots do not fit each other.
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
    noise : tuple of str
        The standard deviations that those of the sensors follow from, and whether each is stated,
        assumed or from within shots; empty where no start was found.
    misfit : float
        Typical misfit of a shot in standard deviations, of the sensor, beam or target that fits worst;
        NaN where no start was found.
    warnings : tuple of CalibrationWarning
        Of shots that do not fit each other, of arrays that read in the other convention and targets of
        another kind, of relations that the readings contradict, of stations without a reading, of lost
        shots, and of how files were read.
    """

    sensors: tuple[SensorHeld, ...]
    targets: tuple[PlaneMotion, ...]
    numbers: int
    unknowns: int
    undetermined: tuple[str, ...]
    exactly: bool
    advice: tuple[str, ...]
    noise: tuple[str, ...]
    misfit: float
    warnings: tuple[CalibrationWarning, ...]

    @property
    def open_sentence(self) -> str:
        """What is undetermined, and what would determine it; empty where nothing is."""
        if not self.undetermined:
            return ""
        return leaves_open(self.numbers, self.unknowns, self.undetermined, self.advice)

    @property
    def doubt(self) -> str | None:
        """What is wrong where shots do not fit each other, or not what is stated; None elsewhere."""
        doubts = [one for one in self.warnings if one.code in DOUBTS]
        gravest = min(doubts, key=lambda one: DOUBTS.index(one.code), default=None)
        return None if gravest is None else gravest.message


def check_survey(survey: Survey, noise: Noise | None = None) -> SurveyCheck:
    """Say what a survey holds, and what its motion leaves undetermined.

    Raises
    ------
    InputError
        No shot has enough points on its target.
    """
    noise = noise or Noise()
    rows = rows_of(survey, noise)
    rows = without_wobble(rows, noise.standstill[1]) or rows
    causes = tuple(misread(rows, noise))
    unread = tuple(unread_stations(rows))
    lost = () if causes else tuple(unconfirmed(rows, unread))
    warnings = (*lost, *causes, *unread, *survey.warnings)
    targets = tuple(_targets(rows))
    numbers, unknowns = counts_of(rows)
    try:
        state = first_state(rows, noise)
    except InputError as error:
        if not rows.items:
            raise with_causes(error, causes) from error
        said = ((error.found,), True, (error.expected,), (), np.nan, warnings)
        return SurveyCheck(tuple(_held(rows, None)), targets, numbers, unknowns, *said)
    begun, drawn = replace(state), first_fit(state).fits
    if drawn:
        state.draw_to_the_hand()
    _, others = best_image(state, _settled_roughly)
    first = first_fit(state)
    if first.fits and not drawn:  # only as its mirror image
        state.draw_to_the_hand()
    problem, _ = state.problem()
    information, axes, _ = information_axes(problem, state.values)
    exact = information < NEGLIGIBLE**2 * information.max()
    weak = ~exact & (information < least_information(information))
    found = judged(problem, dict(state.values))
    found, images = with_images(found, others)
    warnings = (*mislabelled(state, found), *implausible(rows, state.values), *warnings)
    undetermined, advice = open_words(state.rows, found, axes[:, exact | weak], images)
    fits = first.fits
    # Whether relations hold, and which shots contradict the others, depends on the noise, which is
    # learned with everything.
    settled: SurveyState | SurveyEstimate = begun
    if rows.known or not (fits or causes):
        with suppress(InputError):
            settled = learned = estimate_survey(survey, noise, begun=begun)
            fits = fits or learned.fits
            warnings = (*warnings, *contradictions(learned.tests))
    if fits:
        off = off_targets(settled.rows)
        warnings = (*warnings, *off, *misspelt(state, found), *many_rejected(settled))
    else:
        warnings = (no_fit(rows, first, causes, noise), *warnings)
    another = unconfirmed_mount(rows)
    if another and not undetermined:
        undetermined, advice = (another,), (MORE_STATIONS,)
    doubtful = any(one.code in DOUBTS for one in warnings)
    if doubtful:  # what a motion leaves undetermined means nothing then
        undetermined, advice = (), ()
    return SurveyCheck(
        tuple(_held(rows, None if doubtful else found)),
        targets,
        numbers,
        unknowns,
        undetermined,
        # On a cone, or a line, only noise in where the target is makes it look determined.
        bool(undetermined)
        and (not weak.any() or not {CURE_OF_A_CIRCLE, CURE_OF_A_LINE}.isdisjoint(advice)),
        advice,
        first_noise(rows, first, noise),
        first.misfit,
        warnings,
    )


def _settled_roughly(image: SurveyState) -> bool:
    """Reject grossly wrong shots of a first state alone."""
    image.used = np.ones(len(image.rows.items), dtype=bool)
    leave_out_gross(image)
    return True


def _held(rows: SurveyRows, found: Estimate | None) -> Iterator[SensorHeld]:
    """Yield what there is of each sensor and beam; nothing of its mount without an estimate."""
    for mount, name in rows.mounts.items():
        family, member = mount
        own = [item for item in rows.items if item.mount == mount]
        kind, points, lost = BEAM.name, len(own), 0
        if family == SENSOR.name:
            shots = rows.survey.shots[member]
            kind, points = str(shots.kind), len(shots.reading)
            lost = sum(i == member for i, _ in rows.lost)
        on_target = sum(1 if item.points is None else len(item.points) for item in own)
        shift = turn = np.inf
        if found is not None and own:
            C = found.marginal(family, member)
            located, turned = C[LOCATION, LOCATION], C[DIRECTION, DIRECTION]
            if family == SENSOR.name:
                R = pose_of(found.values[family][member])[0]
                located, turned = R @ C[3:6, 3:6] @ R.T, C[:3, :3]
            shift, turn = (
                float(np.nan_to_num(np.sqrt(np.diagonal(each)), nan=np.inf).max())
                for each in (located, turned)
            )
        yield SensorHeld(name, kind, len(own), points, on_target, lost, shift, turn)


def _targets(rows: SurveyRows) -> Iterator[PlaneMotion]:
    """Yield the motion before each target that was read."""
    of = rows.survey.stations
    labels = np.array([normal_label(label) for label in of.plane_labels])
    stations = np.array(sorted({item.station for item in rows.items}), dtype=np.intp)
    for label in dict.fromkeys(labels[stations].tolist()):
        at = stations[labels[stations] == label]
        read = {(i.mount, i.station) for i in rows.items if labels[i.station] == label}
        counts = [sum(mount == one for mount, _ in read) for one in rows.mounts]
        names = [of.station_names[j] for j in at]
        yield motion_before(
            label, of.world_R_hand[at], of.world_t_hand[at], names, np.array(counts)
        )


def check_lines(check: SurveyCheck) -> Iterator[str]:
    """Yield what a check says, a line a sensor and a target."""
    for one in check.sensors:
        words = f"{one.kind} {one.name}: {one.shots} readings"
        if one.kind != BEAM.name:
            words = f"{one.kind} {one.name}: {one.shots} shots of {one.points} points, "
            words += f"{one.on_target} of them on their target"
        words += f", and {count(one.lost, 'shot')} with too few there" if one.lost else ""
        if np.isfinite(one.location_sigma):
            shift, turn = one.location_sigma * IN_MM, one.rotation_sigma * IN_DEG
            words += f"; to be known to {shift:.2g} mm and {turn:.2g} deg (1 sigma)"
        yield words
    if any(np.isfinite(one.location_sigma) for one in check.sensors):
        yield f"these standard deviations follow from the noise: {', '.join(check.noise)}"
    names = [one.name for one in check.sensors]
    for target in check.targets:
        unread = [name for name, n in zip(names, target.readings, strict=True) if n == 0]
        words = f"{count(target.orientations, 'orientation')}, turns about "
        words += "1 axis" if target.axes == 1 else f"{target.axes} axes"
        words += f"; not read by {', '.join(unread)}" if unread else ""
        yield f"{target.name}, {count(target.stations, 'station')}: {words}"
    yield (
        f"{check.numbers} numbers from shots for {check.unknowns} unknowns, without range errors"
    )
    if check.doubt is not None:
        yield check.doubt
    elif not check.undetermined:
        words = "these stations and targets determine everything"
        if check.numbers < check.unknowns + FEW_DEGREES:
            words += f", and are too few to judge how well shots fit: {MORE_STATIONS}"
        yield words
