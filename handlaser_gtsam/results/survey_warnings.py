"""The warnings of a survey: what its readings say of labels, poses, sigmas, range errors and mounts.

Few readings of a beam may have several minima, with mounts far from each other, and standard deviations
say how well one of them is known. Every beam is searched for others by itself, with its targets where
they are, from mounts that are turned about its location and about its middle spot; all unknowns of the
survey then move to the ends that may fit as well.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray, evenly
from ..data.noise import OF_POSE
from ..data.screening import REPEATED, repeated
from ..data.survey import RAY_ERRORS, normal_label
from ..errors import CalibrationWarning
from ..estimation.estimate import BlockProblem, minimum, search_from
from ..estimation.scales import ROTATION, TRANSLATION, NoiseComponent
from ..estimation.survey import SurveyEstimate, usual_noise
from ..estimation.survey_outliers import alike_by_zone
from ..estimation.survey_rows import RANGE_ERRORS, SurveyRows
from ..estimation.survey_state import SurveyState
from ..estimation.survey_trials import ALIKE, ALL_MOUNTS, BOTH_AXES, displacement
from ..model.distributions import (
    FEW_DEGREES,
    SINGLE_LEVEL,
    UNLIKELY_EXCESS,
    chi2_cdf,
    chi2_sf,
    f_sf,
    gaussian_sf,
    p_words,
)
from ..model.families import (
    BEAM,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    PLANE,
    bases,
)
from ..model.sensor_limits import Rejected
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..quantities import FAR_SIGMAS, IN_MM, MAJORITY, MANY_OUTLIERS
from ..starts.beam_minima import MINIMUM_READINGS, MINIMUM_STARTS
from ..starts.directions import half_sphere
from ..starts.rounds import LAST_STEPS, SAME_DIRECTION
from ..text import count, some
from .lines import NAMES_IN_LINE
from .messages import Values, said, warned
from .shared_errors import warnings_of
from .survey_misfit import (
    MISREAD,
    beside_ball,
    contradictions,
    counted_towards,
    curved,
    implausible,
    misheard,
    mislabelled,
    misread,
    misspelt,
    no_fit,
    pulled,
    unconfirmed,
)
from .survey_motion import MORE_STATIONS, counts_of, leaves_open, unconfirmed_mount
from .survey_verdict import FEW, TOO_FEW
from .warnings import (
    DISPLACED,
    RIVAL,
    WORTH_REFINING,
    contradicted_poses,
    contradicted_readings,
    large_pose_errors,
    large_range_error,
)

if TYPE_CHECKING:
    from .survey import BeamMount, Mount, SensorMount


def survey_warnings(
    found: SurveyEstimate,
    sensors: "Mapping[str, SensorMount]",
    beams: "Mapping[str, BeamMount]",
) -> Iterator[CalibrationWarning]:
    """Yield the warnings of a survey, causes before what they make of the result."""
    yield from contradictions(found.tests)
    heard = tuple(misheard(found))
    causes = (*misread(found.rows, found.given), *pulled(found), *beside_ball(found))
    causes += tuple(one for one in heard if one.code in MISREAD)
    causes += tuple(implausible(found.rows, found.estimate.values))
    causes += tuple(mislabelled(found.ended(), found.estimate))
    unread = tuple(unread_stations(found.rows))
    false = any(one.contradicted for one in found.tests)
    moved: tuple[CalibrationWarning, ...] = ()
    if found.estimate.status == "converged" or not (causes or false):
        moved = tuple(_displaced(found, [*sensors.values(), *beams.values()]))
    if not (found.fits or causes or false or moved):
        causes = tuple(curved(found))
    if not found.fits:
        yield no_fit(found.rows, found.first, causes or moved, found.given)
    elif not causes:
        yield from unconfirmed(found.rows, unread)
    yield from causes
    yield from (one for one in heard if one not in causes)
    gone = [one for one in unread if one.code == "no-edge" or "targets" in one.values]
    yield from gone  # a target of which no shot counts is missing in all that follows
    yield from _zones_that_miss(found)
    for member, shots in enumerate(found.rows.survey.shots):
        size, growth = alike_by_zone(found.rows, found.values, found.used, member)
        if found.fits and growth > 1.0:  # which makes standard deviations larger
            yield warned("zones-err", {"sensor": shots.name, "size": size})
    yield from off_targets(found.rows)
    yield from _sigmas(found)
    if found.fits:
        yield from misspelt(found.ended(), found.estimate)
        if len(beams) > 1:
            yield from _rough_beam(found)
        if not false:  # which looks like errors of the hand
            yield from large_pose_errors(_learned_of_hand(found))
        yield from _large_range_errors(found, sensors, beams)
    unsure = list(_too_few(found))
    yield from unsure
    yield from _few(found, unsure=bool(unsure))
    yield from _rivals(found, beams)
    for sensor in sensors.values():
        errors = [(code, error) for code, error in sensor.errors.items() if error.found]
        if errors:
            # One error shows in the tests of others that look like it: the most significant is named.
            (code, first), *others = sorted(errors, key=lambda e: -abs(e[1].size) / e[1].sigma)
            p = 2.0 * float(gaussian_sf(abs(first.size) / first.sigma))
            alike = " or ".join(other for other, _ in others)
            also = f"; an error {alike} would look much like it" if others else ""
            # What stands between the quotes of `free` to estimate it.
            free = '", "'.join(ALIKE) if code == BOTH_AXES else code
            which = {"sensor": sensor.name, "code": code, "alike": alike, "free": free}
            sizes = {"size": first.size, "sigma": first.sigma, "p": p}
            yield warned("range-error", {**which, **sizes}, likely=p_words(p, 1), also=also)
    yield from moved
    if found.fits:  # else noise that was learned, or a wrong minimum, decides which they are
        yield from many_rejected(found)
    yield from (one for one in unread if one not in gone)
    if found.by_pose is not None:
        yield from warnings_of(found.by_pose.sizes)
    yield from found.rows.survey.warnings


def _learned_of_hand(found: SurveyEstimate) -> Iterator[NoiseComponent]:
    """Yield what was learned of the errors of the hand."""
    usual, stated = usual_noise(found.rows, found.given).pose, found.stated.pose
    of_hand = zip((ROTATION, TRANSLATION), found.noise.pose, usual, stated, strict=True)
    for name, sigma, expected, known in of_hand:
        if np.isnan(known):
            yield NoiseComponent(name, sigma, np.nan, expected)


def _large_range_errors(
    found: SurveyEstimate,
    sensors: "Mapping[str, SensorMount]",
    beams: "Mapping[str, BeamMount]",
) -> Iterator[CalibrationWarning]:
    """Warn of range errors that no sensor has: they stand for another form, or for wrong poses.

    Those of many rays have a prior of what is usual, and are far from it.
    """
    for name, sensor in sensors.items():
        for code, size in sensor.range_error.items():
            expected = float(RANGE_ERRORS[RAY_ERRORS.index(code)])
            if abs(size) > FAR_SIGMAS * expected:
                values: Values = {"sensor": name, "code": code, "size": size, "expected": expected}
                also = said("scaled-instead", times=1.0 + size) if code == "k1" else ""
                unit = {"k0": " m", "k2": "/m"}.get(code, "")
                yield warned("large-range-error:sensor", values, unit=unit, also=also)
    if beams:
        k = np.array([one.range_error for one in beams.values()])
        typical, linearity = found.rows.length, found.rows.survey.linearity
        yield from large_range_error(k, typical, linearity, list(beams))


def _rough_beam(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of the beam that is rougher than others whose noise was learned as one.

    The squares of its residuals, over what the unknowns leave of its readings, are compared with those
    of the others by an F test.
    """
    rows, (e, left, owner) = found.rows, found.residuals()
    own = defaultdict[int, dict[str, FloatArray]](dict)
    for mount, source in rows.sources.items():
        if mount[0] == BEAM.name and np.isnan(found.stated.sigma[source]):
            items = [i.mount == mount and i.target[0] != POINT.name for i in rows.items]
            of = np.isin(owner, np.flatnonzero(items))
            own[source][rows.mounts[mount]] = np.array([e[of] @ e[of], left[of].sum()])
    for source, beams in own.items():
        total = np.sum(list(beams.values()), axis=0)
        for name, (squares, dof) in beams.items():
            rest, rest_dof = total - beams[name]
            if not (min(dof, rest_dof) >= 1.0 and rest > 0.0):
                continue
            variance, others = squares / dof, rest / rest_dof
            p = float(f_sf(variance / others, dof, rest_dof)) * len(rows.survey.beam_names)
            if p < SINGLE_LEVEL:
                sigma, rough = (
                    float(found.noise.sigma[source] * np.sqrt(x)) for x in (others, variance)
                )
                values: Values = {"beam": name, "sigma": rough, "others": sigma}
                yield warned("rough-beam", values, likely=p_words(p, 1))


