"""Render the calibration of the shipped recording: python docs/picture.py [FILE.png]."""

import sys
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from mpl_toolkits.mplot3d import Axes3D

import handlaser_gtsam as hl
from handlaser_gtsam.model.equation import corrected

ROOT = Path(__file__).parents[1]
COLOURS = ("#d1495b", "#00798c", "#edae49", "#30638e")
PLANE = 0


def draw_hand(axes: Axes3D, calibration: hl.Calibration, recording: hl.Recording) -> None:
    """Draw the beams of the first plane's stations, and the plane, in millimetres."""
    plane = list(calibration.planes.values())[PLANE]
    stations = np.flatnonzero(recording.plane_of_station == PLANE)
    centre = recording.world_t_hand[stations].mean(axis=0)
    for index, beam in enumerate(calibration.beams.values()):
        for j in stations:
            R, t = recording.world_R_hand[j], recording.world_t_hand[j]
            d = recording.ranges[j, index : index + 1]
            s = corrected(d, beam.range_error[None])[0]
            ends = np.array([beam.location, beam.location + s * beam.direction]) @ R.T + t - centre
            strong = j == stations[0]
            label = f"beam {beam.name}" if strong else None
            axes.plot(
                *(ends * 1e3).T,
                color=COLOURS[index % 4],
                lw=2.5 if strong else 0.8,
                alpha=1.0 if strong else 0.4,
                label=label,
            )
            axes.scatter(*(ends[1:] * 1e3).T, color=COLOURS[index % 4], s=6)
    x, y = np.meshgrid([-0.045, 0.045], [-0.045, 0.045])
    n, b = plane.normal, plane.offset + plane.normal @ centre
    z = -(n[0] * x + n[1] * y + b) / n[2]
    axes.plot_surface(x * 1e3, y * 1e3, z * 1e3, color="#8d99ae", alpha=0.35)
    axes.set(xlabel="x mm", ylabel="y mm", zlabel="z mm", title=f"beams and plane {plane.name}")
    axes.view_init(elev=12, azim=-60)
    axes.legend(loc="upper left", fontsize=8)


def draw_residuals(axes: plt.Axes, calibration: hl.Calibration, recording: hl.Recording) -> None:
    """Draw residuals against readings."""
    for index, beam in enumerate(calibration.beams.values()):
        d, e = recording.ranges[:, index] * 1e3, calibration.fit.residuals[:, index] * 1e3
        axes.plot(d, e, "o", ms=3, color=COLOURS[index % 4], label=f"beam {beam.name}")
    rms = calibration.fit.rms * 1e3
    axes.axhspan(-rms, rms, color="#8d99ae", alpha=0.2, label=f"rms {rms:.3f} mm")
    axes.set(xlabel="reading mm", ylabel="residual mm", title="what is left after calibration")
    axes.legend(fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Calibrate and draw."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "calibration.png"
    recording = hl.read_recording(ROOT / "examples" / "gripper" / "recording.csv")
    calibration = hl.calibrate(recording, hl.Noise(range_sigma=3e-5))
    figure = plt.figure(figsize=(10, 4.2), layout="constrained")
    draw_hand(figure.add_subplot(1, 2, 1, projection="3d"), calibration, recording)
    draw_residuals(figure.add_subplot(1, 2, 2), calibration, recording)
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main()
