"""GTSAM factors of hand-mounted range beams, for any graph with any keys."""

from .beam_drift import beam_drift
from .block import RangeBlock, range_factor, require_rows
from .keys import BeamKeys
from .of_blocks import BlockGraph, graph_of_blocks
from .range_error_prior import range_error_prior
from .range_to_plane import range_to_plane
from .range_to_plane_from_pose import range_to_plane_from_pose
from .shared import Evaluation, SharedEvaluation, evaluated_together

__all__ = [
    "BeamKeys",
    "BlockGraph",
    "Evaluation",
    "RangeBlock",
    "SharedEvaluation",
    "beam_drift",
    "evaluated_together",
    "graph_of_blocks",
    "range_error_prior",
    "range_factor",
    "range_to_plane",
    "range_to_plane_from_pose",
    "require_rows",
]
