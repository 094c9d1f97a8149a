"""What there is to say of a calibration of beams before planes."""

from functools import cached_property
from typing import TYPE_CHECKING

from . import evidence, parameters
from .description import Description
from .tables import Table, sentence
from .terminal import full_lines, screen_lines

if TYPE_CHECKING:
    from ..calibration import Calibration


class CalibrationDescription(Description):
    """What there is to say of a calibration of beams before planes, made when a view first asks."""

    calibration: "Calibration"

    @property
    def findings(self) -> tuple[str, ...]:
        """The reasons of the verdict, as sentences."""
        return super().findings if self.solved else (sentence(self.calibration.message),)

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
    def main_tables(self) -> tuple[Table, ...]:
        """Where the beams sit in the hand; nothing where that is not known."""
        return () if self.beams is None else (self.beams,)

    @property
    def observability(self) -> tuple[str, ...]:
        """What the recording determines, in sentences."""
        return tuple(evidence.observability_sentences(self))

    @property
    def advice(self) -> tuple[str, ...]:
        """What would improve the calibration, in sentences, the best first."""
        return tuple(evidence.advice_sentences(self))

    screen, full = screen_lines, full_lines
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
