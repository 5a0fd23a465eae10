"""Joints that move together and are not said to: cause, joints, size and key to set are named."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from benchmarks.couplings import industrial, scara, telescope

from made_up_poses import states_of
from made_up_sightings import described
from mended import findings
from pa10cal import calibrate
from pa10cal.arm.chain import Chain
from pa10cal.calibration.joint_slips import joint_zeros
from pa10cal.calibration.log_changes import ReorderedColumns, ReversedSigns
from pa10cal.calibration.rules import CHECKS
from pa10cal.campaign.read import read_campaign
from pa10cal.discovery.log_faults import faults_of_input
from pa10cal.files.arms import arm_text, parse_arm
from pa10cal.options import Tolerances
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures
from pa10cal.terms.term import TermParameter

#: What is logged of each kind of arm, as the coupling that it takes to read it.
KINDS = {
    "fanuc": (lambda rng: industrial(rng, -1), {"joint": 3, "by": 2, "factor": 1}),
    "parallelogram": (lambda rng: industrial(rng, 1), {"joint": 3, "by": 2, "factor": -1}),
    "wrist": (lambda rng: industrial(rng, 1), {"joint": 6, "by": 5, "factor": 1}),
    "quill": (scara, {"joint": 3, "by": 4, "mm_per_turn": 20.0}),
    "rest of a quill": (scara, {"joint": 3, "by": 4, "mm_per_turn": -0.4}),
    "telescope": (telescope, {"joint": 4, "by": 3, "factor": -1}),
}
ONE_MOTOR = {"one motor": (telescope, {"joint": 4, "by": 3, "factor": 1, "follows": True})}


def logged(folder, kind, seed, poses=60):
    """Write what a controller logs and an instrument reads of an arm a little off nominal."""
    rows, coupling = (KINDS | ONE_MOTOR)[kind]
    rng = np.random.default_rng(seed)
    plain = parse_arm({"name": "mine", "rows": rows(rng)}, where="mine.yaml")
    arm = parse_arm({**yaml.safe_load(arm_text(plain)), "coupling": [coupling]}, where="mine.yaml")
    model = Model(Chain.of(plain), (link_departures(plain, Tolerances()),))
    x = np.array([p.scale for p in model.parameters]) * rng.normal(0.0, 1.0, len(model.parameters))
    low, high = arm.limits_rad.T
    q = low + (high - low) * rng.uniform(0.1, 0.9, (poses, arm.n))
    if coupling.get("follows"):
        q = arm.coupling.to_joints(arm.coupling.to_axes(q))
    T = model.predict(states_of(plain, poses=poses, q_rad=q), x)
    targets_m = np.add(rng.uniform(-0.15, 0.15, (3, 3)), [0.0, 0.0, 0.1])
    p_m = np.einsum("pij,bj->pbi", T[:, :3, :3], targets_m) + T[:, None, :3, 3]
    p_mm = 1e3 * np.add(p_m, [1.2, -0.4, 0.3]) + rng.normal(0.0, 0.02, p_m.shape)
    axes = arm.coupling.to_axes(q)
    in_file = np.where(arm.axes_slide, 1e3 * axes, np.degrees(axes)).round(5)
    units = np.where(arm.axes_slide, "mm", "deg")
    columns = {f"q{k + 1}_{unit}": in_file[:, k] for k, unit in enumerate(units)}
    columns |= {
        f"T{b + 1}_{axis}_mm": p_mm[:, b, k].round(5)
        for b in range(3)
        for k, axis in enumerate("xyz")
    }
    table = pd.DataFrame(
        {"pose": [f"P{k}" for k in range(poses)], "load_N": 0.0, "repeat": 1} | columns
    )
    folder.mkdir()
    table.to_csv(folder / "poses.csv", index=False)
    (folder / "mine.yaml").write_text(arm_text(plain))
    instrument, holdout = {"kind": "points", "uncertainty_mm": 0.03}, {"every": 5}
    about = {"name": folder.name, "robot": "mine"}
    description = described(**about, instrument=instrument, holdout=holdout)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description))
    return coupling, description


@pytest.mark.slow_but_one_in(18)
@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_joints_logged_together_are_told_with_what_to_set(tmp_path, kind, seed):
    folder = tmp_path / "c"
    coupling, description = logged(folder, kind, seed)
    read = read_campaign(folder)
    assert read.quarantined == (), "a row is thrown out that the coupling fits"
    (found,) = findings(folder)
    assert found.kind == "joint_coupling"
    stated = yaml.safe_load(re.search(r"coupling: (\[\{.*?\}\])", found.remedy)[1])
    (entry,) = stated
    assert (entry["joint"], entry["by"]) == (coupling["joint"], coupling["by"])
    size = "factor" if "factor" in coupling else "mm_per_turn"
    assert entry[size] == pytest.approx(coupling[size], abs=0.03)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description | {"coupling": stated}))
    assert read_campaign(folder).quarantined == ()
    assert findings(folder) == ()


def test_one_motor_that_drives_two_slides_is_calibrated_as_one(tmp_path):
    """Files have no column of the joint that follows, and what moves them apart is no unknown."""
    folder = tmp_path / "c"
    coupling, description = logged(folder, "one motor", 1)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description | {"coupling": [coupling]}))
    read = read_campaign(folder)
    assert "q6" not in (folder / "poses.csv").read_text()
    model = calibrate(read)
    assert model.grade == "good"
    states = read.held_out.states
    axes = read.arm.coupling.to_axes(states.q_rad)
    off_mm = model.deviations(read.held_out).position_mm
    assert np.sqrt(np.mean(off_mm**2)) < 0.06
    found = model.compensate(model.predict(axes).T, seed=axes)
    assert found.q == pytest.approx(axes, abs=1e-6)


def zero_found(joint):
    """Return what is found where a zero is off, of an arm whose joint 3 follows joint 2."""
    coupling = {"joint": 3, "by": 2, "factor": -1, "follows": True}
    rows = industrial(np.random.default_rng(1), 1)
    arm = parse_arm({"name": "mine", "rows": rows, "coupling": [coupling]}, where="mine.yaml")
    off = SimpleNamespace(
        problem=SimpleNamespace(parameters=[TermParameter(f"delta_theta_{joint}", "rad", 1e-3)]),
        fit=SimpleNamespace(x=[0.05]),
    )
    q_rad = np.zeros((5, arm.n))
    checked = SimpleNamespace(
        arm=arm,
        grid=SimpleNamespace(states=SimpleNamespace(q_rad=q_rad)),
        payload=None,
        not_departures_m=CHECKS.not_departures_m,
        calibration=lambda _: off,
        nominal_misfit_m=lambda q: 1e-3 if q.any() else 0.05,
        may_be_offered=lambda *_: True,
        offsets_deg=[0.0] * len(arm.axes_slide),
        words=SimpleNamespace(joint=lambda number: f"q{number}"),
    )
    return joint_zeros(checked)


def test_the_zero_of_a_joint_that_is_not_logged_is_no_slip_of_the_log():
    """No column and no offset of an axis can put it right."""
    assert zero_found(3) is None


def test_the_zero_of_a_joint_after_one_that_follows_has_its_own_number_and_column():
    found = zero_found(4)
    assert (found.joint, found.where) == (4, "q3")
    assert found.what.startswith("the zero of joint 4 is ")
    (fault,) = faults_of_input([found])
    assert (fault.kind, fault.where) == ("joint_zero", "joint 4")


def test_signs_and_exchanges_name_the_joints_that_the_axes_drive():
    arm = SimpleNamespace(coupling=SimpleNamespace(own=np.array([0, 1, 3, 4, 5])))
    assert ReversedSigns((3,)).text(arm) == "the sign of joint 4 is reversed"
    assert ReorderedColumns.exchanged(5, 2, 3).text(arm) == "joints 2 and 4 are exchanged"


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("kind", ["fanuc", "quill"])
def test_what_is_coupled_and_said_so_is_not_accused(tmp_path, kind):
    folder = tmp_path / "c"
    coupling, description = logged(folder, kind, 4)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description | {"coupling": [coupling]}))
    assert findings(folder) == ()
    wrong = coupling | ({"factor": -1} if kind == "fanuc" else {"mm_per_turn": -20.0})
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description | {"coupling": [wrong]}))
    (found,) = findings(folder)
    size = "factor: 1}" if kind == "fanuc" else "mm_per_turn: 20"
    assert size in found.remedy or "mm_per_turn: 19.9" in found.remedy


@pytest.mark.slow
def test_a_coupling_stated_the_wrong_way_round_is_told_with_the_right_one(tmp_path):
    folder = tmp_path / "c"
    coupling, description = logged(folder, "fanuc", 1)
    wrong = coupling | {"joint": coupling["by"], "by": coupling["joint"]}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(description | {"coupling": [wrong]}))
    (found,) = findings(folder)
    assert "set coupling: [{joint: 3, by: 2, factor: 1}] in campaign.yaml" in found.remedy
    assert found.would_leave_mm < 5.0
