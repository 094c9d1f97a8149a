"""Would the file fit if it were read another way? Asked only where it does not fit as it stands.

Each hypothesis is a mistake that people make when they write poses and ranges to a file. The recording
is changed as if the mistake were undone, a start is found, and the residuals are compared. The result
is a sentence for the user, never a change of the data.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ..data.ordering import sorted_readings
from ..data.recording import LARGEST, Recording
from ..errors import InputError
from ..starts import Effort, find_start

MUCH_BETTER = 100.0
"""A hypothesis is worth a word when it lowers the mean squared residual by this factor."""
PROMISING = 9.0
"""And it is tried in earnest when it does so by this factor at a glance."""
SPARE = 15
"""So many readings of one beam more than unknowns tell a mistake from a chance fit."""
DEGREE = np.pi / 180.0
MOST_SWAPS = 40
GROUPS = 4
"""Planes are left out in so many groups to find the one before which beams look swapped."""
Numbers = Literal["vector", "xyz", "XYZ", "ZYX"]
"""Three numbers of a rotation: its vector, or angles of a sequence in SciPy's spelling, in lower case
about fixed axes and in upper case about moving ones."""


Undone = Callable[[Recording], Recording]
"""Returns a recording as it would be without a mistake."""


def better_ways(recording: Recording, terms: int) -> tuple[str, ...]:
    """Say how else the file could be read so that it fits a hundredfold better, the best first.

    Parameters
    ----------
    recording : Recording
    terms : int
        Most range-error terms.
    """
    mistakes = [*_promising(recording, terms), *_swaps(recording, terms)]
    if not mistakes:
        return ()
    now, found = misfit(recording, terms, "normal"), []
    for words, undone, effort in mistakes:
        ratio = now / max(misfit(undone(recording), terms, effort), 1e-30)
        if ratio >= MUCH_BETTER:
            found.append((ratio, words))
    return tuple(
        f"{words}: read so, the readings fit {min(np.sqrt(ratio), 1e6):.0f} times better"
        for ratio, words in sorted(found, reverse=True)
    )


def _promising(recording: Recording, terms: int) -> Iterator[tuple[str, Undone, Effort]]:
    """Yield the mistakes of the poses or the units without which one beam fits far better.

    Such a mistake is the same for all beams, and one beam is the smallest problem that shows it.
    """
    one = _one_beam(recording)
    now = misfit(one, terms, "glance")
    for words, undone in HYPOTHESES.items():
        if now >= PROMISING * misfit(undone(one), terms, "glance"):
            yield words, undone, "normal"


def _one_beam(recording: Recording) -> Recording:
    """Return the readings of the beam with most of them, where they suffice."""
    seen = ~np.isnan(recording.ranges)
    beam = int(np.argmax(seen.sum(axis=0)))
    planes = len(set(recording.plane_of_station[seen[:, beam]].tolist()))
    if seen[:, beam].sum() < 7 + 3 * planes + SPARE:
        return recording
    others = np.ones(seen.shape, dtype=bool)
    others[:, beam] = False
    return recording.without(others).part(seen[:, beam])


def _swaps(recording: Recording, terms: int) -> Iterator[tuple[str, Undone, Effort]]:
    """Two beams exchanged before one plane; exchanged everywhere they would only change names.

    Without that plane the others fit far better, and their beams tell which two were exchanged.
    """
    beams, planes = recording.beam_names, len(recording.plane_names)
    pairs = list(combinations(range(len(beams)), 2))
    if planes < 2 or not 0 < planes * len(pairs) <= MOST_SWAPS:
        return
    now = misfit(recording, terms, "glance")
    for group in range(min(GROUPS, planes)):
        out = np.arange(planes) % GROUPS == group
        try:
            rest = recording.part(~out[recording.plane_of_station])
        except InputError:
            continue
        if rest.beam_names != beams or now < PROMISING * misfit(rest, terms, "glance"):
            continue
        for plane, (i, j) in product(np.flatnonzero(out).tolist(), pairs):
            name = recording.plane_names[plane]
            words = (
                f"the readings of beams {beams[i]} and {beams[j]} look swapped before plane {name}"
            )
            yield words, partial(_swapped, plane=plane, i=i, j=j), "quick"


def _swapped(recording: Recording, plane: int, i: int, j: int) -> Recording:
    ranges, rows = recording.ranges.copy(), recording.plane_of_station == plane
    ranges[rows, i], ranges[rows, j] = recording.ranges[rows, j], recording.ranges[rows, i]
    return replace(recording, ranges=ranges)


def misfit(recording: Recording, terms: int, effort: Effort) -> float:
    """Return the mean squared residual in parts of the variance of the readings: no unit matters."""
    readings, _ = sorted_readings(recording)
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    rms = find_start(readings, None, terms, effort=effort).tried[0][1]
    return float(rms**2) / max(float(np.nanvar(recording.ranges)), 1e-300)


def _turned(change: Callable[[Rotation], Rotation]) -> Undone:
    def undone(recording: Recording) -> Recording:
        R = change(Rotation.from_matrix(recording.world_R_hand)).as_matrix()
        return replace(recording, world_R_hand=R)

    return undone


def _inverted(recording: Recording) -> Recording:
    R = np.swapaxes(recording.world_R_hand, 1, 2)
    t = -np.einsum("mij,mj->mi", R, recording.world_t_hand)
    return replace(recording, world_R_hand=R, world_t_hand=t)


def _scaled(positions: float, ranges: float) -> Undone:
    def undone(recording: Recording) -> Recording:
        t, d = positions * recording.world_t_hand, ranges * recording.ranges
        if np.abs(t).max() > LARGEST or np.nanmax(d) > LARGEST:
            return recording
        return replace(recording, world_t_hand=t, ranges=d)

    return undone


def _scalar_first(rotation: Rotation) -> Rotation:
    q = rotation.as_quat()
    return Rotation.from_quat(np.column_stack((q[:, 1:], q[:, :1])))


def _numbers(written: Numbers, read: Numbers, factor: float = 1.0) -> Undone:
    """Undo that three numbers were `read` as another thing than `written`, or without a `factor`."""

    def change(rotation: Rotation) -> Rotation:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of gimbal lock: another hypothesis, or none, will fit
            found = rotation.as_rotvec() if read == "vector" else rotation.as_euler(read)
        if written == "vector":
            return Rotation.from_rotvec(factor * found)
        return Rotation.from_euler(written, factor * found)

    return _turned(change)


HYPOTHESES: dict[str, Undone] = {
    "the poses look inverted (hand_T_world instead of world_T_hand)": _inverted,
    "the rotations look inverted (hand_R_world instead of world_R_hand)": _turned(Rotation.inv),
    "the quaternions look like qw qx qy qz written as qx qy qz qw": _turned(_scalar_first),
    "the positions look like millimetres": _scaled(1e-3, 1.0),
    "the ranges look like millimetres": _scaled(1.0, 1e-3),
    "the rotation vectors look like degrees taken as radians": _numbers("vector", "vector", DEGREE),
    "the angles about x, y, z look like degrees taken as radians": _numbers("xyz", "xyz", DEGREE),
    "the rotation vectors look like radians taken as degrees": _numbers(
        "vector", "vector", 1.0 / DEGREE
    ),
    "the angles about x, y, z look like radians taken as degrees": _numbers(
        "xyz", "xyz", 1.0 / DEGREE
    ),
    "the first and the third angle look exchanged (KUKA A B C read as FANUC W P R, or so)": _numbers(
        "ZYX", "xyz"
    ),
    "the angles of fixed axes x, y, z look as if read as those of moving axes": _numbers(
        "xyz", "XYZ"
    ),
    "the angles of moving axes x, y, z look as if read as those of fixed axes": _numbers(
        "XYZ", "xyz"
    ),
    "the rotation vectors look as if read as angles about x, y, z": _numbers("vector", "xyz"),
}
"""Mistakes in words, and what undoes them."""
