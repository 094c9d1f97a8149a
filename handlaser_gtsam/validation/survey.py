"""Validation of surveys: does an independent solver agree, and are parts predicted by the rest.

Two tests. SciPy solves the same points again, by formulas of its own (`solvers/reference`).
And every target, and random parts of the stations, are predicted by the rest: the mounts are found
again with the rest alone, and what the other shots add to the sum of squares is compared with what it
should be.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.survey import Survey, normal_label
from ..data.value import Value
from ..errors import CalibrationWarning, HandlaserError, SolverError
from ..estimation.survey import estimate_survey
from ..model.distributions import SINGLE_LEVEL, chi2_sf, f_sf
from ..model.families import POSE
from ..quantities import IN_PERCENT, SINGULAR
from ..results.spot_error import spot_of
from ..results.survey import SurveyCalibration, survey_calibration
from ..results.verdict import Verdict
from .cross_check import CrossCheck, cross_check_survey, fits
from .leave_out import PART_LEFT_OUT, USUAL_SPLITS
from .simulate import generator

LARGEST_DIFFERENCE = 0.5
"""A parameter may differ from SciPy's by this many of its standard deviations, and a standard deviation
by this part. Shots are condensed to first order in their noise: of balls that are read with a noise of
2 % of the range they differ by up to 0.47, which makes errors a tenth larger than is stated."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyLeftOut(Value):
    """How the rest of a survey predicts a part of it.

    Attributes
    ----------
    name : str
        A label, or the number of a random split.
    shots : int
        Shots and readings of beams that were predicted.
    chi2, dof : float, int
        What they add to the sum of squares, and what it should be about.
    p_value : float
        Probability of more by chance; NaN where nothing was predicted.
    shift : float
        Largest shift of a spot at working distance against the whole survey [m].
    message : str
        Why there is no prediction.
    """

    name: str
    shots: int
    chi2: float = 0.0
    dof: int = 0
    p_value: float = np.nan
    shift: float = np.nan
    message: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyValidation(Value):
    """What a validation of a survey found.

    Attributes
    ----------
    calibration : SurveyCalibration
    reference : CrossCheck
    targets, splits : tuple of SurveyLeftOut
    """

    calibration: SurveyCalibration
    reference: CrossCheck
    targets: tuple[SurveyLeftOut, ...]
    splits: tuple[SurveyLeftOut, ...]

    @property
    def disagreement(self) -> str | None:
        """What SciPy, which solves all points by themselves, finds otherwise; None where it agrees."""
        reference = self.reference
        if reference.largest > LARGEST_DIFFERENCE:
            found = (
                f"finds another solution, by {reference.largest:.2g} standard deviations in "
                f"{reference.parameter}"
            )
        elif reference.largest_sigma > LARGEST_DIFFERENCE:
            percent = IN_PERCENT * reference.largest_sigma
            found = (
                f"finds standard deviations that differ by {percent:.0f} % in "
                f"{reference.sigma_parameter}"
            )
        else:
            return None
        return (
            f"SciPy, point by point, {found}: do not use this calibration; shots are too noisy, or "
            "have too few points, for their targets: look at larger parts of them, from nearer"
        )

    @property
    def usable(self) -> bool:
        """Whether the calibration is usable, SciPy agrees, and every part is predicted by the rest."""
        return self.verdict.usable

    @property
    def verdict(self) -> Verdict:
        """The verdict on the calibration after these tests."""
        judged, why = self.calibration.verdict, list[CalibrationWarning]()
        if not judged.usable:
            return judged
        if self.disagreement is not None:
            of = self.reference
            values: dict[str, float | str] = {"parameter": of.parameter, "difference": of.largest}
            if of.largest <= LARGEST_DIFFERENCE:
                values = {"parameter": of.sigma_parameter, "difference": of.largest_sigma}
            why.append(CalibrationWarning("reference-disagrees", self.disagreement, values))
        against = tuple(one.name for one in self.contradicted)
        if against:
            which = f"(p below {SINGLE_LEVEL:g}): {', '.join(against)}"
            words = f"what the rest of the survey does not predict {which}"
            parts = {"parts": ", ".join(against)}
            why.append(CalibrationWarning("not-predicted", words, parts))
        if not why:
            return judged
        return replace(
            judged,
            code="contradicted",
            findings=tuple(one.message for one in why),
            contradicted_by=against,
            causes=(*why, *judged.causes),
        )

    @property
    def contradicted(self) -> tuple[SurveyLeftOut, ...]:
        """Return what the rest does not predict: together by chance in one of 1 / SINGLE_LEVEL."""
        tested = [one for one in (*self.targets, *self.splits) if one.dof]
        return tuple(one for one in tested if one.p_value < SINGLE_LEVEL / len(tested))