def rejected_of(found: SurveyEstimate | SurveyState) -> Iterator[Rejected]:
    """Yield the shots and readings that were left out."""
    rows, stations = found.rows, found.rows.survey.stations
    names, mounts = stations.station_names, rows.mounts
    for item, used in zip(rows.items, found.used, strict=True):
        if not used:
            # A shot with a shape of its own that misses its ball does not show it.
            alone = item.shot is None or item.shot.single
            reason = "grazing" if item.grazing and alone else "contradicted"
            label = rows.label(item.target)
            yield Rejected(names[item.station], mounts[item.mount], label, reason)
    for item in rows.off_target:
        label = rows.label(item.target)
        yield Rejected(names[item.station], mounts[item.mount], label, "off-target")
    for member, at in rows.lost:
        label = stations.plane_labels[at]
        reason = "no-edge" if label in rows.edgeless else "too-few-points"
        yield Rejected(names[at], mounts[SENSOR.name, member], label, reason)


def many_rejected(found: SurveyEstimate | SurveyState) -> Iterator[CalibrationWarning]:
    """Warn of many shots that contradict the others."""
    out = [one for one in rejected_of(found) if one.reason == "contradicted"]
    total, beams = len(found.rows.items), found.rows.names(BEAM.name)
    if len(out) > MANY_OUTLIERS * total:
        names = some([rejected_shot(one, beams) for one in out], NAMES_IN_LINE)
        yield warned("many-rejected", {"shots": len(out), "total": total, "names": names})


