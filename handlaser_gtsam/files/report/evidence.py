"""Why to trust it: the fit, what the recording determines, systematic errors, and what was held out."""

import math
from collections.abc import Iterator

import numpy as np

from ...quantities import IN_MM
from ...results.improvement import WELL_CONDITIONED
from ...results.lines import count
from ...results.noise_lines import noise_words, range_error_words
from ...results.significance import DOUBTFUL_LEVEL, chance
from ...results.systematic import SystematicError
from ...results.wording import size_in_words
from ...validation.hold_out import HoldOut
from .correlations import FLAGGED, MOST_BEAMS, correlations_of
from .subject import Subject
from .tables import (
    NONE,
    Cell,
    Column,
    Table,
    concise,
    name_cell,
    number,
    sentence,
    significant,
    text,
)

SMALL = 0.005
"""Parts of a variance below this are not worth a word."""
MOST_PAIRS = 12
"""Correlations that are listed."""

Facts = tuple[tuple[str, str], ...]


def fit_facts(subject: Subject) -> Facts:
    """Return how well the readings fit, as names and words."""
    fit = subject.calibration.fit
    station, beam = fit.max_residual_at
    facts = [
        ("rms residual", f"{concise(fit.rms * IN_MM)} mm"),
        (
            "largest residual",
            f"{concise(fit.max_residual * IN_MM)} mm, station {station}, beam {beam}",
        ),
    ]
    if subject.solved:
        far, (station, beam) = fit.max_standardized_residual, fit.max_standardized_residual_at
        words = f"{concise(far, 2)} standard deviations, station {station}, beam {beam}"
        facts.append(("largest for its sigma", words))
    facts.append(("degrees of freedom", str(fit.dof)))
    if fit.range_sigma_given or subject.calibration.noise_estimate:
        facts.append(("sigma0", f"{concise(fit.sigma0)} (expected 1)"))
        if fit.dof > 0:
            facts.append(("chi² / dof", f"{concise(fit.chi2, 4)} / {fit.dof}"))
    facts.append(("readings", f"{fit.readings} used, {len(fit.rejected)} rejected"))
    if subject.solved:
        facts.append(("noise", noise_words(subject.calibration).partition(": ")[2]))
        facts.append(("range errors", range_error_words(subject.calibration).partition(", ")[2]))
    facts.append(("hand poses", fit.poses))
    if fit.loss != "gaussian":
        facts.append(("loss", fit.loss))
    return tuple(fact for fact in facts if fact[1])


def observability_words(subject: Subject) -> Iterator[str]:
    """Yield what the recording determines, in sentences."""
    found = subject.calibration.observability
    if found.condition is None or not subject.solved:
        yield f"{found.rank} of {found.unknowns} unknowns are determined."
        if found.undetermined:
            yield f"Undetermined: {'; '.join(found.undetermined)}."
        if found.advice:
            yield f"To determine it: {'; '.join(found.advice)}."
        return
    yield f"All {found.unknowns} unknowns are determined."
    good = found.condition < WELL_CONDITIONED
    yield (
        f"The condition number is {concise(found.condition)}; the usual demand is below "
        f"{WELL_CONDITIONED:.0f}"
        + (
            ", which it meets."
            if good
            else ", which it does not meet: more varied motion lowers it."
        )
    )
    if found.weakest:
        yield f"Known worst is {found.weakest}."
    shares = subject.verdict.shares
    if shares is not None:
        yield from _shares(subject)
    yield from _indices(subject)


def _shares(subject: Subject) -> Iterator[str]:
    shares, beam = subject.verdict.shares, subject.verdict.spot_beam
    if shares is None:
        return
    parts = [
        f"{100.0 * share:.0f} % {words}"
        for share, words in (
            (shares.poses, "come from errors of the robot"),
            (shares.range_error, "from not knowing the range errors"),
            (
                shares.weakest,
                f"lie along the direction known worst, mostly {shares.weakest_quantity}",
            ),
        )
        if math.isfinite(share) and share >= SMALL
    ]
    overlap = "; these overlap" if len(parts) > 1 else ""
    if parts:
        yield f"Of the variance of the worst laser spot (beam {beam}), {', '.join(parts)}{overlap}."


def _indices(subject: Subject) -> Iterator[str]:
    found = subject.calibration.observability.indices
    if found is not None:
        listed = (f"{name} {concise(getattr(found, name), 2)}" for name in ("O1", "O2", "O3", "O4"))
        yield f"Observability indices, larger is better: {', '.join(listed)}."


