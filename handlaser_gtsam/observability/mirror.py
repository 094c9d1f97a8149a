r"""Whether the mirror image of a solution fits as well.

Where the hand does not move between the stations of a plane but only turns, the point reflection of
every beam and plane through the hand's position predicts the same readings:

    (r, v, n, b)  ->  (-r, -v, -n, b + 2 n . t)   leaves   s = -(n_H . r + b_H) / (n_H . v)

No local analysis of rank can see that: both solutions are determined, and one of them is wrong.
"""

import numpy as np

from ..data.parameters import Parameters
from ..data.recording import Readings
from ..solvers.refine import refine

CHI2_MARGIN = 25.0
"""An image within this of the solution's chi2 (five standard deviations) cannot be ruled out."""


def mirror_image_fits(
    solution: Parameters, readings: Readings, squares: float, range_sigma: float
) -> bool:
    """Tell whether the image of `solution` fits within `CHI2_MARGIN` of its sum of squares [m^2].

    Range errors stay as they are: k1 = -2 would turn every reading, and any image, around.
    """
    image = refine(_image(solution, readings), readings, terms=0, iterations=20)
    if image is None:
        return False
    found = image.parameters.directions
    same_side = np.einsum("bi,bi->b", found, solution.directions) > 0.0
    worse = image.squares - squares
    return not same_side.any() and worse <= CHI2_MARGIN * range_sigma**2


def _image(solution: Parameters, readings: Readings) -> Parameters:
    """Return the beams and planes reflected through the mean hand position of each plane."""
    middle = readings.plane_means(readings.world_t_hand)
    return Parameters(
        -solution.locations,
        -solution.directions,
        solution.range_errors,
        -solution.normals,
        solution.offsets + 2.0 * np.einsum("pi,pi->p", solution.normals, middle),
    )
