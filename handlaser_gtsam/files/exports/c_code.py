"""Beams as a C99 header: the true range of a reading, and where the beam ends in the base frame."""

from collections.abc import Sequence

from .beams import ExportedBeam, number, origin_line

TYPE = """
typedef struct {
    double location_m[3];
    double direction[3];
    double k1;
    double k2_per_m;
} handlaser_beam;
"""
FUNCTIONS = """
// The true range [m] of a reading [m].
static inline double handlaser_range(const handlaser_beam *beam, double reading_m)
{
    return reading_m * (1.0 + beam->k1 + beam->k2_per_m * reading_m);
}

// Where the beam ends, hand frame [m].
static inline void handlaser_point_in_hand(const handlaser_beam *beam, double reading_m,
                                           double point_m[3])
{
    double range = handlaser_range(beam, reading_m);
    for (int i = 0; i < 3; i++)
        point_m[i] = beam->location_m[i] + range * beam->direction[i];
}

// Where the beam ends in the frame in which the hand pose is given [m]. The pose is the position of
// the hand [m] and its quaternion x, y, z, w, of any length but zero.
static inline void handlaser_point_in_base(const handlaser_beam *beam, double reading_m,
                                           const double position_m[3], const double quaternion[4],
                                           double point_m[3])
{
    const double *q = quaternion;
    double w = q[3], twice = 2.0 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + w * w);
    double p[3], c[3];
    handlaser_point_in_hand(beam, reading_m, p);
    c[0] = q[1] * p[2] - q[2] * p[1] + w * p[0];
    c[1] = q[2] * p[0] - q[0] * p[2] + w * p[1];
    c[2] = q[0] * p[1] - q[1] * p[0] + w * p[2];
    point_m[0] = position_m[0] + p[0] + twice * (q[1] * c[2] - q[2] * c[1]);
    point_m[1] = position_m[1] + p[1] + twice * (q[2] * c[0] - q[0] * c[2]);
    point_m[2] = position_m[2] + p[2] + twice * (q[0] * c[1] - q[1] * c[0]);
}
"""


def c_text(beams: Sequence[ExportedBeam]) -> str:
    """Return a header that needs no other; the compiler takes out what is not used."""
    constants = []
    for beam in beams:
        r, v = (", ".join(map(number, one.tolist())) for one in (beam.location, beam.direction))
        k = f"{number(beam.k1)}, {number(beam.k2)}"
        constants += [
            f"// {beam.comment}",
            f"static const handlaser_beam {beam.identifier} = {{{{{r}}}, {{{v}}}, {k}}};",
        ]
    return "\n".join(
        [
            f"// {origin_line()}",
            "// Units: m. Needs C99, and no library.",
            "#ifndef HANDLASER_BEAMS_H",
            f"#define HANDLASER_BEAMS_H\n{TYPE}",
            *constants,
            f"{FUNCTIONS}\n#endif",
            "",
        ]
    )
