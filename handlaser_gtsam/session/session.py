"""Recalibration as planes are added.

The first recordings are collected until they determine the beams; from that calibration on, every plane
joins an iSAM2 graph in milliseconds. A plane that its readings do not determine waits for more of
them. Everything a session knows is one value that is replaced as a whole: whatever is raised on the
way, Ctrl-C included, the session is what it was.
"""

from dataclasses import dataclass, replace
from threading import RLock

import numpy as np

from ..calibration import Calibration
from ..diagnosis.drift import Beams, History, Moved
from ..errors import InputError
from ..mounts import Mounts
from ..noise import Noise
from ..options import CalibrationOptions
from ..parameters import Parameters
from ..pipeline import calibrate
from ..range_error import choose_terms
from ..recording import Readings, Recording
from ..sensor import Rejected
from ..solvers.incremental import BeamState, IncrementalGraph, IncrementalOptions, PlaneFactors
from .batch import Inside
from .beginning import begun, refuse, setting_of
from .contents import Contents
from .fitted import fit_plane
from .joining import join_planes
from .reports import Comparison, Update
from .setting import Link, Setting

MOVED = 3e-3
"""Weights are taken anew when the beams have moved by this part of their natural units since: 1 rad,
the typical range, a relative change of the range."""
ROUNDS = 5
"""Of new weights after a new beginning."""
LEAST_CHANGES = 4
"""Between two comparisons with the batch solution."""
FAR = 5.0
"""A move of so many standard deviations since the last comparison with the batch calls for another."""
AGREED = 0.01
"""Standard deviations, and part of each, within which the estimate is that of the batch."""


@dataclass(frozen=True, slots=True)
class _Now:
    """Everything a session knows once there is a calibration.

    Attributes
    ----------
    contents : Contents
    setting : Setting
    graph : IncrementalGraph
    state : BeamState
        Its beams.
    weighed : BeamState
        Those behind the weights.
    compared : BeamState
        Those of the last comparison with the batch solution.
    changes : int
        Since then.
    history : History
    doubtful : frozenset of str
        Planes that do not fit, whatever has moved.
    """

    contents: Contents
    setting: Setting
    graph: IncrementalGraph
    state: BeamState
    weighed: BeamState
    compared: BeamState
    changes: int
    history: History
    doubtful: frozenset[str]


