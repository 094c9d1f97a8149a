"""How a session begins: from a batch calibration of everything that has come so far."""

from dataclasses import replace

import numpy as np

from ..data.noise import Noise
from ..errors import InputError
from ..estimation.options import CalibrationOptions
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from .contents import Contents
from .setting import Setting


def refuse(noise: Noise, options: CalibrationOptions) -> None:
    """Refuse what planes that come one by one cannot have.

    Raises
    ------
    InputError
    """
    S = noise.pose_covariance
    if S is not None and S.ndim == 3:
        raise InputError("a pose covariance a station", "one for all stations to come")
    for wrong, found in (
        (options.estimate_noise, "noise to be estimated while planes are added"),
        (options.range_sigma_by_beam, "a range sigma by beam while planes are added"),
    ):
        if wrong:
            raise InputError(found, "sigmas that are given: estimate them with calibrate")
    if options.loss != "gaussian":
        raise InputError(f"loss {options.loss} while planes are added", "the gaussian loss")
    options.require_consistent(noise)


def setting_of(found: Calibration, noise: Noise, sensor: Sensor) -> Setting:
    """Return the setting of a session that begins with a calibration."""
    beams = found.beams.values()
    given = noise.range_sigma is not None
    return Setting(
        tuple(beam.name for beam in beams),
        tuple(beam.terms for beam in beams),
        found.fit.typical_range,
        found.fit.range_sigma,
        np.inf if given else float(max(found.fit.dof, 1)),
        noise,
        found.fit.poses,
        sensor,
        learned=found.learned,
    )


def begun(contents: Contents, found: Calibration) -> Contents:
    """Return contents of which nothing is in a graph, without the readings that `found` left out."""
    fresh = replace(
        contents,
        left_out={
            plane: np.zeros(one.ranges.shape, dtype=bool)
            for plane, one in contents.stations.items()
        },
        rejected=(),
        numbers={},
        origins={},
        aside={},
    )
    by_plane: dict[str, list[tuple[str, str, str]]] = {}
    plane_of = {
        name: plane for plane, one in contents.stations.items() for name in one.station_names
    }
    for one in found.fit.rejected:
        by_plane.setdefault(plane_of[one.station], []).append((one.station, one.beam, one.reason))
    for plane, bad in by_plane.items():
        recording = contents.stations[plane]
        for reason in {reason for _, _, reason in bad}:
            mask = np.zeros(recording.ranges.shape, dtype=bool)
            for station, beam, why in bad:
                if why == reason:
                    row = recording.station_names.index(station)
                    mask[row, recording.beam_names.index(beam)] = True
            fresh = fresh.leaving_out(plane, recording, mask, reason)
    return fresh
