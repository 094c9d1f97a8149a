"""ToF arrays and depth cameras: ranges along known directions from one point."""

import numpy as np

from ...arrays import FloatArray
from .fans import Rayset


def zone_rays(across: FloatArray) -> Rayset:
    """Return the rays of directions (n, 3); their scale multiplies the tangents x/z, y/z."""
    u = across / np.linalg.norm(across, axis=1)[:, None]
    # Unit vector of (x c, y c, z): its derivative by c is across u.
    aside = np.column_stack((u[:, :2], np.zeros(len(u))))
    turning = aside - u * (aside * u).sum(axis=1)[:, None]
    nothing = np.zeros_like(u)
    return Rayset(nothing, u, nothing, turning)
