"""Why to trust a calibration: fit, noise, observability, systematic errors, rejected readings."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...estimation.errors_by_pose import SizesByPose
from ...estimation.scales import NoiseComponent
from ...model.effects.effect import size_in_words
from ...model.families import BEAM, OF_RANGE_ERROR, RANGE_ERROR
from ...model.joint import STRONG
from ...quantities import IN_DEG, IN_MM, IN_PERCENT, NO_GROWTH
from ...text import count, some
from ..calibration_data import CalibrationData
from ..lines import NAMES_IN_LINE, small_mm
from ..messages import said
from ..systematic import SystematicError
from ..verdict import WELL_CONDITIONED
from .tables import (
    NONE,
    Cell,
    Facts,
    Table,
    concise,
    listed,
    name_cell,
    number,
    sentence,
    significant,
    table_of,
)

if TYPE_CHECKING:
    from .beams import CalibrationDescription

PRIOR = "the prior decides"
"""Stands beside a sigma of which the recording says little."""
KINDS = {
    "range": "a reading",
    "pose translation": "hand position",
    "pose rotation": "hand rotation",
}


def fit_facts(described: "CalibrationDescription") -> Facts:
    """Return how well the readings fit."""
    calibration = described.calibration
    fit = calibration.fit
    station, beam = fit.max_residual_at
    facts = [
        ("rms residual", small_mm(fit.rms)),
        ("largest residual", f"{small_mm(fit.max_residual)} (station {station}, beam {beam})"),
    ]
    if described.solved:
        far, (station, beam) = fit.max_standardized_residual, fit.max_standardized_residual_at
        words = f"{concise(far, 2)} standard deviations (station {station}, beam {beam})"
        facts.append(("largest for its sigma", words))
    facts.append(("degrees of freedom", str(fit.dof)))
    if fit.range_sigma_given or calibration.noise_estimate:
        facts.append(("sigma0", f"{concise(fit.sigma0)} (expected 1)"))
        if fit.dof > 0:
            facts.append(("chi² / dof", f"{concise(fit.chi2, 4)} / {fit.dof}"))
    facts.append(("readings", f"{fit.readings} used, {rejected_words(described)}"))
    facts.append(("noise", noise_words(calibration)))
    if described.solved:
        facts.append(("range errors", range_error_words(calibration)))
        if calibration.effects:
            facts.append(("freed errors", effect_words(calibration)))
    facts.append(("hand poses", fit.poses))
    if fit.loss != "gaussian":
        facts.append(("loss", fit.loss))
    return tuple(facts)


def rejected_words(described: "CalibrationDescription") -> str:
    """Return how many readings were rejected, and the most frequent reasons."""
    rejected = described.calibration.fit.rejected
    numbers = Counter(reading.reason for reading in rejected).most_common()
    reasons = some([f"{reason}: {times}" for reason, times in numbers], NAMES_IN_LINE)
    return f"{len(rejected)} rejected" + (f" ({reasons})" if reasons else "")


def observability_sentences(described: "CalibrationDescription") -> Iterator[str]:
    """Yield what the recording determines."""
    observed = described.calibration.observability
    if observed.condition is None or not described.solved:
        yield f"{observed.rank} of {observed.unknowns} unknowns are determined."
        if observed.undetermined:
            yield f"Undetermined: {'; '.join(observed.undetermined)}."
        if observed.advice:
            yield f"To determine it: {'; '.join(observed.advice)}."
        return
    yield f"All {observed.unknowns} unknowns are determined."
    meets = "met" if observed.condition < WELL_CONDITIONED else "missed"
    number, demand = concise(observed.condition), WELL_CONDITIONED
    yield said(f"condition:{meets}", number=number, demand=demand)
    if observed.weakest:
        yield f"The least certain is {observed.weakest}."
    yield from _shares(described)
    if observed.indices is not None:
        O1, O2, O3, O4 = (concise(getattr(observed.indices, f"O{i}"), 2) for i in range(1, 5))
        yield said("indices", O1=O1, O2=O2, O3=O3, O4=O4)


def _shares(described: "CalibrationDescription") -> Iterator[str]:
    """Yield what the variance of the least certain laser spot is made of."""
    shares = described.verdict.shares
    if shares is None:
        return
    weakest = f"lie along the least certain direction, mostly {shares.weakest_quantity}"
    parts = [
        f"{IN_PERCENT * share:.0f} % {words}"
        for share, words in (
            (shares.poses, "come from errors of the robot"),
            (shares.range_error, "from not knowing the range errors"),
            (shares.weakest, weakest),
        )
        if math.isfinite(share) and round(IN_PERCENT * share) > 0
    ]
    overlap = "; these overlap" if len(parts) > 1 else ""
    if parts:
        beam = described.verdict.spot_beam
        yield f"Of the variance of the worst laser spot (beam {beam}), {', '.join(parts)}{overlap}."


def advice_sentences(described: "CalibrationDescription") -> Iterator[str]:
    """Yield what would improve the calibration, the best first."""
    calibration, best = described.calibration, described.verdict.best.words
    if not described.solved:
        yield from map(sentence, calibration.observability.advice)
        if not calibration.observability.advice:
            yield f"Do this first: {best}."
        return
    yield f"Best improvement: {best}."
    for advice in dict.fromkeys(pair.advice for pair in calibration.correlations):
        first, *further = [pair for pair in calibration.correlations if pair.advice == advice]
        others = f", as are {count(len(further), 'more pair')}" if further else ""
        pair, rho = f"{first.first} and {first.second}", first.coefficient
        yield sentence(said("correlated", advice=advice, pair=pair, rho=rho, others=others))


def correlations_table(described: "CalibrationDescription") -> Table | None:
    """Return the pairs of unknowns that are hardly distinguished; None without a covariance."""
    calibration = described.calibration
    if calibration.covariance is None or not described.solved:
        return None
    pairs = calibration.correlations
    return listed(
        "correlations",
        pairs,
        lambda pair: (
            Cell(str(pair.first)),
            Cell(str(pair.second)),
            number(pair.coefficient, 3, "care"),
        ),
        "pair",
        f"{count(len(pairs), 'pair')} above {STRONG}.",
    )


def systematic_table(described: "CalibrationDescription") -> Table | None:
    """Return every systematic error that was tested, the clearest first; None where none was."""
    tested = described.calibration.systematic
    if not tested or not described.solved:
        return None
    return table_of("systematic", (_systematic(one, described.verdict.reading) for one in tested))


def _systematic(error: SystematicError, reading: float) -> tuple[Cell, ...]:
    state = Cell("not found", 0.0, "good")
    if error.found:
        state = Cell("found", 2.0, "bad")
        if error.explained_by:
            state = Cell("explained", 2.0, "care")
    if error.confounded:
        state = Cell("cannot be told", 1.0)
    name = Cell(error.code)
    if error.confounded and not math.isfinite(error.plausible):
        return name, state, *[Cell(NONE)] * 3
    size = error.size if error.found else error.unnoticed
    below = Cell(size_in_words(size, error.unit), size) if math.isfinite(size) else Cell(NONE)
    shift = error.moved(reading, unnoticed=not error.found)
    return name, state, significant(error.p_value, 2), below, significant(shift * IN_MM, 2)


def systematic_facts(described: "CalibrationDescription") -> Facts:
    """Return the errors that were found or are confounded, each with its remedy in words."""
    tested = described.calibration.systematic if described.solved else ()
    return tuple(
        (
            f"{error.code}, {error.subject}".rstrip(", "),
            sentence(f"{error.message}; {error.remedy}"),
        )
        for error in tested
        if error.confounded or (error.found and not error.explained_by)
    )


def rejected_table(described: "CalibrationDescription") -> Table | None:
    """Return the readings that were rejected, each with its reason; None where there are none."""
    rejected = described.calibration.fit.rejected
    if not rejected:
        return None
    return listed(
        "rejected",
        rejected,
        lambda reading: (
            name_cell(reading.station),
            name_cell(reading.sensor),
            Cell(reading.reason),
            significant(None if reading.residual is None else reading.residual * IN_MM),
        ),
        "reading",
    )


def noise_words(result: CalibrationData) -> str:
    """Return the standard deviations behind the result: given, estimated, or carried by a prior.

    The sigmas of many beams are summed up by the least and the largest.
    """
    estimated = result.noise_estimate
    ranges = [component for component in estimated if component.quantity == "range"]
    parts = [_estimate(component) for component in ranges]
    if len(parts) > NAMES_IN_LINE:
        sigmas = [component.sigma * IN_MM for component in ranges]
        some_by_prior = any(component.prior_carries for component in ranges)
        how = f"estimated; {PRIOR} some" if some_by_prior else "estimated"
        parts = [f"a reading {min(sigmas):.2g} to {max(sigmas):.2g} mm, by beam ({how})"]
    if not parts:
        how = "given" if result.fit.range_sigma_given else "estimated"
        parts = [f"a reading {small_mm(result.fit.range_sigma)} ({how})"]
    parts += [_estimate(component) for component in estimated if component.quantity != "range"]
    return ", ".join([*parts, *_fixed_poses(result), *by_pose_words(result.errors_by_pose)])


def by_pose_words(sizes: SizesByPose | None) -> list[str]:
    """Return how large errors of the hand are that change with its pose, where they are counted."""
    if sizes is None or sizes.growth < NO_GROWTH:
        return []
    return [said("noise:by-pose", shift=sizes.shift, turn=sizes.turn, growth=sizes.growth)]


def _estimate(one: NoiseComponent) -> str:
    """Return an estimated sigma with its own standard deviation."""
    scale, unit = (IN_DEG, "deg") if one.quantity == "pose rotation" else (IN_MM, "mm")
    error = f" +- {one.error * scale:.1g}" if math.isfinite(one.error) else ""
    owner = KINDS[one.quantity] + ("" if one.beam is None else f" of beam {one.beam}")
    how = PRIOR if one.prior_carries else "estimated"
    return f"{owner} {one.sigma * scale:.2g}{error} {unit} ({how})"


def _fixed_poses(result: CalibrationData) -> list[str]:
    """Return the pose sigmas that were not estimated: as given, or as their priors have them."""
    pose = None if result.variances is None else result.variances.pose
    if result.fit.poses == "exact" or pose is None:
        variables = result.fit.poses == "estimated"
        return ["hand poses as variables of the graph" if variables else "hand poses exact"]
    variance, estimated = np.einsum("sii->si", pose).mean(axis=0), result.noise_estimate
    sizes = {
        "pose translation": f"{math.sqrt(float(variance[3:].mean())) * IN_MM:.2g} mm",
        "pose rotation": f"{math.sqrt(float(variance[:3].mean())) * IN_DEG:.2g} deg",
    }
    found = {one.quantity for one in estimated}
    return [
        f"{KINDS[one]} {size} (not estimated)" for one, size in sizes.items() if one not in found
    ]


def range_error_words(result: CalibrationData) -> str:
    """Return which range errors differ from zero, and their learned scales."""
    if not any(beam.terms for beam in result.beams.values()):
        return "taken as zero"
    intervals = {
        name: interval[OF_RANGE_ERROR]
        for name in result.beams
        if (interval := result.intervals(name)) is not None
    }
    listed = []
    for index, term in enumerate(BEAM.coordinates[RANGE_ERROR]):
        names = [
            name
            for name, k in intervals.items()
            if np.isfinite(k).all() and (k[index, 0] > 0.0 or k[index, 1] < 0.0)
        ]
        whose = f" of beam{'s' * (len(names) > 1)} {some(names, NAMES_IN_LINE)}"
        if len(names) == len(result.beams):
            whose = " of all beams" if len(names) > 1 else ""
        if names:
            listed.append(f"{term}{whose}")
    words = "zero is not excluded"
    if listed:
        words = f"zero is excluded (95 %) for {' and '.join(listed)}"
    typical = None if result.learned is None else result.learned.range_error_sigma
    if typical is None:
        return said("range-errors", words=words)
    return said("range-errors:learned", words=words, first=typical[0], second=typical[1])


def effect_words(result: CalibrationData) -> str:
    """Return the systematic errors that were unknowns, with their estimates."""
    determined = [effect.words for effect in result.effects if effect.determined]
    others = [
        " ".join(filter(None, (effect.code, effect.subject, effect.brief)))
        for effect in result.effects
        if not effect.determined
    ]
    words = [some(determined, NAMES_IN_LINE)] if determined else []
    words += [f"undetermined: {some(others, NAMES_IN_LINE)}"] if others else []
    return "; ".join(words)
