"""What goes into an incremental graph with a plane, and what is known of the beams then."""

from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Beams
from ..factors import RangeBlock
from ..model.families import BEAM


@dataclass(frozen=True, slots=True)
class BeamState:
    """Beams of a session with their covariance.

    Attributes
    ----------
    locations, directions : (B, 3)
    range_errors : (B, 2)
    covariance : (8 B, 8 B)
        Ambient, over (x, y, z, vx, vy, vz, k1, k2) of every beam.
    information : float
        Logarithm of the determinant of the tangent information [nats], up to the units.
    """

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    covariance: FloatArray
    information: float

    @property
    def beams(self) -> Beams:
        """The estimate without its covariance."""
        return self.locations, self.directions, self.range_errors

    def sigmas(self) -> FloatArray:
        """Return the standard deviations (B, 8)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, BEAM.size)

    def apart(self, beams: Beams, sigmas: FloatArray) -> tuple[float, float]:
        """Return how far another estimate is: largest difference of a coordinate and of a sigma.

        Parameters
        ----------
        beams : Beams
        sigmas : (B, 8)
            Standard deviations of that estimate: the unit of the first number; the second is relative.
        """
        seen = sigmas > 0.0
        difference = np.abs(np.hstack(self.beams) - np.hstack(beams))[seen] / sigmas[seen]
        relative = np.abs(self.sigmas()[seen] / sigmas[seen] - 1.0)
        return float(difference.max()), float(relative.max())


@dataclass(frozen=True, slots=True)
class GraphPart:
    """What one plane brings into the graph, or what the beams bring that begin it.

    Attributes
    ----------
    blocks : RangeBlocks
        Each with a whitening; none of the beams.
    others : factors
        Priors of the hand poses of a plane; links of the beams.
    start : gtsam.Values
        Start of its variables; variables that are in the graph already keep their values.
    """

    blocks: tuple[RangeBlock, ...]
    others: tuple[gtsam.NonlinearFactor, ...]
    start: gtsam.Values
