r"""Systematic errors that the model leaves out, each as a column of derivatives.

A column is the derivative of the residuals e = s - g(d) (`model`) by the size of the error, at zero.
Errors that concern all readings have one column each. Errors local to one plane come in families: a
column for all readings, and for every member the rows in which it counts.

With n the normal that points away from the sensor and c = -1 / (n_H . v), a surface that lies h
farther along n changes e by c h, a reading that is f too long by -g'(d) f, and a true hand pose
that is xi beside the recorded one by -J xi. Positive sizes: readings too long (`incidence`, `cubic`,
`beam-on-plane`), or longer and longer (`drift`); edges of the plate farther from the sensor than its
middle (`sag`); a plane farther away (`displaced`); true poses ahead in time (`lag`); true turns and
translations larger than reported. Of carry-over each channel keeps a part of the one before it, and the
first one of the last. A tool frame that is displaced while recording moves in the hand along one of
`DIRECTIONS`, at once or steadily; both are counted from their mean. A cubic error is a function of the
reading itself, not of the true range: it is the next term of g.
"""

from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.weighting import slopes
from .projection import Projection, Rows

WHOLE = (
    "incidence",
    "cubic",
    "sag",
    "lag",
    "drift",
    "drift",
    "turn-scale",
    "translation-scale",
    "carry-over",
)
"""Codes of the errors that concern all readings, in the order of the columns.

A drift is steady, or that of a sensor that warms up.
"""
WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""
OF_READINGS = ("incidence", "cubic", "carry-over")
"""Codes of those that a reading has by itself, whenever it is taken."""
DIRECTIONS = np.array(
    [
        one
        for one in product((0.0, 1.0, -1.0), repeat=3)
        if any(one) and one > tuple(-x for x in one)
    ]
)
"""Directions in which a tool frame may be displaced (13, 3): axes and diagonals of a cube. One of them
has a cosine of 0.886 or more to any direction."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced. A step half-way between two of
them correlates by 0.88 or more with one of the two."""
LEAST_STATIONS = 2
"""A plane is taken as displaced only where it has so many stations before and after."""
MOST_SPLITS = 32
"""A plane with more splits is tested at so many, evenly spaced: neighbours hardly differ."""


