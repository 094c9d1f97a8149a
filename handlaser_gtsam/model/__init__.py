"""The mathematics in NumPy, without GTSAM: equation, geometry, weights, losses, distributions."""

from .equation import (
    GRAZING_LIMIT,
    LEAST_FACTOR,
    MOST_FACTOR,
    Linearization,
    Scene,
    corrected,
    cosines,
    linearize,
    plausible_corrections,
    plausible_range_errors,
    predicted_ranges,
    range_error_derivatives,
    residuals,
    residuals_or_infinite,
    scene,
    tangent_columns,
)
from .geometry import (
    means_and_scatter,
    normalized,
    plane_through,
    rotation_cells,
    spots,
    tangent_basis,
)
from .joint import JointCovariance
from .losses import Loss
from .sensor import Rejected
from .weighting import Variances, Whitening, whitening

__all__ = [
    "GRAZING_LIMIT",
    "LEAST_FACTOR",
    "MOST_FACTOR",
    "JointCovariance",
    "Linearization",
    "Loss",
    "Rejected",
    "Scene",
    "Variances",
    "Whitening",
    "corrected",
    "cosines",
    "linearize",
    "means_and_scatter",
    "normalized",
    "plane_through",
    "plausible_corrections",
    "plausible_range_errors",
    "predicted_ranges",
    "range_error_derivatives",
    "residuals",
    "residuals_or_infinite",
    "rotation_cells",
    "scene",
    "spots",
    "tangent_basis",
    "tangent_columns",
    "whitening",
]
