"""What there is to say of a calibration: terminal, notebook, report and live page render it.

Facts are pairs of a name and words; tables hold text with the number behind it. What a calibration does
not know is no table at all.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from ...text import count
from ..lines import WIDTH
from ..result import Result
from ..verdict import Verdict
from .tables import Table, as_html, sentence


@dataclass(frozen=True)
class Description(ABC):
    """A calibration, the verdict on it, and what follows from the two.

    Attributes
    ----------
    calibration : Result
    verdict : Verdict
    """

    calibration: Result
    verdict: Verdict

    @property
    def solved(self) -> bool:
        """Whether there is a calibration: every number of it means something."""
        return self.calibration.success

    @property
    def findings(self) -> tuple[str, ...]:
        """The reasons of the verdict, as sentences."""
        return tuple(map(sentence, self.verdict.findings))

    @property
    def sizes(self) -> str:
        """How much there is of everything, in one line: "44 stations, 4 planes, ..."."""
        return ", ".join(
            f"{number} rejected" if name == "rejected" else count(number, name.removesuffix("s"))
            for name, number in self.counts
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that the verdict does not repeat, as the calibration orders them."""
        warnings = self.calibration.warnings
        return tuple(str(one) for one in warnings if not self.verdict.says(one.message))

    @property
    @abstractmethod
    def counts(self) -> tuple[tuple[str, int], ...]:
        """How much there is of everything, as names and numbers."""

    @property
    @abstractmethod
    def main_tables(self) -> tuple[Table, ...]:
        """Where everything sits in the hand; none of what is not known."""

    @abstractmethod
    def screen(self, *, closing: int = 0, width: int = WIDTH) -> list[str]:
        """Return the default screen, with room for `closing` lines after it."""

    @abstractmethod
    def full(self, width: int = WIDTH) -> list[str]:
        """Return everything that there is to say, in reading order."""

    def notebook_html(self) -> str:
        """Return the verdict, the sizes and the main tables as HTML; names are escaped."""
        return as_html(self.verdict.sentence, self.sizes, self.main_tables)
