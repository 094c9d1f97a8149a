"""The same recordings, the same numbers: what a change that is to change none is measured by.

    python -m benchmarks.same_numbers --write before.pickle
    python -m benchmarks.same_numbers --against before.pickle

Recordings: the shipped one, a real one where HANDLASER_SHARED has it, random problems, and one of
every mistake of a cell, through `hl.calibrate` and through the JSON of the command. Values are compared
in their standard deviations, standard deviations as ratios, status and codes of warnings exactly.
The recordings are kept with the numbers, so that what makes them up may change, too.
Exit code 1 where something differs by more than `--tolerance`.
"""

import argparse
import contextlib
import json
import os
import pickle
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import handlaser_gtsam as hl
from benchmarks.cell_mistakes import AFTER, BEFORE, make_cell
from benchmarks.problems import solvable
from handlaser_gtsam.arrays import FloatArray

ROOT = Path(__file__).resolve().parents[1]
GRIPPER = ROOT / "examples" / "gripper"
Numbers = dict[str, FloatArray]


def recordings(problems: int) -> Iterator[tuple[str, hl.Recording]]:
    """Yield named recordings."""
    yield "gripper", hl.read_recording(GRIPPER / "recording.csv")
    spd = Path(os.environ.get("HANDLASER_SHARED", ROOT.parent / "shared")) / "data" / "spd"
    trials = sorted(spd.glob("L3CX_*_P1")) if spd.is_dir() else []
    if trials:
        convert = runpy.run_path(str(ROOT / "examples" / "spd_to_recording.py"))["convert"]
        with tempfile.TemporaryDirectory() as folder:
            convert(trials, Path(folder) / "real.csv")
            yield "real", hl.read_recording(Path(folder) / "real.csv")
    for seed in range(problems):
        yield f"problem {seed}", solvable(np.random.default_rng(seed)).recording
    for name, (mistake, _) in (BEFORE | AFTER).items():
        cell = make_cell(1)
        cell.record_poses()
        if name in BEFORE:
            mistake(cell)
        cell.read()
        if name in AFTER:
            mistake(cell)
        names = tuple(str(i + 1) for i in range(len(cell.r)))
        with contextlib.suppress(hl.InputError):  # what the checks of a recording refuse
            yield (
                name,
                hl.Recording(cell.recorded_R, cell.recorded_t, cell.d, tuple(cell.labels), names),
            )


def numbers_of(recording: hl.Recording) -> Numbers:
    """Return values and standard deviations, and what was said as texts."""
    try:
        found = hl.calibrate(recording)
    except hl.HandlaserError as error:
        return {"said": np.array([str(error)])}
    codes = [one.code for one in found.warnings]
    result = {"said": np.array([found.status, *codes])}
    for name, beam in found.beams.items():
        sigma = np.full(8, np.nan) if beam.sigma is None else beam.sigma
        result[f"beam {name}"] = np.stack((beam.coordinates, sigma))
    for name, plane in found.planes.items():
        sigma = np.full(4, np.nan) if plane.sigma is None else plane.sigma
        result[f"plane {name}"] = np.stack(((*plane.normal, plane.offset), sigma))
    return result


def of_the_command() -> Numbers:
    """Return what the command writes of the shipped recording."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "calibration.json"
        command = [sys.executable, "-m", "handlaser_gtsam.cli", "calibrate", "--quiet"]
        files = [GRIPPER / "recording.csv", "--rig", GRIPPER / "rig.toml", "--out", out]
        subprocess.run([*command, *map(str, files)], check=True)
        content = json.loads(out.read_text())
    covariance = np.array(content["beam_covariance"])
    sigma = np.sqrt(np.diagonal(covariance)).reshape(-1, 8)
    return {
        f"beam {beam['name']}": np.stack(
            (
                [
                    *beam["location_m"],
                    *beam["direction"],
                    beam["range_error"]["k1"],
                    beam["range_error"]["k2_per_m"],
                ],
                own,
            )
        )
        for beam, own in zip(content["beams"], sigma, strict=True)
    }


def differences(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Return the largest difference of values in standard deviations, and that of their ratios to 1."""
    (x, s), (y, t) = before, after
    known = np.isfinite(s) & (s > 0.0)
    if not np.array_equal(known, np.isfinite(t) & (t > 0.0)):
        return np.inf, np.inf
    if not known.any():
        return 0.0, 0.0
    return float((np.abs(x - y) / s)[known].max()), float(np.abs(t / s - 1.0)[known].max())


def main() -> None:
    """Write the numbers, or compare with those written before."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--write", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--problems", type=int, default=40)
    parser.add_argument("--tolerance", type=float, default=1e-9, help="in standard deviations")
    options = parser.parse_args()
    before: Numbers = {}
    given = dict(recordings(options.problems)) if options.against is None else {}
    if options.against is not None:
        given, before = pickle.loads(options.against.read_bytes())
    found = {
        f"{name}: {key}": values
        for name, recording in given.items()
        for key, values in numbers_of(recording).items()
    }
    found |= {f"command: {key}": values for key, values in of_the_command().items()}
    if options.write is not None:
        options.write.write_bytes(pickle.dumps((given, found)))
        print(f"{len(found)} entries written")
        return
    faults = sorted(set(before) ^ set(found))
    most = (0.0, 0.0)
    for key in sorted(set(before) & set(found)):
        if key.endswith(": said"):
            if before[key].tolist() != found[key].tolist():
                faults.append(f"{key}: {before[key].tolist()} became {found[key].tolist()}")
            continue
        here = differences(before[key], found[key])
        most = max(most[0], here[0]), max(most[1], here[1])
        if max(here) > options.tolerance:
            faults.append(f"{key}: {here[0]:.1e} standard deviations, sigmas by {here[1]:.1e}")
    for one in faults:
        print(one)
    print(
        f"{len(found)} entries, {most[0]:.1e} standard deviations, sigmas by {most[1]:.1e} at most"
    )
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
