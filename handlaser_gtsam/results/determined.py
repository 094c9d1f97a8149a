"""What a solution determines, and the status and message that follow."""

from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..estimation.solution import Solution
from ..observability.mirror import mirror_image_fits
from ..observability.rank import observability
from ..observability.wording import (
    MIRROR,
    MIRROR_ADVICE,
    Names,
    advice,
    open_parts,
    undetermined,
    weakest,
)
from .calibration import Determined, Fit, Status
from .warnings import noise_advice

NO_REDUNDANCY = "the noise of the readings: there are no more readings than unknowns"
NO_REDUNDANCY_ADVICE = "add stations, or give the range sigma"


def determined_by(names: Names, used: Readings, solution: Solution, fit: Fit) -> Determined:
    """Return what the readings that were used, each plane in its own frame, determine."""
    found, parameters = solution.observability, solution.parameters
    parts = open_parts(found, parameters, names)
    if solution.prior is not None:  # what is known of range errors without any reading
        parts = tuple(part for part in parts if part.quantity != "range error")
    words, help_ = undetermined(parts), advice(parts)
    if found.full and solution.redundancy <= 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and _is_ambiguous(used, solution, fit):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full and _motion_determines(used, solution):
        help_ = (noise_advice(fit),)
    return Determined(
        found.rank,
        found.unknowns,
        found.condition if found.full else None,
        words,
        help_,
        parts,
        found.indices(),
        weakest(found, parameters, names),
    )


def _motion_determines(used: Readings, solution: Solution) -> bool:
    """Tell whether readings without noise would determine everything."""
    at, terms = solution.parameters, solution.observability.terms
    return observability(at, used, terms, range_sigma=0.0, prior=solution.prior).full


def _is_ambiguous(readings: Readings, solution: Solution, fit: Fit) -> bool:
    """Tell whether the mirror image of the solution fits as well."""
    squares = float(solution.result.residual @ solution.result.residual)
    sigma = fit.range_sigma if solution.whitening is None else solution.whitening.sigma
    return mirror_image_fits(solution.parameters, readings, squares, sigma)


def status_of(
    solution: Solution, determined: Determined, wrong: CalibrationWarning | None
) -> Status:
    """Return the status; `wrong` says that the readings do not fit at all."""
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    return (
        "converged" if wrong is None and solution.result.status == "converged" else "not_converged"
    )


def message_of(
    status: Status,
    solution: Solution,
    determined: Determined,
    wrong: CalibrationWarning | None,
) -> str:
    """Return the status in words, with what to do."""
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    if wrong is not None and status == "not_converged":
        return wrong.message
    return solution.result.message
