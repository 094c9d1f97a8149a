"""Put range factors into a GTSAM graph of your own.

A hand moves before a wall. Its poses are variables with priors, as they would be with odometry or a
tracker in the same graph. The keys are yours; each station joins in one line, and GTSAM's own
optimizer solves everything together.
"""

import gtsam
import numpy as np

import handlaser_gtsam as hl

rng = np.random.default_rng(1)
BEAM = hl.factors.BeamKeys(location=gtsam.symbol("l", 0), direction=gtsam.symbol("u", 0))
WALL = gtsam.symbol("w", 0)
RANGE_SIGMA = 1e-3  # m
pose_noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([2e-3] * 3 + [1e-3] * 3))  # rad, m

# The truth that the readings come from.
location, direction = np.array([0.02, -0.01, 0.05]), gtsam.Unit3(np.array([0.1, 0.0, 1.0]))
wall = gtsam.OrientedPlane3(gtsam.Unit3(np.array([0.2, 0.1, 1.0])), -0.6)
turns = rng.uniform(-0.5, 0.5, (40, 3))
shifts = rng.uniform(-0.2, 0.2, (40, 3))
poses = [gtsam.Pose3(gtsam.Rot3.Expmap(w), t) for w, t in zip(turns, shifts, strict=True)]

graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
for j, pose in enumerate(poses):
    seen = wall.transform(pose)
    n, b = seen.normal().point3(), seen.distance()
    reading = -(n @ location + b) / (n @ direction.point3()) + RANGE_SIGMA * rng.standard_normal()
    reported = pose.retract(pose_noise.sigmas() * rng.standard_normal(6))
    x = gtsam.symbol("x", j)
    graph.addPriorPose3(x, reported, pose_noise)
    graph.push_back(hl.factors.range_to_plane_from_pose(BEAM, WALL, x, reading, RANGE_SIGMA))
    values.insert(x, reported)
values.insert(BEAM.location, np.zeros(3))
values.insert(BEAM.direction, gtsam.Unit3(np.array([0.0, 0.0, 1.0])))
values.insert(WALL, gtsam.OrientedPlane3(gtsam.Unit3(np.array([0.0, 0.0, 1.0])), -0.5))

result = gtsam.Values(gtsam.LevenbergMarquardtOptimizer(graph, values).optimize())
sigma = np.sqrt(np.diagonal(gtsam.Marginals(graph, result).marginalCovariance(BEAM.location)))
error = result.atPoint3(BEAM.location) - location
print(f"{graph.size()} factors, error {graph.error(values):.0f} -> {graph.error(result):.1f}")
for axis, e, s in zip("xyz", error, sigma, strict=True):
    print(f"location {axis}: off by {e * 1e3:+.2f} mm, standard deviation {s * 1e3:.2f} mm")
assert (np.abs(error) < 4 * sigma).all()
