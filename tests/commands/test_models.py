"""Commands that apply a model or compare two: files they read and write, and what they refuse."""

from __future__ import annotations

import csv
import io
import re
import shlex
from dataclasses import replace
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_model import fitted, fitted_to, postures
from made_up_pair import campaign, shifted
from made_up_poses import context_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.controller_poses import controller_pose
from pa10cal.arm.description import Controller
from pa10cal.campaign.pose_lists import commands_text
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.arms import arm_text, load_arm
from pa10cal.fit import compensation, fitted_model, loads
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.misread_lists import of_joints
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.validity import AngleCoverage, nothing_seen
from pa10cal.options import Tolerances
from pa10cal.results.codec import read
from pa10cal.results.comparison import ComparisonRecord
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import link_departures

JOINTS = ",".join(f"q{k}_deg" for k in range(1, 7))
POSE = "x_mm,y_mm,z_mm,qw,qx,qy,qz"
HERE = "700,200,600,0.5,0.5,0.5,0.5"


def springs(arm):
    return (link_departures(arm, Tolerances()), *(JointSpring(k, 80.0) for k in (2, 3)))


def saved(tmp_path, **about):
    model = fitted("pa10_6ce", 3, springs)
    model = replace(model, fitted_to=fitted_to("c1", loads_N=(0.0, 44.0), **about))
    model.save(tmp_path / "model.yaml")
    return model


def run(command, tmp_path, lines, *options, out="out.csv"):
    given = tmp_path / "given.csv"
    if lines is not None:
        given.write_text("\n".join(lines) + "\n", encoding="utf-8")
    option = "--joints" if command == "predict" else "--targets"
    words = ["--model", str(tmp_path / "model.yaml"), option, str(given)]
    return run_command(command, [*words, "--out", str(tmp_path / out), *options])


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(found, *names):
    return np.array([[float(row[name]) for name in names] for row in found])


def test_predictions_are_those_of_the_model(tmp_path, capsys):
    model = saved(tmp_path)
    q = postures(model.arm, 4, 5)
    lines = [f"id,{JOINTS},load_N"]
    lines += [f"P{k},{','.join(map(repr, np.degrees(row).tolist()))},22" for k, row in enumerate(q)]
    lines[2] = lines[2].removesuffix("22")
    assert run("predict", tmp_path, lines, "--frame", "tool", "--load-N", "11") == 0
    assert "tool of pa10_6ce at 5 joint positions" in capsys.readouterr().out
    found = rows(tmp_path / "out.csv")
    assert list(found[0]) == ["id", *POSE.split(","), "u_mm", "inside", "u_parameters_mm"]
    assert [row["id"] for row in found] == [f"P{k}" for k in range(5)]
    expected = model.predict(q, frame="tool", load_N=[22, 11, 22, 22, 22])
    places = column(found, "x_mm", "y_mm", "z_mm")
    np.testing.assert_allclose(places, 1e3 * expected.T[:, :3, 3], atol=1e-8)
    np.testing.assert_allclose(column(found, "u_mm")[:, 0], expected.u_mm, atol=1e-8)
    assert [row["inside"] for row in found] == [str(bool(i)).lower() for i in expected.inside]


