"""Calibrations to export, and what robots make of the numbers, by formulas of their own."""

import json
import re
import shutil
from math import cos, sin, sqrt

import numpy as np

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import FloatArray

COMPILER = shutil.which("gcc") or shutil.which("cc")
NUMBER = r"-?\d+\.\d+(?:[eE][-+]?\d+)?"
HOSTILE = (
    "<script>alert(1)</script>",
    '"); DROP TABLE beams; --',
    "*/ int main(void) { return 1; } /*",
    "*) END_VAR (*",
    "-->",
    "--",
    "a -- b --->",
    "back\\slash\\",
    "trigraph ??/",
    "' OR ''='",
    '"""',
    "${1/0} $(rm x) `id`",
    "壁",
    "門",
    "β1",
    "😀",
    "ENDMODULE",
    "&amp; ]]>",
    "# coding: utf-7",
    "xacro:eval-comments:on",
    "x" * 200,
    "x" * 199 + "y",
    "a b",
    "a_b",
    "A-B",
)


def unit(v: FloatArray) -> FloatArray:
    """Return v divided by its length."""
    return np.asarray(v / np.linalg.norm(v))


def directions() -> list[FloatArray]:
    """Return the axes of the hand and their opposites, what is beside them, and any others."""
    rng = np.random.default_rng(4)
    found = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    for size in (1e-3, 1e-7, 1e-10, 1e-13):
        found += [unit(one + size * rng.normal(size=3)) for one in found[:6]]
    return found + [unit(one) for one in rng.normal(size=(20, 3))]


def calibrated(
    v: list[FloatArray] | None = None, names: tuple[str, ...] = (), status: str = "converged"
) -> hl.files.CalibrationFile:
    """Return a calibration with these beam directions, or these names, and known numbers besides."""
    rng = np.random.default_rng(7)
    v = [unit(one) for one in rng.normal(size=(max(len(names), 3), 3))] if v is None else v
    names = names or tuple(str(i + 1) for i in range(len(v)))
    count = len(v)
    half = rng.normal(size=(8 * count, 8 * count)) * 1e-4
    covariance = half @ half.T
    beams = [
        {
            "name": name,
            "location_m": rng.uniform(-0.5, 0.5, 3).tolist(),
            "direction": one.tolist(),
            "range_error": {"k1": rng.normal() * 1e-2, "k2_per_m": rng.normal()},
            "range_error_terms": 2,
            "range_error_excludes_zero": None,
            "sigma": None,
            "interval_95": None,
            "covariance": covariance[8 * i : 8 * i + 8, 8 * i : 8 * i + 8].tolist(),
            "spot": None,
        }
        for i, (name, one) in enumerate(zip(names, v, strict=True))
    ]
    planes = [
        {"name": "A", "normal": [0.0, 0.6, 0.8], "offset_m": -0.3, "sigma": None},
        {
            "name": "β",
            "normal": [1.0, 0.0, 0.0],
            "offset_m": 0.25,
            "sigma": {"normal_rad": 1e-3, "offset_m": 2e-5},
        },
    ]
    fit = {
        "readings": 9,
        "rms_m": 1e-5,
        "max_m": 2e-5,
        "chi2": 5.0,
        "dof": 4,
        "sigma0": 1.0,
        "max_at": {"station": "1", "beam": names[0]},
        "range_sigma_m": 3e-5,
        "range_sigma_given": True,
        "poses": "exact",
        "pose_covariance": None,
        "noise_estimate": [],
        "rejected": [],
    }
    seen = {"rank": 9, "unknowns": 9, "condition": 5.0, "undetermined": [], "advice": []}
    whole = {
        "format": "handlaser-calibration",
        "version": 1,
        "status": status,
        "message": "2 steps",
        "warnings": [{"code": "far-reading", "message": "a reading is far", "values": {}}],
        "beams": beams,
        "beam_covariance": covariance.tolist(),
        "planes": planes,
        "fit": fit,
        "observability": seen | {"weakest": None, "indices": None},
        "correlations": [],
        "range_error_scales": None,
        "systematic": [],
        "iterations": 2,
        "start": {"method": "translations", "tried": []},
    }
    return hl.files.CalibrationFile.model_validate_json(json.dumps(whole))


def true_point(beam, reading: float, t, R) -> FloatArray:
    """Return where a beam of a calibration ends in the base."""
    s = reading + beam.range_error.k1 * reading + beam.range_error.k2_per_m * reading**2
    in_hand = np.array(beam.location_m) + s * unit(np.array(beam.direction))
    return np.asarray(np.asarray(R) @ in_hand + t)


def about_x(a: float) -> FloatArray:
    """Turn about x."""
    return np.array([[1, 0, 0], [0, cos(a), -sin(a)], [0, sin(a), cos(a)]])


def about_y(a: float) -> FloatArray:
    """Turn about y."""
    return np.array([[cos(a), 0, sin(a)], [0, 1, 0], [-sin(a), 0, cos(a)]])


def about_z(a: float) -> FloatArray:
    """Turn about z."""
    return np.array([[cos(a), -sin(a), 0], [sin(a), cos(a), 0], [0, 0, 1]])


def of_quaternion(w: float, x: float, y: float, z: float) -> FloatArray:
    """Return the matrix of a unit quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def of_vector(x: float, y: float, z: float) -> FloatArray:
    """Return the matrix of a rotation vector [rad] (Rodrigues)."""
    angle = sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return np.eye(3)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
    return np.asarray(np.eye(3) + sin(angle) * K + (1 - cos(angle)) * K @ K)


def numbers(text: str) -> list[float]:
    """Return all numbers with a point in a text."""
    return [float(one) for one in re.findall(NUMBER, text)]