class Session:
    """A calibration to which planes and stations are added, and from which they are removed.

    Parameters
    ----------
    noise : Noise, optional
        An unknown range sigma is that of the first calibration, and of every comparison with the batch.
        One pose covariance for all stations.
    options : CalibrationOptions, optional
        Of the first calibration; range-error terms chosen by evidence are looked at again in every
        comparison with the batch.
    incremental : IncrementalOptions, optional

    Raises
    ------
    InputError
        A pose covariance a station, noise to be estimated, a range sigma by beam, or a robust loss.
    """

    def __init__(
        self,
        noise: Noise | None = None,
        options: CalibrationOptions | None = None,
        incremental: IncrementalOptions | None = None,
    ) -> None:
        self.noise, self.options = noise or Noise(), options or CalibrationOptions()
        self.incremental = incremental or IncrementalOptions()
        refuse(self.noise, self.options)
        self._early, self._now = Contents.empty(), None
        self._lock = RLock()

    _now: _Now | None

    @property
    def started(self) -> bool:
        """Whether there is a calibration."""
        return self._now is not None

    @property
    def _contents(self) -> Contents:
        return self._early if self._now is None else self._now.contents

    @property
    def planes(self) -> tuple[str, ...]:
        """Names of the planes that are in the calibration."""
        return tuple(self._contents.numbers)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the planes that wait for more stations."""
        contents = self._contents
        return tuple(name for name in contents.stations if name not in contents.numbers)

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """Readings that are kept, and not used."""
        return self._contents.rejected

    def recording(self) -> Recording:
        """Return all stations so far; those that wait, and readings that are not used, included.

        Raises
        ------
        InputError
            There are none.
        """
        return self._contents.everything()

    def add(self, recording: Recording) -> Update:
        """Add the stations of a recording; nothing has changed where an error is raised.

        Raises
        ------
        InputError
            A station name that is there already, or a new beam that its readings do not determine.
        """
        with self._lock:
            now = self._now
            contents = self._contents.added(recording, self.options.sensor)
            if now is None or not set(recording.beam_names) <= set(now.setting.names):
                return self._begin(contents)
            return self._change(now, contents, recording.plane_names)

    def remove_plane(self, name: str) -> Update:
        """Take a plane and its stations out again.

        Raises
        ------
        InputError
            No such plane, or the beams would not be determined without it.
        """
        with self._lock:
            return self._removed(self._contents.without_plane(name), name)

    def remove_station(self, name: str) -> Update:
        """Take a station out again; its plane waits where the others do not determine it.

        Raises
        ------
        InputError
            No such station, or the beams would not be determined without it.
        """
        with self._lock:
            plane = self._contents.plane_of(name)
            return self._removed(self._contents.without_station(name), plane)

    def forget(
        self,
        beam: str,
        since: str,
        location_sigma: float = 0.01,
        direction_sigma: float = 0.05,
        range_error_sigmas: tuple[float, float] = (1e-5, 1e-5),
    ) -> None:
        """Let a beam have moved before a plane came: process noise between what it was and what it is.

        Nothing is thrown away: planes before `since` go on to tell what the beam was, which stays in
        the session as `<beam> until <since>`, and, as far as the noise lets them, what it is.

        Parameters
        ----------
        beam : str
        since : str
            The first plane that saw it moved; one that is in the calibration.
        location_sigma : float
            Of each coordinate of the shift [m].
        direction_sigma : float
            Of the turn about each axis across the beam [rad].
        range_error_sigmas : (float, float)
            Of the change of k1 [1] and k2 [1/m]; small, for a range error belongs to the sensor.

        Raises
        ------
        InputError
            No calibration yet, no such beam or plane, no plane before it, the beam has been told to
            move there already, or sigmas that are not positive or beyond what GTSAM can solve.
        """
        with self._lock:
            now = self._require()
            names, contents, before = now.setting.names, now.contents, f"{beam} until {since}"
            if beam not in names or beam in contents.names:
                current = [name for name in names if name not in contents.names]
                raise InputError(f"beam {beam!r}", f"one of {', '.join(current)}")
            order = list(contents.numbers)
            if since not in order[1:] or before in names:
                raise InputError(
                    f"a move of beam {beam} before plane {since!r}",
                    "a plane with others before it, and every move once",
                )
            split = contents.split(beam, since, before)
            for name in (before, beam):
                if not any(name in split.stations[p].beam_names for p in split.numbers):
                    raise InputError(
                        f"no reading of beam {beam} on one side of plane {since}", "some on both"
                    )
            index = names.index(beam)
            link = Link(len(names), index, location_sigma, direction_sigma, range_error_sigmas)
            old = tuple(
                replace(one, now=len(names)) if one.now == index else one
                for one in now.setting.links
            )
            setting = replace(
                now.setting,
                names=(*names, before),
                terms=(*now.setting.terms, now.setting.terms[index]),
                links=(*old, link),
            )
            at = tuple(np.vstack((a, a[index])) for a in now.state.arrays)
            try:
                self._now = self._restarted(split, setting, (at[0], at[1], at[2]))
            except RuntimeError as error:
                words = f"process noise of {location_sigma:g} m and {direction_sigma:g} rad"
                raise InputError(
                    f"{words}, with which GTSAM calls the beams indeterminate", "less extreme noise"
                ) from error

    def beams(self) -> Mounts:
        """Return the beams as they are now, without looking at the planes.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        mounts = Mounts(
            now.setting.names,
            *now.state.arrays,
            now.setting.terms,
            now.state.covariance,
            now.setting.sigma,
        )
        current = tuple(name for name in now.setting.names if name not in now.contents.names)
        return mounts if len(current) == len(mounts.names) else mounts.arranged(current)

    def calibration(self) -> Calibration:
        """Return the calibration at the present estimate, with everything a batch calibration tells.

        Nothing is solved anew, but every reading is looked at. What a beam was before it moved stands
        beside it as a beam of its own.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        return self._inside(now).calibration(now.contents)

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes as they are now.

        Every plane is in a frame of its own amid its stations, with the axes of the world.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        inside = self._inside(self._require())
        return inside.own(), inside.at

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        return self._inside(now).compared(now.state)

    def moved(self) -> Moved | None:
        """Return the beam that all planes so far show to have moved, whenever that was.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        return now.history.search(now.setting.sigma_dof)

    def settle(self) -> Comparison:
        """Calibrate everything so far at once, and compare; choose again what that chooses otherwise.

        That is range-error terms, outliers and an unknown range sigma. The same happens, outliers
        aside, in every comparison that is due. After a beam was told to have moved, nothing is.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        with self._lock:
            now = self._require()
            if now.setting.links:
                return self._inside(now).compared(now.state)
            found = calibrate(now.contents.everything(), self.noise, self.options)
            if found.status != "converged":
                words = f"everything together does not converge: {found.message}"
                return replace(self._inside(now).compared(now.state), message=words)
            contents = begun(now.contents, found)
            setting = setting_of(found, self.noise)
            differing = setting.difference(now.setting)
            if set(contents.rejected) != set(now.contents.rejected):
                differing.append("outliers chosen anew")
            if differing:
                # From the estimate so far, not from what it is to be compared with.
                order = [now.setting.names.index(name) for name in setting.names]
                r, v, k = (array[order] for array in now.state.arrays)
                now = self._now = self._restarted(contents, setting, (r, v, k))
            return Comparison(*_apart(now, found), "; ".join(differing))

    def _require(self) -> _Now:
        if self._now is None:
            raise InputError("a session without calibration", "recordings that determine the beams")
        return self._now

    def _inside(self, now: _Now) -> Inside:
        return Inside.of(now.contents, now.setting, now.graph)

    def _begin(self, contents: Contents) -> Update:
        """Calibrate everything together, and start the graph from there if that converges."""
        now = self._now
        if now is not None and now.setting.links:
            raise InputError(
                "a new beam after another was told to have moved", "a session of its own for it"
            )
        found = calibrate(contents.everything(), self.noise, self.options)
        if found.status != "converged":
            if now is not None:  # a new beam that is not determined: nothing is lost
                raise InputError(f"a new beam ({found.message})", "readings that determine it")
            self._early = contents
            return Update((), self.waiting, float("nan"), None, None, found.message)
        at, contents = found.parameters(), begun(contents, found)
        beams = (at.locations, at.directions, at.range_errors)
        fresh = self._restarted(contents, setting_of(found, self.noise), beams)
        self._now = fresh
        return Update(
            tuple(fresh.contents.numbers),
            self.waiting,
            float("nan"),
            fresh.state.sigmas(),
            None,
            rejected=fresh.contents.rejected,
            moved=fresh.history.search(fresh.setting.sigma_dof),
        )

    def _restarted(self, contents: Contents, setting: Setting, beams: Beams) -> _Now:
        """Return a session with a new graph of everything that is determined beside `beams`."""
        graph = IncrementalGraph(setting.beams, setting.terms, setting.length, self.incremental)
        contents = replace(contents, numbers={}, origins={})
        factors: dict[int, PlaneFactors] = {}
        history, doubtful = setting.history(beams), set[str]()
        for number, plane in enumerate(contents.stations):
            used = contents.used(plane)
            fitted = fit_plane(setting, used, beams)
            if fitted is None or not fitted.determined():
                continue
            contents = contents.placed(plane, number, fitted.origin)
            factors[number] = fitted.factors(number, contents.station_numbers, used)
            own = fitted.information(history.reference)
            if fitted.fits(own, history.reference):
                history = history.with_plane(plane, own)
            else:
                doubtful.add(plane)
        start = setting.start(beams)
        graph, state = graph.changed(factors, (), start, fine=bool(doubtful))
        r, v, k = beams
        behind = replace(state, locations=r, directions=v, range_errors=k)
        now = _Now(contents, setting, graph, state, behind, state, 0, history, frozenset(doubtful))
        for _ in range(ROUNDS):
            before, now = now, self._weighed(now)
            if now is before:
                break
        return now

    def _removed(self, contents: Contents, plane: str) -> Update:
        now = self._now
        if now is None:
            self._early = contents
            return Update((), self.waiting, float("nan"), None, None)
        return self._change(now, contents, (plane,))

    def _change(self, now: _Now, contents: Contents, planes: tuple[str, ...]) -> Update:
        """Bring the session to `contents`, in which only `planes` differ from what is in."""
        joining = join_planes(now.setting, now.state, now.history, contents, planes, self._reject)
        left = [n for p, n in now.contents.numbers.items() if p not in joining.contents.numbers]
        graph, state = now.graph, now.state
        doubtful = (now.doubtful - set(planes)) | set(joining.doubtful)
        if joining.factors or left:
            try:
                graph, state = graph.changed(
                    joining.factors, left, None, now.setting.determines, fine=bool(doubtful)
                )
            except RuntimeError as error:
                raise InputError(
                    f"a change after which the beams are open ({error})",
                    "planes that determine them",
                ) from error
        new = replace(
            now,
            contents=joining.contents,
            graph=graph,
            state=state,
            history=joining.history,
            changes=now.changes + 1,
            doubtful=doubtful,
        )
        gain = 0.5 * (state.information - now.state.information)
        new, comparison = self._checked(self._weighed(new))
        if comparison is not None and comparison.message:
            gain = float("nan")
        before = now.state.sigmas()
        self._now = new
        old = set(now.contents.rejected)
        epochs = new.history.recent()
        return Update(
            joining.planes,
            self.waiting,
            gain,
            new.state.sigmas(),
            before,
            "",
            tuple(one for one in new.contents.rejected if one not in old),
            new.history.search(new.setting.sigma_dof, epochs),
            joining.doubtful,
            comparison,
        )

    @property
    def _reject(self) -> bool:
        return self.options.outliers == "reject"

    def _weighed(self, now: _Now) -> _Now:
        """Give all readings the weights of the present beams, where these have moved."""
        if not now.setting.weights_depend or now.setting.apart(now.state, now.weighed) < MOVED:
            return now
        factors = {}
        for plane, number in now.contents.numbers.items():
            used = now.contents.used(plane)
            fitted = fit_plane(now.setting, used, now.state.arrays, now.contents.origins[plane])
            if fitted is None:
                return now
            factors[number] = fitted.factors(number, now.contents.station_numbers, used)
        graph, state = now.graph.changed(factors, fine=bool(now.doubtful))
        return replace(now, graph=graph, state=state, weighed=now.state)

    def _checked(self, now: _Now) -> tuple[_Now, Comparison | None]:
        """Compare with the batch solution where that is due; return what follows from it."""
        every = self.incremental.compare_every
        due = max(LEAST_CHANGES, min(every, len(now.contents.numbers) // 4))
        far = _standard_deviations(now.state, now.compared) > FAR
        if every == 0 or (now.changes < due and not far):
            return now, None
        words = []
        setting = self._chosen(now)
        if setting != now.setting:
            words += setting.difference(now.setting)
            now = self._restarted(now.contents, setting, now.state.arrays)
        inside = self._inside(now)
        comparison = inside.compared(now.state)
        if max(comparison.largest, comparison.largest_sigma) > AGREED:
            words.append("begun anew from the batch solution, which it had left")
            now = self._restarted(now.contents, now.setting, inside.batch_beams())
        now = replace(now, compared=now.state, changes=0)
        return now, replace(comparison, message="; ".join(words))

    def _chosen(self, now: _Now) -> Setting:
        """Return the setting that everything so far calls for: terms, and a range sigma not given."""
        asked, given = self.options.range_error, self.noise.range_sigma is not None
        if now.setting.links or (asked != "auto" and given):
            return now.setting
        inside = self._inside(now)
        options = replace(self.options, outliers="keep")
        choice = choose_terms(inside.own(), inside.at, self.noise, options)
        return now.setting.chosen(choice, len(inside.own()))


def _apart(now: _Now, found: Calibration) -> tuple[float, float]:
    """Return how far a calibration of the same beams is, in its sigmas, and how its sigmas differ."""
    state, names = now.state, now.setting.names
    at, order = found.parameters(), [list(found.beams).index(name) for name in names]
    other = np.hstack((at.locations, at.directions, at.range_errors))[order]
    sigma = np.array([found.beams[name].sigma for name in names])
    seen = sigma > 0.0
    difference = np.abs(np.hstack(state.arrays) - other)[seen] / sigma[seen]
    return float(difference.max()), float(np.abs(state.sigmas()[seen] / sigma[seen] - 1.0).max())


def _standard_deviations(state: BeamState, other: BeamState) -> float:
    """Return how many standard deviations of the other estimate the beams have moved since."""
    before = np.hstack(other.arrays)
    sigma = other.sigmas()
    seen = sigma > 0.0
    return float((np.abs(np.hstack(state.arrays) - before)[seen] / sigma[seen]).max())
