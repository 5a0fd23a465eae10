"""Files without names of columns, read where the nominal arm tells what they hold."""

from __future__ import annotations

import re

import numpy as np
import pytest

from made_up_formats import PROGRAMS
from made_up_sightings import is_read, rows_of, sighted
from pa10cal.arm.chain import Chain
from pa10cal.campaign.read import read_campaign
from pa10cal.files.arms import load_arm


def is_whole(folder, raw):
    found = read_campaign(folder)
    assert len(found.observations) == len(raw.q)
    return is_read(found, raw.q, raw.T_instr_target)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.usefixtures("tried")
def test_two_logs_without_names_are_told_by_the_arm(tmp_path, proposed, unit, exchanged):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    q = np.degrees(raw.q) if unit == "deg" else raw.q
    number = np.arange(len(q))
    (tmp_path / "a.txt").write_text(rows_of(number, q, 0.3 + 0.01 * np.sin(number)))
    (tmp_path / "b.txt").write_text(rows_of(1e3 * raw.T_instr_target[:, :3, 3]))
    files = ("b.txt", "a.txt") if exchanged else ("a.txt", "b.txt")
    out = proposed(*files)
    assert "joined by row" in out
    assert is_whole(tmp_path, raw)


def test_one_file_without_names_is_told_by_the_arm(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    place = 1e3 * raw.T_instr_target[:, :3, 3]
    (tmp_path / "a.txt").write_text(rows_of(place, np.degrees(raw.q), 20.0 + 0.0 * place[:, 0]))
    proposed("a.txt")
    assert is_whole(tmp_path, raw)


@pytest.mark.parametrize("before", [[], ["A", "Points"]])
@pytest.mark.usefixtures("tried")
def test_points_as_text_are_joined_by_their_labels(tmp_path, proposed, before):
    """As SpatialAnalyzer exports them: collection, group and target, or the target alone."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    (tmp_path / "p.dat").write_text(PROGRAMS["kuka"][0](np.degrees(raw.q)))
    lines = ["// SA Version 2021.2.0914.9", "// Working frame: A::WORLD", "// mm"]
    order = np.random.default_rng(1).permutation(len(raw.q)).tolist()
    for k in order:
        values = [f"{v:.6f}" for v in 1e3 * raw.T_instr_target[k, :3, 3]]
        lines.append(" ".join([*before, f"P{k + 1}", *values]))
    (tmp_path / "points.txt").write_text("\n".join([*lines, ""]))
    out = proposed("points.txt", "p.dat")
    assert "# points.txt: points as text" in out
    assert "joined by label" in out
    assert is_whole(tmp_path, raw)


@pytest.mark.usefixtures("tried")
def test_a_column_that_numbers_the_targets_is_named(tmp_path, columns):
    raw = sighted(tmp_path, "points", poses=60)
    which = np.random.default_rng(2).integers(0, 3, len(raw.q))
    p = np.where(np.isnan(raw.p_instr_m), np.nanmean(raw.p_instr_m), raw.p_instr_m)
    seen = ~np.isnan(raw.p_instr_m[np.arange(len(which)), which, 0])
    place = 1e3 * p[np.arange(len(which)), which]
    (tmp_path / "a.txt").write_text(rows_of(np.degrees(raw.q)[seen], which[seen] + 1))
    (tmp_path / "b.txt").write_text(rows_of(place[seen]))
    code, _, said = columns("a.txt", "b.txt")
    assert code == 2
    assert "a.txt: column 7 says which of 3 targets a row is of" in said
    assert "copy column 7 behind those of b.txt" in said
    numbered = zip(rows_of(place[seen]).splitlines(), which[seen] + 1, strict=True)
    (tmp_path / "b.txt").write_text("".join(f"{row} {number}\n" for row, number in numbered))
    code, out, _ = columns("a.txt", "b.txt")  # as it says
    assert code == 0
    assert "every row is of one target" in out
    assert f"read so: {seen.sum()} rows can be used, 0 cannot" in out
    (tmp_path / "b.txt").write_text(rows_of(place[seen]))
    for file, names in (("a.txt", "J1 J2 J3 J4 J5 J6 target"), ("b.txt", "X Y Z")):
        rows = (tmp_path / file).read_text()
        (tmp_path / file).write_text(f"{names}\n{rows}")
    code, out, _ = columns("a.txt", "b.txt")
    assert code == 0
    assert "target of a.txt says which target a row is of" in out
    assert "copy that column into b.txt" in out
    texts = [(tmp_path / file).read_text().splitlines() for file in ("a.txt", "b.txt")]
    both = zip(*texts, strict=True)
    (tmp_path / "b.txt").write_text("".join(f"{b} {a.split()[-1]}\n" for a, b in both))
    code, out, _ = columns("a.txt", "b.txt")
    assert code == 0
    assert "every row is of one target" in out
    assert "copy that column" not in out
    assert "T1_x, T1_y, T1_z" in said


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("files", [("all.txt",), ("a.txt", "b.txt")])
@pytest.mark.usefixtures("tried")
def test_targets_that_a_column_numbers_are_read_where_it_stands_with_their_places(
    tmp_path, proposed, files
):
    raw = sighted(tmp_path, "points", poses=60)
    which = np.random.default_rng(2).integers(0, 3, len(raw.q))
    place = 1e3 * raw.p_instr_m[np.arange(len(which)), which]
    seen = np.isfinite(place).all(axis=1)
    q, which, place = np.degrees(raw.q)[seen], which[seen] + 1, place[seen]
    if len(files) == 1:
        (tmp_path / "all.txt").write_text(rows_of(q, which, place))
    else:
        (tmp_path / "a.txt").write_text(rows_of(q))
        (tmp_path / "b.txt").write_text(rows_of(place, which))
    out = proposed(*files)
    assert f"read so: {seen.sum()} rows can be used, 0 cannot" in out
    assert "every row is of one target" in out
    assert "is not read: a gripper" not in out


def test_columns_that_no_arm_explains_are_refused(tmp_path, columns):
    raw = sighted(tmp_path, "pose")
    place = 1e3 * raw.T_instr_target[:, :3, 3]
    (tmp_path / "a.txt").write_text(rows_of(np.degrees(raw.q)))
    (tmp_path / "b.txt").write_text(rows_of(place[::-1]))
    code, _, said = columns("a.txt", "b.txt")
    assert code == 2
    assert "header" in said


@pytest.mark.parametrize(
    ("poses", "times", "what"),
    [
        (10, 1, "too few rows .*'10 rows'|too few rows .*10 and 10 rows"),
        (20, 3, "do not belong together .*20 and 60 rows.*each pose has 3 rows of readings"),
        (20, 0, "do not belong together .*20 and 13 rows.*or shared labels; write headers.*x_mm"),
    ],
)
def test_rows_that_tell_nothing_without_names_are_refused_for_that(
    tmp_path, columns, poses, times, what
):
    raw = sighted(tmp_path, "pose", poses=poses)
    place = np.repeat(1e3 * raw.T_instr_target[:, :3, 3], times or 1, axis=0)
    (tmp_path / "a.txt").write_text(rows_of(np.degrees(raw.q)))
    (tmp_path / "b.txt").write_text(rows_of(place if times else place[:13]))
    for files in (("a.txt", "b.txt"), ("b.txt", "a.txt")):
        code, _, said = columns(*files)
        assert code == 2
        assert "no joint positions" not in said
        assert re.search(
            what, said.replace("60 and 20", "20 and 60").replace("13 and 20", "20 and 13")
        )


@pytest.mark.usefixtures("tried")
def test_joints_that_stand_still_are_read_where_nothing_else_can_be_meant(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", poses=40)
    arm, q = load_arm("ur10"), raw.q.copy()
    q[:, :3] = q[0, :3]
    T_base_ee = Chain.of(arm).forward(q)
    place = 1e3 * (T_base_ee @ [0.1, 0.05, 0.12, 1.0])[:, :3] + [100.0, -2000.0, 300.0]
    (tmp_path / "a.txt").write_text(rows_of(q))
    (tmp_path / "b.txt").write_text(rows_of(place))
    assert "read so: 40 rows can be used, 0 cannot" in proposed("a.txt", "b.txt")


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("heading", ["Pos {}", "Position {}:", "{}"])
@pytest.mark.usefixtures("tried")
def test_blocks_of_named_values_are_joined_by_the_numbers_of_the_joints(
    tmp_path, proposed, heading
):
    """Five readings under each number, as T-Scan writes them; the joints in rows without names."""
    raw = sighted(tmp_path, "pose")
    rng, lines = np.random.default_rng(3), []
    for k, T in enumerate(raw.T_instr_target, start=1):
        lines += [heading.format(k)]
        for p_mm in 1e3 * T[:3, 3] + rng.normal(0.0, 0.02, (5, 3)):
            values = zip("XYZ", p_mm, strict=True)
            lines += ["Cnt=1  " + " ".join(f"{axis}={value:10.3f}" for axis, value in values)]
        lines += [""]
    (tmp_path / "scan.txt").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "joints.txt").write_text(rows_of(np.arange(1, len(raw.q) + 1), raw.q))
    out = proposed("joints.txt", "scan.txt")
    assert "joined by label" in out
    states = read_campaign(tmp_path).observations.states
    assert len(states.q_rad) == 5 * len(raw.q)
    off = np.abs(states.q_rad[:, None] - raw.q).max(axis=2).min(axis=1)
    assert off.max() < 2e-6


@pytest.mark.parametrize(
    "text",
    [
        "Pos 1\nX= 1 Y= 2 Z= 3\n",
        "Pos 1\nX= 1 Y= ? Z= 3\nX= 1\nX== Y=\n",
        "Pos 1\nX Y Z\n",
    ],
)
def test_blocks_that_hold_too_little_are_refused(tmp_path, columns, text):
    (tmp_path / "scan.txt").write_text(text, encoding="utf-8")
    code, _, said = columns("scan.txt")
    assert code == 2
    assert said.startswith("pa10cal columns:")


def _matrices(raw):
    """Return the measured poses as matrices (P, 4, 4), in mm."""
    T = raw.T_instr_target.copy()
    T[:, :3, 3] *= 1e3
    return T


@pytest.mark.usefixtures("tried")
def test_as_many_columns_as_joints_are_these_beside_poses_that_need_no_name(tmp_path, columns):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    elsewhere = np.degrees(raw.q) * [1, -1, 1, 1, -1, 1] + [0, 5, 0, -8, 0, 0]
    (tmp_path / "q.txt").write_text(rows_of(elsewhere))
    (tmp_path / "m.txt").write_text(rows_of(_matrices(raw).reshape(-1, 16)))
    code, out, _ = columns("q.txt", "m.txt")
    assert code == 0
    assert "mm and" in out  # how far the nominal arm is off
    assert "joints:\n      names: ['1', '2', '3', '4', '5', '6']" in out


@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_below_one_another_are_named(tmp_path, columns, rows):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    (tmp_path / "q.txt").write_text(rows_of(np.degrees(raw.q)))
    (tmp_path / "m.txt").write_text(rows_of(_matrices(raw)[:, :rows].reshape(-1, 4)))
    code, _, said = columns("q.txt", "m.txt")
    assert code == 2
    assert f"m.txt holds matrices of {rows} rows, one below another" in said
    assert f"write each into one row of {4 * rows} numbers" in said


def test_joints_whose_names_say_nothing_are_told_by_the_arm(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    place = 1e3 * raw.T_instr_target[:, :3, 3]
    rows = [",".join(row.split()) for row in rows_of(place, np.degrees(raw.q)).splitlines()]
    lines = ["x,y,z,slide,arm1,arm2,arm3,arm4,arm5", *rows, ""]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "joints: slide …, by the nominal arm" in proposed("a.csv")
    assert is_whole(tmp_path, raw)
