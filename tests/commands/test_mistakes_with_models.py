"""Mistakes made with models, arms and settings: each is told by cause, place and remedy."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from made_up_mistakes import Mistake, Own, Said, calibrate, call, columns
from made_up_model import fitted, fitted_to
from pa10cal.commands.command_line import run_command
from pa10cal.fit.model_writing import save_model
from pa10cal.fit.validity import AngleCoverage
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import link_departures

JOINTS = [f"q{k}_deg" for k in range(1, 7)]
POSE = ["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]


def springs(arm):
    return (link_departures(arm, Tolerances()), *(JointSpring(k, 80.0) for k in (2, 3)))


def model_of(robot="pa10_6ce"):
    model = fitted(robot, 3, springs)
    about = fitted_to("c1", loads_N=(0.0, 44.0))
    seen = AngleCoverage(tuple(np.array([[0.2, 1.0]]) for _ in range(6)), (False,) * 6)
    return replace(model, fitted_to=about, seen=seen)


MODEL = model_of()
Q_RAD = np.random.default_rng(5).uniform(0.3, 0.9, (8, 6))
T = MODEL.predict(Q_RAD).T
PLACES_MM = 1e3 * T[:, :3, 3]
TURNS = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
POSITIONS = np.degrees(Q_RAD)
AWAY = POSITIONS + np.array([180.0, 0, 0, 0, 0, 0])


def listed(names, *values, separator=",", decimal="."):
    """Return a list of poses: names of its columns, and their numbers."""
    rows = np.hstack(values)
    lines = [separator.join(["id", *names])]
    lines += [separator.join([f"P{k}", *map(repr, row)]) for k, row in enumerate(rows.tolist())]
    return "\n".join([lines[0], *(line.replace(".", decimal) for line in lines[1:]), ""])


def asked(command: str, text: str | None, *more: object, model: str = "model.yaml"):
    """Return what calls `predict` or `compensate` with a list."""

    def command_of(own: Own) -> Said:
        beside = own.folder.parent
        save_model(MODEL, beside / "model.yaml")
        if text is not None:
            (beside / "liste.csv").write_text(text, encoding="utf-8")
        given = ("--joints" if command == "predict" else "--targets", beside / "liste.csv")
        words = ("--model", beside / model, *given, "--out", beside / "out.csv", *more)
        return call(command, *words)

    return command_of


def compared(first: str, second: str):
    def command_of(own: Own) -> Said:
        beside = own.folder.parent
        save_model(MODEL, beside / "juni.yaml")
        save_model(model_of("ur10"), beside / "ur10.yaml")
        return call("compare", beside / first, beside / second)

    return command_of


URDF = """<robot name="r"><link name="base"/><link name="arm"/><link name="flange"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="arm"/><child link="flange"/><axis xyz="0 1 0"/>
<origin xyz="0.3 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def imported(*more: str, file: str = "arm.urdf"):
    def command_of(own: Own) -> Said:
        beside = own.folder.parent
        (beside / "arm.urdf").write_text(URDF, encoding="utf-8")
        return call("import_arm", beside / file, "--out", beside / "mein_arm.yaml", *more)

    return command_of


ARM = """name: mein_arm
title: a SCARA without its lift
rows:
  - {a_m: 0.3, limits_deg: [-120, 120]}
  - {a_m: 0.25, alpha_deg: 90, limits_deg: [-120, 120]}
  - {d_m: 0.2, limits_deg: [-180, 180]}
"""


def described(old: str, new: str):
    """Return what runs a campaign whose arm has another line in its description."""

    def command_of(own: Own) -> Said:
        assert old in ARM
        own.content["robot"] = "mein_arm"
        own.more["mein_arm.yaml"] = ARM.replace(old, new).encode()
        return call("run", own.write(), "--out", own.folder.parent / "out")

    return command_of


