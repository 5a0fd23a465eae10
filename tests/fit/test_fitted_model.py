"""A fitted model: what it predicts, in which frame, how surely, and the same from its file."""

from __future__ import annotations

import shutil
from dataclasses import replace
from hashlib import sha256
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from made_up_model import fitted, fitted_to, postures, vocabulary
from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.errors import ModelError, TermError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.fit.covariance_file import covariance_beside, write_covariance
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_reading import load_model, model_from_plain
from pa10cal.fit.model_writing import SCHEMA, model_to_plain, save_model
from pa10cal.fit.validity import angles_seen
from pa10cal.numerics.periodic_spline import (
    MapMotion,
    b_splines,
    b_splines_by_knots,
    position_covariance,
)
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import Backlash, JointCoupling
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.structure import ToolSag
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures, tool_frame
from pa10cal.terms.plain import term_to_plain
from pa10cal.terms.weights import Weights


def with_masses(robot):
    return load_arm(robot).mass_kg is not None


@pytest.mark.slow
@pytest.mark.parametrize("robot", [name for name in arm_names() if with_masses(name)])
@settings(
    max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 2**32 - 1))
def test_with_the_whole_vocabulary_it_is_the_same_from_its_file(robot, seed, tmp_path):
    model = fitted(robot, seed)
    save_model(model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.model.terms == model.model.terms
    assert again.fitted_to == model.fitted_to
    np.testing.assert_array_equal(again.x, model.x)
    np.testing.assert_array_equal(again.covariance, model.covariance)
    q = postures(model.arm, seed)
    for frame in model.frames:
        said, read = (m.predict(q, frame=frame, load_N=22.0, arrival=1.0) for m in (model, again))
        np.testing.assert_allclose(read.T, said.T, rtol=0, atol=1e-12)
        np.testing.assert_allclose(read.u_mm, said.u_mm, rtol=1e-9)
        np.testing.assert_array_equal(read.inside, said.inside)


def test_the_file_alone_predicts_without_uncertainty(tmp_path):
    model = fitted("pa10_6ce", 1)
    save_model(model, tmp_path / "model.yaml", warnings=["synthetic"])
    (tmp_path / "model.covariance.npz").unlink()
    again = load_model(tmp_path / "model.yaml")
    q = postures(model.arm, 2)
    assert np.isnan(again.predict(q).u_mm).all()
    np.testing.assert_allclose(again.predict(q).T, model.predict(q).T, rtol=0, atol=1e-12)


def test_the_file_can_be_read_by_people(tmp_path):
    save_model(fitted("pa10_6ce", 1), tmp_path / "model.yaml", warnings=["synthetic"])
    content = yaml.safe_load((tmp_path / "model.yaml").read_text(encoding="utf-8"))
    assert content["schema"] == SCHEMA
    assert content["warnings"] == ["synthetic"]
    term = next(t for t in content["terms"] if t["id"] == "transmission_error")
    assert term["of"] == "joint 1"
    assert term["formula"] == "theta_1 += A sin(100 q_1 + phi)"
    assert set(term["parameters"]["A"]) == {"value", "std", "unit"}
    assert content["arm"]["rows"][1]["a_m"] == 0.45


def test_parameters_are_a_table_as_readers_know_them():
    model = fitted("pa10_6ce", 1)
    table = model.parameters.set_index(["term", "of", "parameter"])
    assert table.loc[("transmission_error", "joint 1", "A"), "unit"] == "rad"
    assert table.loc[("joint_spring", "joint 2", "K_lin_2"), "value"] == pytest.approx(3e4)
    assert (table["std"] >= 0.0).all()
    assert "transmission_error" in model._repr_html_()
    assert replace(model, covariance=None).parameters["std"].isna().all()


def test_a_fit_is_told_with_the_temperatures_that_were_logged():
    states = at_rest(np.zeros((3, 6)), temperature_C=np.array([20.0, np.nan, 24.0]))
    poses = measured_poses(
        ["A", "B", "C"], states, np.tile(np.eye(4), (3, 1, 1)), np.ones((3, 6, 6))
    )
    health = SimpleNamespace(grade="good", line="", findings=(), outliers_show="")
    campaign = SimpleNamespace(name="mine", provenance="made up")
    found = FittedTo.of(poses, "combined", health, campaign)
    assert (found.temperature_C, found.temperature_std_C) == (22.0, 2.0)


def test_the_nominal_arm_is_of_no_fit():
    model = replace(fitted("ur10", 15, links_only), fitted_to=fitted_to("mine"))
    assert "good" in repr(model)
    assert "good" not in repr(model.nominal())
    assert model.nominal().discrepancy is None


def test_nominal_geometry_is_predicted_by_the_nominal_chain():
    arm = load_arm("pa10_6ce")
    model = FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))
    q = postures(arm, 3)
    np.testing.assert_allclose(model.predict(q).T, Chain.of(arm).forward(q), rtol=0, atol=1e-14)
    assert model.predict(q[0]).T.shape == (1, 4, 4)
    assert np.isnan(model.predict(q).u_mm).all()
    assert model.predict(q).inside.all()


