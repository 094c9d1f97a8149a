"""What could go unnoticed of every member of a family of systematic errors (Baarda)."""

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.weighting import Whitening
from .score_tests import ScoreTests


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """What could go unnoticed of every member of a family.

    Attributes
    ----------
    plane, beam, position : (m,)
        What each member concerns: a plane, a beam, and the position in the recording of its first
        station; -1 for all.
    determined : (m,) of bool
    size, sigma : (m,)
        Estimated sizes and their standard deviations; meaningless where not determined.
    p_value : (m,)
        Corrected for all members of all families.
    detectable : (m,)
        Infinite where not determined.
    location_shift, direction_shift : (m, B, 3)
        How wrong r [m] and v [rad] of every beam would be at the detectable size; NaN where not
        determined.
    """

    plane: IntArray
    beam: IntArray
    position: IntArray
    determined: BoolArray
    size: FloatArray
    sigma: FloatArray
    p_value: FloatArray
    detectable: FloatArray
    location_shift: FloatArray
    direction_shift: FloatArray


def detectable_of(
    code: str,
    at: Parameters,
    readings: Readings,
    how: Whitening,
    prior: FloatArray,
    position: IntArray,
    *,
    known: bool,
    dof: int,
) -> Reliability:
    """Return what could go unnoticed of every member of the family `code`.

    The arguments are those of `systematic_errors`. The displacement of plane p from the station at
    position j on is the member with `plane == p` and `position == j`.
    """
    found = ScoreTests(at, readings, how, prior, position, None if known else dof)
    members = np.flatnonzero(found.members.codes == code)
    return Reliability(
        found.members.plane[members],
        found.members.beam[members],
        found.members.position[members],
        found.determined[members],
        found.size[members],
        found.sigma[members],
        found.p[members],
        found.detectable[members],
        *found.shifts(members, found.detectable[members]),
    )