class Everywhere:
    """Errors that concern all readings, with the interface of `Family`.

    Attributes
    ----------
    columns : (N, c)
        Derivatives of the residuals: the errors `WHOLE`, then x, y and z of the tool frame for every
        time at which it may be displaced.
    mix : (c, m)
        Of which columns each member is the sum.
    position : (m,)
        Position in the recording from which on the tool frame is displaced; -1 for all other members.
    """

    def __init__(self, rows: Rows) -> None:
        moves, since = _tool_columns(rows)
        self.columns = np.hstack((_whole_columns(rows), *moves))
        each_time = np.kron(np.eye(len(since)), DIRECTIONS.T)
        self.mix = np.asarray(block_diag(np.eye(len(WHOLE)), each_time))
        own = np.repeat(since, len(DIRECTIONS))
        self.codes = np.array([*WHOLE, *["tool-displaced"] * len(own)])
        self.plane = self.beam = np.full(len(self.codes), -1)
        self.position = np.concatenate((np.full(len(WHOLE), -1), own))
        self.squares = self._squares(rows.how.weighed(self.columns))

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.asarray(self.mix.T @ (self.columns.T @ y))

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return np.asarray(self.columns @ self.mix[:, member])

    def left_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the squares (m,) that are left."""
        found = projection.perpendicular(self.columns)
        return (found.moved @ self.mix).T, self._squares(found.heavy)

    def _squares(self, heavy: FloatArray) -> FloatArray:
        """Return the squares (m,) of the members, given their weighed columns (N, c)."""
        gram = self.columns.T @ heavy
        squares: FloatArray = np.einsum("ci,cd,di->i", self.mix, gram, self.mix)
        return np.maximum(squares, 0.0)


class Family:
    """Errors of one kind that are local to a plane.

    Attributes
    ----------
    codes : (m,) of str
    column : (N,)
        Derivative of the residuals, as if the error were everywhere.
    plane, beam, position : (m,)
        Of every member: its plane, the one beam it concerns (-1 for all), and the position in the
        recording of the first station it concerns. It counts from there on.
    products : (m, B, 10)
        Sums over members times sigma^2 inv(C) with the rows of J, beam by beam.
    squares : (m,)
        Of the whitened columns.
    """

    def __init__(
        self,
        rows: Rows,
        code: str,
        column: FloatArray,
        members: tuple[IntArray, IntArray, IntArray],
        in_time: tuple[IntArray, IntArray, int],
    ) -> None:
        self.plane, self.beam, self.position = plane, _, position = members
        self.codes, self.column = np.full(len(plane), code), column
        # A member counts in the rows [first, last) of every beam, in the order by plane, beam and time.
        self.order, key, times = in_time
        blocks = plane[:, None] * rows.readings.beams + np.arange(rows.readings.beams)
        self.first = np.searchsorted(key, blocks * times + position[:, None])
        self.last = np.searchsorted(key, (blocks + 1) * times)
        self.products = np.zeros((*self.first.shape, rows.J.shape[1]))
        self.squares = np.zeros(len(plane))
        self._sum(rows)

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        values = (self.column[:, None] * y)[self.order]
        if (self.beam < 0).all():
            return np.asarray(_range_sums(values, self.first, self.last).sum(axis=1))
        own = (np.arange(len(self.beam)), self.beam)
        return _range_sums(values, self.first[own], self.last[own])

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        column = np.zeros_like(self.column)
        beams = range(self.first.shape[1]) if self.beam[member] < 0 else [int(self.beam[member])]
        for beam in beams:
            rows = self.order[self.first[member, beam] : self.last[member, beam]]
            column[rows] = self.column[rows]
        return column

    def left_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the squares (m,) that are left."""
        return projection.members(self.products, self.squares, self.plane)

    def _sum(self, rows: Rows) -> None:
        """Fill in the products and the squares."""
        if not rows.how.is_coupled and (self.beam >= 0).all():  # only the own beam has any
            own = np.arange(len(self.beam)), self.beam
            values = self._weighed(rows, -1, np.empty(0))
            found = _range_sums(values, self.first[own], self.last[own])
            self.products[own], self.squares[:] = found[:, :-1], found[:, -1]
            return
        matrix = rows.how.matrix() if (self.beam >= 0).any() else np.empty(0)
        for beam in np.unique(self.beam).tolist():
            members = np.flatnonzero(self.beam == beam)
            values = self._weighed(rows, beam, matrix)
            found = _range_sums(values, self.first[members], self.last[members])
            self.products[members] = found[:, :, :-1]
            self.squares[members] = found[:, :, -1].sum(axis=1)

    def _weighed(self, rows: Rows, beam: int, matrix: FloatArray) -> FloatArray:
        """Return the column times sigma^2 inv(C), with J and with itself, in the order (N, 11).

        Where a beam is given, the column is that of its readings alone, and `matrix` is sigma^2
        inv(C) of every station.
        """
        how, column = rows.how, self.column
        if beam >= 0:
            mine = rows.readings.beam == beam
            column, alone = np.where(mine, column, 0.0), np.zeros(len(matrix))
            alone[how.station[mine]] = column[mine]
            heavy = matrix[how.station, how.beam, how.beam[mine][0]] * alone[how.station]
        else:
            heavy = how.weighed(column[:, None])[:, 0]
        return np.column_stack((rows.J * heavy[:, None], column * heavy))[self.order]


def alternatives(rows: Rows) -> tuple[Everywhere, Family, Family]:
    """Return all errors: those of all readings, and the families `displaced` and `beam-on-plane`.

    A beam's bias on one plane is left out where the beam sees no other plane, or no other beam sees
    the plane: it is then the location of the beam along itself, or the offset of the plane.
    """
    at, readings, position = rows.at, rows.readings, rows.position
    order, key, times = in_time = _in_time(rows)
    height = model.linearize(model.scene(at, readings), readings.distance).offset
    plane, since = _splits(readings, position)
    everyone = np.full_like(plane, -1)
    displaced = Family(rows, "displaced", height, (plane, everyone, since), in_time)
    plane, beam = np.nonzero(_pairs(readings))
    start = position[order][np.searchsorted(key, (plane * readings.beams + beam) * times)]
    longer = -slopes(at, readings)
    biased = Family(rows, "beam-on-plane", longer, (plane, beam, start), in_time)
    return Everywhere(rows), displaced, biased


