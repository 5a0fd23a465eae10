"""What a user states of a file that stays as it is: signs, offsets, rows left out, places."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import sighted
from mended import describe, findings, mend, simulated
from pa10cal import calibrate
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

JOINTS = [f"q{k}_deg" for k in range(1, 7)]


@pytest.fixture
def raw(tmp_path):
    return sighted(tmp_path, "pose", repeats=3, noise_mm=0.02)


def read(raw, **stated):
    raw.description |= stated
    return read_campaign(raw.write())


def unlabelled():
    """Return the columns of `UNLABELLED` as campaign.yaml states them."""
    return {
        key: each if isinstance(each, dict) else {"names": each} for key, each in UNLABELLED.items()
    }


def changed(raw, change) -> None:
    """Change the joint positions of every row: `change` takes and returns (6,) degrees."""
    at = [raw.column(name) for name in JOINTS]
    for k, line in enumerate(raw.poses[1:], start=1):
        row = line.split(",")
        q_deg = change(np.array([float(row[j]) for j in at]), k)
        for j, value in zip(at, q_deg, strict=True):
            row[j] = f"{value:.9f}"
        raw.poses[k] = ",".join(row)


#: The file's columns but for labels, which are then made of the joint positions.
UNLABELLED = {
    "time": "time_s",
    "kind": "kind",
    "joints": JOINTS,
    "position": ["x_mm", "y_mm", "z_mm"],
    "rotation": {"names": ["qw", "qx", "qy", "qz"], "convention": "quaternion_wxyz"},
}


def test_signs_and_offsets_of_joints_are_taken_out(raw):
    right = read(raw)
    signs, offsets = [1, -1, 1, 1, -1, 1], [0.0, 90.0, 0.0, -12.5, 0.0, 3.0]
    changed(raw, lambda q_deg, _: (q_deg - offsets) * signs)
    with pytest.raises(Pa10calError):
        read(raw, joint_signs=[1, -1])
    mended = read(raw, joint_signs=signs, joint_offsets_deg=offsets)
    np.testing.assert_allclose(
        mended.observations.states.q_rad, right.observations.states.q_rad, atol=1e-9
    )


def test_joints_that_count_turns_are_brought_back_where_the_nominal_arm_agrees(raw):
    right = read(raw)
    rng = np.random.default_rng(2)
    changed(raw, lambda q_deg, _: q_deg + 360.0 * rng.integers(-3, 4, 6))
    mended = read(raw)
    turns = (mended.observations.states.q_rad - right.observations.states.q_rad) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert mended.quarantined == ()
    assert any("angles are moved by whole turns" in note for note in mended.notes)


def test_rows_that_exchanged_joints_put_beyond_limits_are_read_and_the_joints_told(tmp_path):
    raw = sighted(tmp_path, "pose", robot="irb120", noise_mm=0.02)
    changed(raw, lambda q_deg, _: q_deg[[2, 1, 0, 3, 4, 5]])
    assert max(float(line.split(",")[raw.column("q3_deg")]) for line in raw.poses[1:]) > 80.0
    assert read(raw).quarantined == ()
    (found,) = findings(raw.folder)
    assert (found.kind, found.where) == ("joint_order", "q1, q3")


def test_numbers_far_beyond_limits_that_do_not_fit_then_stay(raw):
    changed(raw, lambda q_deg, _: 57.3 * q_deg)
    with pytest.raises(Pa10calError, match="beyond the limits"):
        read(raw)


def test_coupled_joints_are_those_of_the_arm_and_commands_those_of_the_controller(raw):
    right = read(raw)
    changed(raw, lambda q_deg, _: q_deg - 1.0 * q_deg[1] * np.eye(6)[2])
    stated = [{"joint": 3, "by": 2, "factor": 1, "counted_only": True}]  # its springs stay
    mended = read(raw, coupling=stated)
    q_rad = mended.observations.states.q_rad
    np.testing.assert_allclose(q_rad, right.observations.states.q_rad, atol=1e-9)
    assert mended.quarantined == ()
    model = calibrate(mended)
    logged_rad = mended.arm.coupling.to_axes(q_rad)
    assert np.abs(logged_rad - q_rad).max() > 0.1
    plain = calibrate(right)
    T = model.predict(logged_rad).T
    assert np.abs(T - plain.predict(q_rad).T).max() < 1e-9
    found = model.compensate(T, seed=logged_rad)
    np.testing.assert_allclose(found.q, logged_rad, atol=1e-6)
    with pytest.raises(Pa10calError, match="coupling, entry 1"):
        read(raw, coupling=[{"joint": 7, "by": 2, "factor": 1}])


def test_directions_of_arrival_are_those_of_coupled_joints(tmp_path):
    folder = simulated(tmp_path / "c", "pa10_6ce", "touches")
    right = read_campaign(folder).observations

    def logged(table):
        q_deg = table.numbers(JOINTS)
        table.put(JOINTS, q_deg - 0.5 * q_deg[:, [1]] * np.eye(6)[2])

    mend(folder, "resolver.csv.gz", logged)
    describe(folder, "coupling", [{"joint": 3, "by": 2, "factor": 0.5}])
    mended = read_campaign(folder).observations
    np.testing.assert_allclose(mended.states.q_rad, right.states.q_rad, atol=1e-9)
    np.testing.assert_array_equal(mended.states.arrival, right.states.arrival)


@pytest.mark.slow
def test_touched_balls_that_a_coupling_explains_are_kept(tmp_path):
    """Joint 4 moves in three poses alone: as logged these are far off, and they are right."""
    extra = [[20, 20, 80, 60, 50, -60], [-30, 10, 100, -50, 40, -100], [10, 30, 70, 80, 60, -90]]
    poses = {"tilt_rad": [0.0, 0.0, 0.0], "extra_deg": extra}
    folder = simulated(tmp_path / "c", "pa10_6ce", "touches", poses=poses)
    right = read_campaign(folder)

    def logged(table):
        q_deg = table.numbers(JOINTS)
        table.put(JOINTS, q_deg - q_deg[:, [3]] * np.eye(6)[4])

    mend(folder, "resolver.csv.gz", logged)
    assert len(read_campaign(folder).observations) == len(right.observations)
    (found,) = (each for each in findings(folder) if each.kind == "joint_coupling")
    assert "coupling: [{joint: 5, by: 4, factor: 1}]" in found.remedy


def test_bounds_are_told_in_the_number_of_the_file(raw):
    changed(raw, lambda q_deg, k: q_deg + 720.0 * (k == 4) * np.eye(6)[2])
    turned = read(raw, joint_signs=[1, 1, -1, 1, 1, 1])
    (row,) = turned.quarantined
    assert float(row.value.split(" = ")[1].split()[0]) > 360.0


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("where", "left_out"),
    [
        ("P003", 3),
        ("pose P003, 0 N, repeat 2", 1),
        ("P003, repeat 2", 1),
        ("line 7", 1),
        ("lines 7 to 9", 3),
        ("lines 7-9", 3),
        ("poses.csv:7", 1),
        ("raw/poses.csv:7", 1),
        ("poses.csv: line 7", 1),
        ("poses.csv: pose P003, 0 N, repeat 2", 1),
    ],
)
def test_rows_are_excluded_with_the_reason_that_is_stated(raw, where, left_out):
    found = read(raw, exclude=[{"where": where, "why": "the tracker was bumped"}])
    assert [row.reason for row in found.quarantined] == left_out * [
        "excluded: the tracker was bumped"
    ]
    assert len(found.observations) == 120 - left_out
    assert not found.wrong_rows


@pytest.mark.parametrize("both", [("P003", "P003, repeat 2"), ("P003, repeat 2", "P003")])
def test_a_reading_may_be_excluded_twice_and_has_the_first_reason(raw, both):
    exclude = [{"where": where, "why": why} for where, why in zip(both, "ab", strict=True)]
    reasons = [row.reason for row in read(raw, exclude=exclude).quarantined]
    assert (reasons.count("excluded: a"), reasons.count("excluded: b")) == (
        (3, 0) if both[0] == "P003" else (1, 2)
    )


def test_a_label_with_a_colon_is_no_line_of_a_file(raw):
    raw.poses[:] = [line.replace("P003", "S1:40") for line in raw.poses]
    found = read(raw, exclude=[{"where": "S1:40", "why": "bumped"}])
    assert len(found.quarantined) == 3
    assert "S1:40" not in found.observations.pose


@pytest.mark.parametrize(
    ("where", "label"),
    [("pose 5", "pose 5"), ("pose pose 5", "pose 5"), ("5", "5"), ("pose P006", "P006")],
)
def test_a_label_may_begin_with_the_word_that_messages_put_before_it(raw, where, label):
    raw.poses[:] = [line.replace("P003", "pose 5").replace("P004", "5") for line in raw.poses]
    found = read(raw, exclude=[{"where": where, "why": "bumped"}])
    assert [row.value for row in found.quarantined] == 3 * [label]


def test_a_label_may_have_commas(raw):
    raw.poses[:] = [line.replace("P003", '"3, 0"') for line in raw.poses]
    for where, count in (("3, 0", 3), ("pose 3, 0, 0 N, repeat 2", 1)):
        found = read(raw, exclude=[{"where": where, "why": "bumped"}])
        assert [row.value for row in found.quarantined] == count * ["3, 0"]


def test_labels_that_are_counted_without_excluded_lines_are_told(raw):
    def excluded(*where):
        exclude = [{"where": each, "why": "bumped"} for each in where]
        found = read(raw, columns={"poses": unlabelled()}, exclude=exclude)
        told = [text for text in found.warnings if "counted without" in text]
        return sorted(row.line for row in found.quarantined), told

    assert excluded("P00004") == ([5, 45, 85], [])
    lines, (told,) = excluded("line 3", "P00004")
    assert lines == [3, 6, 46, 86]
    assert "P00004 is line 6, 46, 86 of poses.csv, as labels" in told
    assert "are counted without line 3: if another row is meant, state its line" in told


def test_no_other_label_is_excluded_for_one_that_is_not_there(raw):
    raw.poses[:] = [line.replace("P003", "pose 5") for line in raw.poses]
    with pytest.raises(Pa10calError, match="nothing is there"):
        read(raw, exclude=[{"where": "5", "why": "bumped"}])


def test_excluded_rows_may_be_many_and_unreadable(raw):
    for k in range(1, 61):
        raw.poses[k] = raw.poses[k].replace(",grid,", ",?,", 1)
    with pytest.raises(Pa10calError, match=r"of 120 rows would be quarantined"):
        read(raw)
    found = read(raw, exclude=[{"where": "lines 2 to 61", "why": "warming up"}])
    assert len(found.quarantined) == 60
    assert len(found.observations) == 60


def test_a_reading_that_is_excluded_by_its_label_need_not_be_readable(raw):
    (row, *_) = (k for k, line in enumerate(raw.poses) if ",P003," in line)
    cells = raw.poses[row].split(",")
    cells[raw.column("q2_deg")] = "9999"
    raw.poses[row] = ",".join(cells)
    repeat = cells[raw.column("repeat")]
    found = read(raw, exclude=[{"where": f"P003, 0 N, repeat {repeat}", "why": "a bad read-back"}])
    assert [row.reason for row in found.quarantined] == ["excluded: a bad read-back"]


def test_an_exclusion_that_meets_nothing_is_refused(raw):
    words = ("P999", "line 999", "pose P003, 0 N, repeat 9", "P003, 0-50 N", "joints.csv:7")
    for where in words:
        with pytest.raises(Pa10calError, match=rf"exclude: nothing is there .*{where}.*poses.csv"):
            read(raw, exclude=[{"where": where, "why": "none"}])


def test_excluding_every_row_is_refused(raw):
    with pytest.raises(Pa10calError, match=r"every row is excluded.*correct exclude"):
        read(raw, exclude=[{"where": "lines 2 to 999", "why": "all bad"}])


def test_repeats_are_known_by_the_scatter_of_what_is_read_back(raw):
    rng = np.random.default_rng(5)
    changed(raw, lambda q_deg, _: q_deg + rng.uniform(-0.002, 0.002, 6))
    found = read(raw, columns={"poses": unlabelled()}).observations
    assert len(set(found.pose)) == 40
    assert sorted(set(found.repeat)) == [1, 2, 3]
    assert len(set(read(raw, repeat_tolerance_deg=1e-4).observations.pose)) == 120


def test_repeats_of_a_place_are_never_on_both_sides(raw):
    at = raw.column("pose"), raw.column("repeat"), raw.column("kind")
    for k, line in enumerate(raw.poses[1:], start=1):
        row = line.split(",")
        row[at[0]], row[at[1]], row[at[2]] = f"R{k}", "1", "grid"  # every row under its own label
        raw.poses[k] = ",".join(row)
    every = read(raw, holdout={"every": 5}).observations
    assert len(set(every.pose)) == 120
    sides = {tuple(q): set() for q in every.states.q_rad.round(9)}
    for q, kind in zip(every.states.q_rad.round(9), every.kind, strict=True):
        sides[tuple(q)].add(kind)
    assert len(sides) == 40
    assert all(len(kinds) == 1 for kinds in sides.values())
    assert sum(kinds == {"holdout"} for kinds in sides.values()) == 8


def test_held_out_places_that_are_calibrated_with_too_are_told(raw):
    assert not read(raw).warnings
    raw.poses[-1] = raw.poses[-1].replace(",holdout,P039,", ",grid,other,")
    assert any("held-out poses at joint positions" in text for text in read(raw).warnings)