def test_many_poses_are_predicted_in_blocks_with_the_same_bytes(tmp_path, capsys, monkeypatch):
    model = saved(tmp_path, grade="unreliable")
    q = np.degrees(postures(model.arm, 5, 30)).tolist()
    lines = [
        f"id,{JOINTS},load_N",
        *(f"P{k},{','.join(map(repr, row))},2" for k, row in enumerate(q)),
    ]
    assert run("predict", tmp_path, lines, "--force") == 0
    said = capsys.readouterr().out
    rows, blocks, former = [], FittedModel.predict_in_blocks, fitted_model.predicted
    monkeypatch.setattr(FittedModel, "predict_in_blocks", partialmethod(blocks, rows=7))

    def predicted(model, given, frame):
        rows.append(len(given.q_rad))
        return former(model, given, frame)

    monkeypatch.setattr(fitted_model, "predicted", predicted)
    assert run("predict", tmp_path, None, "--force", out="blocks.csv") == 0
    assert rows == [7, 7, 7, 7, 2]
    assert (tmp_path / "blocks.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()
    assert capsys.readouterr().out == said.replace("out.csv", "blocks.csv")


def test_many_targets_are_compensated_in_blocks_with_the_same_bytes(tmp_path, capsys, monkeypatch):
    model = saved(tmp_path, grade="unreliable")
    poses = model.predict(postures(model.arm, 5, 30), extrapolate=True)
    q_xyzw = Rotation.from_matrix(poses.T[:, :3, :3]).as_quat()
    values = np.hstack([1e3 * poses.T[:, :3, 3], q_xyzw[:, [3, 0, 1, 2]]]).tolist()
    lines = [f"id,{POSE}", *(f"P{k},{','.join(map(repr, row))}" for k, row in enumerate(values))]
    assert run("compensate", tmp_path, lines, "--force") == 0
    said, rows, judged = capsys.readouterr().out, [], compensation.predicted

    def predicted(model, given, frame):
        rows.append(len(given.q_rad))
        return judged(model, given, frame)

    monkeypatch.setattr(loads, "BLOCK", 7)
    monkeypatch.setattr(compensation, "predicted", predicted)
    assert run("compensate", tmp_path, None, "--force", out="blocks.csv") == 0
    assert rows[:5] == [7, 7, 7, 7, 2]
    assert max(rows) == 7
    assert (tmp_path / "blocks.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()
    assert capsys.readouterr().out == said.replace("out.csv", "blocks.csv")


def test_nothing_is_written_where_a_later_block_is_refused(tmp_path, monkeypatch):
    saved(tmp_path)
    blocks = FittedModel.predict_in_blocks
    monkeypatch.setattr(FittedModel, "predict_in_blocks", partialmethod(blocks, rows=1))
    lines = [f"id,{JOINTS},load_N", "a,0,-90,90,0,10,0,0", "b,0,-90,90,0,10,0,9999"]
    assert run("predict", tmp_path, lines) == REFUSED
    assert not (tmp_path / "out.csv").exists()


def test_what_is_predicted_is_compensated_back(tmp_path, capsys):
    saved(tmp_path)
    q = np.array([[0.3, 0.5, 0.9, 0.4, 0.8, -0.6], [0.2, 0.6, 1.0, 0.3, 0.9, -0.5]])
    lines = [f"id,{JOINTS}"]
    lines += [
        f"{name},{','.join(map(repr, row))}"
        for name, row in zip("ab", np.degrees(q).tolist(), strict=True)
    ]
    assert run("predict", tmp_path, lines, out="poses.csv") == 0
    poses = (tmp_path / "poses.csv").read_text().splitlines()
    targets = [line.rsplit(",", 2)[0] for line in poses]
    targets = [f"{targets[0]},{JOINTS}", f"{targets[1]},20,30,50,20,45,-30", f"{targets[2]},,,,,,"]
    assert run("compensate", tmp_path, targets) == 0
    assert "2 targets of the flange of pa10_6ce: 2 ok" in capsys.readouterr().out
    found = rows(tmp_path / "out.csv")
    assert list(found[0])[:10] == ["id", *JOINTS.split(","), "status", "error_mm", "u_mm"]
    assert [row["id"] for row in found] == ["a", "b"]
    np.testing.assert_allclose(column(found, *JOINTS.split(",")), np.degrees(q), atol=1e-7)
    assert (column(found, "error_mm") < 1e-6).all()


def test_no_target_is_dropped(tmp_path, capsys):
    saved(tmp_path)
    lines = [f"id,{POSE}", f"P1,{HERE}", "far,9000,0,0,1,0,0,0", f"P1,{HERE}", f"P1,{HERE}"]
    assert run("compensate", tmp_path, lines) == 0
    assert "4 targets of the flange of pa10_6ce: 3 ok, 1 unreachable" in capsys.readouterr().out
    found = rows(tmp_path / "out.csv")
    assert [row["id"] for row in found] == ["P1", "far", "P1", "P1"]
    assert [row["status"] for row in found] == ["ok", "unreachable", "ok", "ok"]
    assert float(found[1]["error_mm"]) > 7000.0


SLIPS = [
    ("predict", [f"id,{JOINTS}"], "no row under the header"),
    ("predict", [f"id,{JOINTS.replace('deg', 'rad')}", "P1,1,2,3,4,5,6"], "unit .*q1_rad"),
    (
        "predict",
        [f"id,{JOINTS}", "P1,1,2,3,4,5,6", "P2,1,2,x,4,5,6"],
        ":3: not a finite number.*q3",
    ),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5"], "another number of fields"),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5,6", "P2,1,2,3"], ":3: the number of fields"),
    ("predict", [""], "the file is empty"),
    ("predict", [f"id,{JOINTS},q1_deg", "P1,1,2,3,4,5,6,7"], "q1_deg occurs twice"),
    ("predict", [f"pose,{JOINTS}", "P1,1,2,3,4,5,6"], "missing column id .*rename pose to id"),
    ("predict", [f"id,{JOINTS}", 'P1,"1,5",2,3,4,5,6'], "a decimal comma"),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5,6\0"], "not UTF-8 text"),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5,inf"], "not a finite number"),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5,nan"], ":2: not a finite number.*q6_deg = 'nan'"),
    ("predict", [f"id,{JOINTS}", "P1,1,2,3,4,5,1e9"], "q6_deg is no position of a joint"),
    ("predict", [f"id,{JOINTS},load_N", "P1,1,2,3,4,5,6,60"], "load_N of pose 1.*0 to 44 N"),
    ("predict", [f"id,{JOINTS},load_N", "P1,1,2,3,4,5,6,-1"], "does not know this load"),
    ("compensate", [f"id,{POSE}", "P1,700,200,600,1,1,0,0"], "quaternion is not of length one"),
    (
        "compensate",
        [f"id,{POSE},{JOINTS}", f"P1,{HERE},1,2,3,,5,6"],
        "the seed lacks joints.*q4_deg",
    ),
    ("compensate", [f"id,{POSE},q1_deg", f"P1,{HERE},1"], "missing columns q2_deg"),
    ("compensate", [f"id,{POSE}", "P1,700,200,600,0,0,0,0"], "quaternion is not of length one"),
    ("compensate", [f"id,{POSE},load_N", f"P1,{HERE},", f"P2,{HERE},60"], "load_N of pose 2"),
    ("compensate", ["id,x_mm,y_mm,z_mm,rx,ry,rz", "P1,700,200,600,1,0,0"], "missing columns qw"),
    ("compensate", [f"id,{POSE},q1_mm", f"P1,{HERE},1"], "q1_mm"),
    (
        "compensate",
        [f"id,{POSE}", f"P1,{HERE}", f"P2,{HERE.replace('0.5', '')}"],
        ":3: not a finite",
    ),
]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("command", "lines", "message"), SLIPS)
def test_slips_are_one_message_and_no_file(tmp_path, capsys, command, lines, message):
    saved(tmp_path)
    assert run(command, tmp_path, lines) == REFUSED
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert re.search(message, said), said
    assert not list(tmp_path.glob("*out.csv"))


