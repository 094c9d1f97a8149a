"""How systematic errors are named, and what is said of them."""

from dataclasses import dataclass

UNKNOWNS = "the unknowns of the calibration in this recording"


@dataclass(frozen=True, slots=True)
class Wording:
    """What is said of one kind of error.

    Attributes
    ----------
    phrase : str
        The error, with {size} and {subject} to be filled in.
    remedy : str
    unit : str
        "m" or "1".
    confounded : str
        What it cannot be told from.
    anywhere : str
        The subject where no member is meant.
    """

    phrase: str
    remedy: str
    unit: str = "m"
    confounded: str = UNKNOWNS
    anywhere: str = ""

    def with_size(self, size: float, subject: str | None = None) -> str:
        """Return the phrase with a size, and a subject: any one where none is meant."""
        whose = self.anywhere if subject is None else subject
        return self.phrase.format(size=size_in_words(size, self.unit), subject=whose)

    def without_size(self) -> str:
        """Return the phrase for an error of unknown size."""
        phrase = self.phrase.replace(" by {size}", "").replace(" of {size}", "")
        return phrase.format(subject=self.anywhere)


WORDING = {
    "incidence": Wording(
        "a range error of {size} at an incidence of 45 deg that grows with its squared tangent",
        "measure at smaller angles of incidence, or give the sensor's largest incidence",
    ),
    "cubic": Wording(
        "a third-order range error of {size} at the largest reading",
        "measure over a shorter span of ranges around the working distance, or linearise the sensor",
    ),
    "sag": Wording(
        "a curvature of the plate by {size} from the middle of its spots to the farthest one",
        "use a flatter plate, support it evenly, or measure a smaller part of it",
    ),
    "lag": Wording(
        "a lag between poses and readings by {size} of the step to the next station",
        "let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
        "1",
    ),
    "drift": Wording(
        "a drift of the readings by {size} over the recording",
        "let the sensor warm up, and record in a shorter time",
    ),
    "displaced": Wording(
        "a displacement by {size} of {subject}",
        "fix the plate, and give the stations after the displacement a plane label of their own",
        anywhere="one plane from some station on",
    ),
    "beam-on-plane": Wording(
        "a bias of {size} of {subject}",
        "check the surface of that plane under the beam, or remove these readings",
        confounded="the offset of the plane or the location of the beam: it takes two beams that see "
        "the same two planes",
        anywhere="one beam on one plane",
    ),
    "turn-scale": Wording(
        "a scale error of the robot's turns by {size}",
        "have the robot's joints calibrated, and check the unit and the convention of its angles",
        "1",
    ),
    "translation-scale": Wording(
        "a scale error of the robot's translations by {size}",
        "check the robot's translations against a known length, or calibrate without range errors if "
        "the scale of the sensor is known",
        "1",
        "k1 of all beams, because every length scales together",
    ),
    # Errors that no recording can show.
    "inverse-cosine": Wording(
        "a range error proportional to 1/cos(incidence)",
        "nothing is needed for the beams; measure the offset of a plane by other means if it matters",
        confounded="the offsets of the planes; it changes no beam",
    ),
    "tool-frame": Wording(
        "an error of the tool frame",
        "use the calibration with the tool frame of the recording only",
        confounded="the mount of the beams: both are one rigid motion",
    ),
    "range-offset": Wording(
        "a constant offset of the readings",
        "use the location together with readings of the same sensor only: their sum is right",
        confounded="the location of the beam along itself",
    ),
}


def size_in_words(size: float, unit: str) -> str:
    """Return a size with two digits, in mm or percent."""
    return f"{size * 1e3:.2g} mm" if unit == "m" else f"{size * 100.0:.2g} %"
