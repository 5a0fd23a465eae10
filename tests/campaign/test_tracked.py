"""Campaigns of an instrument that gives poses directly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.campaign.description import read_campaign
from pa10cal.campaign.ingest import ingest_campaign, repeatability_mm
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from pa10cal.settings import IngestSettings


@pytest.fixture
def tracked(raw_campaign):
    """The made-up campaign as a tracker would have given it."""
    raw_campaign.description["instrument"]["kind"] = "pose"
    raw_campaign.description["files"] = {"poses": "poses.csv"}
    del raw_campaign.description["ball_diameter_mm"]
    del raw_campaign.description["tool"]["balls_mm"]
    return raw_campaign


def ingest(raw):
    folder = raw.write()
    campaign = read_campaign(folder)
    return ingest_campaign(campaign, load_arm(campaign.robot), folder, IngestSettings())


def with_columns(lines, columns):
    """Append columns of one value each."""
    values = ",".join(str(value) for value in columns.values())
    lines[:] = [",".join([lines[0], *columns]), *(f"{line},{values}" for line in lines[1:])]


def test_poses_come_out_as_they_went_in(tracked):
    ingested = ingest(tracked)
    poses = ingested.poses
    assert ingested.left_out == ()
    assert list(poses.pose) == [key[1] for key in tracked.keys]
    expected = np.array(tracked.T_cmm_ee)
    expected[:, :3, 3] *= 1e3
    np.testing.assert_allclose(poses.T_cmm_ee_mm, expected, atol=2e-6)
    np.testing.assert_allclose(poses.q_rad, tracked.q_rad, atol=1e-8)
    assert np.isnan(poses.tau_Nm).all()
    assert np.isnan(poses.temperature_C).all()
    assert not poses.arrival.any()
    assert poses.p_cmm_balls_mm.shape == (34, 0, 3)


def test_what_is_stated_is_taken_and_what_is_not_follows_from_the_instrument(tracked):
    plain = ingest(tracked).poses.cov_ee_mm
    np.testing.assert_allclose(plain[7], np.diag([0.005**2] * 3 + [5e-5**2] * 3), rtol=1e-9)
    with_columns(tracked.poses, {"u_x_mm": 0.02, "tau2_Nm": -40.0, "temperature_C": 22.5})
    poses = ingest(tracked).poses
    np.testing.assert_allclose(poses.cov_ee_mm[:, 0, 0], 0.02**2)
    np.testing.assert_allclose(poses.cov_ee_mm[:, 1, 1], 0.005**2)
    assert (poses.tau_Nm[:, 1] == -40.0).all()
    assert np.isnan(poses.tau_Nm[:, 0]).all()
    assert (poses.temperature_C == 22.5).all()


def test_uncertainty_of_the_quaternion_is_that_of_a_small_rotation_on_the_left(tracked):
    u = [1e-4, 2e-4, 3e-4, 4e-4]
    with_columns(tracked.poses, dict(zip(("u_qw", "u_qx", "u_qy", "u_qz"), u, strict=True)))
    poses = ingest(tracked).poses
    R = Rotation.from_matrix(poses.T_cmm_ee_mm[3, :3, :3])
    drawn = R.as_quat(scalar_first=True) + np.random.default_rng(1).normal(0, u, (40_000, 4))
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    turns = (Rotation.from_quat(drawn, scalar_first=True) * R.inv()).as_rotvec()
    np.testing.assert_allclose(np.cov(turns.T), poses.cov_ee_mm[3, 3:, 3:], atol=4e-9)


def test_bad_rows_are_listed(tracked):
    tracked.poses[5] = tracked.poses[5].replace(",0.", ",0.x", 1)
    tracked.poses.append(tracked.poses[9])
    again = tracked.poses[10].split(",")
    tracked.poses.append(",".join(["5000.0", *again[1:]]))
    words = tracked.poses[12].split(",")
    words[-4:] = ["0.5", "0", "0", "0"]
    tracked.poses[12] = ",".join(words)
    ingested = ingest(tracked)
    assert [(row.line, row.reason) for row in ingested.left_out] == [
        (6, "not a finite number"),
        (13, "the quaternion is not of unit length"),
        (36, "repeats an earlier row"),
        (37, "this configuration was read before"),
    ]
    assert len(ingested.poses) == 32


def test_radians_are_noticed(tracked):
    for k, line in enumerate(tracked.poses[1:], start=1):
        words = line.split(",")
        words[5:11] = [str(np.radians(float(word))) for word in words[5:11]]
        tracked.poses[k] = ",".join(words)
    with pytest.raises(Pa10calError, match=r"poses.csv: q1_deg … q6_deg: .*look like radians"):
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
    poses = ingested.poses
    assert sorted(set(poses.pose[poses.kind == "holdout"])) == sorted(held_out)
    assert not set(poses.pose[poses.kind == "grid"]) & set(held_out)
    assert "no line_x rows" in ingested.notes


def test_refuses_two_statements_of_what_is_held_out(tracked):
    tracked.description["holdout"] = {"every": 3}
    with pytest.raises(Pa10calError, match=r"holdout: .*both here and in the rows"):
        ingest(tracked)


def test_repeatability_is_the_deviation_of_position_within_a_pose(tracked):
    poses = ingest(tracked).poses
    assert repeatability_mm(poses) == pytest.approx({0.0: 0.0, 22.0: 0.0}, abs=1e-6)
    shifted = poses.T_cmm_ee_mm.copy()
    second = (poses.kind == "grid") & (poses.repeat == 2) & (poses.load_N == 22)
    shifted[second, 2, 3] += 0.02
    moved = poses.take(np.arange(len(poses)))
    object.__setattr__(moved, "T_cmm_ee_mm", shifted)
    assert repeatability_mm(moved) == pytest.approx({0.0: 0.0, 22.0: 0.02 / 2**0.5}, abs=1e-6)
