"""The figure of which unknowns of the beams go together."""

from ...results.description.correlations import FLAGGED, Correlations
from ..json_text import Record
from .figure import Figure, axis, label, layout, numbers, tick_labels

ROOM_FOR_BEAMS = 28
"""Letters of all beams beside the correlations on a phone."""


def correlation_figure(found: Correlations) -> Figure:
    """Return the correlations as a map."""
    labels, C = found.labels, found.matrix
    beams = list(dict.fromkeys(beam for beam, _ in labels))
    first = [next(i for i, (beam, _) in enumerate(labels) if beam == name) for name in beams]
    ends = [*first[1:], len(labels)]
    numbered = {beam: label(beam) for beam in beams}
    if len(set(numbered.values())) < len(beams):  # names that differ only where they are cut
        numbered = {beam: f"{label(beam)} ({i})" for i, beam in enumerate(beams, 1)}
    words = [f"beam {numbered[beam]} {name}" for beam, name in labels]
    trace: Record = {
        "type": "heatmap",
        "z": [numbers(row, 3) for row in C],
        "x": words,
        "y": words,
        "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "zmin": -1,
        "zmax": 1,
        "colorscale": _scale(),
        "colorbar": {
            "thickness": 10,
            "len": 0.9,
            "outlinewidth": 0,
            "tickvals": [-1, -0.8, 0, 0.8, 1],
        },
    }
    caption = "Correlations. Every beam has location x, y, z, two components of its direction, and "
    caption += f"its range errors. Dark is above {FLAGGED} in size: hardly told apart."
    side = axis(
        "beam",
        type="category",
        tickvals=[(a + b - 1) / 2.0 for a, b in zip(first, ends, strict=True)],
        ticktext=tick_labels(beams, ROOM_FOR_BEAMS),
        showgrid=False,
        zeroline=False,
        ticks="",
    )
    upright = side | {"autorange": "reversed", "tickangle": -90}
    more: Record = {"xaxis": side, "yaxis": upright, "shapes": _borders(first[1:])}
    return Figure("correlation", caption, [trace], layout("", "", 420, more))


def _borders(starts: list[int]) -> list[Record]:
    """Return white lines between the beams."""
    line: Record = {"type": "line", "line": {"color": "white", "width": 2}}
    found = []
    for edge in (start - 0.5 for start in starts):
        found.append(line | {"xref": "paper", "x0": 0, "x1": 1, "y0": edge, "y1": edge})
        found.append(line | {"yref": "paper", "y0": 0, "y1": 1, "x0": edge, "x1": edge})
    return found


def _scale() -> list[tuple[float, str]]:
    """Return colours that are pale up to the flag and dark beyond."""
    edge = 0.5 * (1.0 + FLAGGED)
    return [
        (0.0, "#08306b"),
        (1.0 - edge, "#6baed6"),
        (0.5, "#f7f8fa"),
        (edge, "#fc9272"),
        (1.0, "#7f0000"),
    ]
