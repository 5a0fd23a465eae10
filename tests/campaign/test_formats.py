"""Files of controllers and instruments in formats that are known, read as proposed."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

from made_up_formats import PROGRAMS, TAKES, YASKAWA, qualisys_bodies
from made_up_sightings import is_read, rows_of, sighted
from pa10cal.campaign.formats import BY_NAME
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

#: What most formats round joints to [rad], and positions to [m].
WRITTEN_RAD, WRITTEN_M = np.radians(1e-3), 2e-6


@pytest.fixture
def given(tmp_path, columns):
    """Write files, and propose a campaign.yaml for them; return code, text, what was said."""

    def run(**files):
        names = {name.replace("_", ".", 1): text for name, text in files.items()}
        for name, text in names.items():
            (tmp_path / name).write_bytes(text.encode())
        return columns(*names)

    return run


@pytest.fixture
def proposed(given):
    """Return what is proposed for files that can be read."""

    def run(**files):
        code, out, said = given(**files)
        assert code == 0, said
        return out

    return run


def tracker(p_m, called):
    """Return a tracker's list of points, in another order than they were driven to."""
    lines = ["Name,X [mm],Y [mm],Z [mm]"]
    lines += [f"{called.format(k)},{x:.6f},{y:.6f},{z:.6f}" for k, (x, y, z) in p_m]
    return "\n".join([*lines, ""])


def points(raw, seed=3):
    """Return numbers from 1 and positions in mm, shuffled."""
    order = np.random.default_rng(seed).permutation(len(raw.q))
    return [(k + 1, 1e3 * raw.T_instr_target[k, :3, 3]) for k in order.tolist()]


def timed_joints(time_s, raw):
    """Return a log of joint positions."""
    names = "t;A1;A2;A3;A4;A5;A6"
    return rows_of(time_s, np.degrees(raw.q), names=names, sep=";", decimals=9)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("name", PROGRAMS)
def test_points_of_a_program_are_joined_with_readings_by_their_names(tmp_path, proposed, name):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    write, called = PROGRAMS[name]
    text = proposed(program_dat=write(np.degrees(raw.q)), tracker_csv=tracker(points(raw), called))
    assert text.startswith(f"# program.dat: {BY_NAME[name].title.replace('`', '')}")
    assert yaml.safe_load(text)["columns"]["joints"]["format"] == name
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    assert len(found.observations) == len(raw.q)
    assert is_read(found, raw.q, raw.T_instr_target, WRITTEN_RAD, WRITTEN_M)


def test_points_in_an_array_of_kuka_are_read(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    program = PROGRAMS["kuka"][0](np.degrees(raw.q))
    program = re.sub(r"DECL (?:GLOBAL )?E6AXIS XP(\d+)=", r"CAL[\1]=", program)
    program = program.replace("DECL FRAME", f"DECL E6AXIS CAL[{len(raw.q)}]\r\nDECL FRAME")
    proposed(program_dat=program, tracker_csv=tracker(points(raw), "CAL[{}]"))
    assert is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target, WRITTEN_RAD, WRITTEN_M)


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("title", TAKES)
def test_a_take_of_motion_capture_is_read(tmp_path, proposed, title):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    write, turns = TAKES[title]
    time_s = 10.0 * np.arange(len(raw.q))
    text = proposed(
        joints_csv=timed_joints(time_s, raw), take_txt=write(time_s, raw.T_instr_target)
    )
    name = title.split()[0]
    assert text.startswith(f"# take.txt: {BY_NAME[name].title}")
    content = yaml.safe_load(text)
    assert content["columns"]["readings"]["format"] == name
    assert content["instrument"]["kind"] == ("pose" if turns else "points")
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    order = np.argsort(found.observations.states.time_s)
    measured = found.observations.measured
    if turns:
        np.testing.assert_allclose(measured.T_instr_target[order], raw.T_instr_target, atol=3e-6)
    else:
        expected = raw.T_instr_target[:, :3, 3]
        np.testing.assert_allclose(measured.places_m[order, 0], expected, atol=WRITTEN_M)


