"""Planes that join: fitted beside the beams, judged, and made into factors; nothing is changed yet."""

from dataclasses import dataclass

from ..arrays import BoolArray
from ..diagnosis.drift import History
from ..recording import Recording
from ..solvers.incremental import BeamState, PlaneFactors
from .contents import Contents
from .fitted import FittedPlane, fit_plane, outliers
from .setting import Setting

MANY = 3
"""Readings of one beam at fault in one plane: it is rather the beam that has moved, if that explains
them."""
SUSPICIOUS = 1e-3
"""Probability below which the readings that are left look as if a beam had moved."""


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
        Those of them that do not fit, whichever beam has moved.
    """

    contents: Contents
    factors: dict[int, PlaneFactors]
    history: History
    planes: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()


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
    joined: list[str] = []
    doubtful: list[str] = []
    free = max(contents.numbers.values(), default=-1) + 1
    for plane in planes:
        if plane not in contents.stations:
            history = history.without_plane(plane)
            continue
        used, origin = contents.used(plane), contents.origins.get(plane)
        fitted = fit_plane(setting, used, state.arrays, origin)
        if fitted is None or not fitted.determined():
            contents = contents.placed(plane, None, None)
            history = history.without_plane(plane)
            continue
        if reject:
            contents, fitted = _screened(fitted, contents, plane, used, state, history)
            used = contents.used(plane)
        number = contents.numbers.get(plane, free + len(joined))
        contents = contents.placed(plane, number, fitted.origin)
        factors[number] = fitted.factors(number, contents.station_numbers, used)
        joined.append(plane)
        own = fitted.information(history.reference)
        if fitted.fits(own, history.reference):
            history = history.with_plane(plane, own)
        else:
            history = history.without_plane(plane)
            doubtful.append(plane)
    return Joining(contents, factors, history, tuple(joined), tuple(doubtful))


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
    if known.search(setting.sigma_dof, known.recent()) is not None:
        return (
            contents,
            fitted,
        )  # a beam has moved, and nobody was told: it is the estimate that is off
    less = contents.leaving_out(plane, used, bad)
    again = fit_plane(setting, less.used(plane), state.arrays, fitted.origin)
    if again is None or not again.determined():
        return contents, fitted
    return (contents, fitted) if _rather_moved(fitted, again, bad, known, plane) else (less, again)


def _rather_moved(
    fitted: FittedPlane, again: FittedPlane, bad: BoolArray, known: History, plane: str
) -> bool:
    """Tell whether a beam has moved rather than that the readings `bad` are garbage.

    A move explains all readings, and shows in those that are left when the worst are gone.
    """
    own, rest = (one.information(known.reference) for one in (fitted, again))
    if not fitted.fits(own, known.reference):
        return False
    dof = fitted.setting.sigma_dof
    whole, less = known.with_plane(plane, own), known.with_plane(plane, rest)
    if whole.search(dof, whole.recent()) is None:
        return False
    many = int(bad.sum(axis=0).max()) >= MANY
    return many or less.search(dof, less.recent(), SUSPICIOUS) is not None
