"""Damped least squares, and what data leave open."""

from __future__ import annotations

import numpy as np

from pa10cal.numerics.descent import Linearised, axis_text, descend, split_identified


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
