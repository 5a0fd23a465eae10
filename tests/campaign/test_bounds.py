"""Every column and key has bounds; what lies outside is left out or refused, by name."""

from __future__ import annotations

import gzip
import inspect
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mended import QUATERNION, describe, mend, simulated
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.campaign import csv_rows, text_lines
from pa10cal.campaign.bounds import (
    bound_of,
    in_words,
    only_labelled_rows,
    only_whole_numbers,
    refuse_impossible_gravity,
    refuse_impossible_tool,
    unwrapped,
    within_bounds,
)
from pa10cal.campaign.column_map import FACTORS, OFFSETS, ColumnMap, OwnColumn
from pa10cal.campaign.csv_rows import read_rows
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.target_labels import (
    exchanged,
    exchanged_by_distances,
    not_rigid,
    stated_shape,
)
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm

ONE, ALL = slice(5, 6), slice(None)


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    """Right campaigns of each instrument, to be copied."""
    folder = tmp_path_factory.mktemp("right")
    return {
        instrument: simulated(folder / instrument, robot, instrument)
        for instrument, robot in (
            ("pose", "ur10"),
            ("points", "irb120"),
            ("distance", "iiwa14"),
            ("touches", "pa10_6ce"),
        )
    }


@pytest.fixture
def copy(right, tmp_path):
    def copied(instrument):
        folder = tmp_path / instrument
        folder.mkdir()
        for path in right[instrument].iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        return folder

    return copied


def test_right_campaigns_lose_no_row(right):
    for folder in right.values():
        campaign = read_campaign(folder)
        assert (campaign.quarantined, campaign.warnings) == ((), ())


IRB = [f"q{k}_deg" for k in range(1, 7)]


@pytest.mark.parametrize("first", [0.0, -360.0])
def test_angles_logged_within_one_turn_are_moved_into_the_limits(copy, first):
    folder = copy("points")
    before = read_campaign(folder).observations.states.q_rad

    def wrap(table):
        table.put(IRB, first + np.mod(table.numbers(IRB) - first, 360.0))

    mend(folder, "poses.csv", wrap)
    found = read_campaign(folder)
    np.testing.assert_allclose(found.observations.states.q_rad, before, atol=1e-9)
    (note,) = (each for each in found.notes if " by whole turns" in each)
    assert "q2_deg" in note


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("failed", ["-9999", "9999", "1e154"])
def test_one_number_of_a_sensor_that_failed_does_not_hide_wrapped_angles(copy, failed):
    folder = copy("points")

    def wrap(table):
        table.put(IRB, np.mod(table.numbers(IRB), 360.0))
        table.fill("q1_deg", failed, ONE)

    before = read_campaign(folder).observations.states.q_rad
    mend(folder, "poses.csv", wrap)
    found = read_campaign(folder)
    (note,) = (each for each in found.notes if " by whole turns" in each)
    assert "q1_deg" in note
    (row,) = found.quarantined
    assert row.line == 7
    assert "beyond the limits of joint 1" in row.reason
    np.testing.assert_allclose(
        found.observations.states.q_rad, np.delete(before, 5, axis=0), atol=1e-9
    )


def test_only_joints_that_are_moved_by_turns_are_noted():
    angles = np.zeros((3, 6))
    angles[:, 0], angles[1, 1] = [350.0, 340.0, 10.0], np.nan
    columns = dict(zip(IRB, angles.T, strict=True))
    rows = RawRows("log.csv", columns, np.arange(3), {}, (), ())
    found = unwrapped(rows, IRB, load_arm("irb120"))
    assert found.notes == (
        "log.csv: q1_deg: angles logged within one turn are moved by whole turns, into the limits",
    )
    np.testing.assert_array_equal(found["q1_deg"], [-10.0, -20.0, 10.0])


@pytest.mark.parametrize(("factor", "is_moved"), [(0.5, False), (1.0, True)])
def test_an_axis_is_moved_by_turns_only_if_that_leaves_the_pose(factor, is_moved):
    """Half a turn of the joint that it moves too would be another pose."""
    arm = replace(load_arm("irb120"), coupled=(CoupledJoint(6, 4, factor),))
    angles = np.zeros((9, 6))
    angles[:, 3] = np.linspace(20.0, 260.0, 9)
    rows = RawRows("log.csv", dict(zip(IRB, angles.T, strict=True)), np.arange(9), {}, (), ())
    found = unwrapped(rows, IRB, arm)
    assert bool(found.notes) == is_moved
    assert np.array_equal(found["q4_deg"], angles[:, 3]) != is_moved


