"""Campaigns of instruments that give positions of targets, or distances, and any arm."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest

import pa10cal
from made_up_sightings import UNCERTAINTY_MM, sighted
from pa10cal.arm.chain import Chain
from pa10cal.campaign.read import repeatability_mm, wrong_rows
from pa10cal.campaign.screens import OFF_REPEATS, alike, held_last, off_its_like
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from spoiling import ingest, replace, with_columns

NO_TORQUES = {
    True: "no torques logged: those of the described masses are used",
    False: "no torques logged, masses unknown: those of assumed weights are used",
}
KINDS = ["pose", "points", "distance"]
ROBOTS = ["ur10", "gx4_351s", "iiwa14"]


def scale(raw, factor, chosen):
    """Write the chosen columns in another unit."""
    columns = [k for k, name in enumerate(raw.poses[0].split(",")) if chosen(name)]
    for index, line in enumerate(raw.poses[1:], start=1):
        words = line.split(",")
        for k in columns:
            words[k] = repr(factor * float(words[k])) if words[k] else ""
        raw.poses[index] = ",".join(words)


def add(raw, index, column, value):
    word = raw.poses[index].split(",")[raw.column(column)]
    replace(raw.poses, index, column, repr(float(word) + value))


def seen_row(raw, column, first=1):
    """Return the first row from `first` on with a number in a column."""
    k = raw.column(column)
    return next(i for i in range(first, len(raw.poses)) if raw.poses[i].split(",")[k])


def listed(ingested):
    return [(row.line, row.reason) for row in ingested.quarantined]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("robot", ROBOTS)
def test_points_come_out_as_they_went_in(tmp_path, robot):
    raw = sighted(tmp_path, "points", robot=robot)
    ingested = ingest(raw)
    poses = ingested.observations
    assert ingested.quarantined == ()
    assert ingested.notes == (NO_TORQUES[robot != "gx4_351s"],)
    assert poses.measured.names == ("T1", "T2", "T3")
    np.testing.assert_allclose(1e3 * poses.measured.p_instr_m, 1e3 * raw.p_instr_m, atol=1e-8)
    np.testing.assert_allclose(poses.states.q_rad, raw.q, atol=1e-9)
    seen = np.isfinite(raw.p_instr_m)
    variances = 1e6 * poses.measured.cov_m2[..., range(3), range(3)]
    np.testing.assert_allclose(variances[seen], UNCERTAINTY_MM**2)
    assert np.isnan(variances[~seen]).all()
    assert np.isnan(poses.states.tau_Nm).all()


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_distances_come_out_as_they_went_in(tmp_path, robot):
    raw = sighted(tmp_path, "distance", robot=robot)
    ingested = ingest(raw)
    poses = ingested.observations
    assert ingested.quarantined == ()
    assert ingested.notes == (NO_TORQUES[robot != "gx4_351s"],)
    np.testing.assert_allclose(1e3 * poses.measured.d_m, 1e3 * raw.d_m, atol=1e-8)
    np.testing.assert_allclose(1e3 * poses.measured.u_m, UNCERTAINTY_MM)
    np.testing.assert_allclose(poses.states.q_rad, raw.q, atol=1e-9)


def test_what_is_stated_beside_the_values_is_taken(tmp_path):
    raw = sighted(tmp_path, "points", robot="gx4_351s", targets=1)
    torques = {f"tau{j}_Nm": 1.5 * j for j in range(1, 5)}
    stated = {"u_T1_y_mm": 0.05, "u_q3_mm": 0.02, "u_q4_deg": 0.01, "temperature_C": 22.5}
    with_columns(raw.poses, {**torques, **stated})
    ingested = ingest(raw)
    assert ingested.notes == ()
    poses = ingested.observations
    variances = 1e6 * np.diagonal(poses.measured.cov_m2[0, 0])
    np.testing.assert_allclose(variances, [UNCERTAINTY_MM**2, 0.05**2, UNCERTAINTY_MM**2])
    np.testing.assert_allclose(poses.log.q_u[0, 2:], [2e-5, np.radians(0.01)])
    assert np.isnan(poses.log.q_u[0, :2]).all()
    np.testing.assert_allclose(poses.states.tau_Nm[3], [1.5, 3.0, 4.5, 6.0])
    assert (poses.states.temperature_C == 22.5).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robot", ["ur10", pytest.param("gx4_351s", marks=pytest.mark.slow)])
def test_stated_uncertainties_of_joints_are_in_the_covariance(tmp_path, robot, kind):
    raw, arm = sighted(tmp_path, kind, robot=robot, targets=2), load_arm(robot)
    before = ingest(raw).observations.measured.stated_covariance
    stated = {"u_q2_deg": 0.02, "u_q3_mm" if arm.prismatic[2] else "u_q3_deg": 0.05}
    with_columns(raw.poses, stated)
    measured = ingest(raw).observations.measured
    to_end, targets_m = raw.T_instr_base.copy(), raw.p_ee_m.ravel()
    T_ee_target = raw.T_ee_target if kind == "pose" else np.eye(4)
    if kind == "distance":
        to_end, targets_m = np.eye(4), raw.T_ee_target[:3, 3]
        to_end[:3, 3] = -raw.p_base_point_m
    # What moves by a small step of each joint, the true frames and targets as they are.
    step, expected = 1e-6, before.copy()
    for (name, u), joint in zip(stated.items(), (1, 2), strict=True):
        q = raw.q + step * (np.arange(arm.n) == joint)
        T, T_moved = (to_end @ Chain.of(arm).forward(at) @ T_ee_target for at in (raw.q, q))
        left, left_moved = (measured.compare(at, targets_m).residual for at in (T, T_moved))
        moved = (left_moved - left) / step
        u_q = 1e-3 * u if name.endswith("mm") else np.radians(u)
        expected += u_q**2 * moved[:, :, None] * moved[:, None]
    atol = 1e-4 * np.abs(expected - before).max()
    np.testing.assert_allclose(measured.stated_covariance, expected, rtol=0.0, atol=atol)


@pytest.mark.parametrize("scatter", ["the same in all repeats", "another in each"])
def test_repeats_do_not_contradict_stated_uncertainties_of_joints(tmp_path, scatter):
    raw = sighted(tmp_path, "points", repeats=3, noise_mm=UNCERTAINTY_MM)
    u_deg, arm = 0.02, load_arm("ur10")
    with_columns(raw.poses, {f"u_q{joint}_deg": u_deg for joint in range(1, arm.n + 1)})
    if scatter == "another in each":
        first = raw.column("q1_deg")
        off_deg = np.random.default_rng(2).normal(0.0, u_deg, raw.q.shape)
        for k, by_deg in enumerate(off_deg, start=1):
            words = raw.poses[k].split(",")
            for joint, by in enumerate(by_deg.tolist(), start=first):
                words[joint] = f"{float(words[joint]) + by:.9f}"
            raw.poses[k] = ",".join(words)
    found = pa10cal.read_campaign(raw.write())
    assert pa10cal.calibrate(found).grade in ("good", "few_poses")


def test_rows_without_any_target_or_with_part_of_one_are_listed(tmp_path):
    raw = sighted(tmp_path, "points")
    row = seen_row(raw, "T2_x_mm", 5)
    replace(raw.poses, row, "T2_y_mm", "")
    for b in (1, 2, 3):
        for axis in "xyz":
            replace(raw.poses, 12, f"T{b}_{axis}_mm", "")
    ingested = ingest(raw)
    assert listed(ingested) == [
        (row + 1, "a target with some of its coordinates only"),
        (13, "no target was observed"),
    ]
    assert ingested.quarantined[0].value == "T2_x_mm, T2_y_mm, T2_z_mm"
    assert len(ingested.observations) == 38


@pytest.mark.slow_but_one_in(8)
@pytest.mark.parametrize(
    ("kind", "column", "text", "reason"),
    [
        ("pose", "u_x_mm", "-0.01", "the stated uncertainty is not above zero"),
        ("pose", "u_x_mm", "nan", "not a finite number"),
        ("pose", "tau3_Nm", "off", "not a finite number"),
        ("pose", "qw", "1.9", "the quaternion is not of unit length"),
        ("points", "T1_x_mm", "nan", "not a finite number"),
        ("points", "T1_x_mm", "off", "not a finite number"),
        ("points", "T1_x_mm", "2e7", "a coordinate beyond any measuring volume"),
        ("points", "u_T1_x_mm", "0", "the stated uncertainty is not above zero"),
        ("points", "q2_deg", "", "not a finite number"),
        ("points", "tau2_Nm", "", "not a finite number"),
        ("points", "pose", "", "the pose has no label"),
        ("points", "kind", "test", "kind is none of line_x, line_y, grid, holdout"),
        ("distance", "d_mm", "", "not a finite number"),
        ("distance", "d_mm", "inf", "not a finite number"),
        ("distance", "d_mm", "-900", "the distance is not above zero"),
        ("distance", "d_mm", "0", "the distance is not above zero"),
        ("distance", "load_N", "-22", "negative load"),
        ("distance", "repeat", "1.5", "not a whole number"),
    ],
)
def test_a_row_that_cannot_be_used_is_listed(tmp_path, kind, column, text, reason):
    raw = sighted(tmp_path, kind, targets=1)
    extra = {f"tau{j}_Nm": 1.5 for j in range(1, 7)}
    of = {"pose": "x_mm", "points": "T1_x_mm", "distance": "d_mm"}[kind]
    with_columns(raw.poses, {**extra, f"u_{of}": 0.02})
    replace(raw.poses, 12, column, text)
    ingested = ingest(raw)
    assert listed(ingested) == [(13, reason)]
    if reason == "not a finite number":
        assert ingested.quarantined[0].value.startswith(f"{column} = ")
    assert len(ingested.observations) == 39


@pytest.mark.parametrize("kind", ["points", "distance"])
def test_what_files_do_is_survived(tmp_path, kind):
    raw = sighted(tmp_path, kind)
    raw.poses[20], raw.poses[10] = raw.poses[10], raw.poses[20]
    raw.poses.append(raw.poses[7])
    again = raw.poses[8].split(",")
    raw.poses.append(",".join(["5000", *again[1:]]))
    raw.line_end = "\r\n"
    raw.write()
    content = (raw.folder / "poses.csv").read_bytes()
    last = raw.poses[9].replace("P008", "P200").rsplit(",", 2)[0]
    raw.extra["poses.csv"] = b"\xef\xbb\xbf" + content + last.encode()
    ingested = ingest(raw)
    assert sorted(listed(ingested)) == [
        (42, "repeats an earlier row"),
        (43, "this configuration was read before"),
        (44, "the last line is cut short"),
    ]
    assert "rows of poses.csv out of order: 10" in ingested.notes
    np.testing.assert_allclose(ingested.observations.states.q_rad, raw.q, atol=1e-9)


def test_a_compressed_file_is_read(tmp_path):
    raw = sighted(tmp_path, "distance")
    raw.description["files"]["poses"] = "poses.csv.gz"
    assert len(ingest(raw).observations) == 40


def with_decimal_commas(lines):
    return [lines[0], *(line.replace(".", ",") for line in lines[1:])]


@pytest.mark.parametrize(
    ("spoilt", "message"),
    [
        (lambda _: [], r"poses.csv:1: the file is empty"),
        (lambda lines: lines[:1], r"poses.csv:1: there is no row"),
        (with_decimal_commas, r"poses.csv:2: .*decimal commas.*decimal points"),
        (
            lambda lines: [line.replace(",", ";") for line in lines],
            r"poses.csv:1: .*separated by semicolons",
        ),
        (
            lambda lines: [lines[0].replace("q3_deg", "q3"), *lines[1:]],
            r"poses.csv:1: missing column q3_deg .*is it 'q3'",
        ),
    ],
)
@pytest.mark.parametrize("kind", ["points", "distance"])
def test_a_file_that_cannot_be_used_is_refused(tmp_path, kind, spoilt, message):
    raw = sighted(tmp_path, kind)
    raw.poses = spoilt(raw.poses)
    with pytest.raises(Pa10calError, match=message):
        ingest(raw)


def test_missing_columns_of_what_was_measured_are_named(tmp_path):
    raw = sighted(tmp_path, "points")
    raw.poses[0] = raw.poses[0].replace("T2_z_mm", "T2_z")
    with pytest.raises(Pa10calError, match=r"poses.csv:1: missing column T2_z_mm .*is it 'T2_z'"):
        ingest(raw)
    raw.description["instrument"]["kind"] = "distance"
    with pytest.raises(Pa10calError, match=r"missing column d_mm"):
        ingest(raw)
    of_distance = sighted(tmp_path, "distance")
    of_distance.description["instrument"]["kind"] = "points"
    with pytest.raises(Pa10calError, match=r"missing columns T1_x_mm, T1_y_mm, T1_z_mm"):
        ingest(of_distance)


def test_the_stroke_of_a_joint_that_slides_has_its_own_column(tmp_path):
    raw = sighted(tmp_path, "points", robot="gx4_351s")
    raw.poses[0] = raw.poses[0].replace("q3_mm", "q3_deg")
    with pytest.raises(Pa10calError, match=r"missing column q3_mm .*is it 'q3_deg'"):
        ingest(raw)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("kind", KINDS)
def test_radians_are_noticed(tmp_path, kind, robot):
    raw = sighted(tmp_path, kind, robot=robot, noise_mm=0.5)
    scale(raw, np.pi / 180, lambda name: name.startswith("q") and name.endswith("_deg"))
    with pytest.raises(Pa10calError, match=r"q1_deg … q\d_deg: the joint angles look like radians"):
        ingest(raw)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_stroke_in_metres_is_noticed(tmp_path, kind):
    raw = sighted(tmp_path, kind, robot="gx4_351s", noise_mm=0.5)
    scale(raw, 1e-3, lambda name: name == "q3_mm")
    with pytest.raises(Pa10calError, match=r"the joint strokes look like metres .*millimetres"):
        ingest(raw)


def test_small_turns_in_degrees_are_not_taken_for_radians(tmp_path):
    raw = sighted(tmp_path, "points", noise_mm=0.5)
    rng = np.random.default_rng(3)
    q_deg = rng.uniform(-5, 5, (40, 6)).round(6)
    p_m = Chain.of(load_arm("ur10")).forward(np.radians(q_deg))[:, :3, 3]
    for k, line in enumerate(raw.poses[1:]):
        words = line.split(",")
        words[5:11] = [f"{value:.6f}" for value in q_deg[k]]
        words[11:] = [f"{1e3 * value:.6f}" for value in p_m[k]] + [""] * 6
        raw.poses[k + 1] = ",".join(words)
    assert len(ingest(raw).observations) == 40


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1e-3, "metres"), (0.1, "centimetres"), (1 / 25.4, "inches")],
)
@pytest.mark.parametrize(
    ("robot", "kind"), [("ur10", "pose"), ("gx4_351s", "points"), ("iiwa14", "distance")]
)
def test_lengths_in_another_unit_are_noticed(tmp_path, kind, robot, factor, unit):
    raw = sighted(tmp_path, kind, robot=robot, noise_mm=0.5)
    scale(raw, factor, lambda name: name[0] in "Tdxyz" and name.endswith("_mm"))
    what = "distances" if kind == "distance" else "positions"
    with pytest.raises(Pa10calError, match=rf"poses.csv: \w+_mm.*: the {what} look like {unit}"):
        ingest(raw)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(
    ("kind", "column"), [("pose", "y_mm"), ("points", "T2_y_mm"), ("distance", "d_mm")]
)
def test_a_reading_far_from_the_model_is_listed_wherever_the_target_is(
    tmp_path, kind, column, robot
):
    raw = sighted(tmp_path, kind, robot=robot, noise_mm=0.5)
    row = seen_row(raw, column, 17)
    add(raw, row, column, 250.0)
    ingested = ingest(raw)
    reason = "far from where the joint angles put the end-effector"
    assert listed(ingested) == [(row + 1, reason)]
    assert column in ingested.quarantined[0].value.split(" = ")[0]
    assert len(ingested.observations) == 39


def test_an_attitude_far_from_the_model_is_listed(tmp_path):
    raw = sighted(tmp_path, "pose", noise_mm=0.5)
    words = raw.poses[9].split(",")
    words[-4:] = [words[-3], words[-4], words[-1], words[-2]]
    raw.poses[9] = ",".join(words)
    ingested = ingest(raw)
    assert listed(ingested) == [(10, "far from where the joint angles put the end-effector")]


@pytest.mark.parametrize(
    ("kind", "column"), [("pose", "y_mm"), ("points", "T1_x_mm"), ("distance", "d_mm")]
)
def test_a_repeat_far_from_the_others_is_listed(tmp_path, kind, column):
    raw = sighted(tmp_path, kind, poses=15, repeats=3, targets=1, noise_mm=0.05)
    add(raw, 20, column, 30.0)
    ingested = ingest(raw)
    assert listed(ingested) == [(21, "far from the other readings of this pose and load")]


def test_a_reading_out_of_reach_is_listed(tmp_path):
    raw = sighted(tmp_path, "distance")
    add(raw, 4, "d_mm", 20_000.0)
    reason = "further from the other positions than the arm reaches"
    assert listed(ingest(raw)) == [(5, reason)]


def test_rows_without_a_detection_are_listed_as_that_and_are_no_outliers(tmp_path):
    raw = sighted(tmp_path, "pose")
    header = raw.poses[0].split(",")
    nothing = {"x_mm": "0", "y_mm": "0", "z_mm": "0", "qw": "1", "qx": "0", "qy": "0", "qz": "0"}
    for row in (4, 9):
        words = raw.poses[row].split(",")
        for name, word in nothing.items():
            words[header.index(name)] = word
        raw.poses[row] = ",".join(words)
    ingested = ingest(raw)
    reason = "reads 0, 0, 0, as a target that was not detected"
    assert listed(ingested) == [(5, reason), (10, reason)]
    assert not wrong_rows(ingested.quarantined)


def test_a_label_of_another_command_is_listed(tmp_path):
    raw = sighted(tmp_path, "points", robot="gx4_351s", repeats=3)
    add(raw, 44, "q3_mm", 8.0)
    ingested = ingest(raw)
    assert [row.line for row in ingested.quarantined] == [45]
    assert ingested.quarantined[0].reason.startswith(
        "the joint angles are not those of this pose's"
    )


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("kind", "right", "wrong", "off"),
    [
        ("pose", "qw,qx,qy,qz", "qx,qy,qz,qw", "deg"),
        ("points", "q1_deg,q2_deg", "q2_deg,q1_deg", "mm"),
    ],
)
def test_a_model_that_fits_nowhere_is_a_warning(tmp_path, kind, right, wrong, off):
    raw = sighted(tmp_path, kind)
    raw.poses[0] = raw.poses[0].replace(right, wrong)
    ingested = ingest(raw)
    warning, *of_targets = ingested.warnings
    assert f" {off} " in warning
    # Exact targets keep their distances, which is told as well.
    assert ["were computed from one pose" in each for each in of_targets] == [True] * (
        kind == "points"
    )
    assert "signs and zeros of the joints" in warning
    assert not any("in the median" in note for note in ingested.notes)


def test_places_stated_for_other_targets_are_noted(tmp_path):
    raw = sighted(tmp_path, "points", targets=2)
    raw.description["tool"]["balls_mm"] = {"T1": [0, 0, 90], "C": [1, 2, 3]}
    notes = ingest(raw).notes
    assert "no columns of C, which tool.balls_mm places" in notes
    assert "tool.balls_mm does not place T2: all targets count as unplaced" in notes


def test_unknown_columns_are_noted(tmp_path):
    raw = sighted(tmp_path, "points", targets=1)
    with_columns(raw.poses, {"operator": "ab", "u_x_mm": 0.1, "load_kg": 2.0})
    notes = ingest(raw).notes
    assert "column operator of poses.csv is not used" in notes
    assert "column u_x_mm of poses.csv is not used" in notes
    hint = "(a load is read as load_N, in newtons)"
    assert f"column load_kg of poses.csv is not used {hint}" in notes


@pytest.mark.parametrize("kind", ["points", "distance"])
def test_repeatability_is_that_of_what_was_measured(tmp_path, kind):
    raw = sighted(tmp_path, kind, poses=60, repeats=4, noise_mm=0.1)
    found = repeatability_mm(ingest(raw).calibration)
    # The mean of a standard deviation of four readings is a little below sigma.
    expected = 0.1 * (np.sqrt(3) * 0.97 if kind == "points" else 0.92)
    assert found == {0.0: pytest.approx(expected, rel=0.12)}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_long_campaign_takes_seconds(tmp_path, kind):
    raw = sighted(tmp_path, kind, poses=12_000, noise_mm=0.05)
    begin = time.process_time()
    assert len(ingest(raw).observations) == 12_000
    assert time.process_time() - begin < 6.0


HELD = (
    "repeats the reading of the row before, though the arm moved: the instrument held its last one"
)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_in_which_the_instrument_held_its_last_reading_are_told_as_that(tmp_path, kind):
    raw = sighted(tmp_path, kind, robot="ur10")
    header = raw.poses[0].split(",")
    of_instrument = re.compile(r"(u_)?(T\d_)?([xyz]|d)_mm|q[wxyz]|T\d_mm")
    columns = [k for k, name in enumerate(header) if of_instrument.fullmatch(name)]
    rows = [
        index
        for index in range(5, len(raw.poses))
        if all(raw.poses[at].split(",")[k] for at in (index - 1, index) for k in columns)
    ][:1]
    for index in [*rows, rows[0] + 1]:  # and once more the same
        before, words = raw.poses[index - 1].split(","), raw.poses[index].split(",")
        for k in columns:
            words[k] = before[k]
        raw.poses[index] = ",".join(words)
    ingested = ingest(raw)
    assert listed(ingested) == [(index + 1, HELD) for index in (rows[0], rows[0] + 1)]
    told = wrong_rows(ingested.quarantined)
    assert {finding.what for finding in told} == {f"{HELD}; its rows are quarantined"}


def test_a_target_about_which_the_arm_turned_or_that_stood_still_is_no_held_reading():
    rng = np.random.default_rng(5)
    p_m = np.round(rng.normal(0.0, 0.5, (40, 1, 3)), 6)
    modelled = p_m + rng.normal(0.0, 1e-4, p_m.shape)
    p_m[7], modelled[7] = p_m[6], modelled[6] + 1e-4
    assert not held_last(p_m, modelled).any()
    p_m[9] = p_m[8]
    assert np.flatnonzero(held_last(p_m, modelled)[:, 0]).tolist() == [9]


def test_targets_that_are_one_reading_are_told(tmp_path):
    raw = sighted(tmp_path, "points", noise_mm=0.02)
    assert ingest(raw).warnings == ()
    copied = [raw.column(f"T2_{axis}_mm") for axis in "xyz"]
    for index, line in enumerate(raw.poses[1:], start=1):
        words = line.split(",")
        for k, axis in zip(copied, "xyz", strict=True):
            words[raw.column(f"T3_{axis}_mm")] = words[k]
        raw.poses[index] = ",".join(words)
    told, *_ = ingest(raw).warnings
    assert "T3 has the place of T2 in every row" in told


def test_targets_that_were_computed_from_one_pose_are_told(tmp_path):
    raw = sighted(tmp_path, "points", noise_mm=0.0)
    (warning,) = ingest(raw).warnings
    assert "T1, T2, T3 were computed from one pose" in warning


def contradicted(shift_m, noise_m=0.004):
    """Return places, the same by the nominal arm, and joints; row 7 has the joints of row 6."""
    rng = np.random.default_rng(6)
    modelled = rng.normal(0.0, 0.5, (40, 2, 3))
    near = rng.uniform(-900.0, 900.0, (40, 6))
    near[7], modelled[7] = near[6] + 0.2, modelled[6] + 2e-4
    places = modelled + rng.normal(0.0, noise_m, (40, 2, 3))
    places[7] = places[6] + [0.0, shift_m, 0.0]
    return places, modelled, near


def contradicted_by_the_arm(places, modelled, near, load):
    """Return the rows of which all targets are off those of their like."""
    off = off_its_like(places, modelled, *alike(near, load))
    assert (off.all(axis=1) == off.any(axis=1)).all()
    return np.flatnonzero(off.any(axis=1)).tolist()


def test_of_two_rows_with_the_same_joints_the_one_is_off_that_the_arm_contradicts():
    places, modelled, near = contradicted(0.06)
    load = np.zeros(40)
    assert contradicted_by_the_arm(places, modelled, near, load) == [7]
    assert contradicted_by_the_arm(places, modelled, near, np.arange(40.0)) == []
    far = near + 10.0 * np.arange(40)[:, None]
    assert contradicted_by_the_arm(places, modelled, far, load) == []
    below_the_limit_of_repeats, as_others_are = (
        contradicted(0.008),
        contradicted(0.03, noise_m=0.02),
    )
    assert contradicted_by_the_arm(*below_the_limit_of_repeats, load) == []
    assert contradicted_by_the_arm(*as_others_are, load) == []


def test_a_row_that_another_row_contradicts_is_quarantined(tmp_path):
    raw = sighted(tmp_path, "points", noise_mm=4.0)
    kind = raw.column("kind")
    row = next(k for k, line in enumerate(raw.poses) if line.split(",")[kind] == "holdout")
    before, words = raw.poses[row - 1].split(","), raw.poses[row].split(",")
    for name in raw.poses[0].split(","):
        k = raw.column(name)
        if name.startswith("q"):
            words[k] = before[k]
        elif name.endswith("_x_mm"):
            words[k] = repr(float(before[k]) + 70.0) if before[k] else ""
        elif name.endswith(("_y_mm", "_z_mm")):
            words[k] = before[k]
    raw.poses[row] = ",".join(words)
    assert listed(ingest(raw)) == [(row + 1, OFF_REPEATS)]
