"""GTSAM factors of hand-mounted range beams, for any graph with any keys."""

from handlaser_gtsam.keys import BeamKeys

from .block import RangeBlock, range_factor
from .evaluation import Evaluation
from .range_to_plane import range_to_plane
from .range_to_plane_from_pose import range_to_plane_from_pose
from .shared import SharedEvaluation

__all__ = [
    "BeamKeys",
    "Evaluation",
    "RangeBlock",
    "SharedEvaluation",
    "range_factor",
    "range_to_plane",
    "range_to_plane_from_pose",
]
