"""Joints in one log, readings in another: joined by time, label or row, and told when shifted."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import described
from made_up_two_logs import JOINTS, PLACE, two_logs
from pa10cal.campaign.log_labels import by_label, shared_labels
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.table import read_observations, write_pose_table
from pa10cal.errors import Pa10calError

#: Runs joined by time, and runs shifted by a row; a few of each in the quick suite.
JOINED, SHIFTED, QUICK = range(200), range(100), 4


def some(seeds):
    """Return seeds, of which a few are quick."""
    return [pytest.param(k, marks=[pytest.mark.slow] if k >= QUICK else []) for k in seeds]


@pytest.fixture
def written(tmp_path, proposed):
    """Write two logs, and propose a campaign.yaml for them."""

    def run(logs, **how):
        folder = tmp_path / "mine"
        text = proposed(*logs.write(folder, **how), folder=folder)
        return yaml.safe_load(text), text, folder

    return run


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("seed", some(JOINED))
@pytest.mark.usefixtures("tried")
def test_clocks_that_are_hours_apart_are_joined_by_the_motion(tmp_path, written, seed):
    logs = two_logs(tmp_path, seed, dense=seed % 4 != 3, regular=seed % 5 == 4)
    content, text, folder = written(logs, sep=";", decimal=",")
    assert content["files"] == {"joints": "controller.csv", "readings": "tracker.csv"}
    found = read_campaign(folder)
    (note,) = (each for each in found.notes if "joined by time" in each)
    offset_s = float(re.search(r"readings ([-+]\d+\.\d+) s", note)[1])
    assert note in text
    read_s = logs.stood_s.mean(axis=1)
    width_s = np.ptp(logs.stood_s, axis=1).max()
    assert abs(offset_s - logs.offset_s) < 0.5 * width_s, (offset_s, logs.offset_s, read_s[:2])
    assert len(found.observations) >= 0.95 * len(logs.q_rad)
    order = np.argsort(found.observations.states.time_s)
    q_rad = found.observations.states.q_rad[order]
    if len(q_rad) == len(logs.q_rad):
        np.testing.assert_allclose(q_rad, logs.q_rad, atol=2e-4)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_blank_reading_does_not_move_the_clock_by_a_pose(tmp_path, written, seed):
    """All poses take equally long, so only the nominal arm shows which offset is right."""
    logs = two_logs(tmp_path, seed, regular=True)
    _, _, folder = written(logs, sep=";", decimal=",")
    logs.readings = logs.readings.iloc[5:-5].copy()
    logs.readings.loc[logs.readings.index[7], PLACE] = np.nan
    logs.write(folder, sep=";", decimal=",")
    found = read_campaign(folder)
    (note,) = (each for each in found.notes if "joined by time" in each)
    offset_s = float(re.search(r"readings ([-+]\d+\.\d+) s", note)[1])
    assert abs(offset_s - logs.offset_s) < 0.5 * np.ptp(logs.stood_s, axis=1).max()


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("seed", some(SHIFTED))
def test_a_row_that_is_missing_is_named(tmp_path, written, seed):
    """Readings a row away from their joints, from the start or from a place on."""
    rng = np.random.default_rng(seed)
    logs = two_logs(tmp_path, 1000 + seed, dense=False)
    joints, readings = (
        table.drop(columns=table.columns[0]) for table in (logs.joints, logs.readings)
    )
    place = 0 if seed % 3 == 0 else int(rng.integers(4, len(readings) - 4))
    lost = joints if seed % 2 else readings
    shorter = lost.drop(index=place).reset_index(drop=True)
    logs.joints, logs.readings = (shorter, readings) if seed % 2 else (joints, shorter)
    folder = tmp_path / "mine"
    logs.write(folder)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(mapped()))
    with pytest.raises(Pa10calError) as refused:
        read_campaign(folder)
    assert "readings fit the joints of the row" in str(refused.value)
    (line,) = re.findall(r"tracker.csv:(\d+)", str(refused.value))
    assert abs(int(line) - 2 - place) <= 1


def mapped():
    readings = {
        "position": {"names": ["X [mm]", "Y [mm]", "Z [mm]"]},
        "rotation": {"names": ["Rx [deg]", "Ry [deg]", "Rz [deg]"], "convention": "rpy"},
    }
    return described(
        files={"joints": "controller.csv", "readings": "tracker.csv"},
        holdout={"every": 5},
        columns={"joints": {"joints": {"names": JOINTS}}, "readings": readings},
    )


def read_with(tmp_path, logs, of_readings=(), exclude=(), sep=",", stated=(), **of_joints):
    """Read two logs with further columns mapped."""
    folder, content = tmp_path / "mine", mapped() | {"exclude": list(exclude)} | dict(stated)
    logs.write(folder, sep=sep)
    content["columns"]["joints"] |= of_joints
    content["columns"]["readings"] |= dict(of_readings)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return read_campaign(folder)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("time_of_joints", [False, True])
@pytest.mark.parametrize("shuffled", [False, True])
def test_rows_that_belong_together_are_joined_by_row(tmp_path, time_of_joints, shuffled):
    """In the order of the files, even where the joints have times that are in another."""
    logs = two_logs(tmp_path, 5, dense=False)
    order = np.arange(len(logs.q_rad))
    order = np.random.default_rng(0).permutation(order) if shuffled else order
    shown = slice(None) if time_of_joints else order  # readings go by time
    p_mm = logs.readings[PLACE].to_numpy()[shown]
    logs.joints, logs.readings = (table.iloc[order] for table in (logs.joints, logs.readings))
    logs.readings = logs.readings.drop(columns="Zeitstempel")
    timed = {"time": {"names": "Zeit [s]"}} if time_of_joints else {}
    found = read_with(tmp_path, logs, **timed)
    assert any("joined by row" in note for note in found.notes)
    np.testing.assert_allclose(found.observations.states.q_rad, logs.q_rad[shown], atol=2e-4)
    np.testing.assert_allclose(1e3 * found.observations.measured.places_m[:, 0], p_mm)
    assert found.warnings == ()


def test_poses_to_which_the_arm_came_again_are_joined_by_row(tmp_path):
    """The log of the joints holds commands, which are the same in every digit."""
    logs = two_logs(tmp_path, 5, dense=False)
    joints = logs.joints[JOINTS]
    logs.joints = pd.concat([joints, joints], ignore_index=True)
    readings = logs.readings.drop(columns="Zeitstempel")
    again = readings.assign(**{PLACE[0]: readings[PLACE[0]] + 0.01})
    logs.readings = pd.concat([readings, again], ignore_index=True)
    found = read_with(tmp_path, logs)
    assert found.quarantined == ()
    assert len(found.observations) == 2 * len(joints)
    np.testing.assert_allclose(
        found.observations.states.q_rad[len(joints) :], logs.q_rad, atol=2e-4
    )


@pytest.mark.parametrize(("joint_rows", "reading_rows"), [([7], [6]), ([9], []), ([], [4, 5])])
def test_a_row_that_cannot_be_read_moves_no_other_row(tmp_path, joint_rows, reading_rows):
    """Joined by row, each reading has the joints of its own row, or none."""
    logs = two_logs(tmp_path, 5, dense=False)
    logs.readings = logs.readings.drop(columns="Zeitstempel").astype(object)
    logs.joints = logs.joints.astype(object)
    logs.joints.iloc[joint_rows, 1] = "lost"
    logs.readings.iloc[reading_rows, 0] = "lost"
    found = read_with(tmp_path, logs, stated={"configurations": len(logs.q_rad)})
    assert not any("configurations" in warning for warning in found.warnings)
    kept = np.setdiff1d(np.arange(len(logs.q_rad)), joint_rows + reading_rows)
    np.testing.assert_allclose(found.observations.states.q_rad, logs.q_rad[kept], atol=2e-4)
    reasons = [row.reason for row in found.quarantined]
    assert reasons.count("not a finite number") == len(joint_rows) + len(reading_rows)
    assert reasons.count("the log of the joints has no such row") == len(joint_rows)


@pytest.mark.parametrize(("deleted", "lost", "line"), [(15, 21, 17), (3, 20, 5), (30, 12, 32)])
def test_a_row_that_is_missing_is_not_made_up_for_by_one_that_cannot_be_read(
    tmp_path, deleted, lost, line
):
    """Equally many rows are left of each log, and those between belong to their neighbours."""
    logs = two_logs(tmp_path, 5, dense=False)
    logs.readings = logs.readings.drop(columns="Zeitstempel").drop(index=deleted)
    logs.joints = logs.joints.astype(object)
    logs.joints.iloc[lost, 1] = "lost"
    shifted = rf"tracker.csv:{line}: from line {line} on the readings fit the joints of the row"
    with pytest.raises(Pa10calError, match=shifted):
        read_with(tmp_path, logs)


def test_logs_of_different_numbers_of_rows_are_refused_however_many_can_be_used(tmp_path):
    """Few rows after the missing one do not show in the nominal arm."""
    logs = two_logs(tmp_path, 5, dense=False)
    logs.readings = logs.readings.drop(columns="Zeitstempel").drop(index=39)
    logs.joints = logs.joints.astype(object)
    logs.joints.iloc[2, 1] = "lost"
    with pytest.raises(Pa10calError, match="39 readings and 40 rows of joints"):
        read_with(tmp_path, logs)


def test_a_line_is_excluded_of_the_file_that_is_named(tmp_path):
    logs = two_logs(tmp_path, 5, dense=False)
    exclude = [{"where": "tracker.csv:12", "why": "bumped"}]
    found = read_with(tmp_path, logs, exclude=exclude)
    (row,) = (row for row in found.quarantined if row.reason == "excluded: bumped")
    assert (row.file, row.line) == ("tracker.csv", 12)
    with pytest.raises(Pa10calError, match=r"nothing is there .*controller\.csv:12.*tracker\.csv"):
        read_with(tmp_path, logs, exclude=[{"where": "controller.csv:12", "why": "bumped"}])


@pytest.mark.parametrize("timed", [False, True])
def test_readings_of_which_none_can_be_read_are_refused_for_that(tmp_path, timed):
    logs = two_logs(tmp_path, 5, dense=False)
    logs.readings = logs.readings.astype(str).apply(lambda column: column.str.replace(".", ","))
    time = {"time": {"names": logs.joints.columns[0]}} if timed else {}
    of_readings = {"separator": ";"}
    of_readings |= {"time": {"names": logs.readings.columns[0], "format": "iso"}} if timed else {}
    with pytest.raises(Pa10calError, match=r"40 of 40 rows .*set columns.readings.decimal: ','"):
        read_with(tmp_path, logs, of_readings, sep=";", separator=";", **time)


@pytest.mark.parametrize("by", ["time", "label"])
@pytest.mark.parametrize("lacks", ["joints", "readings"])
def test_logs_are_joined_by_columns_that_both_have(tmp_path, by, lacks):
    logs = two_logs(tmp_path, 5, dense=False)
    logs.write(tmp_path / "mine")
    content = mapped() | {"join": {"by": by}}
    (other,) = {"joints", "readings"} - {lacks}
    name = {"joints": logs.joints, "readings": logs.readings}[other].columns[0]
    key = {"time": "time", "label": "pose"}[by]
    content["columns"][other][key] = {"names": name} if by == "time" else name
    (tmp_path / "mine" / "campaign.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(Pa10calError, match=rf"join.by: .* join .*set columns.{lacks}.{key},"):
        read_campaign(tmp_path / "mine")


TORQUES, U, U_TORQUES = ([f"{name}{k}" for k in range(1, 7)] for name in ("M", "u", "uM"))


def test_uncertainties_that_the_log_of_joints_states_are_read(tmp_path):
    logs = two_logs(tmp_path, 5, dense=False)
    logs.joints[TORQUES], logs.joints[U], logs.joints[U_TORQUES] = 5.0, 0.004, 0.2
    logs.joints = logs.joints.astype({"uM1": object})
    logs.joints.loc[3, "u2"], logs.joints.loc[4, "uM1"] = 0.0, "?"  # not stated; not a number
    logs.readings = logs.readings.drop(columns="Zeitstempel")
    joints = {"names": JOINTS, "u": U}
    found = read_with(tmp_path, logs, joints=joints, torques={"names": TORQUES, "u": U_TORQUES})
    assert "uM1 = '?'" in [row.value for row in found.quarantined]
    log = found.observations.log
    expected = np.full((39, 6), np.radians(0.004))
    expected[3, 1] = np.nan
    np.testing.assert_allclose(log.q_u, expected)
    np.testing.assert_allclose(log.tau_u, 0.2)
    assert set(log.samples) == {1}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("stated", [False, True])
def test_dwells_of_a_dense_log_have_uncertainties(tmp_path, stated):
    """Those stated, else from the scatter, which a read-back without any does not show."""
    logs = two_logs(tmp_path, 0, noise_deg=0.0)
    count = len(logs.joints)
    logs.joints[TORQUES] = 5.0 + np.random.default_rng(0).normal(0.0, 0.5, (count, 6))
    logs.joints[U_TORQUES] = 0.2
    torques = {"names": TORQUES, **({"u": U_TORQUES} if stated else {})}
    stamps = {"names": "Zeitstempel", "format": "%d.%m.%Y %H:%M:%S.%f"}
    found = read_with(tmp_path, logs, {"time": stamps}, time={"names": "Zeit [s]"}, torques=torques)
    assert found.quarantined == ()
    log = found.observations.log
    assert log.samples.min() > 1
    assert np.isnan(log.q_u).all()
    scatter = 0.5 / np.sqrt(log.samples)[:, None]
    if stated:
        np.testing.assert_allclose(log.tau_u, 0.2)
    else:
        assert np.median(log.tau_u / scatter) == pytest.approx(1.0, rel=0.1)


def test_rounded_positions_of_a_dense_log_are_uncertain_in_the_covariance(tmp_path):
    """All samples of a dwell share their rounding, so that no scatter and no repeat shows it."""
    logs = two_logs(tmp_path, 0, poses=60, noise_deg=0.0)
    exact = logs.joints[JOINTS].copy()
    stamps = {"names": "Zeitstempel", "format": "%d.%m.%Y %H:%M:%S.%f"}
    found = []
    for step_deg in (0.0, 0.1):
        logs.joints[JOINTS] = step_deg * np.round(exact / step_deg) if step_deg else exact
        how = {"time": {"names": ["Zeit [s]"]}}
        found.append(read_with(tmp_path, logs, {"time": stamps}, **how).observations)
    before, after = found
    assert after.log.samples.min() > 1
    assert not before.log.q_u_stated.any()
    np.testing.assert_allclose(after.log.q_u_stated, np.radians(0.1) / np.sqrt(12.0))
    more = after.measured.stated_covariance - before.measured.stated_covariance
    assert (np.trace(more, axis1=1, axis2=2) > 0.0).all()
    write_pose_table(tmp_path / "poses.parquet", after, np.zeros(6, dtype=bool), "made-up")
    description = read_campaign(tmp_path / "mine").description
    again = read_observations(tmp_path / "poses.parquet", description)
    np.testing.assert_array_equal(again.log.q_u_stated, after.log.q_u_stated)


@pytest.mark.usefixtures("tried")
def test_labels_join_whatever_the_order(tmp_path, written):
    logs = two_logs(tmp_path, 6, dense=False)
    names = [f"P{k:03d}" for k in range(len(logs.q_rad))]
    logs.joints, logs.readings = (
        table.drop(columns=table.columns[0]) for table in (logs.joints, logs.readings)
    )
    logs.joints.insert(0, "Punkt", names)
    logs.readings.insert(0, "Messpunkt", names)
    logs.joints = logs.joints.sample(frac=1.0, random_state=1)
    logs.readings = logs.readings.drop(index=[3, 17])
    _, text, folder = written(logs)
    assert "joined by label" in text
    found = read_campaign(folder).observations
    assert len(found) == len(names) - 2
    expected = dict(zip(names, logs.q_rad, strict=True))
    for pose, q_rad in zip(found.pose, found.states.q_rad, strict=True):
        np.testing.assert_allclose(q_rad, expected[pose], atol=2e-4)


def test_readings_while_the_arm_moved_are_left_out(tmp_path, written):
    logs = two_logs(tmp_path, 7, apart_s=0.0)
    at = logs.readings.columns[0]
    between = logs.stood_s[11, 0] - 0.8 - logs.stood_s[10, 1] + 0.4
    logs.readings.loc[10, at] = logs.readings.loc[11, at]  # of a dwell whose joints are others
    _, _, folder = written(logs)
    found = read_campaign(folder)
    assert between > 0.0
    assert len(found.observations) + len(found.quarantined) == len(logs.q_rad)


def test_directions_of_arrival_come_from_a_dense_log(tmp_path, written):
    logs = two_logs(tmp_path, 8)
    arrival = read_campaign(written(logs)[2]).observations.states.arrival
    assert np.abs(arrival).mean() > 0.9


def test_logs_of_two_runs_are_refused(tmp_path):
    logs, other = two_logs(tmp_path, 9), two_logs(tmp_path / "other", 10, apart_s=0.0)
    logs.readings = other.readings.iloc[::2].copy()
    rng = np.random.default_rng(1)
    stamps = logs.readings.columns[0]
    logs.readings[stamps] = rng.permutation(logs.readings[stamps].to_numpy())
    folder = tmp_path / "mine"
    logs.write(folder)
    content = mapped()
    content["columns"]["joints"]["time"] = {"names": "Zeit [s]"}
    content["columns"]["readings"]["time"] = {"names": stamps, "format": "%d.%m.%Y %H:%M:%S.%f"}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    try:
        found = read_campaign(folder)
    except Pa10calError:
        return
    assert any("off in the median" in warning for warning in found.warnings)


def test_without_kinds_two_logs_need_a_statement_of_what_is_held_out(tmp_path, written):
    content, _, folder = written(two_logs(tmp_path, 3))
    del content["holdout"]
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(Pa10calError, match=r"set columns.readings.kind; or state holdout"):
        read_campaign(folder)


def test_a_number_of_rows_that_starts_again_is_no_label(tmp_path, written):
    """As a tracker's software writes it where several exports are put one after the other."""
    logs = two_logs(tmp_path, 3, dense=False, regular=True)
    logs.readings["Id"] = [1 + k % 10 for k in range(len(logs.readings))]
    content, text, folder = written(logs)
    assert "pose" not in content["columns"]["readings"]
    assert "check pose: Id starts again" in text
    assert len(read_campaign(folder).observations) == len(logs.q_rad)


