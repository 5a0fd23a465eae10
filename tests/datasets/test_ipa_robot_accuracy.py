"""The UR10 data set: a made-up folder of its layout, and the real one where there is a copy."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_datasets import REPEAT, REPEATED, ROWS, SERIES_A, SERIES_C, edit, ur10_poses, write_ipa
from pa10cal.arm.chain import Chain
from pa10cal.campaign.read import read_campaign
from pa10cal.datasets.importing import write_campaigns
from pa10cal.datasets.readers import dataset_named
from pa10cal.errors import RawDataError
from pa10cal.frame.point_fits import fit_rigid
from pa10cal.options import IngestOptions

DATASET = dataset_named("ipa-robot-accuracy")
read = DATASET.read
STATED = DATASET.published.stated["campaigns"]
STATED_MM = STATED["ur10-c"]["uncertainty_mm"]
NAMES = {SERIES_A: "measurements_grid.csv", SERIES_C: "measurements_random_poses.csv"}


@pytest.fixture
def folder(tmp_path):
    return write_ipa(tmp_path / "ipa")


def campaigns(folder):
    """Import both series, and read them as any campaign."""
    places = write_campaigns(read(folder, 0.2), folder.parent / "raw")
    return [read_campaign(place, IngestOptions(max_quarantined_fraction=0.3)) for place in places]


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_commands_and_measured_poses_come_out_as_they_went_in(folder, which):
    q_rad, T_mm = ur10_poses()
    found = campaigns(folder)[which]
    poses = found.observations
    np.testing.assert_allclose(poses.states.q_rad, q_rad, atol=1e-12)
    T = poses.measured.T_instr_target
    np.testing.assert_allclose(1e3 * T[:, :3, 3], T_mm[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(T[:, :3, :3], T_mm[:, :3, :3], atol=1e-8)
    np.testing.assert_allclose(poses.states.temperature_C, 23.0 + 0.1 * np.arange(ROWS))
    assert found.quarantined == ()


def test_the_file_of_a_campaign_is_the_one_that_was_published(folder):
    for place, file in zip(
        write_campaigns(read(folder, 0.2), folder.parent / "raw"), NAMES, strict=True
    ):
        assert (place / NAMES[file]).read_bytes() == (folder / file).read_bytes()


def test_a_command_again_is_a_repeat_and_the_rest_is_in_order(folder):
    for found in campaigns(folder):
        poses = found.observations
        assert poses.pose[REPEAT] == poses.pose[REPEATED] == "P00003"
        assert poses.repeat[REPEAT] == 2
        assert len(set(poses.pose)) == ROWS - 1


def test_time_is_that_of_the_stamps_and_rows_are_put_in_its_order(folder):
    edit(folder / SERIES_A, 4, "Timestamp", "20200715163904")
    a, c = campaigns(folder)
    expected = [0.0, 5.0, *np.arange(15.0, 46.0, 5.0), 86400.0]
    np.testing.assert_array_equal(a.observations.states.time_s, expected)
    q_rad, _ = ur10_poses()
    np.testing.assert_allclose(a.observations.states.q_rad[9:], q_rad[[2]])
    np.testing.assert_array_equal(c.observations.states.time_s, np.arange(10.0))
    assert "time_s is the number of the row" in c.description.provenance
    assert "time_s counts from the first time stamp" in a.description.provenance


def test_deviations_become_uncertainties_where_they_are_given(folder):
    a, c = campaigns(folder)
    assert a.description.instrument.uncertainty_mm == 0.02
    np.testing.assert_allclose(a.observations.measured.cov[:, 0, 0], 2e-5**2)
    std = 0.001 * (1 + np.arange(ROWS)[:, None] + np.arange(3))
    u_mm = 1e3 * np.sqrt(np.diagonal(c.observations.measured.cov, axis1=1, axis2=2)[:, :3])
    np.testing.assert_allclose(u_mm, std)
    assert "not divided by the root of their number" in c.description.provenance


def test_a_deviation_of_nothing_is_not_stated(folder):
    edit(folder / SERIES_C, 3, "measurement_std_y", "0")
    edit(folder / SERIES_C, 4, "measurement_std_rz", "")
    _, c = campaigns(folder)
    cov = c.observations.measured.cov
    np.testing.assert_allclose(cov[1, 1, 1], (1e-3 * STATED_MM) ** 2)
    np.testing.assert_allclose(cov[2, 3:, 3:], (1e-3 * STATED_MM / 0.1) ** 2 * np.eye(3))
    assert c.quarantined == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "text", "reason"),
    [
        ("Timestamp", "20201332250000", "not a finite number"),
        ("Timestamp", "noon", "not a finite number"),
        ("measurement_rx", "NaN", "not a finite number"),
        ("elbow_joint", "1.25", "not a finite number"),
        ("elbow_joint", "12,5", "beyond the limits of joint 3"),
    ],
)
def test_a_row_that_cannot_be_used_is_listed(folder, column, text, reason):
    edit(folder / SERIES_A, 5, column, text)
    a, c = campaigns(folder)
    (row,) = a.quarantined
    assert (row.file, row.line) == (NAMES[SERIES_A], 5)
    assert row.reason.startswith(reason)
    assert row.value.startswith(f"{column} = ")
    assert len(a.observations) == ROWS - 1
    assert c.quarantined == ()


def test_too_many_such_rows_are_refused(folder):
    for line in (3, 5, 6, 7):
        edit(folder / SERIES_A, line, "wrist_3_joint", "?")
    with pytest.raises(RawDataError, match=r"4 of 10 rows would be quarantined, .*wrist_3_joint"):
        campaigns(folder)


def test_angles_in_degrees_are_noticed(folder):
    for line in range(2, ROWS + 2):
        edit(folder / SERIES_C, line, "shoulder_pan_joint", f"-12{line},5")
    with pytest.raises(RawDataError, match=r"random_poses\.csv:2: .*beyond the limits of joint 1"):
        campaigns(folder)


@pytest.mark.slow
def test_the_last_thirty_percent_are_held_out(folder):
    a, _ = campaigns(folder)
    kinds = a.observations.kind
    assert list(np.flatnonzero(kinds == "holdout")) == [7, 8, 9]  # the last 3 of 9 labels


def test_provenance_says_whose_measurements_these_are(folder):
    for campaign in read(folder, 0.2):
        for words in ("Real measurements", "MIT licence", "Landgraf", DATASET.published.version):
            assert words in campaign.provenance


@pytest.fixture(scope="module")
def real(ipa_data, tmp_path_factory):
    places = write_campaigns(read(ipa_data, 0.0), tmp_path_factory.mktemp("raw"))
    return {place.name: read_campaign(place) for place in places}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rows"), [("ur10-a", 11911), ("ur10-c", 2773)])
def test_real_series_are_read_whole(real, name, rows):
    campaign = real[name]
    poses = campaign.observations
    assert len(poses) == rows
    assert campaign.quarantined == ()
    assert (np.diff(poses.states.time_s) >= 0).all()
    assert list(poses.pose) == sorted(poses.pose)
    assert poses.states.temperature_C.mean() == pytest.approx(
        STATED[name]["reference_temperature_C"], abs=6e-4
    )
    if name == "ur10-c":
        u_mm = 1e3 * np.sqrt(np.diagonal(poses.measured.cov, axis1=1, axis2=2)[:, :3])
        assert np.sqrt(np.mean(u_mm**2)) == pytest.approx(STATED_MM, abs=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur10-a", "ur10-c"])
def test_real_attitudes_fit_the_nominal_arm_in_this_convention_only(real, name):
    campaign = real[name]
    poses = campaign.observations
    T = Chain.of(campaign.arm).forward(poses.states.q_rad)
    T_instr_target = poses.measured.T_instr_target
    measured = Rotation.from_matrix(T_instr_target[:, :3, :3])
    angles = measured.as_euler("XYZ", degrees=True)
    p_mm = 1e3 * T_instr_target[:, :3, 3]

    def spread_deg(rotation):
        """How far flange and target turn against each other, the base as positions put it."""
        flange_mm = 1e3 * (T[:, :3, 3] + 0.093 * T[:, :3, 2])  # the target sits above the flange
        base = fit_rigid(flange_mm, p_mm)
        tool = Rotation.from_matrix(base.T[:3, :3] @ T[:, :3, :3]).inv() * rotation
        return np.degrees((tool * tool.mean().inv()).magnitude().mean())

    assert spread_deg(measured) < 0.2
    for convention in ("xyz", "ZYX", "YXZ"):
        assert spread_deg(Rotation.from_euler(convention, angles, degrees=True)) > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur10-a", "ur10-c"])
def test_real_campaigns_are_split_by_time(real, name):
    kind = real[name].observations.kind
    rows = len(kind)
    held = round(0.3 * rows)
    assert Counter(kind.tolist()) == {"grid": rows - held, "holdout": held}
    assert (kind[rows - held :] == "holdout").all()


def test_the_real_files_are_the_pinned_ones(ipa_data):
    from pa10cal.datasets.fetching import differing_files

    dataset = DATASET
    sums = {name: dataset.published.sha256[name] for name in dataset.files}
    assert differing_files(ipa_data, sums) == ()
