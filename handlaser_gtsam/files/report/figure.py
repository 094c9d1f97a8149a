"""Figures as plotly.js draws them: JSON made by hand, because a page needs no Python library for it.

Plotly reads a few HTML tags in every text, so that names from files are escaped here; and it takes
texts that look like dates or numbers for such, so that every axis has its type.
"""

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import FloatArray
from ...text import shortened
from ..checked_text import Record

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#56b4e9", "#b8860b", "#6a51a3", "#6b7280")
"""Colours of beams, which people who see no red or green tell apart, too."""
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "x", "star", "cross", "pentagon")
AXIS_COLOURS = ("#c0392b", "#2e8b57", "#2c6fbb")
"""Colours of x, y and z of the hand."""
LEGEND = len(COLOURS)
"""Beams that have a legend, and a place on the map of correlations, at most: one for every colour."""
GREY, LINE, INK = "#9aa3ad", "#e3e6ea", "#22303c"
NAME_IN_PICTURE = 26
"""Characters of a name in a picture: half of its width."""
MOST_POINTS = 1000
"""Points, segments or hands that a picture draws at most: a page with more is slow to turn and to
load."""
MOST_SHAPES = 60
"""Planes and bands that a picture draws at most: an eye tells no more of them apart."""
LETTERS_BELOW = 48
"""Letters of all labels below a picture on a phone."""
SHORTEST_LABEL = 3
"""Letters of a label at least: fewer tell no names apart."""
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture: its place in the page, a caption, and traces and layout of plotly.js."""

    name: str
    caption: str
    data: list[Record]
    layout: Record = field(default_factory=dict)

    def json(self) -> Record:
        """Return what the page's script draws."""
        return {"data": self.data, "layout": self.layout}


def label(name: str, longest: int = NAME_IN_PICTURE) -> str:
    """Return a foreign name for a picture: short, and taken neither for HTML nor for TeX."""
    return harmless(short(name, longest))


def tick_labels(names: Sequence[str], room: int = LETTERS_BELOW) -> list[str]:
    """Return names for the ticks of an axis that has room for `room` letters."""
    longest = max(SHORTEST_LABEL, room // max(len(names), 1))
    return [label(name, longest) for name in names]


def short(name: str, longest: int = NAME_IN_PICTURE) -> str:
    """Return a name, cut where it is longer than a picture has room for."""
    return shortened(name, longest)


def harmless(words: str) -> str:
    """Return foreign words that plotly.js shows as they are."""
    return html.escape(words, quote=False).replace("$", "&#36;")


def numbers(values: FloatArray | Iterable[float], digits: int = 6) -> list[float | None]:
    """Return numbers of this many significant digits for JSON; null where there is none."""
    return [
        None if not math.isfinite(x) else float(f"{x:.{digits}g}")
        for x in np.asarray(values, dtype=float).ravel().tolist()
    ]


def layout(
    x: str, y: str, height: int = 320, more: Record | None = None, *, legend: bool = False
) -> Record:
    """Return the layout that all flat figures share: thin lines, no frame, the page's font.

    A legend stands above a figure.
    """
    shared: Record = {
        "height": height,
        "margin": {"l": 58, "r": 14, "t": 34 if legend else 12, "b": 48},
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": axis(x),
        "yaxis": axis(y),
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "yanchor": "bottom",
            "font": {"size": 11},
        },
        "hoverlabel": {"font": {"size": 12}, "align": "left"},
        "dragmode": False,
        "showlegend": legend,
    }
    return shared | (more or {})


def axis(title: str, **more: object) -> Record:
    """Return an axis with a title."""
    shared: Record = {
        "title": {"text": title, "standoff": 8},
        "type": "linear",
        "gridcolor": LINE,
        "linecolor": GREY,
        "zerolinecolor": GREY,
        "zerolinewidth": 1,
        "ticks": "outside",
        "tickcolor": GREY,
        "ticklen": 4,
        "automargin": True,
    }
    return shared | more


def marker(index: int, count: int) -> Record:
    """Return the marker of one of `count` beams: the same for all where there are more than colours."""
    symbol = SYMBOLS[index] if count <= LEGEND else SYMBOLS[0]
    return {"color": colour(index, count), "symbol": symbol, "size": 6}


def colour(index: int, count: int) -> str:
    """Return the colour of one of `count` beams: the same for all where there are more than colours."""
    return COLOURS[index] if count <= LEGEND else COLOURS[0]
