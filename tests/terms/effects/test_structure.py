from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import ObservedTargets
from pa10cal.discovery.jacobians import by_terms, residual_and_jacobian
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.frame.point_fits import fit_rigid
from pa10cal.observe.points import Points
from pa10cal.terms.effects.structure import (
    BaseCompliance,
    LateralCompliance,
    LinkBending,
    LinkTorsion,
)
from pa10cal.terms.model import Model


def rows(arm, q_rad):
    """Frames of the rows, standard Denavit-Hartenberg, written out: T_base_0 … T_base_n."""
    found = [np.eye(4)]
    for i, q in enumerate(q_rad):
        turn, twist = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_euler("z", q + arm.theta_rad[i]).as_matrix()
        turn[2, 3] = arm.d_m[i]
        twist[:3, :3] = Rotation.from_euler("x", arm.alpha_rad[i]).as_matrix()
        twist[0, 3] = arm.a_m[i]
        found.append(found[-1] @ turn @ twist)
    return found


def motion(effect, arm, states, x):
    """Velocity of the end over its angular velocity, (P, 6), in the model."""
    model = Model(Chain.of(arm, bends=tuple(range(1, arm.n))), (effect,))
    return model.predict_with_jacobian(states, np.zeros(len(x))).jacobian @ x


def test_a_bent_link_is_an_even_beam(at, arm, states):
    # Moment and curvature along it, and from these slope and deflection of its end by quadrature.
    along = np.linspace(0.0, 1.0, 2001)
    for name, row in (("upper_arm", 2), ("forearm", 4)):
        moved = motion(at("link_bending", name), arm, states, np.array([1e-6]))
        for p, q_rad in enumerate(states.q_rad):
            frames = rows(arm, q_rad)
            start, end = frames[row - 1][:3, 3], frames[row][:3, 3]
            axis = (end - start) / np.linalg.norm(end - start)
            loads, R_base_end = states.static_loads, frames[row][:3, :3]
            moment = R_base_end @ loads.link_Nm[p, row - 1]
            force = R_base_end @ loads.link_N[p, row - 1]
            beyond = np.outer(1.0 - along, end - start)
            curvature = 1e-6 * (moment - axis * (axis @ moment) + np.cross(beyond, force))
            turn = simpson(curvature, x=along, axis=0)
            lever = beyond + frames[-1][:3, 3] - end
            shift = simpson(np.cross(curvature, lever), x=along, axis=0)
            np.testing.assert_allclose(moved[p], np.hstack([shift, turn]), atol=1e-13)


def test_a_twisted_forearm_turns_what_follows_about_its_axis(at, arm, states):
    moved = motion(at("link_torsion", "forearm"), arm, states, np.array([1e-6]))
    for p, q_rad in enumerate(states.q_rad):
        frames = rows(arm, q_rad)
        axis = (frames[4][:3, 3] - frames[3][:3, 3]) / 0.48
        turn = 1e-6 * axis * (axis @ frames[4][:3, :3] @ states.static_loads.link_Nm[p, 3])
        shift = np.cross(turn, frames[-1][:3, 3] - frames[4][:3, 3])
        np.testing.assert_allclose(moved[p], np.hstack([shift, turn]), atol=1e-15)


@pytest.mark.parametrize("kind", [BaseCompliance, LinkBending, LinkTorsion, LateralCompliance])
def test_a_light_arm_is_as_soft_as_it_is_light(kind, arm, context):
    """Lengths of a thirtieth and masses by their cube turn as much under their own weight."""
    small = replace(
        arm,
        a_m=arm.a_m / 30.0,
        d_m=arm.d_m / 30.0,
        mass_kg=arm.mass_kg / 27e3,
        com_m=arm.com_m / 30.0,
    )
    moment_Nm = 0.5 * 9.81 * small.mass_kg.sum() * small.reach_m
    for effect in kind.everywhere(replace(context, arm=small)):
        turns_rad = [each.plausible * moment_Nm for each in effect.reported]
        np.testing.assert_allclose(turns_rad, 3e-4)
    for effect in kind.everywhere(context):
        assert {each.plausible for each in effect.reported} == {kind.scale_and_size[1]}


def test_a_compliant_base_tilts_under_the_overturning_moment(at, arm, states):
    moved = motion(at("base_compliance", "base"), arm, states, np.array([2e-6, 5e-6]))
    turn = states.static_loads.base_Nm * [2e-6, 5e-6, 0.0]
    p_base_ee = Chain.of(arm).forward(states.q_rad)[:, :3, 3]
    np.testing.assert_allclose(moved, np.hstack([np.cross(turn, p_base_ee), turn]), atol=1e-15)


def test_a_tool_sags_across_its_axis_and_not_along_it(at, arm, states):
    carried = replace(states.static_loads, down_ee=np.tile([0.6, 0.0, 0.8], (len(states), 1)))
    moved = motion(
        at("tool_sag", "tool"), arm, replace(states, static_loads=carried), np.array([1e-4])
    )
    x_base_ee = Chain.of(arm).forward(states.q_rad)[:, :3, 0]
    np.testing.assert_allclose(moved[:, :3], 0.6e-4 * x_base_ee, atol=1e-18)
    assert not moved[:, 3:].any()


# What goes with time or temperature.