def _in_time(rows: Rows) -> tuple[IntArray, IntArray, int]:
    """Return the readings by plane, beam and position, and a sorted key with its stride of blocks."""
    readings, position = rows.readings, rows.position
    order = np.lexsort((position, readings.beam, readings.plane))
    times = int(position.max()) + 1
    block = readings.plane * readings.beams + readings.beam
    return order, (block * times + position)[order], times


def _tool_columns(rows: Rows) -> tuple[list[FloatArray], IntArray]:
    """Return columns (N, 3) of a tool frame that is displaced by one metre, and since when.

    The first displacement is steady, and its position -1; the others begin at a station.
    """
    stations = np.unique(rows.position)
    splits = np.linspace(0, len(stations), TOOL_STEPS + 2)[1:-1].round().astype(np.intp)
    splits = np.unique(
        splits[(splits >= LEAST_STATIONS) & (splits <= len(stations) - LEAST_STATIONS)]
    )
    since = np.concatenate(([-1], stations[splits]))
    along = -model.linearize(model.scene(rows.at, rows.readings), rows.readings.distance).location
    shares = [rows.position / max(int(rows.position.max()), 1)]
    shares += [(rows.position >= first).astype(float) for first in since[1:]]
    return [along * (share - share.mean())[:, None] for share in shares], since


def _whole_columns(rows: Rows) -> FloatArray:
    """Return the columns (N, 9) of the errors `WHOLE`."""
    at, readings, position = rows.at, rows.readings, rows.position
    x, d = model.scene(at, readings), readings.level
    found = model.linearize(x, d, with_pose=True)
    longer = -slopes(at, readings)
    errors = errors_of_readings(at, readings, x, rows.channel, float(d.max()))
    incidence, cubic, carry_over = errors.T
    spot = found.normal / found.offset[:, None]
    square = ((spot - readings.plane_means(spot)[readings.plane]) ** 2).sum(axis=1)
    poses, time = _pose_errors(readings, position), position / max(int(position.max()), 1)
    return np.column_stack(
        (
            incidence,
            cubic,
            found.offset * square / max(float(square.max()), 1e-300),
            *(-np.einsum("ni,nik->kn", found.pose, poses[:, :, :1])),
            longer * (time - 0.5),
            -longer * np.exp(-WARMING * time),
            *(-np.einsum("ni,nik->kn", found.pose, poses[:, :, 1:])),
            carry_over,
        )
    )


def errors_of_readings(
    at: Parameters,
    readings: Readings,
    x: model.Scene,
    channel: IntArray,
    largest: float = 1.0,
) -> FloatArray:
    """Return the columns (N, 3) of the errors `OF_READINGS`.

    The size of a cubic one is that at the `largest` reading [m]; `channel` (B,) is that of `Rows`.
    What is carried over is that of predicted readings. The readings of two beams differ by errors of
    the pose as well, which the residuals hold, too: of the little that the unknowns leave of their
    difference most would be those.
    """
    slope, d = slopes(at, readings), readings.distance
    expected = d + model.residuals(x, d) / slope
    errors = (
        1.0 / model.cosines(x) ** 2 - 1.0,
        (readings.level / largest) ** 3,
        _from_channel_before(readings, expected, channel),
    )
    return np.asarray(-slope[:, None] * np.column_stack(errors))


def _from_channel_before(readings: Readings, d: FloatArray, channel: IntArray) -> FloatArray:
    """Return by how much (N,) the reading of the channel before is longer; zero where there is none.

    Of readings d (N,) [m].
    """
    order = np.argsort(channel)
    before = np.empty_like(order)
    before[order] = np.roll(order, 1)
    _, station = np.unique(readings.station, return_inverse=True)
    grid = np.full((int(station.max()) + 1, readings.beams), np.nan)
    grid[station, readings.beam] = d
    return np.nan_to_num(grid[station, before[readings.beam]] - d)


def _pose_errors(readings: Readings, position: IntArray) -> FloatArray:
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
