"""One plane beside beams that are known: fitted, judged, and made into factors."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording
from ..errors import GrazingBeamError
from ..estimation.estimate import MOST_REJECTED
from ..estimation.information import Information
from ..factors.keys import plane_key, pose_key
from ..model.distributions import chi2_sf, gaussian_sf, student_quantile
from ..model.errors_in_variables import weighed
from ..model.families import BEAM, PLANE, modelled
from ..model.joint import beams_lift
from ..model.reduction import Normal
from ..model.weighting import Whitening, whitening
from ..quantities import KNOWN, NEGLIGIBLE
from ..solvers.beam_problem import jacobian_columns, linearized, moved
from ..solvers.graph import pose_priors, station_blocks
from ..solvers.isam import BeamState, GraphPart
from ..starts.growing import PartialStart, grow
from .config import SessionConfig
from .drift import DriftHistory, turns

DECIDES_ITSELF = 1e-3
"""A reading of which the others know less than this part is not tested."""
SESSION_CUT = 4.5
"""A new reading further off than this, in its standard deviations, is an outlier, if Gaussian."""


class FittedPlane(NamedTuple):
    """Readings of one plane in its own frame, with the plane that fits them beside known beams.

    Attributes
    ----------
    config : SessionConfig
    readings : Readings
    parameters : Parameters
    residual : (N,)
        [m]
    whitening : Whitening
        Poses eliminated.
    normal : Normal
        With two range-error terms; linearised where the last step of Gauss and Newton began, gradients
        counted from where it ended.
    origin : (3,)
        Origin of the frame in the world [m].
    """

    config: SessionConfig
    readings: Readings
    parameters: Parameters
    residual: FloatArray
    whitening: Whitening
    normal: Normal
    origin: FloatArray

    def determined(self) -> bool:
        """Tell whether the readings alone determine the plane, for known beams."""
        unit = PLANE.natural_units(self.readings.typical_range())
        information = self.normal.local[0, 0] * np.outer(unit, unit) / self.whitening.sigma**2
        return bool(np.linalg.eigvalsh(information)[0] > KNOWN**-2)

    def mask(self, recording: Recording, rows: BoolArray) -> BoolArray:
        """Return the mask (M, B) of some of the readings in their recording."""
        beam = np.array(self.config.names)[self.readings.beam[rows]]
        column = [recording.beam_names.index(name) for name in beam.tolist()]
        mask = np.zeros(recording.ranges.shape, dtype=bool)
        mask[self.readings.station[rows], column] = True
        return mask

    def information(self, history: DriftHistory) -> Information:
        """Return what the plane knows of the beams, (n, n) and (n,), in natural units."""
        beams, sigma = self.parameters.beams, self.whitening.sigma
        length = history.config.length
        unit = np.tile(BEAM.natural_units(length), len(beams[0]))
        reduced = self.normal.reduced(unit, PLANE.natural_units(length), history.mask)
        turn = turns(beams[1], history)
        L = turn.T @ reduced.matrix @ turn / sigma**2
        gradient = turn.T @ reduced.gradient / sigma**2
        return Information(L, L @ history.coordinates(beams) - gradient, np.zeros(()))

    def fits(self, information: Information, history: DriftHistory) -> bool:
        """Tell whether its readings agree with each other, whatever the beams are.

        Parameters
        ----------
        information : Information
            Information of this plane.
        history : DriftHistory
            Has the beams that it is counted from.
        """
        white = self.whitening.apply(self.residual) / self.whitening.sigma
        values, axes = np.linalg.eigh(information.matrix)
        keep = values > 1.0
        here = history.coordinates(self.parameters.beams)
        along = axes.T @ (information.vector - information.matrix @ here)
        fall = (along[keep] ** 2 / values[keep]).sum()
        return self._likely(float(white @ white - fall), len(white) - 3 - int(keep.sum()))

    def standardized(self, state: BeamState) -> FloatArray:
        """Return the residual (N,) of each reading from the others, in its standard deviations.

        Baarda's w-test: plane free, beams known with their covariance, readings with theirs. Zero for a
        reading that decides something by itself, of which the others say nothing.
        """
        heavy, right, K = self._normal(state)
        across, squares = heavy[:, :-1], self.whitening.squares()
        left = heavy[:, -1] - across @ (K @ right)
        free = squares - ((across @ K) * across).sum(axis=1)
        tested = free > DECIDES_ITSELF * squares
        return np.where(tested, left / np.sqrt(np.where(tested, free, 1.0)), 0.0)

    def misfit(self, state: BeamState) -> float:
        """Return chi2 of the readings: plane free, beams known with their covariance."""
        heavy, right, K = self._normal(state)
        chi2 = self.residual @ heavy[:, -1] / self.whitening.sigma
        return float(chi2 - right @ K @ right)

    def agrees(self, state: BeamState) -> bool:
        """Tell whether the readings agree with the beams as they are."""
        return self._likely(self.misfit(state), len(self.readings) - 3)

    def _likely(self, chi2: float, free: int) -> bool:
        dof = self.config.sigma_dof
        if np.isfinite(dof):  # an estimated sigma may be wrong by this factor
            chi2 /= 1.0 + 4.0 / np.sqrt(0.5 * dof)
        return free <= 0 or bool(chi2_sf(chi2, free) > NEGLIGIBLE)

    def _normal(self, state: BeamState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what is known of beams and plane.

        Their derivatives and the residuals (N, n + 1) times sigma inv(C), the derivatives times
        inv(C) times the residuals (n,), and the covariance (n, n).
        """
        config, parameters, readings = self.config, self.parameters, self.readings
        columns = jacobian_columns(parameters, readings, 2)
        J = np.zeros((len(readings), len(config.names), BEAM.dim))
        J[np.arange(len(J)), readings.beam] = columns[: BEAM.dim].T
        active = modelled(config.terms).ravel()
        rows = np.hstack((J.reshape(len(J), -1)[:, active], columns[BEAM.dim : -1].T))
        sigma = self.whitening.sigma
        heavy = self.whitening.weighed(np.column_stack((rows, self.residual))) / sigma
        normal = rows.T @ heavy / sigma
        H, right = normal[:, :-1], normal[:, -1]
        lift = beams_lift(model.tangent_basis(parameters.directions), config.terms)
        S = lift.T @ state.covariance @ lift
        unit = np.sqrt(np.diagonal(S))
        H[: len(S), : len(S)] += np.linalg.inv(S / np.outer(unit, unit)) / np.outer(unit, unit)
        scale = 1.0 / np.sqrt(np.diagonal(H))
        K = scale[:, None] * np.linalg.inv(H * np.outer(scale, scale)) * scale
        return heavy, right, K

    def factors(self, number: int, stations: Mapping[str, int], recording: Recording) -> GraphPart:
        """Return the factors of plane `number` in a graph.

        Parameters
        ----------
        number : int
        stations : mapping of str to int
            Number of every station in the session, for the keys of estimated poses.
        recording : Recording
            Recording of this plane.
        """
        readings, how, values = self.readings, self.whitening, gtsam.Values()
        normal, offset = gtsam.Unit3(self.parameters.normals[0]), self.parameters.offsets[0]
        values.insert(plane_key(number), gtsam.OrientedPlane3(normal, offset))
        rows: IntArray = np.lexsort((readings.beam, readings.station))
        together, priors, graph = readings.plane, None, gtsam.NonlinearFactorGraph()
        if self.config.poses == "estimated":
            names = recording.station_names
            number_of = np.array([stations[name] for name in names])
            variances = self.config.variances(len(names))
            if variances.pose is None:
                raise ValueError("estimated poses without a covariance")
            how = whitening(self.parameters, readings, variances.without_poses())
            local = pose_priors(readings, variances.pose)
            priors = replace(local, stations=number_of[local.stations])
            priors.join(graph, values, tuple(pose_key(j) for j in priors.stations.tolist()))
            readings = replace(readings, station=number_of[readings.station])
            together = readings.station
        keys = self.config.beams, (plane_key(number),), priors
        blocks = station_blocks(readings, how, rows, together, keys)
        return GraphPart(blocks, tuple(graph.at(i) for i in range(graph.size())), values)


