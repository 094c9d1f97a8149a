"""All figures of a subject, in the order of the report."""

from ...results.description.correlations import correlations_of
from .correlations import correlation_figure
from .figure import Figure
from .history_figure import stations_figure
from .residual_figures import qq_figure, residual_figures
from .subject import Subject


def flat_figures(subject: Subject) -> list[Figure]:
    """Return the flat figures that there are something to draw for."""
    correlated = correlations_of(subject.calibration)
    found = [
        *residual_figures(subject),
        qq_figure(subject),
        None if correlated is None else correlation_figure(correlated),
        stations_figure(subject),
    ]
    return [one for one in found if one is not None]