def off_targets(rows: SurveyRows) -> Iterator[CalibrationWarning]:
    """Warn of beams that do not see a target that sensors of many rays see."""
    for (mount, target), readings in Counter((i.mount, i.target) for i in rows.off_target).items():
        values: Values = {"beam": rows.mounts[mount], "target": rows.label(target)}
        of = count(readings, "reading")
        yield warned("off-target", {**values, "readings": readings}, of=of)


def _displaced(found: SurveyEstimate, mounts: "Sequence[Mount]") -> Iterator[CalibrationWarning]:
    """Warn of a target, a mount or all mounts that were moved amid the survey."""
    moved = displacement(found) if found.estimate.status != "undetermined" else None
    if moved is None:
        return
    (family, member), station, tried = moved
    size = tried.size
    place, times = found.rows.places().place, []
    for mount, (own, number) in zip(mounts, found.rows.mounts, strict=True):
        J = mount.spot_by()
        shift = J @ tried.moved[place[own][number] + np.arange(J.shape[1])]
        times.append(float(np.linalg.norm(shift)) / mount.spot_error)
    of_mount, of_all = family in (SENSOR.name, BEAM.name), (family, member) == ALL_MOUNTS
    name = "all sensors" if of_all else found.rows.names(family)[member]
    values: Values = {
        "target": f"{family} {name}" if of_mount else name,
        "station": found.rows.survey.stations.station_names[station],
        "shift": float(abs(size[2]) if family == PLANE.name else np.linalg.norm(size)),
        "turn_deg": float(np.degrees(np.hypot(*size[:2]))) if family == PLANE.name else 0.0,
        "p": tried.p_value,
        "times": max(times),
    }
    whose = ":hand" if of_all else ":mount" if of_mount else ""
    yield warned(f"{DISPLACED}{whose}", values, likely=p_words(tried.p_value, 1))


