"""The covariance of everything: all beams and planes together, and what follows from it.

A plane appears in its readings only. Given the beams, planes are therefore independent, and with
the response W_p of plane p to the beams, x_p = -W_p x_beams + noise, every block follows from the
covariance S of the beams and the covariance P_p of each plane for known beams:

    cov(p, beams) = -W_p S,    cov(p, q) = W_p S W_q' + (P_p if p = q)

In a graph in which more ties planes together (hand poses with odometry between them), what couples them
for known beams is added.

Coordinates are tangent (location 3, direction 2, range-error terms a beam; normal 2, offset a plane)
or ambient (the numbers of `BEAM`; nx, ny, nz, b a plane), B S B' with the bases B.

Unknowns of beams whose correlation is strong can hardly be separated (`strong_correlations`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..errors import InputError
from ..quantities import SINGULAR
from .families import (
    BEAM,
    DIRECTION,
    LOCATION,
    MOUNT_DIM,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    PLANE,
    RANGE_ERROR,
    modelled,
)

STRONG = 0.95
"""Two unknowns whose correlation is larger in size are hardly distinguished: each would be known three
times as well if the other were known."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointCovariance(Value):
    """Covariance of beams and planes in SI units.

    Attributes
    ----------
    beam_names, plane_names : tuple of str
    terms : tuple of int
        Range-error terms of each beam.
    beams : (nb, nb)
        Tangent covariance S of all beams, 5 + terms coordinates each.
    response : (P, 3, nb)
        W_p.
    planes : (P, 3, 3)
        P_p.
    beam_bases : (B, 3, 2), plane_bases : (P, 3, 2)
        Tangent bases of directions and normals.
    origins : (P, 3)
        Points at which the offsets of the planes are taken [m]; ambient offsets are at the world's
        origin.
    coupling : (P, 3, P, 3) or None
        Covariance of the planes with each other for known beams, zero for each with itself; None where
        they are independent then.
    """

    beam_names: tuple[str, ...]
    plane_names: tuple[str, ...]
    terms: tuple[int, ...]
    beams: FloatArray
    response: FloatArray
    planes: FloatArray
    beam_bases: FloatArray
    plane_bases: FloatArray
    origins: FloatArray
    coupling: FloatArray | None = None

    def scaled(self, factor: float) -> "JointCovariance":
        """Return the covariance multiplied by a number."""
        coupling = None if self.coupling is None else factor * self.coupling
        return replace(
            self, beams=factor * self.beams, planes=factor * self.planes, coupling=coupling
        )

    def grown(self, beams: float, planes: float) -> "JointCovariance":
        """Return the covariance with larger standard deviations.

        Beams get `beams` times, planes for known beams `planes` times their standard deviations.
        """
        scaled = self.scaled(beams**2)
        return replace(scaled, planes=planes**2 * self.planes)

    def following(
        self,
        beams: FloatArray,
        planes: FloatArray,
        covariance: FloatArray,
        *,
        coupled: bool = True,
    ) -> "JointCovariance":
        r"""Return the covariance where a few further unknowns a are known with some covariance only.

        With A, M the covariance of a, and the derivatives by a of beams and planes at their optima,
        every block C becomes C + M A M'. In terms of what beams leave of a and of the planes,

            T = inv(inv(A) + M_b' inv(S) M_b),    m_p = M_p + W_p M_b,
            W_p becomes W_p - m_p T M_b' inv(S),    cov(p, q) for known beams grows by m_p T m_q'.

        Parameters
        ----------
        beams : (nb, q)
            M_b, tangent.
        planes : (P, 4, q)
            M_p of (n, b), ambient.
        covariance : (q, q)
            A.
        coupled : bool
            Whether to couple planes with each other for known beams, whose number is squared then.
        """
        own = plane_steps(self.plane_bases, self.origins, planes) + self.response @ beams
        unit = np.sqrt(np.diagonal(self.beams))
        unit = np.where(unit > 0.0, unit, 1.0)
        inverse = np.linalg.pinv(self.beams / np.outer(unit, unit), rcond=SINGULAR, hermitian=True)
        known = (inverse @ (beams / unit[:, None])) / unit[:, None]
        T = np.linalg.inv(np.linalg.inv(covariance) + beams.T @ known)
        alone, coupling = own @ T @ np.swapaxes(own, 1, 2), self.coupling
        if coupled:
            flat = own.reshape(-1, len(T))
            coupling = (flat @ T @ flat.T).reshape(len(own), PLANE.dim, len(own), PLANE.dim)
            if self.coupling is not None:
                coupling += self.coupling
            coupling[np.arange(len(own)), :, np.arange(len(own))] = 0.0
        return replace(
            self,
            beams=self.beams + beams @ covariance @ beams.T,
            response=self.response - own @ T @ known.T,
            planes=self.planes + alone,
            coupling=coupling,
        )

    def arranged(
        self, beams: Sequence[tuple[str, int]], planes: Sequence[tuple[str, int]]
    ) -> "JointCovariance":
        """Return the same with all beams, and planes, given by name and present index."""
        i, p = [index for _, index in beams], [index for _, index in planes]
        columns = np.concatenate([self._columns(index) for index in i])
        return JointCovariance(
            tuple(name for name, _ in beams),
            tuple(name for name, _ in planes),
            tuple(self.terms[index] for index in i),
            self.beams[np.ix_(columns, columns)],
            self.response[p][:, :, columns],
            self.planes[p],
            self.beam_bases[i],
            self.plane_bases[p],
            self.origins[p],
            None if self.coupling is None else self.coupling[p][:, :, p],
        )

    def matrix(
        self,
        beams: Sequence[str] | None = None,
        planes: Sequence[str] | None = None,
        *,
        ambient: bool = True,
    ) -> FloatArray:
        """Return the joint covariance of the named beams, then planes; of all where not given.

        Ambient 8 coordinates a beam and 4 a plane; tangent 5 + terms and 3.

        Raises
        ------
        InputError
            A name that is not there.
        """
        i = _indices(self.beam_names, beams, "beam")
        p = _indices(self.plane_names, planes, "plane")
        columns = np.concatenate([np.empty(0, dtype=np.intp), *(self._columns(k) for k in i)])
        follow = -self.response[p].reshape(-1, len(self.beams))
        across = follow @ self.beams
        block = self.beams[np.ix_(columns, columns)]
        joint = np.block([[block, across[:, columns].T], [across[:, columns], across @ follow.T]])
        first = len(columns)
        for number, index in enumerate(p):
            block = slice(first + 3 * number, first + 3 * number + 3)
            joint[block, block] += self.planes[index]
        if self.coupling is not None and p:
            joint[first:, first:] += self.coupling[p][:, :, p].reshape(3 * len(p), -1)
        if not ambient:
            return joint
        of_beams, of_planes = self.beam_lifts(), plane_lifts(self.plane_bases, self.origins)
        lifts = [*(of_beams[k] for k in i), *(of_planes[k] for k in p)]
        return _lifted(_lifted(joint, lifts).T, lifts).T

    def labels(
        self, beams: Sequence[str] | None = None, planes: Sequence[str] | None = None
    ) -> tuple[tuple[str, str], ...]:
        """Return (owner, coordinate) of every row of the ambient `matrix`."""
        i = _indices(self.beam_names, beams, "beam")
        p = _indices(self.plane_names, planes, "plane")
        rows = [(f"beam {self.beam_names[k]}", name) for k in i for name in BEAM.numbers]
        rows += [(f"plane {self.plane_names[k]}", name) for k in p for name in PLANE.numbers]
        return tuple(rows)

    def all_beams(self) -> list[FloatArray]:
        """Return the ambient covariance (8, 8) of every beam."""
        blocks = [
            self.beams[np.ix_(columns, columns)]
            for columns in map(self._columns, range(len(self.terms)))
        ]
        return [lift @ S @ lift.T for lift, S in zip(self.beam_lifts(), blocks, strict=True)]

    def all_planes(self) -> FloatArray:
        """Return the ambient covariances (P, 4, 4) of the planes."""
        tangent = self.planes + self.response @ self.beams @ np.swapaxes(self.response, 1, 2)
        lifts = plane_lifts(self.plane_bases, self.origins)
        return np.asarray(lifts @ tangent @ np.swapaxes(lifts, 1, 2))

    def beam_lifts(self) -> list[FloatArray]:
        """Return (8, 5 + terms) from tangent to ambient coordinates of every beam."""
        lifts = zip(beam_lifts(self.beam_bases), self.terms, strict=True)
        return [lift[:, : MOUNT_DIM + terms] for lift, terms in lifts]

    def _columns(self, index: int) -> IntArray:
        first = sum(MOUNT_DIM + terms for terms in self.terms[:index])
        return np.arange(first, first + MOUNT_DIM + self.terms[index])


