"""Every convention read as every other one: is it noticed? For `benchmarks.logs` and the tests."""

import itertools
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.model.conventions import ANGLES, FORMATS, LENGTHS, Convention, formats_of
from handlaser_gtsam.validation.scenes import ERRORS, SCENES, Layout
from handlaser_gtsam.validation.simulate import simulate

SAME, NUMBERS, SIGN, RESIDUAL, WARNED, UNNOTICED = "=nsrw!"
"""Outcomes: the same poses; another number of columns; a sign in the numbers, or a residual that
falls, refused; a warning; nothing."""
WORDS = {
    SAME: "the same poses",
    NUMBERS: "refused: another number of columns",
    SIGN: "refused: a sign in the numbers",
    RESIDUAL: "refused: fits ten times better under another convention",
    WARNED: "a warning that names a better one",
    UNNOTICED: "NOT NOTICED",
}
TURNS = {
    "as simulated": (0.0, 0.0, 0.0),
    "tool down": (180.0, 0.0, 30.0),
    "askew": (75.0, -40.0, 110.0),
}
"""How the hand is held: angles about fixed axes [deg] that turn the world."""


def meanings() -> list[Convention]:
    """Return one convention of each meaning: every rotation of a format in all units."""
    rotations = dict.fromkeys(one.rotation for one in FORMATS.values())
    found: dict[tuple[str, str, str], Convention] = {}
    for rotation, units, angles in itertools.product(rotations, LENGTHS, ANGLES):
        one = Convention(rotation, units, angles)
        found.setdefault(one.meaning, one)
    return list(found.values())


def name_of(one: Convention) -> str:
    """Return the first format of a meaning, or the meaning itself."""
    rotation, units, angles = one.meaning
    spelled = f"{rotation}/{units}" + (f"/{angles}" if one.has_angles else "")
    return next(iter(formats_of(one.meaning)), spelled)


def log_recording(scene: str, turn: str, seed: int = 0) -> hl.Recording:
    """Return a simulated recording in a world that is turned."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES[scene](Layout(), rng)
    found = simulate(truth, stations, ERRORS[scene], rng)
    W = Rotation.from_euler("xyz", TURNS[turn], degrees=True).as_matrix()
    return hl.Recording(
        W @ found.world_R_hand,
        found.world_t_hand @ W.T,
        found.ranges,
        found.plane_labels,
        found.beam_names,
    )


def numbers(recording: hl.Recording, written: Convention) -> FloatArray:
    """Return poses (M, k) as a controller writes them."""
    t = recording.world_t_hand / LENGTHS[written.units]
    if written.is_matrix:
        T = np.tile(np.eye(4), (len(t), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = recording.world_R_hand, t
        return (np.swapaxes(T, 1, 2) if written.rotation == "matrix-columns" else T).reshape(-1, 16)
    turn = Rotation.from_matrix(recording.world_R_hand)
    if written.rotation in ("xyzw", "wxyz"):
        return np.hstack((t, turn.as_quat(scalar_first=written.rotation == "wxyz")))
    if written.rotation == "rotvec":
        return np.hstack((t, turn.as_rotvec() / ANGLES[written.angles]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of gimbal lock: the angles that are found mean the same
        euler = turn.as_euler(written.rotation)  # type: ignore[call-overload]
    return np.hstack((t, euler / ANGLES[written.angles]))


@dataclass(frozen=True, slots=True)
class Told:
    """What is said of a log that is read in a wrong way.

    Attributes
    ----------
    written, read : str
    outcome : str
        One letter, see above.
    named : bool
        Whether the right convention is named.
    """

    written: str
    read: str
    outcome: str
    named: bool


def read_as(path: Path, recording: hl.Recording, written: Convention, read: Convention) -> Told:
    """Read the log at `path`, which is `written` in one way, in another way."""
    names = name_of(written), name_of(read)
    columns = path.read_text().split("\n", 1)[0].split(",")
    pose = tuple(name for name in columns if name.startswith("c"))
    given = hl.LogFormat(
        rotation=read.rotation,
        units="m" if read.units == "m" else "mm",
        angles=("deg" if read.angles == "deg" else "rad") if read.has_angles else None,
        pose_columns=pose,
    )
    right = f"--rotation {written.rotation} --units {written.units}"
    listed = formats_of(written.meaning)
    try:
        found = hl.read_log(path, given)
    except hl.InputError as error:
        text = str(error)
        named = any(f" {name}" in text or f"|{name}" in text for name in listed) or right in text
        outcome = SIGN
        if "pose columns" in text:
            outcome = NUMBERS
        elif "times better" in text:
            outcome = RESIDUAL
        return Told(*names, outcome, named)
    off = max(
        np.abs(found.world_R_hand - recording.world_R_hand).max(),
        np.abs(found.world_t_hand - recording.world_t_hand).max(),
    )
    if off < 1e-9:
        return Told(*names, SAME, True)
    said = [one.message for one in found.warnings if one.code == "pose-convention"]
    named = any(name in text for text in said for name in (*listed, right))
    return Told(*names, WARNED if said else UNNOTICED, named)


def study(recording: hl.Recording, conventions: Iterable[Convention]) -> Iterator[Told]:
    """Yield what is said of every ordered pair of conventions."""
    several = list(conventions)
    with tempfile.TemporaryDirectory() as folder:
        for written in several:
            x = numbers(recording, written)
            path = Path(folder) / "log.csv"
            heads = [f"c{i}" for i in range(x.shape[1])]
            heads += [f"range_{beam}" for beam in recording.beam_names]
            lines = [",".join(["plane", *heads])]
            for plane, row, d in zip(recording.plane_labels, x, recording.ranges, strict=True):
                cells = ["" if np.isnan(one) else repr(float(one)) for one in (*row, *d)]
                lines.append(",".join([plane, *cells]))
            path.write_text("\n".join(lines) + "\n")
            for read in several:
                yield read_as(path, recording, written, read)


def matrix(told: list[Told]) -> list[str]:
    """Return the lines of a matrix: rows as written, columns as read."""
    rows = list(dict.fromkeys(one.written for one in told))
    columns = list(dict.fromkeys(one.read for one in told))
    outcome = {(one.written, one.read): one.outcome for one in told}
    width = max(map(len, rows)) + 1
    heads = "  ".join(f"{i + 1}" for i in range(len(columns)))
    lines = [f"{'written, read as':{width}}    {heads}"]
    for i, row in enumerate(rows):
        cells = [f"{outcome[row, column]:<{len(str(j + 1))}}" for j, column in enumerate(columns)]
        lines.append(f"{row:{width}} {i + 1:2} " + "  ".join(cells))
    return lines
