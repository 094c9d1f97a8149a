"""Units that people read and write. Inside everything is in SI units: m, rad, s.

x * MM is in metres where x is in millimetres, and x * IN_MM in millimetres where x is in metres.
"""

import math

MM, INCH, DEG = 1e-3, 0.0254, math.pi / 180.0
"""A millimetre and an inch [m], and a degree [rad]."""
IN_MM, IN_DEG = 1e3, 180.0 / math.pi
"""A metre in millimetres, and a radian in degrees."""
KNOWN = 0.1
"""What is known worse than to this part of its natural unit, the range or 1, is not determined."""
MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian over the median of its absolute values."""
