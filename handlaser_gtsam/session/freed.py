"""A session with systematic errors as unknowns (`results.freed`).

Every plane changes the sizes of these errors, and a size changes the readings or the poses of all
planes. So nothing that single planes knew of the beams stays as it was, and no graph can grow: at every
change all planes that their readings determine are calibrated at once. The beams agree with a batch
calibration to the last digit, and a change takes as long as one.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import InputError
from ..model.joint import JointCovariance
from ..pipeline import calibrate
from ..results.calibration import Calibration
from ..solvers.isam import BeamState
from .config import SessionConfig
from .contents import Contents
from .fitted import determined_plane
from .joining import fitted_planes, history_of
from .reports import Change, Comparison, Moved
from .state import undetermined


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
    def of(cls, batch: Calibration, contents: Contents, config: SessionConfig) -> "FreedState":
        """Return the state after a calibration, converged, of some planes of the contents."""
        joint = _joint(batch)
        origins = dict(zip(joint.plane_names, joint.origins, strict=True))
        out = (one for one in contents.rejected if contents.plane_of(one.station) not in origins)
        placed = contents.restarted((*batch.fit.rejected, *out)).numbered(origins)
        for plane, culprit in contents.excluded.items():
            if plane not in origins:
                placed = placed.with_plane(plane, placed.planes[plane].taken_out(culprit))
        return cls(placed, config, batch)

    @cached_property
    def integrated(self) -> BeamState:
        """The beams with all scales integrated over, and what is not known of the errors."""
        joint = _joint(self.batch)
        tangent = joint.matrix(planes=[], ambient=False)
        unit = np.sqrt(np.diagonal(tangent))
        _, correlated = np.linalg.slogdet(tangent / np.outer(unit, unit))
        information = -correlated - 2.0 * np.log(unit).sum()
        beams, covariance = self.batch.parameters().beams, joint.matrix(planes=[])
        return BeamState(*beams, covariance, float(information))

    @property
    def learned_with(self) -> int:
        """Planes behind the scales that were learned: all of them."""
        return len(self.contents.numbers)

    def calibration(self) -> Calibration:
        """Return the batch calibration, which it is."""
        return self.batch

    def estimate(self) -> tuple[Readings, Parameters]:
        """Return the readings that are used, without the errors, and beams and planes.

        Every plane has a frame amid its stations.
        """
        readings = self.batch.used_in(self.contents.everything()).readings()
        origins = readings.plane_means(readings.world_t_hand)
        return readings.seen_from(origins), self.batch.parameters().seen_from(origins)

    def moved(self, *, recently: bool = False) -> Moved | None:
        """Return the beam that has moved; `recently`: in one of the epochs tested after a change."""
        beams, used = self.integrated.beams, self.batch.used_in(self.contents.everything())
        planes = self.contents.numbers
        fitted = {name: determined_plane(self.config, used.plane(name), beams) for name in planes}
        determined = {name: plane for name, plane in fitted.items() if plane is not None}
        history, _ = history_of(self.config, beams, determined)
        return history.search(self.config.sigma_dof, history.recent() if recently else None)

    def compare(self) -> Comparison:
        """Compare with a calibration of the same planes from the beginning."""
        return self._apart(self._calibrated(self.contents, list(self.contents.numbers)))

    def recalibrated(self) -> tuple["FreedState", Comparison]:
        """Calibrate everything, with planes that were excluded, and compare."""
        excluded = tuple(self.contents.excluded)
        contents = self.contents.included(excluded)
        batch = self._calibrated(contents, self._determined(contents))
        if batch.status != "converged":
            words = f"everything together does not converge: {batch.message}"
            return self, replace(self.compare(), changes=(Change("not-converged", words),))
        changes: tuple[Change, ...] = ()
        if excluded:
            changes = (Change("excluded-planes", "planes that did not fit taken in again"),)
        return self._after(batch, contents), replace(self._apart(batch), changes=changes)

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
            for plane in inconsistent:
                contents = contents.with_plane(plane, contents.planes[plane].taken_out(""))
            rest = [plane for plane in inside if plane not in inconsistent]
            batch = self._calibrated(contents, rest) if inconsistent else batch
        if batch.status != "converged":
            raise undetermined(f" ({batch.message})")
        new = self._after(batch, contents)
        joined = tuple(plane for plane in planes if plane in new.contents.numbers)
        return new, joined, inconsistent

    def _determined(self, contents: Contents) -> list[str]:
        """Return the planes that readings and beams determine, and that are not excluded."""
        return list(fitted_planes(contents, self.config, self.integrated.beams))

    def _calibrated(self, contents: Contents, planes: list[str]) -> Calibration:
        """Return the calibration of some planes, in the order in which their stations came."""
        if not planes:
            raise undetermined(" (no plane is left)")
        everything, config = contents.everything(), self.config
        recording = everything.part(np.isin(everything.plane_labels, planes))
        batch = calibrate(recording, config.noise, config.options)
        if batch.interrupted:
            raise KeyboardInterrupt
        if set(batch.beams) != set(config.names):
            lost = ", ".join(name for name in config.names if name not in batch.beams)
            raise InputError(f"no reading left of beam {lost}", "some of every beam")
        return batch

    def _after(self, batch: Calibration, contents: Contents) -> "FreedState":
        return FreedState.of(batch, contents, SessionConfig.of(batch, self.config.given))

    def _apart(self, batch: Calibration) -> Comparison:
        """Compare the beams with the beams of another calibration."""
        return Comparison(*self.config.apart(self.integrated, batch))


def _joint(batch: Calibration) -> JointCovariance:
    """Return the covariance of a calibration that is converged."""
    assert batch.covariance is not None, "what is converged has a covariance"
    return batch.covariance
