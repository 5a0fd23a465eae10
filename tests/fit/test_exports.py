"""What other programs get of a fitted model."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from made_up_model import fitted, postures, vocabulary
from made_up_poses import at_rest
from pa10cal.arm.ur_calibration import ur_deltas_text
from pa10cal.fit.rigid import (
    RigidError,
    best_rigid_model,
    beyond_rigid,
    beyond_rigid_mm,
    dh_text,
    rigid_part,
    terms_beyond_rigid,
)
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.stages.export import DEPARTURES, write_exported
from pa10cal.terms.effects.readings import Scale
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import link_departures, tool_frame


def links(arm):
    return (link_departures(arm, Tolerances()), tool_frame())


def measured(model, seed=1):
    q = postures(model.arm, seed, 9)
    at_22 = dict.fromkeys(("load_N", "temperature_C"), np.full(len(q), 22.0))
    states = at_rest(q, tau_Nm=np.full_like(q, np.nan), arrival=np.ones_like(q), **at_22)
    seen = Pose.of(model.predict(q).T, np.tile(np.eye(6), (len(q), 1, 1)))
    return Observations.single(np.array([f"P{k}" for k in range(len(q))]), states, seen)


def test_tool_and_targets_hang_on_the_flange_of_the_rigid_part():
    model = fitted("ur10", 1, links)
    part, q = rigid_part(model), postures(model.arm, 2)
    T = part.T_base_flange(q)
    np.testing.assert_allclose(T, model.predict(q).T, atol=1e-12)
    np.testing.assert_allclose(
        T @ part.frames["tool"], model.predict(q, frame="tool").T, atol=1e-12
    )
    pointed = replace(model, targets_m=np.arange(6) / 10.0, target_names=("A", "B"))
    frames = rigid_part(pointed).frames
    assert [*frames] == ["target_A", "target_B"]
    np.testing.assert_allclose(frames["target_B"][:3, 3], [0.3, 0.4, 0.5], atol=1e-15)


def test_only_files_of_an_earlier_export_are_removed_or_replaced(tmp_path):
    own, not_text, former = (tmp_path / name for name in ("own.conf", "own.yaml", "former.conf"))
    asked_for, none = tmp_path / "robot.urdf", tmp_path / "none"
    text = ur_deltas_text(np.zeros((6, 4)), f"{DEPARTURES} UR10")
    for path in (own, asked_for):
        path.write_text("[mounting]\ndelta_theta = [ 0.0]\n")
    not_text.write_bytes(b"\xff\xfe")
    former.write_text(text)
    assert not write_exported(dict.fromkeys((own, not_text, former, none)), ())
    assert [path.exists() for path in (own, not_text, former)] == [True, True, False]
    former.write_text(text)
    every = (own, not_text, former, none, asked_for)
    lines = write_exported(dict.fromkeys(every, f"{text}# new"), (asked_for, None))
    assert lines == [
        f"{name} is not written: a file of another origin is there"
        for name in ("own.conf", "own.yaml")
    ]
    assert ["# new" in path.read_text(errors="replace") for path in every] == [False] * 2 + [
        True
    ] * 3


def test_what_moves_no_robot_is_nothing_that_a_urdf_lacks():
    model = fitted("ur10", 1, lambda arm: (*links(arm), Scale("instrument")))
    assert not terms_beyond_rigid(model)


def test_what_a_urdf_lacks_is_what_the_model_predicts_beyond_its_links():
    model = fitted("pa10_6ce", 3, vocabulary)
    poses = measured(model)
    states = poses.states
    whole = model.predict(states.q_rad, load_N=22.0, arrival=1.0, temperature_C=22.0, time_s=0.0)
    off = whole.T[:, :3, 3] - rigid_part(model).T_base_flange(states.q_rad)[:, :3, 3]
    off_mm = 1e3 * np.linalg.norm(off, axis=1)
    rms_mm, peak_mm = beyond_rigid_mm(model, poses)
    assert peak_mm == pytest.approx(off_mm.max())
    said = beyond_rigid(model, poses)
    assert "joint_spring of joint 2" in said
    assert f"over the 9 measured poses these move the flange by {rms_mm:.3f} mm rms" in said
    assert "all that the model has" in beyond_rigid(fitted("ur10", 1, links), poses)
    assert "weights that load the arm are not known" in beyond_rigid(
        replace(model, payload=None), poses
    )


def test_rows_are_a_table_with_units():
    model = fitted("pa10_6ce", 4, links)
    rows = list(csv.DictReader(io.StringIO(dh_text(model, "good"))))
    assert [row["joint"] for row in rows] == [str(k) for k in range(1, 7)]
    assert {row["grade"] for row in rows} == {"good"}
    values = model.parameters.set_index("parameter")
    a2 = values.loc["delta_a_2"]
    assert float(rows[1]["a_nominal_mm"]) == 450.0
    assert float(rows[1]["a_departure_mm"]) == pytest.approx(1e3 * a2["value"], abs=1e-8)
    assert float(rows[1]["a_calibrated_mm"]) == pytest.approx(450.0 + 1e3 * a2["value"], abs=1e-8)
    assert float(rows[1]["a_u_mm"]) == pytest.approx(1e3 * a2["std"], rel=1e-4, abs=1e-9)
    beta = np.degrees(values.loc["delta_beta_2", "value"])
    assert float(rows[1]["beta_departure_deg"]) == pytest.approx(beta, abs=1e-8)
    assert rows[1]["d_u_mm"] == ""  # beta stands in its place
    assert rows[0]["theta_u_deg"] != ""
    assert dh_text(replace(model, covariance=None), "x").count(",,") > 6


def test_two_terms_of_one_coordinate_add_their_covariance():
    other = Tolerances(a_m=7e-3)
    model = fitted("pa10_6ce", 4, lambda arm: (*links(arm), link_departures(arm, other)))
    first, count = model.model.terms[0], len(model.model.terms[0].parameters)
    k = [parameter.name for parameter in first.parameters].index("delta_a_2")
    both = [k, len(model.x) - count + k]
    covariance = np.zeros_like(model.covariance)
    covariance[np.ix_(both, both)] = 1e-8 * np.array([[4.0, -1.0], [-1.0, 1.0]])
    text = dh_text(replace(model, covariance=covariance), "good")
    rows = list(csv.DictReader(io.StringIO(text)))
    assert float(rows[1]["a_u_mm"]) == pytest.approx(1e3 * np.sqrt(3e-8))


def test_the_best_rigid_model_is_nearer_than_the_rigid_part_and_exact_where_all_is_rigid():
    model = fitted("pa10_6ce", 3, lambda arm: (*links(arm), JointSpring(2, 80.0)))
    poses = measured(model)
    part, best = rigid_part(model), best_rigid_model(model, poses)
    before, after = (each.error(model, poses) for each in (part, best))
    assert after.rms_mm < 0.5 * before.rms_mm
    assert (after.frame, after.poses) == ("tool", 9)
    rigid = fitted("ur10", 1, links)
    same = best_rigid_model(rigid, measured(rigid))
    np.testing.assert_allclose(same.coordinates, rigid_part(rigid).coordinates, atol=1e-9)
    rows = list(csv.DictReader(io.StringIO(dh_text(model, "good", best, after))))
    assert float(rows[0]["error_rms_mm"]) == pytest.approx(after.rms_mm, abs=1e-4)
    assert {row["theta_u_deg"] for row in rows} == {""}
    found = np.radians(float(rows[1]["theta_calibrated_deg"]))
    (column,) = best.chain.columns(("theta_2",))
    assert found == pytest.approx(best.coordinates[column], abs=1e-10)


@pytest.mark.parametrize(
    ("frame", "words"),
    [("flange", "the flange"), ("target_target", "the target"), ("target_T1", "target T1")],
)
def test_the_error_of_a_rigid_part_names_its_frame_in_words(frame, words):
    assert str(RigidError(0.1, 0.2, 30, frame)).startswith(f"{words} is off by 0.100 mm rms")
