"""All figures of a subject, in the order of the report: a further one is a line of this list."""

from ...results.correlations import CorrelationMatrix
from .correlations import correlation_figure
from .figure import LEGEND, Figure
from .history_figure import stations_figure
from .residual_figures import qq_figure, residual_figures
from .subject import Subject


def flat_figures(subject: Subject) -> list[Figure]:
    """Return the flat figures that there are something to draw for."""
    figures = [
        *residual_figures(subject),
        qq_figure(subject),
        _correlations(subject),
        stations_figure(subject),
    ]
    return [figure for figure in figures if figure is not None]


def _correlations(subject: Subject) -> Figure | None:
    """Return the correlations of the first beams; None without a covariance."""
    joint = subject.calibration.covariance
    if joint is None or not subject.solved:
        return None
    names = joint.beam_names[:LEGEND]
    directions = subject.calibration.parameters().directions[:LEGEND]
    return correlation_figure(CorrelationMatrix.of(names, directions, joint.matrix(names, [])))
