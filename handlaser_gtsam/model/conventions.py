r"""How controllers write poses: units, and what the numbers of a rotation mean.

A rotation is spelled `xyzw` or `wxyz` (quaternion), `rotvec` (axis times angle), `matrix` or
`matrix-columns` (a homogeneous matrix, row by row or column by column), or as SciPy spells Euler
angles: three letters, in lower case about fixed axes and in upper case about moving ones, so that

    'xyz', [a, b, c]:  R = Rz(c) Ry(b) Rx(a)        'ZYX', [a, b, c]:  R = Rz(a) Ry(b) Rx(c)

KUKA's A B C and FANUC's W P R are the same matrix with the numbers reversed. Sources: the manuals of
the controllers, as collected in the table of the how-to page (docs/logs.md).
"""

import re
import shlex
import warnings
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..checks import require_word
from ..errors import InputError
from ..quantities import DEG, INCH, MM
from ..text import shown
from .geometry import nearest_rotation

QUATERNIONS, MATRICES = ("xyzw", "wxyz"), ("matrix", "matrix-columns")
LENGTHS = {"m": 1.0, "mm": MM, "in": INCH}
"""Units of length [m]; an inch is 25.4 mm."""
UNIT_WORDS = {"m": "metres", "mm": "millimetres", "in": "inches"}
"""What they are called."""
ANGLES = {"rad": 1.0, "deg": DEG}
"""Units of angle [rad]."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time [s]."""
INVERTED = "hand_T_world (base in hand)"
"""Poses that are inverted, in words."""
UNITS = (
    "mm|m|in|inch|deg|°|rad|s|ms|us|ns"
    "|cm|dm|km|um|µm|μm|nm|ft|mrad|mdeg|gon|grad|min|µs|v|mv|ma|counts|digits|lsb|%"
)
"""Units behind names of columns. Nothing is read in those of the second line: they are refused."""
UNIT_IN_NAME = re.compile(
    rf"[\s_]*[\[(]\s*({UNITS})\s*[\])]$"
    r"|_(mm|cm|um|m|inch|deg|rad)$"
    r"|(?:(?<=[xyz])|(?<=reading))_(in)$"
)
"""A unit at the end of a column's name: `X [mm]`, `A(deg)`, `x_mm`, `x_in`.

`laser_in` is the input of a laser.
"""
POSITIONS = (
    *(
        tuple(before + axis for axis in "xyz")
        for before in ("", "t", "p", "pos_", "position.", "pose.position.", "translation.")
    ),
    ("actual_tcp_pose_0", "actual_tcp_pose_1", "actual_tcp_pose_2"),
)
"""What the columns of positions are usually called."""
EULER = re.compile(r"(?!(.)\1|.(.)\2)([xyz]{3}|[XYZ]{3})")
"""Three axes of which neighbours differ."""
ROTATIONS = (
    "xyzw, wxyz, rotvec, matrix, matrix-columns, or Euler angles as SciPy spells them (ZYX, xyz)"
)


@dataclass(frozen=True, slots=True)
class Convention:
    """What the numbers of a pose mean.

    Attributes
    ----------
    rotation : str
        As `ROTATIONS` says.
    units : {"m", "mm", "in"}
    angles : {"rad", "deg"}
        "rad" where there are none.
    columns : tuples of names
        What the columns of the rotation are usually called, in the order of its numbers; of a matrix,
        the columns of the whole pose.
    header : names
        What the columns of the whole pose are called in the file; empty where there is none.
    """

    rotation: str
    units: str = "m"
    angles: str = "rad"
    columns: tuple[tuple[str, ...], ...] = ()
    header: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_word("units", self.units, LENGTHS)
        require_word("angles", self.angles, ANGLES)
        if self.rotation not in (*QUATERNIONS, *MATRICES, "rotvec") and not EULER.fullmatch(
            self.rotation
        ):
            raise InputError(f"rotation {shown(self.rotation)}", ROTATIONS)

    @property
    def is_matrix(self) -> bool:
        """Whether a pose is 12 or 16 numbers."""
        return self.rotation in MATRICES

    @property
    def has_angles(self) -> bool:
        """Whether a rotation is three angles, or an axis times an angle."""
        return self.rotation not in (*QUATERNIONS, *MATRICES)

    @property
    def numbers(self) -> tuple[int, ...]:
        """How many numbers a pose may have."""
        if self.is_matrix:
            return 12, 16  # without the last row (0, 0, 0, 1), or with it
        return (7 if self.rotation in QUATERNIONS else 6,)

    @property
    def meaning(self) -> tuple[str, str, str]:
        """Rotation and units: conventions that share them give the same poses."""
        return self.rotation, self.units, self.angles if self.has_angles else "rad"

    @property
    def words(self) -> str:
        """The meaning for a person."""
        angles = f", {self.angles}" if self.has_angles else ""
        return f"{self.units}{angles}, {self.rotation_words}"

    @property
    def rotation_words(self) -> str:
        """What the numbers of a rotation are, for a person."""
        return ROTATION_WORDS.get(self.rotation, f"angles {self.rotation}")