def links_only(arm):
    return (link_departures(arm, Tolerances()),)


def links_and_tool(arm):
    return (*links_only(arm), tool_frame())


def test_the_flange_is_the_flange_and_the_tool_hangs_on_it(tmp_path):
    model = fitted("iiwa14", 4, links_and_tool)
    model.x[model.model.columns_of(model.model.terms[1])] = [0.1, 0.02, 0.2, 0.0, 0.0, 0.0]
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    model = replace(model, R_ee_target=turned)
    elsewhere = np.eye(4)
    elsewhere[:3, 3] = [0.0, 7e-5, 0.0]
    model = replace(model, T_end_shown=elsewhere)
    save_model(model, tmp_path / "model.yaml")
    model = load_model(tmp_path / "model.yaml")
    q = postures(model.arm, 5)
    flange, tool = model.predict(q).T, model.predict(q, frame="tool").T
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turned, [0.1, 0.02 + 7e-5, 0.2]
    np.testing.assert_allclose(flange @ T, tool, atol=1e-12)


def with_targets(model, u_m=0.0, **places_m):
    """Return a model with targets that are known to an uncertainty, independently of all else."""
    covariance = block_diag(model.covariance, u_m**2 * np.eye(3 * len(places_m)))
    targets_m = np.concatenate([*places_m.values()]).astype(float)
    names = tuple(places_m)
    return replace(model, targets_m=targets_m, target_names=names, covariance=covariance)


def test_a_target_is_as_uncertain_as_its_place_in_the_flange_makes_it():
    model = fitted("ur10", 6, links_only)
    q = postures(model.arm, 5)
    known, guessed = (with_targets(model, u_m, A=[0.1, 0, 0], B=[0, 0.2, 0]) for u_m in (0.0, 1e-4))
    for frame, added_mm in (("target_B", 0.1 * np.sqrt(3.0)), ("flange", 0.0)):
        of_known, of_guessed = (each.predict(q, frame=frame).u_mm for each in (known, guessed))
        np.testing.assert_allclose(of_guessed, np.hypot(of_known, added_mm), rtol=1e-12)


def test_targets_hang_on_the_flange():
    model = fitted("iiwa14", 6, links_only)
    model = with_targets(model, A=[0.1, 0, 0], B=[0, 0.2, 0])
    q = postures(model.arm, 5)
    flange = model.predict(q).T
    b = flange[:, :3, 3] + 0.2 * flange[:, :3, 1]
    np.testing.assert_allclose(model.predict(q, frame="target_B").T[:, :3, 3], b, atol=1e-15)
    first = model.predict(q, frame="target_A").T
    np.testing.assert_array_equal(model.predict(q, frame="tool").T, first)


