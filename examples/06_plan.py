"""The closed loop: first motion, calibration, planned motion, update, until the goal is reached.

Four sensors of 0 to 30 mm look at one plate. What is known at first stands in a rig file: where the
drawings say that the sensors are, and where the plate lies roughly. The robot is simulated; where
`measure` stands, yours drives to the stations and reads.
"""

import math
from pathlib import Path

import numpy as np

import handlaser_gtsam as hl
from handlaser_gtsam.validation.simulate import Errors, Stations, simulate

rig = hl.read_rig(Path(__file__).parent / "planned" / "rig.toml")
errors = Errors(1e-5, 2e-5, math.radians(0.01))  # of the robot and the sensors that are simulated
rng = np.random.default_rng(2)
truth = rig.bounds.draw(rng)  # mounts and plate as they really are, somewhere within the bounds


def measure(stations: hl.StationList, taken: int) -> hl.Recording:
    """Drive to the stations, and read; those on the way need not be read."""
    rows = [j for j, name in enumerate(stations.station_names) if not name.startswith("via")]
    R, t = stations.world_R_hand[rows], stations.world_t_hand[rows]
    poses = Stations(R, t, np.zeros(len(rows), dtype=np.intp))
    read = simulate(truth, poses, errors, rng, rig.sensor)
    names = [str(taken + j + 1) for j in range(len(rows))]
    matrices = stations.matrices()[rows]
    return hl.Recording.from_poses(matrices, read.ranges, "A", station_names=names)


# "0.1 mm and 0.1 deg hold at 95 %": 1.96 standard deviations.
goal = hl.planning.Goal(location_sigma=1e-4 / 1.96, direction_sigma=math.radians(0.1) / 1.96)
session = hl.Session(errors.stated(), hl.CalibrationOptions("none", sensor=rig.sensor))
motion = hl.planning.blind_motion(rig.bounds, rig.sensor, rig.workspace, errors.stated())
recording = measure(motion.stations, 0)
session.add(recording)
taken = len(recording.station_names)
print(f"first motion: {taken} stations, safe for {motion.safe:.1%} of the mounts")

for _ in range(10):
    calibration = session.calibration()
    beams = calibration.beams.values()
    location = max(float(beam.sigma[:3].max()) for beam in beams)
    direction = max(beam.direction_sigma for beam in beams)
    print(f"{taken:3} stations: {location * 1e3:.3f} mm, {math.degrees(direction):.3f} deg")
    if location <= goal.location_sigma and direction <= goal.direction_sigma:
        break
    plan = hl.plan(calibration, 6, rig.sensor, rig.workspace, goal, rng=rng)
    recording = measure(plan.stations, taken)
    session.add(recording)
    taken += len(recording.station_names)
else:
    raise SystemExit("the goal was not reached")

found = calibration.parameters()
error = np.linalg.norm(found.locations - truth.locations, axis=1).max()
turned = np.linalg.norm(np.cross(found.directions, truth.directions), axis=1).max()
print(f"off by {error * 1e3:.3f} mm and {math.degrees(turned):.3f} deg at most")
assert error < 3e-4
assert turned < math.radians(0.3)
