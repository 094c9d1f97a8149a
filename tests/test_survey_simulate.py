"""Simulated surveys: what is written is read, calibrated, and right within its covariance."""

import json

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl

SENSORS = {
    "profiler": '[[sensors]]\nname = "p"\nkind = "profiler"\nsigma_mm = 0.03\nsigma_across_mm = 0.01\n',
    "scanner": '[[sensors]]\nname = "s"\nkind = "scanner"\n',
    "array": '[[sensors]]\nname = "a"\nkind = "array"\nzones = "zones.csv"\n'
    'convention = "perpendicular"\nsigma_mm = 0.4\n',
    "points": '[[sensors]]\nname = "c"\nkind = "points"\n',
}


def rig_of(folder, *kinds, head=""):
    """A rig file with sensors of some kinds."""
    angles = np.linspace(-17.5, 17.5, 8)
    rows = [f"{8 * i + j},{x},{y}" for i, x in enumerate(angles) for j, y in enumerate(angles)]
    (folder / "zones.csv").write_text("\n".join(["zone,x_deg,y_deg", *rows]) + "\n")
    path = folder / "given.toml"
    path.write_text(head + "\n".join(SENSORS[kind] for kind in kinds))
    return str(path)


def far(result, truth):
    """The smallest probability that chance makes a mount so far off."""
    chances = []
    for one in truth["sensors"]:
        found = result.sensors[one["name"]]
        R = found.rotation
        turn = Rotation.from_matrix(R.T @ np.array(one["rotation"])).as_rotvec()
        e = np.concatenate((turn, R.T @ (np.array(one["location_m"]) - found.location)))
        chances.append(chi2.sf(float(e @ np.linalg.solve(found.covariance[:6, :6], e)), 6))
    return min(chances)


