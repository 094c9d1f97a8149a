r"""Systematic errors as unknowns of the SciPy reference, by formulas of its own.

An unknown of size a moves the hand poses, R exp(a omega) and t + a u in the world frame, or makes the
readings longer, by a f. A lag adds a^2 times a bend to turn and shift, so that the hand moves along the
parabola through three stations. Steps and bends follow from the recorded poses alone; f follows from
ranges and angles of incidence at a solution. The numbers 8, 2 and 32 are stated again here, for nothing
is shared with the effects of the model:

    incidence      tan^2 of the angle of incidence
    cubic          (d / largest d)^3
    drift          T - 1/2, and -exp(-8 T): steadily, and as a sensor warms up; T from 0 to 1
    beam-on-plane  1 for one beam before one plane
    displaced      1 / (|cos| g'(d)) for one plane from one of its stations on
    sag            as displaced, times the squared distance from the middle of the plane's spots
    carry-over     the reading expected of the channel before, less the one expected of the own
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import Recording

ERRORS = (
    "incidence",
    "cubic",
    "drift",
    "beam-on-plane",
    "displaced",
    "sag",
    "carry-over",
    "lag",
    "turn-scale",
    "translation-scale",
    "tool-displaced",
)
"""Systematic errors that can be unknowns here, by the codes of the package."""


class SystematicErrors:
    """Unknown sizes of systematic errors of a recording.

    Parameters
    ----------
    sigmas : mapping of str to float
        Standard deviations of the zero-mean priors by code, of `ERRORS`.
    recording : Recording
    seen : (M, B)
        Readings that the errors are defined by: those used, and others like them.

    Attributes
    ----------
    members : tuple of (code, subject)
        Of each of the q unknowns: its code, and whom it concerns in the words of a `FreedEffect`.
    sigma : (q,)
        Of the priors [m, or a part].
    """

    def __init__(self, sigmas: Mapping[str, float], recording: Recording, seen: BoolArray) -> None:
        self.recording = recording
        self.station, self.beam = np.nonzero(seen)
        self.plane = recording.plane_of_station[self.station]
        self.stations = np.unique(self.station)
        self.time = np.arange(len(seen)) / max(int(self.stations.max()), 1)
        moves = [(code, *one) for code in sigmas for one in self._moves(code)]
        parts = [(code, *one) for code in sigmas for one in self._parts(code)]
        self.members = tuple((code, subject) for code, subject, _ in (*moves, *parts))
        self.sigma = np.array([sigmas[code] for code, _ in self.members])
        self.steps = np.zeros((len(self.members), len(seen), 6))
        self.bends = np.zeros_like(self.steps)
        self.parts = np.zeros((len(self.members), len(self.station))).T
        for i, (code, _, step) in enumerate(moves):
            self.steps[i] = step
            if code == "lag":
                self.bends[i] = self._step_and_bend()[1]
        for i, (*_, part) in enumerate(parts, len(moves)):
            self.parts[:, i] = part

    def hands(self, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true hand poses (M, 3, 3) and (M, 3) at sizes (q,)."""
        R, t = self.recording.world_R_hand, self.recording.world_t_hand
        if not self.steps.any():
            return R, t
        step = np.tensordot(size, self.steps, 1) + np.tensordot(size**2, self.bends, 1)
        turn = Rotation.from_rotvec(step[:, :3])
        return (Rotation.from_matrix(R) * turn).as_matrix(), t + step[:, 3:]

    def longer(
        self,
        d: FloatArray,
        expected: FloatArray,
        cosine: FloatArray,
        slope: FloatArray,
        spot: FloatArray,
    ) -> FloatArray:
        """Return by how much errors of size 1 make the readings longer (N, q), zero for moved hands.

        Parameters
        ----------
        d, expected : (N,)
            Readings, recorded and expected [m].
        cosine : (N,)
            Of the angles of incidence.
        slope : (N,)
            g'(d).
        spot : (N, 3)
            Laser spots in the world [m].
        """
        about = spot.copy()
        for p in np.unique(self.plane):
            about[self.plane == p] -= about[self.plane == p].mean(axis=0)
        square = (about**2).sum(axis=1)
        table = np.full(self.recording.ranges.shape, np.nan)
        table[self.station, self.beam] = expected
        change = np.roll(table, 1, axis=1) - table
        farther = 1.0 / np.abs(cosine) / slope
        longer = {
            "incidence": (1.0 - cosine**2) / cosine**2,
            "cubic": (d / d.max()) ** 3,
            "displaced": farther,
            "sag": farther * square / square.max(),
            "carry-over": np.nan_to_num(change[self.station, self.beam]),
        }
        one = np.ones(len(d))
        columns = [longer.get(code, one) for code, _ in self.members]
        return np.asarray(self.parts * np.array(columns).reshape(-1, len(d)).T)

    def _moves(self, code: str) -> list[tuple[str, FloatArray]]:
        """Return whom an error of the hand poses concerns, and its steps (M, 6) of size 1.

        Turns in the hand [rad], then shifts in the world [m].
        """
        R, t = self.recording.world_R_hand, self.recording.world_t_hand
        step = np.zeros((len(t), 6))
        if code == "translation-scale":
            step[:, 3:] = t
        elif code == "turn-scale":
            U, _, V = np.linalg.svd(R[self.stations].sum(axis=0))
            mean = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
            step[:, :3] = Rotation.from_matrix(mean.T @ R).as_rotvec()
        elif code == "lag":
            step, _ = self._step_and_bend()
        elif code == "tool-displaced":
            return self._moves_of_tool()
        else:
            return []
        return [("", step)]

    def _step_and_bend(self) -> FloatArray:
        """Return half of the difference and of the sum of the ways (2, M, 6) on and back.

        The first and the last station of a plane lie on a line with their neighbour. Stations without a
        reading are on the way, too.
        """
        R, t = self.recording.world_R_hand, self.recording.world_t_hand
        plane, found = self.recording.plane_of_station, np.zeros((2, len(t), 6))
        for own in [np.flatnonzero(plane == one) for one in np.unique(plane)]:
            for place, station in enumerate(own):
                ways = []
                for by in (-1, 1):
                    if 0 <= place + by < len(own):
                        other = own[place + by]
                        turn = Rotation.from_matrix(R[station].T @ R[other]).as_rotvec()
                        ways.append(by * np.concatenate((turn, t[other] - t[station])))
                if ways:
                    found[:, station] = np.mean(ways, axis=0), 0.5 * (ways[-1] - ways[0])
        return found

    def _moves_of_tool(self) -> list[tuple[str, FloatArray]]:
        """Return displacements about their mean: along each axis, steadily and from stations on."""
        count = len(self.stations)
        splits = {round(count * part / 8.0) for part in range(1, 8)}
        shares, moves = {"steadily": self.time}, []
        for split in splits:
            if 2 <= split <= count - 2:
                first = int(self.stations[split])
                since = np.arange(len(self.time)) >= first
                shares[f"from station number {first + 1} on"] = since.astype(float)
        for when, share in shares.items():
            off = share - share[self.station].mean()
            for axis, name in enumerate("xyz"):
                shift = off[:, None] * self.recording.world_R_hand[:, :, axis]
                moves.append((f"along {name} {when}", np.hstack((np.zeros_like(shift), shift))))
        return moves

    def _parts(self, code: str) -> list[tuple[str, FloatArray]]:
        """Return whom an error of the readings concerns, and how much each takes part in it (N,)."""
        names, T = self.recording, self.time[self.station]
        found: list[tuple[str, FloatArray]] = []
        if code in ("incidence", "cubic", "sag", "carry-over"):
            found = [("", np.ones_like(T))]
        elif code == "drift":
            found = [("steady", T - 0.5), ("warming up", -np.exp(-8.0 * T))]
        elif code == "beam-on-plane":
            pairs = sorted({*zip(self.plane.tolist(), self.beam.tolist(), strict=True)})
            for plane, beam in pairs:
                beams, planes = (
                    sum(pair[i] == n for pair in pairs) for i, n in enumerate((plane, beam))
                )
                if beams > 1 and planes > 1:
                    words = f"beam {names.beam_names[beam]} on plane {names.plane_names[plane]}"
                    found.append(
                        (words, ((self.plane == plane) & (self.beam == beam)).astype(float))
                    )
        elif code == "displaced":
            for plane, own in enumerate(self._by_plane()):
                splits = np.arange(2, len(own) - 1)
                few = np.linspace(2, len(own) - 2, min(len(splits), 32)).round().astype(int)
                splits = few if len(splits) > 32 else splits
                for first in own[splits].tolist():
                    since = f"from station {names.station_names[first]} on"
                    late = (self.plane == plane) & (self.station >= first)
                    words = f"plane {names.plane_names[plane]} {since}"
                    found.append((words, late.astype(float)))
        return found

    def _by_plane(self) -> list[IntArray]:
        """Return the stations that see each plane, in the order of the recording."""
        plane = self.recording.plane_of_station[self.stations]
        return [self.stations[plane == p] for p in range(len(self.recording.plane_names))]
