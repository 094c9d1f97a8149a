r"""Unknown scales in a session, integrated over as in the batch solution.

Every plane is remembered by its information on the beams for each set of noise scales
(`estimation.information`), counted from beams that all share. The graph holds the most probable scales.
Integrating over all scales changes mean and covariance; both changes follow from the sums over the
planes, and are added to the estimate of iSAM2. So the cost of a new plane does not grow.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..estimation.information import Information, LinearReadings
from ..estimation.learned import LearnedScales
from ..estimation.mixture import BeamPosterior
from ..model.families import DIRECTION, LOCATION, RANGE_ERROR
from ..model.joint import beams_lift
from ..solvers.isam import BeamState
from .config import SessionConfig
from .drift import DriftHistory, turns
from .fitted import FittedPlane


def scaled_information(
    fitted: FittedPlane, history: DriftHistory, learned: LearnedScales
) -> Information:
    """Return what a plane knows of the beams for all sets of noise scales, counted as in a history."""
    readings = fitted.readings
    variances = learned.base.for_stations(int(readings.station.max()) + 1)
    rows = LinearReadings(fitted.parameters, readings, learned.terms, learned.length, variances)
    points = [learned.mode, *learned.points]
    information, _ = rows.information([learned.scales.noise(u) for u in points])
    # The unknowns there are turn (x - shift).
    turn = turns(fitted.parameters.directions, history)
    shift = history.coordinates(fitted.parameters.beams)
    matrix = turn.T @ information.matrix @ turn
    vector = information.vector @ turn
    constant = information.constant - vector @ shift - 0.5 * (matrix @ shift) @ shift
    return Information(matrix, vector + matrix @ shift, constant)


def integrated(
    state: BeamState,
    config: SessionConfig,
    history: DriftHistory,
    pieces: Mapping[str, Information],
) -> BeamState:
    """Return beams at the most probable scales with all scales integrated over.

    Parameters
    ----------
    state : BeamState
    config : SessionConfig
    history : DriftHistory
        What is known beside the planes, whatever the noise is, and what everything is counted from.
    pieces : mapping of str to Information
        `scaled_information` by plane.
    """
    learned, members = config.learned, config.members
    if learned is None or not pieces:
        return state
    total = history.known[None]
    for piece in pieces.values():
        total = total + piece
    k = history.beams[2][:, : learned.terms]
    k = k * np.array([1.0, learned.length])[: learned.terms]
    here = BeamPosterior(total[:1], k, learned.widest, members)
    both = BeamPosterior(total[1:], k, learned.widest, members)
    mixture = both.mixture(learned.along(here.worst_known()).grid, learned.log_weight)
    mean, covariance = here.conditional(learned.range_error)
    unit = history.unit
    step = ((mixture.mean - mean) * unit).reshape(len(state.locations), -1)
    change = (mixture.covariance - covariance) * np.outer(unit, unit)
    bases = model.tangent_basis(history.beams[1])
    lift = beams_lift(bases, [learned.terms] * len(bases))
    k = state.range_errors.copy()
    k[:, : learned.terms] += step[:, RANGE_ERROR]
    turned = np.einsum("bij,bj->bi", bases, step[:, DIRECTION])
    # The history has other tangents than the state, which has the tangents of a batch solution:
    # project along every beam out of the coordinates (8,).
    across = np.tile(np.eye(8), (len(state.directions), 1, 1))
    across[:, 3:6, 3:6] -= state.directions[:, :, None] * state.directions[:, None, :]
    project = block_diag(*across)
    return replace(
        state,
        locations=state.locations + step[:, LOCATION],
        directions=model.normalized(state.directions + turned),
        range_errors=k,
        covariance=project @ (state.covariance + lift @ change @ lift.T) @ project,
    )
