"""Why the shots of a survey do not fit each other: sensors or targets that are not what is stated.

Two mistakes show within shots, whatever the mount: zones of a ToF array that read along their rays or
at right angles to the array, which differ by the cosine of each zone's angle, and a ball that is
labelled a plane, or a plane that is labelled a sphere. Under the wrong reading a target loses its
shape, so that shots alone decide: the sum of squares within them, with a fixed price for readings that
no shape fits. The other way has to cost less than half, and to fit nearly all readings: where shots
show more than their target, neither way says anything. The other kind of a target has to fit the whole
survey, too. Cones are tried with other angles once all is solved.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from difflib import get_close_matches
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray, evenly
from ..data.noise import Noise
from ..data.survey import ERRORS, RAY_ERRORS, Known, Shots, Survey, kind_of, normal_label
from ..errors import CalibrationWarning, InputError
from ..estimation.estimate import MOST_REJECTED, Estimate
from ..estimation.survey import (
    FirstFit,
    RelationTest,
    SurveyEstimate,
    begin_quickly,
    estimate_survey,
    state_of,
    surely_fits,
)
from ..estimation.survey_outliers import (
    GROSS,
    MOST_LEFT_OUT,
    OF_OTHERS,
    beside_balls,
    misses_of,
)
from ..estimation.survey_rows import Entity, SurveyRows, rows_of
from ..estimation.survey_state import SurveyState
from ..model.condensed_shots import LARGEST_BALL, Stated
from ..model.distributions import FAMILY_LEVEL, f_sf, gaussian_sf, p_words
from ..model.equation import plausible_factors
from ..model.families import BEAM, FAMILIES, OF_RANGE_ERROR, PLANE
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets.sphere import SPHERE
from ..model.targets_in_shots import condensed_shots, surely_balls
from ..quantities import FAR_SIGMAS, IN_DEG, IN_MM, ROUGH_CUT, WIDEST_CONE
from ..text import count, some
from .lines import NAMES_IN_LINE
from .messages import Values, said, warned
from .warnings import DISPLACED, IMPLAUSIBLE, much_alike

NO_FIT = "no-fit"
"""Code of the warning that most shots do not fit each other."""
FALSE_RELATION = "relation-contradicted"
"""Code of the warning that readings contradict what is said to be known."""
MISREAD = (
    "convention",
    "target-kind",
    "undetermined-label",
    "half-angle",
    "behind-echo",
    "beside-ball",
    IMPLAUSIBLE,
)
"""Codes of mistakes with which no result is usable, and no advice on the motion means anything."""
PULLED = 2.0
"""Readings are pulled if their median is off by more standard deviations of one. Less is lost in the
noise: a real array reads 4 mm short behind echoes of 80 to 100 mm, and 14 to 45 mm behind nearer ones,
with 6 mm of noise."""
OTHER_KIND = {"plane": "sphere", "sphere": "plane"}
"""What a target may be in place of what its label says: shots of grooves are split before."""
MUCH_DEARER = 2.0
"""Real arrays before clutter cost up to 1.5 times as much one way as the other, from file to file; with
noise of a fifth of what the two ways differ by, the wrong one costs ten times as much."""
Cost = tuple[float, float, int]
"""What shots cost when they are read in one way: see `_squares`."""


def misread(rows: SurveyRows, noise: Noise) -> Iterator[CalibrationWarning]:
    """Warn of arrays that fit the other convention better, and of targets that fit the other kind."""
    labels = rows.survey.stations.plane_labels
    for shots in rows.survey.shots:
        better = better_convention(shots, labels)
        if better is not None:
            yield warned("convention", {"sensor": shots.name, "better": better})
    for label, better in better_kinds(rows.survey, noise).items():
        kind, _, name = label.partition(":")
        values = {"target": label, "kind": kind, "better": better}
        towards = "; ".join(counted_towards(rows).values()) if kind == SPHERE.name else ""
        if towards:
            yield warned("target-kind:towards", values, towards=towards)
        else:
            yield warned("target-kind", {**values, "label": f"{better}:{name}"})


def counted_towards(rows: SurveyRows) -> dict[int, str]:
    """Return what to try of profilers whose shots show balls only where z grows towards the sensor.

    Keys are the numbers of these sensors. A shape in a profile is the same wherever it is along z, so
    that z is reversed about its own middle.
    """
    labels, found = rows.survey.stations.plane_labels, {}
    for member, shots in enumerate(rows.survey.shots):
        before = [at for i, at in rows.lost if i == member and kind_of(labels[at]) == SPHERE.name]
        met = sum(i.member == member and i.target[0] == SPHERE.name for i in rows.items)
        if shots.kind != "profiler" or len(before) <= met:
            continue
        turned = float(shots.reading.min() + shots.reading.max()) - shots.reading
        tables = [(shots.across[shots.station == s], turned[shots.station == s]) for s in before]
        shown = condensed_shots(KINDS[shots.kind], SPHERE.name, tables, Stated(sigma=shots.sigma))
        if sum(shot is not None for shot in shown) > 0.5 * len(before):
            found[member] = f"if z of {shots.name} grows towards the sensor, reverse its sign"
    return found


def misheard(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of cones whose readings fit far better with another half angle, by an F test, or as well.

    Each reading that does not fit costs as much as one that just does.
    """
    cones = found.rows.survey.cones
    if not cones.any() or found.estimate.status not in ("converged", "contradicted"):
        return
    noise, sources = found.given, found.rows.sources
    sigma = [found.noise.sigma[sources[BEAM.name, i]] for i in range(len(cones))]
    survey = replace(found.rows.survey, range_sigma=np.array(sigma))
    if noise.pose_covariance is None:
        turn, shift = found.noise.pose
        noise = replace(noise, pose_rotation_sigma=turn, pose_translation_sigma=shift)
    for stated in np.unique(cones[cones > 0.0]).tolist():
        one = [] if (cones == stated).all() else np.flatnonzero(cones == stated).tolist()
        of = " of " + some([survey.beam_names[i] for i in one], NAMES_IN_LINE) if one else ""
        yield from _misheard(found, survey, noise, stated, of)


