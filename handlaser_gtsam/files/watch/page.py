"""The page: one HTML text that asks nobody but its server, and holds no word of any recording."""

import base64
import hashlib
from dataclasses import dataclass

from ..report.page import packed, templates


@dataclass(frozen=True, slots=True)
class Page:
    """The page, what names this version of it, and the policy that lets a browser run nothing else."""

    html: str
    name: str
    policy: str


def live_page() -> Page:
    """Make the page.

    The scripts that may run are told by their hashes: the page's own, and plotly.js, which is in the
    page compressed.
    """
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    environment, library = templates("watch"), get_plotlyjs()
    script = environment.get_template("live.js").render()
    template = environment.get_template("live.html.j2")
    parts = {
        "script": script,
        "plotly": packed(library),
        "plotly_version": get_plotlyjs_version(),
    }
    name = hashlib.sha256(template.render(**parts, name="").encode()).hexdigest()[:16]
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {_hash(script)} {_hash(library)}",
            "style-src 'unsafe-inline'",  # plotly.js places everything by attributes
            "img-src data: blob:",
            "font-src data:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )
    return Page(template.render(**parts, name=name), name, policy)


def _hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