@pytest.mark.usefixtures("tried")
def test_several_readings_a_row_of_joints_are_told_what_to_write(tmp_path, written):
    logs = two_logs(tmp_path, 3, dense=False, regular=True)
    logs.readings = logs.readings.loc[logs.readings.index.repeat(3)].reset_index(drop=True)
    del logs.readings["Zeitstempel"], logs.joints["Zeit [s]"]
    _, text, _ = written(logs)
    assert "each pose has 3 rows of readings, write its joints 3 times" in text


AT_MM = {"SMR1": [0.0, 0.0, 0.0], "SMR2": [90.0, 0.0, 30.0], "SMR3": [0.0, 80.0, 30.0]}


def one_target_a_row(logs):
    """Return the readings of three targets, three rows a pose, and each pose's index."""
    angles_deg = logs.readings[["Rx [deg]", "Ry [deg]", "Rz [deg]"]]
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    tables = [
        (logs.readings[PLACE] + R @ at).assign(Target=name).astype(object)
        for name, at in AT_MM.items()
    ]
    return pd.concat(tables).sort_index(kind="stable")


def read_targets(tmp_path, logs, **of_readings):
    folder, content = tmp_path / "mine", mapped()
    logs.write(folder)
    words = {"names": "Target", "words": {name: name for name in AT_MM}}
    content["columns"]["readings"] = {"position": {"names": PLACE}, "target": words, **of_readings}
    content["instrument"] = {"kind": "points", "uncertainty_mm": 0.05}
    content["tool"]["balls_mm"] = AT_MM
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return read_campaign(folder)


