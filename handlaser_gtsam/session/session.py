"""Recalibration as planes are added.

The first recordings are collected until they determine the beams; from that calibration on, every plane
joins an iSAM2 graph in milliseconds. A plane that its readings do not determine waits for more of
them. Where systematic errors are unknowns, each plane changes what all others say: then everything is
calibrated again at every change (`session.freed`). Everything a session knows is one value that is
replaced as a whole: whatever is raised on the way, Ctrl-C included, the session is what it was.
"""

from dataclasses import replace
from threading import RLock

import numpy as np

from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..data.screening import screened
from ..errors import ArgumentError, CalibrationWarning, InputError
from ..estimation.options import CalibrationOptions
from ..model.sensor_limits import Rejected
from ..pipeline import calibrate_from
from ..results.calibration import Calibration
from ..results.freed import prior_sizes
from ..results.messages import warned
from ..results.mounts import Mounts
from ..validation.other_recording import BeamDrift
from .contents import Contents
from .freed import FreedState
from .reports import Comparison, Update
from .state import SessionState

AnyState = SessionState | FreedState

RESTARTED = (
    "restarted from everything: the planes so far did not fit the calibration they began with"
)
UNKNOWN = float("nan")


class Session:
    """A calibration to which planes and stations are added, and from which they are removed.

    What needs a calibration raises InputError as long as there is none. A session can be pickled and
    copied: a copy gives the same answers, and goes on by itself.

    Parameters
    ----------
    noise : Noise, optional
        An unknown range sigma is taken from the first calibration, then from every comparison with the
        batch. One pose covariance for all stations.
    options : CalibrationOptions, optional
        Options of the first calibration; every comparison with the batch learns unknown scales again.
        With `free` errors every change is a batch calibration, takes as long as one, and is exact.

    Raises
    ------
    InputError
        A pose covariance a station, noise to be estimated, a range sigma by beam, a robust loss, or
        a free error of which no plausible size is known.
    """

    def __init__(
        self,
        noise: Noise | None = None,
        options: CalibrationOptions | None = None,
    ) -> None:
        self.noise = Noise() if noise is None else noise
        self.options = CalibrationOptions() if options is None else options
        require_kind("noise", self.noise, Noise)
        require_kind("options", self.options, CalibrationOptions)
        S = self.noise.pose_covariance
        if S is not None and S.ndim == 3:
            raise InputError("a pose covariance a station", "one for all stations to come")
        for name in ("estimate_noise", "range_sigma_by_beam"):
            if getattr(self.options, name):
                expected = "sigmas that are given: estimate them with calibrate"
                raise ArgumentError(name, "while planes are added", expected)
        if self.options.loss != "gaussian":
            loss = f"{self.options.loss} while planes are added"
            raise ArgumentError("loss", loss, "the gaussian loss")
        self.options.require_consistent(self.noise)
        prior_sizes(self.options.free, self.options.sensor, 1.0)
        # Planes are added with one range sigma of all beams.
        self.options = replace(self.options, range_sigma_by_beam=False)
        self._early, self._now = Contents(), None
        self._screening: tuple[CalibrationWarning, ...] = ()
        self._lock = RLock()

    _now: AnyState | None

    def __getstate__(self) -> dict[str, object]:
        """Return everything but the lock, which is not shared."""
        with self._lock:
            return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Take everything over, with a new lock."""
        self.__dict__.update(state)
        self._lock = RLock()

    @property
    def started(self) -> bool:
        """Whether there is a calibration."""
        return self._now is not None

    @property
    def state(self) -> AnyState:
        """Everything that is known; it is never changed, only replaced.

        Raises
        ------
        InputError
            There is no calibration yet.
        """
        if self._now is None:
            raise InputError("a session without calibration", "recordings that determine the beams")
        return self._now

    @property
    def _contents(self) -> Contents:
        return self._early if self._now is None else self._now.contents

    @property
    def planes(self) -> tuple[str, ...]:
        """Names of the planes that are in the calibration."""
        return tuple(self._contents.inside)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the planes that wait for more stations, or fit the beams in no way."""
        return self._contents.waiting

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
        return self._contents.recorded()

    def add(self, recording: Recording) -> Update:
        """Add the stations of a recording; nothing has changed where an error is raised.

        All of them are read with the beams where these are now, also stations of a plane whose earlier
        stations were read before a beam moved.

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
        left, warnings = screened(recording, self.noise.range_sigma)
        if warnings:
            recording = left.part(~np.isnan(left.ranges).all(axis=1))
        with self._lock:
            now, contents = self._now, self._contents.added(recording, self.options.sensor)
            if now is None or not set(recording.beam_names) <= set(now.config.names):
                self._now, update = started(now, contents, self.noise, self.options)
                self._early = contents
            else:
                self._now, update = changed(now, contents, recording.plane_names)
            self._screening += warnings
        return update

    def remove_plane(self, name: str) -> Update:
        """Take a plane and its stations out again.

        Raises
        ------
        InputError
            No such plane, or the beams would not be determined without it.
        """
        with self._lock:
            self._require_plane(name)
            return self._without(self._contents.planes[name].recording.station_names, name)

    def remove_station(self, name: str) -> Update:
        """Take a station out again; its plane waits where the others do not determine it.

        Raises
        ------
        InputError
            No such station, or the beams would not be determined without it.
        """
        with self._lock:
            return self._without((name,), self._contents.plane_of(name))

    def _require_plane(self, name: str) -> None:
        planes = self._contents.planes
        if not planes:
            raise InputError(f"plane {name!r} of a session without planes", "one that was added")
        if name not in planes:
            raise InputError(f"unknown plane {name!r}", f"one of {', '.join(planes)}")

    def _without(self, stations: tuple[str, ...], plane: str) -> Update:
        contents = self._contents.without(stations)
        if self._now is None:
            self._early = contents
            return Update((), self.waiting, UNKNOWN, None, None)
        self._now, update = changed(self._now, contents, (plane,))
        return update

    def split_beam(self, beam: str, since: str) -> None:
        """Let a beam have moved before a plane came: everything is calibrated with one beam more.

        Nothing is thrown away: planes before `since` determine the earlier state, which stays in the
        session as `<beam> until <since>`, and are determined by the other beams, too.

        Parameters
        ----------
        beam : str
        since : str
            The first plane that saw it displaced.

        Raises
        ------
        InputError
            No calibration yet, no such beam or plane, no plane before it, a move that is known
            already, or readings that do not determine both states.
        """
        with self._lock:
            now, contents, before = self.state, self._contents, f"{beam} until {since}"
            present = [name for name in now.config.names if name not in contents.names]
            if beam not in present:
                raise InputError(f"beam {beam!r}", f"one of {', '.join(present)}")
            self._require_plane(since)
            if since not in list(contents.planes)[1:] or before in contents.names:
                raise InputError(
                    f"a move of beam {beam} before plane {since!r}",
                    "a plane with others before it, and every move once",
                )
            split = contents.split(beam, since)
            if not {beam, before} <= set(split.recording().beam_names):
                found = f"no reading of beam {beam} on one side of plane {since}"
                raise InputError(found, "some on both")
            # What does not determine the beams is refused.
            self._now, _ = started(now, split, self.noise, self.options)

    def beams(self) -> Mounts:
        """Return the beams as they are now, without looking at the planes.

        A range sigma that was not given is taken from the last comparison, or from `recalibrate`.
        """
        now = self.state
        state, config = now.with_shared, now.config
        terms = (config.terms,) * len(config.names)
        pose = config.variances.pose
        mounts = Mounts(
            config.names,
            *state.beams,
            terms,
            state.covariance,
            config.variances.range_sigma,
            None if pose is None else pose[0],
            config.sigma_dof,
        )
        former = now.contents.names
        return mounts.arranged(tuple(name for name in config.names if name not in former))

    def calibration(self) -> Calibration:
        """Return the batch solution from the present estimate, with all that a calibration states.

        The state of a beam before it moved stands beside it as a further beam.
        """
        now = self.state
        calibration = now.calibration()
        warnings = (*self._screening, *calibration.warnings)
        planes = len(now.contents.inside)
        learns = now.config.learned is not None or self.noise.range_sigma is None
        if learns and now.learned_with != planes:
            values = {"learned": now.learned_with, "planes": planes}
            warnings = (*warnings, warned("scales-of-fewer-planes", values))
        return replace(calibration, warnings=warnings)

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, and beams and planes as they are now.

        Every plane has a frame amid its stations, with the axes of the world.
        """
        return self.state.estimate()

    def compare(self) -> Comparison:
        """Compare the beams with the batch solution of the same readings, from the present estimate.

        With free errors it is a calibration of the same planes from the beginning.
        """
        return self.state.compare()

    def moved(self) -> BeamDrift | None:
        """Return the beam that all planes so far show to have moved, whenever that was."""
        return self.state.moved()

    def recalibrate(self) -> Comparison:
        """Calibrate everything so far at once, compare, and take over scales and outliers that differ.

        Scales of noise and range errors are meant; every comparison that is due learns them again, too.
        """
        with self._lock:
            self._now, comparison = self.state.recalibrated()
        return comparison


