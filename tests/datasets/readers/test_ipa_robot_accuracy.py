"""The UR10 data set: a made-up folder of its layout, and the real one where there is a copy."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_datasets import REPEAT, REPEATED, ROWS, SERIES_A, SERIES_C, edit, ur10_poses, write_ipa
from pa10cal.arm.chain import Chain
from pa10cal.campaign.read import read_campaign
from pa10cal.datasets.campaign_folder import write_campaigns
from pa10cal.datasets.catalogue import dataset_named
from pa10cal.datasets.readers.ipa_robot_accuracy import DATASET, read
from pa10cal.errors import RawDataError
from pa10cal.files.arms import load_arm
from pa10cal.frame.rigid_fit import fit_rigid

Q = [f"q{j}_deg" for j in range(1, 7)]
ATTITUDE = ["qw", "qx", "qy", "qz"]


@pytest.fixture
def folder(tmp_path):
    return write_ipa(tmp_path / "ipa")


def ingested(campaign, folder):
    (place,) = write_campaigns([campaign], folder)
    return read_campaign(place)


@pytest.mark.parametrize("which", [0, 1])
def test_commands_and_measured_poses_come_out_as_they_went_in(folder, which):
    q_rad, T_mm = ur10_poses()
    campaign = read(folder, 0.2)[which]
    poses = campaign.poses
    np.testing.assert_allclose(np.radians(poses[Q]), q_rad, atol=1e-12)
    np.testing.assert_allclose(poses[["x_mm", "y_mm", "z_mm"]], T_mm[:, :3, 3], atol=1e-6)
    R = Rotation.from_quat(poses[ATTITUDE], scalar_first=True).as_matrix()
    np.testing.assert_allclose(R, T_mm[:, :3, :3], atol=1e-8)
    assert (poses["qw"] >= 0).all()
    np.testing.assert_allclose(poses["temperature_C"], 23.0 + 0.1 * np.arange(ROWS))
    assert campaign.reference_temperature_C == pytest.approx(23.45)
    assert campaign.left_out == ()


def test_a_command_again_is_a_repeat_and_the_rest_is_in_order(folder):
    for campaign in read(folder, 0.2):
        labels = list(campaign.poses["pose"])
        assert labels[REPEAT] == labels[REPEATED] == "P00003"
        assert campaign.poses["repeat"][REPEAT] == 2
        assert len(set(labels)) == ROWS - 1
        assert campaign.notes == ("10 readings, 1 of them repeats",)


def test_time_is_that_of_the_stamps_and_rows_are_put_in_its_order(folder):
    edit(folder / SERIES_A, 4, "Timestamp", "20200715163904")
    a, c = read(folder, 0.2)
    expected = [0.0, 5.0, *np.arange(15.0, 46.0, 5.0), 86400.0]
    np.testing.assert_array_equal(a.poses["time_s"], expected)
    q_rad, _ = ur10_poses()
    np.testing.assert_allclose(np.radians(a.poses[Q])[9:], q_rad[[2]])
    np.testing.assert_array_equal(c.poses["time_s"], np.arange(10.0))
    assert "time_s is the number of the row" in c.provenance
    assert "time_s counts from the first time stamp" in a.provenance


def test_deviations_become_uncertainties_where_they_are_given(folder):
    a, c = read(folder, 0.2)
    assert not [name for name in a.poses.columns if name.startswith("u_")]
    assert a.uncertainty_mm == 0.02
    std = 0.001 * (1 + np.arange(ROWS)[:, None] + np.arange(3))
    np.testing.assert_allclose(c.poses[["u_x_mm", "u_y_mm", "u_z_mm"]], std)
    assert c.uncertainty_mm == pytest.approx(np.sqrt((std**2).mean()), abs=5e-5)
    assert "not divided by the root of their number" in c.provenance


def test_uncertainty_of_an_attitude_is_what_drawn_angles_scatter_by(folder):
    _, c = read(folder, 0.2)
    rng = np.random.default_rng(3)
    for k in (0, 4, 7):
        R = Rotation.from_quat(c.poses.loc[k, ATTITUDE].to_numpy(dtype=float), scalar_first=True)
        angles = R.as_euler("XYZ", degrees=True)
        std = 0.001 * (1 + k + np.arange(3, 6))
        drawn = Rotation.from_euler("XYZ", rng.normal(angles, std, (40_000, 3)), degrees=True)
        q = drawn.as_quat(scalar_first=True)
        q *= np.sign(q @ R.as_quat(scalar_first=True))[:, None]
        stated = c.poses.loc[k, [f"u_{name}" for name in ATTITUDE]].to_numpy(dtype=float)
        np.testing.assert_allclose(q.std(axis=0), stated, rtol=0.02)


def test_a_deviation_of_nothing_is_not_stated(folder):
    edit(folder / SERIES_C, 3, "measurement_std_y", "0")
    edit(folder / SERIES_C, 4, "measurement_std_rz", "")
    _, c = read(folder, 0.2)
    assert list(np.flatnonzero(c.poses["u_y_mm"].isna())) == [1]
    assert list(np.flatnonzero(c.poses["u_qw"].isna())) == [2]
    assert c.left_out == ()


@pytest.mark.parametrize(
    ("column", "text", "reason"),
    [
        ("Timestamp", "20201332250000", "the time stamp is no time"),
        ("Timestamp", "noon", "not a finite number"),
        ("measurement_temperature", "", "not a finite number"),
        ("measurement_rx", "NaN", "not a finite number"),
        ("elbow_joint", "1.25", "not a finite number"),
        ("elbow_joint", "12,5", "a joint angle beyond one turn"),
    ],
)
def test_a_row_that_cannot_be_used_is_listed(folder, column, text, reason):
    edit(folder / SERIES_A, 5, column, text)
    a, c = read(folder, 0.2)
    assert [(row.file, row.line, row.reason) for row in a.left_out] == [(SERIES_A, 5, reason)]
    assert len(a.poses) == ROWS - 1
    assert c.left_out == ()


def test_too_many_such_rows_are_refused(folder):
    for line in (3, 5, 6):
        edit(folder / SERIES_A, line, "wrist_3_joint", "?")
    with pytest.raises(RawDataError, match=r"3 of 10 rows would be quarantined, .*not a finite"):
        read(folder, 0.2)


def test_angles_in_degrees_are_noticed(folder):
    for line in range(2, ROWS + 2):
        edit(folder / SERIES_C, line, "shoulder_pan_joint", f"-12{line},5")
    with pytest.raises(RawDataError, match=r"random_poses\.csv:2: .*look like degrees .*122\.5"):
        read(folder, 0.2)


def test_the_last_thirty_percent_are_held_out(folder, tmp_path):
    a, _ = read(folder, 0.2)
    poses = ingested(a, tmp_path).observations
    assert list(np.flatnonzero(poses.kind == "holdout")) == [7, 8, 9]  # the last 3 of 9 labels


def test_provenance_says_whose_measurements_these_are(folder):
    for campaign in read(folder, 0.2):
        for words in ("Real measurements", "MIT licence", "Landgraf", DATASET.published.version):
            assert words in campaign.provenance


@pytest.fixture(scope="module")
def real(ipa_data):
    return {campaign.name: campaign for campaign in read(ipa_data, 0.0)}


@pytest.mark.parametrize(("name", "rows"), [("ur10-a", 11911), ("ur10-c", 2773)])
def test_real_series_are_read_whole(real, name, rows):
    campaign = real[name]
    assert len(campaign.poses) == rows
    assert campaign.left_out == ()
    assert campaign.poses["time_s"].is_monotonic_increasing
    assert not campaign.poses.isna().any(axis=None)
    assert list(campaign.poses["pose"]) == sorted(campaign.poses["pose"])


@pytest.mark.parametrize("name", ["ur10-a", "ur10-c"])
def test_real_attitudes_fit_the_nominal_arm_in_this_convention_only(real, name):
    poses = real[name].poses
    T = Chain.of(load_arm("ur10")).forward(np.radians(poses[Q].to_numpy()))
    measured = Rotation.from_quat(poses[ATTITUDE], scalar_first=True)
    angles = measured.as_euler("XYZ", degrees=True)
    p_mm = poses[["x_mm", "y_mm", "z_mm"]].to_numpy()

    def spread_deg(rotation):
        """How far flange and target turn against each other, the base as positions put it."""
        flange_mm = 1e3 * (T[:, :3, 3] + 0.093 * T[:, :3, 2])  # the target sits above the flange
        base = fit_rigid(flange_mm, p_mm)
        tool = Rotation.from_matrix(base.T[:3, :3] @ T[:, :3, :3]).inv() * rotation
        return np.degrees((tool * tool.mean().inv()).magnitude().mean())

    assert spread_deg(measured) < 0.2
    for convention in ("xyz", "ZYX", "YXZ"):
        assert spread_deg(Rotation.from_euler(convention, angles, degrees=True)) > 5.0


@pytest.mark.parametrize("name", ["ur10-a", "ur10-c"])
def test_real_campaigns_are_ingested_whole_and_split_by_time(real, name, tmp_path):
    found = ingested(real[name], tmp_path)
    assert found.quarantined == ()
    kind = found.observations.kind
    rows = len(kind)
    held = round(0.3 * rows)
    assert Counter(kind.tolist()) == {"grid": rows - held, "holdout": held}
    assert (np.diff(found.observations.states.time_s) >= 0).all()
    assert (kind[rows - held :] == "holdout").all()


def test_the_real_files_are_the_pinned_ones(ipa_data):
    from pa10cal.datasets.checksums import differing_files

    dataset = dataset_named("ipa-robot-accuracy")
    sums = {name: dataset.published.sha256[name] for name in dataset.files}
    assert differing_files(ipa_data, sums) == ()