def _misheard(
    found: SurveyEstimate, survey: Survey, noise: Noise, stated: float, of: str
) -> Iterator[CalibrationWarning]:
    """Warn of the cones with one stated half angle, whose names are said where others have another."""
    mine = survey.cones == stated

    def fitted(half_angle: float, beside: SurveyEstimate) -> tuple[SurveyEstimate, float]:
        other = replace(survey, half_angle=np.where(mine, half_angle, survey.cones))
        again = _again(other, noise, beside)
        if again is None:
            return beside, np.inf
        squares = again.estimate.chi2 + FAR_SIGMAS**2 * float((~again.used).sum())
        return again, squares

    at_stated, squares = fitted(stated, found)
    least, better, tries = squares, stated, 0
    others: list[tuple[float, float, SurveyEstimate]] = []
    # A datum of a data sheet may be another one, or the whole angle in its place. From the stated
    # angle outwards each begins where the one before ended. On the way to the right one the misfit may
    # grow by a tenth, as shots come in and others go out; beyond it, it grows to nearly twice as much.
    for outwards in ((0.8, 0.6, 0.5), (1.25, 1.6, 2.0)):
        before, squares_before = at_stated, squares
        for half_angle in (part * stated for part in outwards if part * stated <= WIDEST_CONE):
            tries += 1
            again, now = fitted(half_angle, before)
            if not np.isfinite(now):
                continue
            if now > 1.5 * squares_before:
                break
            before, squares_before = again, now
            others.append((half_angle, now, again))
            if now < least:
                least, better = now, half_angle
    dof = found.estimate.dof
    if least <= 0.0 or not np.isfinite(least) or dof < 1:
        return
    variance = least / dof
    gain = (squares - least) / variance
    if better != stated and np.isfinite(gain) and f_sf(gain, 1, dof) < FAMILY_LEVEL / tries:
        yield warned("half-angle", {"half_angle": better}, stated=stated, of=of)
        return
    alike = [(a, e) for a, s, e in others if s - squares <= FAR_SIGMAS**2 * variance]
    shifts = [(_shift_of_beams(at_stated, other), angle) for angle, other in alike]
    (times, shift), angle = max(shifts, default=((0.0, 0.0), stated))
    if times > 1.0:
        yield warned(
            "half-angle-unsure", {"half_angle": angle, "shift_m": shift}, stated=stated, of=of
        )


