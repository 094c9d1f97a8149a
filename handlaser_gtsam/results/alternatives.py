r"""Systematic errors that the model leaves out, each as a column of derivatives.

A column is the derivative of the residuals e = s - g(d) (`model`) by the size of the error, at zero.
Errors that concern all readings are `whole_columns`, one a column. Errors local to one plane come
in families: a column for all readings, and for every member the rows in which it counts.

With n the normal that points away from the sensor and c = -1 / (n_H . v), a surface that lies h
farther along n changes e by c h, a reading that is f too long by -g'(d) f, and a true hand pose
that is xi beside the recorded one by -J xi. Positive sizes: readings too long (`incidence`, `cubic`,
`beam-on-plane`), or longer and longer (`drift`); edges of the plate farther from the sensor than its
middle (`sag`); a plane farther away (`displaced`); true poses ahead in time (`lag`); true turns and
translations larger than reported. A cubic error is a function of the reading itself, not of the
true range: it is the next term of g.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..parameters import Parameters
from ..recording import Readings
from ..solvers.reduction import (
    NormalEquations,
    jacobian_columns,
    normal_equations,
    whitened_normal_equations,
)
from ..weighting import Whitening, slopes

WHOLE = ("incidence", "cubic", "sag", "lag", "drift", "turn-scale", "translation-scale")
"""Codes of the errors that concern all readings, in the order of `whole_columns`."""
LEAST_STATIONS = 2
"""A plane is taken as displaced only where it has so many stations before and after."""
WIDTH = 7
"""Unknowns of a beam: location, direction, k1 and k2."""
ROUNDING = 1e-14
"""Information below this part of the largest is lost in rounding."""
MOST_SPLITS = 32
"""A plane with more splits is tested at so many, evenly spaced: neighbours hardly differ."""


@dataclass(frozen=True, slots=True)
class Family:
    """Errors of one kind that are local to a plane.

    Attributes
    ----------
    code : str
    column : (N,)
        Derivative of the residuals, as if the error were everywhere.
    plane, beam, position : (m,)
        Of every member: its plane, the one beam it concerns (-1 for all), and the position in the
        recording of the first station it concerns.
    first, last : (m, B)
        The rows [first, last) of every beam in which it counts, in the order `rows`.
    rows : (N,)
        The readings by plane, beam and position.
    """

    code: str
    column: FloatArray
    plane: IntArray
    beam: IntArray
    position: IntArray
    first: IntArray
    last: IntArray
    rows: IntArray

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        values = (self.column[:, None] * y)[self.rows]
        if (self.beam < 0).all():
            return np.asarray(_range_sums(values, self.first, self.last).sum(axis=1))
        own = (np.arange(len(self.beam)), self.beam)
        return _range_sums(values, self.first[own], self.last[own])

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        column = np.zeros_like(self.column)
        beams = range(self.first.shape[1]) if self.beam[member] < 0 else [int(self.beam[member])]
        for beam in beams:
            rows = self.rows[self.first[member, beam] : self.last[member, beam]]
            column[rows] = self.column[rows]
        return column

    def products(self, rows: "Rows") -> tuple[FloatArray, FloatArray]:
        """Return sums over members times sigma^2 inv(C): with the rows of J, and with themselves.

        The first are (m, B, 10), beam by beam; the second the squares (m,) of the whitened columns.
        """
        sums = np.zeros((*self.first.shape, rows.J.shape[1]))
        squares = np.zeros(len(self.beam))
        for beam in np.unique(self.beam).tolist():
            members = np.flatnonzero(self.beam == beam)
            own = self.column if beam < 0 else self.column * (rows.readings.beam == beam)
            heavy = weighed(rows.how, own[:, None])
            values = np.hstack((rows.J * heavy, own[:, None] * heavy))[self.rows]
            found = _range_sums(values, self.first[members], self.last[members])
            sums[members] = found[:, :, :-1]
            squares[members] = found[:, :, -1].sum(axis=1)
        return sums, squares


def weighed(how: Whitening, columns: FloatArray) -> FloatArray:
    """Return sigma^2 inv(C) times columns (N, q)."""
    grid = np.zeros((*how.root.shape[:2], columns.shape[1]))
    grid[how.station, how.beam] = columns
    product: FloatArray = how.root @ (how.root @ grid)
    return product[how.station, how.beam]


def whole_columns(at: Parameters, readings: Readings, position: IntArray) -> FloatArray:
    """Return the columns (N, 7) of the errors `WHOLE`.

    Parameters
    ----------
    at : Parameters
    readings : Readings
    position : (N,)
        Order in time of each reading's station.
    """
    x, d = model.scene(at, readings), readings.distance
    found = model.linearize(x, d, with_pose=True)
    longer = -slopes(at, readings)
    tangent_square = 1.0 / model.cosines(x) ** 2 - 1.0
    spot = found.normal / found.offset[:, None]
    square = ((spot - readings.plane_means(spot)[readings.plane]) ** 2).sum(axis=1)
    poses = pose_errors(readings, position)
    return np.column_stack(
        (
            longer * tangent_square,
            longer * (d / d.max()) ** 3,
            found.offset * square / max(float(square.max()), 1e-300),
            *(-np.einsum("ni,nik->kn", found.pose, poses[:, :, :1])),
            longer * (position / max(int(position.max()), 1) - 0.5),
            *(-np.einsum("ni,nik->kn", found.pose, poses[:, :, 1:])),
        )
    )


def pose_errors(readings: Readings, position: IntArray) -> FloatArray:
    """Return (omega, u) (N, 6, 3) of the hand poses for a lag, a turn scale and a translation scale.

    The lag of one step is half the way from the previous station of the plane to the next, or the
    whole way to or from the neighbour at the ends; turns count from the mean orientation, and
    translations from the origin of the plane's frame, in which a shift is that of the plane.
    """
    _, row, station = np.unique(readings.station, return_index=True, return_inverse=True)
    R, t = readings.world_R_hand[row], readings.world_t_hand[row]
    order = np.lexsort((position[row], readings.plane[row]))
    plane = readings.plane[row][order]
    same = np.flatnonzero(plane[1:] == plane[:-1])
    before, after = order.copy(), order.copy()
    before[same + 1], after[same] = order[same], order[same + 1]
    steps = np.maximum((before != order).astype(int) + (after != order), 1)[:, None]
    errors = np.zeros((len(row), 6, 3))
    turn = Rotation.from_matrix(np.swapaxes(R[before], 1, 2) @ R[after]).as_rotvec()
    errors[order, :3, 0] = turn / steps
    errors[order, 3:, 0] = np.einsum("mij,mi->mj", R[order], (t[after] - t[before]) / steps)
    mean = Rotation.from_matrix(R).mean().as_matrix()
    errors[:, :3, 1] = Rotation.from_matrix(mean.T @ R).as_rotvec()
    errors[:, 3:, 2] = np.einsum("mij,mi->mj", R, t)
    whole: FloatArray = errors[station]
    return whole


def families(at: Parameters, readings: Readings, position: IntArray) -> tuple[Family, ...]:
    """Return the families of errors that are local to a plane: `displaced` and `beam-on-plane`.

    A beam's bias on one plane is left out where the beam sees no other plane, or no other beam sees
    the plane: it is then the location of the beam along itself, or the offset of the plane.
    """
    found = model.linearize(model.scene(at, readings), readings.distance)
    rows = np.lexsort((position, readings.beam, readings.plane))
    block = readings.plane * readings.beams + readings.beam
    times = int(position.max()) + 1
    key = (block * times + position)[rows]

    def family(
        code: str, column: FloatArray, plane: IntArray, beam: IntArray, since: IntArray
    ) -> Family:
        blocks = plane[:, None] * readings.beams + np.arange(readings.beams)
        first = np.searchsorted(key, blocks * times + since[:, None])
        last = np.searchsorted(key, (blocks + 1) * times)
        return Family(code, column, plane, beam, since, first, last, rows)

    plane, since = _splits(readings, position)
    displaced = family("displaced", found.offset, plane, np.full_like(plane, -1), since)
    plane, beam = np.nonzero(_pairs(readings))
    start = position[rows][np.searchsorted(key, (plane * readings.beams + beam) * times)]
    biased = family("beam-on-plane", -slopes(at, readings), plane, beam, start)
    return displaced, biased


def _pairs(readings: Readings) -> BoolArray:
    """Return which beams (P, B) may have a bias on which plane."""
    seen = np.zeros((readings.planes, readings.beams), dtype=bool)
    seen[readings.plane, readings.beam] = True
    shared: BoolArray = seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None]
    return shared


def _splits(readings: Readings, position: IntArray) -> tuple[IntArray, IntArray]:
    """Return planes (m,), and positions (m,) from which on each may be displaced."""
    _, row = np.unique(readings.station, return_index=True)
    order = np.lexsort((position[row], readings.plane[row]))
    plane, when = readings.plane[row][order], position[row][order]
    start = np.searchsorted(plane, np.arange(readings.planes + 1))
    chosen = [np.empty(0, dtype=np.intp)]
    for first, last in zip(start[:-1] + LEAST_STATIONS, start[1:] - LEAST_STATIONS, strict=True):
        if last - first >= MOST_SPLITS:
            chosen.append(np.linspace(first, last, MOST_SPLITS).round().astype(np.intp))
        elif last >= first:
            chosen.append(np.arange(first, last + 1, dtype=np.intp))
    splits = np.concatenate(chosen)
    return plane[splits], when[splits]


def _range_sums(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the sums of values (N, D) over rows [first, last), both of any shape."""
    padded = np.concatenate((values, np.zeros((1, values.shape[1]))))
    bounds = np.stack((first.ravel(), last.ravel()), axis=1).ravel()
    if not bounds.size:
        return np.zeros((*first.shape, values.shape[1]))
    sums = np.add.reduceat(padded, bounds, axis=0)[::2].reshape(*first.shape, -1)
    sums[first >= last] = 0.0
    return sums


