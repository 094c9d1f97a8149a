"""Beams as structured text (IEC 61131-3): the true range, and where the beam ends in the base frame."""

from collections.abc import Sequence

from .beams import ExportedBeam, number, origin_line

TYPE = """
TYPE HANDLASER_BEAM :
STRUCT
    X : LREAL; (* location, hand frame, m *)
    Y : LREAL;
    Z : LREAL;
    VX : LREAL; (* unit direction, hand frame *)
    VY : LREAL;
    VZ : LREAL;
    K1 : LREAL; (* range error *)
    K2 : LREAL; (* range error, 1/m *)
END_STRUCT
END_TYPE
"""
FUNCTIONS = """
(* The true range, m, of a reading, m. *)
FUNCTION HANDLASER_RANGE : LREAL
VAR_INPUT
    BEAM : HANDLASER_BEAM;
    READING : LREAL;
END_VAR
    HANDLASER_RANGE := READING * (LREAL#1.0 + BEAM.K1 + BEAM.K2 * READING);
END_FUNCTION

(* Where the beam ends, X, Y, Z in the frame in which the hand pose is given, m. The pose is the
   position of the hand, PX, PY, PZ, m, and its quaternion of any length but zero. *)
FUNCTION_BLOCK HANDLASER_POINT
VAR_INPUT
    BEAM : HANDLASER_BEAM;
    READING : LREAL;
    PX : LREAL;
    PY : LREAL;
    PZ : LREAL;
    QX : LREAL;
    QY : LREAL;
    QZ : LREAL;
    QW : LREAL;
END_VAR
VAR_OUTPUT
    X : LREAL;
    Y : LREAL;
    Z : LREAL;
END_VAR
VAR
    S : LREAL;
    HX : LREAL;
    HY : LREAL;
    HZ : LREAL;
    TWICE : LREAL;
    CX : LREAL;
    CY : LREAL;
    CZ : LREAL;
END_VAR
    S := HANDLASER_RANGE(BEAM := BEAM, READING := READING);
    HX := BEAM.X + S * BEAM.VX;
    HY := BEAM.Y + S * BEAM.VY;
    HZ := BEAM.Z + S * BEAM.VZ;
    TWICE := LREAL#2.0 / (QX * QX + QY * QY + QZ * QZ + QW * QW);
    CX := QY * HZ - QZ * HY + QW * HX;
    CY := QZ * HX - QX * HZ + QW * HY;
    CZ := QX * HY - QY * HX + QW * HZ;
    X := PX + HX + TWICE * (QY * CZ - QZ * CY);
    Y := PY + HY + TWICE * (QZ * CX - QX * CZ);
    Z := PZ + HZ + TWICE * (QX * CY - QY * CX);
END_FUNCTION_BLOCK
"""
FIELDS = ("X", "Y", "Z", "VX", "VY", "VZ", "K1", "K2")


def structured_text(beams: Sequence[ExportedBeam]) -> str:
    """Return a type, a constant for each beam, a function and a function block."""
    constants = []
    for beam in beams:
        values = [*beam.location.tolist(), *beam.direction.tolist(), beam.k1, beam.k2]
        pairs = zip(FIELDS, values, strict=True)
        fields = ", ".join(f"{field} := LREAL#{number(value)}" for field, value in pairs)
        constants += [
            f"    (* {beam.comment} *)",
            f"    {beam.identifier.upper()} : HANDLASER_BEAM := ({fields});",
        ]
    head = f"(* {origin_line()}\n   Units: m. *)"
    table = "\n".join(["VAR_GLOBAL CONSTANT", *constants, "END_VAR"])
    return "\n".join([head + "\n" + TYPE, table + "\n" + FUNCTIONS])
