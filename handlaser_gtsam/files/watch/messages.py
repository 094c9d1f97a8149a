"""What the page is sent of a calibration: its sections, figures and JSON, each a text of one line.

Sections are HTML that the templates of the report have escaped; figures escape names as plotly.js wants
it. What has not changed is the same text, and is sent to nobody again.
"""

import hashlib
import json

from ..report.page import content_of
from ..report.subject import Subject


def messages_of(subject: Subject) -> dict[str, str]:
    """Return messages by topic: an event's name, and after a colon what it is about."""
    sections, figures, result = content_of(subject)
    found = {
        f"figure:{name}": _line({"name": name, "figure": figure.json()})
        for name, figure in figures.items()
    }
    found |= {
        f"section:{name}": _line({"name": name, "html": html}) for name, html in sections.items()
    }
    found["result"] = result or "null"
    digest = hashlib.sha256("\n".join(found.values()).encode()).hexdigest()
    return found | {"state": _line({"opening": subject.opening, "digest": digest})}


def _line(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
