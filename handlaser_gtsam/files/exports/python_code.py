"""Beams as a Python module that needs no other: the true range, and where the beam ends."""

from collections.abc import Sequence

from .beams import ExportedBeam, number, origin_line
from .names import literal

FUNCTIONS = '''

def true_range(beam, reading):
    """Return the true range [m] of a reading [m] of the beam of that name."""
    _, _, k1, k2 = BEAMS[beam]
    return reading * (1.0 + k1 + k2 * reading)


def point_in_hand(beam, reading):
    """Return where the beam ends, (x, y, z) in the hand frame [m]."""
    location, direction, _, _ = BEAMS[beam]
    s = true_range(beam, reading)
    return tuple(r + s * v for r, v in zip(location, direction))


def point_in_base(beam, reading, position, quaternion):
    """Return where the beam ends in the frame in which the hand pose is given [m].

    The pose is the position of the hand (x, y, z) [m] and its quaternion (x, y, z, w), of any length
    but zero.
    """
    x, y, z, w = quaternion
    twice = 2.0 / (x * x + y * y + z * z + w * w)
    p = point_in_hand(beam, reading)
    a = y * p[2] - z * p[1] + w * p[0]
    b = z * p[0] - x * p[2] + w * p[1]
    c = x * p[1] - y * p[0] + w * p[2]
    return (
        position[0] + p[0] + twice * (y * c - z * b),
        position[1] + p[1] + twice * (z * a - x * c),
        position[2] + p[2] + twice * (x * b - y * a),
    )
'''


def python_text(beams: Sequence[ExportedBeam]) -> str:
    """Return a module with the table `BEAMS`, by the names of the beams, and three functions."""
    rows = []
    for beam in beams:
        r, v = (", ".join(map(number, one.tolist())) for one in (beam.location, beam.direction))
        rows += [
            f"    # {beam.comment}",
            f"    {literal(beam.name)}: (({r}), ({v}), {number(beam.k1)}, {number(beam.k2)}),",
        ]
    return "\n".join(
        [
            f'"""{origin_line()}\n\nUnits: m. Needs no other module.\n"""\n',
            "BEAMS = {  # location [m], direction, k1, k2 [1/m]",
            *rows,
            "}",
            FUNCTIONS.rstrip("\n"),
            "",
        ]
    )
