"""The one solver: valleys, bounds, weights that change, and rounding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.numerics.least_squares import (
    Bounds,
    Equations,
    Linearised,
    axis_text,
    best_candidate,
    descend,
    minimise,
    solve_normal,
    split_identified,
)


def still(at, taken):
    return bool(np.abs(taken.step).max() < 1e-12)


def rosenbrock(x):
    jacobian = np.array([[-1.0, 0.0], [-20.0 * x[0], 10.0]])
    return Equations.of(np.array([1.0 - x[0], 10.0 * (x[1] - x[0] ** 2)]), jacobian)


def test_a_curved_valley_is_followed_to_its_end():
    found = minimise(np.array([-1.2, 1.0]), rosenbrock, np.add, still, most_steps=200)
    np.testing.assert_allclose(found.at, 1.0, atol=1e-9)
    assert found.converged


def test_bounds_hold_what_presses_on_them_and_free_the_rest():
    bounds = Bounds(np.array([-np.inf, -np.inf]), np.array([0.5, np.inf]))
    found = minimise(
        np.array([-1.2, 1.0]),
        rosenbrock,
        lambda x, step: bounds.clip(x + step),
        still,
        most_steps=300,
        held=bounds.held,
    )
    np.testing.assert_allclose(found.at, [0.5, 0.25], atol=1e-9)


@settings(deadline=None)  # a busy machine takes long for a moment
@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
def test_what_stops_at_the_end_of_its_range_lets_the_others_step_on(seed, count):
    rng = np.random.default_rng(seed)
    jacobian, values = rng.normal(size=(20, count)), rng.normal(size=20)
    free = np.linalg.lstsq(jacobian, values, rcond=None)[0]
    # The first may go half the way from zero to where it would go.
    bounds = Bounds(np.full(count, -np.inf), np.full(count, np.inf))
    (bounds.upper if free[0] > 0.0 else bounds.lower)[0] = 0.5 * free[0]
    found = minimise(
        np.zeros(count),
        lambda x: Equations.of(jacobian @ x - values, jacobian),
        lambda x, step: bounds.clip(x + step),
        still,
        most_steps=5,
        held=bounds.held,
        beyond=bounds.beyond,
    )
    rest = values - 0.5 * free[0] * jacobian[:, 0]
    others = np.linalg.lstsq(jacobian[:, 1:], rest, rcond=None)[0]
    np.testing.assert_allclose(found.at, [0.5 * free[0], *others], atol=1e-8)
    assert found.iterations <= 3


@settings(deadline=None)  # a busy machine takes long for a moment
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_a_linear_problem_takes_one_step(seed, count):
    rng = np.random.default_rng(seed)
    jacobian, values = rng.normal(size=(20, count)), rng.normal(size=20)
    found = minimise(
        np.zeros(count),
        lambda x: Equations.of(jacobian @ x - values, jacobian),
        np.add,
        still,
        most_steps=5,
    )
    expected = np.linalg.lstsq(jacobian, values, rcond=None)[0]
    np.testing.assert_allclose(found.at, expected, atol=1e-8)
    assert found.iterations <= 3


def test_weights_that_follow_the_residual_find_the_median():
    values = np.array([0.0, 1.0, 2.0, 3.0, 100.0])
    weights = np.ones(5)

    def equations(x):
        root = np.sqrt(weights)
        return Equations.of(root * (x[0] - values), root[:, None])

    def reweighted(x, taken):
        weights[:] = 1.0 / np.maximum(np.abs(x[0] - values), 1e-9)
        return equations(x)

    found = minimise(np.zeros(1), equations, np.add, still, most_steps=400, reweighted=reweighted)
    assert found.at[0] == pytest.approx(2.0, abs=1e-6)


def test_where_no_step_leads_down_it_ends_there():
    found = minimise(
        np.zeros(1),
        lambda x: Equations(1.0 + abs(x[0]), np.ones(1), np.eye(1)),
        np.add,
        still,
        most_steps=5,
    )
    assert found.at[0] == 0.0
    assert "no step reduces the error" in found.reason


def test_a_start_without_a_finite_error_is_no_minimum():
    for cost in (np.nan, np.inf):
        found = minimise(
            np.zeros(1),
            lambda x, cost=cost: Equations(cost, np.ones(1), np.eye(1)),
            np.add,
            still,
            most_steps=5,
        )
        assert not found.converged
        assert "no finite number" in found.reason


def test_too_few_steps_are_said():
    found = minimise(np.array([-1.2, 1.0]), rosenbrock, np.add, still, most_steps=2)
    assert not found.converged
    assert "2 steps were not enough" in found.reason


def test_directions_left_open_stay_where_they_are():
    normal = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    solved = solve_normal(normal, np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(solved, [0.5, 0.5, 0.0], atol=1e-12)


def test_a_valley_that_full_steps_leave_is_followed_to_its_end():
    def problem(x):  # Rosenbrock's
        by_step = np.array([[1.0, 0.0], [20.0 * x[0], -10.0]])
        return Linearised(by_step, np.array([1.0 - x[0], 10.0 * (x[1] - x[0] ** 2)]))

    end, there = descend(np.array([-1.2, 1.0]), problem, lambda x, step: x + step)
    np.testing.assert_allclose(end, 1.0, atol=1e-9)
    assert there.cost < 1e-20


def test_steps_that_would_go_up_are_damped():
    def problem(x):  # atan: full steps from far away overshoot further and further
        return Linearised(np.array([[1.0 / (1.0 + x[0] ** 2)]]), -np.arctan(x))

    end, _ = descend(np.array([20.0]), problem, lambda x, step: x + step)
    assert abs(end[0]) < 1e-9


def test_what_others_mimic_is_open():
    rng = np.random.default_rng(5)
    others = rng.normal(size=(40, 2))
    mimicked = others @ [1.0, -2.0]
    these = np.column_stack([rng.normal(size=40), mimicked, rng.normal(size=40)])
    split = split_identified(these, others)
    assert split.identified.shape == (3, 2)
    np.testing.assert_allclose(np.abs(split.unidentified), [[0.0], [1.0], [0.0]], atol=1e-9)
    assert np.linalg.matrix_rank(np.hstack([split.identified, split.unidentified])) == 3


def test_open_directions_are_said_along_single_unknowns_where_they_span_them():
    split = split_identified(np.tile(np.eye(3), (5, 1)), np.tile(np.eye(3), (5, 1)))
    assert split.identified.shape == (3, 0)
    np.testing.assert_allclose(np.sort(np.abs(split.unidentified), axis=0), np.eye(3)[:, [2, 2, 2]])


def test_all_is_free_where_nothing_is_mimicked():
    split = split_identified(np.eye(4)[:, :2], np.eye(4)[:, 2:])
    assert split.unidentified.shape == (2, 0)
    assert np.linalg.matrix_rank(split.identified) == 2


def test_a_direction_has_its_largest_component_positive():
    assert axis_text(np.array([1e-9, 0.0, -2.0])) == "(0.00, 0.00, 1.00)"


def test_the_first_of_the_least_is_found_without_fitting_all():
    misfits, fitted = [5.0, 2.0, 3.0, 2.0, 9.0], []

    def fit(k: int) -> float:
        fitted.append(k)
        return misfits[k]

    assert best_candidate([4.0, 1.5, 2.5, 1.0, 8.0], fit, 10.0) == (2.0, 1)
    assert sorted(fitted) == [1, 3]
    assert best_candidate([4.0, 1.5, 2.5, 1.0, 8.0], fit, 1.9) is None
