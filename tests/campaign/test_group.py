"""Groups of campaigns: read as one robot, each campaign in its own way; what is no group."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest
import yaml

import pa10cal
from made_up_poses import at_rest
from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.refit_frames import refit_frames
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.description import describe_group, read_description
from pa10cal.campaign.table import read_observations, write_pose_table
from pa10cal.commands.command_line import main
from pa10cal.errors import CalibrationError, Pa10calError, RawDataError, SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.fit.loads import statics_of
from pa10cal.settings import parse_settings
from pa10cal.terms.model import Model

MIXED = ("pose", "points", "distance")
ZEROS_NM = np.array([0.0, 12.0, -8.0, 3.0, 0.0, 0.0])


SHIPPED = files("pa10cal.files").joinpath("arms", "ur10.yaml")


def campaign(folder, kind, name, spoil=lambda made: None, **asked):
    """Write a campaign of a robot as it is described, and return its folder."""
    made = sighted(folder, kind, **{"poses": 50, "noise_mm": 0.01, **asked})
    made.folder = folder / name
    made.description["name"] = name
    spoil(made)
    return made.write()


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("group")
    return [campaign(folder, kind, f"of-{kind}", seed=k) for k, kind in enumerate(MIXED)]


@pytest.mark.slow
def test_a_group_is_read_calibrated_and_predicts(folders):
    group = pa10cal.read_group(folders, "ur10")
    assert group.name == "ur10"
    assert len(group.observations) == 150
    assert group.observations.pose[0].startswith("of-pose/")
    model = pa10cal.calibrate(group)
    assert model.fitted_to.instrument == "pose and points and distance"
    names = set(model.parameters.parameter)
    assert {"tool_x@of-pose", "base_rx@of-points", "delta_a_2"} <= names
    assert "base_rx@of-distance" not in names  # a distance shows no orientation of the base
    assert set(model.frames) >= {"target_T1@of-points", "target_target@of-distance"}
    errors = model.deviations(model.as_modelled(group.observations)).distance_mm
    assert np.sqrt(np.mean(errors**2)) < 0.03
    assert model.predict(np.zeros(6), frame="tool").T.shape == (1, 4, 4)


def test_arms_of_a_group_may_be_described_elsewhere(folders, tmp_path):
    described = yaml.safe_load(SHIPPED.read_text())
    described["rows"][1]["a_m"] -= 0.001
    (tmp_path / "ur10.yaml").write_text(yaml.safe_dump(described))
    group = pa10cal.read_group(folders[:2], "ur10", arms=tmp_path)
    assert group.arm.a_m[1] == described["rows"][1]["a_m"]
    (tmp_path / "ur10.yaml").write_text("robot: [")
    with pytest.raises(Pa10calError, match=r"ur10\.yaml"):
        pa10cal.read_group(folders[:2], "ur10", arms=tmp_path)


def test_few_poses_at_the_lowest_load_are_joined_by_those_at_every_load(folders, tmp_path):
    def loaded(made):
        made.poses[4:] = [line.replace(",0,1,", ",44,1,", 1) for line in made.poses[4:]]

    other = campaign(tmp_path, "distance", "loaded", spoil=loaded)
    every = pa10cal.read_group([folders[0], other], "ur10").observations
    assert np.count_nonzero(every.states.load_N) == 47


def test_each_campaign_is_checked_alone(folders):
    group = pa10cal.read_group(folders, "ur10")
    each = group.observations.by_campaign()
    assert list(each) == [f"of-{kind}" for kind in MIXED]
    assert [own.measured.kind for own in each.values()] == list(MIXED)
    assert all(own.states.campaign is None for own in each.values())
    assert np.all(np.diff(group.observations.states.time_s) > 0.0)


def test_where_each_instrument_stands_is_kept_in_the_table(folders, tmp_path):
    every = pa10cal.read_group(folders, "ur10").observations
    stand_m = every.measured.p_first_instr_of
    assert list(stand_m) == [f"of-{kind}" for kind in MIXED]
    # The frame is that of the first.
    np.testing.assert_allclose(stand_m["of-pose"], 0.0, atol=1e-12)
    # In the frame of its own instrument a campaign is as it was read.
    own = pa10cal.read_campaign(folders[1]).observations.measured.places_m
    there = every.by_campaign()["of-points"].measured.places_m
    length_m = np.linalg.norm(there - stand_m["of-points"], axis=2)
    np.testing.assert_allclose(np.sort(length_m), np.sort(np.linalg.norm(own, axis=2)), atol=1e-9)
    write_pose_table(tmp_path / "poses.parquet", every, np.zeros(6, dtype=bool), "ur10")
    described = describe_group("ur10", [(read_description(f), load_arm("ur10")) for f in folders])
    back = read_observations(tmp_path / "poses.parquet", described).measured.p_first_instr_of
    np.testing.assert_equal(dict(back), dict(stand_m))


def joined(folders, out, name="ur10"):
    tables, frames = [], []
    for folder in folders:
        table, frame = folder / "poses.parquet", folder / "base_frame.json"
        given = ["--campaign-dir", str(folder)]
        out_of = ["--out", str(table), "--quarantine", str(folder / "quarantine.csv")]
        assert main(["ingest", *given, *out_of]) == 0
        assert main(["seed", *given, "--poses", str(table), "--out", str(frame)]) == 0
        tables.append(str(table))
        frames.append(str(frame))
    given = ["--name", name, "--out-dir", str(out)]
    given += ["--campaign-dir", *map(str, folders), "--poses", *tables, "--base-frame", *frames]
    return main(["join", *given])


@pytest.mark.slow
def test_commands_take_a_joined_group_like_a_campaign(folders, tmp_path, capsys):
    assert joined(folders, tmp_path / "ur10") == 0
    described = read_description(tmp_path / "ur10")
    assert [each.name for each in described.campaigns] == [f"of-{kind}" for kind in MIXED]
    assert described.instrument_kinds == "pose and points and distance"
    given = ["--campaign-dir", str(tmp_path / "ur10")]
    given += ["--poses", str(tmp_path / "ur10/poses.parquet")]
    frame = str(tmp_path / "base_frame.json")
    assert main(["seed", *given, "--out", frame]) == 0
    options = '{"general": {"springs": []}}'
    calibrated = ["--base-frame", frame, "--load", "combined", "--settings", options]
    out = str(tmp_path / "combined.json")
    assert main(["calibrate", *given, *calibrated, "--out", out]) == 0
    assert "ur10 combined: converged" in capsys.readouterr().out
    read = pa10cal.read_group(folders, "ur10")
    table = read_observations(tmp_path / "ur10/poses.parquet", described)
    assert table.pose.tolist() == read.observations.pose.tolist()
    np.testing.assert_allclose(
        table.measured.parts[2].d_m, read.observations.measured.parts[2].d_m, atol=1e-12
    )


def test_errors_of_logged_torques_are_taken_out_of_a_group(tmp_path):
    chain, gravity_m_s2 = Chain.of(load_arm("ur10")), np.array([0.0, 0.0, -9.80665])
    payload, weights_Nm = Payload(1.0, np.array([0.0, 0.0, 0.05]), np.zeros(3), gravity_m_s2), {}

    def logged(made):
        weights = statics_of(Model(chain, ()), np.zeros(0), at_rest(made.q), payload)
        name, tau_Nm = made.description["name"], weights.joint_Nm
        made.poses[0] += "".join(f",tau{j}_Nm" for j in range(1, 7))
        for k, (of_weights, of_log) in enumerate(zip(tau_Nm, tau_Nm + ZEROS_NM, strict=True)):
            weights_Nm[f"{name}/P{k:03d}"] = of_weights
            made.poses[k + 1] += "".join(f",{torque:.3f}" for torque in of_log)

    pair = [
        campaign(tmp_path, "pose", name, logged, poses=100, seed=k) for k, name in enumerate("ab")
    ]
    every = pa10cal.read_group(pair, "ur10").observations
    of_poses_Nm = np.array([weights_Nm[label] for label in every.pose])
    np.testing.assert_allclose(every.states.tau_Nm, of_poses_Nm, atol=0.1)


def test_a_groups_folder_has_no_raw_files(folders, tmp_path):
    assert joined(folders[:2], tmp_path / "ur10") == 0
    with pytest.raises(RawDataError, match="the folder is of a group"):
        pa10cal.read_campaign(tmp_path / "ur10")


def test_join_takes_all_of_every_campaign(folders, capsys):
    given = ["--campaign-dir", *map(str, folders[:2]), "--poses", "a.parquet"]
    assert main(["join", "--name", "x", *given, "--base-frame", "a.json", "--out-dir", "x"]) == 2
    assert "one of each for every campaign" in capsys.readouterr().err


def test_a_model_of_a_group_is_saved_and_carried_over(folders, tmp_path):
    group = pa10cal.read_group(folders[:2], "ur10")
    model = pa10cal.calibrate(group)
    model.save(tmp_path / "model.yaml")
    again = pa10cal.load_model(tmp_path / "model.yaml")
    q = np.linspace(-1.0, 1.0, 12).reshape(2, 6)
    for frame in ("flange", "tool", "target_T1@of-points"):
        np.testing.assert_allclose(
            again.predict(q, frame=frame).T, model.predict(q, frame=frame).T, atol=1e-12
        )
    alone = pa10cal.read_campaign(folders[1])
    elsewhere = refit_frames(again, again.as_modelled(alone.observations))
    errors = elsewhere.deviations(elsewhere.as_modelled(alone.observations)).distance_mm
    assert np.sqrt(np.mean(errors**2)) < 0.03


def test_robots_of_two_kinds_are_no_group(folders, tmp_path):
    other = campaign(tmp_path, "pose", "another", robot="irb120")
    with pytest.raises(RawDataError, match=r"not of one robot.*ur10 and irb120"):
        pa10cal.read_group([folders[0], other])


def test_two_nominal_tables_of_one_robot_are_no_group(folders, tmp_path):
    other = campaign(tmp_path, "pose", "another")
    described = yaml.safe_load(SHIPPED.read_text())
    described["rows"][1]["a_m"] -= 0.001
    (other / "ur10.yaml").write_text(yaml.safe_dump(described))
    with pytest.raises(RawDataError, match="a_m, row 2"):
        pa10cal.read_group([folders[0], other])


@pytest.mark.parametrize(
    ("chosen", "name", "words"),
    [
        ([0], "ur10", "fewer than two"),
        ([], "ur10", "fewer than two"),
        ([0, 1, 0], "ur10", "stands in a group twice"),
        ([0, 1], "of-pose", "called like one of its campaigns"),
    ],
)
def test_what_is_no_group_is_refused(folders, chosen, name, words):
    with pytest.raises(RawDataError, match=words):
        pa10cal.read_group([folders[k] for k in chosen], name)


def test_the_papers_model_is_for_one_campaign(folders):
    group = pa10cal.read_group(folders[:2], "ur10")
    options = CalibrationOptions(model="paper")
    with pytest.raises(CalibrationError, match=r"of one campaign.*set calibration.model to auto"):
        pa10cal.calibrate(group, options)


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({"ur10": ["a"]}, "two or more"),
        ({"ur10": []}, "two or more"),
        ({"ur10": ["a", "a"]}, "each once"),
        ({"a": ["a", "b"]}, "called like a campaign"),
        ({"b": ["a", "c"], "d": ["b", "a"]}, "called like a campaign"),
        ({"wild_trials": ["a", "b"]}, "none of"),
        ({".x": ["a", "b"]}, "not beginning"),
    ],
)
def test_settings_refuse_what_is_no_group(groups, words):
    with pytest.raises(SettingsError, match=words):
        parse_settings({"campaigns": ["a"], "groups": groups}, where="config.yaml")


def test_settings_take_groups():
    found = parse_settings({"campaigns": ["c"], "groups": {"ur10": ["a", "b"]}}, where="")
    assert found.groups == {"ur10": ("a", "b")}


@pytest.mark.parametrize("listed", [3, None, "pose"])
def test_a_campaign_of_a_group_that_is_no_description_is_refused(tmp_path, listed):
    content = {"schema": "pa10cal-group/1", "name": "both", "campaigns": [listed]}
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(SettingsError, match=r"campaigns\[0\]: key the whole does not fit"):
        read_description(tmp_path)