def test_a_load_beyond_those_of_the_fit_can_be_insisted_on(tmp_path, capsys):
    saved(tmp_path)
    lines = [f"id,{JOINTS}", "P1,1,2,3,4,5,6"]
    assert run("predict", tmp_path, lines, "--load-N", "60") == REFUSED
    assert "--force" in capsys.readouterr().err
    assert run("predict", tmp_path, lines, "--load-N", "60", "--force") == 0


@pytest.mark.parametrize("grade", ["suspect_input", "not_converged"])
@pytest.mark.parametrize("command", ["predict", "compensate"])
def test_a_doubtful_model_takes_force_and_the_file_says_so(tmp_path, capsys, grade, command):
    saved(tmp_path, grade=grade, health="joint 6: reverse its sign")
    lines = [f"id,{JOINTS}", "P1,1,2,3,4,5,6"]
    lines = lines if command == "predict" else [f"id,{POSE}", f"P1,{HERE}"]
    assert run(command, tmp_path, lines) == REFUSED
    said = capsys.readouterr().err
    assert f"a model of grade {grade} is not applied" in said
    assert "reverse its sign" in said
    assert not (tmp_path / "out.csv").exists()
    assert run(command, tmp_path, lines, "--force") == 0
    assert rows(tmp_path / "out.csv")[0]["forced"] == grade