def _again(survey: Survey, noise: Noise, earlier: SurveyEstimate) -> SurveyEstimate | None:
    """Return the estimate of a survey from where another ended; None where it ends in no minimum."""
    with suppress(InputError):  # no start
        found = estimate_survey(survey, noise, earlier)
        return found if found.estimate.status in ("converged", "contradicted") else None
    return None


def _shift_of_beams(found: SurveyEstimate, other: SurveyEstimate) -> tuple[float, float]:
    """Return the largest shift of a beam between two estimates, in its sigmas and in metres."""
    moved = other.estimate.values[BEAM.name][:, :3] - found.estimate.values[BEAM.name][:, :3]
    shifts = np.linalg.norm(moved, axis=1)
    blocks = [found.estimate.marginal(BEAM.name, i)[:3, :3] for i in range(len(moved))]
    sigma = np.sqrt([np.trace(C) for C in blocks])
    return max(zip((shifts / sigma).tolist(), shifts.tolist(), strict=True))


def pulled(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of arrays of which what stands behind a near echo misses its planes by more than its noise.

    Mounts and planes are those without any of these readings, because they pull the whole fit. All
    bands of the echo before count up to the farthest one that is off.
    """
    survey = found.rows.survey
    if found.estimate.status == "undetermined":
        return
    for member, shots in enumerate(survey.shots):
        if shots.before is None:
            continue
        # Parts of the typical reading up to which an echo may pull what its zone reads behind it.
        edges = np.array([0.0, 0.15, 0.2, 0.25, 0.3, 0.4]) * float(np.median(shots.reading))
        edges = edges[[(shots.before < edge).mean() < MOST_LEFT_OUT for edge in edges.tolist()]]
        if not (shots.before < edges[-1]).any():
            continue
        changed = list(survey.shots)
        changed[member] = shots.clear_of(float(edges[-1]))
        clear = _again(replace(survey, shots=tuple(changed)), found.given, found)
        if clear is None:
            continue
        sigma, miss = float(clear.noise.sigma[member]), _misses(found.rows, clear, member)
        limit, beside = 0.0, False
        for near, far in pairwise(edges.tolist()):
            e = miss[(shots.before >= near) & (shots.before < far) & np.isfinite(miss)]
            middle = float(np.median(e)) if e.size else 0.0
            # The median of n Gaussian numbers has the variance pi / (2 n).
            chance = FAR_SIGMAS * sigma * np.sqrt(np.pi / (2.0 * max(e.size, 1)))
            # The pull fades with the distance: next to pulled readings it may be within the noise.
            beside = abs(middle) > (chance if beside else max(PULLED * sigma, chance))
            if beside:
                limit = float(np.ceil(far * IN_MM))
        if limit:
            short = -float(np.median(miss[(shots.before * IN_MM < limit) & np.isfinite(miss)]))
            values: Values = {"sensor": shots.name, "limit_mm": limit, "short_m": short}
            way = "short" if short > 0.0 else "long"
            yield warned("behind-echo", values, size=abs(short), way=way)


def beside_ball(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of arrays of which more than `MOST_LEFT_OUT` of the rays at a ball read anything else.

    Of simulated arrays with half of the zones at edges, all of 16 mounts with less were right, and one
    of five with more.
    """
    for member, shots in enumerate(found.rows.survey.shots):
        part = beside_balls(found.rows, found.values, member)
        if found.estimate.status == "converged" and part > MOST_LEFT_OUT:
            yield warned("beside-ball", {"sensor": shots.name, "part": part})


def _misses(rows: SurveyRows, clear: SurveyEstimate, member: int) -> FloatArray:
    """Return by how much all readings of a sensor miss their planes in another estimate (N,) [m].

    NaN where the target is no plane, or not known to that estimate.
    """
    shots, labels = rows.survey.shots[member], rows.survey.stations.plane_labels
    miss = np.full(len(shots.reading), np.nan)
    names = np.array([normal_label(label) for label in labels])[shots.station]
    for plane, label in enumerate(clear.rows.targets.get(PLANE.name, ())):
        some = np.flatnonzero(names == label)
        miss[some] = misses_of(rows, clear.values, member, (PLANE.name, plane), some)
    return miss


def curved(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of sensors whose shots fit each other with range errors as unknowns, and not without them.

    Small ones show in score tests of shots that fit.
    """
    survey, given = found.rows.survey, found.given
    if not survey.shots:
        return
    along = RAY_ERRORS[:3]  # k0, k1 and k2; a scale across the rays shows in score tests
    more = [
        replace(one, free=tuple(sorted({*one.free, *along} & {*ERRORS[one.kind]})))
        for one in survey.shots
    ]
    survey = replace(survey, shots=tuple(more))
    state = state_of(rows_of(survey, given), given)
    if not (begin_quickly(state) and surely_fits(state)):
        return
    free = estimate_survey(survey, given, begun=state).estimate
    if free.status != "converged":
        return
    sigma = dict(zip(free.names, np.sqrt(np.diagonal(free.covariance)).tolist(), strict=True))
    for member, shots in enumerate(survey.shots):
        k = free.values[SENSOR.name][member, 12:][: len(along)]
        sizes = {
            code: (float(size), sigma[f"{SENSOR.name}[{member}].{code}"])
            for code, size in zip(along, k, strict=True)
            if code in ERRORS[shots.kind]
        }
        far = {
            code: abs(size) / s for code, (size, s) in sizes.items() if abs(size) > FAR_SIGMAS * s
        }
        if not far or not plausible_factors(k[1:], shots.reading).all():
            continue
        code = max(far, key=lambda one: far[one])
        size, of_size = sizes[code]
        p = 2.0 * float(gaussian_sf(far[code]))
        which = {"sensor": shots.name, "code": code, "alike": "", "free": '", "'.join(far)}
        values = {"size": size, "sigma": of_size, "p": p}
        # Readings, positions and mounts that are all of one scale have the same residuals.
        also = said("scaled-instead", times=1.0 + size) if list(far) == ["k1"] else ""
        yield warned("range-error", {**which, **values}, likely=p_words(p, 1), also=also)


def no_fit(
    rows: SurveyRows, fit: FirstFit, causes: Sequence[CalibrationWarning], given: Noise
) -> CalibrationWarning:
    """Say by how much shots miss their targets, in lengths and against the noise, and what to do."""
    labels = dict.fromkeys(rows.survey.stations.plane_labels)
    plain = [one for one in labels if ":" not in one]
    names, have = some(plain, NAMES_IN_LINE), "has" if len(plain) == 1 else "have"
    hints = {"kind": plain, "known": rows.known, "groove": "groove" in map(kind_of, labels)}
    more = [said(f"survey-checks:{of}", names=names, have=have) for of in hints if hints[of]]
    known = [one.message for one in causes if one.code in (*MISREAD, DISPLACED, "range-error")]
    known += _listed_twice(rows)
    checks = "".join((said("survey-checks"), *more))
    if any(one.code == "range-error" for one in causes):  # another scale of the poses looks like k1
        known.append(f"otherwise {checks}")
    what = "; ".join(known) or checks
    noise = some(first_noise(rows, fit, given), NAMES_IN_LINE)
    values = {"misfit": fit.misfit, "distance_m": fit.distance}
    return warned(f"{NO_FIT}:shots", values, noise=noise, what=what, of=fit.of)


def _listed_twice(rows: SurveyRows) -> Iterator[str]:
    """Say of which sensors many scans are listed under several labels of one kind, with all points.

    Each of these says that most points are on its own target. A ball before a wall, and that wall, may
    be in one scan. A few scans, or equal readings of few zones, keep nothing from fitting.
    """
    survey, stations = rows.survey, rows.survey.stations
    labels = [normal_label(label) for label in stations.plane_labels]
    for shots in survey.shots:
        alike = defaultdict[tuple[int, str, bytes, bytes], list[int]](list)
        seen = np.unique(shots.station).tolist()
        for station in seen:
            own = shots.station == station
            across, reading = shots.across[own], shots.reading[own]
            if np.ptp(reading) > 0.0:
                kind = kind_of(labels[station])
                same = int(rows.stops[station]), kind, across.tobytes(), reading.tobytes()
                alike[same].append(station)
        several = [each for each in alike.values() if len({labels[one] for one in each}) > 1]
        if sum(map(len, several)) > MOST_REJECTED * len(seen):
            names = [f"{stations.station_names[one]} ({labels[one]})" for one in several[0]]
            number = count(len(several), "scan")
            yield said("listed-twice", scans=number, sensor=shots.name, stations=some(names, 6))


def with_causes(error: InputError, causes: Iterable[CalibrationWarning]) -> InputError:
    """Return why nothing leads to a start, with the mistakes that are known in place of what to do."""
    known = "; ".join(one.message for one in causes)
    return InputError(error.found, known or error.expected)


def unconfirmed(
    rows: SurveyRows, causes: Sequence[CalibrationWarning]
) -> Iterator[CalibrationWarning]:
    """Warn of sensors that lose more shots than may be rejected, where the rest does not confirm them.

    It confirms them where the shots of every target that count say more than the unknowns of that
    target. Fewer lost shots are too many where they show their ball with z reversed, or where no shot
    of a target counts, and no other target could show what is wrong: planes look alike from a sensor
    that is read inside out, spheres do not. `causes` say of the shots why they are lost.
    """
    labels = [normal_label(label) for label in rows.survey.stations.plane_labels]
    numbers = Counter[str]()
    for item in rows.items:
        numbers[labels[item.station]] += item.numbers
    told = {label for label in numbers if numbers[label] > FAMILIES.get(kind_of(label), PLANE).dim}
    round_told = any(kind_of(label) == SPHERE.name for label in told)
    turned = counted_towards(rows)
    for member, shots in enumerate(rows.survey.shots):
        lost = [labels[at] for own, at in rows.lost if own == member]
        total = len(np.unique(shots.station))
        balls = [one for one in dict.fromkeys(lost) if kind_of(one) == SPHERE.name]
        open_ = [label for label in dict.fromkeys(lost) if label not in told]
        if member in turned:
            open_ = balls
        elif len(lost) <= MOST_REJECTED * total:
            open_ = [] if round_told else [one for one in balls if not numbers[one]]
        if open_:
            targets, what = some(open_, NAMES_IN_LINE), "; ".join(one.message for one in causes)
            values: Values = {"sensor": shots.name, "lost": len(lost), "targets": targets}
            yield warned(f"{NO_FIT}:lost", values, total=total, what=what)


def mislabelled(state: SurveyState, found: Estimate) -> Iterator[CalibrationWarning]:
    """Warn of targets that are undetermined, and whose shots fit another one with more stations.

    Parameters
    ----------
    state : SurveyState
        At the values of the estimate.
    found : Estimate
    """
    rows, stations = state.rows, _stations_of(state.rows)
    known = {one for one in stations if np.isfinite(found.marginal(*one)).all()}
    for target in stations.keys() - known:
        misfit: dict[str, float] = {}
        for other in known:
            if other[0] == target[0] and stations[other] > stations[target]:
                misfit[rows.label(other)] = _misfit_as(state, target, other)
        best = min(misfit, key=lambda label: misfit[label], default="")
        if best and misfit[best] < GROSS:
            label = rows.label(target)
            how = "a misspelt" if get_close_matches(label, [best]) else "another name of"
            values: Values = {"target": label, "other": best}
            how_many = count(stations[target], "station")
            yield warned("undetermined-label", values, stations=how_many, how=how)


def misspelt(state: SurveyState, found: Estimate) -> Iterator[CalibrationWarning]:
    """Warn of labels that few stations have, much like another one whose target their shots fit.

    These targets are determined; of others `mislabelled` warns. Parameters are as there.
    """
    rows, stations = state.rows, _stations_of(state.rows)
    for family in rows.targets:
        own = [one for one in stations if one[0] == family]
        own = [one for one in own if np.isfinite(found.marginal(*one)).all()]
        names = [rows.label(one).rpartition(":")[2] for one in own]
        for few, other in much_alike(names, [stations[one] for one in own]):
            if _misfit_as(state, own[few], own[other]) < FAR_SIGMAS:
                values: Values = {"target": rows.label(own[few]), "other": rows.label(own[other])}
                how_many = count(stations[own[few]], "station")
                yield warned("misspelt-label:survey", values, stations=how_many)


def _stations_of(rows: SurveyRows) -> dict[Entity, int]:
    """Return how many stations each target has."""
    pairs = {(item.target, item.station) for item in rows.items}
    return Counter(target for target, _ in pairs)


def _misfit_as(state: SurveyState, target: Entity, other: Entity) -> float:
    """Return the typical misfit of the shots of a target, if they are of another one [sigmas]."""
    rows = state.rows
    own = np.array([item.target == target for item in rows.items])
    items = [replace(i, target=other) if i.target == target else i for i in rows.items]
    renamed = replace(state, rows=replace(rows, items=tuple(items)))
    return float(np.median(renamed.misfits()[own]))


def implausible(rows: SurveyRows, values: Mapping[str, FloatArray]) -> Iterator[CalibrationWarning]:
    """Warn of single beams that fit only with range errors that no sensor has."""
    ranges = rows.survey.ranges
    for member, name in enumerate(rows.survey.beam_names):
        assert ranges is not None
        d, k = ranges[:, member], values[BEAM.name].reshape(-1, BEAM.size)[member, OF_RANGE_ERROR]
        if not plausible_factors(k, d[~np.isnan(d)]).all():
            yield warned(f"{IMPLAUSIBLE}:beam", {"beam": name})


def contradictions(tests: Sequence[RelationTest]) -> Iterator[CalibrationWarning]:
    """Warn of the relations that the readings contradict, and of rivals only once."""
    named: list[Known] = []
    for tested in tests:
        if not tested.contradicted or tested.known in named:
            continue
        named += [tested.known, *tested.rivals]
        known = " or ".join(one.words for one in (tested.known, *tested.rivals))
        values: Values = {"p": tested.p_value, "known": known}
        likely = p_words(tested.p_value, 1)
        if tested.rivals:
            yield warned(f"{FALSE_RELATION}:either", values, likely=likely)
        else:
            yield warned(FALSE_RELATION, values, likely=likely)


def first_noise(rows: SurveyRows, fit: FirstFit, given: Noise) -> tuple[str, ...]:
    """Return the standard deviations of readings and hand at a first fit, and where each is from."""
    sigma = fit.noise.sigma.tolist()
    hows = ["from its shots" if one.sigma is None else "as stated" for one in rows.survey.shots]
    of_beams = rows.survey.stated_sigmas[np.unique(rows.survey.beam_sources, return_index=True)[1]]
    hows += [_how(given.range_sigma if np.isnan(own) else own) for own in of_beams.tolist()]
    parts = [
        f"{name} {one * IN_MM:.2g} mm {how}"
        for name, one, how in zip(rows.names_of_noise(), sigma, hows, strict=False)
    ]
    if given.pose_covariance is not None:
        return (*parts, "hand as its covariances state")
    turn, shift = fit.noise.pose
    how, of_turn = _how(given.pose_translation_sigma), _how(given.pose_rotation_sigma)
    of_shift = "" if how == of_turn else f" {how}"
    hand = f"hand {shift * IN_MM:.2g} mm{of_shift} and {turn * IN_DEG:.2g} deg {of_turn}"
    return (*parts, hand)


def _how(stated: float | None) -> str:
    return "assumed" if stated is None else "as stated"


def better_convention(shots: Shots, labels: tuple[str, ...]) -> str | None:
    """Return the convention that readings of an array fit better; None where it is the one stated.

    Parameters
    ----------
    shots : Shots
        Of an array; what is no array has no convention.
    labels : tuple of str
        Targets of the stations.
    """
    if shots.kind != "array":
        return None
    cosine = shots.across[:, 2]
    if shots.convention == "radial":
        other, reading = "perpendicular", shots.reading / cosine
    else:
        other, reading = "radial", shots.reading * cosine
    kinds = {s: kind_of(labels[s]) for s in np.unique(shots.station).tolist()}
    variance = shots.sigma**2 if shots.sigma else 0.0
    if not variance:
        first = _squares(shots, shots.reading, kinds), _squares(shots, reading, kinds)
        variance = min((total / dof for total, dof, _ in first if dof), default=0.0)
    if variance <= 0.0:
        return None
    sigma = float(np.sqrt(variance))  # single shots of nine zones call too many readings far
    ways = (_squares(shots, shots.reading, kinds, sigma), _squares(shots, reading, kinds, sigma))
    return other if _much_better([(*ways, variance)]) else None


def better_kinds(survey: Survey, noise: Noise) -> dict[str, str]:
    """Return the labels of planes and spheres that fit the other kind better, with that kind.

    The shots of a target decide by themselves, and the whole survey with the other labels has to agree,
    as every sensor sees it that has a few shots there: a ball that is seen in small parts looks flat in
    each, but not in all together. Without a quick start of all sensors nothing is said.
    """
    labels = [normal_label(label) for label in survey.stations.plane_labels]
    suspects = {
        label: OTHER_KIND[kind_of(label)]
        for label in dict.fromkeys(labels)
        if kind_of(label) in OTHER_KIND and _looks_other(survey.shots, labels, label)
    }
    if not suspects:
        return {}
    renamed = {label: f"{kind}:{label.partition(':')[2]}" for label, kind in suspects.items()}
    # One name may stand for a plane and for a sphere: then both labels are one target.
    changed = tuple(renamed.get(label, label) for label in labels)
    known = tuple(one for one in survey.known if not suspects.keys() & set(one.of))
    stations = replace(survey.stations, plane_labels=changed)
    rows = rows_of(replace(survey, stations=stations, known=known))
    if not rows.items:
        return {}
    state = state_of(rows, noise)
    if not begin_quickly(state):
        return {}
    each = defaultdict[str, dict[Entity, list[float]]](lambda: defaultdict(list))
    for item, misfit in zip(state.rows.items, state.misfits().tolist(), strict=True):
        each[labels[item.station]][item.mount].append(misfit)
    radii = state.values.get(SPHERE.name, np.empty((1, 0, SPHERE.size)))[0, :, -1].tolist()
    balls = zip(state.rows.targets.get(SPHERE.name, ()), radii, strict=True)
    flat = {label for label, radius in balls if radius > LARGEST_BALL * state.rows.length}
    better = {}
    for label, kind in suspects.items():
        shots = each[label].values()
        least = min(3, max(map(len, shots), default=0))
        fits = [np.median(own) < GROSS for own in shots if len(own) >= least]
        if fits and all(fits) and renamed[label] not in flat:
            better[label] = kind
    return better


def _looks_other(sensors: Sequence[Shots], labels: Sequence[str], label: str) -> bool:
    """Tell whether the shots of all sensors before one target have the shape of the other kind.

    Of few readings no sphere is known by its shot. Where no sensor knows one, the planes that others
    are labelled tell each sensor whether this target is as flat, and one that finds it is not decides.
    A ball may be a small part of its shots, and all else in them a table: one sensor that finds it in
    half of them decides.
    """
    kind = kind_of(label)
    sure: list[tuple[Cost, Cost, float]] = []
    knowing: list[tuple[Shots, float]] = []
    as_planes: list[tuple[Shots, Cost]] = []
    for shots in sensors:
        seen = [s for s in np.unique(shots.station).tolist() if labels[s] == label]
        ways = {one: _squares(shots, shots.reading, dict.fromkeys(seen, one)) for one in OTHER_KIND}
        if ways["sphere"][1] or ways["sphere"][2]:
            variance = min((total / dof for total, dof, _ in ways.values() if dof), default=0.0)
            sure.append((ways[kind], ways[OTHER_KIND[kind]], variance))
            knowing.append((shots, variance))
        elif ways["plane"][1]:
            as_planes.append((shots, ways["plane"]))
    if sure:
        if not _much_better(sure):
            return False
        return kind == "plane" or not any(_shows_balls(*one, labels, label) for one in knowing)
    bent = [_bent(shots, labels, label, way) for shots, way in as_planes]
    return (kind == "plane") in bent


def _shows_balls(shots: Shots, variance: float, labels: Sequence[str], label: str) -> bool:
    """Tell whether at least half of the shots before one target surely have a ball among their points.

    Where a table is labelled as a ball, a ball may lie in the view of some shots.
    """
    seen = [s for s in np.unique(shots.station).tolist() if labels[s] == label]
    own = [shots.station == s for s in seen]
    tables = [(shots.across[rows], shots.reading[rows]) for rows in own]
    kind = KINDS[shots.kind]
    found = condensed_shots(kind, SPHERE.name, tables, Stated(sigma=shots.sigma))
    return 2 * int(surely_balls(kind, tables, found, variance).sum()) >= len(seen)


def _bent(shots: Shots, labels: Sequence[str], label: str, as_plane: Cost) -> bool | None:
    """Tell whether a target is less flat than planes are; None where nothing says what flat is.

    Readings that fit no plane bend it only where it loses a larger part of them than other planes.
    """
    stations = np.unique(shots.station).tolist()
    planes = [s for s in stations if kind_of(labels[s]) == "plane" and labels[s] != label]
    total, dof, gone = _squares(shots, shots.reading, dict.fromkeys(planes, "plane"))
    variance = shots.sigma**2 if shots.sigma else total / max(dof, 1.0)
    if variance == 0.0:
        return None
    squares, own, lost = as_plane
    of_others = max(OF_OTHERS, gone / max(dof + gone, 1.0))
    bent = max(lost - of_others * (own + lost), 0.0)
    return squares / variance + ROUGH_CUT**2 * bent > MUCH_DEARER * (own + lost)


def _much_better(sensors: Iterable[tuple[Cost, Cost, float]]) -> bool:
    """Tell whether the other way costs far less, and fits nearly all readings.

    Each sensor has the way as stated, the other, and the variance of a reading [m^2]: zero where no
    shot of it has a shape, and it says nothing.
    """
    now = changed = 0.0
    many, gone = 0.0, 0
    for stated, other, variance in sensors:
        if variance > 0.0:
            now += stated[0] / variance + ROUGH_CUT**2 * stated[2]
            changed += other[0] / variance + ROUGH_CUT**2 * other[2]
            many, gone = many + other[1], gone + other[2]
    return many > 0 and gone <= OF_OTHERS * (many + gone) and now > MUCH_DEARER * changed


def _squares(
    shots: Shots, reading: FloatArray, kinds: Mapping[int, str], sigma: float | None = None
) -> Cost:
    """Return the squares within shots [m^2], their degrees of freedom, and how many fit nothing.

    Parameters
    ----------
    shots : Shots
    reading : (N,)
        Its readings, or what they would be.
    kinds : mapping
        What is seen at each station that counts.
    sigma : float, optional
        Standard deviation of a reading [m], where it is known.
    """
    total, dof, lost, rng = 0.0, 0.0, 0, np.random.default_rng(len(reading))
    order = np.argsort(shots.station, kind="stable")
    for target in OTHER_KIND:
        seen = np.array([s for s, kind in kinds.items() if kind == target], dtype=np.intp)
        begins, ends = np.searchsorted(shots.station, (seen, seen + 1), sorter=order)
        # A thousand readings say it: of nine zones with clutter before them, twenty shots do not. Of
        # profiles a few shots would do, but others may be on something else.
        points = int((ends - begins).sum()) // max(len(seen), 1)
        some = evenly(len(seen), max(20, 1000 // max(points, 1)))
        each = [order[begins[i] : ends[i]] for i in some.tolist()]
        # 64 points tell a shape, and shots of equal length are condensed together. They are drawn,
        # because those at even steps of an image may lie on one line.
        each = [rng.permutation(rows)[:64] for rows in each]
        tables = [(shots.across[rows], reading[rows]) for rows in each]
        seen_in = condensed_shots(KINDS[shots.kind], target, tables, Stated(sigma=sigma))
        for (_, d), shot in zip(tables, seen_in, strict=True):
            if shot is None:
                lost += len(d)
                continue
            if not shot.hardly_known:
                total += shot.squares + float(shot.rest @ shot.rest)
                dof += shot.dof + len(shot.rest)
            # What is behind a ball is no part of it that does not fit.
            farthest = d[shot.kept].max() if target == SPHERE.name else np.inf
            lost += int((~shot.kept & (d <= farthest)).sum())
    return total, dof, lost
