"""Solvers: the factor graph, Levenberg-Marquardt and iSAM2 on it, and SciPy as reference."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..model.damped_search import LevenbergOptions as LevenbergOptions
    from ..progress import Progress as Progress
    from ..progress import Trial as Trial
    from .graph import CalibrationGraph as CalibrationGraph
    from .graph import PosePriors as PosePriors
    from .graph import build_graph as build_graph
    from .graph import pose_priors as pose_priors
    from .graph import read_parameters as read_parameters
    from .graph_levenberg import LevenbergResult as LevenbergResult
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