def test_a_creeping_base_carries_the_arm_along(at, arm, states):
    rate = np.array([1e-5, -2e-5, 3e-5])
    model = Model(Chain.of(arm), (at("base_drift", "base"),))
    hourly = replace(states, time_s=100.0 + 3600.0 * np.arange(len(states)))
    moved = model.predict(hourly, rate) - Chain.of(arm).forward(states.q_rad)
    np.testing.assert_allclose(moved[:, :3, 3], np.outer(np.arange(len(states)), rate), atol=1e-15)
    np.testing.assert_allclose(moved[:, :3, :3], 0.0, atol=1e-15)


def test_a_warm_arm_is_one_with_a_longer_pedestal_and_longer_links(at, arm, states):
    warm = replace(states, temperature_C=np.full(len(states), 31.0))
    grown = 1.0 + 10.0 * 2e-5 * np.array([1, 1, 0, 1, 0, 0])  # rows of pedestal, upper arm, forearm
    longer = replace(arm, d_m=arm.d_m * grown, a_m=arm.a_m * grown)
    model = Model(Chain.of(arm), (at("thermal_growth", "arm"),))
    np.testing.assert_allclose(
        model.predict(warm, np.array([2e-5])), Chain.of(longer).forward(states.q_rad), atol=1e-15
    )


# False readings.


BALLS_M = np.array([[0.095, 0.0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])
STEP_M = 1e-6


def motion_in_ee(T_from, T_to):
    """Small motion from one pose to another, along the axes of the first, (..., 6)."""
    back = np.swapaxes(T_from[..., :3, :3], -1, -2)
    shift = np.einsum("...ij,...j->...i", back, T_to[..., :3, 3] - T_from[..., :3, 3])
    turn = Rotation.from_matrix((back @ T_to[..., :3, :3]).reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([shift, turn.reshape(shift.shape)], axis=-1)


of_matrices = pytest.mark.parametrize(
    ("name", "x", "matrix"),
    [
        ("cmm_scale", [1e-4, -2e-4, 3e-4], np.diag([1e-4, -2e-4, 3e-4])),
        ("scale", [2e-4], np.diag([2e-4, 2e-4, 2e-4])),
        ("cmm_squareness", [2e-4], 2e-4 * np.outer([1, 0, 0], [0, 1, 0])),
    ],
)


@of_matrices
def test_predicts_the_pose_that_a_false_instrument_reads(name, x, matrix, at, arm, states):
    """The instrument stands at the base here, and reads p + matrix p."""
    T_true = Chain.of(arm).forward(states.q_rad)
    p_m = np.einsum("pij,bj->pbi", T_true[:, :3, :3], BALLS_M) + T_true[:, None, :3, 3]
    nudges = STEP_M * np.eye(9).reshape(9, 1, 3, 3)
    nudged = fit_rigid(BALLS_M, p_m + nudges).T
    by_targets = np.moveaxis(motion_in_ee(T_true, nudged), 0, -1) / STEP_M
    seen = ObservedTargets(p_instr_targets_m=p_m, pose_by_targets=by_targets)
    model = Model(Chain.of(arm), (at(name, "instrument"),))
    predicted = model.predict(replace(states, seen=seen), np.array(x))
    read = fit_rigid(BALLS_M, p_m + p_m @ matrix.T).T
    moved = motion_in_ee(T_true, read)
    assert np.abs(moved).max() > 1e-5
    np.testing.assert_allclose(motion_in_ee(T_true, predicted), moved, atol=2e-7)


@of_matrices
def test_the_pattern_of_the_targets_is_read_as_falsely(name, x, matrix, at, arm, states):
    """The model with the true targets predicts the false readings of every target."""
    T_true = Chain.of(arm).forward(states.q_rad)
    p_m = np.einsum("pij,bj->pbi", T_true[:, :3, :3], BALLS_M) + T_true[:, None, :3, 3]
    cov_m2 = np.broadcast_to(np.eye(3), (*p_m.shape, 3))
    true = Points(("T1", "T2", "T3"), p_m, cov_m2, BALLS_M)
    seen = true.readout(T_true, BALLS_M.ravel())
    read = replace(true, p_instr_m=p_m + p_m @ matrix.T)
    model, there = Model(Chain.of(arm), (at(name, "instrument"),)), replace(states, seen=seen)
    fitted = FittedModel(model, np.array(x), np.eye(4), targets_m=BALLS_M.ravel())
    T_read = model.predict(there, fitted.x)
    rigid = read.compare(T_read, fitted.targets_m).residual
    whole = read.compare(T_read, fitted.targets_read_m(there)).residual
    assert np.abs(rigid).max() > 5e-6  # the pattern is 0.15 m wide
    np.testing.assert_allclose(whole, 0.0, atol=2e-7)
    # Derivatives, of the model's own terms and of one that joins, are the false readings.
    poses, (effect,) = SimpleNamespace(measured=read, states=there), model.terms
    _, own = residual_and_jacobian(replace(fitted, x=0.0 * fitted.x), poses)
    bare = replace(fitted, model=Model(Chain.of(arm), ()), x=np.zeros(0))
    (joining,) = by_terms(bare, poses, [effect], [0.0 * fitted.x])
    wanted = effect.field(p_m).reshape(len(p_m), 9, -1)
    np.testing.assert_allclose(own[:, :, : len(x)], wanted, atol=1e-9)
    np.testing.assert_allclose(joining, wanted, atol=1e-9)
