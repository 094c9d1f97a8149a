"""Planes that join: fitted beside the beams, and judged; nothing is changed yet."""

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray
from ..data.parameters import Beams
from ..model.families import MOUNT_DIM
from ..model.sensor_limits import FLAT, within_incidence
from ..outliers.reading_tests import price
from ..solvers.isam import BeamState
from .config import SessionConfig
from .contents import Contents, PlaneContents
from .moved_beam import recent, search
from .plane import FittedPlane, fit_plane

CONTRADICTED = "contradicted by the beams and the other readings"
GROSS_ERROR = 0.02
"""Prior probability that a reading is a gross error."""
DISPLACED = 1e-3
"""Prior probability that a beam is displaced between two planes."""


def fitted_planes(contents: Contents, config: SessionConfig, at: Beams) -> Contents:
    """Return the contents with every plane in that `at` determines and that is not excluded."""
    number, planes = 0, {}
    for name, plane in contents.planes.items():
        fitted = None
        if plane.culprit is None:
            fitted = fit_plane(config, plane.used(), at)
        planes[name] = replace(plane, number=None if fitted is None else number, fitted=fitted)
        number += fitted is not None
    return contents.with_planes(planes)


def join_planes(
    config: SessionConfig, at: Beams, state: BeamState, contents: Contents, names: tuple[str, ...]
) -> tuple[Contents, tuple[str, ...], tuple[str, ...]]:
    """Join planes to the beams as they are, or take out those that are not determined.

    Parameters
    ----------
    config : SessionConfig
    at : Beams
        Beams about which all planes are linearised.
    state : BeamState
        Beams as they are.
    contents : Contents
        With the changes of these planes in them.
    names : tuple of str

    Returns
    -------
    Contents
        With outliers rejected, and planes that are not determined out of the graph.
    joined : tuple of str
        Planes that joined.
    inconsistent : tuple of str
        Planes that do not fit, whichever beam has moved a little. They are excluded, or join all the
        same where nothing is to be rejected.
    """
    joined: list[str] = []
    inconsistent: list[str] = []
    for name in names:
        if name not in contents.planes:
            continue
        own = contents.planes[name]
        origin = None if own.fitted is None else own.fitted.origin
        fitted = fit_plane(config, own.used(), at, origin)
        if fitted is None:
            contents = contents.with_planes({name: own.taken_out()})
            continue
        own, fitted = _less(own, fitted, _flat(fitted, own), FLAT) or (own, fitted)
        if config.reject:
            # Unless a beam that has moved explains them, readings that contradict others are out.
            less = _less(own, fitted, fitted.outliers(own.used(), state), CONTRADICTED)
            if less is not None and not _rather_moved(contents, name, fitted, less[1], state):
                own, fitted = less
        if not fitted.fits:
            inconsistent.append(name)
            if config.reject:
                culprit = fitted.culprit(own.used(), state)
                contents = contents.with_planes({name: own.taken_out(culprit)})
                continue
        free = max(contents.numbers.values(), default=-1) + 1
        number = free if own.number is None else own.number
        own = replace(own, number=number, fitted=fitted, culprit=None)
        contents = contents.with_planes({name: own})
        joined.append(name)
    return contents, tuple(joined), tuple(inconsistent)


def _less(
    own: PlaneContents, fitted: FittedPlane, bad: BoolArray | None, reason: str
) -> tuple[PlaneContents, FittedPlane] | None:
    """Return contents and plane with readings (M, B) rejected; None for none, or too few left."""
    if bad is None or not bad.any():
        return None
    less = own.less(bad, reason)
    again = fit_plane(fitted.config, less.used(), fitted.parameters.beams, fitted.origin)
    return None if again is None else (less, again)


def _flat(fitted: FittedPlane, own: PlaneContents) -> BoolArray | None:
    """Return the readings (M, B) that meet the plane flatter than the sensor allows."""
    readings, sensor = fitted.readings, fitted.config.options.sensor
    if sensor.max_incidence >= 0.5 * np.pi:
        return None
    flat = np.ones(len(readings), dtype=bool)
    flat[within_incidence(readings, fitted.parameters, sensor)] = False
    return None if flat.all() else fitted.mask(own.used(), flat)


def _rather_moved(
    contents: Contents, name: str, fitted: FittedPlane, again: FittedPlane, state: BeamState
) -> bool:
    """Tell whether a beam has moved rather than that the rejected readings are gross errors.

    The explanation with the larger fall of chi2 beyond its price is believed. A reading that is
    anything within the span W of the readings costs 2 ln(W / (sqrt(2 pi) sigma)), a move ln N for each
    of its unknowns, both twice the logarithm of how rare they are.
    """
    own = replace(contents.planes[name], fitted=fitted)
    planes = contents.with_planes({name: own}).fitted
    planes = {plane: one for plane, one in planes.items() if one.fits or plane == name}
    moved = search(fitted.config, planes, recent(len(planes)))
    if moved is None:
        return False
    d, sigma = fitted.readings.distance, fitted.whitening.sigma
    gone = len(d) - len(again.readings.distance)
    of_beam = fitted.readings.beam == fitted.config.names.index(moved.name)
    if (
        gone == of_beam.sum()
        and not np.isin(again.readings.beam, fitted.readings.beam[of_beam]).any()
    ):
        return True  # of a far move the fall of chi2 is known to a part of itself only
    gross = fitted.misfit(state) - again.misfit(state)
    gross -= 2.0 * gone * (max(price(d, sigma), 0.0) - np.log(GROSS_ERROR))
    beams = len(fitted.config.names)
    move = moved.statistic - MOUNT_DIM * np.log(len(d)) - 2.0 * np.log(beams / DISPLACED)
    return bool(move > gross)
