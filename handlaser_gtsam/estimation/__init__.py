"""The joint estimate: unknown scales of noise and range errors, learned and integrated over."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..solvers.beam_problem import SolvedMany as SolvedMany
    from .estimate import BlockProblem as BlockProblem
    from .estimate import Estimate as Estimate
    from .estimate import TestedEffect as TestedEffect
    from .estimate import kept_blocks as kept_blocks
    from .estimate import score_test as score_test
    from .learning_scales import LearnedScales as LearnedScales
    from .many_recordings import solve_many as solve_many
    from .scale_mixture import RangeErrorGrid as RangeErrorGrid
    from .scales import Scale as Scale
    from .scales import Scales as Scales
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