def settled(text: str):
    def command_of(own: Own) -> Said:
        path = own.folder.parent / "robust.yaml"
        path.write_text(text, encoding="utf-8")
        return call("run", own.write(), "--out", own.folder.parent / "out", "--settings", path)

    return command_of


def prior_of_another_arm(own: Own) -> Said:
    save_model(MODEL, own.folder.parent / "maerz.yaml")
    return calibrate(own, "--prior", own.folder.parent / "maerz.yaml")


def workbook(own: Own) -> Said:
    own.more["messung.xlsx"] = b"PK\x03\x04" + bytes(60)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "python_calamine", None)
        return columns(own, "messung.xlsx")


def mistake(name, cause, place, remedy, *knowing, **more):
    """Return a mistake that is in the call: nothing of the campaign is spoilt.

    Last stands the command, before it the words that belong to what is known, if there are any.
    """
    *knows, command = knowing
    return Mistake(name, lambda own: None, cause, place, remedy, *(knows or [()]), command, **more)


MISTAKES = [
    mistake(
        "radians for predict",
        "joint positions look like radians",
        r"liste\.csv: q1_deg … q6_deg",
        r"multiply them by 57\.29578",
        ("unit of joints",),
        asked("predict", listed(JOINTS, Q_RAD)),
        warned=True,
    ),
    mistake(
        "a quaternion in the other order for compensate",
        "quaternions look like x, y, z, w",
        r"liste\.csv: qw, qx, qy, qz",
        "name the columns qx,qy,qz,qw",
        ("convention",),
        asked("compensate", listed(POSE, PLACES_MM, np.roll(TURNS, -1, axis=1))),
        warned=True,
    ),
    mistake(
        "seeds in radians",
        "seeds look like radians",
        r"liste\.csv: q1_deg … q6_deg",
        r"multiply them by 57\.29578",
        ("unit of joints",),
        asked("compensate", listed([*POSE, *JOINTS], PLACES_MM, TURNS, Q_RAD)),
        warned=True,
    ),
    mistake(
        "seeds that contradict their targets",
        "8 of 8 seeds contradict their targets",
        r"liste\.csv: q1_deg … q6_deg",
        "check the units and the order of the joints, the frame",
        asked("compensate", listed([*POSE, *JOINTS], PLACES_MM, TURNS, AWAY)),
        warned=True,
    ),
    mistake(
        "a joint too few",
        "missing column q6_deg",
        r"liste\.csv:1",
        "add it",
        asked("predict", listed(JOINTS[:5], POSITIONS[:, :5])),
    ),
    mistake(
        "joints of another arm",
        "a column of another arm.*q7_deg",
        r"liste\.csv:1",
        "give a model of the same arm",
        asked("predict", listed([*JOINTS, "q7_deg"], POSITIONS, POSITIONS[:, :1])),
    ),
    mistake(
        "a list with semicolons and decimal commas",
        "separated by semicolons",
        r"liste\.csv:1",
        "export the file with commas and decimal points",
        ("separator", "decimal"),
        asked("predict", listed(JOINTS, POSITIONS, separator=";", decimal=",")),
    ),
    mistake(
        "targets in metres",
        "no target is further than a hundredth of a metre",
        r"liste\.csv.*x_mm, y_mm, z_mm",
        "multiply .*by 1000",
        ("unit of lengths",),
        asked("compensate", listed(POSE, 1e-3 * PLACES_MM, TURNS)),
    ),
    mistake(
        "a load beyond those of the calibration",
        "does not know this load",
        r"--load-N|load_N",
        "0 to 44 N.*--force",
        asked("predict", listed(JOINTS, POSITIONS), "--load-N", "60"),
    ),
    mistake(
        "a frame that is not there",
        "target_A",
        r"--frame|frame",
        "flange, tool",
        asked("predict", listed(JOINTS, POSITIONS), "--frame", "target_A"),
    ),
    mistake(
        "a list that is not there",
        "the file is not there",
        r"liste\.csv",
        "check the path and the name",
        asked("predict", None),
    ),
    mistake(
        "a model that is not there",
        "the file is not there",
        r"modell\.yaml",
        "correct the path",
        asked("predict", listed(JOINTS, POSITIONS), model="modell.yaml"),
    ),
    mistake(
        "models of two arms",
        "models of arms of different layouts",
        r"juni\.yaml.*ur10\.yaml|pa10_6ce.*ur10|ur10.*pa10_6ce",
        "of (one|the same) arm",
        compared("juni.yaml", "ur10.yaml"),
    ),
    mistake(
        "a folder without a model",
        "the file is not there",
        "juli",
        "correct the path",
        compared("juni.yaml", "juli"),
    ),
    mistake(
        "a link that the URDF has not",
        "no (such )?link.*tool0|tool0",
        r"arm\.urdf|--tip",
        "flange",
        imported("--tip", "tool0"),
    ),
    mistake(
        "a URDF that is not there",
        "the file is not there|No such file",
        r"roboter\.urdf",
        "check the path",
        imported(file="roboter.urdf"),
    ),
    mistake(
        "angles of an arm in radians",
        "alpha_deg looks like radians",
        r"mein_arm\.yaml: row 2",
        "write 90",
        described("alpha_deg: 90", "alpha_deg: 1.5708"),
    ),
    mistake(
        "lengths of an arm in millimetres",
        "a_m is out of proportion",
        r"mein_arm\.yaml: row 1",
        "divide by 1000",
        ("unit of lengths",),
        described("a_m: 0.3,", "a_m: 300,"),
    ),
    mistake(
        "a key of an arm misspelt",
        "unknown key alfa_deg",
        r"mein_arm\.yaml: row 2",
        "did you mean 'alpha_deg'",
        ("meant",),
        described("alpha_deg", "alfa_deg"),
    ),
    mistake(
        "a setting misspelt",
        "unknown key calibration.epsilonn",
        r"robust\.yaml: unknown",
        "did you mean 'epsilon'",
        ("meant",),
        settled(json.dumps({"calibration": {"epsilonn": 1}})),
    ),
    mistake(
        "a prior of another arm",
        "prior is of another arm|of another arm",
        r"maerz\.yaml",
        "model of ur10|same arm",
        prior_of_another_arm,
    ),
    mistake(
        "a workbook without its reader",
        "the package python_calamine is not installed",
        "the Python environment",
        r"pip install '\.\[workbooks\]'",
        workbook,
    ),
]


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_is_told_by_cause_place_and_remedy(own, mistake):
    mistake.judge(own)


