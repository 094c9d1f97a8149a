"""A session with systematic errors as unknowns (`results.freed`).

Every plane changes the sizes of these errors, and a size changes the readings or the poses of all
planes. So nothing that single planes knew of the beams stays as it was, and no graph can grow: at every
change all planes that their readings determine are calibrated at once. The beams agree with a batch
calibration to the last digit, and a change takes as long as one.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import InputError
from ..estimation.options import CalibrationOptions
from ..pipeline import calibrate_from
from ..results.calibration import Calibration
from ..solvers.isam import BeamState
from ..validation.other_recording import BeamDrift
from .config import SessionConfig
from .contents import Contents
from .moved_beam import search
from .plane import fit_plane
from .reports import ChangeCode, Comparison
from .state import fitted_planes, undetermined


@dataclass(frozen=True, eq=False)
class FreedState:
    """The calibration of a session with freed errors; what `SessionState` is without them.

    Attributes
    ----------
    contents : Contents
        As recorded. A plane that is in the calibration has a number.
    config : SessionConfig
    batch : Calibration
        Of these planes; it is converged.
    """

    contents: Contents
    config: SessionConfig
    batch: Calibration

    @classmethod
    def of(
        cls, batch: Calibration, contents: Contents, noise: Noise, options: CalibrationOptions
    ) -> "FreedState":
        """Return the state after a calibration, converged, of some planes of the contents."""
        out = (
            one for one in contents.rejected if contents.plane_of(one.station) not in batch.planes
        )
        placed = contents.restarted((*batch.fit.rejected, *out)).planes
        number = {name: number for number, name in enumerate(batch.planes)}
        culprits = contents.excluded
        planes = {
            name: replace(plane, number=number.get(name), culprit=culprits.get(name))
            for name, plane in placed.items()
        }
        config = SessionConfig.of(batch, noise, options)
        return cls(contents.with_planes(planes), config, batch)

    @cached_property
    def with_shared(self) -> BeamState:
        """The beams with all scales integrated over, and all errors: it is of the calibration."""
        joint = self.batch.covariance
        assert joint is not None, "what is converged has a covariance"
        _, log_det = np.linalg.slogdet(joint.matrix(planes=[], ambient=False))
        return BeamState(*self.batch.parameters().beams, joint.matrix(planes=[]), -float(log_det))

    @property
    def learned_with(self) -> int:
        """Planes behind the scales that were learned: all of them."""
        return len(self.contents.inside)

    def calibration(self) -> Calibration:
        """Return the batch calibration, which it is."""
        return self.batch

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, without the errors, and beams and planes.

        Every plane has a frame amid its stations.
        """
        readings = self.batch.used_in(self.contents.recording()).readings()
        origins = readings.plane_means(readings.world_t_hand)
        return readings.seen_from(origins), self.batch.parameters().seen_from(origins)

    def moved(self, *, recently: bool = False) -> BeamDrift | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        beams, used = self.with_shared.beams, self.batch.used_in(self.contents.recording())
        every = {
            name: fit_plane(self.config, used.plane(name), beams) for name in self.contents.inside
        }
        fitted = {name: plane for name, plane in every.items() if plane is not None and plane.fits}
        return search(self.config, fitted, recently=recently)

    def compare(self) -> Comparison:
        """Compare with a calibration of the same planes from the beginning."""
        batch = self._calibrated(self.contents, list(self.contents.inside))
        return Comparison(*self.config.apart(self.with_shared, batch))

    def recalibrated(self) -> tuple["FreedState", Comparison]:
        """Calibrate everything, with planes that were excluded, and compare."""
        contents = self.contents.included()
        batch = self._calibrated(contents, self._determined(contents))
        if batch.status != "converged":
            words = f"everything together does not converge: {batch.message}"
            return self, replace(self.compare(), changes={"not-converged": words})
        changes: dict[ChangeCode, str] = {}
        if self.contents.excluded:
            changes = {"excluded-planes": "planes that did not fit taken in again"}
        new = FreedState.of(batch, contents, self.config.noise, self.config.options)
        return new, Comparison(*self.config.apart(self.with_shared, batch), changes)

    def changed(
        self, contents: Contents, planes: tuple[str, ...]
    ) -> tuple["FreedState", tuple[str, ...], tuple[str, ...]]:
        """Return the state with `contents`, in which only `planes` differ from the present ones.

        The second result names the `planes` that are in it, the third the planes that fit the others in
        no way: they are excluded.

        Raises
        ------
        InputError
            The beams would not be determined.
        """
        inside, inconsistent = self._determined(contents), tuple[str, ...]()
        batch = self._calibrated(contents, inside)
        if batch.status != "converged":
            inconsistent = tuple(plane for plane in planes if plane in inside)
            out = {name: contents.planes[name].taken_out("") for name in inconsistent}
            contents = contents.with_planes(out)
            rest = [plane for plane in inside if plane not in inconsistent]
            batch = self._calibrated(contents, rest) if inconsistent else batch
        if batch.status != "converged":
            raise undetermined(f" ({batch.message})")
        new = FreedState.of(batch, contents, self.config.noise, self.config.options)
        return new, tuple(plane for plane in planes if plane in new.contents.inside), inconsistent

    def _determined(self, contents: Contents) -> list[str]:
        """Return the planes that readings and beams determine, and that are not excluded."""
        return list(fitted_planes(contents, self.config, self.with_shared.beams).inside)

    def _calibrated(self, contents: Contents, planes: list[str]) -> Calibration:
        """Return the calibration of some planes, in the order in which their stations came."""
        if not planes:
            raise undetermined(" (no plane is left)")
        everything, config = contents.recording(), self.config
        recording = everything.part(np.isin(everything.plane_labels, planes))
        batch = calibrate_from(None, recording, config.noise, config.options)
        if batch.interrupted:
            raise KeyboardInterrupt
        if set(batch.beams) != set(config.names):
            lost = ", ".join(name for name in config.names if name not in batch.beams)
            raise InputError(f"no reading left of beam {lost}", "some of every beam")
        return batch
