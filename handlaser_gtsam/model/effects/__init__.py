"""Systematic errors that the model does not hold: the list of them all.

What is added here is tested for in every recording, counted with its plausible size in the verdict, and
named in every view. Columns of derivatives stand in one file each for sensors, plates and robots.
"""

from . import of_plates, of_robots, of_sensors
from .effect import Effect, by_kind

EFFECTS = {
    effect.code: effect
    for effect in (
        # Triangulation: tilts of 30 degrees change a reading by 0.5 % of the measuring range (operating
        # instructions of the optoNCDT 1402, 1700 and 2300, "angle influences"). Ultrasound: within its
        # cone a sensor reads the distance d cos a to the nearest point, which for small angles a is
        # 1 - tan^2(a) / 2 times that along the beam. The others as their accuracy or linearity.
        Effect(
            code="incidence",
            phrase="a range error of {size} at an incidence of 45 deg that grows with its squared "
            "tangent",
            remedy="measure at smaller angles of incidence, or give the sensor's largest incidence",
            reveal="add stations at 50 to 60 deg of incidence, where the sensor reads there",
            of_readings=of_sensors.incidence,
            of_sensor=by_kind(0.015, 0.01, 0.0005, 0.5),
        ),
        # Linearities: data sheets of the optoNCDT 1402, the SICK DT35 (10 mm, of a measuring range of
        # 1 m or so), the confocalDT IFS2405 and the Omron E4PA.
        Effect(
            code="cubic",
            phrase="a third-order range error of {size} at the largest reading",
            remedy="measure over a shorter span of ranges around the working distance, or linearise "
            "the sensor",
            reveal="add stations over the whole span of ranges at the same angles of incidence",
            of_readings=of_sensors.cubic,
            power=3,
            of_sensor=by_kind(0.002, 0.01, 0.0005, 0.01),
        ),
        # A machined face of up to 300 mm is flat to 0.2 mm (ISO 2768-2, class H).
        Effect(
            code="sag",
            phrase="a curvature of the plate by {size} from the middle of its spots to the farthest "
            "one",
            remedy="use a flatter plate, support it evenly, or measure a smaller part of it",
            reveal="add stations that look at the middle and at the edges of the plate from several "
            "sides",
            members=of_plates.sag,
            of_cell=2e-4,
        ),
        # A reading is taken up to a tenth of a step before or after its pose.
        Effect(
            code="lag",
            phrase="a lag between poses and readings by {size} of the step to the next station",
            remedy="let the hand come to rest before reading, and synchronise the clocks of robot and "
            "sensor",
            reveal="reach some stations again from another side",
            unit="1",
            members=of_robots.lag,
            of_cell=0.1,
        ),
        # Over a warm-up by 10 K. Triangulation: 0.03 % a kelvin (data sheet of the optoNCDT 1402).
        # Ultrasound: the speed of sound changes by 0.17 % a kelvin. The others as their accuracy.
        Effect(
            code="drift",
            phrase="a drift of the readings by {size} over the recording",
            remedy="let the sensor warm up, and record in a shorter time",
            reveal="repeat the first stations at the end",
            members=of_sensors.drift,
            of_sensor=by_kind(0.003, 0.01, 0.0005, 0.017),
        ),
        # Held by hand-tightened clamps a plate moves by up to 1 mm.
        Effect(
            code="displaced",
            phrase="a displacement by {size} of {subject}",
            remedy="fix the plate, and give the stations after the displacement a plane label of their "
            "own",
            reveal="record more stations before each plane, and repeat the first ones at the end",
            anywhere="one plane from some station on",
            members=of_plates.displaced,
            of_cell=1e-3,
        ),
        Effect(
            code="tool-displaced",
            phrase="a displacement of the tool frame by {size} {subject}",
            remedy="fasten the bracket of the sensors and the tool, let the robot warm up, and record "
            "again",
            reveal="repeat the first stations at the end, before the same planes",
            anywhere="while recording",
            members=of_robots.tool_displaced,
            of_cell=2.5e-4,
        ),
        # Colours err as linearity does: see `cubic`.
        Effect(
            code="beam-on-plane",
            phrase="a bias of {size} of {subject}",
            remedy="check the surface of that plane under the beam, or remove these readings",
            reveal="add a plane of the same surface",
            confounded="the offset of the plane or the location of the beam: it takes two beams that "
            "see the same two planes",
            anywhere="one beam on one plane",
            members=of_plates.beam_on_plane,
            of_sensor=by_kind(0.002, 0.01, 0.0005, 0.01),
        ),
        # As the lengths: see `translation-scale`.
        Effect(
            code="turn-scale",
            phrase="a scale error of the robot's turns by {size}",
            remedy="have the robot's joints calibrated, and check the unit and the convention of its "
            "angles",
            reveal="turn the hand further, and about other axes",
            unit="1",
            members=of_robots.turn_scale,
            of_cell=1e-3,
        ),
        # Lengths of a six-axis arm are wrong by up to 0.65 mm over a metre (Slamani, Nubiola and Bonev,
        # Industrial Robot 2012).
        Effect(
            code="translation-scale",
            phrase="a scale error of the robot's translations by {size}",
            remedy="check the robot's translations against a known length, or calibrate without range "
            "errors if the scale of the sensor is known",
            reveal="measure a known length with the robot",
            unit="1",
            confounded="k1 of all beams, because every length scales together",
            is_k1=True,
            members=of_robots.translation_scale,
            of_cell=1e-3,
        ),
        # The sampling capacitor brings C / (C + C_input) of the channel before along: 2 % for 20 pF at
        # an input of 1 nF (Microchip, "Channel to channel crosstalk and error").
        Effect(
            code="carry-over",
            phrase="a carry-over of {size} from one channel to the next",
            remedy="sample slower, put a buffer before the converter, or use a converter for each "
            "sensor",
            reveal="cover one sensor while another reads a fixed distance; state carry_over_percent = "
            "0 in the rig file's [plausible] where every sensor has a converter of its own",
            unit="1",
            of_readings=of_sensors.carry_over,
            least_beams=2,
            of_cell=0.02,
        ),
        # The following no recording can show, because unknowns of the calibration are the same.
        # Readings that err by size times tan(tilt): with dr across the beam a plane that is tilted by
        # the angle a towards dr is met |dr| tan a earlier. Triangulation: as `incidence`, where that
        # grows with the tangent and has its sign.
        Effect(
            code="tilt",
            phrase="a range error of {size} at an incidence of 45 deg that changes its sign with the "
            "side",
            remedy="calibrate once more with the sensor turned by half a turn about its beam, and take "
            "the mean",
            reveal="calibrate once more with the sensor turned by half a turn about its beam",
            confounded="a location of the beam to the side",
            across=True,
            of_sensor=by_kind(0.0087, 0.01, 0.0005, 0.01),
        ),
        Effect(
            code="inverse-cosine",
            phrase="a range error proportional to 1/cos(incidence)",
            remedy="nothing is needed for the beams; measure the offset of a plane by other means if "
            "it matters",
            confounded="the offsets of the planes; it changes no beam",
        ),
        Effect(
            code="tool-frame",
            phrase="an error of the tool frame",
            remedy="use the calibration with the tool frame of the recording only",
            confounded="the mount of the beams: both are one rigid motion",
        ),
        Effect(
            code="range-offset",
            phrase="a constant offset of the readings",
            remedy="use the location together with readings of the same sensor only: their sum is "
            "right",
            confounded="the location of the beam along itself",
        ),
    )
}
"""All systematic errors by their codes, each under the source of its plausible size."""
OF_READINGS = {
    code: effect.of_readings for code, effect in EFFECTS.items() if effect.of_readings is not None
}
"""Columns of the errors that a reading has by itself, whenever it is taken."""


def may_also_be(codes: tuple[str, ...]) -> str:
    """Say which other errors the readings do not tell from one that was found."""
    return f"it may also be {' or '.join(EFFECTS[code].without_size() for code in codes)}"
