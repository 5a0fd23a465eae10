"""Campaigns of an instrument that gives poses directly."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest
from mended import simulated
from pa10cal.campaign.read import read_campaign, repeatability_mm
from pa10cal.campaign.tracked import notes_on_torques
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import parse_arm
from spoiling import ingest, replace, with_columns


@pytest.fixture
def tracked(raw_campaign):
    """The made-up campaign as a tracker would have given it."""
    raw_campaign.description["instrument"]["kind"] = "pose"
    raw_campaign.description["files"] = {"poses": "poses.csv"}
    del raw_campaign.description["ball_diameter_mm"]
    del raw_campaign.description["tool"]["balls_mm"]
    return raw_campaign


def test_poses_come_out_as_they_went_in(tracked):
    ingested = ingest(tracked)
    poses = ingested.observations
    assert ingested.quarantined == ()
    assert ingested.notes == ("no torques logged: those of the described masses are used",)
    assert list(poses.pose) == [key[1] for key in tracked.keys]
    measured = poses.measured
    R = np.array(tracked.T_instr_ee)[:, :3, :3]
    np.testing.assert_allclose(measured.T_instr_target[:, :3, :3], R, atol=2e-6)
    place_m = np.array(tracked.T_instr_ee)[:, :3, 3]
    np.testing.assert_allclose(measured.T_instr_target[:, :3, 3], place_m, atol=2e-9)
    np.testing.assert_allclose(poses.states.q_rad, tracked.q_rad, atol=1e-8)
    assert np.isnan(poses.states.tau_Nm).all()
    assert np.isnan(poses.states.temperature_C).all()
    assert not poses.states.arrival.any()
    assert measured.by_apparatus.shape == (34, 6, 0)


def test_what_is_stated_is_taken_and_what_is_not_follows_from_the_instrument(tracked):
    plain = ingest(tracked).observations.measured.cov
    np.testing.assert_allclose(plain[7], np.diag([5e-6**2] * 3 + [5e-5**2] * 3), rtol=1e-9)
    torques = {f"tau{j}_Nm": -20.0 * j for j in range(1, 7)}
    with_columns(tracked.poses, {"u_x_mm": 0.02, **torques, "temperature_C": 22.5})
    ingested = ingest(tracked)
    assert not any("torques" in note for note in ingested.notes)
    poses = ingested.observations
    np.testing.assert_allclose(poses.measured.cov[:, 0, 0], 2e-5**2)
    np.testing.assert_allclose(poses.measured.cov[:, 1, 1], 5e-6**2)
    assert (poses.states.tau_Nm[:, 1] == -40.0).all()
    assert (poses.states.temperature_C == 22.5).all()


def test_uncertainty_of_the_quaternion_is_that_of_a_small_rotation_on_the_left(tracked):
    u = [1e-4, 2e-4, 3e-4, 4e-4]
    with_columns(tracked.poses, dict(zip(("u_qw", "u_qx", "u_qy", "u_qz"), u, strict=True)))
    poses = ingest(tracked).observations
    R = Rotation.from_matrix(poses.measured.T_instr_target[3, :3, :3])
    drawn = R.as_quat(scalar_first=True) + np.random.default_rng(1).normal(0, u, (40_000, 4))
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    turns = (Rotation.from_quat(drawn, scalar_first=True) * R.inv()).as_rotvec()
    np.testing.assert_allclose(np.cov(turns.T), poses.measured.cov[3, 3:, 3:], atol=4e-9)


def test_positions_in_micrometres_are_noticed(tracked):
    for k, line in enumerate(tracked.poses[1:], start=1):
        words = line.split(",")
        words[11:14] = [f"{1e3 * float(word):.6f}" for word in words[11:14]]
        tracked.poses[k] = ",".join(words)
    with pytest.raises(Pa10calError, match=r"x_mm, y_mm, z_mm: .*look like micrometres"):
        ingest(tracked)


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize(
    ("x_mm", "reason"),
    [
        (9999, "further from the other positions than the arm reaches"),
        (1e5, "further from the other positions than the arm reaches"),
        (2e7, "a coordinate beyond any measuring volume"),
        (-1200, "far from where the joint angles put the end-effector"),
    ],
)
@pytest.mark.parametrize("index", [3, 9, 34])
def test_a_single_position_far_off_is_listed(tracked, index, x_mm, reason):
    replace(tracked.poses, index, "x_mm", str(x_mm))
    ingested = ingest(tracked)
    assert [(row.line, row.reason) for row in ingested.quarantined] == [(index + 1, reason)]
    assert len(ingested.observations) == 33


@pytest.mark.parametrize("quote", ["", '"'])
def test_a_field_longer_than_any_is_listed(tracked, quote):
    replace(tracked.poses, 12, "x_mm", quote + 150_000 * "7")
    (row,) = ingest(tracked).quarantined
    assert (row.line, row.reason) == (13, "not a finite number")


def test_an_uncertainty_left_blank_is_not_stated(tracked):
    with_columns(tracked.poses, {"u_x_mm": 0.02})
    replace(tracked.poses, 12, "u_x_mm", "")
    ingested = ingest(tracked)
    assert ingested.quarantined == ()
    assert ingested.observations.measured.cov[11, 0, 0] == pytest.approx(5e-6**2)


def test_torques_of_some_joints_only_are_refused(tracked):
    names = [f"tau{j}_Nm" for j in (1, 2, 4, 5, 6)]
    with_columns(tracked.poses, dict.fromkeys([*names, "tau_3_Nm"], 1.0))
    with pytest.raises(Pa10calError, match=r"poses.csv:1: missing column tau3_Nm .*'tau_3_Nm'"):
        ingest(tracked)


@pytest.mark.parametrize(
    ("rule", "held_out"),
    [({"every": 3}, ["P03", "P06"]), ({"last_fraction": 0.25}, ["H01", "H02"])],
)
def test_holds_out_whole_poses_where_the_rows_do_not_say_it(tracked, rule, held_out):
    tracked.description["holdout"] = rule
    tracked.poses[:] = [line.replace("holdout,", "grid,", 1) for line in tracked.poses]
    del tracked.poses[1:9]  # the straight moves
    column = tracked.poses[0].split(",").index("kind")
    for k, line in enumerate(tracked.poses):
        words = line.split(",")
        del words[column]
        tracked.poses[k] = ",".join(words)
    ingested = ingest(tracked)
    poses = ingested.observations
    assert sorted(set(poses.pose[poses.kind == "holdout"])) == sorted(held_out)
    assert not set(poses.pose[poses.kind == "grid"]) & set(held_out)
    assert not any("line_" in note for note in ingested.notes)  # of no use to this instrument


@pytest.mark.parametrize("rule", ["every: 500", "last_fraction: 0.001"])
def test_a_rule_that_holds_out_nothing_is_a_warning(tracked, rule):
    key, value = rule.split(": ")
    tracked.description["holdout"] = {key: json.loads(value)}
    tracked.poses[:] = [line.replace("holdout,", "grid,", 1) for line in tracked.poses]
    (warning,) = ingest(tracked).warnings
    assert warning.startswith(f"no pose is held out: holdout {{{rule}}} of campaign.yaml")


def test_repeats_under_labels_of_their_own_are_a_warning(tmp_path):
    folder = simulated(
        tmp_path / "c", "irb120", "points", poses=12, repeats=3, repeat_every=1, holdout_share=0.0
    )
    assert not any("label" in warning for warning in read_campaign(folder).warnings)
    table = pd.read_csv(folder / "poses.csv")
    rows = table.groupby(["pose", "repeat"], sort=False).ngroup()
    table["pose"], table["repeat"] = [f"Q{k:03d}" for k in rows], 1
    table.to_csv(folder / "poses.csv", index=False)
    (warning,) = read_campaign(folder).warnings
    assert warning.startswith(f"{rows.nunique() - 12} calibration readings are at joint positions")
    assert "and 0 are repeats by their labels" in warning


def test_refuses_to_hold_out_all_poses(tracked):
    tracked.description["holdout"] = {"last_fraction": 0.99}
    tracked.poses[:] = [line.replace("holdout,", "grid,", 1) for line in tracked.poses]
    says = r"holdout.last_fraction: all poses are held out.*got 0.99.*last_fraction: 0.3"
    with pytest.raises(Pa10calError, match=says):
        ingest(tracked)


def test_refuses_two_statements_of_what_is_held_out(tracked):
    tracked.description["holdout"] = {"every": 3}
    with pytest.raises(Pa10calError, match=r"holdout: .*both here and in the rows"):
        ingest(tracked)


def test_repeatability_is_the_deviation_of_position_within_a_pose(tracked):
    poses = ingest(tracked).calibration
    assert repeatability_mm(poses) == pytest.approx({0.0: 0.0, 22.0: 0.0}, abs=1e-6)
    T = poses.measured.T_instr_target.copy()
    T[(poses.repeat == 2) & (poses.states.load_N == 22), 2, 3] += 2e-5
    moved = poses.with_measured(T_instr_target=T)
    assert repeatability_mm(moved) == pytest.approx({0.0: 0.0, 22.0: 0.02 / 2**0.5}, abs=1e-6)


def spoil_numbers(lines):
    """A row that cannot be read is of its configuration all the same; an exact repeat is none."""
    lines[3] = lines[3].replace(lines[3].split(",")[5], "x")
    lines.append(lines[5])


def measure_again(lines):
    """A reading that failed counts once with the one that took its place."""
    lines.append(lines[3])
    replace(lines, len(lines) - 1, "time_s", "9999.0")
    replace(lines, 3, "x_mm", "")


def cut(lines):
    del lines[30:]


MISSING = (
    "poses.csv has 29 of the 34 configurations that campaign.yaml states: 5 are missing, and the "
    "log seems cut short"
)
BEYOND = (
    "poses.csv has 34 configurations, and campaign.yaml states 30: correct that number, or remove "
    "rows of another campaign"
)


@pytest.mark.parametrize(
    ("stated", "spoil", "said"),
    [
        (None, cut, ()),
        (34, list, ()),
        (34, spoil_numbers, ()),
        (34, measure_again, ()),
        (34, cut, (MISSING,)),
        (30, list, (BEYOND,)),
    ],
)
def test_a_log_is_counted_against_what_the_campaign_states(tracked, stated, spoil, said):
    if stated is not None:
        tracked.description["configurations"] = stated
    spoil(tracked.poses)
    assert ingest(tracked).warnings == said


def test_loads_of_one_name_are_one(tracked):
    column = tracked.poses[0].split(",").index("load_N")
    for k in range(1, len(tracked.poses)):
        if float(tracked.poses[k].split(",")[column]) == 0.0:
            replace(tracked.poses, k, "load_N", ("-0.0", "0")[k % 2])
        else:
            replace(tracked.poses, k, "load_N", ("22.000001", "21.999999")[k % 2])
    found = ingest(tracked).observations
    loads_N = found.states.load_N
    assert sorted(set(map(str, loads_N))) == ["0.0", "22.0"]
    pose = found.pose[loads_N == 22.0][0]
    tracked.description["exclude"] = [{"where": f"pose {pose}, 22.000001 N", "why": "bumped"}]
    excluded = [row.reason for row in ingest(tracked).quarantined]
    assert set(excluded) == {"excluded: bumped"}
    assert len(excluded) == ((found.pose == pose) & (loads_N == 22.0)).sum()


def test_temperatures_that_some_rows_lack_are_told(tracked):
    with_columns(tracked.poses, {"temperature_C": 22.5})
    replace(tracked.poses, 3, "temperature_C", "")
    assert "temperature_C is blank in 1 of 34 rows" in ingest(tracked).notes


def test_logged_torques_of_an_arm_with_a_follower_are_told_to_be_unused():
    rows = [{"a_m": 0.3, "alpha_deg": 90.0}, {"a_m": 0.5}, {"a_m": 0.4, "alpha_deg": -90.0}]
    follows = [{"joint": 3, "by": 2, "factor": 1, "follows": True}]
    arm = parse_arm({"name": "mine", "rows": rows, "coupling": follows}, where="mine.yaml")
    tau_Nm = arm.coupling.beside_joints(np.ones((4, 2)))
    (said,) = notes_on_torques(dataclasses.replace(at_rest(np.zeros((4, 3))), tau_Nm=tau_Nm), arm)
    assert said == "logged torques are not used: there is none of joint 3 (follows: true)"


def test_touches_are_counted_likewise(raw_campaign):
    raw_campaign.description["configurations"] = 36
    (said,) = ingest(raw_campaign).warnings
    assert said.startswith("cmm.csv has 34 of the 36 configurations")


def test_rows_without_times_are_read_in_full_and_in_their_order(tracked):
    timed = ingest(tracked).observations
    column = tracked.poses[0].split(",").index("time_s")
    tracked.poses[:] = [
        ",".join(field for k, field in enumerate(line.split(",")) if k != column)
        for line in tracked.poses
    ]
    ingested = ingest(tracked)
    found = ingested.observations
    assert list(found.pose) == list(timed.pose)
    np.testing.assert_array_equal(found.states.q_rad, timed.states.q_rad)
    assert (np.diff(found.states.time_s) > 0.0).all()
    assert timed.states.tells_time
    assert not found.states.tells_time
    assert sum("time was not recorded" in note for note in ingested.notes) == 1


def test_a_campaign_may_say_that_its_times_are_none(tracked):
    tracked.description["time_recorded"] = False
    ingested = ingest(tracked)
    assert not ingested.observations.states.tells_time
    assert sum("time was not recorded" in note for note in ingested.notes) == 1
