"""Values of the command line's options."""

from enum import StrEnum


class PosesChoice(StrEnum):
    """Values of --poses."""

    auto = "auto"
    exact = "exact"
    marginalised = "marginalised"
    estimated = "estimated"


class OutliersChoice(StrEnum):
    """Values of --outliers."""

    reject = "reject"
    keep = "keep"


class LossChoice(StrEnum):
    """Values of --loss."""

    gaussian = "gaussian"
    huber = "huber"
    cauchy = "cauchy"
    tukey = "tukey"


class RangeErrorChoice(StrEnum):
    """Values of --range-error."""

    auto = "auto"
    none = "none"
    k1 = "k1"
    k1k2 = "k1k2"