def rejected_shot(one: Rejected, beams: Container[str]) -> str:
    """Return which it is, as "beam 1 at station 2", given the names of the beams."""
    kind = BEAM.name if one.sensor in beams else SENSOR.name
    return f"{kind} {one.sensor} at station {one.station}"


def unread_stations(rows: SurveyRows) -> Iterator[CalibrationWarning]:
    """Warn of stations without a reading, of grooves without an edge, and of lost shots."""
    survey, stations = rows.survey, len(rows.survey.stations)
    names = survey.stations.station_names
    twice = {at for _, at in rows.repeated}
    if twice:
        first = min(twice)
        like = names[rows.stops[first]]
        yield repeated("repeated-stations", REPEATED, len(twice), stations, names[first], like)
    read = {item.station for item in (*rows.items, *rows.off_target)} | twice
    read |= {at for _, at in rows.lost}
    unread = stations - len(read)
    labels = survey.stations.plane_labels
    if unread:
        seen = {labels[at] for at in read}
        targets = some([one for one in dict.fromkeys(labels) if one not in seen], NAMES_IN_LINE)
        left = {"targets": targets} if targets else {}
        nothing = f"; nothing was read of {targets}" if targets else ""
        counts = {"stations": unread, "total": stations}
        yield warned("stations-left-out", {**counts, **left}, nothing=nothing)
    edgeless = rows.edgeless
    for label in edgeless:
        shots = sum(labels[at] == label for _, at in rows.lost)
        plane = f"{PLANE.name}:{label.partition(':')[2]}"
        yield warned("no-edge", {"target": label, "shots": shots, "label": plane})
    lost = [(member, at) for member, at in rows.lost if labels[at] not in edgeless]
    if lost:
        listed = [f"sensor {survey.shots[i].name} at station {names[at]}" for i, at in lost]
        counted = {normal_label(labels[item.station]) for item in rows.items}
        lost_labels = dict.fromkeys(normal_label(labels[at]) for _, at in lost)
        targets = some([one for one in lost_labels if one not in counted], NAMES_IN_LINE)
        gone = {"targets": targets} if targets else {}
        uncounted = f", so that no shot of {targets} counts" if targets else ""
        more = "".join(f"; {one}" for one in counted_towards(rows).values())
        values: Values = {"shots": len(lost), "names": some(listed, NAMES_IN_LINE), **gone}
        with_few = count(len(lost), "shot")
        yield warned("too-few-points", values, lost=with_few, uncounted=uncounted, more=more)


def _few(found: SurveyEstimate, *, unsure: bool) -> Iterator[CalibrationWarning]:
    """Warn of hardly more readings than unknowns.

    Where noise is learned from as few, standard deviations rest on what noise is usual. Among stated
    ones, a gross error of a single beam may pass for another mount, as is said already where results
    are `unsure`. Of shots of many rays that is not said: rows of these tell more than the mount.
    """
    learned, shots = np.isnan(found.stated.sigma), found.rows.survey.shots
    if found.estimate.status != "converged" or (shots and not learned.any()):
        return
    names = [*found.rows.names_of_noise(), "the aiming at points"]
    spare, usual = found.redundancy(), usual_noise(found.rows, found.given).sigma
    few = np.flatnonzero(learned & (spare < FEW_DEGREES)).tolist()
    for i in few:
        sigma = {"sigma": float(found.noise.sigma[i]), "usual": float(usual[i])}
        yield warned(f"{FEW}:survey", {"source": names[i]}, spare=float(spare[i]), **sigma)
    in_all = round(float(spare.sum()))
    if not (few or unsure or shots) and in_all < FEW_DEGREES:
        yield warned(f"{FEW}:beams", {"redundancy": in_all})


