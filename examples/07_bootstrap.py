"""Standard deviations by parametric bootstrap: nothing is linearised.

Recordings are drawn from a calibration, with its noise of readings and hand poses, and each is solved
again. How much the solutions spread is compared with the standard deviations of the calibration.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import handlaser_gtsam as hl


def bootstrap(
    recording: hl.Recording, errors: hl.validation.Errors, rng: np.random.Generator, draws: int
) -> np.ndarray:
    """Return the spread of the draws over the stated sigma (B, 8), for x, y, z, vx, vy, vz, k1, k2."""
    noise = errors.stated()
    calibration = hl.calibrate(recording, noise, hl.CalibrationOptions(range_error="k1k2"))
    truth, used = calibration.parameters(), calibration.used_in(recording)
    plane = np.array([used.plane_names.index(label) for label in used.plane_labels])
    stations = hl.simulate.Stations(used.world_R_hand, used.world_t_hand, plane)
    drawn = [hl.simulate.simulate(truth, stations, errors, rng) for _ in range(draws)]
    # What was not read in the recording, or was rejected, is not read in the draws either.
    unread = np.isnan(used.ranges)
    drawn = [replace(one, ranges=np.where(unread, np.nan, one.ranges)) for one in drawn]
    solved = hl.estimation.solve_many(drawn, noise, terms=2, starts=[truth] * draws)
    assert solved.converged.all()
    beams = np.array([np.hstack(one.beams) for one in solved.parameters])
    stated = np.array([beam.sigma for beam in calibration.beams.values()])
    return beams.std(axis=0, ddof=1) / stated


if __name__ == "__main__":
    gripper = Path(__file__).parent / "gripper" / "recording.csv"
    known = hl.validation.Errors(3e-5, pose_translation_sigma=2e-5, pose_rotation_sigma=1e-4)
    ratio = bootstrap(hl.read_recording(gripper), known, np.random.default_rng(0), draws=400)
    names = ("x", "y", "z", "vx", "vy", "vz", "k1", "k2")
    print("spread of 400 draws over the stated standard deviation, by beam:")
    for name, row in zip(names, ratio.T, strict=True):
        print(f"  {name:2}", *(f"{value:.2f}" for value in row))
