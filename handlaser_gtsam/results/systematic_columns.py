r"""Systematic errors that the model does not hold, each as a column of derivatives.

A column is the derivative of the residuals e = s - g(d) (`model`) by the size of the error, at zero.
Errors that concern all readings have one column each (`common_columns`). Errors local to one plane come
in families: a column for all readings, and for every member the rows in which it counts. What is said
of each error stands under its code in `systematic_words`.

With n the normal that points away from the sensor and c = -1 / (n_H . v), a surface that lies h
farther along n changes e by c h, a reading that is f too long by -g'(d) f, and a true hand pose
that is xi beside the recorded one by -J xi. Positive sizes: readings too long (`incidence`, `cubic`,
`beam-on-plane`), or longer and longer (`drift`); edges of the plate farther from the sensor than its
middle (`sag`); a plane farther away (`displaced`); true poses ahead in time (`lag`); true turns and
translations larger than reported. With carry-over each channel keeps a part of the channel before it,
and the first channel a part of the last. A tool frame that is displaced while recording moves in the
hand along one of `DIRECTIONS`, at once or steadily; both are counted from their mean. A cubic error is
a function of the reading itself, not of the true range: it is the next term of g.
"""

from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.weighting import slopes
from .projection import LinearRows, Projection

WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""
OF_READINGS = ("incidence", "cubic", "carry-over")
"""Codes of the errors that a reading has by itself, whenever it is taken."""
DIRECTIONS = np.array(
    [
        axis
        for axis in product((0.0, 1.0, -1.0), repeat=3)
        if any(axis) and axis > tuple(-x for x in axis)
    ]
)
"""Directions in which a tool frame may be displaced (13, 3): the axes and diagonals of a cube, one of
which has a cosine of 0.886 or more to any direction."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced: a step half-way between two of
them correlates by 0.88 or more with one of the two."""
LEAST_STATIONS = 2
"""Stations that there are at least before and after a displacement, of a plane or of the tool frame."""
MOST_SPLITS = 32
"""Evenly spaced splits at which a plane with more is tested: neighbours hardly differ."""


class CommonErrors:
    """Errors that concern all readings, with the interface of `PlaneErrors`.

    Attributes
    ----------
    columns : (N, c)
        Derivatives of the residuals: the errors of `common_columns`, then x, y and z of the tool frame
        for every time at which it may be displaced.
    mix : (c, m)
        Of which columns each member is the sum.
    position : (m,)
        Position in the recording from which on the tool frame is displaced; -1 for all other members.
    """

    def __init__(self, rows: LinearRows) -> None:
        moves, since = _tool_columns(rows)
        codes, columns = zip(*common_columns(rows), strict=True)
        self.columns = np.column_stack((*columns, *moves))
        each_time = np.kron(np.eye(len(since)), DIRECTIONS.T)
        self.mix = np.asarray(block_diag(np.eye(len(codes)), each_time))
        since = np.repeat(since, len(DIRECTIONS))
        self.codes = np.array([*codes, *["tool-displaced"] * len(since)])
        self.plane = self.beam = np.full(len(self.codes), -1)
        self.position = np.concatenate((np.full(len(codes), -1), since))
        self.squares = self._squares(rows.how.weighed(self.columns))

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.asarray(self.mix.T @ (self.columns.T @ y))

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return np.asarray(self.columns @ self.mix[:, member])

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        rest = projection.perpendicular(self.columns)
        return (rest.moved @ self.mix).T, self._squares(rest.heavy)

    def _squares(self, heavy: FloatArray) -> FloatArray:
        """Return the squares (m,) of the members, given their weighed columns (N, c)."""
        gram = self.columns.T @ heavy
        squares: FloatArray = np.einsum("ci,cd,di->i", self.mix, gram, self.mix)
        return np.maximum(squares, 0.0)


class PlaneErrors:
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
        rows: LinearRows,
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
        of_beam = (np.arange(len(self.beam)), self.beam)
        return _range_sums(values, self.first[of_beam], self.last[of_beam])

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        column = np.zeros_like(self.column)
        beams = range(self.first.shape[1]) if self.beam[member] < 0 else [int(self.beam[member])]
        for beam in beams:
            rows = self.order[self.first[member, beam] : self.last[member, beam]]
            column[rows] = self.column[rows]
        return column

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        return projection.members(self.products, self.squares, self.plane)

    def _sum(self, rows: LinearRows) -> None:
        """Fill in the products and the squares."""
        if not rows.how.is_coupled and (self.beam >= 0).all():  # only the own beam has any
            of_beam = np.arange(len(self.beam)), self.beam
            values = self._weighed(rows, self.column)
            sums = _range_sums(values, self.first[of_beam], self.last[of_beam])
            self.products[of_beam], self.squares[:] = sums[:, :-1], sums[:, -1]
            return
        for beam in np.unique(self.beam).tolist():
            members = np.flatnonzero(self.beam == beam)
            mine = (rows.readings.beam == beam) | (beam < 0)
            values = self._weighed(rows, np.where(mine, self.column, 0.0))
            sums = _range_sums(values, self.first[members], self.last[members])
            self.products[members] = sums[:, :, :-1]
            self.squares[members] = sums[:, :, -1].sum(axis=1)

    def _weighed(self, rows: LinearRows, column: FloatArray) -> FloatArray:
        """Return a column times sigma^2 inv(C), with J and with itself, in the order (N, 11)."""
        heavy = rows.how.weighed(column[:, None])[:, 0]
        return np.column_stack((rows.J * heavy[:, None], column * heavy))[self.order]


