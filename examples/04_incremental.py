"""Recalibrate as planes are added, in milliseconds; notice a displaced beam, and go on with it.

Four beams look at one plane after the other. Every plane joins an iSAM2 graph; the session says what
it taught. Before the 13th plane, beam 2 is displaced by 0.3 degrees: the session names the beam and the
plane, and is told to let that beam have moved.
"""

from dataclasses import replace

import numpy as np

import handlaser_gtsam as hl
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, PLANES, DISPLACED = 1e-4, 16, 12
rng = np.random.default_rng(7)
truth, stations = SCENES["arm"](Layout(beams=4, planes=PLANES, stations=8), rng)
turned = truth.directions.copy()
across = hl.model.tangent_basis(turned)[1, :, 0]
turned[1] = np.cos(np.radians(0.3)) * turned[1] + np.sin(np.radians(0.3)) * across
before = simulate(truth, stations, Errors(SIGMA), rng)
after = simulate(replace(truth, directions=turned), stations, Errors(SIGMA), rng)

session = hl.Session(hl.Noise(range_sigma=SIGMA), hl.CalibrationOptions("none"))
print("plane  learnt   largest standard deviation of a location")
for number, name in enumerate(before.plane_names):
    recording = before if number < DISPLACED else after
    update = session.add(recording.plane(name))
    if update.sigma is None:
        print(f"{name:5}  waits: {update.message[:70]}")
        continue
    taught = "  the start" if np.isnan(update.information) else f"{update.information:6.2f} nats"
    print(f"{name:5} {taught} {1e3 * update.sigma[:, :3].max():8.4f} mm")
    if update.moved is not None:
        moved = update.moved
        turn = np.degrees(moved.turn)
        print(f"       beam {moved.name} has moved before plane {moved.since}, by {turn:.2f} deg")
        assert (moved.name, moved.since) == ("2", before.plane_names[DISPLACED])
        session.split_beam(moved.name, since=moved.since)

largest = session.compare().largest
print(f"from the batch solution: {largest:.4f} standard deviations at most")
found = session.beams()
beam = found.names.index("2")
error = np.degrees(np.linalg.norm(found.directions[beam] - turned[beam]))
print(f"beam 2 now points {error:.3f} deg from where it really does")
verdict = session.calibration().verdict
print(verdict.sentence)
assert largest < 0.01
assert error < 0.1
assert verdict.usable
