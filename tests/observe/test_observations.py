"""What each instrument saw, read back from the table of poses."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import UNCERTAINTY_MM, sighted
from pa10cal.campaign.table import read_observations, read_pose_table, write_pose_table
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import average_repeats, poses_of
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose, Touched
from spoiling import ingest, replace

U_M = 1e-3 * UNCERTAINTY_MM


def every_of(raw, tmp_path):
    """Ingest, write the table, read it back: every single reading."""
    campaign, path = ingest(raw), tmp_path / "poses.parquet"
    write_pose_table(path, campaign.observations, campaign.arm.prismatic, campaign.name)
    return read_observations(path, campaign.description)


def averaged(every):
    """Return the averaged poses to fit."""
    return average_repeats(every.of_kind("grid"))


def rows_of(raw, found):
    """Return the rows of the raw file that single sightings come from, by their times."""
    return np.round(found.states.time_s / 10).astype(int)


def test_poses_are_those_of_the_table_with_the_instruments_covariance(tmp_path):
    raw = sighted(tmp_path, "pose", repeats=3)
    every = every_of(raw, tmp_path)
    single = every.of_kind("grid")
    assert isinstance(single.measured, Pose)
    assert len(single) == 32 * 3
    rows = rows_of(raw, single)
    np.testing.assert_allclose(single.measured.T_instr_target, raw.T_instr_target[rows], atol=1e-8)
    np.testing.assert_allclose(single.states.q_rad, raw.q[rows], atol=1e-9)
    np.testing.assert_allclose(np.diag(single.measured.cov[0])[:3], U_M**2)
    mean = averaged(every)
    assert len(mean) == 32
    np.testing.assert_array_equal(mean.readings, 3)
    np.testing.assert_allclose(3.0 * mean.measured.cov, single.measured.cov[::3], rtol=1e-9)
    assert len(average_repeats(every.of_kind("holdout"))) == 8
    assert len(every.of_kind("line_x")) == 0


def test_touched_balls_give_the_end_effector(raw_campaign, tmp_path):
    raw_campaign.write()
    every = every_of(raw_campaign, tmp_path)
    found, expected = averaged(every), poses_of(every, covariance="instrument")
    assert isinstance(found.measured, Touched)
    assert found.measured.balls.names == ("A", "B", "C")
    np.testing.assert_array_equal(found.measured.T_instr_target, expected.measured.T_instr_target)
    np.testing.assert_array_equal(found.measured.cov, expected.measured.cov)
    np.testing.assert_array_equal(found.states.tau_Nm, expected.states.tau_Nm)


def test_points_keep_what_was_not_seen(tmp_path):
    raw = sighted(tmp_path, "points", repeats=2)
    every = every_of(raw, tmp_path)
    single = every.of_kind("grid")
    assert isinstance(single.measured, Points)
    assert single.measured.names == ("T1", "T2", "T3")
    assert single.measured.p_ee_stated_m is None
    rows = rows_of(raw, single)
    np.testing.assert_allclose(single.measured.p_instr_m, raw.p_instr_m[rows], atol=1e-9)
    unseen = np.isnan(raw.p_instr_m[rows][..., 0])
    assert unseen.any()
    np.testing.assert_array_equal(np.isnan(single.measured.cov_m2[..., 0, 0]), unseen)
    given = single.measured.cov_m2[~unseen]
    np.testing.assert_allclose(given, np.broadcast_to(U_M**2 * np.eye(3), given.shape))


def test_a_target_is_averaged_over_the_repeats_in_which_it_was_seen(tmp_path):
    raw = sighted(tmp_path, "points", repeats=3, noise_mm=0.5)
    every = every_of(raw, tmp_path)
    mean = averaged(every)
    assert len(mean) == 32
    np.testing.assert_array_equal(mean.readings, 3)
    each = raw.p_instr_m.reshape(3, 40, 3, 3)
    times = np.isfinite(each[..., 0]).sum(axis=0)
    assert set(times.ravel()) >= {1, 2, 3}
    labels = np.array([int(label[1:]) for label in mean.pose])
    for k, p in enumerate(labels):
        for b in range(3):
            if times[p, b] == 0:
                assert np.isnan(mean.measured.p_instr_m[k, b]).all()
                assert np.isnan(mean.measured.cov_m2[k, b]).all()
                continue
            expected = np.nanmean(each[:, p, b], axis=0)
            np.testing.assert_allclose(mean.measured.p_instr_m[k, b], expected, atol=1e-9)
            np.testing.assert_allclose(
                mean.measured.cov_m2[k, b], U_M**2 / times[p, b] * np.eye(3), rtol=1e-9
            )


def test_stated_places_are_those_of_the_targets_seen(tmp_path):
    raw = sighted(tmp_path, "points", targets=2)
    raw.description["tool"]["balls_mm"] = {"T2": [1, 2, 3], "T1": [4, 5, 6], "T9": [0, 0, 0]}
    every = every_of(raw, tmp_path)
    seen = averaged(every).measured
    np.testing.assert_allclose(seen.p_ee_stated_m, [[4e-3, 5e-3, 6e-3], [1e-3, 2e-3, 3e-3]])
    del raw.description["tool"]["balls_mm"]["T1"]
    assert averaged(every_of(raw, tmp_path)).measured.p_ee_stated_m is None


def test_distances_are_averaged_with_their_uncertainties(tmp_path):
    raw = sighted(tmp_path, "distance", repeats=2, noise_mm=0.5)
    raw.poses[0] += ",u_d_mm"
    raw.poses[1:] = [line + (",0.03" if k < 40 else ",") for k, line in enumerate(raw.poses[1:])]
    every = every_of(raw, tmp_path)
    single = every.of_kind("grid")
    assert isinstance(single.measured, Distance)
    rows = rows_of(raw, single)
    np.testing.assert_allclose(single.measured.d_m, raw.d_m[rows], atol=1e-9)
    np.testing.assert_allclose(single.measured.u_m, np.where(rows < 40, 3e-5, U_M))
    mean = averaged(every)
    np.testing.assert_allclose(mean.measured.d_m, raw.d_m.reshape(2, 40).mean(axis=0)[rows[::2]])
    np.testing.assert_allclose(mean.measured.u_m, np.hypot(3e-5, U_M) / 2)


def test_the_position_of_a_joint_that_slides_is_in_metres(tmp_path):
    raw = sighted(tmp_path, "points", robot="gx4_351s")
    every = every_of(raw, tmp_path)
    names = ["q1_rad", "q2_rad", "q3_m", "q4_rad", "q1_u_rad", "q2_u_rad", "q3_u_m", "q4_u_rad"]
    table = read_pose_table(tmp_path / "poses.parquet")
    assert [name for name in table.columns if name.startswith("q")] == names
    found = averaged(every)
    np.testing.assert_allclose(found.states.q_rad, raw.q[rows_of(raw, found)], atol=1e-9)


@pytest.mark.parametrize("kind", ["points", "distance"])
def test_the_pose_of_an_end_effector_that_was_not_seen_is_refused(tmp_path, kind):
    every = every_of(sighted(tmp_path, kind), tmp_path)
    table = read_pose_table(tmp_path / "poses.parquet")
    assert not [name for name in table.columns if name.startswith("ee_")]
    with pytest.raises(RawDataError, match=rf"{kind}: .*does not measure .*general model"):
        poses_of(every)


def test_a_label_read_twice_is_one_pose_whatever_the_joints_do_within_it(tmp_path):
    raw = sighted(tmp_path, "distance", poses=20)
    replace(raw.poses, 1, "pose", "P099")
    raw.poses[2] = raw.poses[1].replace("0,grid", "15,grid", 1).replace(",1,", ",2,", 1)
    replace(raw.poses, 2, "d_mm", f"{1e3 * raw.d_m[0] + 1:.6f}")
    every = every_of(raw, tmp_path)
    found = averaged(every)
    at = list(found.pose).index("P099")
    assert found.readings[at] == 2
    assert found.measured.d_m[at] == pytest.approx(raw.d_m[0] + 5e-4, abs=1e-9)