def test_a_model_that_cannot_be_read_is_refused(tmp_path, capsys):
    saved(tmp_path)
    (tmp_path / "model.yaml").write_text("schema: other/1\n")
    assert run("predict", tmp_path, [f"id,{JOINTS}", "P1,1,2,3,4,5,6"]) == REFUSED
    assert "not a model of this version" in capsys.readouterr().err


def test_without_its_covariance_a_model_says_no_uncertainty(tmp_path):
    saved(tmp_path)
    (tmp_path / "model.covariance.npz").unlink()
    assert run("compensate", tmp_path, [f"id,{POSE}", f"P1,{HERE}"]) == 0
    assert rows(tmp_path / "out.csv")[0]["u_mm"] == ""
    assert np.isnan(load_model(tmp_path / "model.yaml").predict(np.zeros(6)).u_mm).all()


def test_columns_that_are_not_read_are_named(tmp_path, capsys):
    """A load under another name would be none."""
    saved(tmp_path)
    assert run("predict", tmp_path, [f"id,{JOINTS},load,note", "P1,1,2,3,4,5,6,22,x"]) == 0
    assert "csv: load, note (a load is read as load_N, in newtons)" in capsys.readouterr().out
    assert run("compensate", tmp_path, [f"id,{POSE},load", f"P1,{HERE},22"]) == 0
    assert "csv: load (a load is read" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "out", "of"),
    [
        ("predict", "given.csv", "joints"),
        ("compensate", "given.csv", "targets"),
        ("predict", "model.yaml", "model"),
    ],
)
def test_no_input_is_replaced(tmp_path, capsys, command, out, of):
    saved(tmp_path)
    lines = [f"id,{JOINTS}", "P1,1,2,3,4,5,6"]
    lines = lines if command == "predict" else [f"id,{POSE}", f"P1,{HERE}"]
    before = (tmp_path / "model.yaml").read_bytes()
    assert run(command, tmp_path, lines, out=out) == REFUSED
    assert f"--out: the output would replace the file of {of}" in capsys.readouterr().err
    assert (tmp_path / "given.csv").read_text(encoding="utf-8").splitlines() == lines
    assert (tmp_path / "model.yaml").read_bytes() == before


def test_statuses_are_those_of_the_target(tmp_path):
    """Straight wrist, beyond a limit, out of reach: a row each, in order, and exit code 0."""
    model = saved(tmp_path)
    q = np.radians([[10, 20, 60, 0, 0, 0], [10, -80, 150, 0, 40, 0], [20, 30, 60, 20, 45, -30]])
    poses = model.predict(q).T
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    numbers = np.hstack([1e3 * poses[:, :3, 3], quaternions]).tolist()
    lines = [f"id,{POSE},{JOINTS}"]
    for name, row, seed in zip("abc", numbers, np.degrees(q).tolist(), strict=True):
        lines.append(",".join([name, *map(repr, [*row, *seed])]))
    lines.insert(3, f"far,3000,0,0,1,0,0,0{',' * 6}")
    assert run("compensate", tmp_path, lines) == 0
    found = rows(tmp_path / "out.csv")
    assert [row["id"] for row in found] == ["a", "b", "far", "c"]
    assert [row["status"] for row in found] == [
        "near_singular",
        "outside_limits",
        "unreachable",
        "ok",
    ]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("angles", ["ABC", "quaternion", "rpy", "rotation_vector"])
