r"""Unknown scales in a session, integrated over as in the batch solution.

Every plane is remembered by its information on the beams for each set of noise scales
(`estimation.information`), counted from beams that all share. The graph holds the most probable scales.
Integrating over all scales changes mean and covariance; both changes follow from the sums over the
planes, and are added to the estimate of iSAM2. So the cost of a new plane does not grow.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..arrays import IntArray
from ..data.parameters import Beams
from ..estimation.information import Information, LinearReadings
from ..estimation.learned import LearnedScales
from ..estimation.mixture import BeamPosterior
from ..model.joint import beams_lift
from ..solvers.beam_state import BeamState
from .config import SessionConfig
from .drift import Reference, turns
from .fitted import FittedPlane


@dataclass(frozen=True, slots=True)
class ScaleSums:
    """The information of all planes of a session on the beams, for all sets of noise scales.

    Attributes
    ----------
    learned : LearnedScales
    reference : Reference
        Beams that everything is counted from.
    members : (b,)
        Beams whose range errors have the prior.
    known : Information
        Information on the beams beside the planes.
    pieces : mapping of str to Information
        Information by plane.
    """

    learned: LearnedScales
    reference: Reference
    members: IntArray
    known: Information
    pieces: Mapping[str, Information]

    @classmethod
    def of(
        cls, config: SessionConfig, beams: Beams, fitted: Mapping[str, FittedPlane]
    ) -> "ScaleSums | None":
        """Return the sums of planes, counted from `beams`; None where no scales are learned."""
        if config.learned is None:
            return None
        history = config.history(beams)
        known, members = history.known[None], config.members  # whatever the noise is
        empty = cls(config.learned, history.reference, members, known, {})
        return empty.changed(fitted, fitted)

    def changed(self, fitted: Mapping[str, FittedPlane], inside: Collection[str]) -> "ScaleSums":
        """Return the sums of the planes that are `inside`, of which some have been fitted again."""
        kept = {plane: piece for plane, piece in self.pieces.items() if plane in inside}
        again = {plane: self._counted(refitted) for plane, refitted in fitted.items()}
        return replace(self, pieces={**kept, **again})

    def _counted(self, fitted: FittedPlane) -> Information:
        """Return the information of a plane, counted from the reference."""
        learned, readings = self.learned, fitted.readings
        variances = learned.base.for_stations(int(readings.station.max()) + 1)
        rows = LinearReadings(fitted.parameters, readings, learned.terms, learned.length, variances)
        points = [learned.mode, *learned.points]
        information, _ = rows.information([learned.scales.noise(u) for u in points])
        # The unknowns there are turn (x - shift).
        turn = turns(fitted.parameters.directions, self.reference)
        shift = self.reference.coordinates(fitted.parameters.beams)
        matrix = turn.T @ information.matrix @ turn
        vector = information.vector @ turn
        constant = information.constant - vector @ shift - 0.5 * (matrix @ shift) @ shift
        return Information(matrix, vector + matrix @ shift, constant)

    def integrated(self, state: BeamState) -> BeamState:
        """Return beams at the most probable scales with all scales integrated over."""
        if not self.pieces:
            return state
        learned, total = self.learned, self.known
        for piece in self.pieces.values():
            total = total + piece
        k = self.reference.beams[2][:, : learned.terms]
        k = k * np.array([1.0, learned.length])[: learned.terms]
        here = BeamPosterior(total[:1], k, learned.widest, self.members)
        both = BeamPosterior(total[1:], k, learned.widest, self.members)
        mixture = both.mixture(learned.along(here.worst_known()).grid, learned.log_weight)
        mean, covariance = here.conditional(learned.range_error)
        unit = self.reference.unit
        step = ((mixture.mean - mean) * unit).reshape(len(state.locations), -1)
        change = (mixture.covariance - covariance) * np.outer(unit, unit)
        bases = model.tangent_basis(self.reference.beams[1])
        lift = beams_lift(bases, [learned.terms] * len(bases))
        k = state.range_errors.copy()
        k[:, : learned.terms] += step[:, 5:]
        turned = np.einsum("bij,bj->bi", bases, step[:, 3:5])
        # The reference has other tangents than the state, which has the tangents of a batch solution:
        # project along every beam out of the coordinates (8,).
        across = np.tile(np.eye(8), (len(state.directions), 1, 1))
        across[:, 3:6, 3:6] -= state.directions[:, :, None] * state.directions[:, None, :]
        project = block_diag(*across)
        return replace(
            state,
            locations=state.locations + step[:, :3],
            directions=model.normalized(state.directions + turned),
            range_errors=k,
            covariance=project @ (state.covariance + lift @ change @ lift.T) @ project,
        )