def test_a_pose_of_which_no_target_can_be_read_moves_no_other_pose(tmp_path):
    """Three rows of readings, one row of joints a pose: poses count, whether or not one is lost."""
    logs = two_logs(tmp_path, 12, poses=30, dense=False)
    logs.joints = logs.joints.drop(columns="Zeit [s]")
    logs.readings = one_target_a_row(logs).assign(Pose=lambda rows: [f"M{k}" for k in rows.index])
    logs.readings.loc[20, PLACE] = "lost"
    found = read_targets(tmp_path, logs, pose="Pose")
    assert len(found.quarantined) == 3
    kept = np.delete(np.arange(30), 20)
    np.testing.assert_allclose(found.observations.states.q_rad, logs.q_rad[kept], atol=2e-4)


def test_a_target_that_one_visit_lacks_is_not_that_of_the_next_visit(tmp_path):
    """All poses twice under equal commands, each row of readings with joints of its own."""
    logs = two_logs(tmp_path, 12, poses=30, dense=False, noise_deg=0.0)
    once = one_target_a_row(logs)
    again = once.assign(**{PLACE[0]: once[PLACE[0]] + 0.02})
    joints = logs.joints[JOINTS].loc[once.index]
    lost = 3 * 3 + 1  # SMR2 at the first visit of a pose
    logs.readings = pd.concat([once, again], ignore_index=True).drop(index=lost)
    logs.joints = pd.concat([joints, joints], ignore_index=True).drop(index=lost)
    found = read_targets(tmp_path, logs).observations
    at_pose = np.abs(found.states.q_rad - logs.q_rad[3]).max(axis=1) < 1e-3
    off_mm = 1e3 * found.measured.places_m[at_pose, :, 0]
    off_mm -= once.loc[3, PLACE[0]].to_numpy(float)
    np.testing.assert_allclose(off_mm, [[0.0, np.nan, 0.0], [0.02] * 3], atol=1e-6)


