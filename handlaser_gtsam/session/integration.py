r"""Unknown scales in a session, integrated over as in the batch solution.

Every plane is remembered by what it says of the beams for each set of noise scales
(`estimation.information`), counted from beams that all share. The graph holds the most probable scales;
what integrating over all of them changes in mean and covariance follows from the sums over the planes,
and is added to what iSAM2 has. So a new plane costs what one plane costs.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Beams
from ..estimation.information import Information, LinearReadings
from ..estimation.learned import LearnedScales
from ..estimation.mixture import BeamPosterior
from ..model.joint import beams_lift
from ..solvers.beam_state import BeamState
from .config import SessionConfig
from .fitted import FittedPlane
from .reference import Reference, turns


@dataclass(frozen=True, slots=True)
class ScaleSums:
    """What all planes of a session say of the beams, for all sets of noise scales.

    Attributes
    ----------
    learned : LearnedScales
    reference : Reference
        Beams that everything is counted from.
    members : (b,)
        Beams whose range errors have the prior.
    known : Information
        Of the beams, beside the planes.
    pieces : mapping of str to Information
        By plane.
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

    def with_plane(self, plane: str, fitted: FittedPlane) -> "ScaleSums":
        """Return the sums with a plane, in place of what was known of it."""
        learned, readings = self.learned, fitted.readings
        variances = learned.base.for_stations(int(readings.station.max()) + 1)
        rows = LinearReadings(fitted.at, readings, learned.terms, learned.length, variances)
        points = [learned.mode, *learned.points]
        found, _ = rows.information([learned.scales.noise(u) for u in points])
        turn = turns(fitted.at.directions, self.reference)
        shift = self.reference.coordinates(fitted.at.beams)
        counted = _counted_from(found, turn, shift)
        return replace(self, pieces={**self.pieces, plane: counted})

    def changed(self, fitted: Mapping[str, FittedPlane], inside: Collection[str]) -> "ScaleSums":
        """Return the sums of the planes that are `inside`, of which some have been fitted anew."""
        kept = {plane: one for plane, one in self.pieces.items() if plane in inside}
        found = replace(self, pieces=kept)
        for plane, one in fitted.items():
            found = found.with_plane(plane, one)
        return found

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
        # The reference has other tangents than the state, of which those of a batch solution are.
        across = block_diag(*(_across(v) for v in state.directions))
        return replace(
            state,
            locations=state.locations + step[:, :3],
            directions=model.normalized(state.directions + turned),
            range_errors=k,
            covariance=across @ (state.covariance + lift @ change @ lift.T) @ across,
        )


def _across(direction: FloatArray) -> FloatArray:
    """Return the projector (8, 8) of the coordinates of a beam that takes out what is along it."""
    projector = np.eye(8)
    projector[3:6, 3:6] -= np.outer(direction, direction)
    return projector


def _counted_from(found: Information, turn: FloatArray, shift: FloatArray) -> Information:
    """Return information counted from a reference: unknowns here are turn (x - shift)."""
    matrix = turn.T @ found.matrix @ turn
    vector = found.vector @ turn
    constant = found.constant - vector @ shift - 0.5 * (matrix @ shift) @ shift
    return Information(matrix, vector + matrix @ shift, constant)
