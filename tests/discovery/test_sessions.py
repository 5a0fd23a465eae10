"""Two sessions in one file without times."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import Hidden, observe
from made_up_weights import K_NM_RAD, holding_Nm, sagging
from pa10cal.discovery import jacobians
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.sessions import (
    StepsOfBase,
    changed_between_repeats,
    is_moved_in_order,
    moved_in_order,
)

POSES, FIRST = 120, 50  # poses, of which so many are of the first session


@pytest.fixture(scope="module")
def given():
    return observe(poses=POSES, held_out=10)


def untimed(poses):
    return poses.with_states(replace(poses.states, timed=np.zeros(len(poses), dtype=bool)))


def moved(poses, off_m):
    """Move readings (P, 3) [m]."""
    T = poses.measured.T_instr_target.copy()
    T[:, :3, 3] += off_m
    return poses.with_measured(T_instr_target=T)


def of_two_sessions(poses, size_m=2e-4):
    """Rows of a second session, whose instrument stood elsewhere, below those of a first."""
    in_time = np.argsort(np.argsort(poses.states.time_s, kind="stable"))
    return moved(poses, np.where(in_time >= FIRST, size_m, 0.0)[:, None] * [1.0, -0.5, 0.3])


def test_rows_without_times_are_found_to_be_of_two_sessions(given):
    at, poses = given.baseline, untimed(given.readings)
    assert moved_in_order(at, poses) is None
    both = of_two_sessions(poses)
    found = moved_in_order(at, both)
    first = both.pose[np.argsort(both.states.time_s, kind="stable")[FIRST]]
    assert found.of == f"the rows from pose {first} on"
    assert "two sessions? join them as a group" in found.why
    assert is_moved_in_order(found)
    # Where times were recorded a motion is sought in time.
    assert moved_in_order(at, of_two_sessions(given.readings)) is None


def test_an_error_of_a_joint_is_no_session_where_rows_follow_it(given):
    at, poses = given.baseline, untimed(given.readings)
    q_rad = poses.states.q_rad[:, 1]
    by_joint = jacobians.by_joints(at, poses, [2])[:, :3, 0]
    off_m = by_joint * np.where(q_rad > np.quantile(q_rad, 0.4), 3e-4, -3e-4)[:, None]
    follows = poses.with_states(replace(poses.states, time_s=np.argsort(np.argsort(q_rad)) * 1.0))
    assert moved_in_order(at, moved(follows, off_m)) is None
    # Nor where they do not.
    assert moved_in_order(at, moved(poses, off_m)) is None


def test_a_base_that_moves_slowly_is_not_two_sessions(given):
    at, poses = given.baseline, untimed(given.readings)
    in_time = np.argsort(np.argsort(poses.states.time_s, kind="stable"))
    found = moved_in_order(at, moved(poses, 4e-4 * (in_time / POSES)[:, None] * [1.0, -0.5, 0.3]))
    assert found.of == "the order of the rows"
    assert "give the time of each reading" in found.why
    assert is_moved_in_order(found)


def test_a_load_that_is_not_stated_is_no_base_that_moved():
    """Half a kilogram in the middle of the rows, whose torque is that of virtual work."""
    made = observe(Hidden(turn=sagging()), poses=POSES, held_out=10, springs=True)
    at, poses = made.baseline, untimed(made.readings)
    poses = complete(poses, at, made.setup)
    in_time = np.argsort(np.argsort(poses.states.time_s, kind="stable"))
    more_Nm = holding_Nm(poses.states.q_rad, [(0.5, at.arm.n, np.zeros(3))])
    sag_rad = np.where((in_time >= FIRST) & (in_time < 100), more_Nm / K_NM_RAD, 0.0)
    by_joint = jacobians.by_joints(at, poses, [2])[:, :3, 0]
    found = moved_in_order(at, moved(poses, -sag_rad[:, None] * by_joint))
    assert found.of == "the order of the rows"
    assert "the arm carries another load than is stated" in found.why
    assert "load_N" in found.why


def test_steps_gain_what_dense_columns_of_moved_poses_explain():
    rng = np.random.default_rng(5)
    by_base, data = rng.normal(size=(40, 3, 6)), rng.normal(size=120)
    own, order = np.linalg.qr(rng.normal(size=(120, 4)))[0], rng.permutation(40)
    rest = data - own @ (own.T @ data)
    steps = StepsOfBase(
        gram=np.einsum("pbi,pbj->pij", by_base, by_base),
        across=np.einsum("pbk,pbi->pki", own.reshape(40, 3, 4), by_base),
        projection=np.einsum("pbi,pb->pi", by_base, rest.reshape(40, 3)),
        squares=float(rest @ rest),
        readings=120,
    )

    def from_row(first):
        columns = np.zeros_like(by_base)
        columns[order[first:]] = by_base[order[first:]]
        return columns.reshape(120, 6)

    def left(*columns):
        all_of = np.concatenate([own, *columns], axis=1)
        return float(np.sum((data - all_of @ np.linalg.lstsq(all_of, data)[0]) ** 2))

    def gain(before, after):
        return 60.0 * np.log(before / after) - 3.5 * np.log(120)

    first = steps.best(order)
    alone = gain(left(), left(from_row(first.first)))
    assert first.gain == pytest.approx(alone, rel=1e-9)
    every = [gain(left(), left(from_row(k))) for k in range(10, 31)]
    assert first.gain == pytest.approx(max(every), rel=1e-9)
    second = steps.beside(order[first.first :]).best(order)
    both = gain(left(from_row(first.first)), left(from_row(first.first), from_row(second.first)))
    assert second.gain == pytest.approx(both, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ("nothing", None),
        ("lost motion", None),
        ("step", "the zero of joint 3"),
        ("warm-up", "the zero of joint 3"),
        ("base", "the base or the instrument"),
    ],
)
def test_repeats_that_differ_by_their_order_are_told(given, change, place):
    half = given.readings.take(np.arange(POSES // 2))
    rows = np.concatenate([np.arange(POSES // 2), np.arange(POSES // 2)[::-1]])
    poses, part = half.take(rows), np.linspace(0.0, 1.0, POSES)
    states = replace(poses.states, time_s=1.0 + np.arange(POSES), timed=np.zeros(POSES, bool))
    rng = np.random.default_rng(11)
    states.arrival[:] = rng.choice([-1.0, 1.0], states.arrival.shape)
    poses = poses.with_states(states)
    by_joint = jacobians.by_joints(given.baseline, poses, [3])[:, :3, 0]
    turned_rad = {
        "lost motion": 1e-4 * states.arrival[:, 2],
        "step": 3e-4 * (part > 0.63),
        "warm-up": 3e-4 * np.exp(-part / 0.3),
    }.get(change, np.zeros(POSES))
    off_m = by_joint * turned_rad[:, None]
    if change == "base":
        off_m = off_m + (part > 0.63)[:, None] * [1e-4, -5e-5, 3e-5]
    noise_m = np.sqrt(np.diagonal(poses.measured.stated_covariance, axis1=1, axis2=2)[:, :3])
    found = changed_between_repeats(given.baseline, moved(poses, off_m + rng.normal(0.0, noise_m)))
    if place is None:
        assert found is None
        return
    assert f"as if {place} had moved meanwhile" in found.why
    assert "give the time of each reading" in found.why
    assert is_moved_in_order(found)
