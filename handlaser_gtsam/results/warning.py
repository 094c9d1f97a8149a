"""What makes a result worth a second look: a code for programs, a sentence for people."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CalibrationWarning:
    """A sign that a result should not be believed as it stands.

    Attributes
    ----------
    code : str
        What kind of sign, in lower case with hyphens; the kinds are listed in docs/files.md.
    message : str
        What was found, and what to look at.
    """

    code: str
    message: str

    def __str__(self) -> str:
        return self.message
