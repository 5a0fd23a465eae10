"""Cells hold every reading once, and what cells of a pose share is laid out as it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from made_up_poses import at_rest, measured_poses
from pa10cal.discovery.evidence.noise_model import average_into_cells, shared_error
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.observe.points import Points


def rows_of(pose, load_N, side, time_s, repeats=None):
    """Return rows; the joint angles of row k are 1 at k, so that means show what they hold."""
    count = len(pose)
    return measured_poses(
        pose=np.array([f"P{k}" for k in pose]),
        states=at_rest(
            np.eye(count),
            tau_Nm=np.zeros((count, 2)),
            arrival=np.stack([side, np.ones(count)], axis=1),
            load_N=np.asarray(load_N, dtype=float),
            time_s=np.asarray(time_s, dtype=float),
        ),
        T_instr_ee=np.tile(np.eye(4), (count, 1, 1)),
        cov=np.tile(np.eye(6), (count, 1, 1)),
        readings=np.ones(count, dtype=np.int64) if repeats is None else np.asarray(repeats),
    )


@st.composite
def some_readings(draw):
    count = draw(st.integers(1, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return rows_of(
        rng.integers(0, 3, count),
        rng.choice([0.0, 22.0], count),
        rng.choice([-1.0, 1.0], count),
        rng.permutation(count),
    )


@given(some_readings())
@examples(40)
def test_every_reading_is_in_one_cell_of_its_own_circumstances(readings):
    cov_ee = np.arange(1.0, len(readings) + 1)[:, None, None] * np.eye(6)
    cells, cell_cov = average_into_cells(readings, cov_ee, EVIDENCE.readings_a_cell)
    held = cells.states.q_rad > 0.0
    assert (held.sum(axis=0) == 1).all()
    assert (held.sum(axis=1) == cells.readings).all()
    assert cells.readings.max() <= EVIDENCE.readings_a_cell
    for k, members in enumerate(held):
        rows = readings.take(members)
        assert set(rows.pose) == {cells.pose[k]}
        assert set(rows.states.load_N) == {cells.states.load_N[k]}
        np.testing.assert_array_equal(rows.states.arrival, cells.states.arrival[[k] * len(rows)])
        # The mean of so many independent readings.
        expected = cov_ee[members].mean(axis=0) / len(rows)
        np.testing.assert_allclose(cell_cov[k], expected)


def test_readings_of_a_cell_have_the_same_targets():
    readings = rows_of([0] * 6, [0.0] * 6, [1.0] * 6, np.arange(6.0))
    p_m = np.ones((6, 2, 3))
    p_m[[1, 3], 1] = np.nan
    points = Points(("T1", "T2"), p_m, np.tile(1e-12 * np.eye(3), (6, 2, 1, 1)), None)
    cells, _ = average_into_cells(
        replace(readings, measured=points), np.tile(np.eye(6), (6, 1, 1)), 8
    )
    held = cells.states.q_rad > 0.0
    assert {tuple(np.flatnonzero(row).tolist()) for row in held} == {(1, 3), (0, 2, 4, 5)}
    seen = cells.measured.components_seen[:, 3:]
    np.testing.assert_array_equal(seen, np.tile(~held[:, [1]], 3))


@given(some_readings())
@examples(40)
def test_cells_of_the_same_circumstances_follow_each_other_in_time(readings):
    cells, _ = average_into_cells(readings, readings.measured.cov, EVIDENCE.readings_a_cell)
    held = cells.states.q_rad > 0.0
    time_s = readings.states.time_s
    keys = list(zip(cells.pose, cells.states.load_N, map(tuple, cells.states.arrival), strict=True))
    assert keys == sorted(keys)
    for k in range(1, len(keys)):
        if keys[k] == keys[k - 1]:
            assert time_s[held[k - 1]].max() < time_s[held[k]].min()
            assert abs(int(cells.readings[k]) - int(cells.readings[k - 1])) <= 1
            assert cells.readings[k] + cells.readings[k - 1] > EVIDENCE.readings_a_cell


def shapes_of(load_N, time_s, side):
    """Write down how an error of a pose may go with its cells, (c, 4)."""

    def spread(values):
        centred = values - values.mean()
        return centred / np.abs(centred).max() if np.ptp(values) else 0.0 * centred

    return np.stack([np.ones(len(side)), *map(spread, (load_N, time_s, side))], axis=1)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 100.0), st.sampled_from([0.0, 0.6, 1.0]))
@examples(25)
def test_turned_rows_of_the_shared_error_are_independent(seed, variance, share_seen):
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(4), rng.integers(1, 7, 4))
    load_N, side = rng.choice([0.0, 22.0, 44.0], len(pose)), rng.choice([-1.0, 1.0], len(pose))
    time_s, repeats = rng.permutation(len(pose)) * 50.0, rng.integers(1, 5, len(pose))
    # Of two components, the second is not in all cells: what these would share is not in the rest.
    seen = np.stack([np.full(len(pose), True), rng.uniform(size=len(pose)) < share_seen], axis=1)
    found = shared_error(rows_of(pose, load_N, side, time_s, repeats), seen)
    rotation = found.rotation.toarray()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(2 * len(pose)), atol=1e-12)
    of_pose, component = np.repeat(pose, 2), np.tile([0, 1], len(pose))
    apart = (of_pose[:, None] != of_pose) | (component[:, None] != component)
    assert not rotation[apart].any()
    np.testing.assert_array_equal(rotation[~seen.ravel()], np.eye(2 * len(pose))[~seen.ravel()])
    assert not found.variance[~seen.ravel()].any()
    shared = np.zeros((len(pose), 2, len(pose), 2))
    for each in range(4):
        here = np.flatnonzero(pose == each)
        # A unit of the error is one standard deviation of a reading; a mean of k is whiter.
        shapes = shapes_of(load_N[here], time_s[here], side[here]) * np.sqrt(repeats[here, None])
        for k in (0, 1):
            there = np.outer(seen[here, k], seen[here, k])
            shared[here[:, None], k, here, k] = there * (shapes @ shapes.T)
    covariance = np.eye(2 * len(pose)) + variance * shared.reshape(2 * len(pose), -1)
    turned = rotation @ covariance @ rotation.T
    np.testing.assert_allclose(turned, np.diag(1.0 + variance * found.variance), atol=1e-8)


def test_a_pose_of_one_cell_shares_with_nothing():
    cells = rows_of([0, 1], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [3, 1])
    found = shared_error(cells, np.full((2, 1), True))
    np.testing.assert_allclose(np.abs(found.rotation.toarray()), np.eye(2))
    assert found.variance == pytest.approx([3.0, 1.0])