@dataclass(frozen=True, slots=True)
class Rows:
    """The linear problem at a solution.

    Attributes
    ----------
    readings : Readings
    how : Whitening
    J : (N, 10)
        Derivatives of the residuals by the unknowns of the own beam (7) and plane (3).
    residual : (N,)
    normal : NormalEquations
        Of all unknowns.
    """

    readings: Readings
    how: Whitening
    J: FloatArray
    residual: FloatArray
    normal: NormalEquations


def linear_rows(at: Parameters, readings: Readings, how: Whitening) -> Rows:
    """Return the linear problem at a solution; raises GrazingBeamError like the model."""
    columns, _ = jacobian_columns(at, readings, 2)
    coupled = how.root * (1.0 - np.eye(how.root.shape[1]))
    if coupled.any():
        normal = whitened_normal_equations(at, readings, 2, how)
    else:
        normal = normal_equations(at, readings, 2, how.squares())
    J = np.ascontiguousarray(columns[: WIDTH + 3].T)
    return Rows(readings, how, J, columns[-1], normal)


@dataclass(frozen=True, slots=True)
class Left:
    """What the unknowns leave of columns.

    Attributes
    ----------
    heavy : (N, q)
        Times sigma^2 inv(C).
    squares : (q,)
        Of the whitened columns, rows of the prior included.
    moved : (7 B, q)
        The beams' part of the unknowns that explain the rest.
    """

    heavy: FloatArray
    squares: FloatArray
    moved: FloatArray