def _too_few(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of surveys, and of beams, whose readings cannot contradict a mount without a relation.

    Noise that is stated shows by chi2 that a mount does not fit.
    """
    if found.estimate.status != "converged":
        return
    rows, unknowns, used = found.rows, BEAM.dim, found.rows.counted(found.used)
    another = unconfirmed_mount(rows)
    if another:
        numbers, every = counts_of(rows)
        sentence = leaves_open(numbers, every, (another,), (MORE_STATIONS,))
        counts = {"numbers": numbers, "unknowns": every}
        yield warned(f"{TOO_FEW}:survey", counts, sentence=sentence)
    related = {entity for known in rows.known for entity in rows.entities(known)}
    for member, name in enumerate(rows.survey.beam_names):
        mount = BEAM.name, member
        numbers = sum(item.numbers for item in used if item.mount == mount)
        learned = np.isnan(found.stated.sigma[rows.sources[mount]])
        if numbers < unknowns and learned and mount not in related:
            values: Values = {"beam": name, "numbers": numbers, "unknowns": unknowns}
            yield warned(TOO_FEW, values)


def _zones_that_miss(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of zones of arrays that hardly ever see the planes that most other zones see."""
    rows = found.rows
    for member, shots in enumerate(rows.survey.shots):
        before = [
            item
            for item in rows.counted(found.used)
            if item.mount == (SENSOR.name, member) and item.target[0] == PLANE.name
        ]
        if shots.kind != "array" or not before:
            continue
        # Directions that come from one row of a file are equal to the last digit.
        zones, zone = np.unique(shots.across, axis=0, return_inverse=True)
        seen = np.isin(shots.station, [item.station for item in before])
        kept = np.isin(np.arange(len(seen)), np.concatenate([item.points for item in before]))
        read = np.bincount(zone.ravel(), seen, len(zones))
        fits = np.bincount(zone.ravel(), seen & kept, len(zones))
        miss = (read >= FEW_DEGREES) & (fits < (1.0 - MAJORITY) * read)
        if miss.any() and miss.mean() < 0.5 and fits[~miss].sum() > MAJORITY * read[~miss].sum():
            at = np.degrees(np.arctan2(zones[miss, :2], zones[miss, 2:]))
            names = some([f"({x:.3g}, {y:.3g})" for x, y in at.tolist()], 4)
            values: Values = {"sensor": shots.name, "zones": int(miss.sum())}
            yield warned("zones-miss", values, names=names, count=count(int(miss.sum()), "zone"))


def _contradicted(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of stated sigmas that the readings contradict: they were learned."""
    if found.contradicted is None:
        return
    (survey, noise), now = found.contradicted, found.noise.sigma
    if noise.without(OF_POSE) != noise and found.given.without(OF_POSE) == found.given:
        yield contradicted_poses(noise, *found.noise.pose)
    names, of_beams = found.rows.names_of_noise(), survey.stated_sigmas
    for (family, member), source in found.rows.sources.items():
        if family == SENSOR.name:
            stated = survey.shots[member].sigma
        else:
            stated = noise.range_sigma if np.isnan(of_beams[member]) else float(of_beams[member])
        if stated is not None and np.isnan(found.stated.sigma[source]) and names[source]:
            yield contradicted_readings(stated, float(now[source]), f" of {names[source]}")
            names[source] = ""  # said once of all that share it


def _sigmas(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of stated sigmas that scatter inside shots, or all readings, contradict; else by chi2."""
    for member, shots in enumerate(found.rows.survey.shots):
        own = [
            one.shot
            for one in found.rows.counted(found.used)
            if one.shot is not None and one.member == member and not one.shot.single
        ]
        many = sum(shot.dof for shot in own)
        if not shots.sigma or not many:
            continue
        inside = math.sqrt(sum(shot.squares for shot in own) / many)
        times = inside / shots.sigma
        how, chance = ("large", chi2_cdf) if times < 1.0 else ("small", chi2_sf)
        p = float(chance(many * times**2, many))
        # Points tell a sigma to a per cent; data sheets do not state it better than by such a
        # factor.
        if p < SINGLE_LEVEL and max(times, 1.0 / times) > 1.5:
            sizes = {"sigma_mm": inside * IN_MM, "stated_mm": shots.sigma * IN_MM}
            found_so: Values = {"sensor": shots.name, **sizes, "times": times, "p": p}
            yield warned(f"sigmas-too-{how}:shots", found_so)
            return
    yield from _contradicted(found)
    chi2, dof = found.estimate.chi2, found.estimate.dof
    learned = np.isnan([*found.stated.sigma, *found.stated.pose]).any()
    if learned or dof < 1 or not math.isfinite(chi2):
        return
    times, by_pose = math.sqrt(chi2 / dof), None if found.by_pose is None else found.by_pose.sizes
    if times < 1.0 and by_pose is not None and by_pose.explain_small_residuals:
        return
    for how, p in (("small", float(chi2_sf(chi2, dof))), ("large", float(chi2_cdf(chi2, dof)))):
        if p < SINGLE_LEVEL:
            values = {"times": times, "p": p}
            yield warned(f"sigmas-too-{how}:survey", values, likely=p_words(p, 1))


def _rivals(
    found: SurveyEstimate, beams: "Mapping[str, BeamMount]"
) -> Iterator[CalibrationWarning]:
    """Warn of mounts of beams that are nearly as probable, and not within what is stated.

    At most one of each beam.
    """
    if found.estimate.status != "converged":
        return
    state = found.ended()
    for member, (name, beam) in enumerate(beams.items()):
        if not math.isfinite(beam.direction_sigma):
            continue
        v = state.values[BEAM.name][0, member, OF_DIRECTION]
        far = max(FAR_SIGMAS * beam.direction_sigma, SAME_DIRECTION)
        for mount in _minima(state, member):
            moved = state.values[BEAM.name].copy()
            moved[0, member] = mount
            problem, _ = replace(state, values={**state.values, BEAM.name: moved}).problem()
            there = minimum(problem, problem.start, LAST_STEPS)
            if there is None:
                continue
            excess = replace(state, values=there).chi2() - state.chi2()
            angle = float(np.linalg.norm(there[BEAM.name][0, member, OF_DIRECTION] - v))
            if excess <= UNLIKELY_EXCESS and angle >= far:
                words: Values = {"beam": name, "turn_deg": float(np.degrees(angle)), "chi2": excess}
                yield warned(RIVAL, words, more=max(excess, 0.0))
                break


def _minima(state: SurveyState, member: int) -> Iterator[FloatArray]:
    """Yield other minima (8,) of a beam, with its targets where they are, from the best on."""
    items, x = state.rows.items, state.values[BEAM.name][0, member]
    own = np.flatnonzero([i.mount == (BEAM.name, member) for i in items] & state.used)
    some = own[evenly(len(own), MINIMUM_READINGS)]
    alone, _ = replace(state, used=np.isin(np.arange(len(items)), some)).problem()
    v, d = x[OF_DIRECTION], float(np.median([items[i].reading for i in some]))
    # Twice as many as before planes: spheres have minima on every side of where a beam meets them.
    half = half_sphere(2 * MINIMUM_STARTS)
    turned = half @ np.column_stack((bases(v), v)).T
    starts = np.repeat(x[None], 2 * len(turned) + 1, axis=0)  # the first is the mount itself
    starts[1:, OF_DIRECTION], starts[1:, OF_RANGE_ERROR] = np.tile(turned, (2, 1)), 0.0
    starts[len(turned) + 1 :, OF_LOCATION] += d * (v - turned)
    beams = np.repeat(state.values[BEAM.name], len(starts), axis=0)
    beams[:, member] = starts
    unknown = {BEAM.name: alone.unknown[BEAM.name]}
    problem = BlockProblem(alone.blocks, {**state.values, BEAM.name: beams}, unknown, alone.length)
    ends = search_from(problem, problem.start, LAST_STEPS)
    mounts, excess = ends.values[BEAM.name][:, member], 2.0 * (ends.cost - ends.cost[0])
    seen = [v]
    for k in np.argsort(excess).tolist():
        if excess[k] > WORTH_REFINING or len(seen) > 4:
            return
        w = mounts[k, OF_DIRECTION]
        if min(float(np.linalg.norm(w - one)) for one in seen) > SAME_DIRECTION:
            seen.append(w)
            yield mounts[k]
