"""Units that people read and write, and the few bounds that many calculations share.

Inside everything is in SI units: m, rad, s. x * MM is in metres where x is in millimetres, and
x * IN_MM in millimetres where x is in metres.
"""

import math

MM = 1e-3
"""A millimetre [m]."""
INCH = 0.0254
"""An inch [m]."""
DEG = math.pi / 180.0
"""A degree [rad]."""
IN_MM = 1e3
"""A metre in millimetres."""
IN_DEG = 180.0 / math.pi
"""A radian in degrees."""
IN_PERCENT = 100.0
"""The whole in percent."""
KNOWN = 0.1
"""What has a standard deviation above this part of its natural unit is undetermined: of the range for a
length, of 1 for a direction."""
WIDEST_CONE = math.pi / 3.0
"""No ultrasonic sensor hears farther from its axis [rad]."""
MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian over the median of its absolute values."""
TEN_TIMES = 10.0
"""A noise ten times what was stated or is expected is no noise, but a mistake such as a wrong unit."""
NO_GROWTH = 1.02
"""No digit that is shown of a standard deviation changes by a smaller factor."""
MANY_OUTLIERS = 0.1
"""More outliers than this part of the readings are no accident, but have a cause."""
MAJORITY = 0.6
"""A clear majority: a bare one may agree by chance."""

TINY = 1e-300
"""A divisor or the argument of a logarithm is at least this, so that the result stays finite."""
SINGULAR = 1e-12
"""An eigenvalue or a diagonal entry below this part of the largest is rounding and counts as zero."""
ROUNDING = 1e-9
"""A part below this is the rounding that long sums and solved systems leave of double precision."""
NEGLIGIBLE = 1e-6
"""A part below this counts for nothing: it is above rounding, and no estimate is known so well."""
RESOLUTION = 1e-10
"""Changes of a cost, or of a shape, below this part of it are rounding, not evidence."""
EXACT = 1e-11
"""Residuals below this part of the readings are taken as rounding: the noise cannot be learned then."""
UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights readings where nothing is known of it, as where they fit exactly."""
REPRESENTATIVE_BEAMS = 30
"""Beams, evenly chosen, that stand for more of them: time grows with their third power."""
LARGEST_LENGTH = 1e6
"""No robot reaches farther, and no sensor is worse [m]: squares of larger numbers lose every digit."""
LARGEST_NUMBER = 1e12
"""Larger numbers [m, 1/m, 1] are refused: positions on Earth are smaller, and squares stay finite."""
NUMBERS_AT_ONCE = 4_000_000
"""Numbers of the largest intermediate array, 32 MB: a batch that needs more is cut."""
ROWS_AT_ONCE = 20_000
"""Rows of readings that are evaluated in one batch: more would leave the processor's cache."""
MOST_ROUNDS = 20
"""Rounds at most of an iteration that ends by itself, mostly within a few, when nothing changes."""
SAME_OPTIMUM = 0.01
"""Two solutions within this many standard deviations, and their sigmas within this part, are one."""
ROUGH_CUT = 4.5
"""A new reading, or a point of a shot, further off by more standard deviations is an outlier: of good
ones, if Gaussian, one in 150,000 is."""
FAR_SIGMAS = 4.0
"""A deviation by more standard deviations is no accident: good recordings have one in 16,000."""
POWER = 0.8
"""Probability with which an error of the detectable size is found: the usual one in reliability
theory."""
