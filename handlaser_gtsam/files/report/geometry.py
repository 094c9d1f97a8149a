"""What there is to draw in space: planes, beams with their spots, and the hand at its stations; mm."""

from dataclasses import dataclass

import numpy as np

from ... import model
from ...arrays import FloatArray
from ...data.parameters import Beams
from ...quantities import IN_MM
from .figure import MOST_POINTS, MOST_SHAPES, evenly, short
from .subject import ReadingRows, Subject

PLANE_SIZE = 1.15
"""The size of a plane that is drawn, in sizes of what its spots take up: they stand clear of its
edge."""
AXIS_SIZE = 0.05
"""Length of the axes of a hand, as a part of the extent of the picture: many hands do not cover it."""


Segments = tuple[str, FloatArray, tuple[str, ...]]
"""A beam from the sensor to its spots: its name, segments (N, 2, 3) [mm], and what each of them is."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """A picture in space, in one frame.

    Attributes
    ----------
    frame : str
        `world` or `hand`.
    planes : tuple of (str, (4, 3))
        Name and corners of every plane [mm].
    beams : tuple of Segments
    hands : (M, 4, 3)
        Origin of the hand and the ends of its x, y and z axis [mm].
    hand_names : tuple of str
    """

    frame: str
    planes: tuple[tuple[str, FloatArray], ...]
    beams: tuple[Segments, ...]
    hands: FloatArray
    hand_names: tuple[str, ...]

    @property
    def points(self) -> FloatArray:
        """Everything that is drawn (N, 3)."""
        parts = [corners for _, corners in self.planes] + [self.hands.reshape(-1, 3)]
        parts += [segments.reshape(-1, 3) for _, segments, _ in self.beams]
        return np.concatenate(parts)


def in_world(subject: Subject) -> Geometry | None:
    """Return stations, beams, spots and planes in the world frame; None without a recording.

    Where there is no calibration, only the stations are known.
    """
    rows = subject.rows
    if rows is None:
        return None
    recording = rows.recording
    R, t = recording.world_R_hand, recording.world_t_hand * IN_MM
    shown = evenly(len(t), MOST_POINTS)
    beams: tuple[Segments, ...] = ()
    planes: tuple[tuple[str, FloatArray], ...] = ()
    everything = t
    if subject.solved:
        beams, planes = _beams(subject, rows), _planes(subject, rows)
        everything = np.concatenate((t, rows.spot * IN_MM))
    length = AXIS_SIZE * max(float(np.ptp(everything, axis=0).max()), 1.0)
    ends = t[shown, None, :] + length * np.swapaxes(R[shown], 1, 2)
    names = tuple(
        f"station {short(recording.station_names[j])}, plane {short(recording.plane_labels[j])}"
        for j in shown.tolist()
    )
    return Geometry("world", planes, beams, np.concatenate((t[shown, None], ends), axis=1), names)


def in_hand(subject: Subject) -> Geometry | None:
    """Return the beams in the hand frame, as far as they read; None where there is no calibration."""
    calibration, rows = subject.calibration, subject.rows
    if not subject.solved:
        return None
    reach = np.full(len(calibration.beams), calibration.fit.typical_range)
    if rows is not None:
        np.maximum.at(reach, rows.beam, rows.reading)
    return of_hand(tuple(calibration.beams), calibration.parameters().beams, reach)


def of_hand(names: tuple[str, ...], beams: Beams, reach: FloatArray) -> Geometry | None:
    """Return beams (r, v, k) up to readings `reach` (B,) [m]; None where these are not known."""
    if not np.isfinite(reach).all():
        return None
    r, v, k = beams
    ends = np.stack((r, r + model.corrected(reach, k)[:, None] * v), axis=1) * IN_MM
    extent = np.ptp(np.concatenate((ends.reshape(-1, 3), np.zeros((1, 3)))), axis=0)
    length = 4.0 * AXIS_SIZE * max(float(extent.max()), 1.0)
    hand = np.concatenate((np.zeros((1, 3)), length * np.eye(3)))
    drawn = zip(names, ends[:, None], ((f"beam {short(name)}",) for name in names), strict=True)
    return Geometry("hand", (), tuple(drawn), hand[None], ("the hand",))


def _beams(subject: Subject, rows: ReadingRows) -> tuple[Segments, ...]:
    calibration, recording = subject.calibration, rows.recording
    used = np.flatnonzero(rows.used)
    used = used[evenly(len(used), MOST_POINTS)]
    found = []
    for index, beam in enumerate(calibration.beams.values()):
        mine = used[rows.beam[used] == index]
        R = recording.world_R_hand[rows.station[mine]]
        start = R @ beam.location + recording.world_t_hand[rows.station[mine]]
        words = tuple(
            f"beam {short(beam.name)}, station {short(recording.station_names[j])}, "
            f"plane {short(recording.plane_labels[j])}, reading {d * IN_MM:.3f} mm"
            for j, d in zip(rows.station[mine].tolist(), rows.reading[mine].tolist(), strict=True)
        )
        found.append((beam.name, np.stack((start, rows.spot[mine]), axis=1) * IN_MM, words))
    return tuple(found)


def _planes(subject: Subject, rows: ReadingRows) -> tuple[tuple[str, FloatArray], ...]:
    """Return a rectangle around the spots of every plane."""
    recording = rows.recording
    found = []
    for index, plane in enumerate(list(subject.calibration.planes.values())[:MOST_SHAPES]):
        spots = rows.spot[rows.used & (recording.plane_of_station[rows.station] == index)]
        if not len(spots):
            continue
        on = spots - (spots @ plane.normal + plane.offset)[:, None] * plane.normal
        found.append((plane.name, plate(plane.normal, on)))
    return tuple(found)


def plate(n: FloatArray, on: FloatArray) -> FloatArray:
    """Return the corners (4, 3) [mm] of a rectangle around points (N, 3) [m] of a plane."""
    middle = on.mean(axis=0)
    axes = np.linalg.svd(on - middle, full_matrices=len(on) < 3)[2][:2] if len(on) > 2 else None
    basis = model.tangent_basis(n[None])[0].T if axes is None else axes
    basis = basis - (basis @ n)[:, None] * n
    flat = (on - middle) @ basis.T
    low, high = PLANE_SIZE * flat.min(axis=0), PLANE_SIZE * flat.max(axis=0)
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.asarray((middle + np.array(corners) @ basis) * IN_MM)
