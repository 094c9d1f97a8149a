"""Probabilities and quantiles, against their definitions by numerical integration."""

import math
from functools import partial

import numpy as np
import pytest
from scipy.integrate import quad

from handlaser_gtsam.model import distributions as found


def gaussian(x):
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


def student(dof, x):
    scale = math.exp(math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof))
    return scale / math.sqrt(dof * math.pi) * (1.0 + x * x / dof) ** (-0.5 * (dof + 1.0))


def chi2(dof, x):
    return math.exp((0.5 * dof - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(0.5 * dof)) / 2.0


def beta(a, b, x):
    size = math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    return math.exp((a - 1.0) * math.log(x) + (b - 1.0) * math.log1p(-x) - size)


def ratio(dof, below, x):
    """The density of F: of a beta variate dof x / (dof x + below)."""
    part = dof * x / (dof * x + below)
    return beta(0.5 * dof, 0.5 * below, part) * dof * below / (dof * x + below) ** 2


CASES = {
    "gaussian": (gaussian, found.gaussian_sf, found.gaussian_quantile, (0.3, 2.0, 6.0)),
    "student": (
        partial(student, 5.0),
        partial(found.student_sf, dof=5.0),
        partial(found.student_quantile, dof=5.0),
        (0.3, 2.0, 30.0),
    ),
    "chi-square": (
        partial(chi2, 7.5),
        partial(found.chi2_sf, dof=7.5),
        partial(found.chi2_quantile, dof=7.5),
        (0.5, 8.0, 60.0),
    ),
    "F": (
        partial(ratio, 3.0, 11.0),
        partial(found.f_sf, dof=3.0, below=11.0),
        partial(found.f_quantile, dof=3.0, below=11.0),
        (0.2, 1.5, 40.0),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_tails_are_integrals_of_the_density_and_quantiles_their_inverse(name):
    density, sf, quantile, places = CASES[name]
    for x in places:
        tail = quad(density, x, math.inf, epsabs=0.0, epsrel=1e-10)[0]
        assert float(sf(x)) == pytest.approx(tail, rel=1e-7)
        if tail > 1e-8:  # a probability near one keeps few digits of what is left
            assert float(quantile(1.0 - tail)) == pytest.approx(x, rel=1e-5)


def test_the_other_side_and_what_is_below_zero():
    x = np.array([0.2, 1.0, 3.0])
    assert found.gaussian_cdf(x) == pytest.approx(1.0 - found.gaussian_sf(x))
    assert found.gaussian_cdf(-x) == pytest.approx(found.gaussian_sf(x))
    assert found.chi2_cdf(x, 4.0) == pytest.approx(1.0 - found.chi2_sf(x, 4.0))
    for rounding in (-1e-18, 0.0):
        assert float(found.chi2_sf(rounding, 3)) == float(found.f_sf(rounding, 3, 9)) == 1.0
    assert np.isnan(found.chi2_sf(np.nan, 3))


def test_quantiles_of_a_beta_variate():
    for p in (0.025, 0.5, 0.975):
        x = float(found.beta_quantile(p, 3.0, 8.0))
        assert quad(partial(beta, 3.0, 8.0), 0.0, x)[0] == pytest.approx(p, abs=1e-8)


@pytest.mark.parametrize(("dof", "x"), [(3.0, 12.0), (40.0, 4.0)])
def test_the_noncentrality_has_its_probability(dof, x):
    """A noncentral t is (z + mean) / sqrt(w / dof) for a Gaussian z and a chi-square w."""
    mean = found.student_mean(0.2, dof, x)

    def below(w):
        return chi2(dof, w) * float(found.gaussian_cdf(x * math.sqrt(w / dof) - mean))

    assert quad(below, 0.0, 12.0 * dof, limit=200)[0] == pytest.approx(0.2, abs=1e-5)


@pytest.mark.parametrize(
    ("p", "digits", "words"),
    [
        (0.0, 2, "p < 1e-09"),
        (9e-10, 1, "p < 1e-09"),
        (1e-9, 1, "p = 1e-09"),
        (0.0314, 2, "p = 0.031"),
    ],
)
def test_no_p_value_is_written_as_zero(p, digits, words):
    assert found.p_words(p, digits) == words


def test_a_sum_of_squares_counts_as_much_as_the_noise_is_known():
    x = np.array([0.0, 3.0, 20.0])
    assert np.array_equal(found.squares_sf(x, 4), found.chi2_sf(x, 4))
    assert np.array_equal(found.squares_sf(x, 4, 11), found.f_sf(x / 4, 4, 11))
    assert found.squares_sf(x, 4, 1e9) == pytest.approx(found.chi2_sf(x, 4), rel=1e-6)
