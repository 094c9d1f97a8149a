"""Calibrate the shipped recording from Python."""

from pathlib import Path

import numpy as np

import handlaser_gtsam as hl

folder = Path(__file__).parent / "gripper"
recording = hl.read_recording(folder / "recording.csv")
noise = hl.Noise(range_sigma=3e-5)  # metres; the errors of the robot are estimated

calibration = hl.calibrate(recording, noise)
print(calibration.status, "-", calibration.message)
for name, beam in calibration.beams.items():
    x, y, z = beam.location * 1e3
    sigma = beam.location_sigma.max() * 1e3
    turn = np.degrees(beam.direction_sigma)
    print(f"beam {name}: ({x:.2f}, {y:.2f}, {z:.2f}) mm +- {sigma:.2f} mm, +- {turn:.2f} deg")
    k1, k2 = beam.range_error
    low, high = calibration.intervals(name)[7]
    print(f"  range error k1 {k1:.4f}, k2 {k2:.2f}/m (95 % from {low:.2f} to {high:.2f})")
print(f"rms {calibration.fit.rms * 1e3:.3f} mm over {calibration.fit.readings} readings")