CASES = {
    "a profiler": (("profiler",), "plane:A,sphere:ball", ()),
    "all kinds": (("profiler", "scanner", "array", "points"), "plane:A,plane:B,sphere:ball", ()),
    "beams and a point": (("scanner",), "plane:A,point:tip", ("--beams", "2")),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_what_is_simulated_is_calibrated_within_its_covariance(handlaser, tmp_path, case):
    kinds, targets, more = CASES[case]
    rig = rig_of(tmp_path, *kinds)
    folder = tmp_path / "made"
    words = ["simulate", folder, "--rig", rig, "--targets", targets, "--seed", "1", *more]
    code, out, err = handlaser(*words)
    assert (code, err) == (0, "")
    assert "stations.csv" in out
    survey = hl.read_survey(folder / "stations.csv", folder / "rig.toml")
    result = hl.calibrate(survey, hl.read_rig(folder / "rig.toml").noise)
    assert result.status == "converged", result.message
    truth = json.loads((folder / "truth.json").read_text())
    assert far(result, truth) > 1e-4  # of half a dozen mounts
    for one in truth["beams"]:
        found = result.beams[one["name"]]
        e = found.location - one["location_m"]
        C = found.covariance[:3, :3]
        assert chi2.sf(float(e @ np.linalg.solve(C, e)), 3) > 1e-4


FEW = {
    # Sensors, targets, stations and beams.
    "two spheres": ("profiler", "sphere:a,sphere:b", 14, 2),
    "a plane, a sphere and a point": ("profiler", "plane:A,sphere:b,point:tip", 8, 2),
    "three beams": ("profiler", "sphere:a,sphere:b,sphere:c", 10, 3),  # held targets find these
    "a beam beside the centres": ("scanner points", "sphere:a,sphere:b,sphere:c", 8, 2),
}
SEEDS = {"three beams": 3, "a beam beside the centres": 7}


@pytest.mark.slow
@pytest.mark.parametrize("case", FEW)
def test_beams_with_few_readings_are_found_before_targets_of_others(handlaser, tmp_path, case):
    """By itself such a beam fits perfectly wherever its balls are, and other starts miss the balls."""
    kinds, targets, stations, beams = FEW[case]
    rig = rig_of(tmp_path, *kinds.split())
    words = ("--targets", targets, "--stations", stations, "--beams", beams)
    words += ("--seed", SEEDS.get(case, 1))
    assert handlaser("simulate", tmp_path / "out", "--rig", rig, *words)[0] == 0
    survey = hl.read_survey(tmp_path / "out" / "stations.csv", tmp_path / "out" / "rig.toml")
    result = hl.calibrate(survey, hl.read_rig(tmp_path / "out" / "rig.toml").noise)
    assert result.status == "converged", result.message
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert far(result, truth) > 1e-4
    for one in truth["beams"]:
        found = result.beams[one["name"]]
        e = found.location - one["location_m"]
        assert chi2.sf(float(e @ np.linalg.solve(found.covariance[:3, :3], e)), 3) > 1e-4


def test_readings_without_errors_are_ranges_to_the_plane_by_another_formula(handlaser, tmp_path):
    """Points of a table without noise, in the world, lie on the true targets to its last digit."""
    head = "[noise]\npose_translation_sigma_mm = 0.0\npose_rotation_sigma_deg = 0.0\n"
    rig = rig_of(tmp_path, "scanner", head=head)
    words = ["simulate", tmp_path / "out", "--rig", rig, "--range-sigma-mm", "0", "--k1", "0.01"]
    assert handlaser(*words, "--k2-per-m", "0.02")[0] == 0
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    # A reading of the survey would look for another convention, because of the large range error.
    of = hl.read_stations(tmp_path / "out" / "stations.csv")
    tables = hl.read_rig(tmp_path / "out" / "rig.toml").survey
    (shots,), *_ = tables.shots(of.station_names)
    d = shots.reading + 0.01 * shots.reading + 0.02 * shots.reading**2
    a = shots.across[:, 0]
    p = np.column_stack((d * np.cos(a), d * np.sin(a), 0.0 * a))
    mount = truth["sensors"][0]
    p = p @ np.array(mount["rotation"]).T + mount["location_m"]
    p = np.einsum("nij,nj->ni", of.world_R_hand[shots.station], p)
    p += of.world_t_hand[shots.station]
    off = {}
    for one in truth["targets"]:
        v = one["values"]
        mine = p[np.array(of.plane_labels)[shots.station] == one["label"]]
        if one["kind"] == "plane":
            off[one["label"]] = mine @ [v["nx"], v["ny"], v["nz"]] + v["b"]
        else:
            off[one["label"]] = np.linalg.norm(mine - [v[x] for x in "xyz"], axis=1) - v["radius"]
    assert all(len(one) > 100 for one in off.values())
    # Half of the last digit is 5e-9 m, and an angle of half a digit is as much at 0.1 m.
    assert max(np.abs(one).max() for one in off.values()) < 2e-8


def test_an_array_reads_z_where_its_convention_says_so(handlaser, tmp_path):
    rig = rig_of(tmp_path, "array")
    assert handlaser("simulate", tmp_path / "z", "--rig", rig)[0] == 0
    text = (tmp_path / "given.toml").read_text().replace("perpendicular", "radial")
    (tmp_path / "given.toml").write_text(text)
    assert handlaser("simulate", tmp_path / "r", "--rig", rig)[0] == 0
    z, r = (pl.read_csv(tmp_path / name / "a.csv") for name in "zr")
    u = pl.read_csv(tmp_path / "z" / "a-zones.csv")
    length = np.linalg.norm(u.select("x", "y", "z").to_numpy(), axis=1)[z["zone"].to_numpy()]
    assert r["reading"].to_numpy() == pytest.approx(z["reading"].to_numpy() * length, abs=2e-5)


BAD = {
    "no sensors": ("", (), "no table [[sensors]]"),
    "relations": ('[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\nvalue_mm = 3.0\n'
                  "sigma_mm = 0.1\n", (), "[[known]], which is not simulated"),
    "a scene": ("", ("--scene", "arm"), "--scene or --planes with --rig"),
    "a name that is no file": ("", (), "a sensor called"),
    "a point alone": ("", ("--targets", "point:tip", "--beams", "1"), "no reading of p"),
    "a point without a beam": ("", ("--targets", "point:tip"), "the target point:tip"),
    "a kind that is none": ("", ("--targets", "cube:C"), "the label 'cube:C'"),
    "no zones": ("", (), "no readable file"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_simulated_is_refused_and_nothing_written(refusal, tmp_path, case):
    head, more, words = BAD[case]
    kinds = {"no sensors": (), "no zones": ("array",)}.get(case, ("profiler",))
    rig = rig_of(tmp_path, *kinds, head=head)
    if case == "a name that is no file":
        path = tmp_path / "given.toml"
        path.write_text(path.read_text().replace('name = "p"', 'name = "a/p"'))
    if case == "no zones":
        (tmp_path / "zones.csv").unlink()
    err = refusal("simulate", tmp_path / "new", "--rig", rig, *more)
    assert words in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "new").exists()


def test_stations_of_which_no_ray_hits_are_counted_and_stay(handlaser, tmp_path):
    """A ball is narrower than the field of view of an array, of which a third has to be on it."""
    rig = rig_of(tmp_path, "array")
    words = ["simulate", tmp_path / "out", "--rig", rig, "--targets", "sphere:ball", "--seed", "6"]
    code, out, err = handlaser(*words)
    assert (code, err) == (0, "")
    stations = pl.read_csv(tmp_path / "out" / "stations.csv")["station"].to_list()
    read = set(pl.read_csv(tmp_path / "out" / "a.csv")["station"].to_list())
    unread = sum(one not in read for one in stations)
    assert unread > 0
    assert f"1 target, 11 stations each; at {unread} of 11 stations no ray hits a target" in (
        " ".join(out.split())
    )


def test_few_stations_are_for_all_sensors_in_turns(handlaser, refusal, tmp_path):
    rig = rig_of(tmp_path, "profiler", "scanner")
    words = ["simulate", tmp_path / "out", "--rig", rig, "--targets", "plane:A,plane:B"]
    assert handlaser(*words, "--stations", "1")[0] == 0
    assert "no reading of s at any of 1 stations; expected more stations" in refusal(
        *words[:4], "--targets", "plane:A", "--stations", "1", "--force"
    )


def test_how_logs_are_written_does_not_matter(handlaser, tmp_path):
    """The rig file of a real log serves as it is; what is written is no log."""
    rig = rig_of(tmp_path, "profiler", head='[log]\npose_format = "kuka"\n')
    assert handlaser("simulate", tmp_path / "out", "--rig", rig)[0] == 0
    assert "[log]" not in (tmp_path / "out" / "rig.toml").read_text()
    survey = hl.read_survey(tmp_path / "out" / "stations.csv", tmp_path / "out" / "rig.toml")
    assert len(survey.stations) == 22


def test_targets_without_sensors_are_refused(refusal, tmp_path):
    assert "--targets without --rig" in refusal(
        "simulate", tmp_path / "new", "--targets", "plane:A"
    )


def test_files_that_are_there_are_kept_unless_forced(handlaser, refusal, tmp_path):
    rig = rig_of(tmp_path, "profiler")
    assert handlaser("simulate", tmp_path / "out", "--rig", rig, "--quiet") == (0, "", "")
    before = (tmp_path / "out" / "p.csv").read_text()
    assert "stations.csv there already" in refusal(
        "simulate", tmp_path / "out", "--rig", rig, "--seed", "3"
    )
    assert handlaser("simulate", tmp_path / "out", "--rig", rig, "--seed", "3", "--force")[0] == 0
    assert (tmp_path / "out" / "p.csv").read_text() != before


def test_what_is_simulated_replaces_nothing_that_it_was_made_of(refusal, tmp_path):
    rig_of(tmp_path, "profiler", "array")
    rig = (tmp_path / "given.toml").rename(tmp_path / "rig.toml")
    before = rig.read_text()
    words = ("--rig", rig, "--stations", "3", "--force")
    assert "found the input itself as rig.toml; expected another file to write to" in refusal(
        "simulate", tmp_path, *words
    )
    assert rig.read_text() == before
    rig.write_text(before.replace("zones.csv", "made/a-zones.csv"))
    (tmp_path / "made").mkdir()
    zones = (tmp_path / "zones.csv").rename(tmp_path / "made" / "a-zones.csv")
    kept = zones.read_bytes()
    assert "found the input itself as a-zones.csv" in refusal("simulate", tmp_path / "made", *words)
    assert zones.read_bytes() == kept
    assert [one.name for one in zones.parent.iterdir()] == [zones.name]


def test_an_array_without_zones_is_refused_in_one_line(refusal, tmp_path):
    rig = rig_of(tmp_path, "array")
    text = (tmp_path / "given.toml").read_text()
    (tmp_path / "given.toml").write_text(text.replace('zones = "zones.csv"\n', ""))
    err = refusal("simulate", tmp_path / "made", "--rig", rig)
    assert (
        err
        == f"handlaser: --rig {rig}: found no zones of a; expected the file of zones of an array\n"
    )