def test_poses_to_send_are_written_as_the_controller_has_them(tmp_path, capsys, angles):
    model = saved(tmp_path)
    lines = [f"id,{POSE}", f"P1,{HERE}", "P2,650,250,550,0.1,0.7,0.1,0.7"]
    options = ("--frame", "tool", "--write", "cartesian", "--angles", angles)
    assert run("compensate", tmp_path, lines, *options) == 0
    assert "and this TCP: x_mm" in capsys.readouterr().out
    found = rows(tmp_path / "out.csv")
    q = np.radians(column(found, *JOINTS.split(",")))
    names = [name for name in found[0] if name.startswith("send_")]
    T = Chain.of(model.arm).forward(q) @ model.T_flange_frame("tool")
    for row, expected in zip(column(found, *names), T, strict=True):
        np.testing.assert_allclose(controller_pose(row, angles), expected, atol=1e-8)
    if angles == "ABC":
        A, B, C = np.radians(column(found, *names[3:])[0])
        turns = [Rotation.from_rotvec(v) for v in ([0, 0, A], [0, B, 0], [C, 0, 0])]
        R = (turns[0] * turns[1] * turns[2]).as_matrix()  # about z, the new y, the new x
        np.testing.assert_allclose(R, T[0, :3, :3], atol=1e-8)


def test_the_tcp_of_the_controller_can_be_given(tmp_path, capsys):
    model = saved(tmp_path)
    lines = [f"id,{POSE}", f"P1,{HERE}"]
    tcp = ("--tcp", "10", "-20", "150", "30", "0", "-90")
    options = ("--write", "cartesian", "--angles", "ABC", *tcp)
    assert run("compensate", tmp_path, lines, *options) == 0
    assert "z_mm 150" in capsys.readouterr().out
    (row,) = found = rows(tmp_path / "out.csv")
    T = Chain.of(model.arm).forward(np.radians(column(found, *JOINTS.split(","))))
    place = T[0] @ np.array([0.01, -0.02, 0.15, 1.0])
    np.testing.assert_allclose(float(row["send_x_mm"]), 1e3 * place[0], atol=1e-6)
    assert run("compensate", tmp_path, lines, *options[:-1]) == REFUSED
    assert "give 6 numbers" in capsys.readouterr().err
    assert run("compensate", tmp_path, lines, "--angles", "ABC") == REFUSED
    assert "add --write cartesian" in capsys.readouterr().err


def test_poses_are_sent_relative_to_the_controllers_own_model(tmp_path, capsys):
    model = saved(tmp_path)
    arm = replace(model.arm, name="factory", a_m=model.arm.a_m + 5e-4)
    factory = tmp_path / "factory.yaml"
    factory.write_text(arm_text(arm), encoding="utf-8")
    lines, options = [f"id,{POSE}", f"P1,{HERE}"], ("--write", "cartesian")
    assert run("compensate", tmp_path, lines, *options) == 0
    assert "with the nominal model (its own compensation must be off" in capsys.readouterr().out
    assert run("compensate", tmp_path, lines, *options, "--controller", str(factory)) == 0
    assert "with the model of factory and this TCP" in capsys.readouterr().out
    (row,) = found = rows(tmp_path / "out.csv")
    T = Chain.of(arm).forward(np.radians(column(found, *JOINTS.split(","))))
    np.testing.assert_allclose(float(row["send_x_mm"]), 1e3 * T[0, 0, 3], atol=1e-6)
    assert run("compensate", tmp_path, lines, *options, "--controller", "ur10") == REFUSED
    assert "--controller: the model of the controller, ur10, is of an" in capsys.readouterr().err
    assert run("compensate", tmp_path, lines, "--controller", "ur10") == REFUSED
    assert "add --write cartesian" in capsys.readouterr().err
    for stated, said in (
        (Controller(compensation=True, known=False), "would correct the robot twice"),
        (Controller(compensation=True, known=True), "pa10_6ce, its compensation on, and this"),
        (Controller(compensation=False, known=True), "nominal model, its compensation off, and"),
        (Controller(compensation=True, known=True, arm=arm), "with the model of factory and"),
    ):
        chain = replace(model.model.chain, arm=replace(model.arm, controller=stated))
        content = replace(model, model=replace(model.model, chain=chain))
        content.save(tmp_path / "model.yaml")
        assert run("compensate", tmp_path, lines, *options) == (0 if stated.known else REFUSED)
        assert said in "".join(capsys.readouterr())
        assert run("compensate", tmp_path, lines) == 0


