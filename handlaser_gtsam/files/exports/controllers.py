"""Beams as tool frames of robot controllers, each in its own units and orientation."""

import textwrap
from collections.abc import Sequence

from ...errors import InputError
from .beams import DEG, MM, ROLL, ExportedBeam, fixed, number, origin_line
from .frames import Axis, quaternion, rotation_vector, yaw_pitch_roll

REMARK = 30
"""Characters of a remark in a FANUC program."""
LAST_TOOL = 99
"""Largest number of a tool; how many a controller really has depends on its configuration."""


def kuka_text(beams: Sequence[ExportedBeam], axis: Axis, along: float) -> str:
    """Return a data list for KUKA (handlaser.dat): mm, and A, B, C about z, y, x in turn [deg]."""
    lines = ["&ACCESS RVO", "DEFDAT HANDLASER PUBLIC"]
    lines += [f"; {one}" for one in _comments(axis, along, "mm, deg")]
    lines.append(f"; In a program: $TOOL={beams[0].identifier.upper()}")
    for beam in beams:
        x, y, z, a, b, c = map(fixed, _mm_deg(beam, axis, along))
        frame = f"{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}"
        lines += [f"; {beam.comment}", f"DECL GLOBAL FRAME {beam.identifier.upper()}={frame}"]
    return "\n".join([*lines, "ENDDAT", ""])


def abb_text(beams: Sequence[ExportedBeam], axis: Axis, along: float) -> str:
    """Return a RAPID module for ABB: mm, and the quaternion with its scalar first."""
    lines = ["MODULE HANDLASER"]
    lines += [f"  ! {one}" for one in _comments(axis, along, "mm")]
    lines.append("  ! The load of each tool is that of tool0: put in what your hand weighs.")
    for beam in beams:
        frame = beam.frame(axis, along)
        at = ",".join(fixed(one * MM) for one in frame.t.tolist())
        qx, qy, qz, qw = quaternion(frame.R)
        turn = ",".join(fixed(one, 12) for one in (qw, qx, qy, qz))
        load = "[0.001,[0,0,0.001],[1,0,0,0],0,0,0]"
        lines += [
            f"  ! {beam.comment}",
            f"  PERS tooldata {beam.identifier}:=[TRUE,[[{at}],[{turn}]],{load}];",
        ]
    return "\n".join([*lines, "ENDMODULE", ""])


def fanuc_text(beams: Sequence[ExportedBeam], axis: Axis, along: float, tool: int) -> str:
    """Return a FANUC program (handlaser.ls) that sets UTOOL[tool] and on, through PR[tool] and on.

    Positions are in mm, and W, P, R about the fixed x, y, z in turn [deg].

    Raises
    ------
    InputError
        Tools beyond `LAST_TOOL`.
    """
    if tool + len(beams) - 1 > LAST_TOOL:
        found = f"tool {tool} as the first of {len(beams)}"
        raise InputError(found, f"numbers of tools that end at {LAST_TOOL} at most")
    steps: list[str] = []
    positions = []
    along_words = f" at {number(along * MM)} mm" if along else ""
    steps += _remarks(f"handlaser: {axis} along beam{along_words}")
    for index, beam in enumerate(beams):
        x, y, z, a, b, c = map(fixed, _mm_deg(beam, axis, along))
        at, slot = index + 1, tool + index
        steps += [
            *_remarks(f"UTOOL[{slot}]: {beam.comment}"),
            f"PR[{slot}]=P[{at}]",
            f"UTOOL[{slot}]=PR[{slot}]",
        ]
        positions += [
            f"P[{at}]{{",
            "   GP1:",
            f"\tUF : 0, UT : {slot},\t\tCONFIG : 'N U T, 0, 0, 0',",
            f"\tX = {x}  mm,\tY = {y}  mm,\tZ = {z}  mm,",
            f"\tW = {c} deg,\tP = {b} deg,\tR = {a} deg",
            "};",
        ]
    numbered = [f"{at:4d}:  {step} ;" for at, step in enumerate(steps, 1)]
    head = [
        "/PROG  HANDLASER",
        "/ATTR",
        'COMMENT\t\t= "laser beams";',
        "DEFAULT_GROUP\t= 1,*,*,*,*;",
    ]
    return "\n".join([*head, "/MN", *numbered, "/POS", *positions, "/END", ""])


def ur_text(beams: Sequence[ExportedBeam], axis: Axis, along: float) -> str:
    """Return URScript: poses in m with rotation vectors [rad]."""
    lines = [f"# {one}" for one in _comments(axis, along, "m, rad")]
    lines.append(f"# In a program: set_tcp({beams[0].identifier})")
    for beam in beams:
        frame = beam.frame(axis, along)
        pose = ", ".join(map(number, [*frame.t.tolist(), *rotation_vector(frame.R)]))
        lines += [f"# {beam.comment}", f"global {beam.identifier} = p[{pose}]"]
    return "\n".join([*lines, ""])


def _mm_deg(beam: ExportedBeam, axis: Axis, along: float) -> list[float]:
    """Return x, y, z [mm] and A, B, C [deg]; the matrix of FANUC's W, P, R is the same, reversed."""
    frame = beam.frame(axis, along)
    return [one * MM for one in frame.t.tolist()] + [one * DEG for one in yaw_pitch_roll(frame.R)]


def _comments(axis: Axis, along: float, units: str) -> list[str]:
    where = "where the true range is zero"
    if along:
        where = f"{number(along * MM)} mm down the beam from {where}"
    return [
        origin_line(),
        f"{axis} of each frame lies along its beam; its origin is {where}. Units: {units}.",
        ROLL,
    ]


def _remarks(text: str) -> list[str]:
    return [f"!{line}" for line in textwrap.wrap(text, REMARK)]
