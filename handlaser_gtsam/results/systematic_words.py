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
        What it is confounded with.
    anywhere : str
        The subject where no member is meant.
    reveal : str
        What would show an error that may be there unseen.
    """

    phrase: str
    remedy: str
    unit: str = "m"
    confounded: str = UNKNOWNS
    anywhere: str = ""
    reveal: str = ""

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
        reveal="add stations at 50 to 60 deg of incidence, where the sensor reads there",
    ),
    "cubic": Wording(
        "a third-order range error of {size} at the largest reading",
        "measure over a shorter span of ranges around the working distance, or linearise the sensor",
        reveal="add stations over the whole span of ranges at the same angles of incidence",
    ),
    "sag": Wording(
        "a curvature of the plate by {size} from the middle of its spots to the farthest one",
        "use a flatter plate, support it evenly, or measure a smaller part of it",
        reveal="add stations that look at the middle and at the edges of the plate from several sides",
    ),
    "lag": Wording(
        "a lag between poses and readings by {size} of the step to the next station",
        "let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
        "1",
        reveal="reach some stations again from another side",
    ),
    "drift": Wording(
        "a drift of the readings by {size} over the recording",
        "let the sensor warm up, and record in a shorter time",
        reveal="repeat the first stations at the end",
    ),
    "displaced": Wording(
        "a displacement by {size} of {subject}",
        "fix the plate, and give the stations after the displacement a plane label of their own",
        anywhere="one plane from some station on",
        reveal="record more stations before each plane, and repeat the first ones at the end",
    ),
    "tool-displaced": Wording(
        "a displacement of the tool frame by {size} {subject}",
        "fasten the bracket of the sensors and the tool, let the robot warm up, and record again",
        anywhere="while recording",
        reveal="repeat the first stations at the end, before the same planes",
    ),
    "beam-on-plane": Wording(
        "a bias of {size} of {subject}",
        "check the surface of that plane under the beam, or remove these readings",
        confounded="the offset of the plane or the location of the beam: it takes two beams that see "
        "the same two planes",
        anywhere="one beam on one plane",
        reveal="add a plane of the same surface",
    ),
    "turn-scale": Wording(
        "a scale error of the robot's turns by {size}",
        "have the robot's joints calibrated, and check the unit and the convention of its angles",
        "1",
        reveal="turn the hand further, and about other axes",
    ),
    "translation-scale": Wording(
        "a scale error of the robot's translations by {size}",
        "check the robot's translations against a known length, or calibrate without range errors if "
        "the scale of the sensor is known",
        "1",
        "k1 of all beams, because every length scales together",
        reveal="measure a known length with the robot",
    ),
    "carry-over": Wording(
        "a carry-over of {size} from one channel to the next",
        "sample slower, put a buffer before the converter, or use a converter for each sensor",
        "1",
        reveal="cover one sensor while another reads a fixed distance; state carry_over_percent = 0 in "
        "the rig file's [plausible] where every sensor has a converter of its own",
    ),
    # Errors that no recording can show.
    "tilt": Wording(
        "a range error of {size} at an incidence of 45 deg that changes its sign with the side",
        "calibrate once more with the sensor turned by half a turn about its beam, and take the mean",
        confounded="a location of the beam to the side",
        reveal="calibrate once more with the sensor turned by half a turn about its beam",
    ),
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


def may_also_be(codes: tuple[str, ...]) -> str:
    """Say which other errors the readings do not tell from one that was found."""
    return f"it may also be {' or '.join(WORDING[code].without_size() for code in codes)}"


def size_in_words(size: float, unit: str) -> str:
    """Return a size with two digits, in mm or percent."""
    return f"{size * 1e3:.2g} mm" if unit == "m" else f"{size * 100.0:.2g} %"