def test_sides_of_arrival_are_columns_or_an_option(tmp_path, capsys):
    model = fitted("pa10_6ce", 3, lambda arm: (*springs(arm), Backlash("joint 1")))
    replace(model, x=np.append(model.x[:-1], 3.5e-4)).save(tmp_path / "model.yaml")
    sides = [f"id,{JOINTS},arrival1", "a,1,2,3,4,5,6,1", "b,1,2,3,4,5,6,"]
    assert run("predict", tmp_path, sides) == 0
    known, unknown = column(rows(tmp_path / "out.csv"), "u_mm")[:, 0]
    assert unknown > 10.0 * known
    assert run("predict", tmp_path, sides, "--arrival", "-1", "0", "0", "0", "0", "0") == 0
    assert column(rows(tmp_path / "out.csv"), "u_mm")[1, 0] < 2.0 * known
    assert run("predict", tmp_path, sides, "--arrival", "1", "1") == REFUSED
    assert "--arrival" in capsys.readouterr().err
    sides[1] = sides[1].removesuffix("1") + "2"
    assert run("predict", tmp_path, sides) == REFUSED
    assert ":2: arrival1 is no direction of arrival" in capsys.readouterr().err


def test_effects_that_hold_nowhere_are_said_to_and_no_pose_is_away_for_that(tmp_path, capsys):
    model = saved(tmp_path)
    away = FallBack(nothing_seen(6), replace(model.nominal(), seen=None))
    replace(model, seen=None, falls_back=away).save(tmp_path / "model.yaml")
    assert run("predict", tmp_path, [f"id,{JOINTS}", "P1,1,2,3,4,5,6"]) == 0
    said = capsys.readouterr().out
    assert "1 joint positions, 0 of them away from the poses of the fit; its effects hold" in said
    assert rows(tmp_path / "out.csv")[0]["inside"] == "true"
    assert run("compensate", tmp_path, [f"id,{POSE}", f"P1,{HERE}"]) == 0
    assert "; its effects hold nowhere" in capsys.readouterr().out


def with_effect(tmp_path, id, *x):
    """Save a model with an effect of temperature or time, and return it."""
    (effect,) = (each for each in candidates(context_of(load_arm("pa10_6ce"))) if each.id == id)
    model = fitted("pa10_6ce", 3, lambda arm: (*springs(arm), effect))
    about = fitted_to("c1", temperature_std_C=2.0)
    model = replace(model, x=np.append(model.x[: -len(x)], x), fitted_to=about)
    model.save(tmp_path / "model.yaml")
    return model


@pytest.mark.parametrize("command", ["predict", "compensate"])
def test_temperatures_are_a_column_or_an_option(tmp_path, capsys, command):
    model = with_effect(tmp_path, "thermal_growth", 1.2e-5)
    names, cells = (JOINTS, "1,2,3,4,5,6") if command == "predict" else (POSE, HERE)
    wanted = ["x_mm", "y_mm", "z_mm"] if command == "predict" else JOINTS.split(",")
    lines = [f"id,{names},temperature_C", f"a,{cells},31.5", f"b,{cells},"]
    assert run(command, tmp_path, lines) == 0
    said = capsys.readouterr().out
    assert "which 1 rows do not give: the mean of the fit, 21.5 °C, is taken; u_mm holds" in said
    found = rows(tmp_path / "out.csv")
    warm, usual = column(found, *wanted)
    assert np.abs(warm - usual).max() > 1e-3
    known, unknown = column(found, "u_mm")[:, 0]
    assert unknown > known
    if command == "predict":
        q = np.radians([1, 2, 3, 4, 5, 6])
        at = model.predict([q, q, q], temperature_C=[23.5, 19.5, 21.5])
        apart_mm = 0.5e3 * np.linalg.norm(at.T[0, :3, 3] - at.T[1, :3, 3])
        assert unknown == pytest.approx(np.hypot(at.u_mm[2], apart_mm), rel=1e-6)
    assert run(command, tmp_path, lines, "--temperature-C", "31.5") == 0
    assert "thermal_growth" not in capsys.readouterr().out
    both = column(rows(tmp_path / "out.csv"), *wanted)
    np.testing.assert_allclose(both, [warm, warm], atol=1e-8)


