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
from ..json_text import Record

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#56b4e9", "#b8860b", "#6a51a3", "#6b7280")
"""Told apart by people who see no red or green, too."""
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "x", "star", "cross", "pentagon")
AXIS_COLOURS = ("#c0392b", "#2e8b57", "#2c6fbb")
"""Of x, y and z of the hand."""
LEGEND = 8
"""Up to so many beams have a legend."""
GREY, LINE, INK = "#9aa3ad", "#e3e6ea", "#22303c"
LONGEST = 26
"""Characters of a name in a picture."""
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


def label(name: str, longest: int = LONGEST) -> str:
    """Return a foreign name for a picture: short, and taken neither for HTML nor for TeX."""
    return harmless(short(name, longest))


def tick_labels(names: Sequence[str], room: int) -> list[str]:
    """Return names for the ticks of an axis that has room for so many letters."""
    longest = max(3, room // max(len(names), 1))
    return [label(name, longest) for name in names]


def short(name: str, longest: int = LONGEST) -> str:
    """Return a name, cut where it is longer than a picture has room for."""
    return shortened(name, longest)


def harmless(words: str) -> str:
    """Return foreign words that plotly.js shows as they are."""
    return html.escape(words, quote=False).replace("$", "&#36;")


def numbers(values: FloatArray | Iterable[float], digits: int = 6) -> list[float | None]:
    """Return numbers for JSON, to so many significant digits; null where there is none."""
    return [
        None if not math.isfinite(x) else float(f"{x:.{digits}g}")
        for x in np.asarray(values, dtype=float).ravel().tolist()
    ]


def layout(x: str, y: str, height: int = 320, more: Record | None = None) -> Record:
    """Return the layout that all flat figures share: thin lines, no frame, the page's font."""
    found: Record = {
        "height": height,
        "margin": {"l": 58, "r": 14, "t": 12, "b": 48},
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
        "showlegend": False,
    }
    return found | (more or {})


def axis(title: str, **more: object) -> Record:
    """Return an axis with a title."""
    found: Record = {
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
    return found | more


def colour(index: int, count: int) -> str:
    """Return the colour of one of so many beams; one for all where there are too many to tell."""
    return COLOURS[index] if count <= len(COLOURS) else COLOURS[0]