def test_a_target_goes_with_a_tool_that_gives_way_and_the_flange_does_not():
    model = fitted("ur10", 6, lambda arm: (*links_only(arm), ToolSag("tool")))
    model = with_targets(model, A=[0.0, 0.1, 0.2])
    sag = model.model.columns_of(model.model.terms[-1])
    stiff = replace(model, x=np.where(np.arange(len(model.x)) == sag.start, 0.0, model.x))
    q = postures(model.arm, 5)
    np.testing.assert_array_equal(model.predict(q).T, stiff.predict(q).T)
    for frame in ("target_A", "tool"):
        moved = (
            model.predict(q, frame=frame).T[:, :3, 3] - stiff.predict(q, frame=frame).T[:, :3, 3]
        )
        R = model.predict(q).T[:, :3, :3]
        across = np.einsum("pji,j->pi", R, [0.0, 0.0, -1.0]) * [1.0, 1.0, 0.0]
        wanted = model.x[sag.start] * np.einsum("pij,pj->pi", R, across)
        np.testing.assert_allclose(moved, wanted, atol=1e-9)
    assert np.abs(moved).max() > 1e-6


def moved_place(model, drawn, q, frame):
    """Return where a frame is with other parameters, and the base moved along its own axes."""
    k = len(model.x)
    moved = replace(model, x=model.x + drawn[:k], covariance=None)
    place = moved.predict(q, frame=frame).T[:, :3, 3]
    return place + drawn[k : k + 3] + np.cross(drawn[k + 3 : k + 6], place)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["flange", "tool", "target_A"])
def test_uncertainty_is_that_of_predictions_with_drawn_parameters(frame):
    model = fitted("ur10", 7, links_and_tool if frame != "target_A" else links_only)
    if frame == "target_A":
        model = with_targets(model, A=[0.1, 0.2, 0.3])
    q, rng = postures(model.arm, 8, 4), np.random.default_rng(9)
    root = np.linalg.svd(model.covariance)
    draws = rng.normal(size=(3000, 3)) @ (np.sqrt(root[1][:3]) * root[0][:, :3]).T
    places = np.array([moved_place(model, d, q, frame) for d in draws])
    expected = 1e3 * np.sqrt(places.var(axis=0).sum(axis=1))
    np.testing.assert_allclose(model.predict(q, frame=frame).u_mm, expected, rtol=0.06)


def of_smooth_terms(arm):
    """All terms, each that changes by hundreds of waves a turn with a small amplitude aside."""
    return tuple(term for term in vocabulary(arm) if term.id != "transmission_error")


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("terms", [links_and_tool, of_smooth_terms])
def test_the_jacobian_is_that_of_small_moves(terms):
    model = fitted("pa10_6ce", 10, terms)
    model.x[model.model.columns_of(tool_frame())][:3] = [0.05, 0.02, 0.3]
    q, h = postures(model.arm, 11, 3), 1e-5
    found = model.jacobian(q, frame="tool")
    for joint in range(model.arm.n):
        step = np.zeros(model.arm.n)
        step[joint] = h
        ahead, behind = (model.predict(q + s * step, frame="tool").T for s in (1, -1))
        by_q = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(found[:, :3, joint], by_q[:, :3, 3], atol=1e-8)
        spin = by_q[:, :3, :3] @ np.swapaxes(model.predict(q, frame="tool").T[:, :3, :3], 1, 2)
        about = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        np.testing.assert_allclose(found[:, 3:, joint], about, atol=1e-8)


def test_what_is_read_falsely_moves_no_robot():
    model = fitted("pa10_6ce", 12)
    false = {"along_move", "cmm_scale", "cmm_squareness", "friction_torque", "scale", "torque_gain"}
    false |= {"place_map", "move_settling"}
    physical = model.only(*(term for term in model.model.terms if term.id not in false))
    q = postures(model.arm, 13)
    np.testing.assert_array_equal(model.predict(q).T, physical.predict(q).T)


