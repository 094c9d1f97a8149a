"""What there is to say of a calibration: terminal, notebook, report and live page render it.

Facts are pairs of a name and words; tables hold text with the number behind it. What a calibration does
not know is no table at all.
"""

from dataclasses import dataclass
from functools import cached_property

from ...text import count
from ..calibration_data import CalibrationData
from ..verdict import Verdict
from . import evidence, parameters
from .tables import sentence


@dataclass(frozen=True)
class Description:
    """A calibration, the verdict on it, and what follows from the two.

    Attributes
    ----------
    calibration : CalibrationData
    verdict : Verdict
    """

    calibration: CalibrationData
    verdict: Verdict

    @property
    def solved(self) -> bool:
        """Whether there is a calibration: every number of beams and planes means something."""
        return self.calibration.status == "converged"

    @property
    def opening(self) -> str:
        """The verdict in a few words."""
        return self.verdict.opening

    @property
    def mark(self) -> str:
        """The colour of the verdict: `good`, `care` or `bad`."""
        return self.verdict.mark

    @property
    def findings(self) -> tuple[str, ...]:
        """The reasons of the verdict, as sentences."""
        found = self.verdict.findings if self.solved else (self.calibration.message,)
        return tuple(map(sentence, found))

    @property
    def counts(self) -> tuple[tuple[str, int], ...]:
        """How much there is of everything, as names and numbers."""
        calibration = self.calibration
        fit, recording = calibration.fit, calibration.recording
        stations = () if recording is None else (("stations", len(recording.plane_labels)),)
        return (
            *stations,
            ("planes", len(calibration.planes)),
            ("beams", len(calibration.beams)),
            ("readings", fit.readings + len(fit.rejected)),
            ("rejected", len(fit.rejected)),
        )

    @property
    def sizes(self) -> str:
        """The same in one line: "44 stations, 4 planes, ..."."""
        return ", ".join(
            f"{number} rejected" if name == "rejected" else count(number, name.removesuffix("s"))
            for name, number in self.counts
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that the verdict does not repeat, as `calibration.warnings` orders them."""
        warnings = self.calibration.warnings
        return tuple(str(one) for one in warnings if not self.verdict.says(one.message))

    @property
    def observability(self) -> tuple[str, ...]:
        """What the recording determines, in sentences."""
        return tuple(evidence.observability_sentences(self))

    @property
    def advice(self) -> tuple[str, ...]:
        """What would improve the calibration, in sentences, the best first."""
        return tuple(evidence.advice_sentences(self))

    # Tables and facts, made when a view first asks for them.
    beams = cached_property(parameters.beams_table)
    mounts = cached_property(parameters.mounts_table)
    spots = cached_property(parameters.spots_table)
    planes = cached_property(parameters.planes_table)
    limits = cached_property(parameters.limits_table)
    fit = cached_property(evidence.fit_facts)
    correlations = cached_property(evidence.correlations_table)
    systematic = cached_property(evidence.systematic_table)
    systematic_facts = cached_property(evidence.systematic_facts)
    rejected = cached_property(evidence.rejected_table)
