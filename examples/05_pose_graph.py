"""Add a beam to a pose graph that a robot has already, and read the calibration back.

A mobile base has odometry that drifts by 1 % and a fix now and then, and stands on a floor that is flat
to a fraction of a millimetre; its arm carries a laser. The hand poses are variables of that graph. Each
reading joins in one line, a landmark that the graph knows already serves as the plane, and everything
is solved together.
"""

import gtsam
import numpy as np

import handlaser_gtsam as hl

rng = np.random.default_rng(4)
PLACES, RANGE_SIGMA = 60, 1e-3  # m
BEAM = hl.factors.BeamKeys(location=gtsam.symbol("l", 0), direction=gtsam.symbol("u", 0))
WALL, FLOOR = gtsam.symbol("w", 0), gtsam.symbol("f", 0)
FLAT = np.array([0.0, 0.0, 1.0, 0.0])
base, hand = (lambda j: gtsam.symbol("b", j)), (lambda j: gtsam.symbol("h", j))
gaussian = gtsam.noiseModel.Diagonal.Sigmas
floor_sigmas = np.array([2e-4, 2e-4, 3e-4])  # roll, pitch [rad] and height [m]: how flat it is
fix_sigmas, arm_sigmas = np.array([1e-3] * 3 + [1e-3] * 3), np.array([3e-4] * 3 + [2e-4] * 3)

# The truth that the measurements come from.
location, direction = np.array([0.05, -0.02, 0.08]), np.array([0.98, 0.1, 0.17])
direction /= np.linalg.norm(direction)
wall = gtsam.OrientedPlane3(gtsam.Unit3(np.array([1.0, 0.1, 0.05])), -2.0)

# 1. The graph that the robot had: odometry, floor, fixes, the arm, and the wall as a landmark.
graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
true_base, true_hand, believed = [], [], gtsam.Pose3()
for j in range(PLACES):
    x = gtsam.Pose3(
        gtsam.Rot3.Yaw(rng.normal(0.0, 0.3)), np.array([*rng.uniform(-0.7, 0.7, 2), 0.0])
    )
    roll, pitch, height = floor_sigmas * rng.standard_normal(3)
    x = x.retract(np.array([roll, pitch, 0.0, 0.0, 0.0, height]))
    reach = gtsam.Pose3(gtsam.Rot3.Expmap(rng.uniform(-0.5, 0.5, 3)), rng.uniform(-0.3, 0.3, 3))
    if j:
        step = true_base[-1].between(x)
        drift = np.maximum(0.01 * np.abs(gtsam.Pose3.Logmap(step)), 1e-4)  # 1 % of the step
        measured = step.retract(drift * rng.standard_normal(6))
        graph.push_back(gtsam.BetweenFactorPose3(base(j - 1), base(j), measured, gaussian(drift)))
        believed = believed.compose(measured)
    if j % 10 == 0:
        believed = x.retract(fix_sigmas * rng.standard_normal(6))
        graph.addPriorPose3(base(j), believed, gaussian(fix_sigmas))
    # The floor is a plane that the base always sees at (0, 0, 1), 0: three rows, and no more.
    on_floor = gtsam.OrientedPlane3Factor(FLAT, gaussian(floor_sigmas), base(j), FLOOR)
    graph.push_back(on_floor)
    graph.push_back(gtsam.BetweenFactorPose3(base(j), hand(j), reach, gaussian(arm_sigmas)))
    values.insert(base(j), believed)
    values.insert(hand(j), believed.compose(reach))
    true_base.append(x)
    true_hand.append(x.compose(reach.retract(arm_sigmas * rng.standard_normal(6))))
values.insert(FLOOR, gtsam.OrientedPlane3(gtsam.Unit3(FLAT[:3]), FLAT[3]))
seen = wall.transform(true_base[0])
landmark_noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.02)
measured_plane = np.array([*seen.normal().point3(), seen.distance() + 0.01])
graph.push_back(gtsam.OrientedPlane3Factor(measured_plane, landmark_noise, base(0), WALL))
values.insert(WALL, gtsam.OrientedPlane3(gtsam.Unit3(np.array([1.0, 0.0, 0.0])), -1.9))

# 2. The beam: one line a reading.
for j, pose in enumerate(true_hand):
    n, b = wall.transform(pose).normal().point3(), wall.transform(pose).distance()
    d = -(n @ location + b) / (n @ direction) + RANGE_SIGMA * rng.standard_normal()
    graph.push_back(hl.factors.range_to_plane_from_pose(BEAM, WALL, hand(j), d, RANGE_SIGMA))
values.insert(BEAM.location, np.zeros(3))
values.insert(BEAM.direction, gtsam.Unit3(np.array([1.0, 0.0, 0.0])))

# 3. Solve everything together, and read the calibration back in one call.
solved = hl.optimize(graph, values)
result = hl.read_graph(graph, solved.values, beams={"laser": BEAM}, planes={"wall": WALL})
beam = result.beams["laser"]
print(f"{graph.size()} factors, {solved.message}; {result.message}")
print(f"chi2 {result.fit.chi2:.0f} for {result.fit.dof} degrees of freedom")
for axis, r, s, true in zip("xyz", beam.location, beam.location_sigma, location, strict=True):
    print(f"location {axis} {1e3 * r:7.2f} +- {1e3 * s:.2f} mm, true {1e3 * true:.2f}")
assert result.status == "converged"
assert (np.abs(beam.location - location) < 4 * beam.location_sigma).all()