@pytest.mark.parametrize("by", ["time", "row"])
def test_targets_aimed_at_in_turn_while_the_arm_stands_are_one_configuration(tmp_path, written, by):
    """One instrument measures three targets one after the other; each has a row of its own."""
    logs = two_logs(tmp_path, 12, poses=30, dense=by == "time")
    angles_deg = logs.readings[["Rx [deg]", "Ry [deg]", "Rz [deg]"]]
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    at_mm = {"SMR1": [0.0, 0.0, 0.0], "SMR2": [90.0, 0.0, 30.0], "SMR3": [0.0, 80.0, 30.0]}
    first_s = pd.to_datetime(logs.readings["Zeitstempel"], format="%d.%m.%Y %H:%M:%S.%f")
    tables = []
    for turn, (name, place_mm) in enumerate(at_mm.items()):
        table = logs.readings[["Zeitstempel", *PLACE]].copy()
        later = first_s + pd.to_timedelta(0.1 * turn, unit="s")
        table["Zeitstempel"] = later.dt.strftime("%d.%m.%Y %H:%M:%S.%f")
        table[PLACE] += R @ place_mm
        tables.append(table.assign(Target=name))
    logs.readings = pd.concat(tables).sort_index(kind="stable")
    if by == "row":
        logs.readings = logs.readings.drop(columns="Zeitstempel")
        logs.joints = logs.joints.drop(columns="Zeit [s]").loc[logs.readings.index]
    _, _, folder = written(logs)
    found = read_campaign(folder)
    assert any("90 rows of one target each are 30 configurations" in note for note in found.notes)
    np.testing.assert_allclose(found.observations.states.q_rad, logs.q_rad, atol=2e-4)
    assert found.observations.measured.target_names == tuple(at_mm)
    assert np.isfinite(found.observations.measured.places_m).all()


