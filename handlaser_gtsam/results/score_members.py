"""Systematic errors as columns of the residuals: sums over all their members, and what is left of them.

Effects of all readings are few columns and their sums. Effects of single planes come in families of
many members, of which no column is formed: each counts in ranges of the rows in the order by plane,
beam and time.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import block_diag

from ..arrays import FloatArray, IntArray
from ..model.effects import EFFECTS
from ..model.effects.effect import Everywhere, OnPlanes
from .projection import LinearRows, Projection


class CommonErrors:
    """Errors that concern all readings, with the interface of `PlaneErrors`.

    Attributes
    ----------
    columns : (N, c)
        Derivatives of the residuals.
    mix : (c, m)
        Of which columns each member is the sum.
    position : (m,)
        Position in the recording from which on each member counts; -1 for the whole of it.
    """

    def __init__(self, rows: LinearRows, kinds: Sequence[tuple[str, Everywhere]]) -> None:
        # There may be none: all of them can be unknowns.
        none = Everywhere(np.empty((len(rows.readings), 0)))
        every = [none, *(kind for _, kind in kinds)]
        self.columns = np.hstack([kind.columns for kind in every])
        self.mix = np.asarray(block_diag(*(kind.mix for kind in every)))
        self.position = np.concatenate([kind.since for kind in every])
        codes = [code for code, kind in kinds for _ in kind.since]
        self.codes = np.array(codes, dtype=str)
        self.plane = self.beam = np.full(len(self.codes), -1)
        self.squares = self._squares(rows.how.weighed(self.columns))

    def by_code(self, value: Callable[[str], float]) -> FloatArray:
        """Return what every member (m,) has by its code."""
        return np.array([value(code) for code in self.codes.tolist()])

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.asarray(self.mix.T @ (self.columns.T @ y))

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return np.asarray(self.columns @ self.mix[:, member])

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        _, heavy, _, moved = projection.perpendicular(self.columns)
        return (moved @ self.mix).T, self._squares(heavy)

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

    def __init__(self, rows: LinearRows, code: str, kind: OnPlanes) -> None:
        self.rows, self.kind, self.code = rows, kind, code
        self.plane, self.beam, self.position = kind.plane, kind.beam, kind.since
        plane, position = self.plane, self.position
        self.codes, self.column = np.full(len(plane), code), kind.column
        # A member counts in the rows [first, last) of every beam, in the order by plane, beam and time.
        readings = rows.readings
        self.order = np.lexsort((rows.position, readings.beam, readings.plane))
        times = int(rows.position.max()) + 1
        block = readings.plane * readings.beams + readings.beam
        key = (block * times + rows.position)[self.order]
        blocks = plane[:, None] * rows.readings.beams + np.arange(rows.readings.beams)
        self.first = np.searchsorted(key, blocks * times + position[:, None])
        self.last = np.searchsorted(key, (blocks + 1) * times)
        self.products = np.zeros((*self.first.shape, rows.J.shape[1]))
        self.squares = np.zeros(len(plane))
        self._sum(rows)

    def by_code(self, value: Callable[[str], float]) -> FloatArray:
        """Return what every member (m,) has by its code."""
        return np.full(len(self.plane), value(self.code))

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        values = (self.column[:, None] * y)[self.order]
        if (self.beam < 0).all():
            return np.asarray(_range_sums(values, self.first, self.last).sum(axis=1))
        of_beam = (np.arange(len(self.beam)), self.beam)
        return _range_sums(values, self.first[of_beam], self.last[of_beam])

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return self.kind.column_of(member, self.rows)

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        freed = self.dot(projection.freed_heavy)
        return projection.members(self.products, self.squares, self.plane, freed)

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


def score_members(rows: LinearRows) -> list[CommonErrors | PlaneErrors]:
    """Return all effects that are no unknowns: one of all readings each, or a family."""
    everywhere: list[tuple[str, Everywhere]] = []
    families: list[CommonErrors | PlaneErrors] = []
    for code, effect in EFFECTS.items():
        members = None if code in rows.freed.codes else effect.at(rows)
        if isinstance(members, Everywhere):
            everywhere.append((code, members))
        elif members is not None:
            families.append(PlaneErrors(rows, code, members))
    # Those with more members than columns last.
    everywhere.sort(key=lambda one: one[1].mix.shape[1] > len(one[1].mix))
    return [CommonErrors(rows, everywhere), *families]


def _range_sums(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the sums of values (N, D) over rows [first, last), both of any shape."""
    padded = np.concatenate((values, np.zeros((1, values.shape[1]))))
    bounds = np.stack((first.ravel(), last.ravel()), axis=1).ravel()
    if not bounds.size:
        return np.zeros((*first.shape, values.shape[1]))
    sums = np.add.reduceat(padded, bounds, axis=0)[::2].reshape(*first.shape, -1)
    sums[first >= last] = 0.0
    return sums
