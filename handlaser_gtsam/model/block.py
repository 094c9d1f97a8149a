"""Blocks of rows: what a least-squares problem is put together from.

A block has groups of rows that see the same variables: the readings of one beam at a chunk of stations
of one plane, the rays of one shot of a profiler, the coordinates of one prior. Which variables each
group sees is static (`slots`); numbers are computed at a point (`evaluate`), for K problems or
candidates at once. Short groups are filled up with rows of weight zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from .families import FAMILIES


class SumsByKey:
    """Sums over groups of equal key, along an axis of an array.

    How to sum is found out once: keys that repeat as a whole, or in runs of one length, become a sum
    over a reshaped axis, all others a sorted `np.add.reduceat`.

    Parameters
    ----------
    key : (G,)
        Whole numbers, in any order.

    Attributes
    ----------
    keys : (U,)
        The different keys, ascending, in the order of the sums.
    """

    def __init__(self, key: IntArray) -> None:
        key = np.asarray(key)
        self._tiles, self._order = 1, None
        again = np.flatnonzero((key[1:] == key[0]) & (key[:-1] != key[0])) + 1
        if again.size and len(key) % again[0] == 0:
            first = key[: again[0]]
            if (key.reshape(-1, len(first)) == first).all():
                self._tiles, key = len(key) // len(first), first
        if (np.diff(key) < 0).any():
            self._order = np.argsort(key, kind="stable")
            key = key[self._order]
        self.keys: IntArray
        self.keys, self._first, lengths = np.unique(key, return_index=True, return_counts=True)
        self._run = int(lengths[0]) if (lengths == lengths[0]).all() else 0

    def __call__(self, array: FloatArray, axis: int = 1) -> FloatArray:
        """Return the sums (..., U, ...) of an array (..., G, ...) along an axis from 0 on."""
        before, after = array.shape[:axis], array.shape[axis + 1 :]
        if self._tiles > 1:
            width = array.shape[axis] // self._tiles
            array = array.reshape(*before, self._tiles, width, *after).sum(axis=axis)
        if self._order is not None:
            array = array.take(self._order, axis=axis)
        if self._run == 1:
            return array
        if self._run:
            runs = array.reshape(*before, len(self.keys), self._run, *after)
            return np.asarray(runs.sum(axis=axis + 1))
        return np.asarray(np.add.reduceat(array, self._first, axis=axis))


Values = Mapping[str, FloatArray]
"""Members (K, n, size) of each family, K problems or candidates first; 1 where all share them."""


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """One variable that each group of a block sees.

    Attributes
    ----------
    family : str
    member : (G,)
        Which member each group sees.
    columns : slice
        Where the derivatives by its tangent coordinates stand among the columns.
    """

    family: str
    member: IntArray
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of a block at one point, not yet weighed.

    Attributes
    ----------
    columns : (q + 1, K, G, S)
        Derivatives by q tangent coordinates, then residuals; zero where there is no row.
    impossible : (K, G, S) of bool, or None
        Rows that mean nothing here, as of a beam that grazes its plane.
    """

    columns: FloatArray
    impossible: BoolArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """How the rows of a block weigh.

    With the columns U of a station, the weight matrix of its rows is root (I - U U') root.

    Attributes
    ----------
    root : (K, G, S), or None where all rows weigh 1
        Of the weight of each row.
    common : (c, K, G, S), or None
        U: what the rows of a station have in common, six columns for errors of the hand.
    station : (G, S), or None
        Number of each row's station, where there are common columns. Blocks of one problem number
        their stations alike.
    """

    root: FloatArray | None = None
    common: FloatArray | None = None
    station: IntArray | None = None

    def picked(self, problems: IntArray) -> "Weights":
        """Return the weights of some problems."""
        root, common = self.root, self.common
        return Weights(
            root if root is None or len(root) == 1 else root[problems],
            common if common is None or common.shape[1] == 1 else common[:, problems],
            self.station,
        )


@runtime_checkable
class Block(Protocol):
    """Rows of a least-squares problem."""

    @property
    def weights(self) -> Weights:
        """How the rows weigh."""

    def slots(self) -> tuple[Slot, ...]:
        """Return the variables that the groups see."""

    def evaluate(self, values: Values) -> Rows:
        """Return the rows at values of K problems."""


@runtime_checkable
class OfProblems(Block, Protocol):
    """Rows whose numbers, beside the values, are of one problem each; all problems share any others."""

    def picked(self, problems: IntArray) -> "OfProblems":
        """Return the block of some problems."""


def whitened(rows: Rows, weights: Weights) -> FloatArray:
    """Return the columns times the roots of their weights."""
    return rows.columns if weights.root is None else rows.columns * weights.root


def impossible_rows(rows: Rows, block: Block) -> BoolArray:
    """Tell which rows (K, G, S) are impossible and weigh anything."""
    if rows.impossible is None:
        return np.zeros(rows.columns.shape[1:], dtype=bool)
    root = block.weights.root
    return rows.impossible if root is None else rows.impossible & (root > 0.0)


def impossible(rows: Rows, block: Block) -> BoolArray:
    """Tell which problems (K,) have an impossible row that weighs anything."""
    return np.asarray(impossible_rows(rows, block).any(axis=(1, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class VectorPrior:
    """Independent Gaussians of the last coordinates of all members of a family.

    Attributes
    ----------
    family : str
        Its last part is a vector.
    root : (K, n, q)
        One over the standard deviation of the last q coordinates of each member; zero where nothing is
        known.
    mean : (n, q)
    """

    family: str
    root: FloatArray
    mean: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members, one a group."""
        members = np.arange(self.root.shape[1])
        return (Slot(self.family, members, slice(0, FAMILIES[self.family].dim)),)

    def evaluate(self, values: Values) -> Rows:
        """Return a row a coordinate."""
        dim, q = FAMILIES[self.family].dim, self.root.shape[2]
        off = values[self.family][..., -q:] - self.mean
        columns = np.zeros((dim + 1, *off.shape))
        for i in range(q):
            columns[dim - q + i, ..., i] = self.root[..., i]
        columns[-1] = self.root * off
        return Rows(columns)

    def picked(self, problems: IntArray) -> "VectorPrior":
        """Return the priors of some problems."""
        root = self.root if len(self.root) == 1 else self.root[problems]
        return VectorPrior(self.family, root, self.mean, self.weights.picked(problems))
