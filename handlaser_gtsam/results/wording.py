"""How systematic errors are named, and what is said of them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Wording:
    """What is said of one kind of error.

    Attributes
    ----------
    unit : str
        "m" or "1".
    phrase : str
        The error, with {size} and {subject} to be filled in.
    anywhere : str
        The subject where no member is meant.
    confounded : str
        What it cannot be told from.
    remedy : str
    """

    unit: str
    phrase: str
    anywhere: str
    confounded: str
    remedy: str

    def with_size(self, size: float, subject: str | None = None) -> str:
        """Return the phrase with a size, and a subject: any one where none is meant."""
        whose = self.anywhere if subject is None else subject
        return self.phrase.format(size=size_in_words(size, self.unit), subject=whose)


UNKNOWNS = "the unknowns of the calibration in this recording"
WORDING = {
    "incidence": Wording(
        "m",
        "a range error of {size} at an incidence of 45 deg that grows with its squared tangent",
        "",
        UNKNOWNS,
        "measure at smaller angles of incidence, or give the sensor's largest incidence",
    ),
    "cubic": Wording(
        "m",
        "a third-order range error of {size} at the largest reading",
        "",
        UNKNOWNS,
        "measure over a shorter span of ranges around the working distance, or linearise the sensor",
    ),
    "sag": Wording(
        "m",
        "a curvature of the plate by {size} from the middle of its spots to the farthest one",
        "",
        UNKNOWNS,
        "use a flatter plate, support it evenly, or measure a smaller part of it",
    ),
    "lag": Wording(
        "1",
        "a lag between poses and readings by {size} of the step to the next station",
        "",
        UNKNOWNS,
        "let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
    ),
    "drift": Wording(
        "m",
        "a drift of the readings by {size} over the recording",
        "",
        UNKNOWNS,
        "let the sensor warm up, and record in a shorter time",
    ),
    "displaced": Wording(
        "m",
        "a displacement by {size} of {subject}",
        "one plane from some station on",
        UNKNOWNS,
        "fix the plate, and give the stations after the displacement a plane label of their own",
    ),
    "beam-on-plane": Wording(
        "m",
        "a bias of {size} of {subject}",
        "one beam on one plane",
        "the offset of the plane or the location of the beam: it takes two beams that see the same two "
        "planes",
        "check the surface of that plane under the beam, or remove these readings",
    ),
    "turn-scale": Wording(
        "1",
        "a scale error of the robot's turns by {size}",
        "",
        UNKNOWNS,
        "have the robot's joints calibrated, and check the unit and the convention of its angles",
    ),
    "translation-scale": Wording(
        "1",
        "a scale error of the robot's translations by {size}",
        "",
        "k1 of all beams, because every length scales together",
        "check the robot's translations against a known length, or calibrate without range errors if "
        "the scale of the sensor is known",
    ),
}
BY_NATURE = {
    "inverse-cosine": (
        "a range error proportional to 1/cos(incidence) cannot be told from the offsets of the planes; "
        "it changes no beam",
        "nothing is needed for the beams; measure the offset of a plane by other means if it matters",
    ),
    "tool-frame": (
        "an error of the tool frame cannot be told from the mount of the beams: both are one rigid "
        "motion",
        "use the calibration with the tool frame of the recording only",
    ),
    "range-offset": (
        "a constant offset of the readings cannot be told from the location of the beam along itself",
        "use the location together with readings of the same sensor only: their sum is right",
    ),
}
"""Errors that no recording can show, why, and what to do."""


def size_in_words(size: float, unit: str) -> str:
    """Return a size with two digits, in mm or percent."""
    return f"{size * 1e3:.2g} mm" if unit == "m" else f"{size * 100.0:.2g} %"
