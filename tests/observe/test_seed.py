"""Base frame from straight moves: equations (5)-(7), their uncertainty, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from pa10cal.arrays import homogeneous
from pa10cal.errors import CalibrationError
from pa10cal.observe.seed import EndPositions, axes_from_lines, fit_line, frame_from_lines
from pa10cal.options import BaseFrameOptions

MEASURED = {"campaign": "a", "provenance": "made up", "origin_from": "both moves"}
LIMITS = BaseFrameOptions(min_length_mm=50.0, max_bend_mm=5.0, min_angle_deg=60.0)
TRAVEL_M = np.linspace(0.0, 0.2, 11)


def cell(seed: int, noise_m: float = 0.0):
    """Return (T_instr_base, measured x, base x, measured y, base y) of a made-up cell."""
    rng = np.random.default_rng(seed)
    T = homogeneous(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3))
    base_x = np.array([0.5, 0.1, 0.4]) + np.outer(TRAVEL_M, [1, 0, 0])
    base_y = np.array([0.5, 0.1, 0.4]) + np.outer(TRAVEL_M, [0, 1, 0])
    measured = [
        base @ T[:3, :3].T + T[:3, 3] + noise_m * rng.normal(size=base.shape)
        for base in (base_x, base_y)
    ]
    return T, measured[0], base_x, measured[1], base_y


def seed_of(x, base_x, y, base_y, limits=LIMITS):
    moves = EndPositions(x, base_x), EndPositions(y, base_y)
    both = EndPositions(np.vstack([x, y]), np.vstack([base_x, base_y]))
    return frame_from_lines(*moves, both, limits, **MEASURED)


@examples(40)
@given(seed=st.integers(0, 2**32 - 1))
def test_exact_moves_give_the_base_frame_exactly(seed):
    T, *moves = cell(seed)
    found = seed_of(*moves)
    assert found.T_instr_base == pytest.approx(T, abs=1e-12)
    assert found.angle_between_lines_deg == pytest.approx(90.0)
    assert found.line_x.length_mm == pytest.approx(200.0)
    assert found.origin_scatter_mm == pytest.approx(0.0, abs=1e-9)


@examples(40)
@given(tilt=st.floats(-0.5, 0.5), seed=st.integers(0, 2**32 - 1))
def test_axes_are_a_rotation_that_keeps_x_and_the_plane(tilt, seed):
    R = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    x, y = R[:, 0], R @ [np.sin(tilt), np.cos(tilt), 0.0]
    axes = axes_from_lines(3.0 * x, 0.2 * y)
    assert axes == pytest.approx(R, abs=1e-12)


def test_a_move_travelled_backwards_or_in_any_order_gives_the_same_frame():
    T, x, base_x, y, base_y = cell(4)
    order = np.random.default_rng(0).permutation(len(x))
    found = seed_of(x[::-1], base_x[::-1], y[order], base_y[order])
    assert found.T_instr_base == pytest.approx(T, abs=1e-12)


def test_direction_uncertainty_is_the_scatter_of_many_noisy_lines():
    noise_m, lines = 2e-5, 400
    turned, stated = [], []
    for seed in range(lines):
        T, x, base_x, _, _ = cell(seed, noise_m)
        line = fit_line(x, base_x[:, 0])
        turned.append(T[:3, 1:3].T @ line.direction_instr)
        stated.append(line.direction_u_rad**2)
    assert np.mean(stated) ** 0.5 == pytest.approx(np.square(turned).mean() ** 0.5, rel=0.08)


def test_origin_is_the_mean_offset_of_the_given_poses():
    T, x, base_x, y, base_y = cell(5)
    shifted = np.array([0.003, 0.0, 0.0])
    measured = x[:2] + np.outer([0, 1], shifted)
    moves = EndPositions(x, base_x), EndPositions(y, base_y)
    found = frame_from_lines(*moves, EndPositions(measured, base_x[:2]), LIMITS, **MEASURED)
    assert found.T_instr_base[:3, 3] == pytest.approx(T[:3, 3] + shifted / 2)
    assert found.origin_scatter_mm == pytest.approx(1.5)
    assert found.origin_poses == 2


def shortened(x, base_x, y, base_y):
    return x[:3] * 0.1, base_x[:3], y, base_y


def bent(x, base_x, y, base_y):
    return (
        x,
        base_x,
        y + 10.0 * ((TRAVEL_M - 0.1) ** 2)[:, None] * np.array([0.3, 0.5, 0.8]),
        base_y,
    )


def parallel(x, base_x, y, base_y):
    return x, base_x, x + 0.01 * y, base_y


def two_points(x, base_x, y, base_y):
    return x, base_x, y[:2], base_y[:2]


def exchanged(x, base_x, y, base_y):
    return y, base_y, x, base_x


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (exchanged, r"line_x: .*not along x of the base.*0, 200, 0 mm.*labels"),
        (shortened, r"line_x: .*too short.*mm.*min_length_mm"),
        (bent, r"line_y: .*bent.*max_bend_mm"),
        (parallel, r"line_x and line_y: .*parallel"),
        (two_points, r"line_y: too few points.*got 2"),
    ],
)
def test_refuses_moves_that_give_no_frame(spoil, message):
    with pytest.raises(CalibrationError, match=message):
        seed_of(*spoil(*cell(6)[1:]))
