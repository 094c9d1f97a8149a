"""Convert trials of the SPD-Geometric-Calibration data set to a recording.

    python examples/spd_to_recording.py TRIAL_FOLDER [TRIAL_FOLDER ...] recording.csv

Each folder is one plane: `transforms.csv` holds a station a row, the 4 x 4 matrix world_T_hand row by
row in metres; `measurements.csv` a time stamp and repeated readings in millimetres, whose mean is
the reading of the station. Trials of one mount (P1, P3) share the beam and belong together.
"""

import sys
from pathlib import Path

import numpy as np

import handlaser_gtsam as hl


def rows_of(path: Path, skip: int) -> list[list[float]]:
    """Return the numbers of each line, without its first `skip` cells and empty ones."""
    lines = path.read_text().splitlines()
    return [
        [float(x) for x in line.split(",")[skip:] if x.strip()] for line in lines if line.strip()
    ]


def convert(trials: list[Path], out: Path) -> None:
    """Write the trials as one recording with one beam, "1"."""
    poses, ranges, planes, stations = [], [], [], []
    for trial in trials:
        transforms = np.array(rows_of(trial / "transforms.csv", skip=0)).reshape(-1, 4, 4)
        readings = [np.mean(row) / 1e3 for row in rows_of(trial / "measurements.csv", skip=1)]
        if len(readings) != len(transforms):
            sys.exit(
                f"{trial}: {len(transforms)} poses and {len(readings)} readings; expected as many"
            )
        poses.append(transforms)
        ranges += readings
        planes += [trial.name] * len(readings)
        stations += [f"{trial.name}-{j + 1}" for j in range(len(readings))]
    world_T_hand = np.concatenate(poses)
    recording = hl.Recording(
        world_T_hand[:, :3, :3],
        world_T_hand[:, :3, 3],
        np.array(ranges)[:, None],
        planes,
        ["1"],
        stations,
    )
    hl.write_recording(out, recording)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    *folders, target = (Path(argument) for argument in sys.argv[1:])
    convert(folders, target)