def test_labels_that_programs_write_otherwise_are_the_same_numbers():
    numbers = [*map(str, range(1, 41))]
    station = by_label(np.array([f"{k}.0" for k in numbers]), np.array(numbers))
    np.testing.assert_array_equal(station, np.arange(40))


@pytest.mark.parametrize(
    ("joints", "readings", "station"),
    [
        (["P[1]", "P[2]", "P[3]", "P[4]", "Home"], ["p1", "p2", "p3", "p4", "Home"], range(5)),
        (["P1.2", "P12", "P3"], ["p_1_2", "p12", "p3"], range(3)),
        (["A1", "a1", "B"], ["A1", "a1", "b"], [0, 1, -1]),  # two points, not one
    ],
)
def test_the_spelling_that_proposes_a_column_joins_by_it(joints, readings, station):
    np.testing.assert_array_equal(by_label(np.array(joints), np.array(readings)), [*station])
    proposed = shared_labels({"p": joints}, {"q": readings})
    assert (proposed == ("p", "q")) == (min(station) >= 0)


def test_columns_hold_labels_where_half_of_their_rows_have_one_of_their_own():
    assert shared_labels({"p": [*"ABC"] * 2}, {"q": [*"ABC"]}) == ("p", "q")
    assert shared_labels({"p": [*"ABC"] * 3}, {"q": [*"ABC"]}) is None


