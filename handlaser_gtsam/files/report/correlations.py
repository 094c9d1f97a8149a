"""The figure of which unknowns of the beams go together."""

from ...results.correlations import LABELS, STRONG, CorrelationMatrix
from ..json_text import Record
from .figure import LETTERS_BELOW, Figure, axis, label, layout, numbers, tick_labels


def correlation_figure(correlations: CorrelationMatrix) -> Figure:
    """Return the correlations as a map."""
    labels = [(unknown.beam, LABELS[unknown.number]) for unknown in correlations.unknowns]
    C = correlations.matrix
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
        "colorscale": [  # pale up to a strong correlation, and dark beyond
            (0.0, "#08306b"),
            (0.5 * (1.0 - STRONG), "#6baed6"),
            (0.5, "#f7f8fa"),
            (0.5 * (1.0 + STRONG), "#fc9272"),
            (1.0, "#7f0000"),
        ],
        "colorbar": {
            "thickness": 10,
            "len": 0.9,
            "outlinewidth": 0,
            "tickvals": [-1, -0.5, 0, 0.5, 1],
        },
    }
    caption = "Correlations. Every beam has location x, y, z, two components of its direction, and "
    caption += f"its range errors. Dark is above {STRONG} in size: hardly told apart."
    side = axis(
        "beam",
        type="category",
        tickvals=[(a + b - 1) / 2.0 for a, b in zip(first, ends, strict=True)],
        ticktext=tick_labels(beams, LETTERS_BELOW // 2),
        showgrid=False,
        zeroline=False,
        ticks="",
    )
    white: Record = {"type": "line", "line": {"color": "white", "width": 2}}
    borders: list[Record] = []  # between the beams
    for edge in (start - 0.5 for start in first[1:]):
        borders.append(white | {"xref": "paper", "x0": 0, "x1": 1, "y0": edge, "y1": edge})
        borders.append(white | {"yref": "paper", "y0": 0, "y1": 1, "x0": edge, "x1": edge})
    upright = side | {"autorange": "reversed", "tickangle": -90}
    more: Record = {"xaxis": side, "yaxis": upright, "shapes": borders}
    return Figure("correlation", caption, [trace], layout("", "", 420, more))