def started(
    now: AnyState | None, contents: Contents, noise: Noise, options: CalibrationOptions
) -> tuple[AnyState | None, Update]:
    """Calibrate everything together, and start from there if that converges.

    Raises
    ------
    InputError
        The readings of a new beam do not determine it, or hardly.
    """
    waits = Update((), contents.waiting, UNKNOWN, None, None)
    try:
        batch = calibrate_from(None, contents.recording(), noise, options)
    except InputError as error:
        if now is not None or not options.free:
            raise
        return None, replace(waits, message=str(error))  # the first planes may have no such error
    if batch.status != "converged":
        if now is not None:  # a new beam that is not determined: nothing is lost
            raise InputError(f"a new beam ({batch.message})", "readings that determine it")
        return None, replace(waits, message=batch.message)
    kind: type[AnyState] = FreedState if options.free else SessionState
    try:
        new = kind.of(batch, contents, noise, options)
    except InputError as error:
        if now is not None:
            raise
        return None, replace(waits, message=str(error))
    return new, Update(
        tuple(new.contents.inside),
        new.contents.waiting,
        UNKNOWN,
        new.with_shared.sigmas(),
        None,
        rejected=new.contents.rejected,
        moved=new.moved(),
    )


def changed(now: AnyState, contents: Contents, planes: tuple[str, ...]) -> tuple[AnyState, Update]:
    """Bring a session to `contents`, in which only `planes` differ from the present ones.

    Raises
    ------
    InputError
        The beams would not be determined.
    """
    new: AnyState
    new, joined, inconsistent = now.changed(contents, planes)
    comparison, message = None, ""
    if isinstance(new, SessionState):
        if inconsistent and new.config.reject and not new.trusted:
            batch, of = new.calibrated()
            if batch.status == "converged":
                new = SessionState.of(batch, new.contents, of.noise, of.options)
                message = RESTARTED
                joined, inconsistent = tuple(new.contents.inside), ()
        new, comparison = new.compared_if_due()
    moved = new.moved(recently=True)
    if moved is not None and isinstance(new, SessionState) and new.config.reject:
        before = None if comparison else now.moved(recently=True)
        if before is None or (before.name, before.since) != (moved.name, moved.since):
            judged = new.rather_gross(moved)
            if judged is not new:
                new, message, comparison, inconsistent = judged, RESTARTED, None, ()
                joined, moved = tuple(new.contents.inside), new.moved(recently=True)
    begun_again = message or (comparison is not None and comparison.changes)
    gain = 0.5 * (new.with_shared.information - now.with_shared.information)
    old = set(now.contents.rejected)
    return new, Update(
        joined,
        new.contents.waiting,
        UNKNOWN if begun_again else gain,
        new.with_shared.sigmas(),
        now.with_shared.sigmas(),
        message,
        tuple(reading for reading in new.contents.rejected if reading not in old),
        moved,
        inconsistent,
        comparison,
    )