def test_one_row_a_turn_off_stays_so(copy):
    folder = copy("points")
    mend(folder, "poses.csv", lambda table: table.fill("q2_deg", "359.5", ONE))
    found = read_campaign(folder)
    assert len(found.quarantined) == 1
    assert not any(" by whole turns" in note for note in found.notes)


@pytest.mark.parametrize("times", [10.0, 57.3])
def test_numbers_of_more_than_a_turn_are_no_angles_within_one(copy, times):
    folder = copy("points")
    mend(
        folder,
        "poses.csv",
        lambda table: table.put(IRB, times * np.mod(table.numbers(IRB), 360.0)),
    )
    with pytest.raises(Pa10calError, match="beyond the limits of joint"):
        read_campaign(folder)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("instrument", "column", "text", "reason"),
    [
        ("pose", "q2_deg", "100000", "beyond the limits of joint 2 in the description of ur10"),
        ("pose", "q2_deg", "-1e154", "beyond the limits of joint 2"),
        ("points", "q3_deg", "90", "beyond the limits of joint 3 in the description of irb120"),
        ("pose", "load_N", "1e6", "a load beyond any arm's"),
        ("pose", "time_s", "1e154", "a time beyond any clock"),
        ("pose", "time_s", "1.7e12", "a time beyond any clock"),
        ("pose", "repeat", "1e154", "a number beyond any count"),
        ("pose", "x_mm", "1e154", "a coordinate beyond any measuring volume"),
        ("pose", "qx", "1e154", "the quaternion is not of unit length"),
        ("pose", "u_x_mm", "1e154", "a stated uncertainty above 1000"),
        ("pose", "u_x_mm", "1e-154", "the stated uncertainty is not above zero"),
        ("pose", "u_qx", "1e6", "a stated uncertainty above 1"),
        ("pose", "u_q2_deg", "1e6", "a stated uncertainty above 90"),
        ("pose", "temperature_C", "1e3", "a temperature outside -60 to 150"),
        ("points", "T1_x_mm", "-1e154", "a coordinate beyond any measuring volume"),
        ("distance", "d_mm", "1e154", "a coordinate beyond any measuring volume"),
        ("distance", "d_mm", "-5", "not above"),
    ],
)
def test_one_number_out_of_bounds_is_left_out(copy, instrument, column, text, reason):
    folder = copy(instrument)
    mend(folder, "poses.csv", lambda table: table.fill(column, text, ONE))
    (row,) = read_campaign(folder).quarantined
    assert row.line == 7
    assert reason in row.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "column", "text", "reason"),
    [
        ("resolver.csv.gz", "tau2_Nm", "1e154", "a torque beyond that of any arm"),
        ("resolver.csv.gz", "q2_deg", "1e5", "beyond the limits of joint 2"),
        ("resolver.csv.gz", "time_s", "1e154", "a time beyond any clock"),
        ("cmm.csv.gz", "x_mm", "1e154", "a coordinate beyond"),
        ("cmm.csv.gz", "touch", "1e154", "a number beyond any count"),
    ],
)
def test_one_number_of_a_log_out_of_bounds_is_left_out(copy, file, column, text, reason):
    folder = copy("touches")
    mend(folder, file, lambda table: table.fill(column, text, ONE))
    assert any(reason in row.reason and row.line == 7 for row in read_campaign(folder).quarantined)


@pytest.mark.parametrize(
    ("column", "text", "message"),
    [
        ("q3_deg", "n/a", r"60 of 60 .*not a finite number \(got \"q3_deg = 'n/a'\"\).*q3_deg"),
        ("u_q2_deg", "1e6", r"60 of 60 .*a stated uncertainty above 90 \(got 'u_q2_deg"),
        ("temperature_C", "293.15", r"looks like kelvin .*subtract 273.15"),
        ("pose", "P", r"another configuration has this pose, load and repeat"),
    ],
)
def test_a_wrong_column_is_refused_by_name(copy, column, text, message):
    folder = copy("pose")
    mend(folder, "poses.csv", lambda table: table.fill(column, text))
    with pytest.raises(Pa10calError, match=message):
        read_campaign(folder)