def test_rows_without_a_partner_under_their_label_are_told(tmp_path):
    logs = two_logs(tmp_path, 6, dense=False)
    names = [f"P{k:03d}" for k in range(len(logs.q_rad))]
    logs.joints, logs.readings = (
        table.drop(columns=table.columns[0]).assign(label=names)
        for table in (logs.joints, logs.readings)
    )
    # Of P005 two readings more than rows of joints, of P009 none, and one of no label there.
    joints, readings = logs.joints, logs.readings
    again = joints.iloc[[5]].copy()
    again[JOINTS[0]] += 1e-4
    logs.joints = pd.concat([joints, again], ignore_index=True)
    more = readings.iloc[[5, 5, 12]].assign(label=["P005", "P005", "P999"])
    more[PLACE[0]] += [0.01, 0.02, 0.0]
    logs.readings = pd.concat([readings.drop(index=9), more], ignore_index=True)
    found = read_with(tmp_path, logs, {"pose": "label"}, pose="label")
    reasons = {row.line: row.reason for row in found.quarantined}
    assert reasons == {
        42: "the log of the joints has its label several times, and less often than the readings",
        43: "the log of the joints has no such label",
    }
    (note,) = (note for note in found.notes if "joined by label" in note)
    assert note.endswith("; 1 of 41 rows of controller.csv have no reading")


