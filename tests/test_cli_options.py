"""A bad value gets one line that names what the user wrote: the option, or the field and its file."""

import inspect
import json
import re

import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.cli import verbs
from handlaser_gtsam.cli.options import expanded
from handlaser_gtsam.files.logs.format import LogFormat
from handlaser_gtsam.files.study_toml import read_study

RECORDING = str(GRIPPER / "recording.csv")
PLANNED = str(GRIPPER.parent / "planned" / "rig.toml")
STUDY = GRIPPER.parent / "study" / "study.toml"
BASE = {
    "calibrate": [RECORDING, "--quiet"],
    "check": [RECORDING],
    "convert": [RECORDING, "--quiet"],
    "export": ["calibration.json", "--to", "kuka"],
    "plan": [
        "--rig",
        str(GRIPPER.parent / "planned" / "rig.toml"),
        "--calibration",
        "calibration.json",
    ],
    "plot": [RECORDING, "--out", "pictures"],
    "simulate": ["made", "--quiet"],
    "study": [str(STUDY), "--quiet"],
    "validate": [RECORDING],
    "watch": ["."],
}
OFFER = {"--plane-file", "--readings", "--rig", "--calibration", "--hold-out"}
"""Files to be read."""
WORDS = {
    "--tool": "1,2",
    "--base": "1,2,3,4,5,6,nan",
    "--plane-ranges": "abc",
    "--delimiter": "abc",
    "--pose-format": "abc",
    "--rotation": "abc",
    **{f"--{name}-column": "abc" for name in ("plane", "station", "time")},
    **{f"--{name}-columns": "abc" for name in ("pose", "range")},
}
"""Bad values of options that take text."""
FREE = {
    *("--beam", "--link", "--into", "--out", "--picture", "--report", "--host", "--scheduler"),
    "--write-log",
    *("--plane", "--header", "--sheet", "--pose-topic", "--frames"),
    *("--beam-column", "--range-column"),  # both or none
    *("--readings-station-column", "--readings-time-column"),  # of a second file
}
"""Options that take any text, or files to write, whose message names the file."""
PYDANTIC = re.compile(r"Input should|validation error|type=|pydantic|Value error|\[")


