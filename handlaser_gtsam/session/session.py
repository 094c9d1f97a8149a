"""Recalibration as planes are added.

The first recordings are collected until they determine the beams; from that calibration on, every plane
joins an iSAM2 graph in milliseconds. A plane that its readings do not determine waits for more of
them. Everything a session knows is one value that is replaced as a whole: whatever is raised on the
way, Ctrl-C included, the session is what it was.
"""

from dataclasses import replace
from threading import RLock

import numpy as np

from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording, join
from ..data.screen import screened
from ..errors import CalibrationWarning, GrazingBeamError, InputError
from ..estimation.options import CalibrationOptions
from ..model.sensor import Rejected
from ..pipeline import calibrate
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..solvers.incremental import IncrementalOptions
from .beginning import begun, refuse, setting_of
from .checking import apart, checked
from .contents import Contents
from .drift import Moved
from .now import Now, begin
from .reports import Comparison, Update
from .setting import Link, Setting

BEGUN_ANEW = (
    "begun anew from everything: the planes so far did not fit the calibration they began with"
)


class Session:
    """A calibration to which planes and stations are added, and from which they are removed.

    Parameters
    ----------
    noise : Noise, optional
        An unknown range sigma is that of the first calibration, and of every comparison with the batch.
        One pose covariance for all stations.
    options : CalibrationOptions, optional
        Of the first calibration; unknown scales are learned anew in every comparison with the batch.
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
        for name, given, kind in (
            ("noise", noise, Noise),
            ("options", options, CalibrationOptions),
            ("incremental", incremental, IncrementalOptions),
        ):
            if given is not None:
                require_kind(name, given, kind)
        self.noise, self.options = noise or Noise(), options or CalibrationOptions()
        self.incremental = incremental or IncrementalOptions()
        refuse(self.noise, self.options)
        self._early, self._now = Contents.empty(), None
        self._screening: tuple[CalibrationWarning, ...] = ()
        self._lock = RLock()

    _now: Now | None

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
        """Names of the planes that wait for more stations, or fit the beams in no way."""
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

        They see the beams as they are now, also before a plane that came before one has moved.

        Raises
        ------
        InputError
            A station name that is there already, a channel that was logged twice, or a new beam that
            its readings do not determine.
        """
        if not isinstance(recording, Recording):
            raise InputError(
                f"{type(recording).__name__} to add", "a Recording: hl.read_recording(...)"
            )
        found = screened(recording, self.noise.range_sigma)
        if found.warnings:
            recording = found.recording.part(~np.isnan(found.recording.ranges).all(axis=1))
        with self._lock:
            update = self._added(recording)
            self._screening += found.warnings
        return update

    def _added(self, recording: Recording) -> Update:
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
                raise InputError(f"beam {beam!r}", f"one of {', '.join(now.current)}")
            order = [
                plane
                for plane in contents.stations
                if plane in {*contents.numbers, *contents.aside}
            ]
            if since not in order[1:] or before in names:
                raise InputError(
                    f"a move of beam {beam} before plane {since!r}",
                    "a plane with others before it, and every move once",
                )
            split = contents.split(beam, since, before).taken_back(order[order.index(since) :])
            for name in (before, beam):
                if not any(name in split.stations[p].beam_names for p in order):
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
                learned=None
                if now.setting.learned is None
                else now.setting.learned.for_beams(len(names) + 1),
            )
            at = tuple(np.vstack((a, a[index])) for a in now.state.beams)
            self._now = self._split(split, setting, (at[0], at[1], at[2]))

    def _split(self, split: Contents, setting: Setting, at: Beams) -> Now:
        """Begin anew with a beam that has moved; from nowhere where it has moved too far."""
        try:
            return begin(split, setting, at, self.incremental)
        except (RuntimeError, GrazingBeamError) as error:
            recording = join([split.used(plane) for plane in split.stations])
            options = replace(self.options, outliers="keep")
            found = calibrate(recording, replace(self.noise, range_sigma=setting.sigma), options)
            if found.status == "converged":
                own = found.parameters()
                order = [list(found.beams).index(name) for name in setting.names]
                k = np.where(
                    np.arange(2) < np.array(setting.terms)[:, None], own.range_errors[order], 0
                )
                try:
                    beams = (own.locations[order], own.directions[order], k)
                    return begin(split, setting, beams, self.incremental)
                except (RuntimeError, GrazingBeamError):
                    pass
            noise = setting.links[-1]
            raise InputError(
                f"a move that process noise of {noise.location_sigma:g} m and "
                f"{noise.direction_sigma:g} rad does not settle ({error})",
                "noise as large as the move, or more planes after it",
            ) from error

    def beams(self) -> Mounts:
        """Return the beams as they are now, without looking at the planes.

        A range sigma that was not given is that of the last comparison, or of `settle`.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        state = now.integrated()
        mounts = Mounts(
            now.setting.names,
            *state.beams,
            now.setting.terms,
            state.covariance,
            now.setting.sigma,
        )
        return mounts if now.current == mounts.names else mounts.arranged(now.current)

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
        found = now.inside().calibration(now.contents)
        found = replace(found, warnings=(*self._screening, *found.warnings))
        planes = len(now.contents.numbers)
        learns = now.setting.learned is not None or self.noise.range_sigma is None
        if not learns or now.learned_with == planes or now.setting.links:
            return found
        words = (
            f"the scales of noise and range errors were learned from {now.learned_with} of {planes} "
            f"planes: settle() learns them anew"
        )
        more = CalibrationWarning("scales-of-fewer-planes", words)
        return replace(found, warnings=(*found.warnings, more))

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes as they are now.

        Every plane is in a frame of its own amid its stations, with the axes of the world.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        inside = self._require().inside()
        return inside.own(), inside.at

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        return now.inside().compared(now.integrated())

    def moved(self) -> Moved | None:
        """Return the beam that all planes so far show to have moved, whenever that was.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        now = self._require()
        return now.moved()

    def settle(self) -> Comparison:
        """Calibrate everything so far at once, and compare; take over what that finds otherwise.

        That is scales of noise and range errors, and outliers. The same happens, outliers aside, in
        every comparison that is due; but not once a beam is known to have moved.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        with self._lock:
            now = self._require()
            if now.setting.links:
                return now.inside().compared(now.integrated())
            found = calibrate(now.contents.everything(), self.noise, self.options)
            if found.status != "converged":
                words = f"everything together does not converge: {found.message}"
                return replace(now.inside().compared(now.integrated()), message=words)
            contents = begun(now.contents, found)
            setting = setting_of(found, self.noise, self.options.sensor)
            differing = setting.difference(now.setting)
            out = [{(r.station, r.beam) for r in c.rejected} for c in (contents, now.contents)]
            if out[0] != out[1]:
                differing.append("outliers chosen anew")
            if now.contents.aside:
                differing.append("planes that did not fit taken in again")
            if differing:
                # From the estimate so far, not from what it is to be compared with.
                order = [now.setting.names.index(name) for name in setting.names]
                r, v, k = (array[order] for array in now.state.beams)
                now = begin(contents, setting, (r, v, k), self.incremental)
            now = self._now = replace(now, learned_with=len(now.contents.numbers))
            return Comparison(*apart(now, found), "; ".join(differing))

    def _require(self) -> Now:
        if self._now is None:
            raise InputError("a session without calibration", "recordings that determine the beams")
        return self._now

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
        fresh = begin(
            contents, setting_of(found, self.noise, self.options.sensor), beams, self.incremental
        )
        fresh = self._now = replace(fresh, estimate=fresh.integrated())
        return Update(
            tuple(fresh.contents.numbers),
            self.waiting,
            float("nan"),
            fresh.integrated().sigmas(),
            None,
            rejected=fresh.contents.rejected,
            moved=fresh.moved(),
        )

    def _from_nowhere(self, contents: Contents) -> Now | None:
        """Begin anew from a batch calibration of everything; None where that does not converge."""
        found = calibrate(contents.everything(), self.noise, self.options)
        if found.status != "converged":
            return None
        at = found.parameters()
        setting = setting_of(found, self.noise, self.options.sensor)
        beams = (at.locations, at.directions, at.range_errors)
        return begin(begun(contents, found), setting, beams, self.incremental)

    def _removed(self, contents: Contents, plane: str) -> Update:
        now = self._now
        if now is None:
            self._early = contents
            return Update((), self.waiting, float("nan"), None, None)
        return self._change(now, contents, (plane,))

    def _change(self, now: Now, contents: Contents, planes: tuple[str, ...]) -> Update:
        """Bring the session to `contents`, in which only `planes` differ from what is in."""
        reject = self.options.outliers == "reject"
        new, joining = now.changed(contents, planes, reject=reject)
        gain, words = 0.5 * (new.state.information - now.state.information), ""
        if joining.doubtful and reject and not (new.trusted or new.setting.links):
            fresh = self._from_nowhere(new.contents)
            if fresh is not None:
                new, gain, words = fresh, float("nan"), BEGUN_ANEW
        new, comparison = checked(new)
        if comparison is not None and comparison.message:
            gain = float("nan")
        new = self._now = replace(new, estimate=new.integrated())
        old = set(now.contents.rejected)
        return Update(
            tuple(new.contents.numbers) if words else joining.planes,
            self.waiting,
            gain,
            new.integrated().sigmas(),
            now.integrated().sigmas() if new.setting.names == now.setting.names else None,
            words,
            tuple(one for one in new.contents.rejected if one not in old),
            new.moved(recently=True),
            () if words else joining.doubtful,
            comparison,
        )