def three_visits(tmp_path):
    """Return logs of 30 poses, each visited three times under one label, and X of the first."""
    logs = two_logs(tmp_path, 5, poses=30, dense=False, noise_deg=0.0)
    names = [f"P{k}" for k in range(30)]
    joints, readings = (
        table.drop(columns=table.columns[0]).assign(label=names)
        for table in (logs.joints, logs.readings)
    )
    turns = range(3)  # joints and places tell which visit it was
    logs.joints = pd.concat(
        [joints.assign(**{JOINTS[0]: joints[JOINTS[0]] + 0.002 * turn}) for turn in turns],
        ignore_index=True,
    ).astype(object)
    logs.readings = pd.concat(
        [readings.assign(**{PLACE[0]: readings[PLACE[0]] + 0.004 * turn}) for turn in turns],
        ignore_index=True,
    ).astype(object)
    return logs, readings[PLACE[0]].to_numpy()


@pytest.mark.parametrize(
    ("log", "column"), [("joints", JOINTS[1]), ("readings", PLACE[1]), ("readings", "Rx [deg]")]
)
def test_a_visit_that_cannot_be_read_moves_no_later_visit_of_its_label(tmp_path, log, column):
    logs, first_mm = three_visits(tmp_path)
    getattr(logs, log).loc[5, column] = "lost"
    found = read_with(tmp_path, logs, {"pose": "label"}, pose="label")
    readings = found.observations
    assert len(readings) == 89
    pose = [int(label[1:]) for label in readings.pose]
    by_joints = np.degrees(readings.states.q_rad - logs.q_rad[pose])[:, 0] / 0.002
    by_place = (1e3 * readings.measured.places_m[:, 0, 0] - first_mm[pose]) / 0.004
    np.testing.assert_allclose(by_joints, np.round(by_place), atol=0.1)
    told = {row.line: row.reason for row in found.quarantined if row.file == "tracker.csv"}
    lost = "the row of the joints for this visit of its label cannot be used"
    assert told == {7: lost if log == "joints" else "not a finite number"}


