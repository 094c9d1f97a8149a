r"""One plane beside beams that are known: fitted, judged, and made into factors.

A plane is linearised at the beams about which the session counts everything, `at`. With the residuals e
of its N readings, their covariance C, and the derivatives A (N, n) by the beams' unknowns x from there
and B (N, 3) by the plane, its readings alone determine the plane where B' inv(C) B has full rank, and
say of the beams the information that is left once the plane is eliminated (`LinearReadings`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording
from ..errors import GrazingBeamError
from ..estimation.estimate import MOST_REJECTED
from ..estimation.learning_scales import LinearReadings
from ..estimation.scale_mixture import parts_of
from ..factors.keys import plane_key, pose_key
from ..model.distributions import chi2_sf, gaussian_sf, student_quantile
from ..model.families import BEAM, PLANE
from ..model.joint import beams_lift
from ..model.weighting import Whitening, weighed, whitening
from ..quantities import KNOWN, NEGLIGIBLE, ROUGH_CUT
from ..solvers.beam_problem import jacobian_columns, moved
from ..solvers.graph import grouped_blocks, pose_priors
from ..solvers.isam import BeamState, GraphPart
from ..starts.growing import grown_from
from .config import SessionConfig


@dataclass(frozen=True, eq=False)
class FittedPlane:
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
    information : (J, n + 1, n + 1)
        What the plane knows of the beams (`information_of`), in natural units, for each of the J
        `SessionConfig.sets`.
    origin : (3,)
        Origin of the frame in the world [m].
    """

    config: SessionConfig
    readings: Readings
    parameters: Parameters
    residual: FloatArray
    whitening: Whitening
    information: FloatArray
    origin: FloatArray

    def mask(self, recording: Recording, rows: BoolArray) -> BoolArray:
        """Return the mask (M, B) of some of the readings in their recording."""
        beam = np.array(self.config.names)[self.readings.beam[rows]]
        column = [recording.beam_names.index(name) for name in beam.tolist()]
        mask = np.zeros(recording.ranges.shape, dtype=bool)
        mask[self.readings.station[rows], column] = True
        return mask

    @cached_property
    def fits(self) -> bool:
        """Whether its readings agree with each other, whatever the beams are."""
        matrix, vector, _ = parts_of(self.information[0])
        white = self.whitening.apply(self.residual) / self.whitening.sigma
        values, axes = np.linalg.eigh(matrix)
        keep = values > 1.0
        fall = ((axes.T @ vector)[keep] ** 2 / values[keep]).sum()
        return self._likely(float(white @ white - fall), len(white) - 3 - int(keep.sum()))

    def agrees(self, state: BeamState) -> bool:
        """Tell whether the readings agree with the beams as they are."""
        return self._likely(self.misfit(state), len(self.readings) - 3)

    def misfit(self, state: BeamState) -> float:
        """Return chi2 of the readings: plane free, beams known with their covariance."""
        rows, heavy, K = self._normal(state)
        right = rows.T @ heavy[:, -1]
        return float(right[-1] - right[:-1] @ K @ right[:-1])

    def standardized(self, state: BeamState) -> FloatArray:
        """Return the residual (N,) of each reading from the others, in its standard deviations.

        Baarda's w-test: plane free, beams known with their covariance, readings with theirs. Zero for a
        reading that decides something by itself, of which the others say nothing.
        """
        rows, heavy, K = self._normal(state)
        across = heavy[:, :-1]
        squares = self.whitening.squares() / self.whitening.sigma**2
        left = heavy[:, -1] - across @ (K @ (rows.T @ heavy[:, -1])[:-1])
        free = squares - ((across @ K) * across).sum(axis=1)
        tested = free > 1e-3 * squares  # of the rest the others know next to nothing
        return np.where(tested, left / np.sqrt(np.where(tested, free, 1.0)), 0.0)

    def outliers(self, recording: Recording, state: BeamState) -> BoolArray | None:
        """Return which readings (M, B) of its recording the other readings and the beams contradict.

        The farthest is rejected, the plane fitted again, until none is far. None where that does not
        end soon: then it is not the readings that are at fault.
        """
        dof, at = self.config.sigma_dof, self.parameters.beams
        cut = ROUGH_CUT
        if np.isfinite(dof):
            cut = -float(student_quantile(gaussian_sf(ROUGH_CUT), dof))
        bad, now = np.zeros(recording.ranges.shape, dtype=bool), self
        most = MOST_REJECTED * (~np.isnan(recording.ranges)).sum()
        while True:
            t = np.abs(now.standardized(state))
            worst = int(np.argmax(t))
            if t[worst] <= cut:
                return bad
            bad |= now.mask(recording, np.arange(len(t)) == worst)
            rest = None
            if bad.sum() <= most:  # else the beams are at fault
                rest = fit_plane(self.config, recording.without(bad), at, self.origin)
            if rest is None:
                return None
            now = rest

    def culprit(self, recording: Recording, state: BeamState) -> str:
        """Return the only beam without which the plane would fit; empty where there is none."""
        culprits = []
        names = recording.beam_names
        for name in names if len(names) > 1 else ():
            rest = recording.without(np.array(names) == name)
            fitted = fit_plane(self.config, rest, self.parameters.beams, self.origin)
            if fitted is not None and fitted.agrees(state):
                culprits.append(name)
        return culprits[0] if len(culprits) == 1 else ""

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
        values.insert(plane_key(number), plane=gtsam.OrientedPlane3(normal, offset))
        rows: IntArray = np.lexsort((readings.beam, readings.station))
        together, priors, graph = readings.plane, None, gtsam.NonlinearFactorGraph()
        if self.config.poses == "estimated":
            names = recording.station_names
            number_of = np.array([stations[name] for name in names])
            variances = self.config.variances.for_stations(len(names))
            assert variances.pose is not None, "estimated poses have a covariance"
            how = whitening(self.parameters, readings, variances.without_poses())
            local = pose_priors(readings, variances.pose)
            priors = replace(local, stations=number_of[local.stations])
            priors.join(graph, values, tuple(pose_key(j) for j in priors.stations.tolist()))
            readings = replace(readings, station=number_of[readings.station])
            together = readings.station
        keys = self.config.keys, (plane_key(number),), priors
        blocks = grouped_blocks(readings, how, rows, together, keys)
        return GraphPart(blocks, tuple(graph.at(i) for i in range(graph.size())), values)

    def _likely(self, chi2: float, free: int) -> bool:
        dof = self.config.sigma_dof
        if np.isfinite(dof):  # an estimated sigma may be wrong by this factor
            chi2 /= 1.0 + 4.0 / np.sqrt(0.5 * dof)
        return free <= 0 or bool(chi2_sf(chi2, free) > NEGLIGIBLE)

    def _normal(self, state: BeamState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what is known of beams and plane, in metres and radians.

        The derivatives and the residuals at the beams of `state` (N, n + 4), inv(C) times both, and the
        covariance (n + 3, n + 3) of beams and plane.
        """
        config, parameters, readings = self.config, self.parameters, self.readings
        columns = jacobian_columns(parameters, readings, 2)
        J = np.zeros((len(readings), len(config.names), BEAM.dim))
        J[np.arange(len(J)), readings.beam] = columns[: BEAM.dim].T
        of_beams = J.reshape(len(J), -1)[:, config.mask]
        lift = beams_lift(model.tangent_basis(parameters.directions), [config.terms] * J.shape[1])
        x = lift.T @ (np.hstack(state.beams) - np.hstack(parameters.beams)).ravel()
        residual = self.residual + of_beams @ x
        rows = np.column_stack((of_beams, columns[BEAM.dim : -1].T, residual))
        heavy = self.whitening.weighed(rows) / self.whitening.sigma**2
        H = rows[:, :-1].T @ heavy[:, :-1]
        S = lift.T @ state.covariance @ lift
        unit = np.sqrt(np.diagonal(S))
        H[: len(S), : len(S)] += np.linalg.inv(S / np.outer(unit, unit)) / np.outer(unit, unit)
        scale = 1.0 / np.sqrt(np.diagonal(H))
        return rows, heavy, scale[:, None] * np.linalg.inv(H * np.outer(scale, scale)) * scale


def fit_plane(
    config: SessionConfig, recording: Recording, at: Beams, origin: FloatArray | None = None
) -> FittedPlane | None:
    """Return the plane that fits a recording of it and known beams.

    None where its readings do not determine it, or a beam grazes it.

    Parameters
    ----------
    config : SessionConfig
    recording : Recording
        Recording of one plane.
    at : Beams
    origin : (3,), optional
        Origin of the plane's frame [m]; amid its stations where not given.
    """
    readings = config.readings(recording)
    if origin is None:
        origin = readings.plane_means(readings.world_t_hand)[0]
    readings, stations = readings.seen_from(origin[None]), len(recording.plane_labels)
    variances, base = (of.for_stations(stations) for of in (config.variances, config.base))
    r, v, k = at
    # The plane through the laser spots by total least squares, facing away from the beams.
    parameters = grown_from(readings, r=r, v=v, k=k)
    still, unit = np.zeros((len(r), BEAM.dim)), PLANE.natural_units(config.length)
    try:
        # A second pass judges the noise of readings by the weighted plane, not by that of the spots.
        for _ in range(2 if config.terms else 1):
            corrected, how = weighed(readings, parameters, variances, config.terms)
            rows = LinearReadings(parameters, corrected, config.terms, config.length, base)
            _, planes = rows.information(*(scales[:1] for scales in config.sets))
            if not planes.local_values[0, 0, 0] > KNOWN**-2:
                return None
            parameters = moved(parameters, still, unit * planes.local_step[0], rows.centres)
        rows = LinearReadings(parameters, corrected, config.terms, config.length, base)
        information, _ = rows.information(*config.sets)
        e = model.residuals(model.scene(parameters, corrected), corrected.distance)
    except GrazingBeamError:
        return None
    return FittedPlane(config, corrected, parameters, e, how, information, origin)
