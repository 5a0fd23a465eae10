"""A target that moves on the tool is told by the distances alone, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.loose_targets import knocked_targets, loose_targets
from pa10cal.frame.point_fits import fit_rigid
from pa10cal.observe.joined import concatenated
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Touched

POSES, STATED_MM = 160, 0.03
PLACES_M = np.array([[0.1, 0.0, 0.1], [-0.06, 0.09, 0.1], [-0.05, -0.08, 0.15], [0.0, 0.02, 0.2]])


def measured(seed, *, targets=3, noise_mm=(STATED_MM,) * 3, loose=None, moves_mm=0.0):
    """Return poses of a tool in every orientation, one target of which hangs as gravity pulls."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(POSES, rng).as_matrix()
    places_m = np.tile(PLACES_M[:targets], (POSES, 1, 1))
    if loose is not None:
        places_m[:, loose] -= 1e-3 * moves_mm * R[:, 2]  # down, as the tool sees it
    p_m = np.einsum("pij,pbj->pbi", R, places_m) + rng.uniform(1.0, 3.0, (POSES, 1, 3))
    p_m += 1e-3 * rng.normal(0.0, 1.0, p_m.shape) * noise_mm
    cov_m2 = np.broadcast_to((1e-3 * STATED_MM) ** 2 * np.eye(3), (*p_m.shape, 3))
    names = tuple(f"T{k + 1}" for k in range(targets))
    zero, zeros = np.zeros(POSES), np.zeros((POSES, 6))
    states = PoseStates(
        q_rad=zeros, load_N=zero, tau_Nm=zeros, arrival=zeros, temperature_C=zero, time_s=zero
    )
    labels = np.array([f"P{k}" for k in range(POSES)])
    return Observations.single(labels, states, Points(names, p_m, cov_m2, None))


@pytest.mark.parametrize(("targets", "loose"), [(3, 0), (3, 1), (3, 2), (4, 3)])
def test_the_target_that_moves_is_told(targets, loose):
    (found,) = loose_targets(measured(1, targets=targets, loose=loose, moves_mm=0.2))
    assert found.of == f"target T{loose + 1}"
    assert found.shared_error_mm == pytest.approx(0.2 / np.sqrt(3.0), rel=0.4)
    assert "fasten it" in found.why


@pytest.mark.filterwarnings("error")
def test_targets_at_one_place_show_no_direction():
    every = measured(1)
    p_m = every.measured.p_instr_m.copy()
    p_m[:, 2] = p_m[:, 1]
    assert loose_targets(replace(every, measured=replace(every.measured, p_instr_m=p_m))) == ()


def test_of_a_group_the_target_is_told_with_its_campaign():
    parts = [measured(1), measured(2, loose=1, moves_mm=0.2)]
    (found,) = loose_targets(concatenated(parts, ("first", "second")))
    (alone,) = loose_targets(parts[1])
    assert found == alone.model_copy(update={"of": "target T2 of second"})


def test_a_target_that_was_knocked_once_is_told_with_the_poses_between_which_it_was():
    every = measured(1)
    p_m = every.measured.p_instr_m.copy()
    # Away from the middle of the others, as the tool sees it.
    away = p_m[70:, 2] - p_m[70:, :2].mean(axis=1)
    p_m[70:, 2] += 4e-4 * away / np.linalg.norm(away, axis=1)[:, None]
    knocked = replace(every, measured=replace(every.measured, p_instr_m=p_m))
    in_time = replace(every.states, time_s=np.arange(float(POSES)))
    (found,) = knocked_targets(replace(knocked, states=in_time))
    assert found.of == "target T3"
    assert "by one step between poses P69 and P70: it was knocked" in found.why
    mixed = np.random.default_rng(0).permutation(POSES)
    at_random = replace(knocked, states=replace(in_time, time_s=mixed.astype(float)))
    assert knocked_targets(at_random) == ()
    (found,) = loose_targets(at_random)
    assert "it is loose" in found.why


def touched_by(every, knocked_from, shift_mm):
    """Return a campaign's poses as touched balls, one of which was knocked from a pose on."""
    T = fit_rigid(PLACES_M[:3], every.measured.p_instr_m).T
    p_mm = 1e3 * every.measured.p_instr_m
    p_mm[knocked_from:, 1] += T[knocked_from:, :3, :3] @ np.asarray(shift_mm)
    cov_mm2 = np.broadcast_to(STATED_MM**2 * np.eye(3), (*p_mm.shape, 3))
    touches = np.full(p_mm.shape[:2], 5)
    balls = Touched.of_balls(("A", "B", "C"), 1e3 * PLACES_M[:3], p_mm, cov_mm2, touches)
    times = replace(every.states, time_s=np.arange(float(POSES)))
    return replace(every, measured=balls, states=times)


@pytest.mark.parametrize("row", [30, 80])
def test_of_touched_balls_the_knocked_one_is_told_by_distances_far_below_their_scatter(row):
    (found,) = knocked_targets(touched_by(measured(3), row, [-0.04, 0.05, 0.0]))
    assert found.of == "target B"
    assert "one step between poses" in found.why
    assert "as two campaigns" in found.why
    between = int(found.why.split("poses P")[1].split()[0])
    assert abs(between - (row - 1)) <= 4
    assert knocked_targets(touched_by(measured(3), row, np.zeros(3))) == ()


def test_a_tool_that_grows_steadily_has_no_knocked_target():
    every = measured(4)
    p_m = every.measured.p_instr_m.copy()
    middle_m = p_m.mean(axis=1, keepdims=True)
    p_m = middle_m + (p_m - middle_m) * (1.0 + 8e-4 * np.linspace(0, 1, POSES))[:, None, None]
    in_time = replace(every.states, time_s=np.arange(float(POSES)))
    warmed = replace(every, measured=replace(every.measured, p_instr_m=p_m), states=in_time)
    assert knocked_targets(warmed) == ()


@examples(40)
@given(st.integers(0, 10_000), st.floats(0.5, 4.0), st.floats(1.0, 3.0))
def test_none_is_told_where_noise_is_larger_than_stated_or_not_the_same_in_all_directions(
    seed, times, across
):
    noise_mm = times * STATED_MM * np.array([1.0, across, across])
    every = measured(seed, noise_mm=noise_mm)
    assert loose_targets(every) == knocked_targets(every) == ()


def test_of_two_targets_none_is_told():
    assert loose_targets(measured(1, targets=2, loose=1, moves_mm=0.2)) == ()


def test_of_few_poses_none_is_told():
    every = measured(1, loose=1, moves_mm=0.2)
    assert loose_targets(every.take(np.arange(12))) == ()
    unseen = every.measured.p_instr_m.copy()
    unseen[12:, 1] = np.nan
    assert loose_targets(replace(every, measured=replace(every.measured, p_instr_m=unseen))) == ()