class Projection:
    """Takes out of columns what the unknowns explain; planes are eliminated before beams.

    Unknowns are scaled by the square roots of their own information, so that their units do not
    matter.
    """

    def __init__(self, rows: Rows, prior: FloatArray) -> None:
        self.J, self.how = rows.J, rows.how
        self.readings, readings, normal = rows.readings, rows.readings, rows.normal
        self.pull = np.zeros((readings.beams, WIDTH))
        finite = np.isfinite(prior) & (prior > 0.0)
        self.pull[:, 5:][finite] = self.how.sigma / prior[finite]
        active = np.ones_like(self.pull, dtype=bool)
        active[:, 5:] = prior > 0.0
        H = normal.beam[0] + np.diag(self.pull.ravel() ** 2)
        diagonal = np.where(active.ravel(), np.diagonal(H), np.inf)
        unit = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, np.inf))
        plane_unit = 1.0 / np.sqrt(np.einsum("pii->pi", normal.plane[0]))
        squares = normal.plane[0] * plane_unit[:, :, None] * plane_unit[:, None, :]
        inverse = _inverse(squares)
        border = normal.border[0] * unit[:, None] * plane_unit[:, None, :]
        response = inverse @ np.swapaxes(border, 1, 2)
        S = H * np.outer(unit, unit)
        S -= np.swapaxes(border, 0, 1).reshape(len(S), -1) @ response.reshape(-1, len(S))
        self.beam_inverse = _inverse(0.5 * (S + S.T)) * np.outer(unit, unit)
        self.plane_inverse = inverse * plane_unit[:, :, None] * plane_unit[:, None, :]
        used = unit > 0.0
        self.response = np.zeros_like(response)
        self.response[:, :, used] = response[:, :, used] / unit[used]
        self.response *= plane_unit[:, :, None]

    def perpendicular(self, columns: FloatArray, pulled: FloatArray | None = None) -> "Left":
        """Return what the unknowns leave of columns (N, q).

        They are projected twice: the second time takes what rounding left the first.

        Parameters
        ----------
        columns : (N, q)
        pulled : (7 B, q), optional
            In the rows of the prior; zero where not given.
        """
        rest = columns.copy()
        pulled = np.zeros((self.pull.size, columns.shape[1])) if pulled is None else pulled.copy()
        moved = np.zeros_like(pulled)
        pull = self.pull.reshape(-1, 1)
        for _ in range(2):
            beams, planes = self._gradient(weighed(self.how, rest))
            x, y = self._solved(beams + pull * pulled, planes)
            rest -= self._image(x, y)
            pulled -= pull * x
            moved += x
        heavy = weighed(self.how, rest)
        squares = (rest * heavy).sum(axis=0) + (pulled**2).sum(axis=0)
        return Left(heavy, squares, moved)

    def members(
        self, products: FloatArray, squares: FloatArray, plane: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members of a family (m, 7 B), and the squares (m,) that are left.

        Parameters
        ----------
        products : (m, B, 10)
            From `Family.products`.
        squares : (m,)
        plane : (m,)
        """
        own = products[:, :, WIDTH:].sum(axis=1)
        beams = products[:, :, :WIDTH].reshape(len(products), self.pull.size)
        beams = beams - np.einsum("mi,mij->mj", own, self.response[plane])
        moved = beams @ self.beam_inverse
        left = squares - np.einsum("mi,mij,mj->m", own, self.plane_inverse[plane], own)
        left -= (beams * moved).sum(axis=1)
        return moved, left

    def _gradient(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J'y for columns y (N, q): beams (7 B, q) and planes (P, 3, q)."""
        starts = self.readings.block_starts()
        sums = np.add.reduceat(self.J[:, :, None] * y[:, None, :], starts, axis=0)
        beams = np.zeros((self.readings.beams, WIDTH, y.shape[1]))
        planes = np.zeros((self.readings.planes, 3, y.shape[1]))
        np.add.at(beams, self.readings.beam[starts], sums[:, :WIDTH])
        np.add.at(planes, self.readings.plane[starts], sums[:, WIDTH:])
        return beams.reshape(-1, y.shape[1]), planes

    def _solved(self, beams: FloatArray, planes: FloatArray) -> tuple[FloatArray, FloatArray]:
        x = self.beam_inverse @ (beams - np.einsum("pij,piq->jq", self.response, planes))
        return x, self.plane_inverse @ planes - self.response @ x

    def _image(self, x: FloatArray, y: FloatArray) -> FloatArray:
        own = x.reshape(self.readings.beams, WIDTH, -1)[self.readings.beam]
        image: FloatArray = np.einsum("ni,niq->nq", self.J[:, :WIDTH], own)
        image += np.einsum("ni,niq->nq", self.J[:, WIDTH:], y[self.readings.plane])
        return image


def _inverse(matrices: FloatArray) -> FloatArray:
    """Return pseudo-inverses of symmetric matrices (..., n, n) of unit scale."""
    values, axes = np.linalg.eigh(matrices)
    keep = values > ROUNDING * np.maximum(values[..., -1:], 1e-300)
    inverse = np.where(keep, 1.0 / np.where(keep, values, 1.0), 0.0)
    product: FloatArray = (axes * inverse[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return product


@dataclass(frozen=True, slots=True)
class Wording:
    """What is said of one kind of error.

    Attributes
    ----------
    unit : str
        "m" or "1".
    phrase : str
        The error, with {size} and {subject} to be filled in.
    anywhere : str
        The subject where no member is meant.
    confounded : str
        What it cannot be told from.
    remedy : str
    """

    unit: str
    phrase: str
    anywhere: str
    confounded: str
    remedy: str


UNKNOWNS = "the unknowns of the calibration in this recording"
WORDING = {
    "incidence": Wording(
        "m",
        "a range error of {size} at an incidence of 45 deg that grows with its squared tangent",
        "",
        UNKNOWNS,
        "measure at smaller angles of incidence, or give the sensor's largest incidence",
    ),
    "cubic": Wording(
        "m",
        "a third-order range error of {size} at the largest reading",
        "",
        UNKNOWNS,
        "measure over a shorter span of ranges around the working distance, or linearise the sensor",
    ),
    "sag": Wording(
        "m",
        "a curvature of the plate by {size} from the middle of its spots to the farthest one",
        "",
        UNKNOWNS,
        "use a flatter plate, support it evenly, or measure a smaller part of it",
    ),
    "lag": Wording(
        "1",
        "a lag between poses and readings by {size} of the step to the next station",
        "",
        UNKNOWNS,
        "let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
    ),
    "drift": Wording(
        "m",
        "a drift of the readings by {size} over the recording",
        "",
        UNKNOWNS,
        "let the sensor warm up, and record in a shorter time",
    ),
    "displaced": Wording(
        "m",
        "a displacement by {size} of {subject}",
        "one plane from some station on",
        UNKNOWNS,
        "fix the plate, and give the stations after the displacement a plane label of their own",
    ),
    "beam-on-plane": Wording(
        "m",
        "a bias of {size} of {subject}",
        "one beam on one plane",
        "the offset of the plane or the location of the beam: it takes two beams that see the same two "
        "planes",
        "check the surface of that plane under the beam, or remove these readings",
    ),
    "turn-scale": Wording(
        "1",
        "a scale error of the robot's turns by {size}",
        "",
        UNKNOWNS,
        "have the robot's joints calibrated, and check the unit and the convention of its angles",
    ),
    "translation-scale": Wording(
        "1",
        "a scale error of the robot's translations by {size}",
        "",
        "k1 of all beams, because every length scales together",
        "check the robot's translations against a known length, or calibrate without range errors if "
        "the scale of the sensor is known",
    ),
}
BY_NATURE = {
    "inverse-cosine": (
        "a range error proportional to 1/cos(incidence) cannot be told from the offsets of the planes; "
        "it changes no beam",
        "nothing is needed for the beams; measure the offset of a plane by other means if it matters",
    ),
    "tool-frame": (
        "an error of the tool frame cannot be told from the mount of the beams: both are one rigid "
        "motion",
        "use the calibration with the tool frame of the recording only",
    ),
    "range-offset": (
        "a constant offset of the readings cannot be told from the location of the beam along itself",
        "use the location together with readings of the same sensor only: their sum is right",
    ),
}
"""Errors that no recording can show, why, and what to do."""


def size_in_words(size: float, unit: str) -> str:
    """Return a size with two digits, in mm or percent."""
    return f"{size * 1e3:.2g} mm" if unit == "m" else f"{size * 100.0:.2g} %"
