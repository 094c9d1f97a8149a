"""Solve twice, by factor graph and by SciPy, and compare in standard deviations."""

from pathlib import Path

import handlaser_gtsam as hl

recording = hl.read_recording(Path(__file__).parent / "gripper" / "recording.csv")
calibration = hl.calibrate(recording, hl.Noise(range_sigma=3e-5))
check = hl.cross_check(calibration, recording)
print(f"largest difference: {check.largest:.1e} standard deviations ({check.parameter})")
print(f"standard deviations agree to {check.largest_sigma:.1e} ({check.sigma_parameter})")
assert check.largest < 1e-6
