"""A robot that never stops: errors of its poses that change smoothly from one station to the next.

    python -m benchmarks.moving_robot [--runs 40] [--lengths 0 5 20 60] [--jobs J]

Two beams before four planes, 400 stations each on a smooth path; every pose errs by 0.1 mm and 0.2 mrad
an axis, by noise that a Gaussian window of some length of stations has smoothed (0: independent), and
readings by 0.02 mm. Printed are, with the noise given and with nothing given, the rms and the largest
of the errors of r, k1 and k2 in their stated standard deviations (an honest rms is 1), in how many
recordings the correlation is named, the length of it that is named, and other warnings. The generator
shares nothing with the package.
"""

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options

PLANES, STATIONS, BEAMS = 4, 400, 2
RANGE, TRANSLATION, ROTATION = 2e-5, 1e-4, 2e-4
"""Standard deviations of readings [m] and of poses [m], [rad]."""
NAMED = "correlated-in-time"


@dataclass(frozen=True)
class Outcome:
    """Errors in standard deviations (z,), the length of correlation named, and other warnings."""

    z: np.ndarray
    length: float | None
    others: tuple[str, ...]


def smooth_noise(count: int, length: int, rng: np.random.Generator) -> np.ndarray:
    """Return Gaussian noise (count, 6) of unit variance that correlates by exp(-(k / length)^2 / 2)."""
    if length == 0:
        return rng.standard_normal((count, 6))
    window = np.exp(-((np.arange(-4 * length, 4 * length + 1) / length) ** 2))
    window /= np.linalg.norm(window)
    white = rng.standard_normal((count + 8 * length, 6))
    return np.stack([np.convolve(one, window, "valid") for one in white.T], axis=1)


def recorded(length: int, seed: int) -> tuple[hl.Recording, np.ndarray, np.ndarray]:
    """Return a recording, and the true locations (B, 3) and range errors (B, 2)."""
    rng = np.random.default_rng(seed)
    locations = rng.uniform(-0.06, 0.06, (BEAMS, 3))
    turns = Rotation.from_rotvec(rng.uniform(-0.35, 0.35, (BEAMS, 3)))
    directions = turns.apply([0.0, 0.0, 1.0])
    k = rng.uniform(-5e-3, 5e-3, (BEAMS, 2))
    rotations, positions, ranges = [], [], []
    for plane in range(PLANES):
        tilt = [0.6 * (plane % 2) - 0.3, 0.6 * (plane // 2) - 0.3, 0.0]
        normal = Rotation.from_euler("xyz", tilt).apply([0.0, 0.0, -1.0])
        R, t = _path(rng)
        start = t[:, None] + np.stack([R.apply(r) for r in locations], axis=1)
        along = np.stack([R.apply(v) for v in directions], axis=1)
        true = ((np.array([0.1 * plane, 0.0, 0.9]) - start) @ normal) / (along @ normal)
        d = true
        for _ in range(20):  # of true = d + k1 d + k2 d^2
            d = true - k[:, 0] * d - k[:, 1] * d**2
        ranges.append(d + RANGE * rng.standard_normal(d.shape))
        error = smooth_noise(STATIONS, length, rng)
        rotations.append((R * Rotation.from_rotvec(ROTATION * error[:, :3])).as_matrix())
        positions.append(t + TRANSLATION * error[:, 3:])
    labels = np.repeat(list("ABCD"), STATIONS).tolist()
    recording = hl.Recording(
        np.concatenate(rotations),
        np.concatenate(positions),
        np.concatenate(ranges),
        tuple(labels),
        ("1", "2"),
    )
    return recording, locations, k


def _path(rng: np.random.Generator) -> tuple[Rotation, np.ndarray]:
    """Return rotations and positions of a hand that moves in sums of three sines."""
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 1, 3))
    turns = np.linspace(0.0, 1.6, STATIONS)[:, None] * [0.7, 1.1, 1.7]
    path = (np.sin(2.0 * np.pi * turns + phase) / [1.0, 1.5, 2.2]).sum(axis=2).T / 1.6
    path *= [0.35, 0.35, 0.5, 0.12, 0.12, 0.12]
    return Rotation.from_rotvec(path[:, :3]), path[:, 3:] + [0.0, 0.0, 0.3]


def outcome(argument: tuple[int, bool, int]) -> Outcome:
    """Return what came of a recording: length of the errors, whether noise is given, seed."""
    length, given, seed = argument
    recording, locations, k = recorded(length, seed)
    noise = hl.Noise(RANGE, TRANSLATION, ROTATION) if given else hl.Noise()
    found = hl.calibrate(recording, noise)
    if found.status != "converged":
        raise RuntimeError(f"run {argument}: {found.message}")
    z = [
        np.concatenate(
            (
                (beam.location - r) / beam.location_sigma,
                (beam.range_error - error) / beam.range_error_sigma,
            )
        )
        for beam, r, error in zip(found.beams.values(), locations, k, strict=True)
    ]
    named = [one.values["length"] for one in found.warnings if one.code == NAMED]
    others = tuple(one.code for one in found.warnings if one.code != NAMED)
    return Outcome(np.concatenate(z), float(named[0]) if named else None, others)


def main() -> None:
    """Print a line for every length of the errors of poses, and whether noise is given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--lengths", type=int, nargs="*", default=[0, 5, 20, 60])
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        studies.show("length  noise     rms z  largest  named     length of it  other warnings")
        for length in arguments.lengths:
            for given in (True, False):
                runs = [(length, given, seed) for seed in range(arguments.runs)]
                every = studies.each(f"length {length}", outcome, runs)
                z = np.stack([one.z for one in every])
                named = [one.length for one in every if one.length is not None]
                others = Counter(code for one in every for code in one.others)
                studies.show(
                    f"{length:6d}  {'given' if given else 'nothing':7} {np.sqrt((z**2).mean()):7.2f} "
                    f"{np.abs(z).max():8.1f}  {len(named):3d} of {len(every):3d} "
                    f"{np.median(named) if named else 0.0:8.0f}      {dict(others) or 'none'}"
                )


if __name__ == "__main__":
    main()
