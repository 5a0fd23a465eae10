from dataclasses import replace

import numpy as np
import pytest

from pa10cal.terms.effects.generic import ArrivalMap


def left_of(target, basis):
    """Largest part of a target (m,) that columns (m, k) cannot make."""
    made = basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
    return np.abs(target - made).max() / np.abs(target).max()


def test_a_place_map_makes_any_cubic_field_but_its_constant_and_no_more(at):
    effect = at("place_map", "instrument")
    p_m = np.random.default_rng(4).uniform(0.1, 0.9, (60, 3, 3))
    basis = effect.field(p_m).reshape(-1, 57)
    constant = np.tile(np.eye(3), (180, 1))
    x, y, z = np.moveaxis(p_m, -1, 0)
    nothing = np.zeros_like(x)
    bowed = np.stack([x - y**2, (x - 0.2) ** 2 * z, nothing], axis=-1).ravel()
    assert left_of(bowed, np.hstack([basis, constant])) < 1e-10
    assert left_of(np.stack([nothing, nothing, z**4], axis=-1).ravel(), basis) > 1e-3
    assert left_of(constant[:, 0], basis) > 0.1


def test_a_place_map_is_of_its_plausible_size_a_unit_from_the_middle(at):
    effect = at("place_map", "instrument")
    field = effect.field(np.array([[[0.7, 0.5, 0.6]]]))[0, 0]
    names = [parameter.name for parameter in effect.reported]
    for axis, name in enumerate("xyz"):
        for power in ("x", "xx", "xxx"):
            assert field[axis, names.index(f"{name}_by_{power}")] == pytest.approx(1.0)
    assert np.count_nonzero(field.round(12)) == 9


def test_parts_of_a_place_map_bow_one_axis_along_one(at):
    effect = at("place_map", "instrument")
    p_m = np.random.default_rng(5).uniform(-0.6, 1.6, (40, 1, 3))
    field = effect.field(p_m)[:, 0]  # (40, 3, 57)
    pairs = []
    for part in effect.parts:
        columns = field[:, :, list(part)]
        (axis,) = np.flatnonzero(columns.any(axis=(0, 2)))
        free = np.hstack([columns[:, axis], np.ones((40, 1)), p_m[:, 0]])
        left = [left_of(p_m[:, 0, along] ** 3 - p_m[:, 0, along] ** 2, free) for along in range(3)]
        (along,) = np.flatnonzero(np.array(left) < 1e-9)
        pairs.append((axis, along))
    assert sorted(pairs) == [(axis, along) for axis in range(3) for along in range(3)]
    assert at("windup_map", "joint 2").parts == at("drift_map", "base").parts == ()


def test_a_torque_map_follows_the_angle_over_its_span_and_beyond(at, states):
    effect = at("torque_map", "joint 3")
    low, high = effect.span_rad
    q_rad = np.zeros_like(states.q_rad)
    q_rad[:, 2] = [low, high, 0.5 * (low + high), 1.5 * high - 0.5 * low, low, high]
    found = effect.torque_derivative(replace(states, q_rad=q_rad), np.zeros(4))
    assert not np.delete(found, 2, axis=1).any()
    np.testing.assert_allclose(found[:2, 2], [[-1, 1, -1, 1], [1, 1, 1, 1]], atol=1e-12)
    np.testing.assert_allclose(found[2, 2], [0, -0.5, 0, 0.375], atol=1e-12)
    np.testing.assert_allclose(found[3, 2, :2], [2.0, 5.5], atol=1e-12)


def test_a_windup_map_deflects_by_any_quintic_of_the_torque_but_its_constant(at, states):
    effect = at("windup_map", "joint 2")
    tau_Nm = np.linspace(-1.5, 1.5, 30) * effect.span_Nm
    swept = replace(states, q_rad=np.zeros((30, 6)), tau_Nm=np.outer(tau_Nm, np.eye(6)[1]))
    deflection = -effect.derivative(swept, np.zeros(5))[:, 0]
    np.testing.assert_allclose(deflection[:, 0], tau_Nm / effect.span_Nm)
    free = np.hstack([deflection, np.ones((30, 1))])
    assert left_of((tau_Nm / 50.0) ** 5 - (tau_Nm / 80.0) ** 2, free) < 1e-10
    assert left_of((tau_Nm / 50.0) ** 6, free) > 1e-3
    assert left_of(np.ones(30), deflection) > 0.1


def test_a_drift_map_makes_a_constant_rate(at, states):
    steady = at("base_drift", "base").derivative(states, np.zeros(3))
    effect = at("drift_map", "base")
    basis = effect.derivative(states, np.zeros(18))
    constant = np.tile(np.eye(6), (len(states), 1))
    for k in range(3):
        rate = np.zeros((len(states), 6))
        rate[:, :3] = steady[:, :, k]
        assert left_of(rate.ravel(), np.hstack([basis.reshape(-1, 18), constant])) < 1e-10
    ends = effect.derivative(
        replace(states, time_s=np.linspace(*effect.span_s, len(states))), np.zeros(18)
    )
    np.testing.assert_allclose(ends[-1], np.kron(np.eye(6), np.ones(3)), atol=1e-12)


def test_an_arrival_map_has_an_amount_of_its_own_at_each_knot_for_either_side(states):
    effect, x = ArrivalMap("joint 2", (-0.8, 0.8)), np.arange(17.0)
    angles = np.array([-9.0, -0.8, -0.75, 0.0, 0.8, 9.0])  # knots are 0.1 apart
    q_rad = np.zeros_like(states.q_rad)
    q_rad[:, 1] = angles
    for side in (-1.0, 0.0, 1.0):
        at = replace(states, q_rad=q_rad, arrival=np.full_like(q_rad, side))
        np.testing.assert_allclose(
            effect.shift(at, x)[:, 0], side * np.array([0, 0, 0.5, 8, 16, 16])
        )
    assert effect.coordinates == ("theta_2",)
    assert effect.arriving == (2,)