def test_a_wrong_zero_of_a_joint_is_not_taken_for_another_unit(copy):
    folder = copy("points")
    describe(folder, "joint_offsets_deg", [0, 0, 150, 0, 0, 0])
    with pytest.raises(Pa10calError, match=r"beyond the limits of joint 3.*joint_offsets_deg"):
        read_campaign(folder)


@pytest.mark.parametrize("sign", [1, -1])
def test_degrees_stated_as_radians_are_told_with_joints_of_either_sign(copy, sign):
    folder = copy("points")
    mend(folder, "poses.csv", lambda table: table.put(IRB, sign * table.numbers(IRB)))
    columns = {
        "time": {"names": "time_s"},
        "kind": {"names": "kind", "words": {}},
        "joints": {"names": IRB, "unit": "rad"},
        "targets": {
            name: {"names": [f"{name}_{axis}_mm" for axis in "xyz"], "unit": "mm"}
            for name in ("T1", "T2", "T3")
        },
    }
    describe(folder, "columns", {"poses": columns})
    describe(folder, "joint_signs", [sign] * 6)
    with pytest.raises(Pa10calError, match=r"look like degrees.*columns.poses.joints.unit: deg"):
        read_campaign(folder)


@pytest.mark.parametrize(
    ("angle", "stroke", "said"),
    [
        (
            1.0,
            120.0,
            r"`C` \(`q3`\): the strokes look like millimetres.*joints.stroke_unit: mm",
        ),
        (57.0, 0.12, r"`A` \(`q1`\).*: the joint angles look like degrees.*poses.joints.unit: deg"),
    ],
)
def test_angles_and_strokes_are_judged_by_their_own_units(angle, stroke, said):
    """Joints 1, 2 and 4 of the SCARA turn, stated in radians; joint 3 slides, stated in metres."""
    numbers = {"q1_deg": angle, "q2_deg": angle, "q3_mm": -stroke, "q4_deg": angle}
    units = {name: ("rad", 57.3) if "deg" in name else ("m", 1e3) for name in numbers}
    own = {
        name: OwnColumn((letter,), *units[name], key="columns.poses.joints")
        for name, letter in zip(numbers, "ABCD", strict=True)
    }
    columns = {name: np.full(9, units[name][1] * number) for name, number in numbers.items()}
    rows = RawRows("t.csv", columns, np.arange(9), {}, (), (), own=ColumnMap(own))
    with pytest.raises(Pa10calError, match=said):
        within_bounds(rows, list(numbers), load_arm("gx4_351s"))


@pytest.mark.parametrize(
    ("unit", "number", "is_kelvin"),
    [("F", 293.0, True), ("C", 293.0, True), ("K", 293.0, False), ("F", 500.0, False)],
)
def test_kelvin_is_told_by_the_numbers_of_the_file(unit, number, is_kelvin):
    factor, offset = FACTORS[unit], OFFSETS.get(unit, 0.0)
    own = ColumnMap({"temperature_C": OwnColumn(("T",), unit, factor, offset, "temperature")})
    columns = {"temperature_C": np.full(9, factor * number + offset)}
    rows = RawRows("t.csv", columns, np.arange(9), {}, (), (), own=own)
    if not is_kelvin:
        found = within_bounds(rows, ["temperature_C"], load_arm("irb120"))
        assert len(found) == (9 if unit == "K" else 0)
        return
    with pytest.raises(Pa10calError, match=r"looks like kelvin \(got 293.*temperature.unit: K"):
        within_bounds(rows, ["temperature_C"], load_arm("irb120"))


@pytest.mark.filterwarnings("error")
def test_a_joint_without_limits_has_no_angles_to_move():
    arm = load_arm("irb120")
    limits = np.array(arm.limits_rad)
    limits[0] = [-np.inf, np.inf]
    arm = replace(arm, limits_rad=limits)
    columns = {name: np.linspace(-400.0, 400.0, 9) for name in IRB[:1]}
    rows = RawRows("t.csv", columns, np.arange(9), {}, (), ())
    assert unwrapped(rows, IRB[:1], arm) is rows


