"""Calibrate the shipped recording from Python."""

from pathlib import Path

import numpy as np

import handlaser_gtsam as hl

folder = Path(__file__).parent / "gripper"
recording = hl.read_recording(folder / "recording.csv")
noise = hl.Noise(range_sigma=3e-5)  # metres

calibration = hl.calibrate(recording, noise)
print(calibration.status, "-", calibration.range_error_choice)
for name, beam in calibration.beams.items():
    x, y, z = beam.location * 1e3
    sigma = beam.location_sigma.max() * 1e3
    turn = np.degrees(beam.direction_sigma)
    print(f"beam {name}: ({x:.2f}, {y:.2f}, {z:.2f}) mm +- {sigma:.2f} mm, +- {turn:.2f} deg")
print(f"rms {calibration.fit.rms * 1e3:.3f} mm over {calibration.fit.readings} readings")