def test_the_state_of_the_pose_counts():
    q = postures(load_arm("pa10_6ce"), 14)
    model = fitted("pa10_6ce", 15)
    still = model.predict(q).T
    assert np.abs(model.predict(q, load_N=44.0).T - still).max() > 1e-5
    assert np.abs(model.predict(q, arrival=1.0).T - still).max() > 1e-6
    assert np.abs(model.predict(q, temperature_C=35.0).T - still).max() > 1e-6
    assert isinstance(model.states(q), PoseStates)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "pa10cal-model/1"}, "schema.*pa10cal-model/1.*allowed: pa10cal-model/2"),
        ({"terms": None}, "cannot be built from"),
        ({"arm": "absent"}, "key arm is missing"),
        ({"targets_m": "absent"}, "key targets_m is missing"),
        ({"tool": {"R_ee_target": [[1.0]]}}, "cannot be built from"),
        ({"T_instr_base": [[1.0, 0.0]]}, "T_instr_base"),
    ],
)
def test_what_is_no_model_is_refused_by_name(change, message, tmp_path):
    path = tmp_path / "model.yaml"
    save_model(fitted("ur10", 15, links_and_tool), path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    for key, value in change.items():
        content.pop(key)
        if value != "absent":
            content[key] = value
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ModelError, match=message):
        load_model(path)


def test_an_unknown_term_is_refused_by_name(tmp_path):
    path = tmp_path / "model.yaml"
    save_model(fitted("ur10", 15, links_and_tool), path)
    path.write_text(path.read_text(encoding="utf-8").replace("id: offsets", "id: ofsets", 1))
    with pytest.raises(TermError, match=r"model\.yaml: terms\[0\]: id: unknown term.*offsets"):
        load_model(path)
    path.write_text("{", encoding="utf-8")
    with pytest.raises(ModelError, match=r"cannot be read"):
        load_model(path)
    with pytest.raises(ModelError, match=r"cannot be read"):
        load_model(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            JointSpring(9, 50.0),
            r"joint_spring of joint 9: .*\(got 'theta_9'\).*joints 1 to 6 of ur10",
        ),
        (JointSpring(2, 0.0), r"key tau_ref_Nm .*greater than 0"),
        (Backlash("joint 0"), r"backlash of joint 0: .*\(got 'theta_0'\)"),
        (JointCoupling("joint 3", 8, slides=False), r"joint_coupling of joint 3: .*'joint 8'"),
        (Weights(6, (3, 27), (0.1, 0.1)), r"weights of arm: .*\(got 'column 27'\)"),
        (Weights(7, (3,), (0.1,)), r"weights of arm: .*\(got '7 joints'\)"),
    ],
)
def test_a_term_of_what_the_arm_has_not_is_refused_when_it_is_read(term, message):
    model = fitted("ur10", 15, links_and_tool)
    plain = model_to_plain(model)
    values = [0.0] * len(term.parameters)
    plain["terms"].append({**term_to_plain(term), "formula": term.formula, "x": values})
    with pytest.raises(TermError, match=message):
        model_from_plain(plain, where="model.yaml")


def test_a_term_of_another_formula_is_refused(tmp_path):
    path = tmp_path / "model.yaml"
    model = fitted("ur10", 15, lambda arm: (*links_and_tool(arm), Backlash("joint 1")))
    save_model(model, path)
    assert load_model(path).model.terms[-1] == Backlash("joint 1")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("theta_1 -= b s_1", "theta_1 += b s_1"), encoding="utf-8")
    with pytest.raises(ModelError, match=r"formula.*theta_1 \+= b s_1.*calibrate"):
        load_model(path)


def test_of_no_poses_nothing_is_predicted():
    model = fitted("pa10_6ce", 16)
    assert model.predict(np.zeros((0, 6))).T.shape == (0, 4, 4)
    assert model.compensate(np.zeros((0, 4, 4))).q.shape == (0, 6)