def validate_survey(
    survey: Survey,
    noise: Noise | None = None,
    splits: int = USUAL_SPLITS,
    rng: np.random.Generator | None = None,
) -> SurveyValidation:
    """Calibrate a survey, solve it again with SciPy, and predict its parts from the rest.

    Parameters
    ----------
    survey : Survey
    noise : Noise, optional
        As for `calibrate`.
    splits : int
        Random splits of the stations.
    rng : Generator, optional
        Of the splits; the same ones each time where it is not given.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        A survey that has no minimum, or more than one.
    """
    require_kind("survey", survey, Survey)
    require_count("splits", splits, 0, 10**9)
    rng = generator(rng)
    noise = Noise() if noise is None else noise
    whole = estimate_survey(survey, noise)
    calibration = survey_calibration(whole)
    if not fits(calibration):
        raise SolverError(calibration.verdict.sentence)
    reference = cross_check_survey(calibration)
    labels = np.array([normal_label(label) for label in survey.stations.plane_labels])
    different = sorted(set(labels.tolist()))
    targets = [
        _left_out(calibration, label, labels == label) for label in different if len(different) > 1
    ]
    random = []
    for number in range(splits):
        out = np.zeros(len(labels), dtype=bool)
        out[rng.permutation(len(labels))[: round(PART_LEFT_OUT * len(labels))]] = True
        random.append(_left_out(calibration, f"{number + 1}", out))
    return SurveyValidation(calibration, reference, tuple(targets), tuple(random))


def _left_out(calibration: SurveyCalibration, name: str, out: BoolArray) -> SurveyLeftOut:
    """Predict the shots of some stations from the rest of the survey."""
    whole = calibration._found
    test = [item for item, used in zip(whole.rows.items, whole.used, strict=True) if used]
    test = [item for item in test if out[item.station]]
    rest = _without(whole.rows.survey, out)
    if not test or rest is None:
        return SurveyLeftOut(name, len(test), message="nothing is left")
    try:
        found = estimate_survey(rest, whole.given)
    except HandlaserError as error:
        return SurveyLeftOut(name, len(test), message=str(error))
    if found.estimate.status != "converged":
        return SurveyLeftOut(name, len(test), message=survey_calibration(found).message)
    # The whole has the values of what the rest has not seen.
    values = {kind: x[None].copy() for kind, x in whole.estimate.values.items()}
    for kind, x in found.estimate.values.items():
        if kind in found.rows.targets:
            labels = whole.rows.targets[kind]
            values[kind][0, [labels.index(label) for label in found.rows.targets[kind]]] = x
        elif kind != POSE.name:
            values[kind][0, : len(x)] = x
    state = whole.at(values, found.noise)
    rows, owner = state.dense()
    J, e = rows.whitened()
    predicted = (owner >= 0) & out[state.stations(owner)]
    both, rank = _squares(J, e)
    known, known_rank = _squares(J[~predicted], e[~predicted])
    dof = int(predicted.sum()) - (rank - known_rank)
    squares = both - known
    if dof <= 0:
        return SurveyLeftOut(name, len(test), message="it says nothing about the mounts")
    redundancy = int((~predicted).sum()) - known_rank
    learned = bool(np.isnan([*whole.stated.sigma, *whole.stated.pose]).any())
    p = f_sf(squares / dof, dof, max(redundancy, 1)) if learned else chi2_sf(squares, dof)
    # By how much spots at working distance move at most.
    rest_of, shifts = survey_calibration(found), [0.0]
    for own, sensor in calibration.sensors.items():
        other, spot = rest_of.sensors[own], sensor.spot
        there = other.rotation @ spot + other.location
        shifts.append(float(np.linalg.norm(sensor.rotation @ spot + sensor.location - there)))
    for i, (own, beam) in enumerate(calibration.beams.items()):
        assert whole.rows.survey.ranges is not None
        d = float(np.nanmedian(whole.rows.survey.ranges[:, i]))
        spots = [
            spot_of(np.concatenate((one.location, one.direction, one.range_error)), d)[0]
            for one in (beam, rest_of.beams[own])
        ]
        shifts.append(float(np.linalg.norm(spots[1] - spots[0])))
    return SurveyLeftOut(name, len(test), squares, dof, float(p), max(shifts))


def _without(survey: Survey, out: BoolArray) -> Survey | None:
    """Return a survey without the readings of some stations; None where none are left."""
    shots = []
    for one in survey.shots:
        kept = ~out[one.station]
        if kept.any():
            shots.append(one.part(kept))
    ranges = survey.ranges
    if ranges is not None:
        ranges = np.where(out[:, None], np.nan, ranges)
    if len(shots) < len(survey.shots) or (ranges is not None and np.isnan(ranges).all(0).any()):
        return None
    return replace(survey, shots=tuple(shots), ranges=ranges)


def _squares(J: FloatArray, e: FloatArray) -> tuple[float, int]:
    """Return the least sum of squares of linear rows, and their rank."""
    scale = np.linalg.norm(J, axis=0)
    U, size, _ = np.linalg.svd(J / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    U = U[:, size > SINGULAR**0.5 * size.max()]
    return float(e @ e - ((U.T @ e) ** 2).sum()), U.shape[1]
