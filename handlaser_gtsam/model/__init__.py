"""The mathematics in NumPy, without GTSAM: blocks, their reduction and search, weights, losses."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .equation import GRAZING_LIMIT as GRAZING_LIMIT
    from .equation import LEAST_FACTOR as LEAST_FACTOR
    from .equation import MOST_FACTOR as MOST_FACTOR
    from .equation import Linearization as Linearization
    from .equation import Scene as Scene
    from .equation import corrected as corrected
    from .equation import cosines as cosines
    from .equation import linearize as linearize
    from .equation import plausible_corrections as plausible_corrections
    from .equation import plausible_range_errors as plausible_range_errors
    from .equation import predicted_ranges as predicted_ranges
    from .equation import range_error_derivatives as range_error_derivatives
    from .equation import residuals as residuals
    from .equation import residuals_or_infinite as residuals_or_infinite
    from .equation import scene as scene
    from .equation import tangent_columns as tangent_columns
    from .geometry import means_and_scatter as means_and_scatter
    from .geometry import normalized as normalized
    from .geometry import plane_through as plane_through
    from .geometry import rotation_cells as rotation_cells
    from .geometry import spots as spots
    from .geometry import tangent_basis as tangent_basis
    from .joint import JointCovariance as JointCovariance
    from .losses import Loss as Loss
    from .sensor_limits import Rejected as Rejected
    from .weighting import Variances as Variances
    from .weighting import Whitening as Whitening
    from .weighting import whitening as whitening
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