def test_what_cannot_be_predicted_is_refused():
    model = fitted("pa10_6ce", 16)
    with pytest.raises(ModelError, match=r"5 joints.*allowed: .N, 6. for pa10_6ce"):
        model.predict(np.zeros((2, 5)))
    for words in ("a", [[1.0, 2.0], [3.0]]):
        with pytest.raises(ModelError, match=r"q: not an array of numbers"):
            model.predict(words)
    with pytest.raises(ModelError, match=r"q: joint positions of 3 dimensions.*got .2, 1, 6"):
        model.predict(np.zeros((2, 1, 6)))
    with pytest.raises(ModelError, match=r"q: joint positions that are no finite numbers"):
        model.predict(np.full(6, np.nan))
    with pytest.raises(ModelError, match=r"T: not a pose"):
        model.compensate(5.0)
    with pytest.raises(ModelError, match=r"unknown frame.*target_A.*allowed: flange, tool"):
        model.predict(np.zeros(6), frame="target_A")
    with pytest.raises(ModelError, match=r"joint_spring of joint 2: the weights.*not known"):
        replace(model, payload=None).predict(np.zeros(6))
    for condition, place in (
        ({"temperature_C": [20.0, np.inf]}, r"temperature_C of pose 2"),
        ({"time_s": -np.inf}, r"time_s of pose 1"),
    ):
        with pytest.raises(ModelError, match=f"{place}: no finite number"):
            model.predict(np.zeros((2, 6)), **condition)
    with pytest.raises(ModelError, match=r"3 values for"):
        replace(model, x=np.zeros(3), covariance=None)


def test_a_covariance_of_another_model_is_refused(tmp_path):
    save_model(fitted("ur10", 15, links_and_tool), tmp_path / "model.yaml")
    other = replace(fitted("ur10", 15, links_only), covariance=np.eye(30))
    save_model(other, tmp_path / "other.yaml")
    (tmp_path / "other.covariance.npz").replace(tmp_path / "model.covariance.npz")
    with pytest.raises(ModelError, match=r"covariance: a covariance of shape \(30, 30\)"):
        load_model(tmp_path / "model.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda C: C.fill(np.nan), "not made of finite numbers"),
        (lambda C: C.__setitem__((3, 3), np.inf), "not made of finite numbers"),
        (lambda C: C.__setitem__((3, 3), -C[3, 3]), "a variance below zero, that of parameter 3"),
        (lambda C: C.__setitem__((0, 1), C[0, 1] + 0.5 * np.sqrt(C[0, 0] * C[1, 1])), "symmetric"),
        (
            lambda C: [
                C.__setitem__(at, 2.0 * np.sqrt(C[0, 0] * C[1, 1])) for at in ((0, 1), (1, 0))
            ],
            "correlations that no random numbers have",
        ),
        # A parameter without a variance goes with no other.
        (lambda C: C.__setitem__((3, 3), 0.0), "correlations that no random numbers have"),
    ],
)
def test_a_covariance_that_no_random_numbers_have_is_refused(change, message, tmp_path):
    model = fitted("ur10", 15, links_only)
    covariance = model.covariance.copy()
    change(covariance)
    save_model(model, tmp_path / "model.yaml")
    write_covariance(replace(model, covariance=covariance), tmp_path / "model.covariance.npz")
    with pytest.raises(ModelError, match=rf"model\.yaml: covariance: .*{message}.*write"):
        load_model(tmp_path / "model.yaml")