ROTATION_WORDS = {
    "xyzw": "quaternion x y z w",
    "wxyz": "quaternion w x y z",
    "rotvec": "rotation vector",
    "matrix": "matrix row by row",
    "matrix-columns": "matrix column by column",
}


def _columns(*spellings: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(one.split()) for one in spellings)


def _matrix(by: str) -> tuple[tuple[str, ...], ...]:
    """Return the names of 16 and of 12 numbers, row by row or column by column."""
    found = []
    for rows, first in ((4, 0), (3, 0), (4, 1), (3, 1)):
        cells = [(i, j) for i in range(rows) for j in range(4)]
        if by == "columns":
            cells = [(i, j) for j in range(4) for i in range(rows)]
        found += [tuple(f"{letter}{i + first}{j + first}" for i, j in cells) for letter in "rmt"]
    return tuple(found)


def _counted(*names: str, numbers: tuple[int, ...] = (16, 12)) -> tuple[tuple[str, ...], ...]:
    """Return name[0], name[1], ... as arrays in tables are spelled."""
    return tuple(
        tuple(f"{name}{left}{i}{right}" for i in range(count))
        for name in names
        for count in numbers
        for left, right in (("[", "]"), ("_", ""), (".", ""), ("", ""))
    )


_XYZW = _columns(
    "qx qy qz qw",
    "q_x q_y q_z q_w",
    "orientation.x orientation.y orientation.z orientation.w",
    "pose.orientation.x pose.orientation.y pose.orientation.z pose.orientation.w",
    "rotation.x rotation.y rotation.z rotation.w",
)
_WXYZ = _columns("q1 q2 q3 q4", "qw qx qy qz", "q_w q_x q_y q_z")
_ABC, _R_XYZ = _columns("a b c"), _columns("rx ry rz", "r_x r_y r_z")
_RTDE = _columns("actual_tcp_pose_3 actual_tcp_pose_4 actual_tcp_pose_5")
_MM_DEG = ("mm", "deg")

FORMATS: dict[str, Convention] = {
    "ros": Convention("xyzw", columns=_XYZW),
    "tum": Convention("xyzw", columns=_XYZW),
    "kuka": Convention("ZYX", *_MM_DEG, _ABC),
    "abb": Convention("wxyz", "mm", columns=_WXYZ),
    "abb-euler": Convention("ZYX", *_MM_DEG, _columns("rz ry rx", "ez ey ex")),
    "fanuc": Convention("xyz", *_MM_DEG, _columns("w p r")),
    **dict.fromkeys(("yaskawa", "denso"), Convention("xyz", *_MM_DEG, _R_XYZ)),
    "mitsubishi": Convention("xyz", *_MM_DEG, _ABC),
    **dict.fromkeys(
        ("tm", "jaka", "aubo", "omron", "dobot", "hyundai", "elite"),
        Convention("xyz", *_MM_DEG, _R_XYZ),
    ),
    "ur": Convention("rotvec", "m", "rad", (*_R_XYZ, *_RTDE)),
    "staubli": Convention("XYZ", *_MM_DEG, _R_XYZ),
    "kawasaki": Convention("ZYZ", *_MM_DEG, _columns("o a t")),
    "doosan": Convention("ZYZ", *_MM_DEG, (*_ABC, *_R_XYZ)),
    "comau": Convention("ZYZ", *_MM_DEG, _columns("a e r")),
    "nachi": Convention("ZYX", *_MM_DEG, _columns("roll pitch yaw")),
    "epson": Convention("ZYX", *_MM_DEG, _columns("u v w")),
    "estun": Convention("ZYX", *_MM_DEG, _ABC),
    "franka": Convention(
        "matrix-columns", columns=_counted("o_t_ee", "state.o_t_ee", numbers=(16,))
    ),
    "urdf-rpy": Convention("xyz", "m", "rad", _columns("roll pitch yaw", "r p y")),
    "matrix": Convention(
        "matrix", columns=(*_matrix("rows"), *_counted("t", "m", "pose", "matrix"))
    ),
}
"""Every pose format by its name: the table of this package."""


def formats_of(meaning: tuple[str, str, str]) -> list[str]:
    """Return the names of all formats of a meaning."""
    return [name for name, one in FORMATS.items() if one.meaning == meaning]


