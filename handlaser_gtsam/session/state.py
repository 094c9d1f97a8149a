"""Everything a session knows once there is a calibration, and what follows from it; never changed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..data.parameters import Beams, Parameters
from ..errors import HandlaserError, InputError
from ..keys import pose_key
from ..solvers.incremental import BeamState, IncrementalGraph, IncrementalOptions, PlaneFactors
from .batch import Inside
from .contents import Contents
from .drift import History, Moved
from .fitted import FittedPlane, fit_plane
from .integration import ScaleSums
from .joining import Joining, join_planes
from .setting import Setting

MOVED = 3e-3
"""Weights are taken anew when the beams have moved by this part of their natural units since: 1 rad,
the typical range, a relative change of the range."""
MOVED_WITH_SCALES = 5e-4
"""The same where scales are integrated over: how probable they are depends on how well all planes fit,
which is known to second order in such a move."""
TRUSTED = 4
"""Planes inside from which others may be put aside."""
ROUNDS = 5
"""Of new weights after a new beginning."""


@dataclass(frozen=True, slots=True)
class Now:
    """The calibration of a session, and how it came about.

    Attributes
    ----------
    contents : Contents
    setting : Setting
    options : IncrementalOptions
    graph : IncrementalGraph
    state : BeamState
        Its beams.
    weighed : Beams
        Those behind the weights.
    compared : BeamState
        Those of the last comparison with the batch solution.
    changes : int
        Since then.
    history : History
    doubtful : frozenset of str
        Planes that do not fit, whatever has moved.
    learned_with : int
        Planes behind the scales that were learned last, and a range sigma that was not given.
    sums : ScaleSums or None
        What the planes say for all scales; None where none are integrated over.
    """

    contents: Contents
    setting: Setting
    options: IncrementalOptions
    graph: IncrementalGraph
    state: BeamState
    weighed: Beams
    compared: BeamState
    changes: int
    history: History
    doubtful: frozenset[str]
    learned_with: int
    sums: ScaleSums | None = None
    estimate: BeamState | None = None
    """The beams with all scales integrated over, once that has been done."""

    def integrated(self) -> BeamState:
        """Return the beams with all scales integrated over."""
        if self.estimate is not None:
            return self.estimate
        return self.state if self.sums is None else self.sums.integrated(self.state)

    @property
    def current(self) -> tuple[str, ...]:
        """Names of the beams as they are, without those that were before a move."""
        return tuple(name for name in self.setting.names if name not in self.contents.names)

    @property
    def trusted(self) -> bool:
        """Whether planes that were put aside are rather at fault than the beams as they are.

        A few planes may have begun with the wrong beams; many that agree on one beam speak for a move.
        """
        inside, aside = len(self.contents.numbers), self.contents.aside
        culprits = set(aside.values())
        agree = len(culprits) == 1 and "" not in culprits
        return inside >= TRUSTED and (len(aside) <= 0.5 * inside or agree)

    def inside(self) -> Inside:
        """Return what is in the graph as one problem, at the present estimate."""
        graph, contents = self.graph, self.contents
        at = graph.parameters()
        place = {number: index for index, number in enumerate(graph.planes)}
        order = [place[number] for number in contents.numbers.values()]
        at = replace(at, normals=at.normals[order], offsets=at.offsets[order])
        found = Inside.of(contents, self.setting, at)
        if self.setting.poses != "estimated":
            return found
        poses, names = gtsam.Values(), found.recording.station_names
        for j in np.unique(found.readings.station[found.used]).tolist():
            own = pose_key(contents.station_numbers[names[j]])
            poses.insert(pose_key(j), graph.pose(own))
        return replace(found, poses=poses)

    def moved(self, *, recently: bool = False) -> Moved | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        epochs = self.history.recent() if recently else None
        found, far = self.history.search(self.setting.sigma_dof, epochs), self._moved_far()
        if found is None or far is None or far.beam != found.beam:
            return found or far
        order = list(self.contents.stations)
        return replace(found, since=min(found.since, far.since, key=order.index))

    def _moved_far(self) -> Moved | None:
        """Return the beam without which planes that were put aside would fit: it has moved far."""
        for plane, beam in self.contents.aside.items():
            if beam:
                unknown = float("nan")
                return Moved(beam, plane, unknown, 0.0, np.full(3, unknown), unknown)
        return None

    def changed(
        self, contents: Contents, planes: tuple[str, ...], *, reject: bool
    ) -> tuple["Now", Joining]:
        """Return what follows from `contents`, in which only `planes` differ from what is in.

        Raises
        ------
        InputError
            The beams would not be determined.
        """
        joining = join_planes(self.setting, self.state, self.history, contents, planes, reject)
        if set(planes) & set(self.contents.numbers):  # a new plane takes nothing away
            lost = joining.contents.without_readings(self.setting.names)
            if lost:
                raise InputError(f"no reading left of beam {', '.join(lost)}", "some of every beam")
        left = [n for p, n in self.contents.numbers.items() if p not in joining.contents.numbers]
        doubtful = (self.doubtful - set(planes)) | set(joining.doubtful)
        new = replace(
            self,
            contents=joining.contents,
            history=joining.history,
            changes=self.changes + 1,
            doubtful=doubtful,
            sums=_summed(self.sums, joining),
            estimate=None,
        )
        if not (joining.factors or left):
            return new, joining
        try:
            graph, state = self.graph.changed(
                joining.factors, left, None, self.setting.determines, fine=bool(doubtful)
            )
            new = replace(new, graph=graph, state=state).reweighed()
        except RuntimeError:  # iSAM2 takes undamped steps: the batch solver does not
            new = new.solved_at_once()
        if left and not self.setting.links and not new.inside().determined():
            raise InputError(
                "a change after which the beams are open", "planes that determine them"
            )
        return new, joining

    def solved_at_once(self) -> "Now":
        """Return the same from a batch solution of the contents, beside the present beams.

        Raises
        ------
        InputError
            The beams are not determined.
        """
        fitted = fitted_planes(self.contents, self.setting, self.state.beams)
        try:
            if not fitted:
                raise RuntimeError("no plane is left")
            contents = _placed(self.contents, fitted)
            planes = [one.at for one in fitted.values()]
            r, v, k = self.state.beams
            normals = np.concatenate([one.normals for one in planes])
            at = Parameters(r, v, k, normals, np.concatenate([one.offsets for one in planes]))
            beams = Inside.of(contents, self.setting, at).batch_beams()
            found = begin(self.contents, self.setting, beams, self.options)
            if not self.setting.determines(found.state):
                raise RuntimeError("too few planes are left")
        except (RuntimeError, HandlaserError) as error:
            raise InputError(
                f"a change after which the beams are open ({error})", "planes that determine them"
            ) from error
        return replace(
            found, compared=self.compared, changes=self.changes, learned_with=self.learned_with
        )

    def reweighed(self) -> "Now":
        """Return the same with the weights of the present beams, where these have moved."""
        setting, state = self.setting, self.state
        limit = MOVED if setting.learned is None else MOVED_WITH_SCALES
        if not setting.weights_depend or setting.apart(state.beams, self.weighed) < limit:
            return self
        factors, all_fitted = {}, {}
        for plane, number in self.contents.numbers.items():
            used = self.contents.used(plane)
            fitted = fit_plane(setting, used, state.beams, self.contents.origins[plane])
            if fitted is None:
                return self
            factors[number] = fitted.factors(number, self.contents.station_numbers, used)
            all_fitted[plane] = fitted
        graph, found = self.graph.changed(factors, fine=bool(self.doubtful))
        sums = _sums(setting, state.beams, all_fitted)
        return replace(
            self, graph=graph, state=found, weighed=state.beams, sums=sums, estimate=None
        )


def begin(contents: Contents, setting: Setting, beams: Beams, options: IncrementalOptions) -> Now:
    """Return a new graph of every plane that is determined beside `beams`.

    Raises
    ------
    RuntimeError
        GTSAM calls the system indeterminate, or the estimate does not settle.
    """
    fitted = fitted_planes(contents, setting, beams)
    contents = _placed(contents, fitted)
    factors: dict[int, PlaneFactors] = {}
    history, doubtful = setting.history(beams), set[str]()
    for plane, one in fitted.items():
        number, used = contents.numbers[plane], contents.used(plane)
        factors[number] = one.factors(number, contents.station_numbers, used)
        own = one.information(history.reference)
        if one.fits(own, history.reference):
            history = history.with_plane(plane, own)
        else:
            doubtful.add(plane)
    graph = IncrementalGraph(setting.beams, setting.terms, setting.length, options)
    start = setting.start(beams)
    graph, state = graph.changed(factors, (), start, fine=bool(doubtful))
    now = Now(
        contents,
        setting,
        options,
        graph,
        state,
        beams,
        state,
        0,
        history,
        frozenset(doubtful),
        len(fitted),
        _sums(setting, beams, fitted),
    )
    for _ in range(ROUNDS):
        before, now = now, now.reweighed()
        if now is before:
            break
    return replace(now, compared=now.state)


def _sums(setting: Setting, beams: Beams, fitted: Mapping[str, FittedPlane]) -> ScaleSums | None:
    """Return what planes say for all scales, counted from `beams`; None where none are learned."""
    if setting.learned is None:
        return None
    found = ScaleSums.empty(setting.learned, setting.history(beams), setting.members)
    for plane, one in fitted.items():
        found = found.with_plane(plane, one)
    return found


def _summed(sums: ScaleSums | None, joining: Joining) -> ScaleSums | None:
    """Return the sums after planes have joined, changed and left."""
    if sums is None:
        return None
    for plane in tuple(sums.pieces):
        if plane not in joining.contents.numbers:
            sums = sums.without_plane(plane)
    for plane, fitted in joining.fitted.items():
        sums = sums.with_plane(plane, fitted)
    return sums


def fitted_planes(contents: Contents, setting: Setting, beams: Beams) -> Mapping[str, FittedPlane]:
    """Return the planes that are determined beside `beams`."""
    found = {}
    for plane in contents.stations:
        if plane in contents.aside:
            continue
        fitted = fit_plane(setting, contents.used(plane), beams)
        if fitted is not None and fitted.determined():
            found[plane] = fitted
    return found


def _placed(contents: Contents, fitted: Mapping[str, FittedPlane]) -> Contents:
    """Return the contents with these planes in the graph, numbered anew."""
    return replace(
        contents,
        numbers={plane: number for number, plane in enumerate(fitted)},
        origins={plane: one.origin for plane, one in fitted.items()},
    )