def test_what_was_not_seen_in_a_take_is_left_out(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = 10.0 * np.arange(len(raw.q))
    take = TAKES["motive"][0](time_s, raw.T_instr_target, lost=(4, 9))
    proposed(joints_csv=timed_joints(time_s, raw), take_csv=take)
    found = read_campaign(tmp_path)
    assert len(found.observations) == len(raw.q) - 2
    assert [row.line for row in found.quarantined] == [12, 17]  # below seven lines


def test_a_take_may_have_decimal_commas(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = 10.0 * np.arange(len(raw.q))
    take = re.sub(r"(\d)\.(\d)", r"\1,\2", TAKES["qualisys"][0](time_s, raw.T_instr_target))
    text = proposed(joints_csv=timed_joints(time_s, raw), take_txt=take)
    assert yaml.safe_load(text)["columns"]["readings"]["decimal"] == ","
    found = read_campaign(tmp_path)
    assert is_read(found, raw.q, raw.T_instr_target, WRITTEN_RAD, WRITTEN_M)


def test_of_two_bodies_that_on_the_arm_is_the_target(tmp_path, proposed):
    """The other, which stands still, is a target on the base, though it is named first."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = 10.0 * np.arange(len(raw.q))
    floor = np.tile(np.eye(4), (len(time_s), 1, 1))
    floor[:, :3, 3] = np.random.default_rng(0).normal([1.2, 0.3, 0.05], 2e-5, (len(time_s), 3))
    take = qualisys_bodies(time_s, {"Floor": floor, "Flange": raw.T_instr_target})
    text = proposed(joints_csv=timed_joints(time_s, raw), take_tsv=take)
    columns = yaml.safe_load(text)["columns"]["readings"]
    assert columns["rotation"]["names"][0] == "Flange r11"
    assert columns["position"]["names"][0] == "Flange x [mm]"
    assert list(columns["targets"]) == ["base1"]


def test_pulses_are_refused_with_what_to_export(given):
    places = "Name,X,Y,Z\nC00000,1,2,3\nC00001,4,5,6\n"
    code, _, said = given(job_jbi=YASKAWA, tracker_csv=places)
    assert code == 2
    assert "job.jbi:6" in said
    assert "pulses" in said
    assert "S, L, U, R, B, T in degrees" in said


EVERY = {
    **{name: write for name, (write, _) in PROGRAMS.items()},
    **{k: w for k, (w, _) in TAKES.items()},
}


def written(raw, name):
    if name in PROGRAMS:
        return EVERY[name](np.degrees(raw.q))
    return EVERY[name](10.0 * np.arange(len(raw.q)), raw.T_instr_target)


def said_of(folder):
    """Return why rows are quarantined, or why a campaign is refused."""
    try:
        return "; ".join(row.reason for row in read_campaign(folder).quarantined)
    except Pa10calError as error:
        return str(error)


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("share", [0.02, 0.5, pytest.param(0.93, marks=pytest.mark.slow)])
def test_a_file_that_was_cut_short_is_told(tmp_path, given, name, share):
    """A part of a row is quarantined as cut; a part of a header is refused with its place."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    text = written(raw, name)
    cut = text[: int(share * len(text))].rstrip("\r\n")[:-1]
    if name in PROGRAMS:
        code, _, said = given(program_dat=cut, tracker_csv=tracker(points(raw), PROGRAMS[name][1]))
    else:
        joints = rows_of(np.degrees(raw.q), names="A1;A2;A3;A4;A5;A6", sep=";")
        code, _, said = given(take_txt=cut, joints_csv=joints)
    if code == 0:
        assert re.search("cut short|; allowed: ", said_of(tmp_path))
    else:
        assert code == 2
        assert re.match(r"pa10cal columns: .*(program\.dat|take\.txt).*: .*; allowed: .*; ", said)


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("motive", "Frame,Time (Seconds)", "Index,Clock", "lacks the line with Frame"),
        ("motive", "Length Units,Meters", "Length Units,Ells", "unit of lengths is not known"),
        ("motive", "Length Units,Meters,", "", "unit of lengths is not known"),
        ("vicon", "Segments\n100\n", "Segments\n", "lacks a part of its header"),
        ("vicon", "\n100\n", "\nfast\n", "rate is not a number"),
        ("qualisys", "BODY_NAMES\tFlange", "BODY_NAMES\tFlange\tBase", "do not have the columns"),
        ("qualisys", "BODY_NAMES\tFlange\r\n", "", "do not have the columns"),
        ("fanuc_ls", "J1=", "J1 is", "no joint positions|axes|refused"),
        ("kuka", "E6AXIS", "E7AXIS", "no joint positions"),
        ("abb", "jointtarget", "poseframe", "no joint positions"),
    ],
)
def test_a_header_of_another_version_is_refused(given, tmp_path, name, old, new, told):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    text = written(raw, name)
    assert old in text
    other = tracker(points(raw), "P{}")
    code, out, said = given(file_txt=text.replace(old, new), other_csv=other)
    assert re.search(told, said + out)
    assert code == 2 or "it is refused" in out


def test_a_program_in_two_units_is_refused(tmp_path, given):
    raw = sighted(tmp_path, "pose")
    text = PROGRAMS["fanuc_ls"][0](np.degrees(raw.q))
    last = text.rindex("J2=")
    text = text[:last] + text[last:].replace(" deg", " mm", 1)
    code, _, said = given(file_ls=text, other_csv=tracker(points(raw), "P{}"))
    assert code == 2
    assert re.search(r"file\.ls:\d+: J2 is in two units", said)


