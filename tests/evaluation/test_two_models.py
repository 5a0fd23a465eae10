"""What differs between two models, and whether it matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pa10cal
from calibrated import calibrated
from made_up_model import fitted
from made_up_pair import PART, campaign, parts, shifted
from mended import write_simulated
from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Controller
from pa10cal.arrays import homogeneous
from pa10cal.errors import ModelError
from pa10cal.evaluation import two_models
from pa10cal.files.arms import parse_arm
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage, nothing_seen
from pa10cal.options import Tolerances
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures


def over_u(found, name):
    rows = found.parameters
    (k,) = np.flatnonzero(rows.parameter == name)
    return rows.over_u[k]


def test_a_model_agrees_with_itself():
    model = campaign(1)
    found = pa10cal.compare(model, model)
    assert found.agree
    assert found.postures == two_models.POSTURES
    assert found.loads_N == (0.0, 22.0)
    flange = found.frames["flange"]
    assert flange.rms_mm == flange.orientation_deg == 0.0
    assert flange.remaining_rms_mm < 1e-12
    assert (found.parameters.difference == 0.0).all()
    assert found.line.startswith("the models agree within their uncertainty: their flanges differ")


def test_two_campaigns_of_one_robot_differ_as_expected(monkeypatch):
    monkeypatch.setattr(two_models, "POSTURES", 60)
    found = [pa10cal.compare(campaign(k), campaign(k + 1)) for k in range(100, 160, 2)]
    flanges = [each.frames["flange"] for each in found]
    assert sum(not each.agree for each in found) <= 1
    # The less likely of place and orientation counts, twice.
    assert 0.3 < np.median([flange.chance for flange in flanges]) <= 1.0
    for left, expected in (("remaining_rms_mm", "expected_mm"), ("remaining_deg", "expected_deg")):
        squares = [(getattr(f, left) / getattr(f, expected)) ** 2 for f in flanges]
        assert np.mean(squares) == pytest.approx(1.0, abs=0.35)
    u = np.concatenate([each.parameters.over_u for each in found])
    assert np.sqrt(np.mean(u**2)) == pytest.approx(1.0, abs=0.1)


def test_a_joint_that_moved_is_seen_in_the_flange_and_named_among_the_parameters():
    one, other = campaign(1), shifted(campaign(2), delta_theta_3=1e-3)
    found = pa10cal.compare(one, other)
    assert found.agree is False
    assert found.frames["flange"].chance < 1e-6
    assert "more than their uncertainty" in found.line
    assert over_u(found, "delta_theta_3") > 20.0
    rows = found.parameters
    assert rows.parameter[np.nanargmax(np.abs(rows.over_u))] == "delta_theta_3"


def test_models_that_agree_though_a_part_of_the_arm_moved_say_both():
    found = pa10cal.compare(campaign(1), shifted(campaign(1), delta_theta_4=1.2e-4))
    assert found.agree
    assert found.what_moved.verdict == "joint_zero_moved"
    assert found.line.endswith("a part of the arm moved, which changes poses by less than that")


def test_what_base_and_tool_explain_does_not_count():
    # The zero of joint 1 turns the base, that of joint 6 the tool.
    moved = shifted(campaign(1), delta_theta_1=0.02, delta_d_1=0.003, delta_theta_6=0.3)
    found = pa10cal.compare(campaign(1), moved)
    flange = found.frames["flange"]
    assert found.agree
    assert flange.rms_mm > 5.0
    assert flange.base_and_tool_mm == pytest.approx(flange.rms_mm, rel=1e-6)
    assert flange.orientation_deg > 15.0
    # The weight of what is mounted off the axis turns with it, and the spring of joint 2 gives way.
    assert flange.remaining_rms_mm < 2e-3
    assert flange.remaining_deg < 2e-4


@pytest.mark.parametrize("turned_rad", [0.02, 1.5, np.pi])
def test_a_base_that_is_turned_changes_nothing(turned_rad):
    # The zero of joint 1 turns the base, and is far less known than what it hides.
    one, other = (with_std(campaign(k), "delta_theta_1", 0.01) for k in (1, 2))
    other = shifted(other, delta_theta_3=3e-3)
    flange = pa10cal.compare(one, other).frames["flange"]
    found = pa10cal.compare(one, shifted(other, delta_theta_1=turned_rad))
    assert found.agree is False
    turned = found.frames["flange"]
    assert turned.expected_mm == pytest.approx(flange.expected_mm, rel=1e-6)
    assert turned.expected_deg == pytest.approx(flange.expected_deg, rel=1e-6)
    assert turned.remaining_rms_mm == pytest.approx(flange.remaining_rms_mm, rel=1e-6)
    assert pa10cal.compare(one, with_std(campaign(2), "delta_theta_1", 0.01)).agree


def with_std(model, name, std):
    """Return a model of which one parameter has another standard uncertainty."""
    covariance = model.covariance.copy()
    k = [parameter.name for parameter in model.model.parameters].index(name)
    covariance[k, k] = std**2
    return replace(model, covariance=covariance)


def test_a_tool_elsewhere_moves_the_errors_of_its_frame():
    # Errors of a frame and of one that is fixed to it, by differences of their poses.
    rng = np.random.default_rng(3)
    T = homogeneous(Rotation.random(5, random_state=1).as_matrix(), rng.normal(size=(5, 3)))
    base, tool = (
        homogeneous(Rotation.random(random_state=k).as_matrix(), rng.normal(size=3)) for k in (2, 3)
    )
    step, modes = 1e-6, rng.normal(size=(5, 6, 1))

    def erring(T, modes):
        turned = Rotation.from_rotvec(step * modes[:, 3:, 0]).as_matrix() @ T[:, :3, :3]
        return homogeneous(turned, T[:, :3, 3] + step * modes[:, :3, 0])

    moved = two_models._modes_moved(modes, T, base, tool)
    expected = base @ erring(T, modes) @ tool
    np.testing.assert_allclose(erring(base @ T @ tool, moved), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("spread_m", [0.0, 0.01, 1.0])
def test_motions_of_base_and_tool_are_found_however_large(spread_m):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        R = Rotation.from_rotvec(rng.normal(0.0, 0.5, (60, 3))).as_matrix()
        T = homogeneous(R, spread_m * rng.normal(size=(60, 3)) + 1.0)
        turned = [Rotation.random(random_state=100 * k + seed).as_matrix() for k in (1, 2)]
        base, tool = homogeneous(turned[0], rng.normal(size=3)), homogeneous(turned[1], R[0, 0])
        T_wanted = base @ T @ tool
        found_base, found_tool = two_models._moved_onto(T, T_wanted)
        np.testing.assert_allclose(found_base @ T @ found_tool, T_wanted, rtol=0, atol=1e-9)


def test_only_angles_that_both_have_seen_are_compared():
    one, other = campaign(1), campaign(2)
    n = one.arm.n

    def seen(low, high):
        return AngleCoverage((np.array([[low, high]]),) * n, (False,) * n)

    apart = pa10cal.compare(one, replace(other, seen=seen(1.2, 1.5)))
    assert apart.agree is None
    assert apart.postures == 0
    assert not apart.frames
    assert apart.line.endswith("no common angles of joints 1, 2, 3, 4, 5, 6")
    turned = seen_in(-1.0, 1.0)
    turned = replace(turned, intervals=(*turned.intervals[:5], turned.intervals[5] + 2.0 * np.pi))
    within = [replace(model, seen=seen_in(-1.0, 1.0)) for model in (one, other)]
    apart = pa10cal.compare(within[0], replace(within[1], seen=turned))
    assert apart.line.endswith(
        "no common angles of joint 6; those of joint 6 are whole turns apart"
    )
    no_limits = [without_limits(model, 5) for model in (one, other)]
    seen_far = replace(turned, intervals=(*turned.intervals[:5], np.array([[8.0, 10.0]])))
    far = [replace(model, seen=seen_far) for model in no_limits]
    assert pa10cal.compare(*far).agree
    far = [replace(model, seen=seen_far) for model in (one, other)]
    assert pa10cal.compare(*far).line.endswith(
        "judged: no position of joint 6 that both know is within the limits of both arms"
    )
    # An effect far off outside what it holds for is of no account there.
    away = shifted(other, delta_theta_2=0.1)
    fallen = replace(other, falls_back=FallBack(seen(-0.5, 0.5), away))
    assert pa10cal.compare(one, fallen).agree
    assert pa10cal.compare(one, replace(other, seen=None)).agree


def without_limits(model, joint):
    """Return a model of an arm that does not state the limits of a joint, from 0."""
    limits_rad = model.arm.limits_rad.copy()
    limits_rad[joint] = [-np.inf, np.inf]
    chain = replace(model.model.chain, arm=replace(model.arm, limits_rad=limits_rad))
    return replace(model, model=replace(model.model, chain=chain))


def of_rows(rows, seed=None):
    """Return a model of an arm of these rows, off by its uncertainty (or not, without a seed)."""
    arm = parse_arm({"name": "own", "title": "own", "rows": rows}, where="own")
    model = Model(Chain.of(arm), (link_departures(arm, Tolerances()),))
    scale = np.concatenate([PART * model.scale, np.full(6, 1e-5)])
    x = np.zeros(len(model.scale))
    if seed is not None:
        x = np.random.default_rng(seed).normal(0.0, scale[:-6])
    return FittedModel(model, x, np.eye(4), covariance=np.diag(scale**2))


SLIDE = {"prismatic": True, "limits_m": [0.0, 1.0]}
GANTRY = [SLIDE | {"alpha_deg": 90.0}, SLIDE | {"alpha_deg": 90.0}, SLIDE]
TURNTABLE = [{"limits_deg": [-180.0, 180.0], "a_m": 0.3}]


@pytest.mark.parametrize("rows", [GANTRY, TURNTABLE])
def test_rounding_that_base_and_tool_leave_is_no_difference(rows):
    # Errors of a gantry's orientation, and all of a turntable's, are alike in every posture.
    found = [pa10cal.compare(of_rows(rows, k), of_rows(rows, k + 1)) for k in range(0, 20, 2)]
    assert sum(not each.agree for each in found) <= 1  # where 1 of 100 differs by chance
    if rows is GANTRY:
        assert np.median([each.frames["flange"].chance for each in found]) < 0.9
        bent = of_rows(rows)
        assert pa10cal.compare(bent, shifted(bent, delta_alpha_1=0.01)).agree is False


def test_postures_are_within_the_limits_of_both_arms():
    def limited(limits_m):
        return of_rows([{**SLIDE, "limits_m": limits_m}, *TURNTABLE])

    def slides(one, other):
        return two_models._common_intervals(one, other)[0].tolist()

    assert slides(limited([0.0, 1.0]), limited([0.5, 3.0])) == [[0.5, 1.0]]
    model = limited([0.0, 1.0])
    arm = replace(model.arm, limits_rad=np.full((2, 2), [-np.inf, np.inf]))
    free = replace(model, model=replace(model.model, chain=replace(model.model.chain, arm=arm)))
    assert slides(free, free) == [[-1.0, 1.0]]
    ends = [np.array([[low, low + 1.0]]) for low in (0.0, 2.0)]
    on_rails = [
        replace(free, seen=AngleCoverage((span, np.array([[-1.0, 1.0]])), (False,) * 2))
        for span in ends
    ]
    line = pa10cal.compare(*on_rails).line
    assert line.endswith("they have seen no common positions of joint 1")
    visited = (np.array([[0.0, 9.0]]), np.array([[-1.0, 1.0]]))
    on_rail = replace(free, seen=AngleCoverage(visited, (False,) * 2))
    assert slides(free, on_rail) == [[0.0, 9.0]]
    ends = two_models._with_ends(np.array([[5.0, np.inf], [-np.inf, -5.0], [-np.inf, np.inf]]))
    assert ends.tolist() == [[5.0, 6.0], [-6.0, -5.0], [-1.0, 1.0]]


def seen_in(low, high):
    return AngleCoverage((np.array([[low, high]]),) * 6, (False,) * 6)


def test_a_joint_held_at_one_angle_in_both_campaigns_is_compared_there():
    held = AngleCoverage(
        (np.array([[0.123, 0.123]]), *seen_in(-1.0, 1.0).intervals[1:]), (False,) * 6
    )
    one, other = replace(campaign(1), seen=held), replace(campaign(2), seen=held)
    found = pa10cal.compare(one, other)
    assert found.postures == two_models.POSTURES
    assert found.agree
    # Of angles modulo a turn, too, in whichever turn the limits allow.
    modulo = replace(held, intervals=(held.intervals[0] + 2 * np.pi - 0.5,) * 6, turns=(True,) * 6)
    models = [replace(model, seen=modulo) for model in (one, other)]
    q = two_models._postures(two_models._common_intervals(*models))
    np.testing.assert_allclose(q, 0.123 - 0.5, atol=1e-12)


def test_where_effects_hold_nowhere_the_calibrated_models_are_compared(tmp_path):
    one, calibrated_model = campaign(1), campaign(2)
    # An effect that holds nowhere, whatever it says, is of no account.
    outer = shifted(calibrated_model, delta_theta_2=0.1)
    nowhere = FallBack(nothing_seen(one.arm.n), calibrated_model)
    other = replace(outer, falls_back=nowhere)
    found, expected = pa10cal.compare(one, other), pa10cal.compare(one, calibrated_model)
    assert found.agree
    assert found.frames == expected.frames
    moved = replace(other, falls_back=replace(nowhere, model=shifted(outer, delta_theta_3=0.01)))
    moved.save(tmp_path / "model.yaml")  # without the covariance of the calibrated model
    assert pa10cal.compare(one, pa10cal.load_model(tmp_path / "model.yaml")).agree is False


def test_without_a_covariance_it_is_not_judged_and_a_doubtful_grade_is_said():
    found = pa10cal.compare(campaign(1), replace(campaign(2), covariance=None), ("a", "b"))
    assert found.agree is None
    assert found.frames["flange"].expected_mm is None
    assert found.second.covariance is False
    assert np.isnan(found.parameters.over_u).all()
    assert "cannot be judged: the covariance is missing of b; their flanges differ" in found.line
    doubtful = campaign(2).fitted_to.model_copy(update={"grade": "suspect_input"})
    found = pa10cal.compare(campaign(1), replace(campaign(2), fitted_to=doubtful), ("a", "b"))
    assert found.line.endswith("; mind that b is graded suspect_input")


def test_terms_of_one_only_are_told():
    def no_spring(arm):
        return tuple(term for term in parts(arm) if term.id != "joint_spring")

    found = pa10cal.compare(campaign(1), campaign(2, terms=no_spring))
    assert found.first.only_here == ("joint_spring of joint 2",)
    assert found.second.only_here == ()
    rows = found.parameters
    (k,) = np.flatnonzero(rows.parameter == "K_lin_2")
    assert rows.first[k] > 0.0
    assert np.isnan([rows.second[k], rows.difference[k], rows.over_u[k]]).all()


def test_parameters_that_no_pose_determines_are_not_called_different():
    one = campaign(1)
    k = [parameter.name for parameter in one.model.parameters].index("delta_d_1")
    covariance = one.covariance.copy()
    covariance[k, k] = 1e-34
    held = replace(shifted(one, delta_d_1=1e-14), covariance=covariance)
    assert np.isnan(over_u(pa10cal.compare(held, replace(one, covariance=covariance)), "delta_d_1"))


def test_turns_of_the_tool_count_from_the_attitude_that_a_fit_began_with():
    one, other = campaign(1), campaign(2)
    assert np.isfinite(over_u(pa10cal.compare(one, other), "tool_rx"))
    turned = replace(other, R_ee_target=Rotation.from_rotvec([0.0, 0.0, 0.1]).as_matrix())
    assert np.isnan(over_u(pa10cal.compare(one, turned), "tool_rx"))
    assert np.isfinite(over_u(pa10cal.compare(one, turned), "tool_x"))


def test_turns_of_the_tool_of_a_campaign_of_a_group_count_from_there_too(monkeypatch):
    one, other = campaign(1), campaign(2)
    every = FittedModel.every_reported

    def of_june(model):
        return [
            (replace(term, of="tool@june") if term.of == "tool" else term, *more)
            for term, *more in every(model)
        ]

    monkeypatch.setattr(FittedModel, "every_reported", of_june)
    turned = replace(other, R_ee_target=Rotation.from_rotvec([0.0, 0.0, 0.1]).as_matrix())
    assert np.isfinite(over_u(pa10cal.compare(one, other), "tool_rx"))
    assert np.isnan(over_u(pa10cal.compare(one, turned), "tool_rx"))


def test_models_that_agree_on_the_same_readings_say_so():
    about = campaign(1).fitted_to.model_copy(update={"readings": ("1",)})
    one, other = (replace(campaign(k), fitted_to=about) for k in (1, 2))
    found = pa10cal.compare(one, other)
    assert found.agree
    assert "both rest on the same readings, so that they may differ by less" in found.line
    assert "same readings" not in pa10cal.compare(campaign(1), campaign(2)).line


@pytest.mark.slow
def test_two_halves_of_a_campaign_agree(tmp_path):
    plan = {"instrument": "points", "poses": 160, "departs": "rows"}
    raw = {"random_seed": 21, "robot": "irb120", "without_touches": plan}
    measured = pa10cal.read_campaign(write_simulated(tmp_path / "raw", raw))
    every, about = measured.observations, (measured.description, measured.arm)
    half = np.arange(len(every)) % 2 == 0
    found = pa10cal.compare(*(calibrated(*about, every.take(rows)) for rows in (half, ~half)))
    assert found.agree, found.line
    assert found.frames["flange"].remaining_rms_mm < 0.05
    assert np.sqrt(np.nanmean(found.parameters.over_u**2)) < 1.5


def test_descriptions_that_differ_otherwise_are_told():
    one, other = campaign(1), campaign(2)
    heavier = replace(other, payload=replace(other.payload, mass_kg=3.0))
    assert pa10cal.compare(one, heavier).described_otherwise == ("payload.mass_kg",)
    for changed in (
        {"controller": Controller(compensation=True, known=False)},
        {"coupled": (CoupledJoint(3, 2, 1.0),)},
    ):
        model, chain = other.model, other.model.chain
        arm = replace(other.arm, **changed)
        described = replace(other, model=replace(model, chain=replace(chain, arm=arm)))
        (name,) = changed
        expected = {"coupled": "coupling"}.get(name, name)
        assert pa10cal.compare(one, described).described_otherwise == (expected,)
    unknown = replace(fitted("ur10", 3, lambda arm: (link_departures(arm, Tolerances()),)))
    found = pa10cal.compare(unknown, replace(unknown, payload=None))
    assert found.described_otherwise == ("payload",)


def test_arms_of_another_layout_are_refused():
    with pytest.raises(ModelError, match=r"b \(ur10\).*layouts.*convention|d_m of row 1: "):
        pa10cal.compare(campaign(1), campaign(1, robot="ur10"), ("a", "b"))
    other = campaign(2)
    chain = other.model.chain
    longer = replace(other.arm, d_m=other.arm.d_m + np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0]))
    other = replace(other, model=replace(other.model, chain=replace(chain, arm=longer)))
    with pytest.raises(ModelError, match=r"d_m of row 4: 0.48 and 0.49.*the same arm"):
        pa10cal.compare(campaign(1), other)
    turn = Rotation.from_euler("z", 30.0, degrees=True)
    turned = homogeneous(turn.as_matrix(), np.array([0.2, 0.0, 0.0]))
    raised = replace(chain.arm, T_base_row1=turned @ chain.arm.T_base_row1)
    other = replace(other, model=replace(other.model, chain=replace(chain, arm=raised)))
    with pytest.raises(ModelError, match=r"T_base_row1: [\d.]+ mm and 30 deg apart"):
        pa10cal.compare(campaign(1), other)