def systematic_columns(rows: LinearRows) -> tuple[CommonErrors, PlaneErrors, PlaneErrors]:
    """Return all errors: the errors of all readings, and the families `displaced` and `beam-on-plane`.

    A beam has no bias on one plane where it sees no other plane, or where no other beam sees the plane:
    that bias is then the location of the beam along itself, or the offset of the plane.
    """
    at, readings, position = rows.at, rows.readings, rows.position
    # Readings by plane, beam and position, and a sorted key with its stride of blocks.
    order = np.lexsort((position, readings.beam, readings.plane))
    times = int(position.max()) + 1
    block = readings.plane * readings.beams + readings.beam
    key = (block * times + position)[order]
    in_time = order, key, times
    height = model.linearize(model.scene(at, readings), readings.distance).offset
    plane, since = _splits(readings, position)
    all_beams = np.full_like(plane, -1)
    displaced = PlaneErrors(rows, "displaced", height, (plane, all_beams, since), in_time)
    seen = np.zeros((readings.planes, readings.beams), dtype=bool)
    seen[readings.plane, readings.beam] = True
    plane, beam = np.nonzero(seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None])
    start = position[order][np.searchsorted(key, (plane * readings.beams + beam) * times)]
    longer = -slopes(at, readings)
    biased = PlaneErrors(rows, "beam-on-plane", longer, (plane, beam, start), in_time)
    return CommonErrors(rows), displaced, biased


def _tool_columns(rows: LinearRows) -> tuple[list[FloatArray], IntArray]:
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


def common_columns(rows: LinearRows) -> list[tuple[str, FloatArray]]:
    """Return the errors that concern all readings: the code of each, and its column (N,)."""
    at, readings, position = rows.at, rows.readings, rows.position
    x, d = model.scene(at, readings), readings.level
    lin = model.linearize(x, d, with_pose=True)
    longer = -slopes(at, readings)
    incidence, cubic, carry_over = errors_of_readings(
        at, readings, x, rows.channel, float(d.max())
    ).T
    spot = lin.normal / lin.offset[:, None]
    square = ((spot - readings.plane_means(spot)[readings.plane]) ** 2).sum(axis=1)
    time = position / max(int(position.max()), 1)
    lag, turn_scale, translation_scale = -np.einsum(
        "ni,nik->kn", lin.pose, _pose_errors(readings, position)
    )
    return [
        ("incidence", incidence),
        ("cubic", cubic),
        ("sag", lin.offset * square / max(float(square.max()), np.finfo(float).tiny)),
        ("lag", lag),
        ("drift", longer * (time - 0.5)),  # a steady one,
        ("drift", -longer * np.exp(-WARMING * time)),  # and that of a sensor that warms up
        ("turn-scale", turn_scale),
        ("translation-scale", translation_scale),
        ("carry-over", carry_over),
    ]


def errors_of_readings(
    at: Parameters,
    readings: Readings,
    x: model.Scene,
    channel: IntArray,
    largest: float = 1.0,
) -> FloatArray:
    """Return the columns (N, 3) of the errors `OF_READINGS`.

    The size of a cubic one is that at the `largest` reading [m]; `channel` (B,) is that of
    `LinearRows`. Predicted readings are carried over, not those of the recording: two readings of a
    station differ by errors of the pose as well, which the residuals hold, too, and most of the little
    that the unknowns do not explain of the difference would be these errors.
    """
    slope, d = slopes(at, readings), readings.distance
    expected = d + model.residuals(x, d) / slope
    # The reading of the channel before, at the same station: without one, nothing is carried over.
    order = np.argsort(channel)
    channel_before = np.empty_like(order)
    channel_before[order] = np.roll(order, 1)
    _, station = np.unique(readings.station, return_inverse=True)
    table = np.full((int(station.max()) + 1, readings.beams), np.nan)
    table[station, readings.beam] = expected
    before = table[station, channel_before[readings.beam]]
    errors = (
        1.0 / model.cosines(x) ** 2 - 1.0,
        (readings.level / largest) ** 3,
        np.nan_to_num(before - expected),
    )
    return np.asarray(-slope[:, None] * np.column_stack(errors))


def _pose_errors(readings: Readings, position: IntArray) -> FloatArray:
    """Return (omega, u) (N, 6, 3) of the hand poses for a lag, a turn scale and a translation scale.

    The lag of one step is half the way from the previous station of the plane to the next, or the
    whole way to or from the neighbour at the ends; turns count from the mean orientation, and
    translations from the origin of the plane's frame, in which the plane shifts.
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
    return np.asarray(errors[station])


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