def _lifted(rows: FloatArray, lifts: Sequence[FloatArray]) -> FloatArray:
    """Return the product of a block-diagonal matrix, given by its blocks, with rows (n, m)."""
    ends = np.cumsum([lift.shape[1] for lift in lifts])[:-1]
    parts = zip(lifts, np.split(rows, ends), strict=True)
    return np.concatenate([lift @ part for lift, part in parts])


def beam_lifts(bases: FloatArray) -> FloatArray:
    """Return (B, 8, 7) from tangent to ambient coordinates of each beam, bases (B, 3, 2)."""
    lifts = np.zeros((len(bases), BEAM.size, BEAM.dim))
    lifts[:, OF_LOCATION, LOCATION] = np.eye(3)
    lifts[:, OF_DIRECTION, DIRECTION] = bases
    lifts[:, OF_RANGE_ERROR, RANGE_ERROR] = np.eye(2)
    return lifts


def beams_lift(bases: FloatArray, terms: Sequence[int]) -> FloatArray:
    """Return (8 B, nb) from the tangent coordinates of all beams, 5 + terms each, to ambient ones."""
    count = len(bases)
    each, lift = np.arange(count), np.zeros((count, BEAM.size, count, BEAM.dim))
    lift[each, :, each] = beam_lifts(bases)
    active = modelled(terms).ravel()
    return lift.reshape(BEAM.size * count, BEAM.dim * count)[:, active]


