"""The mathematics in NumPy, without GTSAM: equation, geometry, weights, losses."""

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
)
from .geometry import means_and_scatter, normalized, plane_through, spots, tangent_basis

__all__ = [
    "GRAZING_LIMIT",
    "LEAST_FACTOR",
    "MOST_FACTOR",
    "Linearization",
    "Scene",
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
    "scene",
    "spots",
    "tangent_basis",
]
