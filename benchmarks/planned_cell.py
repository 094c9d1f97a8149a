"""The paper's cell with planned stations: what is known before, and what a run through it gives.

Four beams and four planes as in `scenes.paper`, with its errors. Before any reading the mounts are
known to within 3.1 mm and 17 degrees, and the planes to within 2 mm and 2 degrees. The hand's origin
may move by 10 cm along each axis, and turn by 45 degrees to any side, which is how far the incidences
of the paper's own motion go; beams meet the planes at 60 degrees of incidence at most.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.planning.bounds import tilted
from handlaser_gtsam.planning.route import VIA
from handlaser_gtsam.validation.scenes import ERRORS, SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, Stations, plane_name, simulate

BASE = np.array([0.6, 0.1, 0.4])
"""About which the planes stand [m]."""
CIRCLE = 0.015
"""Radius on which the beams start [m]."""
SENSOR = hl.Sensor(0.0, 0.030, math.radians(60.0))
LARGEST_TURN = math.radians(45.0)
WITHIN, TILT = 0.002, math.radians(2.0)
"""How well a plane is known before any reading [m], [rad]."""
ROOM = 0.1
"""How far the hand's origin may move along each axis [m]."""
ERR = ERRORS["paper"]


@dataclass(frozen=True, slots=True)
class Cell:
    """A simulated robot: true beams and planes, and what is known of them before any reading.

    Attributes
    ----------
    truth : Parameters
    bounds : Bounds
        Of the mounts, before the first plane.
    plates : tuple of Plate
        Where all planes roughly are.
    errors : Errors
    """

    truth: hl.Parameters
    bounds: hl.planning.Bounds
    plates: tuple[hl.planning.Plate, ...]
    errors: Errors = ERR

    @property
    def workspace(self) -> hl.planning.Workspace:
        """Where the hand may go."""
        return hl.planning.Workspace(BASE - ROOM, BASE + ROOM, np.eye(3), LARGEST_TURN)

    @property
    def noise(self) -> hl.Noise:
        """What the errors are stated to be."""
        return self.errors.stated()

    def unread(self, recording: hl.Recording) -> dict[str, hl.planning.Plate]:
        """Return where the planes stand of which nothing was read yet."""
        named = zip(PLANES, self.plates, strict=False)
        return {name: one for name, one in named if name not in recording.plane_names}

    def measured(
        self, plan: hl.planning.Plan, rng: np.random.Generator, first: int = 0
    ) -> hl.Recording:
        """Return what the sensors read at the stations of a plan, named from `first` on."""
        stations = plan.stations
        names = stations.station_names
        rows = [j for j, name in enumerate(names) if not name.startswith(VIA)]
        index = [PLANES.index(stations.plane_labels[j]) for j in rows]
        poses = Stations(stations.world_R_hand[rows], stations.world_t_hand[rows], np.array(index))
        seen = sorted(set(index))
        truth = replace(
            self.truth,
            normals=self.truth.normals[seen],
            offsets=self.truth.offsets[seen],
        )
        poses = replace(poses, plane=np.searchsorted(seen, poses.plane))
        read = simulate(truth, poses, self.errors, rng, SENSOR)
        return replace(
            read,
            plane_labels=tuple(stations.plane_labels[j] for j in rows),
            station_names=tuple(str(first + j + 1) for j in range(len(rows))),
        )


PLANES = tuple(plane_name(p) for p in range(26))


def cell(rng: np.random.Generator, planes: int = 4, errors: Errors = ERR) -> Cell:
    """Return a cell with random mounts and planes."""
    truth, _ = SCENES["paper"](Layout(planes=planes), rng)
    angle = 2.0 * np.pi * (np.arange(4) + 0.5) / 4
    nominal = CIRCLE * np.stack((np.cos(angle), np.sin(angle), np.zeros(4)), axis=1)
    axes = tilted(truth.normals, TILT, rng)
    plates = []
    for n, b, axis in zip(truth.normals, truth.offsets, axes, strict=True):
        foot = BASE - (n @ BASE + b) * n
        plates.append(
            hl.planning.Plate(foot + rng.uniform(-WITHIN, WITHIN) * n, axis, WITHIN, TILT)
        )
    ahead = np.tile([0.0, 0.0, 1.0], (4, 1))
    bounds = hl.planning.Bounds(nominal, ahead, plates[0], 0.2 * CIRCLE + 1e-4, math.radians(17.0))
    return Cell(truth, bounds, tuple(plates), errors)


def errors_of(found: hl.Calibration, truth: hl.Parameters) -> tuple[FloatArray, FloatArray]:
    """Return the squared errors of the locations [m^2] and of the directions [rad^2] (B,)."""
    at = found.parameters()
    turn = np.linalg.norm(np.cross(at.directions, truth.directions), axis=1)
    return ((at.locations - truth.locations) ** 2).sum(axis=1), turn**2
