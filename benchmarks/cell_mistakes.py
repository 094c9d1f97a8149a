"""Recordings of a cell with one plausible mistake each: which wrong results are silent.

    python -m benchmarks.cell_mistakes [--seeds 10] [--jobs 2] [--only NAME ...] [--rig FILE]

Every recording has 2 to 4 plates, 13 to 16 stations before each and 2 to 4 triangulation sensors that
read 40 to 170 mm. The formulas share nothing with the package. The recording goes through a file, as
at a cell, and is calibrated with nothing given but the kind of sensor unless `--rig` says more.

    refused    an error message instead of a result
    unusable   the verdict says that the result is not to be used
    care       usable, with warnings
    silent     usable, without any warning
    wrong      a laser spot amid the range is farther from its true place than 5 of its stated standard
               deviations, and than the verdict says that may hide
    wrong and silent: what must not be
    named      the error message or the headline names the cause
"""

import argparse
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.results.spots import spot_at
from handlaser_gtsam.results.verdict import verdict

OUTCOMES = "refused", "unusable", "care", "silent"
MOST_SIGMAS = 5.0
"""A spot farther from its true place than so many of its standard deviations is wrong."""
RANGE_SIGMA, POSITION_SIGMA, TURN_SIGMA = 2e-5, 4e-5, np.radians(0.008)
"""Noise of a reading [m], and of a hand pose along [m] and about [rad] each axis."""


@dataclass
class Cell:
    """A cell, true and as recorded; a mistake changes it before or after the readings are taken.

    Attributes
    ----------
    rng : Generator
    r, v : (B, 3)
        Locations [m] and directions of the beams in the hand frame.
    k : (B, 2)
        Range errors k1 and k2 [1/m].
    plane : (M,)
        The plate before which each station stands.
    n, h : (M, 3), (M,)
        Normal and offset of the plate at each station: its points x have n . x = h [m].
    R, t : (M, 3, 3), (M, 3)
        Where the hand is.
    recorded_R, recorded_t : as R and t
        Where the recording says it is.
    d : (M, B)
        Readings [m].
    tangent : (M, B)
        Tangent of the angle of incidence.
    labels : M strings
    """

    rng: np.random.Generator
    r: FloatArray
    v: FloatArray
    k: FloatArray
    plane: IntArray
    n: FloatArray
    h: FloatArray
    R: FloatArray
    t: FloatArray
    recorded_R: FloatArray = field(init=False)
    recorded_t: FloatArray = field(init=False)
    d: FloatArray = field(init=False)
    tangent: FloatArray = field(init=False)
    labels: list[str] = field(init=False)

    @property
    def stations(self) -> int:
        """How many there are."""
        return len(self.plane)

    @property
    def late(self) -> np.ndarray:
        """Whether a station belongs to the second half (M,)."""
        return np.arange(self.stations) >= self.stations // 2

    @property
    def time(self) -> FloatArray:
        """From 0 at the first station to 1 at the last (M,)."""
        return np.linspace(0.0, 1.0, self.stations)

    def record_poses(self) -> None:
        """Record the poses with the errors of a robot."""
        turn = Rotation.from_rotvec(TURN_SIGMA * self.rng.standard_normal((self.stations, 3)))
        self.recorded_R = self.R @ turn.as_matrix()
        self.recorded_t = self.t + POSITION_SIGMA * self.rng.standard_normal((self.stations, 3))
        self.labels = [chr(ord("A") + p) for p in self.plane]

    def read(self) -> None:
        """Take the readings: d + k1 d + k2 d^2 is the distance to the plate, and noise is added."""
        origin = self.t[:, None] + np.einsum("mij,bj->mbi", self.R, self.r)
        ray = np.einsum("mij,bj->mbi", self.R, self.v)
        cosine = np.einsum("mi,mbi->mb", self.n, ray)
        distance = (self.h[:, None] - np.einsum("mi,mbi->mb", self.n, origin)) / cosine
        self.tangent = np.sqrt(1.0 - cosine**2) / np.abs(cosine)
        d = distance.copy()
        for _ in range(30):  # a contraction: |k1 + 2 k2 d| is some hundredths
            d = distance - self.k[:, 0] * d - self.k[:, 1] * d**2
        self.d = d + RANGE_SIGMA * self.rng.standard_normal(d.shape)

    def spots(self) -> FloatArray:
        """Return where the hand's points before each plate are: on the plate, by station (M, 3)."""
        ray = self.R @ np.array([0.0, 0.0, 1.0])
        along = (self.h - np.einsum("mi,mi->m", self.n, self.t)) / np.einsum(
            "mi,mi->m", self.n, ray
        )
        found: FloatArray = self.t + along[:, None] * ray
        return found