def called(convention: Convention) -> str:
    """Return the options that state a convention of a file with its header.

    They are the name of a format, with its units where these are others, or all is spelled out; and the
    columns, where nothing else finds them.
    """
    alike = [name for name, one in FORMATS.items() if finds(one, convention.header)]
    names = [name for name in formats_of(convention.meaning) if name in alike]
    if names:
        others = f" (as {', '.join(names[1:])})" if names[1:] else ""
        return f"--pose-format {names[0]}{others}"
    units = f" --units {convention.units}"
    angles = f" --angles {convention.angles}" if convention.has_angles else ""
    base = next((name for name in alike if FORMATS[name].rotation == convention.rotation), None)
    if base is not None:
        known = FORMATS[base]
        units = units if known.units != convention.units else ""
        angles = angles if known.angles != convention.angles else ""
        return f"--pose-format {base}{units}{angles}"
    words = f"--rotation {convention.rotation}{units}{angles}"
    spelled = Convention(convention.rotation, columns=spelled_columns(convention.rotation))
    if not finds(spelled, convention.header):
        words += f" --pose-columns {shlex.quote(','.join(convention.header))}"
    return words


def finds(convention: Convention, header: tuple[str, ...]) -> bool:
    """Tell whether a file with a header has the columns of a convention; any, where none is known."""
    names = tuple(map(plain, header))
    if not names or (convention.is_matrix and names in convention.columns):
        return True
    return names[:3] in POSITIONS and names[3:] in convention.columns


def plain(name: str) -> str:
    """Return a column's name in lower case without a unit."""
    return UNIT_IN_NAME.sub("", name.strip().lower()).strip()


def spelled_columns(rotation: str) -> tuple[tuple[str, ...], ...]:
    """Return what the columns of a rotation that is spelled out are called."""
    if rotation in QUATERNIONS:
        return _columns(" ".join(f"q{axis}" for axis in rotation))
    if rotation in MATRICES:
        by = "rows" if rotation == "matrix" else "columns"
        return _matrix(by)
    if rotation == "rotvec":
        return _R_XYZ
    if len(set(rotation.lower())) == len(rotation):
        return _columns(" ".join(f"r{axis}" for axis in rotation.lower()))
    return ()


def poses_of(x: FloatArray, convention: Convention) -> tuple[FloatArray, FloatArray]:
    """Return rotations (M, 3, 3) and positions (M, 3) [m] of the numbers x (M, k) of poses.

    The numbers have no fault; rotations that are nearly orthonormal are made so.
    """
    length = LENGTHS[convention.units]
    if convention.is_matrix:
        T = matrices(x, convention)
        return nearest_rotation(T[:, :3, :3]), length * T[:, :3, 3]
    turn, kind, angle = x[:, 3:], convention.rotation, ANGLES[convention.angles]
    if kind in QUATERNIONS:
        rotation = Rotation.from_quat(turn, scalar_first=kind == "wxyz")
    elif kind == "rotvec":
        rotation = Rotation.from_rotvec(angle * turn)
    else:
        rotation = Rotation.from_euler(kind, angle * turn)
    return rotation.as_matrix(), length * x[:, :3]


def numbers_of(R: FloatArray, t: FloatArray, convention: Convention) -> FloatArray:
    """Return the numbers (M, k) of rotations (M, 3, 3) and positions (M, 3) [m]: `poses_of` undone."""
    kind, length, angle = convention.rotation, LENGTHS[convention.units], ANGLES[convention.angles]
    rotation = Rotation.from_matrix(R)
    if convention.is_matrix:
        T = np.tile(np.eye(4), (len(R), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R, t / length
        return (np.swapaxes(T, 1, 2) if kind == "matrix-columns" else T).reshape(-1, 16)
    if kind in QUATERNIONS:
        turn = rotation.as_quat(canonical=True, scalar_first=kind == "wxyz")
    elif kind == "rotvec":
        turn = rotation.as_rotvec() / angle
    else:
        with warnings.catch_warnings():
            # Of gimbal lock, where the third angle is free, and zero.
            warnings.simplefilter("ignore")
            turn = rotation.as_euler(kind) / angle  # type: ignore[call-overload]  # checked above
    return np.hstack((t / length, turn))


def matrices(x: FloatArray, convention: Convention) -> FloatArray:
    """Return homogeneous matrices (M, 4, 4) of the 12 or 16 numbers of each pose."""
    rows = x.shape[1] // 4
    by_columns = convention.rotation == "matrix-columns"
    T = np.tile(np.eye(4), (len(x), 1, 1))
    T[:, :rows] = (
        np.swapaxes(x.reshape(-1, 4, rows), 1, 2) if by_columns else x.reshape(-1, rows, 4)
    )
    return T


def inverted(R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse of poses (M, 3, 3), (M, 3)."""
    S = np.swapaxes(R, 1, 2)
    return S, -np.einsum("mij,mj->mi", S, t)
