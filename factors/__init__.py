"""GTSAM factors of hand-mounted range beams, for any graph with any keys."""

from .beam_drift import beam_drift as beam_drift
from .keys import BeamKeys as BeamKeys
from .of_blocks import BlockGraph as BlockGraph
from .of_blocks import graph_of_blocks as graph_of_blocks
from .poses_of_stop import poses_of_stop as poses_of_stop
from .range_block import RangeBlock as RangeBlock
from .range_block import range_factor as range_factor
from .range_block import require_rows as require_rows
from .range_error_prior import range_error_prior as range_error_prior
from .range_to_plane import range_to_plane as range_to_plane
from .range_to_plane import range_to_plane_from_pose as range_to_plane_from_pose
from .shared_evaluation import Evaluation as Evaluation
from .shared_evaluation import SharedEvaluation as SharedEvaluation
from .shared_evaluation import evaluated_together as evaluated_together