def _bad_values():
    for verb in BASE:
        parameters = inspect.signature(expanded(verbs.function_of(verb))).parameters
        for name, one in parameters.items():
            kinds, option = str(one.annotation), f"--{name.replace('_', '-')}"
            if "OptionInfo" not in kinds or "bool" in kinds or option in FREE:
                continue
            if verb == "export" and option == "--tool":
                values = ["0"]
            elif option in OFFER:
                values = ["missing/file"]
            elif option in WORDS:
                values = [WORDS[option]]
            elif "tuple[float, float]" in kinds:
                values = ["5 1", "nan 3", "a 1", "-1e300 2"]
            elif "float" in kinds:
                values = ["nan", "abc", "1e300"]
            elif option == "--seed":
                values = ["-1", "1.5"]
            elif "int" in kinds.partition(",")[0]:
                values = ["-1", "1.5", "99999999999999999999"]
            else:
                values = ["abc"]
            for value in values:
                yield pytest.param(verb, option, value.split(), id=f"{verb} {option} {value}")


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A folder with a calibration."""
    folder = tmp_path_factory.mktemp("options")
    result = hl.calibrate(hl.read_recording(RECORDING), hl.Noise(3e-5, 0.0, 0.0))
    hl.write_calibration(folder / "calibration.json", result)
    return folder


@pytest.mark.parametrize(("verb", "option", "values"), list(_bad_values()))
def test_names_the_option(verb, option, values, refusal, calibrated, monkeypatch):
    monkeypatch.chdir(calibrated)
    if verb == "watch":
        pytest.importorskip("uvicorn")
    base = BASE[verb]
    if option == "--calibration" and verb == "plan":
        base = base[:2]
    err = refusal(verb, *base, option, *values)
    assert option in err
    assert not PYDANTIC.search(err)


RIG_FIELDS = {
    "noise": "range_sigma_mm pose_translation_sigma_mm pose_rotation_sigma_deg incidence_sigma_mm "
    "pose_translation_prior_mm pose_rotation_prior_deg",
    "sensor": "max_incidence_deg linearity_percent",
    "limits": "rms_mm location_sigma_mm direction_sigma_deg",
    "log": "tolerance_s stand_s stand_mm stand_deg",
    "goal": "location_sigma_mm direction_sigma_deg spot_mm",
    "placement": "largest_tilt_deg within_mm tilt_deg",
    "workspace": "largest_turn_deg largest_step_mm",
    "blind": "location_within_mm cone_deg plate_within_mm plate_tilt_deg",
}
NEEDED = {
    "workspace": "box_mm = [[0, 0, 0], [1, 1, 1]]\n",
    "blind": "location_mm = [[0, 0, 0]]\ndirection = [[0, 0, 1]]\nplate_point_mm = [0, 0, 9]\n"
    "plate_normal = [0, 0, 1]\n",
}


def refused(read, path, text):
    path.write_text(text)
    with pytest.raises(hl.InputError) as caught:
        read(path)
    words = str(caught.value)
    assert str(path) in words
    assert not PYDANTIC.search(words.replace("[least, largest]", ""))
    return words


@pytest.mark.parametrize(
    ("table", "field"), [(t, f) for t, fields in RIG_FIELDS.items() for f in fields.split()]
)
def test_names_the_field_of_a_rig_file_in_its_own_unit(table, field, tmp_path):
    text = f"[{table}]\n{NEEDED.get(table, '')}{field} = -2\n"
    words = refused(hl.read_rig, tmp_path / "rig.toml", text)
    unit = {"mm": " mm", "deg": " deg", "percent": " %", "s": " s"}[field.rpartition("_")[2]]
    assert f"found {table}.{field} -2{unit}; expected a number, " in words


def test_names_fields_of_the_table_of_logs_and_not_options(tmp_path):
    rig = tmp_path / "rig.toml"
    assert "log.stands and log.interpolate" in refused(
        hl.read_rig, rig, "[log]\nstands = true\ninterpolate = true\n"
    )
    assert "log.units 'km'" in refused(hl.read_rig, rig, '[log]\nunits = "km"\n')
    assert "sensor.range_mm 5 1 mm" in refused(hl.read_rig, rig, "[sensor]\nrange_mm = [5, 1]\n")


def test_names_the_field_of_a_study(tmp_path):
    study = tmp_path / "study.toml"
    scene, end = '[scenes.a]\nscene = "paper"\n', "\n[treatments.b]\n"
    for text, name in (
        (f"{scene}beams = -1{end}", "scenes.a.beams -1"),
        (f"{scene}range_sigma_mm = -1{end}", "scenes.a.range_sigma_mm -1 mm"),
        (f"{scene}k2_per_m = 1e300{end}", "scenes.a.k2_per_m 1e+300 1/m"),
        (f"{scene}{end}noise = 3", "treatments.b.noise = 3; expected one of 'scene' or a table"),
        (f"{scene}{end}noise = {{ a = 1 }}", "the unknown field treatments.b.noise.a"),
        (
            f"{scene}{end}noise = {{ range_sigma_mm = -1 }}",
            "treatments.b.noise.range_sigma_mm -1 mm",
        ),
    ):
        assert name in refused(read_study, study, text)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("version",), 2, "version = 2; expected 1 or less"),
        (("version",), "1", "version = '1'; expected a whole number"),
        (
            ("beams", 0, "range_error_terms"),
            -1,
            "beams.0.range_error_terms = -1; expected 0 or more",
        ),
        (
            ("beams", 0, "location_m"),
            [1.0],
            "location_m = [1.0]; expected an array of 3 or more",
        ),
        (("beams", 0, "location_m"), [1.0] * 4, "expected an array of 3 or fewer"),
        (("beams", 0, "direction", 0), None, "beams.0.direction.0 = None; expected a number"),
        (("fit", "range_sigma_m"), [], "fit.range_sigma_m = []; expected a number"),
    ],
)
def test_names_the_field_of_a_calibration(calibrated, tmp_path, place, value, words):
    record = json.loads((calibrated / "calibration.json").read_text())
    inside = record
    for part in place[:-1]:
        inside = inside[part]
    inside[place[-1]] = value
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(record))
    with pytest.raises(hl.InputError) as caught:
        hl.read_calibration(path)
    assert words in str(caught.value)


LOG_FIELDS = [one.replace("_", "-") for one in LogFormat.__dataclass_fields__]


@pytest.mark.parametrize("verb", ["calibrate", "check", "plan", "plot", "validate", "watch"])
def test_options_of_logs_at_other_verbs_are_answered_with_what_to_do(verb, handlaser, refusal):
    for option in LOG_FIELDS:
        err = refusal(verb, RECORDING, f"--{option}=mm")
        assert f"no option --{option} at handlaser {verb}" in err
        assert f"[log] of the rig file, as {option.replace('-', '_')}." in err
        assert "`handlaser convert`" in err
    _, _, err = handlaser("study", str(STUDY), "--pose-format", "kuka")  # reads no log
    assert "No such option" in err


def test_a_field_of_a_log_that_a_recording_passes_over_is_said_to_be(handlaser, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text('[log]\npose_columns = ["misspelt"]\n')
    code, out, _ = handlaser("calibrate", RECORDING, "--rig", rig)
    assert code == 0
    assert "what is stated of logs does not count" in " ".join(out.split())
