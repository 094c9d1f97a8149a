"""Foreign text, from files and callers: how it is shown, and which of it can be a name.

A name or a cell may hold line breaks, terminal escapes, or marks that turn the direction of writing;
a message that repeats it unchanged says something else than it means. Everything that Unicode does not
call printable is shown as an escape: control and format characters, surrogates, unassigned code points,
and every separator but the plain space.
"""

from collections.abc import Sequence

LONGEST_NAME = 200
"""Characters of the name of a beam, plane, station or column; longer ones are a fault of the file."""
SHOWN_CHARACTERS = 80
"""Characters of a value that a message repeats."""


def printable(text: str) -> str:
    r"""Return `text` with an escape, such as \x1b or \u202e, for all that is not printable."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object) -> str:
    """Return a foreign value as a message repeats it: quoted if it is text, escaped, and cut short."""
    if isinstance(value, str) and len(value) > SHOWN_CHARACTERS:
        return f"{printable(repr(value[:SHOWN_CHARACTERS]))}... ({len(value)} characters)"
    try:
        whole = printable(repr(value))
    except Exception:  # a foreign object may fail at anything, or be an integer of endless digits
        return f"a value of type {type(value).__name__}"
    return whole if len(whole) <= 2 * SHOWN_CHARACTERS else whole[:SHOWN_CHARACTERS] + "..."


def name_fault(name: object) -> str:
    """Return what keeps `name` from being the name of something; empty if nothing does."""
    if not isinstance(name, str):
        return f"{shown(name)} of type {type(name).__name__}, which is no text"
    if not name:
        return "an empty name"
    if len(name) > LONGEST_NAME:
        return f"a name of {len(name)} characters, {shown(name[:20])}..."
    if not name.isprintable():
        return f"a name with characters that cannot be printed, {shown(name)}"
    if name != name.strip():
        return f"a name with blanks at its ends, {shown(name)}"
    return ""


A_NAME = f"printable text of 1 to {LONGEST_NAME} characters without blanks at its ends"
"""What `name_fault` expects."""


def count(number: int, noun: str) -> str:
    """Return a number of things: "1 beam", "2 beams"."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def shortened(name: str, most: int) -> str:
    """Return a name of at most `most` letters, with its end: numbers there tell long names apart."""
    if len(name) <= most:
        return name
    end = (most - 1) // 2
    return f"{name[: most - 1 - end]}…{name[len(name) - end :]}"


def some(names: Sequence[str], most: int) -> str:
    """Return at most `most` names, and how many more there are."""
    shown = ", ".join(names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")