def plane_lifts(bases: FloatArray, origins: FloatArray) -> FloatArray:
    """Return (..., 4, 3) from (tangent of n, offset at `origins` (..., 3)) to (n, b) of planes."""
    lifts = np.zeros((*origins.shape[:-1], 4, 3))
    lifts[..., :3, :2] = bases
    lifts[..., 3, :2] = -(origins[..., None, :] @ bases)[..., 0, :]
    lifts[..., 3, 2] = 1.0
    return lifts


def plane_steps(bases: FloatArray, origins: FloatArray, planes: FloatArray) -> FloatArray:
    """Return (P, 3, q) from which `plane_lifts` leads to changes (P, 4, q) of (n, b)."""
    offsets = planes[:, 3] + np.einsum("pi,piq->pq", origins, planes[:, :3])
    tilts = np.einsum("pij,piq->pjq", bases, planes[:, :3])
    return np.concatenate((tilts, offsets[:, None]), axis=1)


def _indices(names: tuple[str, ...], wanted: Sequence[str] | None, kind: str) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    if isinstance(wanted, str):
        raise InputError(f"{wanted!r} as the names of {kind}s", f"a sequence: [{wanted!r}]")
    for name in wanted:
        if name not in names:
            raise InputError(f"{kind} {name!r}", f"one of {', '.join(names)}")
    return [names.index(name) for name in wanted]


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One of the numbers of a beam, as its family counts them."""

    beam: str
    number: int

    def __str__(self) -> str:
        """Return "beam NAME QUANTITY"."""
        return f"beam {self.beam} {BEAM.labels[self.number]}"


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two unknowns and their correlation coefficient."""

    first: Coordinate
    second: Coordinate
    coefficient: float

    @property
    def advice(self) -> str:
        """What would tell the two apart."""
        if max(self.first.number, self.second.number) >= OF_RANGE_ERROR.start:
            return "measure over a wider span of ranges, or estimate fewer range-error terms"
        if self.first.beam != self.second.beam:
            return "add planes with other normals"
        return "turn the hand further, and vary the range"


def correlation_matrix(
    beams: Sequence[str], directions: FloatArray, covariance: FloatArray
) -> tuple[tuple[Coordinate, ...], FloatArray]:
    """Return the unknowns of beams that are estimated, and their correlations, a row each.

    Of the three components of a direction, the largest follows from the others and is no row.

    Parameters
    ----------
    beams : B names
    directions : (B, 3)
    covariance : (8 B, 8 B)
        Over the numbers of every beam, ambient.
    """
    width = BEAM.size
    variance = np.diagonal(covariance)
    keep = variance > 0.0
    for index, v in enumerate(directions):
        keep[width * index + OF_DIRECTION.start + int(np.abs(v).argmax())] = False
    rows = np.flatnonzero(keep)
    sigma = np.sqrt(variance[rows])
    unknowns = tuple(Coordinate(beams[row // width], row % width) for row in rows.tolist())
    return unknowns, covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma)


def strong_correlations(joint: JointCovariance) -> tuple[Correlation, ...]:
    """Return the pairs of beam unknowns whose correlation exceeds `STRONG`, strongest first."""
    # The direction is perpendicular to its tangent plane; its sign does not matter here.
    directions = np.cross(joint.beam_bases[:, :, 0], joint.beam_bases[:, :, 1])
    unknowns, C = correlation_matrix(joint.beam_names, directions, joint.matrix(planes=[]))
    first, second = np.triu_indices(len(unknowns), 1)
    strong = np.flatnonzero(np.abs(C[first, second]) > STRONG)
    strong = strong[np.argsort(-np.abs(C[first, second])[strong], kind="stable")]
    return tuple(
        Correlation(unknowns[first[i]], unknowns[second[i]], float(C[first[i], second[i]]))
        for i in strong
    )