def test_a_number_that_is_not_whole_is_shown_with_all_its_digits():
    rows = RawRows("t.csv", {"repeat": np.array([1.0, 1234567.5])}, np.arange(2), {}, (), ())
    (lost,) = only_whole_numbers(rows, "repeat", load_arm("irb120")).quarantined
    assert lost.value == "repeat = 1234567.5"


def test_many_columns_with_a_number_out_of_bounds_are_left_out_one_by_one():
    count, steps = 60, 30
    names = [f"base{k}_x_mm" for k in range(count)]
    columns = {name: np.where(np.arange(count) == k, 1e9, 0.0) for k, name in enumerate(names)}
    rows = RawRows("t.csv", columns, np.arange(count), {}, (), ())
    most = sys.getrecursionlimit()
    sys.setrecursionlimit(len(inspect.stack(0)) + steps)
    try:
        found = within_bounds(rows, names, load_arm("irb120"))
    finally:
        sys.setrecursionlimit(most)
    assert [row.value for row in found.quarantined] == [f"{name} = 1000000000" for name in names]


def test_a_row_without_a_load_is_left_out():
    columns = {"load_N": [0.0, np.nan], "repeat": [1.0, 1.0], "pose": ["P1", "P2"]}
    arrays = {name: np.array(column) for name, column in columns.items()}
    found = only_labelled_rows(
        RawRows("t.csv", arrays, np.arange(2), {}, (), ()), load_arm("irb120")
    )
    assert found.line.tolist() == [0]


@pytest.mark.parametrize("name", ["a(b", r"x\1", "foo+", "u_mm"])
def test_a_column_outside_the_contract_is_its_name_in_words(name):
    assert in_words(name) == name


def test_a_tool_is_not_weighed_against_placeholders_for_the_masses_of_an_arm():
    arm = load_arm("iiwa14")
    for mass_kg in (0.0, 1e-3):
        refuse_impossible_tool(0.5, replace(arm, mass_kg=np.full(arm.n, mass_kg)), "c")
    with pytest.raises(Pa10calError, match=r"the mass of the arm itself.*mass_kg: 0.5 if"):
        refuse_impossible_tool(500.0, arm, "c")
    unit_masses = replace(arm, mass_kg=np.ones(arm.n))
    with pytest.raises(Pa10calError, match=r"or correct the masses of the links .* of iiwa14"):
        refuse_impossible_tool(8.0, unit_masses, "c")


@pytest.mark.parametrize("size", [0.0, 1e-3, 1.62, 3.71, 9.81, 24.8])
def test_gravity_may_be_that_of_another_place_than_the_earth(size):
    refuse_impossible_gravity((size, 0.0, 0.0), "c")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("gravity_m_s2", [0, 0, -98.1], r"gravity is of another size"),
        ("gravity_m_s2", [0, 0, -9810], r"gravity is in mm/s2 .*9.5 to 10.1"),
        ("gravity_m_s2", [0, 0, -1], r"gravity is in units of g"),
        (
            "gravity_m_s2",
            [0, 0, -1e154],
            r"gravity is of another size.*\[0, 0, -9.80665\] for a base that",
        ),
        ("reference_temperature_C", 293.15, r"looks like kelvin"),
        ("reference_temperature_C", 1e154, r"no temperature of a laboratory"),
        ("tool.mass_kg", 1500, r"heavier .*set tool.mass_kg: 1.5 if the mass is in grams"),
        ("tool.com_mm", [0, 1e154, 0], r"tool.com_mm.1"),
        ("tool.load_point_mm", [0, 1e154, 0], r"tool.load_point_mm.1"),
        ("instrument.uncertainty_mm", 1e154, r"less than or equal to 1000"),
        ("instrument.uncertainty_mm", 1e-154, r"greater than 0.000000001"),
    ],
)
def test_a_key_out_of_bounds_is_refused(copy, key, value, message):
    folder = copy("pose")
    describe(folder, key, value)
    with pytest.raises(Pa10calError, match=message):
        read_campaign(folder)


