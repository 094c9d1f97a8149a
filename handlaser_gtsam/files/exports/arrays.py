"""Beams, covariances and planes as binary files of MATLAB and NumPy, SI units."""

import io

import numpy as np

from ...results.mounts import Mounts
from ..calibration_file import CalibrationFile
from .beams import origin_line

ABOUT = (
    "SI units: m, rad. Beams in the hand frame, planes n . x + b = 0 in the world frame. "
    "The true range is s = d + k1 d + k2 d^2 for a reading d. "
    "beam_covariance has 8 rows a beam: x, y, z, vx, vy, vz, k1, k2."
)


def matlab_bytes(mounts: Mounts, file: CalibrationFile) -> bytes:
    """Return a MAT file with one struct, `handlaser`; names are cells of text."""
    from scipy.io import savemat

    content = {
        name: value.astype(object) if value.dtype.kind == "U" and value.ndim else value
        for name, value in _content(mounts, file).items()
    }
    buffer = io.BytesIO()
    savemat(buffer, {"handlaser": content}, oned_as="column")  # type: ignore[arg-type]  # not by the stubs
    return buffer.getvalue()


def numpy_bytes(mounts: Mounts, file: CalibrationFile) -> bytes:
    """Return an NPZ file, which needs no pickle."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **_content(mounts, file))
    return buffer.getvalue()


def _content(mounts: Mounts, file: CalibrationFile) -> dict[str, np.ndarray]:
    """Return what both hold: `mounts` of some beams, and all planes; NaN where nothing is known."""
    sigmas = [
        (np.nan, np.nan) if one.sigma is None else (one.sigma.normal_rad, one.sigma.offset_m)
        for one in file.planes
    ]
    plane_sigmas = np.array(sigmas, dtype=np.float64).reshape(-1, 2)
    return {
        "about": np.array(f"{origin_line()} {ABOUT}"),
        "beam_names": np.array(mounts.names),
        "location_m": mounts.locations,
        "direction": mounts.directions,
        "range_error": mounts.range_errors,
        "range_error_terms": np.array(mounts.terms),
        "beam_sigma": mounts.sigma,
        "beam_covariance": mounts.covariance,
        "plane_names": np.array([one.name for one in file.planes]),
        "plane_normal": np.array([one.normal for one in file.planes]),
        "plane_offset_m": np.array([one.offset_m for one in file.planes]),
        "plane_normal_sigma_rad": plane_sigmas[:, 0],
        "plane_offset_sigma_m": plane_sigmas[:, 1],
        "range_sigma_m": np.array(mounts.range_sigma),
    }
