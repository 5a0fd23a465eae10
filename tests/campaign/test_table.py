"""The table of poses: written the same, read back, averaged with the scatter of repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest, measured_poses
from pa10cal.campaign.table import SCHEMA, read_observations, read_pose_table, write_pose_table
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import poses_of
from spoiling import ingest

ARMS, AXES = 6, "xyz"


@pytest.fixture(scope="module")
def campaign(made_up_campaign, tmp_path_factory):
    """Return a campaign as it is read; no test changes it."""
    return ingest(replace(made_up_campaign, folder=tmp_path_factory.mktemp("table") / "made-up"))


@pytest.fixture
def every(campaign, tmp_path):
    written(campaign.observations, tmp_path / "every.parquet", campaign.name)
    return read_observations(tmp_path / "every.parquet", campaign.description)


@pytest.fixture
def table(campaign, tmp_path):
    written(campaign.observations, tmp_path / "poses.parquet", "made-up")
    return read_pose_table(tmp_path / "poses.parquet")


def written(every, path, name="made-up"):
    write_pose_table(path, every, np.zeros(ARMS, dtype=bool), name)


def made_up_poses(repeats, scatter_ee, rng, poses=40):
    """Poses whose readings scatter about a mean by a known covariance along the tool's axes."""
    root = np.linalg.cholesky(scatter_ee)
    count = poses * repeats
    R = np.repeat(Rotation.random(poses, random_state=rng).as_matrix(), repeats, axis=0)
    place = np.repeat(rng.uniform(-0.5, 0.5, (poses, 3)), repeats, axis=0)
    error = rng.normal(size=(count, 6)) @ root.T
    T = np.tile(np.eye(4), (count, 1, 1))
    turn = (R @ error[:, 3:, None])[..., 0]
    T[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix() @ R
    T[:, :3, 3] = place + (R @ error[:, :3, None])[..., 0]
    states = at_rest(
        rng.normal(size=(count, ARMS)),
        tau_Nm=rng.normal(size=(count, ARMS)),
        arrival=np.sign(rng.normal(size=(count, ARMS))),
        temperature_C=np.full(count, 21.0),
        time_s=np.arange(count, dtype=float),
    )
    labels = np.repeat([f"P{k:02d}" for k in range(poses)], repeats)
    return measured_poses(labels, states, T, np.tile(4.0 * scatter_ee, (count, 1, 1)))


def test_the_same_readings_give_the_same_bytes(campaign, tmp_path):
    for name in ("first", "second"):
        written(campaign.observations, tmp_path / name)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


def test_columns_are_those_of_the_page_of_results(table):
    expected = ["kind", "pose", "load_N", "repeat", "time_s"]
    for names in ("q{}_rad", "q{}_u_rad", "tau{}_Nm", "tau{}_u_Nm", "s{}"):
        expected += [names.format(j) for j in range(1, 7)]
    expected += ["temperature_C", "dwell_samples"]
    for ball in "ABC":
        expected += [f"ball{ball}_{axis}_mm" for axis in AXES]
        expected += [f"ball{ball}_c{k}_mm2" for k in ("xx", "xy", "xz", "yy", "yz", "zz")]
        expected += [f"ball{ball}_touches"]
    expected += [f"ee_{axis}_mm" for axis in AXES] + ["ee_qw", "ee_qx", "ee_qy", "ee_qz"]
    expected += [f"ee_cov_{i}{j}" for i in range(6) for j in range(i, 6)]
    assert list(table.columns) == expected
    assert table.attrs["campaign"] == "made-up"
    assert (table["ee_qw"] >= 0).all()
    assert table["time_s"].is_monotonic_increasing
    assert not table.isna().to_numpy().any()


def test_poses_are_those_the_touches_were_made_from(every, raw_campaign):
    for kind, expected in (("grid", 12), ("holdout", 2), ("line_x", 4), ("line_y", 4)):
        assert len(poses_of(every, kind)) == expected
    single = poses_of(every, average=False)
    truth = {key: c for c, key in enumerate(raw_campaign.keys) if key[0] == "grid"}
    labels = zip(single.pose, single.states.load_N, strict=True)
    index = [truth["grid", pose, load, 1] for pose, load in labels]
    T = raw_campaign.T_instr_ee[index]
    np.testing.assert_allclose(single.measured.T_instr_target[:, :3, 3], T[:, :3, 3], atol=5e-5)
    turned = single.measured.T_instr_target[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    assert Rotation.from_matrix(turned).magnitude().max() < 2e-4
    np.testing.assert_allclose(single.states.q_rad, raw_campaign.q_rad[index], atol=3e-6)
    np.testing.assert_allclose(single.states.tau_Nm[:, 1], -40.0, atol=0.6)


def test_arrivals_are_those_of_the_approach(table):
    s = table[[f"s{j}" for j in range(1, 7)]].to_numpy()
    rows = np.arange(len(s))[:, None]
    np.testing.assert_array_equal(s, np.where(np.arange(6) % 2 == rows % 2, 1, -1))


def test_averages_are_plain_means_ordered_by_pose_and_load(table, every):
    mean = poses_of(every)
    assert list(mean.pose) == sorted(mean.pose)
    np.testing.assert_array_equal(mean.states.load_N, [0.0, 22.0] * 6)
    np.testing.assert_array_equal(mean.readings, 2)
    rows = table[(table["pose"] == "P03") & (table["load_N"] == 22)]
    place = rows[["ee_x_mm", "ee_y_mm", "ee_z_mm"]].to_numpy()
    T = mean.measured.T_instr_target[5]
    np.testing.assert_allclose(T[:3, 3], 1e-3 * place.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(mean.states.tau_Nm[5, 2], rows["tau3_Nm"].mean())
    R = Rotation.from_quat(rows[["ee_qw", "ee_qx", "ee_qy", "ee_qz"]], scalar_first=True)
    np.testing.assert_allclose(T[:3, :3], R.mean().as_matrix(), atol=1e-9)


def test_a_kind_without_rows_gives_no_poses(every):
    none = poses_of(every.take(every.kind == "grid"), "holdout")
    assert len(none) == 0
    assert none.measured.T_instr_target.shape == (0, 4, 4)
    assert none.measured.cov.shape == (0, 6, 6)


def test_covariance_of_the_mean_is_the_pooled_scatter_in_the_instruments_axes():
    rng = np.random.default_rng(8)
    sigmas = np.array([2e-5, 1e-5, 5e-6, 5e-5, 2e-5, 1e-5])
    correlated = np.eye(6)
    correlated[0, 4] = correlated[4, 0] = 0.6
    scatter = correlated * np.outer(sigmas, sigmas)
    every = made_up_poses(25, scatter, rng)
    mean = poses_of(every)
    R = mean.measured.T_instr_target[7, :3, :3]
    to_ee = np.kron(np.eye(2), R.T)
    found = 25 * to_ee @ mean.measured.cov[7] @ to_ee.T
    np.testing.assert_allclose(found / np.outer(sigmas, sigmas), correlated, atol=0.15)
    single = poses_of(every, average=False)
    np.testing.assert_allclose(single.measured.cov[7 * 25], 25 * mean.measured.cov[7], rtol=1e-2)


def test_covariance_is_the_instruments_where_nothing_is_repeated_or_it_is_asked_for():
    rng = np.random.default_rng(9)
    scatter = np.diag([1e-10, 1e-10, 1e-10, 1e-9, 1e-9, 1e-9])
    stated = 4.0 * scatter
    once = made_up_poses(1, scatter, rng)
    np.testing.assert_allclose(poses_of(once).measured.cov[3], stated)
    thrice = made_up_poses(3, scatter, rng)
    asked = poses_of(thrice, covariance="instrument")
    np.testing.assert_allclose(asked.measured.cov[3], stated / 3)


@pytest.mark.parametrize("content", [None, b"kind,pose\n", b""])
def test_refuses_what_is_no_table(tmp_path, content):
    path = tmp_path / "poses.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RawDataError, match=r"poses.parquet: the table of poses cannot be read"):
        read_pose_table(path)


@pytest.mark.parametrize("name", ["tau6_u_Nm", "q6_rad", "time_s"])
def test_refuses_a_table_that_lacks_a_column(tmp_path, campaign, name):
    path = tmp_path / "poses.parquet"
    written(campaign.observations, path, campaign.name)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns([name]), path)
    with pytest.raises(RawDataError, match=rf"poses.parquet: .*no column {name}.*ingest again"):
        read_observations(path, campaign.description)


def test_refuses_the_table_of_another_campaign(tmp_path, table):
    rng = np.random.default_rng(9)
    poses = made_up_poses(1, np.eye(6) * 1e-9, rng)
    written(poses, tmp_path / "poses.parquet", "one")
    assert read_pose_table(tmp_path / "poses.parquet", "one").attrs["campaign"] == "one"
    with pytest.raises(RawDataError, match=r"poses.parquet: .*\(got 'one'\); .*campaign 'other'"):
        read_pose_table(tmp_path / "poses.parquet", "other")


def test_refuses_another_parquet_file(tmp_path, table):
    table.to_parquet(tmp_path / "other.parquet")
    with pytest.raises(RawDataError, match="schema none"):
        read_pose_table(tmp_path / "other.parquet")


@pytest.mark.parametrize(
    "table",
    [
        pa.Table.from_arrays([pa.array([1.0]), pa.array([2.0])], names=["s1", "s1"]),
        pa.table({"s1": [1.0]}).replace_schema_metadata({b"schema": b"\xff\xfe"}),
        pa.table({"s1": [1.0]}).replace_schema_metadata({b"schema": SCHEMA.encode()}),
    ],
    ids=["two columns of one name", "a schema that is no text", "no campaign"],
)
def test_a_damaged_table_of_poses_is_refused(tmp_path, table):
    pq.write_table(table, tmp_path / "poses.parquet")
    with pytest.raises(RawDataError, match=r"poses\.parquet"):
        read_pose_table(tmp_path / "poses.parquet", "c1")