def test_times_are_a_column_or_an_option_and_without_one_no_base_moves(tmp_path, capsys):
    model = with_effect(tmp_path, "base_drift", 1e-4, 0.0, 0.0)
    q, start_s = np.radians([1, 2, 3, 4, 5, 6]), model.model.terms[-1].start_s
    lines = [f"id,{JOINTS},time_s", f"a,1,2,3,4,5,6,{start_s + 7200}", "b,1,2,3,4,5,6,"]
    assert run("predict", tmp_path, lines) == 0
    assert "base_drift needs time_s, which 1 rows do not give" in capsys.readouterr().out
    later, none = column(rows(tmp_path / "out.csv"), "x_mm", "y_mm", "z_mm")
    np.testing.assert_allclose(later - none, [0.2, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(model.predict(q).T, model.predict(q, time_s=start_s).T, atol=1e-12)
    assert run("predict", tmp_path, lines, "--time-s", str(start_s)) == 0
    assert "base_drift" not in capsys.readouterr().out


@pytest.mark.slow
def test_lists_that_agree_with_the_model_are_not_warned_of(tmp_path, capsys):
    """Those that contradict it are in test_mistakes_with_models."""
    model = saved(tmp_path)
    seen = AngleCoverage(tuple(np.array([[0.2, 1.0]]) for _ in range(6)), (False,) * 6)
    replace(model, seen=seen).save(tmp_path / "model.yaml")
    q = np.random.default_rng(5).uniform(0.3, 0.9, (8, 6))
    T = model.predict(q).T
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    poses, positions = np.hstack([1e3 * T[:, :3, 3], quaternions]), np.degrees(q)
    for command, names, values in (
        ("predict", JOINTS, positions),
        ("compensate", POSE, poses),
        ("compensate", f"{POSE},{JOINTS}", np.hstack([poses, positions])),
    ):
        lines = [f"P{k},{','.join(map(repr, row))}" for k, row in enumerate(values.tolist())]
        assert run(command, tmp_path, [f"id,{names}", *lines]) == 0
        assert "warning" not in capsys.readouterr().err
    # A seed beside them does not hide that quaternions are in the other order.
    values[:, 3:7] = np.roll(quaternions, -1, axis=1)
    lines = [f"P{k},{','.join(map(repr, row))}" for k, row in enumerate(values.tolist())]
    assert run("compensate", tmp_path, [f"id,{POSE},{JOINTS}", *lines]) == 0
    said = capsys.readouterr().err
    assert said.count("warning") == 1
    assert "look like x, y, z, w" in said


def test_positions_about_zero_that_hardly_move_are_warned_of(tmp_path):
    all_round = AngleCoverage(tuple(np.array([[-3.0, 3.0]]) for _ in range(6)), (False,) * 6)
    model = replace(saved(tmp_path), seen=all_round)
    wide = np.random.default_rng(3).uniform(-2.5, 2.5, (30, 6))
    (warned,) = of_joints(model, np.radians(wide))
    assert "hardly a motion" in warned
    for other in (wide, np.radians(wide[:4]), np.radians(0.1 * wide)):
        assert not list(of_joints(model, other))


# Command `compare`: what it prints, as the docs show it, what it writes and what it refuses.


DOCS = Path(__file__).parents[2] / "docs/using-the-model.md"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    campaign(1, "june").save(tmp_path / "june.yaml")
    shifted(campaign(2, "july"), delta_theta_3=1e-3).save(tmp_path / "july.yaml")
    return tmp_path


def test_the_example_of_the_docs(here, capsys):
    section = DOCS.read_text(encoding="utf-8").split("## What has changed")[1]
    line, shown = re.search(
        r"```sh\n(pa10cal .*)\n```\n\n```text\n(.*?)```", section, re.S
    ).groups()
    _, command, *words = shlex.split(line)
    assert run_command(command, words) == 0
    assert capsys.readouterr().out == shown
    found = read(ComparisonRecord, here / "compare.json")
    assert found.agree is False
    assert found.first.campaign == "june"


def spoil_covariance(here):
    (here / "july.covariance.npz").write_bytes(b"PK nothing")


def not_a_model(here):
    (here / "july.yaml").write_text("schema: pa10cal-campaign/1\n", encoding="utf-8")


def no_file(here):
    (here / "july.yaml").unlink()


def another_arm(here):
    campaign(1, robot="ur10").save(here / "july.yaml")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_covariance, r"july\.covariance\.npz: the covariance of the model cannot be read"),
        (not_a_model, r"july\.yaml: schema: not a model"),
        (no_file, r"july\.yaml: the model cannot be read"),
        (another_arm, r"june\.yaml \(pa10_6ce\), july\.yaml \(ur10\): models of arms of different"),
    ],
)
def test_what_is_refused(here, capsys, spoil, message):
    spoil(here)
    assert run_command("compare", ["june.yaml", "july.yaml", "--out", "c.json"]) == REFUSED
    said = capsys.readouterr()
    assert re.search(message, said.err)
    assert len(said.err.splitlines()) == 1
    assert not said.out
    assert not (here / "c.json").exists()