def fit_plane(
    config: SessionConfig, recording: Recording, beams: Beams, origin: FloatArray | None = None
) -> FittedPlane | None:
    """Return the plane that fits a recording of it and known beams; None where a beam grazes it.

    Parameters
    ----------
    config : SessionConfig
    recording : Recording
        Recording of one plane.
    beams : Beams
    origin : (3,), optional
        Origin of the plane's frame [m]; amid its stations where not given.
    """
    readings = config.readings(recording)
    if origin is None:
        origin = readings.plane_means(readings.world_t_hand)[0]
    readings = readings.seen_from(origin[None])
    variances = config.variances(len(recording.plane_labels))
    r, v, k = beams
    # The plane through the laser spots by total least squares, facing away from the beams.
    parameters = grow(PartialStart.of(readings, r=r, v=v, k=k), readings)
    terms = max(config.terms)
    try:
        # A second pass judges the noise of readings by the weighted plane, not by that of the spots.
        for _ in range(2 if terms and config.weights_depend else 1):
            corrected, how = weighed(readings, parameters, variances, terms)
            at = linearized(parameters, corrected, 2, how)
            still = np.zeros((len(r), BEAM.dim))
            unit = PLANE.natural_units(corrected.typical_range())
            reduced = at.normal.reduced(np.ones(still.size), unit)
            parameters = moved(parameters, still, unit * reduced.local_step, at.centres)
        e = model.residuals(model.scene(parameters, corrected), corrected.distance)
    except GrazingBeamError:
        return None
    gradient, none = reduced.gradient[None], np.zeros_like(at.normal.local_gradient)
    normal = replace(at.normal, gradient=gradient, local_gradient=none)
    return FittedPlane(config, corrected, parameters, e, how, normal, origin)


def determined_plane(
    config: SessionConfig, recording: Recording, beams: Beams, origin: FloatArray | None = None
) -> FittedPlane | None:
    """Return as `fit_plane` a plane that its readings determine; None for any other."""
    fitted = fit_plane(config, recording, beams, origin)
    return fitted if fitted is not None and fitted.determined() else None


def outliers(fitted: FittedPlane, recording: Recording, state: BeamState) -> BoolArray | None:
    """Return which readings (M, B) of a recording the other readings and the beams contradict.

    The farthest is rejected, the plane fitted again, until none is far. None where that does not end
    soon: then it is not the readings that are at fault.
    """
    dof = fitted.config.sigma_dof
    cut = SESSION_CUT if np.isinf(dof) else -float(student_quantile(gaussian_sf(SESSION_CUT), dof))
    bad = np.zeros(recording.ranges.shape, dtype=bool)
    total, now = int((~np.isnan(recording.ranges)).sum()), fitted
    while True:
        t = np.abs(now.standardized(state))
        worst = int(np.argmax(t))
        if t[worst] <= cut:
            return bad
        if bad.sum() + 1 > MOST_REJECTED * total:  # the beams are at fault
            return None
        bad |= now.mask(recording, np.arange(len(t)) == worst)
        rest = recording.without(bad)
        again = determined_plane(fitted.config, rest, fitted.parameters.beams, fitted.origin)
        if again is None:
            return None
        now = again