def make_cell(seed: int) -> Cell:
    """Return a cell with the poses of its stations, nothing recorded yet."""
    rng = np.random.default_rng(seed)
    beams, plates = int(rng.integers(2, 5)), int(rng.integers(2, 5))
    angle = 2.0 * np.pi * (np.arange(beams) + rng.uniform()) / beams
    r = np.column_stack((0.03 * np.cos(angle), 0.03 * np.sin(angle), rng.uniform(0, 0.02, beams)))
    v = np.column_stack((rng.uniform(-0.15, 0.15, (beams, 2)), np.ones(beams)))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    k = rng.standard_normal((beams, 2)) * [0.003, 0.02]
    plane = np.repeat(np.arange(plates), rng.integers(13, 17, plates))
    down = Rotation.from_euler("xy", [np.pi, 0.0])  # the hand looks along -z of the world
    tilt = np.column_stack((rng.uniform(-0.5, 0.5, (plates, 2)), np.zeros(plates)))
    faces = Rotation.from_rotvec(tilt) * down
    n = faces.apply([0.0, 0.0, 1.0])  # away from the hand
    foot = np.array([0.6, 0.0, 0.2]) + rng.uniform(-0.15, 0.15, (plates, 3))
    count = len(plane)
    lean = Rotation.from_euler(
        "zxy", np.column_stack((rng.uniform(-0.8, 0.8, count), rng.uniform(-0.4, 0.4, (count, 2))))
    )
    hand = faces[plane] * lean
    shift = np.column_stack(
        (rng.uniform(-0.06, 0.06, (count, 2)), -rng.uniform(0.075, 0.145, count))
    )
    t = foot[plane] + faces[plane].apply(shift)
    h = np.einsum("pi,pi->p", n, foot)
    return Cell(rng, r, v, k, plane, n[plane], h[plane], hand.as_matrix(), t)


Mistake = Callable[[Cell], None]


def nothing(_: Cell) -> None:
    """Change nothing."""


def tool(turn_deg: float, shift_mm: float, share: Callable[[Cell], FloatArray]) -> Mistake:
    """Move the hand in its own frame, by a share of a turn and a shift along one random axis."""

    def change(cell: Cell) -> None:
        axis = cell.rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        part = share(cell)[:, None]
        cell.t = cell.t + np.einsum("mij,mj->mi", cell.R, 1e-3 * shift_mm * part * axis)
        cell.R = cell.R @ Rotation.from_rotvec(np.radians(turn_deg) * part * axis).as_matrix()

    return change


def turned(change: Callable[[Rotation], Rotation]) -> Mistake:
    """Write the rotations in another way."""

    def mistake(cell: Cell) -> None:
        cell.recorded_R = change(Rotation.from_matrix(cell.recorded_R)).as_matrix()

    return mistake


def scaled(positions: float, ranges: float) -> Mistake:
    """Give positions and ranges another unit."""

    def mistake(cell: Cell) -> None:
        cell.recorded_t, cell.d = positions * cell.recorded_t, ranges * cell.d

    return mistake


def longer(error: Callable[[Cell], FloatArray]) -> Mistake:
    """Make readings longer by an error [m]."""

    def mistake(cell: Cell) -> None:
        cell.d = cell.d + error(cell)

    return mistake


def invert(cell: Cell) -> None:
    """Give the poses of the world in the hand."""
    cell.recorded_R = np.swapaxes(cell.recorded_R, 1, 2)
    cell.recorded_t = -np.einsum("mij,mj->mi", cell.recorded_R, cell.recorded_t)


def mirror(sign: Sequence[float], order: Sequence[int] = (0, 1, 2)) -> Mistake:
    """Give the coordinates of positions other signs, or another order."""

    def mistake(cell: Cell) -> None:
        cell.recorded_t = cell.recorded_t[:, list(order)] * np.asarray(sign)

    return mistake


def exchange(where: Callable[[Cell], np.ndarray]) -> Mistake:
    """Exchange two sensors at some stations."""

    def mistake(cell: Cell) -> None:
        rows = where(cell)
        cell.d[rows, :2] = cell.d[rows, 1::-1]

    return mistake


