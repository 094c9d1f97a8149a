"""Wrong conventions of logs of few stations, which no single beam tells from a right one.

The scenes are made here: beams before plates, whose poses are written as KUKA's X, Y, Z, A, B, C.
"""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl

GIVEN = hl.LogFormat(pose_format="kuka", range_units="mm")


def log_of(path, seed, *, beams, plates, stations, written="", outliers=0.0):
    """Write a log; poses may be `written` with the angles reversed, or inverted."""
    rng = np.random.default_rng([seed, beams, plates])
    r = rng.uniform(-0.08, 0.08, (beams, 3))
    v = 0.15 * rng.normal(size=(beams, 3)) + [0.0, 0.0, 1.0]
    v /= np.linalg.norm(v, axis=1)[:, None]
    rows = [["plane", *"XYZABC", *(f"range_{i}" for i in range(beams))]]
    for plate in range(plates):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        foot = np.array([0.8, 0.0, 0.4]) + rng.uniform(-0.2, 0.2, 3)
        while len(rows) <= (plate + 1) * stations // plates:
            z = 0.4 * rng.normal(size=3) - n
            z /= np.linalg.norm(z)
            x = np.cross(z, rng.normal(size=3))
            x /= np.linalg.norm(x)
            R = np.column_stack((x, np.cross(z, x), z))
            t = foot + n * rng.uniform(0.15, 0.45) + rng.uniform(-0.1, 0.1, 3)
            cosine = v @ R.T @ n
            d = -((t - foot + r @ R.T) @ n) / cosine
            if (cosine > -0.4).any() or (d < 0.05).any():
                continue
            d += 1e-4 * rng.normal(size=beams)
            d = np.where(rng.random(beams) < outliers, rng.uniform(0.05, 0.6, beams), d)
            if written == "inverted":
                R, t = R.T, -R.T @ t
            angles = Rotation.from_matrix(R).as_euler("ZYX", degrees=True)
            if written == "reversed":
                angles = angles[::-1]
            numbers = (*np.round(1e3 * t, 4), *np.round(angles, 5), *np.round(1e3 * d, 3))
            rows.append(["ABCD"[plate], *map(str, map(float, numbers))])
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    return path


NAMED = {"reversed": "--pose-format mitsubishi", "inverted": "--inverted"}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "beams", "stations"), [(0, 3, 24), (1, 2, 28)])
@pytest.mark.parametrize("written", NAMED)
def test_beams_tell_together_what_one_of_them_does_not(tmp_path, written, seed, beams, stations):
    """Of 24 readings before four plates, with 19 unknowns, five are more; all beams have enough."""
    path = log_of(
        tmp_path / "log.csv", seed, beams=beams, plates=4, stations=stations, written=written
    )
    with pytest.raises(hl.InputError, match=f"times better if .*{re.escape(NAMED[written])}"):
        hl.read_log(path, GIVEN)


@pytest.mark.slow
@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_no_right_log_of_few_stations_is_accused(tmp_path, outliers):
    for seed in range(2):
        path = log_of(tmp_path / "log.csv", seed, beams=2, plates=4, stations=24, outliers=outliers)
        assert hl.read_log(path, GIVEN).warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize(("plates", "stations", "checked"), [(2, 24, True), (4, 24, False)])
def test_one_beam_tells_with_ten_readings_more_than_unknowns(tmp_path, plates, stations, checked):
    """It has seven unknowns, and each plate three: 13 and 19 of 24 readings (docs/logs.md)."""
    path = log_of(
        tmp_path / "log.csv", 1, beams=1, plates=plates, stations=stations, written="reversed"
    )
    if checked:
        with pytest.raises(hl.InputError, match="times better if"):
            hl.read_log(path, GIVEN)
    else:
        assert hl.read_log(path, GIVEN).warnings == ()