def test_a_covariance_of_parameters_that_are_held_is_one(tmp_path):
    model = fitted("ur10", 15, links_only)
    covariance = model.covariance.copy()
    covariance[3], covariance[:, 3] = 0.0, 0.0
    save_model(replace(model, covariance=covariance), tmp_path / "model.yaml")
    np.testing.assert_array_equal(load_model(tmp_path / "model.yaml").covariance, covariance)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with a model; to be read only."""
    folder = tmp_path_factory.mktemp("saved")
    save_model(fitted("pa10_6ce", 16), folder / "model.yaml")
    return folder


def weights(**changes):
    """Return the weights of a six-joint arm as its file has them."""
    known = {"from": "stated", "why": "", "mass_u": [0.1] * 6, "com_u_m": [0.01] * 6}
    return {**known, "by_log": None, **changes}


def by_log(**changes):
    """Return what a log shows of these weights, as the file has it."""
    return {"x": [0.0] * 27, "covariance": np.zeros((27, 27)).tolist(), "said": "", **changes}


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize(
    "change",
    [
        lambda plain: plain["T_instr_base"][0].__setitem__(0, 0.5),
        lambda plain: plain["T_instr_base"][0].__setitem__(3, float("nan")),
        lambda plain: plain["T_instr_base"][3].__setitem__(3, 2.0),
        lambda plain: plain["tool"].__setitem__("R_ee_target", [[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        lambda plain: plain["arm"]["T_base_row1"][0].__setitem__(0, -1.0),
        lambda plain: plain["targets_m"].update(A=[0.0, 0.0, None]),
        lambda plain: plain["arm"]["rows"][1].update(alpha_rad=float("inf")),
        lambda plain: plain["arm"]["rows"][1].update(d_m=None),
        lambda plain: plain["arm"]["rows"][1].update(limits_rad=1.0),
        lambda plain: plain["payload"].update(load_point_m=float("nan")),
        lambda plain: plain["payload"].update(com_m=[0.0, 0.0]),
        lambda plain: plain["payload"].update(mass_kg=float("inf")),
        lambda plain: plain["arm"].update(convention="Modified"),
        lambda plain: plain["arm"]["rows"][1].update(prismatic=None),
        lambda plain: plain["arm"]["rows"][1].update(hayati="false"),
        lambda plain: plain["arm"].update(coupling=[{"joint": 7, "by": 1, "factor": 1.0}]),
        lambda plain: plain["arm"].update(
            coupling=[{"joint": 1, "by": 2, "factor": 1.0}, {"joint": 2, "by": 1, "factor": 1.0}]
        ),
        lambda plain: plain["arm"].update(weights=weights(mass_u=[0.1])),
        lambda plain: plain["arm"].update(weights=weights(com_u_m=[None] * 6)),
        lambda plain: plain["arm"].update(weights={**weights(), "from": "hearsay"}),
        lambda plain: plain["arm"].update(weights=weights(by_log=by_log(x=[0.0]))),
        lambda plain: plain["arm"].update(weights=weights(by_log=by_log(zero_Nm=[1.0]))),
        lambda plain: plain["targets_m"].update({"1": [0.0, 0.1], "2": [0.1, 0.1], "3": [0, 0]}),
        lambda plain: plain["seen"].pop(),
        lambda plain: plain["seen"][0].update(intervals=[[1.0, -1.0]]),
        lambda plain: plain["seen"][0].update(intervals=[[-1.0, float("nan")]]),
        lambda plain: plain.update(otherwise={"probability": 1.5, "model": dict(plain)}),
    ],
)
def test_frames_that_are_none_are_refused(change, saved, tmp_path):
    path = shutil.copytree(saved, tmp_path / "saved") / "model.yaml"
    plain = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)
    change(plain)
    path.write_text(yaml.dump(plain, Dumper=yaml.CSafeDumper), encoding="utf-8")
    with pytest.raises(ModelError, match=r"model\.yaml.*: .*cannot be built"):
        load_model(path)


def test_a_model_to_fall_back_to_is_of_the_same_arm(saved, tmp_path):
    path = shutil.copytree(saved, tmp_path / "saved") / "model.yaml"
    plain = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)
    other = model_to_plain(fitted("iiwa14", 1, links_only))
    for change in (
        {"otherwise": {"probability": 0.1, "model": other}},
        {"falls_back": {"within": plain["seen"], "model": other}},
    ):
        path.write_text(yaml.dump({**plain, **change}, Dumper=yaml.CSafeDumper), encoding="utf-8")
        with pytest.raises(ModelError, match="7 joints"):
            load_model(path)


def test_a_covariance_has_the_same_bytes_under_every_python(tmp_path):
    model = fitted("ur10", 15, links_only)
    size = len(model.covariance)
    known = replace(model, covariance=np.arange(float(size**2)).reshape(size, size))
    write_covariance(known, tmp_path / "model.covariance.npz")
    written = (tmp_path / "model.covariance.npz").read_bytes()
    digest = "f04dfef19009e021a23618dee38db66828fda4e99c6a1cf9f84cc3c3fd3bdb73"
    assert sha256(written).hexdigest() == digest
    with np.load(tmp_path / "model.covariance.npz") as stored:
        np.testing.assert_array_equal(stored["covariance"], known.covariance)


def test_a_covariance_with_fine_maps_of_all_joints_is_read_again(tmp_path):
    size = 6 * 360 + 70  # a measured arm has so many
    wide = replace(fitted("ur10", 15, links_only), covariance=np.eye(size))
    write_covariance(wide, tmp_path / "model.covariance.npz")
    assert covariance_beside(tmp_path / "model.yaml").shape == (size, size)


@pytest.mark.parametrize("knots", [(), (12,), (36, 24)])
def test_variances_by_few_splines_are_those_of_all_knots(knots):
    rng = np.random.default_rng(4)
    poses, dense, total = 30, 5, 5 + sum(knots)
    root = rng.standard_normal((total, total))
    covariance = root @ root.T
    order = rng.permutation(total)
    moved = rng.standard_normal((poses, 3, dense))
    columns, maps, first = [moved], [], dense
    for count in knots:
        q_rad, turned = rng.uniform(-9.0, 9.0, poses), rng.standard_normal((poses, 3))
        maps.append(MapMotion(order[first : first + count], q_rad, turned))
        by_knot = b_splines(count, q_rad) @ b_splines_by_knots(count)
        columns.append(turned[:, :, None] * by_knot[:, None, :])
        first += count
    whole = np.concatenate(columns, axis=2)
    expected = np.einsum("pik,kl,pjl->pij", whole, covariance[np.ix_(order, order)], whole)
    found = position_covariance(covariance, order[:dense], moved, maps)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_beyond_the_angles_seen_a_map_is_uncertain_by_what_it_changes():
    of_map = JointErrorMap(of="joint 1", knots=12)
    model = fitted("pa10_6ce", 3, lambda _arm: (of_map, tool_frame()))
    x = model.x.copy()
    x[model.model.parameter_indices(of_map)] = 3e-4 * np.sin(2.0 * np.pi * np.arange(12) / 12)
    seen = angles_seen(np.outer([-1.0, 1.0], np.ones(6)))
    known, q = replace(model, x=x, seen=seen), np.array([[0.4, 0.5, 0.5, 0.5, 0.5, 0.5]] * 3)
    q[:, 0] = 0.4, -1.5, 1.5
    found, without = (
        known.predict(q, frame="tool"),
        replace(known, seen=None).predict(q, frame="tool"),
    )
    more_mm = np.sqrt(found.u_mm**2 - without.u_mm**2)
    arm_mm = 1e3 * np.hypot(*found.T[:, :2, 3].T)
    wave_rad = 2.0 * 3e-4 * np.sin(0.5 * 0.5)
    assert more_mm == pytest.approx(arm_mm * [0.0, wave_rad, wave_rad], rel=0.02, abs=1e-9)


def test_uncertain_joint_positions_are_in_the_uncertainty_of_a_prediction(tmp_path):
    u_rad = (4e-4, 4e-4, 0.0, 2e-4, 0.0, 0.0)
    exact = replace(fitted("pa10_6ce", 3, lambda _arm: (tool_frame(),)), fitted_to=fitted_to("c1"))
    uncertain = replace(exact, fitted_to=fitted_to("c1", u_q_rad=u_rad))
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 6))
    drawn = np.random.default_rng(3).normal(0.0, 1.0, (2000, 6)) * u_rad
    at, more = exact.predict(q, frame="tool"), uncertain.predict(q, frame="tool")
    for k in range(len(q)):
        off_mm = 1e3 * (exact.predict(q[k] + drawn, frame="tool").T - at.T[k])[:, :3, 3]
        of_joints_mm = np.sqrt(np.mean(np.sum(off_mm**2, axis=1)))
        assert more.u_mm[k] == pytest.approx(np.hypot(at.u_mm[k], of_joints_mm), rel=0.05)
    np.testing.assert_array_equal(more.u_parameters_mm, at.u_parameters_mm)
    uncertain.save(tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml").predict(q, frame="tool")
    np.testing.assert_allclose(again.u_mm, more.u_mm, rtol=1e-9)
