"""Figures as plotly.js draws them: JSON made by hand, because a page needs no Python library for it.

How layouts, axes and traces look stands in `page.json`, in the words of plotly; captions stand in the
templates of the pages. Plotly reads a few HTML tags in every text, so that names from files are escaped
here; and it takes texts that look like dates or numbers for such, so that every axis has its type.
"""

import html
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...arrays import FloatArray
from ...text import shortened
from ..checked_text import Record

STYLE: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "page.json").read_text())
"""The look that figures share, as plotly.js takes it, by the name of a layout, an axis or a trace; and
the sections of pages."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#56b4e9", "#b8860b", "#6a51a3", "#6b7280")
"""Colours of beams, which people who see no red or green tell apart, too."""
SYMBOLS = STYLE["symbols"]
"""Symbols of beams by their names in plotly, as matplotlib calls them."""
AXIS_COLOURS = ("#c0392b", "#2e8b57", "#2c6fbb")
"""Colours of x, y and z of the hand."""
LEGEND = len(COLOURS)
"""Beams that have a legend at most: one for every colour."""
NAME_IN_PICTURE = 26
"""Characters of a name in a picture: half of its width."""
MOST_POINTS = 1000
"""Points, segments or hands that a picture draws at most: a page with more is slow to turn and to
load."""
MOST_SHAPES = 60
"""Planes, bands, points of a profile, or rays of a sensor that a picture draws at most: an eye tells no
more of them apart."""
CLEAR = 1.15
"""Planes and scales that are drawn reach this many times as far as what they show: it stands clear of
their edge."""


class Figure(NamedTuple):
    """A picture: its place in the page, and traces and layout of plotly.js."""

    name: str
    data: list[Record]
    layout: Record

    def json(self) -> Record:
        """Return what the page's script draws."""
        return {"data": self.data, "layout": self.layout}


def label(name: str, longest: int = NAME_IN_PICTURE) -> str:
    """Return a foreign name for a picture: short, and taken neither for HTML nor for TeX."""
    return harmless(shortened(name, longest))


def short(name: str) -> str:
    """Return a name, cut where it is longer than a picture has room for."""
    return shortened(name, NAME_IN_PICTURE)


def harmless(words: str) -> str:
    """Return foreign words that plotly.js shows as they are."""
    return html.escape(words, quote=False).replace("$", "&#36;")


def numbers(values: FloatArray | Iterable[float], digits: int = 6) -> list[float | None]:
    """Return numbers of this many significant digits for JSON; null where there is none."""
    return [
        None if not math.isfinite(x) else float(f"{x:.{digits}g}")
        for x in np.asarray(values, dtype=float).ravel().tolist()
    ]


def trace(style: str, x: FloatArray, y: FloatArray, digits: int = 6) -> Record:
    """Return a trace of points (x, y), as one of the styles has it."""
    return STYLE[style] | {"x": numbers(x, digits), "y": numbers(y, digits)}


def layout(x: str, y: str, *, legend: bool = False) -> Record:
    """Return the layout that all flat figures share: thin lines, no frame, the page's font.

    A legend stands above a figure.
    """
    shared = STYLE["flat"] | {"xaxis": axis(x), "yaxis": axis(y)}
    return shared | (STYLE["legend"] if legend else {})


def axis(title: str, **more: object) -> Record:
    """Return an axis with a title."""
    return {"title": {"text": title, "standoff": 8}} | STYLE["axis"] | more


def axis_of_stations(count: int) -> Record:
    """Return the axis on which the stations stand at 1, 2 ..."""
    return axis("station, in their order", zeroline=False, range=[0.0, count + 1.0])


def axis_of_names(title: str, names: Sequence[str]) -> Record:
    """Return the axis on which named things stand at 0, 1 ...; where there are many, some are named."""
    room, shortest = 48, 3  # letters of all labels on a phone; of one, fewer tell no names apart
    ticks = list(range(0, len(names), max(1, math.ceil(len(names) * shortest / room))))
    longest = max(shortest, room // max(len(ticks), 1))
    words, ends = [label(names[i], longest) for i in ticks], [-0.6, len(names) - 0.4]
    return axis(title, tickvals=ticks, ticktext=words, range=ends) | STYLE["names"]


def marker(index: int, count: int) -> Record:
    """Return the marker of one of `count` beams: the same for all where there are more than colours."""
    symbol = list(SYMBOLS)[index if count <= LEGEND else 0]
    return {"color": colour(index, count), "symbol": symbol, "size": 6}


def colour(index: int, count: int) -> str:
    """Return the colour of one of `count` beams: the same for all where there are more than colours."""
    return COLOURS[index if count <= LEGEND else 0]
