"""Planes that join: fitted beside the beams, judged, and made into factors; nothing is changed yet."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..data.recording import Recording
from ..model.sensor import FLAT, within_incidence
from ..outliers.snooping import price
from ..solvers.incremental import BeamState, PlaneFactors
from .contents import Contents
from .drift import MOVES, History
from .fitted import FittedPlane, fit_plane, outliers
from .setting import Setting

GARBAGE, KNOCKED = 0.02, 1e-3
"""How often a reading is garbage, and how often a beam is knocked from one plane to the next."""


@dataclass(frozen=True, slots=True)
class Joining:
    """What became of planes that were to join.

    Attributes
    ----------
    contents : Contents
        With outliers left out, and planes that are not determined out of the graph.
    factors : dict of int to PlaneFactors
    history : History
    planes : tuple of str
        That joined.
    doubtful : tuple of str
        Planes that do not fit, whichever beam has moved a little. They are put aside, or join all the
        same where nothing is to be left out.
    fitted : mapping of str to FittedPlane
        Those that joined.
    """

    contents: Contents
    factors: dict[int, PlaneFactors]
    history: History
    planes: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()
    fitted: Mapping[str, FittedPlane] = field(default_factory=dict)


def join_planes(
    setting: Setting,
    state: BeamState,
    history: History,
    contents: Contents,
    planes: tuple[str, ...],
    reject: bool,
) -> Joining:
    """Return what becomes of `planes` beside the beams as they are.

    Parameters
    ----------
    setting : Setting
    state : BeamState
    history : History
    contents : Contents
        With the new stations of these planes; planes that are not there have been removed.
    planes : tuple of str
    reject : bool
        Whether readings that the others contradict are left out.
    """
    factors: dict[int, PlaneFactors] = {}
    joined: dict[str, FittedPlane] = {}
    doubtful: list[str] = []
    free = max(contents.numbers.values(), default=-1) + 1
    for plane in planes:
        if plane not in contents.stations:
            history = history.without_plane(plane)
            continue
        used, origin = contents.used(plane), contents.origins.get(plane)
        fitted = fit_plane(setting, used, state.beams, origin)
        if fitted is None or not fitted.determined():
            contents = contents.placed(plane, None, None)
            history = history.without_plane(plane)
            continue
        before = contents
        contents, fitted = _within_incidence(fitted, contents, plane, used, state)
        if reject:
            part = used if contents is before else contents.used(plane)
            contents, fitted = _screened(fitted, contents, plane, part, state, history)
        used = used if contents is before else contents.used(plane)
        own = fitted.information(history.reference)
        if not fitted.fits(own, history.reference):
            history = history.without_plane(plane)
            doubtful.append(plane)
            if reject:
                contents = contents.put_aside(plane, _culprit(fitted, used, state))
                continue
        else:
            history = history.with_plane(plane, own)
        contents = contents.taken_back((plane,))
        number = contents.numbers.get(plane, free + len(joined))
        contents = contents.placed(plane, number, fitted.origin)
        factors[number] = fitted.factors(number, contents.station_numbers, used)
        joined[plane] = fitted
    return Joining(contents, factors, history, tuple(joined), tuple(doubtful), joined)


def _within_incidence(
    fitted: FittedPlane, contents: Contents, plane: str, used: Recording, state: BeamState
) -> tuple[Contents, FittedPlane]:
    """Leave out the readings that meet the plane flatter than the sensor allows."""
    readings, setting = fitted.readings, fitted.setting
    if setting.sensor.max_incidence >= 0.5 * np.pi:
        return contents, fitted
    flat = np.ones(len(readings), dtype=bool)
    flat[within_incidence(readings, fitted.at, setting.sensor)] = False
    if not flat.any() or flat.all():
        return contents, fitted
    bad = np.zeros(used.ranges.shape, dtype=bool)
    column = {name: i for i, name in enumerate(used.beam_names)}
    for row in np.flatnonzero(flat).tolist():
        bad[readings.station[row], column[setting.names[readings.beam[row]]]] = True
    less = contents.leaving_out(plane, used, bad, FLAT)
    again = fit_plane(setting, less.used(plane), state.beams, fitted.origin)
    return (contents, fitted) if again is None or not again.determined() else (less, again)


def _culprit(fitted: FittedPlane, used: Recording, state: BeamState) -> str:
    """Return the only beam without which the plane would fit; empty where there is none."""
    found = []
    for name in used.beam_names if len(used.beam_names) > 1 else ():
        bad = np.zeros(used.ranges.shape, dtype=bool)
        bad[:, used.beam_names.index(name)] = True
        rest = fit_plane(fitted.setting, used.without(bad), state.beams, fitted.origin)
        if rest is not None and rest.determined() and rest.agrees(state):
            found.append(name)
    return found[0] if len(found) == 1 else ""


def _screened(
    fitted: FittedPlane,
    contents: Contents,
    plane: str,
    used: Recording,
    state: BeamState,
    history: History,
) -> tuple[Contents, FittedPlane]:
    """Leave readings out that the others contradict, unless a beam that has moved explains them."""
    setting = fitted.setting
    bad = outliers(fitted, used, state)
    if bad is None or not bad.any():
        return contents, fitted
    known = history.without_plane(plane)
    less = contents.leaving_out(plane, used, bad)
    again = fit_plane(setting, less.used(plane), state.beams, fitted.origin)
    if again is None or not again.determined():
        return contents, fitted
    moved = _rather_moved(fitted, again, known, plane, state)
    return (contents, fitted) if moved else (less, again)


def _rather_moved(
    fitted: FittedPlane, again: FittedPlane, known: History, plane: str, state: BeamState
) -> bool:
    """Tell whether a beam has moved rather than that the readings left out are garbage.

    The explanation with the larger fall of chi2 beyond its price is believed. A reading that is
    anything within the span W of the readings costs 2 ln(W / (sqrt(2 pi) sigma)), a move ln N for each
    of its unknowns, both twice the logarithm of how rare they are.
    """
    whole = known.with_plane(plane, fitted.information(known.reference))
    moved = whole.search(fitted.setting.sigma_dof, whole.recent())
    if moved is None:
        return False
    d, sigma = fitted.readings.distance, fitted.whitening.sigma
    gone = len(d) - len(again.readings.distance)
    garbage = fitted.misfit(state) - again.misfit(state)
    garbage -= 2.0 * gone * (max(price(d, sigma), 0.0) - np.log(GARBAGE))
    beams = len(fitted.setting.names)
    move = moved.statistic - MOVES * np.log(len(d)) - 2.0 * np.log(beams / KNOCKED)
    return bool(move > garbage)