def test_without_a_covariance_it_says_so(here, capsys):
    (here / "july.covariance.npz").unlink()
    assert run_command("compare", ["june.yaml", "july.yaml"]) == 0
    assert "cannot be judged: the covariance is missing of july.yaml" in capsys.readouterr().out


def test_no_model_is_replaced(here, capsys):
    before = (here / "july.yaml").read_bytes()
    assert run_command("compare", ["june.yaml", "july.yaml", "--out", "july.yaml"]) == REFUSED
    assert "would replace the file of second" in capsys.readouterr().err
    assert (here / "july.yaml").read_bytes() == before


def test_a_folder_of_results_is_enough(here, capsys):
    for name in ("june", "july"):
        folder = here / "results" / name / "model"
        folder.mkdir(parents=True)
        campaign(1, name).save(folder / "model.yaml")
    assert run_command("compare", ["results/june", "results/july/model"]) == 0
    assert "expected to remain" in capsys.readouterr().out
    assert run_command("compare", ["results", "results/july"]) == REFUSED
    assert "results/model.yaml: the model cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    "id",
    [
        *("a,90.0", 'say "b"', "=cmd|' /C calc'!A0", "two\nlines", "a;b\tc", "a\r90.0"),
        *(" =1+1", "\t=1", "+A1", "-A1", "@A1"),
    ],
)
def test_an_id_is_one_cell_whatever_it_is(id):
    ids, q = np.array([id, "plain"]), np.radians([[1.0, 2.0], [3.0, 4.0]])
    columns = {"u_mm": np.array([0.5, np.nan])}
    text = commands_text(ids, q, np.zeros(2, dtype=bool), columns)
    header, first, second = csv.reader(io.StringIO(text, newline=""))
    assert header == ["id", "q1_deg", "q2_deg", "u_mm"]
    assert first[0].removeprefix("'") == id
    assert first[0][0] not in "=+-@"
    assert [float(word) for word in first[1:]] == [1.0, 2.0, 0.5]
    assert second == ["plain", "3.0000000000", "4.0000000000", ""]