def test_a_temperature_that_no_fit_has_seen_is_part_of_the_uncertainty(tmp_path, capsys):
    about = fitted_to("c1", temperature_std_C=0.5)
    save_model(replace(MODEL, fitted_to=about), tmp_path / "model.yaml")
    (tmp_path / "q.csv").write_text(
        f"id,{','.join(JOINTS)},temperature_C,time_s\na,1,2,3,4,5,6,22,3\nb,1,2,3,4,5,6,32.5,4\n"
    )
    words = ["--model", tmp_path / "model.yaml", "--joints", tmp_path / "q.csv"]
    assert run_command("predict", [*map(str, words), "--out", str(tmp_path / "poses.csv")]) == 0
    said = capsys.readouterr().out
    assert "time_s is not used: no effect of the model depends on time" in said
    assert "temperature_C moves no pose" in said
    assert "1 rows are up to 11.0 K from the mean of the fit, 21.5 °C: u_mm holds a growth" in said
    usual, warm = pd.read_csv(tmp_path / "poses.csv").to_dict("records")
    distance_mm = np.linalg.norm([usual[name] for name in ("x_mm", "y_mm", "z_mm")])
    assert warm["u_parameters_mm"] == usual["u_parameters_mm"]
    expected_mm = np.hypot(usual["u_mm"], 18e-6 * 10.0 * distance_mm)
    assert warm["u_mm"] == pytest.approx(expected_mm, rel=1e-6)