def correlations_table(subject: Subject) -> Table | None:
    """Return the pairs of unknowns that are correlated above `FLAGGED`; None without a covariance."""
    found = correlations_of(subject)
    if found is None:
        return None
    labels, C = found.labels, found.matrix
    first, second = np.triu_indices(len(labels), 1)
    size = np.abs(C[first, second])
    strong = np.flatnonzero(size > FLAGGED)
    strong = strong[np.argsort(-size[strong], kind="stable")]
    rows = [
        (
            text(f"beam {labels[i][0]} {labels[i][1]}"),
            text(f"beam {labels[j][0]} {labels[j][1]}"),
            number(C[i, j], 3, "care"),
        )
        for i, j in zip(
            first[strong[:MOST_PAIRS]].tolist(), second[strong[:MOST_PAIRS]].tolist(), strict=True
        )
    ]
    note = [f"{count(len(strong), 'pair')} above {FLAGGED}."]
    if len(strong) > MOST_PAIRS:
        note.append(f"The {MOST_PAIRS} strongest are listed.")
    if len(subject.calibration.beams) > MOST_BEAMS:
        note.append(f"Only the first {MOST_BEAMS} beams are compared here.")
    columns = (Column("unknown", number=False), Column("and", number=False), Column("correlation"))
    return Table("correlations", "", columns, tuple(rows), " ".join(note))


def systematic_table(subject: Subject) -> Table | None:
    """Return every systematic error that was tested, the clearest first; None where none was."""
    tested = subject.calibration.systematic
    if not tested or not subject.solved:
        return None
    return Table(
        "systematic",
        "Found where p is below 0.01 after Holm's correction. What is not found may still be as large "
        "as the size given; the last column says how far it would then move a laser spot.",
        (
            Column("error", number=False),
            Column("result", number=False),
            Column("p"),
            Column("unnoticed below", number=False),
            Column("spot moves mm"),
        ),
        tuple(_systematic(one, subject.reading) for one in tested),
    )


def _systematic(one: SystematicError, reading: float) -> tuple[Cell, ...]:
    state = Cell("not found", 0.0, "good")
    if one.found:
        state = Cell(
            "explained" if one.explained_by else "found", 2.0, "care" if one.explained_by else "bad"
        )
    if one.confounded:
        state = Cell("cannot be told", 1.0)
    name = text(one.code.replace("-", " "))
    if one.confounded and not math.isfinite(one.plausible):
        return name, state, *[Cell(NONE)] * 3
    size = one.size if one.found else one.unnoticed
    shift = one.spots(reading, unnoticed=not one.found)
    most = float(np.nan_to_num(shift).max()) if shift.size else math.nan
    below = Cell(size_in_words(size, one.unit), size) if math.isfinite(size) else Cell(NONE)
    return name, state, significant(one.p_value, 2), below, significant(most * IN_MM, 2)


def systematic_facts(subject: Subject) -> Facts:
    """Return what was found, or cannot be told, by its name in words with the remedy."""
    tested = subject.calibration.systematic if subject.solved else ()
    return tuple(
        (one.code.replace("-", " "), sentence(f"{one.message}; {one.remedy}"))
        for one in tested
        if one.confounded or (one.found and not one.explained_by)
    )


def held_out_table(subject: Subject) -> Table | None:
    """Return how the beams found without each plane fit that plane; None where nothing was left out."""
    planes = subject.held_out.planes
    if not planes:
        return None
    rows = [_held(subject, one.plane, one.result, one.message) for one in planes]
    count = len(subject.calibration.planes)
    note = (
        f"{len(planes)} of {count} planes were left out, one at a time."
        if len(planes) < count
        else ""
    )
    return Table(
        "held-out",
        "The plane is left out, the beams are found from the others, and its readings are compared "
        "with them. The chance is that of so large a difference in good recordings.",
        (
            Column("without plane", number=False),
            Column("readings"),
            Column("rms mm"),
            Column("largest mm"),
            Column("p"),
            Column("beams", number=False),
        ),
        tuple(rows),
        note,
    )


def _held(subject: Subject, plane: str, held: HoldOut | None, why: str) -> tuple[Cell, ...]:
    if held is None:
        return name_cell(plane), *[Cell(NONE)] * 4, Cell(why, 1.0, "care")
    state = Cell("agree", 0.0, "good")
    if math.isnan(held.p_value):
        state = Cell("not tested", 1.0, "care")
    elif plane in subject.contradicting:
        state = Cell(f"contradict it ({chance(held.p_value)})", 3.0, "bad")
    elif held.p_value < DOUBTFUL_LEVEL:
        state = Cell(f"hardly agree ({chance(held.p_value)})", 2.0, "care")
    numbers = (significant(held.rms * IN_MM), significant(held.max_residual * IN_MM))
    return (
        name_cell(plane),
        Cell(str(held.readings), held.readings),
        *numbers,
        significant(held.p_value, 2),
        state,
    )


def splits_words(subject: Subject) -> str:
    """Return how 30 % of the stations are predicted from the others; empty where nothing was."""
    splits = subject.held_out.splits
    if not splits:
        return ""
    tests = sum(one.tests for one in splits)
    rms = math.sqrt(sum(one.tests * one.rms**2 for one in splits) / tests)
    unit = math.sqrt(sum(one.tests * one.standardized**2 for one in splits) / tests)
    largest = max(one.max_residual for one in splits)
    return (
        f"30 % of the stations predicted from the other 70 %, {count(len(splits), 'time')}: rms "
        f"{concise(rms * IN_MM)} mm, largest {concise(largest * IN_MM)} mm, which is {concise(unit)} "
        "of the predicted standard deviations (expected 1)."
    )