def test_without_gravity_a_note_tells_that_no_springs_are_fitted(copy):
    folder = copy("points")
    describe(folder, "gravity_m_s2", [0, 0, 0])
    found = read_campaign(folder)
    assert "no torques logged, gravity not stated: no springs are fitted" in found.notes


def test_a_tool_in_grams_is_refused_without_masses_of_the_arm_too(copy):
    folder = copy("points")
    describe(folder, "tool.mass_kg", 1500)
    with pytest.raises(Pa10calError, match="in grams"):
        read_campaign(folder)


def test_one_attitude_for_all_rows_is_refused(copy):
    folder = copy("pose")
    mend(folder, "poses.csv", lambda table: [table.fill(name, "0") for name in QUATERNION[1:]])
    mend(folder, "poses.csv", lambda table: table.fill("qw", "1"))
    with pytest.raises(Pa10calError, match="every row has the same orientation"):
        read_campaign(folder)


def test_one_label_for_two_configurations_is_told_from_a_row_read_twice(copy):
    folder = copy("pose")

    def change(table):
        for name in ("kind", "pose", "repeat"):
            table.rows[6][table.header.index(name)] = table.rows[5][table.header.index(name)]
        again = list(table.rows[9])
        again[table.header.index("time_s")] = "90000"
        table.rows.append(again)

    mend(folder, "poses.csv", change)
    reasons = {row.line: row.reason for row in read_campaign(folder).quarantined}
    assert "another configuration has this pose" in reasons[8]
    assert reasons[62] == "this configuration was read before"


@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
def test_held_out_rows_are_screened(copy, instrument):
    folder = copy(instrument)
    column = {"pose": "y_mm", "points": "T1_y_mm", "distance": "d_mm"}[instrument]

    def change(table):
        last = table.rows[-2]
        assert last[table.header.index("kind")] == "holdout"
        at = table.header.index(column)
        last[at] = repr(float(last[at]) + 40.0)

    mend(folder, "poses.csv", change)
    assert len(read_campaign(folder).quarantined) == 1


def exchange(first, second, rows):
    def change(table):
        columns = [
            [table.header.index(f"{t}_{axis}_mm") for axis in "xyz"] for t in (first, second)
        ]
        for row in table.rows[rows]:
            for one, other in zip(*columns, strict=True):
                row[one], row[other] = row[other], row[one]

    return change


def test_targets_exchanged_in_many_poses_are_told_by_their_distances():
    """Motion capture exchanges the labels of markers, in nine of 21 poses of a measured arm."""
    rng = np.random.default_rng(5)
    body_m = np.array([[0.0, 0.0, 0.0], [0.143, 0.0, 0.0], [0.03, 0.04, 0.0]])
    R = Rotation.random(21, random_state=rng).as_matrix()
    p_m = np.einsum("pij,bj->pbi", R, body_m) + rng.uniform(-1.0, 1.0, (21, 1, 3))
    p_m += rng.normal(0.0, 5e-4, p_m.shape)
    swapped = np.arange(21) % 7 < 3
    p_m[swapped] = p_m[swapped][:, [1, 0, 2]]
    p_m[20, 2] = np.nan  # a pose in which one was not seen stays
    orders = exchanged_by_distances(p_m)
    assert [order for order in orders if order is not None] == [(1, 0, 2)] * 9
    assert [order is not None for order in orders] == swapped.tolist()
    rigid = p_m[~swapped]
    assert not any(exchanged_by_distances(rigid))
    assert not any(exchanged_by_distances(p_m[:, :2]))  # of two no distance tells


def test_exchanged_targets_are_named(copy):
    folder = copy("points")
    mend(folder, "poses.csv", exchange("T1", "T3", ONE))
    (row,) = read_campaign(folder).quarantined
    assert (row.line, row.value) == (7, "T1 and T3")
    assert row.reason == "the labels of these targets are exchanged"