def test_points_of_two_motion_groups_are_whole(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    text = PROGRAMS["fanuc_ls"][0](np.degrees(raw.q))
    text = text.replace("\r\n};", "\r\n   GP2:\r\n\tUF : 0, UT : 1,\r\n\tJ1= 5.0 deg\r\n};")
    proposed(program_ls=text, tracker_csv=tracker(points(raw), "P{}"))
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    assert len(found.observations) == len(raw.q)


def test_a_file_of_another_format_than_is_stated_is_refused(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    proposed(
        program_dat=PROGRAMS["kuka"][0](np.degrees(raw.q)),
        tracker_csv=tracker(points(raw), "P{}"),
    )
    (tmp_path / "program.dat").write_text(PROGRAMS["abb"][0](np.degrees(raw.q)))
    with pytest.raises(Pa10calError, match="the file is no KUKA data list"):
        read_campaign(tmp_path)


# Plain tables whose columns hold a place only together.


def with_joints(raw, **columns):
    """Return a table of joint positions and further columns, to nine decimals."""
    names = ";".join([*(f"J{k} [deg]" for k in range(1, 7)), *columns])
    return rows_of(np.degrees(raw.q), *columns.values(), names=names, sep=";", decimals=9)


TURN = {"deg": 360.0, "gon": 400.0, "rad": 2.0 * np.pi}


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("horizontal", ["clockwise", "counterclockwise"])
@pytest.mark.parametrize("vertical", ["zenith", "horizon"])
@pytest.mark.parametrize("unit", [*TURN, "gon, not stated"])
def test_polar_readings_are_read_as_the_arm_shows(tmp_path, proposed, horizontal, vertical, unit):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    p_m = raw.T_instr_target[:, :3, 3]
    d_m = np.linalg.norm(p_m, axis=1)
    of_unit = TURN[unit[:3]] / (2.0 * np.pi)
    hz = np.arctan2(p_m[:, 1], p_m[:, 0]) * (-1 if horizontal == "clockwise" else 1)
    down = np.arccos(p_m[:, 2] / d_m)
    v = down if vertical == "zenith" else 0.5 * np.pi - down
    stated = "" if "not" in unit else f" [{unit}]"
    columns = {f"Hz{stated}": hz % (2.0 * np.pi) * of_unit, f"V{stated}": v * of_unit, "D [m]": d_m}
    text = proposed(readings_csv=with_joints(raw, **columns))
    assert text.startswith("# readings.csv: polar readings")
    (target,) = yaml.safe_load(text)["columns"]["poses"]["targets"].values()
    expected = {"unit": unit[:3], "horizontal": horizontal, "vertical": vertical}
    assert target["polar"] == expected
    found = read_campaign(tmp_path)
    order = np.argsort(found.observations.states.time_s)
    np.testing.assert_allclose(found.observations.measured.places_m[order, 0], p_m, atol=3e-6)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("order", ["rows", "columns", "twelve"])
@pytest.mark.parametrize("header", ["O_T_EE_{}", "m{}"])
def test_matrices_are_read_by_rows_or_by_columns(tmp_path, proposed, order, header):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    T = raw.T_instr_target if order != "columns" else np.swapaxes(raw.T_instr_target, 1, 2)
    values = T.reshape(-1, 16)[:, : 12 if order == "twelve" else 16]
    still = np.tile(np.eye(4).ravel(), (len(T), 1))
    columns = {f"F_T_EE_{k}": v for k, v in enumerate(still.T)}
    columns |= {header.format(k): v for k, v in enumerate(values.T)}
    text = proposed(readings_csv=with_joints(raw, **columns))
    assert text.startswith("# readings.csv: matrices of 4 by 4")
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    order = np.argsort(found.observations.states.time_s)
    measured = found.observations.measured.T_instr_target[order]
    np.testing.assert_allclose(measured, raw.T_instr_target, atol=3e-6)


def test_a_log_of_rtde_is_read(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    names = [
        "timestamp",
        *(f"target_q_{k}" for k in range(6)),
        *(f"actual_q_{k}" for k in range(6)),
    ]
    names += [f"actual_qd_{k}" for k in range(6)] + [f"actual_TCP_pose_{k}" for k in range(6)]
    lines = [" ".join(names)]
    for k, q in enumerate(raw.q):
        values = [100.0 + 10 * k, *(q + 1e-3), *q, *np.zeros(6), *raw.T_instr_target[k, 0], 0, 0]
        lines.append(" ".join(f"{value:.9f}" for value in values))
    time_s, places = 5 + 10 * np.arange(len(raw.q)), 1e3 * raw.T_instr_target[:, :3, 3]
    tracker_csv = rows_of(time_s, places, names="Zeit;X [mm];Y [mm];Z [mm]", sep=";")
    text = proposed(robot_txt="\n".join([*lines, ""]), tracker_csv=tracker_csv)
    assert text.startswith("# robot.txt: Universal Robots RTDE log")
    found = read_campaign(tmp_path)
    order = np.argsort(found.observations.states.time_s)
    np.testing.assert_allclose(found.observations.states.q_rad[order], raw.q, atol=1e-8)