def relabel(change: Callable[[Cell, int], str]) -> Mistake:
    """Give stations other labels."""

    def mistake(cell: Cell) -> None:
        cell.labels = [change(cell, m) for m in range(cell.stations)]

    return mistake


def exchange_labels(cell: Cell) -> None:
    """Visit the plates in turn, and exchange the labels A and B in the second half."""
    order = np.argsort(
        np.concatenate([np.arange(n) for n in np.bincount(cell.plane)]), kind="stable"
    )
    cell.recorded_R, cell.recorded_t = cell.recorded_R[order], cell.recorded_t[order]
    cell.d, cell.labels = cell.d[order], [cell.labels[m] for m in order]
    other = {"A": "B", "B": "A"}
    cell.labels = [
        other.get(label, label) if late else label
        for label, late in zip(cell.labels, cell.late, strict=True)
    ]


def move_plate(shift_mm: float, turn_deg: float) -> Mistake:
    """Move the first plate before the second half of its stations."""

    def mistake(cell: Cell) -> None:
        own = np.flatnonzero(cell.plane == 0)
        late = own[len(own) // 2 :]
        foot = cell.spots()[own].mean(axis=0)
        n = Rotation.from_euler("x", turn_deg, degrees=True).apply(cell.n[late])
        cell.n[late], cell.h[late] = n, n @ foot + 1e-3 * shift_mm

    return mistake


def sag(size_mm: float, both: bool) -> Mistake:
    """Bend the plates: edges are farther away by a parabola, along one axis or both."""

    def mistake(cell: Cell) -> None:
        spots = cell.spots()
        for p in np.unique(cell.plane):
            own = cell.plane == p
            rest = spots[own] - spots[own].mean(axis=0)
            square = (rest**2).sum(axis=1) if both else rest[:, 0] ** 2
            cell.h[own] = cell.h[own] + 1e-3 * size_mm * square / square.max()

    return mistake


def average_on_the_way(cell: Cell) -> None:
    """Take each reading a tenth of the way to the next station."""
    way = np.roll(cell.t, -1, axis=0) - cell.t
    following = Rotation.from_matrix(np.roll(cell.R, -1, axis=0))
    turn = (Rotation.from_matrix(cell.R).inv() * following).as_rotvec()
    same = (cell.plane == np.roll(cell.plane, -1))[:, None]
    cell.t = cell.t + 0.1 * same * way
    cell.R = cell.R @ Rotation.from_rotvec(0.1 * same * turn).as_matrix()


def one_row_late(cell: Cell) -> None:
    """Give each row the readings of the row before."""
    cell.d = np.roll(cell.d, 1, axis=0)


def slip(cell: Cell) -> None:
    """Lose one row of readings, so that those of the second half belong one row later."""
    rows = np.flatnonzero(cell.late)
    cell.d[rows[:-1]] = cell.d[rows[1:]]


def carry_over(cell: Cell) -> None:
    """Let each channel of a converter keep 1.5 % of the one before it."""
    cell.d = cell.d + 0.015 * (np.roll(cell.d, 1, axis=1) - cell.d)


def freeze(cell: Cell) -> None:
    """Let one sensor repeat its reading four times."""
    first = cell.stations // 3
    cell.d[first : first + 4, 0] = cell.d[first, 0]


def gross(share: float) -> Mistake:
    """Make some readings anything."""

    def mistake(cell: Cell) -> None:
        wrong = cell.rng.uniform(size=cell.d.shape) < share
        cell.d[wrong] = cell.rng.uniform(0.04, 0.17, int(wrong.sum()))

    return mistake


def edge(cell: Cell) -> None:
    """Let every twentieth reading miss the plate by 3 mm."""
    cell.d[cell.rng.uniform(size=cell.d.shape) < 0.05] += 3e-3


def arm_errors(cell: Cell) -> None:
    """Give the poses errors that are smooth functions of where the hand is, as a wrong model does."""
    x = (cell.t - cell.t.mean(axis=0)) / 0.2
    warp, twist = cell.rng.standard_normal((3, 3)), cell.rng.standard_normal((3, 3))
    cell.recorded_t = cell.recorded_t + 3e-4 * np.sin(x @ warp)
    turn = Rotation.from_rotvec(np.radians(0.04) * np.sin(x @ twist))
    cell.recorded_R = cell.recorded_R @ turn.as_matrix()


def bracket(cell: Cell) -> None:
    """Bend the bracket of the sensors by 0.2 mm as it turns against gravity."""
    gravity = cell.R[:, 2, :]
    cell.t = cell.t + np.einsum("mij,mj->mi", cell.R, 2e-4 * (gravity - gravity.mean(axis=0)))


def backlash(cell: Cell) -> None:
    """Stop the hand 0.1 mm behind where it came from."""
    way = np.diff(cell.t, axis=0, prepend=cell.t[:1] - 1e-3)
    cell.t = cell.t - 1e-4 * way / np.linalg.norm(way, axis=1, keepdims=True)


def inverted_output(cell: Cell) -> None:
    """Let a sensor give its full scale less the range."""
    cell.d[:, 0] = 0.22 - cell.d[:, 0]


def copy_channel(cell: Cell) -> None:
    """Log a channel twice."""
    cell.d[:, 1] = cell.d[:, 0]


def in_part(rows: Callable[[Cell], np.ndarray], factor: float) -> Mistake:
    """Give the ranges of some stations another unit."""

    def mistake(cell: Cell) -> None:
        cell.d[rows(cell)] *= factor

    return mistake


def round_poses(cell: Cell) -> None:
    """Round as a teach pendant does, to 0.1 mm and 0.1 degrees."""
    cell.recorded_t = np.round(cell.recorded_t, 4)
    angles = Rotation.from_matrix(cell.recorded_R).as_euler("ZYX", degrees=True)
    cell.recorded_R = Rotation.from_euler("ZYX", np.round(angles, 1), degrees=True).as_matrix()


def wrong_base(cell: Cell) -> None:
    """Displace the base of the robot amid the first plate."""
    own = np.flatnonzero(cell.plane == 0)
    rest = np.arange(cell.stations) >= own[len(own) // 2]
    cell.recorded_t = cell.recorded_t + rest[:, None] * np.array([8e-4, -6e-4, 5e-4])


BEFORE: dict[str, tuple[Mistake, str]] = {
    "tool-steps-0.5mm": (tool(0.0, 0.5, lambda c: c.late * 1.0), "tool"),
    "tool-turns-0.1deg": (tool(0.1, 0.0, lambda c: c.late * 1.0), "tool"),
    "tool-creeps-0.5mm": (tool(0.0, 0.5, lambda c: c.time), "tool|drift"),
    "tool-wrong-throughout": (nothing, ""),
    "plate-moves-0.5mm": (move_plate(0.5, 0.0), "of plane|moved"),
    "plate-turns-0.3deg": (move_plate(0.0, 0.3), "of plane|moved|curv"),
    "plate-moves-20mm": (move_plate(20.0, 2.0), "of plane|moved|another plane"),
    "plates-sag-0.3mm": (sag(0.3, both=True), "sag|bend|curv"),
    "plates-bend-one-way-0.3mm": (sag(0.3, both=False), "sag|bend|curv"),
    "read-on-the-way": (average_on_the_way, "of the way"),
    "bracket-bends": (bracket, ""),
    "backlash": (backlash, ""),
}
"""Mistakes of the world, and what names them: before the readings are taken."""
AFTER: dict[str, tuple[Mistake, str]] = {
    "none": (nothing, ""),
    "everything-in-mm": (scaled(1e3, 1e3), "millimet"),
    "positions-in-mm": (scaled(1e3, 1.0), "millimet"),
    "ranges-in-mm": (scaled(1.0, 1e3), "millimet"),
    "ranges-in-inches": (scaled(1.0, 1.0 / 0.0254), "inch|unit"),
    "poses-inverted": (invert, "inverted"),
    "rotations-inverted": (turned(Rotation.inv), "inverted"),
    "quaternions-scalar-first": (
        turned(lambda R: Rotation.from_quat(np.roll(R.as_quat(), 1, axis=1))),
        "quaternion w x y z",
    ),
    "angles-exchanged": (turned(lambda R: Rotation.from_euler("xyz", R.as_euler("ZYX"))), "angle"),
    "axis-negated": (mirror([-1, 1, 1]), "sign|negat|mirror|left-handed"),
    "two-axes-exchanged": (mirror([1, 1, 1], [1, 0, 2]), "exchanged|swapped"),
    "sensors-exchanged-one-plate": (exchange(lambda c: c.plane == 1), "exchanged|swapped"),
    "sensors-exchanged-from-middle": (exchange(lambda c: c.late), "exchanged|swapped"),
    "sensors-exchanged-four-stations": (
        exchange(lambda c: (c.time > 0.5) & (np.arange(c.stations) < c.stations // 2 + 5)),
        "",
    ),
    "output-inverted": (inverted_output, "invert|other side|two sides|sign|negat"),
    "channel-twice": (copy_channel, "twice"),
    "unit-changes-half-way": (in_part(lambda c: c.late, 1e3), "millimet|unit"),
    "unit-changes-to-inches": (in_part(lambda c: c.late, 1.0 / 0.0254), "inch|unit"),
    "labels-exchanged-from-middle": (exchange_labels, "label"),
    "two-plates-one-label": (
        relabel(lambda c, m: chr(ord("A") + max(int(c.plane[m]) - 1, 0))),
        "label|another plane",
    ),
    "label-late-by-one": (relabel(lambda c, m: chr(ord("A") + int(c.plane[max(m - 1, 0)]))), ""),
    "label-late-by-three": (relabel(lambda c, m: chr(ord("A") + int(c.plane[max(m - 3, 0)]))), ""),
    "one-label-wrong": (
        relabel(lambda c, m: chr(ord("A") + (int(c.plane[m]) + (m == 5)) % (c.plane.max() + 1))),
        "",
    ),
    "rows-late-by-one": (one_row_late, "late|lag|row|fit"),
    "rows-slip-half-way": (slip, "late|lag|row|fit"),
    "carry-over-1.5%": (carry_over, ""),
    "warm-up-0.3mm": (longer(lambda c: -3e-4 * np.exp(-8.0 * c.time)[:, None]), "drift|warm"),
    "drift-0.3mm": (longer(lambda c: 3e-4 * c.time[:, None]), "drift"),
    "incidence-0.5mm": (longer(lambda c: 5e-4 * c.tangent**2), ""),
    "tilt-6um-per-deg": (longer(lambda c: 6e-6 * np.degrees(np.arctan(c.tangent))), ""),
    "cubic-0.2mm": (longer(lambda c: 2e-4 * (c.d / c.d.max()) ** 3), ""),
    "ripple-0.1mm": (longer(lambda c: 1e-4 * np.sin(2 * np.pi * c.d / 0.03)), ""),
    "shiny-plate-0.3mm": (longer(lambda c: 3e-4 * (c.plane == 0)[:, None]), ""),
    "one-beam-shiny-0.3mm": (
        longer(lambda c: 3e-4 * ((c.plane == 0)[:, None] & (np.arange(c.d.shape[1]) == 0))),
        "bias|reads|on plane",
    ),
    "readings-0.1mm": (lambda c: setattr(c, "d", np.round(c.d, 4)), ""),
    "readings-1mm": (lambda c: setattr(c, "d", np.round(c.d, 3)), ""),
    "poses-rounded": (round_poses, ""),
    "clipped-at-120mm": (lambda c: setattr(c, "d", np.minimum(c.d, 0.12)), "range|end|code|repeat"),
    "frozen-four-times": (freeze, ""),
    "gross-3%": (gross(0.03), ""),
    "gross-15%": (gross(0.15), ""),
    "plate-edge-5%": (edge, ""),
    "arm-model-0.3mm": (arm_errors, ""),
    "positions-scaled-0.3%": (scaled(1.003, 1.0), ""),
    "turns-scaled-0.3%": (
        turned(lambda R: R.mean() * Rotation.from_rotvec(1.003 * (R.mean().inv() * R).as_rotvec())),
        "",
    ),
    "base-displaced-1mm": (wrong_base, "of plane|moved"),
}
"""Mistakes of the recording, and what names them: after the readings are taken. What is named by
nothing has several causes that look alike, or does no harm."""


@dataclass(frozen=True, slots=True)
class Row:
    """What became of one recording; `sigmas` and `error` [m] are those of its worst spot."""

    name: str
    seed: int
    outcome: str
    wrong: bool
    named: bool
    sigmas: float
    error: float
    headline: str


def judge(argument: tuple[str, int], rig: Path | None) -> Row:
    """Make a recording with a mistake, calibrate it, and compare with the truth."""
    name, seed = argument
    cell = make_cell(seed)
    mistake, pattern = (BEFORE | AFTER)[name]
    cell.record_poses()  # of where the robot believes it is
    if name in BEFORE:
        mistake(cell)
    cell.read()
    if name in AFTER:
        mistake(cell)
    beams = [str(i + 1) for i in range(len(cell.r))]
    try:
        result, judged = _calibrate(cell, beams, rig)
    except hl.HandlaserError as refusal:
        words = str(refusal)
        return Row(name, seed, "refused", False, _names(pattern, words), 0.0, 0.0, words)
    outcome = "unusable" if not judged.usable else "care" if result.warnings else "silent"
    sigmas, error = _distance(cell, result, judged.reading)
    stated = (judged.spot_error or 0.0) + (judged.hidden_error or 0.0)
    wrong = sigmas > MOST_SIGMAS and error > stated
    return Row(
        name, seed, outcome, wrong, _names(pattern, judged.sentence), sigmas, error, judged.sentence
    )


def _calibrate(cell: Cell, beams: list[str], rig: Path | None):  # type: ignore[no-untyped-def]
    """Write the recording, read it as the command does, and calibrate it."""
    quaternions = Rotation.from_matrix(cell.recorded_R).as_quat()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        lines = ["plane,x,y,z,qx,qy,qz,qw," + ",".join(f"range_{beam}" for beam in beams)]
        for label, t, q, d in zip(cell.labels, cell.recorded_t, quaternions, cell.d, strict=True):
            lines.append(",".join([label, *(f"{value:.9g}" for value in (*t, *q, *d))]))
        path.write_text("\n".join(lines) + "\n")
        recording = hl.read_recording(path)
    known = (
        hl.files.Rig(sensor=hl.Sensor(kind="triangulation")) if rig is None else hl.read_rig(rig)
    )
    result = hl.calibrate(recording, known.noise, hl.CalibrationOptions(sensor=known.sensor))
    return result, verdict(result, known.limits)


def _distance(cell: Cell, result: hl.Calibration, reading: float) -> tuple[float, float]:
    """Return how far the worst spot is off, in its standard deviations and in metres."""
    sigmas, errors = [0.0], [0.0]
    for i, beam in enumerate(result.beams.values()):
        if beam.covariance is None:
            continue
        try:
            x, J, _ = spot_at(result, beam, reading)
        except hl.HandlaserError:
            continue
        g = reading * (1.0 + cell.k[i, 0] + cell.k[i, 1] * reading)
        error = float(np.linalg.norm(x - cell.r[i] - g * cell.v[i]))
        sigma = float(np.sqrt(np.linalg.eigvalsh(J @ beam.covariance @ J.T).max()))
        sigmas.append(error / sigma)
        errors.append(error)
    return max(sigmas), max(errors)


def _names(pattern: str, text: str) -> bool:
    return bool(pattern) and re.search(pattern, text) is not None


def main() -> None:
    """Run the study and print a row a mistake."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="+", default=sorted(BEFORE | AFTER))
    parser.add_argument("--rig", type=Path, help="a rig file that says what is known")
    parser.add_argument("--words", action="store_true", help="print the headlines")
    add_options(parser)
    arguments = parser.parse_args()
    jobs = [(name, seed) for name in arguments.only for seed in range(arguments.seeds)]
    with Studies.of(arguments) as studies:
        rows = studies.each("recordings", partial(judge, rig=arguments.rig), jobs)
    print(f"{'mistake':32} refused unusable care silent | wrong silent-wrong care-wrong | named")
    for name in arguments.only:
        own = [row for row in rows if row.name == name]
        count = {key: sum(row.outcome == key for row in own) for key in OUTCOMES}
        wrong = [row for row in own if row.wrong]
        silent = sum(row.outcome == "silent" for row in wrong)
        care = sum(row.outcome == "care" for row in wrong)
        named = f"{sum(row.named for row in own)}" if (BEFORE | AFTER)[name][1] else "-"
        print(
            f"{name:32} "
            + " ".join(f"{count[key]:{max(len(key), 4)}}" for key in OUTCOMES)
            + f" | {len(wrong):5} {silent:12} {care:10} | {named:>5}"
        )
        if arguments.words:
            for row in own:
                off = f"{row.sigmas:.1f} sigma, {1e3 * row.error:.2f} mm"
                print(f"    {row.seed} {row.outcome}, {off}: {row.headline}")


if __name__ == "__main__":
    main()