def test_visits_are_not_counted_where_a_row_may_have_their_label(tmp_path):
    """A row of joints with a field more: whose visit it was, nobody knows."""
    logs, _ = three_visits(tmp_path)
    folder = tmp_path / "mine"
    read_with(tmp_path, logs, {"pose": "label"}, pose="label")
    lines = (folder / "controller.csv").read_text().splitlines()
    lines[6] += ",1.0"
    (folder / "controller.csv").write_text("\n".join(lines) + "\n")
    found = read_campaign(folder)
    unclear = "the two logs have its label in different numbers"
    told = [row.line for row in found.quarantined if row.reason.startswith(unclear)]
    assert told == [7, 37, 67]


def test_logs_of_which_no_visit_is_clear_are_refused_for_that(tmp_path):
    """All labels twice in the joints' log, whose last row was cut off, and once in the other."""
    logs, _ = three_visits(tmp_path)
    logs.joints, logs.readings = logs.joints.iloc[:60], logs.readings.iloc[:30].copy()
    logs.readings["at"] = 1.7e9 + 10.0 * np.arange(30)
    read_with(tmp_path, logs, {"pose": "label", "time": {"names": "at"}}, pose="label")
    with (tmp_path / "mine" / "controller.csv").open("a") as log:
        log.write("12.3,4\n")
    with pytest.raises(Pa10calError, match=r"30 of 30 rows .*one of them has rows that cannot be"):
        read_campaign(tmp_path / "mine")


def test_times_of_which_none_is_stated_are_refused_without_a_warning(tmp_path):
    logs, _ = three_visits(tmp_path)
    logs.joints, logs.readings = logs.joints.iloc[:30], logs.readings.iloc[:30].assign(at=np.nan)
    with pytest.raises(Pa10calError, match="column `at`"):
        read_with(tmp_path, logs, {"pose": "label", "time": {"names": "at"}}, pose="label")


def test_a_blank_temperature_in_the_log_of_joints_takes_none_of_the_others(tmp_path):
    logs = two_logs(tmp_path, 5, dense=False)
    logs.joints["T"] = temperature_C = np.where(np.arange(40) == 3, np.nan, 21.5)
    logs.readings = logs.readings.drop(columns="Zeitstempel")
    found = read_with(tmp_path, logs, temperature={"names": "T"})
    np.testing.assert_allclose(found.observations.states.temperature_C, temperature_C)
    assert "temperature_C is blank in 1 of 40 rows" in found.notes


def test_rows_without_a_label_are_not_joined_by_it():
    joints, readings = np.array(["A", "B", "", "C"]), np.array(["A", "", "B", "C"])
    np.testing.assert_array_equal(by_label(joints, readings), [0, -1, 1, 3])


def test_labels_of_which_one_begins_another_are_not_visits_of_one():
    labels = np.array([f"P{k}" for k in range(1, 13)])
    readings = np.array(["P12", "P1", "P12"])
    np.testing.assert_array_equal(by_label(labels, readings), [11, 0, 11])