def test_a_target_off_the_others_is_named(copy):
    folder = copy("points")

    def change(table):
        at = table.header.index("T2_z_mm")
        table.rows[5][at] = repr(float(table.rows[5][at]) + 3.0)

    mend(folder, "poses.csv", change)
    (row,) = read_campaign(folder).quarantined
    assert row.reason == "its distances from the other targets are not those of the other poses"
    assert row.value.startswith("T2_x_mm")


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("first", "second"), [("A", "B"), ("B", "C")])
def test_exchanged_balls_are_named_whatever_the_exchange(copy, first, second):
    folder = copy("touches")
    swap = {first: second, second: first}

    def change(table):
        at = table.header.index("ball")
        keys = [
            tuple(row[table.header.index(k)] for k in ("pose", "load_N", "repeat"))
            for row in table.rows
        ]
        for row, key in zip(table.rows, keys, strict=True):
            if key == keys[600]:
                row[at] = swap.get(row[at], row[at])

    mend(folder, "cmm.csv.gz", change)
    read = read_campaign(folder)
    reasons = [row.reason for row in read.quarantined]
    named = f"the labels of these targets are exchanged: {first} and {second}"
    assert reasons.count(named) >= 12
    (finding,) = read.wrong_rows  # which may be excluded by the words that name it
    describe(folder, "exclude", [{"where": finding.where, "why": "exchanged"}])
    again = read_campaign(folder)
    assert not again.wrong_rows
    assert len(again.observations) == len(read.observations)


def test_balls_exchanged_in_the_description_are_named(copy):
    folder = copy("touches")
    describe(folder, "tool.balls_mm", lambda balls: {**balls, "A": balls["B"], "B": balls["A"]})
    with pytest.raises(Pa10calError, match="balls A and B seem exchanged"):
        read_campaign(folder)


@pytest.mark.parametrize("share", [0.04, 0.7])
def test_a_log_cut_short_says_how_many_configurations_are_missing(copy, share):
    folder = copy("touches")
    mend(
        folder,
        "resolver.csv.gz",
        lambda table: table.rows.__delitem__(slice(int(share * len(table.rows)), None)),
    )
    with pytest.raises(Pa10calError, match=r"cut short \(got '\d+ of \d+ configurations"):
        read_campaign(folder)


def test_touches_cut_short_say_how_many_configurations_may_be_missing(copy):
    folder = copy("touches")
    mend(
        folder,
        "cmm.csv.gz",
        lambda table: table.rows.__delitem__(slice(int(0.5 * len(table.rows)), None)),
    )
    (warning,) = read_campaign(folder).warnings
    assert "cmm.csv.gz seems cut short" in warning
    assert "unless the arm only waited there" in warning


def test_large_files_are_refused_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(text_lines, "LARGEST_BYTES", 10_000)
    text = b"a,b\n" + b"1,2\n" * 3000
    for name, content in (("t.csv", text), ("t.csv.gz", gzip.compress(text))):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(Pa10calError, match=r"larger than is read .*at most 0 MB"):
            read_rows(tmp_path / name, ["a", "b"])


def test_rows_are_the_same_in_whatever_parts_they_are_read(tmp_path, monkeypatch):
    lines = [f"{k},{'x' if k % 7 == 3 else k / 3}" for k in range(50)]
    (tmp_path / "t.csv").write_text("a,b\n" + "\n".join(lines) + "\n")
    whole = read_rows(tmp_path / "t.csv", ["a", "b"]).finite(["a", "b"])
    monkeypatch.setattr(csv_rows, "ROWS_A_PART", 4)
    parts = read_rows(tmp_path / "t.csv", ["a", "b"]).finite(["a", "b"])
    np.testing.assert_array_equal(whole.numbers_of(["a", "b"]), parts.numbers_of(["a", "b"]))
    assert whole.quarantined == parts.quarantined
    assert [row.value for row in whole.quarantined] == ["b = 'x'"] * 7


def test_bounds_of_sliding_joints_are_in_millimetres():
    bound = bound_of("q3_mm", load_arm("gx4_351s"))
    assert bound.high - bound.low < 1000.0


def test_shapes_and_labels_of_too_few_are_not_judged():
    p = np.zeros((3, 2, 3))
    assert not not_rigid(p).any()
    assert list(exchanged(p, p)) == [None] * 3
    assert stated_shape(np.full((3, 2, 3), np.nan), np.zeros((2, 3))) is None
