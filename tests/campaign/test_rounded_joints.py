"""Positions in whole counts of encoders, and in decimals that are a rounding or a program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest
from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.campaign import rounded_joints
from pa10cal.campaign.rounded_joints import (
    Step,
    decimal_step,
    rounding_step,
    whole_counts,
    with_rounding,
)
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.points import Points
from spoiling import ingest, with_columns


def test_whole_counts_of_encoders_are_as_uncertain_as_their_rounding(tmp_path):
    raw, u_deg = sighted(tmp_path, "points", poses=60), 360.0 / 4096 / np.sqrt(12.0)
    before = ingest(raw)
    assert not before.observations.log.q_u_stated.any()
    first = raw.column("q1_deg")
    for k in range(1, len(raw.poses)):
        words = raw.poses[k].split(",")
        counts = np.round(np.array(words[first : first + 6], dtype=float) * 4096 / 360.0)
        words[first : first + 6] = [f"{count * 360.0 / 4096:.5f}" for count in counts]
        raw.poses[k] = ",".join(words)
    rounded = list(raw.poses)
    for k in range(1, len(raw.poses), 3):
        words = raw.poses[k].split(",")
        words[first] = f"{float(words[first]) + 360.0 / 8192:.5f}"
        raw.poses[k] = ",".join(words)
    told = [note.partition(" deg")[0] for note in ingest(raw).notes if "whole counts" in note]
    assert len(told) == 2
    assert told[0].startswith("q1: positions are whole counts of encoders (8192 a turn)")
    assert told[1].startswith("q2, q3, q4, q5, q6: positions are whole counts of encoders (4096 a")
    raw.poses = rounded
    found = ingest(raw)
    np.testing.assert_allclose(found.observations.log.q_u_stated, np.radians(u_deg))
    assert any("whole counts of encoders (4096 a turn)" in note for note in found.notes)
    more = found.observations.measured.stated_covariance
    assert np.trace(more, axis1=1, axis2=2).mean() > 0.0
    with_columns(raw.poses, {f"u_q{joint}_deg": 0.01 for joint in range(1, 7)})
    stated = ingest(raw).observations.log.q_u_stated
    np.testing.assert_allclose(stated, np.radians(0.01))  # what is stated counts


@pytest.mark.parametrize("places", [1, 5])
def test_few_positions_of_an_axis_are_no_counts_and_take_no_time(monkeypatch, places):
    """They are whole numbers of nearly any step; all were gone through, for seconds an axis."""
    tried = []
    right = rounded_joints._differ_by_whole
    monkeypatch.setattr(
        rounded_joints, "_differ_by_whole", lambda *given: tried.append(given) or right(*given)
    )
    rng = np.random.default_rng(4)
    positions = 77.7 * rng.integers(0, places, 60) + rng.normal(0.0, 1e-5, 60)
    assert rounding_step(positions, slides=False) is None
    assert len(tried) < 100
    # Enough of them are counts, whatever else the axis did.
    counted = 360.0 / 7000 * np.append(rng.integers(0, 3000, 25), np.zeros(200))
    assert rounding_step(counted, slides=False) == Step.of_counts(7000)


@pytest.mark.parametrize("step_deg", [0.1, 0.5, 11.25, 45.0])
def test_programmed_positions_in_round_parts_of_a_degree_are_exact(step_deg):
    positions = step_deg * np.random.default_rng(1).integers(-1000, 1000, 200)
    assert whole_counts(positions) == 0.0
    assert whole_counts(360.0 / 1024 * np.arange(200)) == 1024.0
    assert whole_counts(360.0 / 1024 * np.arange(10)) == 0.0


def _with_positions(raw, arm, q_logged_deg, q_true_rad, noise_m=3e-5):
    """Write other joint positions, and readings of the targets at the true ones."""
    first, at = raw.column("q1_deg"), raw.column("T1_x_mm")
    T_base_ee = Chain.of(arm).forward(q_true_rad)
    on_ee = np.column_stack([raw.p_ee_m, np.ones(len(raw.p_ee_m))])
    p_m = np.einsum("ij,pjk,bk->pbi", raw.T_instr_base, T_base_ee, on_ee)[..., :3]
    p_m += noise_m * np.random.default_rng(2).standard_normal(p_m.shape)
    for k, (q_deg, p) in enumerate(zip(q_logged_deg, p_m, strict=True), start=1):
        words = raw.poses[k].split(",")
        words[first : first + 6] = [f"{each:.6f}" for each in q_deg]
        words[at : at + 9] = [f"{1e3 * each:.4f}" for each in p.ravel()]
        raw.poses[k] = ",".join(words)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("unit_deg", "words"), [(1.0, "0.1 deg"), (np.degrees(0.01), "0.001 rad"), (3.6, "0.001 turns")]
)
def test_decimals_are_a_rounding_where_the_readings_show_it(tmp_path, unit_deg, words):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    step_deg = 0.1 * unit_deg
    true_deg = np.degrees(raw.q)
    logged_deg = step_deg * np.round(true_deg / step_deg)
    _with_positions(raw, arm, logged_deg, raw.q)
    found = ingest(raw)
    (told,) = [warning for warning in found.warnings if "rounded" in warning]
    assert told.startswith(f"q1, q2, q3, q4, q5, q6: joint positions are rounded to {words}, as")
    u_rad = np.radians(step_deg) / np.sqrt(12.0)
    np.testing.assert_allclose(found.observations.log.q_u_stated, u_rad)
    _with_positions(raw, arm, logged_deg, np.radians(logged_deg))
    exact = ingest(raw)
    assert not exact.observations.log.q_u_stated.any()
    assert not [warning for warning in exact.warnings if "rounded" in warning]


@pytest.mark.parametrize(
    ("counts", "digits"), [(8000, 4), (4000, 4), (7200, 4), (7000, 4), (16000, 3)]
)
def test_counts_of_any_number_are_a_rounding_where_the_readings_show_it(tmp_path, counts, digits):
    raw, arm, step_deg = sighted(tmp_path, "points", poses=60), load_arm("ur10"), 360.0 / counts
    logged_deg = np.round(step_deg * np.round(np.degrees(raw.q) / step_deg), digits)
    _with_positions(raw, arm, logged_deg, raw.q)
    found = ingest(raw)
    (told,) = [warning for warning in found.warnings if "rounded" in warning]
    assert f"are rounded to {step_deg:g} deg ({counts} counts a turn), as" in told
    assert "more decimals" not in told
    u_rad = np.radians(step_deg) / np.sqrt(12.0)
    np.testing.assert_allclose(found.observations.log.q_u_stated, u_rad)
    _with_positions(raw, arm, logged_deg, np.radians(logged_deg))
    assert not ingest(raw).observations.log.q_u_stated.any()


@pytest.mark.parametrize(("axis", "off_grid_deg", "times"), [(5, 0.04, 1.0), (1, 0.0, 0.0)])
def test_an_axis_on_a_grid_does_not_hide_the_rounding_of_others(
    tmp_path, axis, off_grid_deg, times
):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    true_deg = np.degrees(raw.q)
    off_deg = off_grid_deg * np.random.default_rng(3).uniform(-1.0, 1.0, 60)
    true_deg[:, axis] = np.round(true_deg[:, axis]) + off_deg
    _with_positions(raw, arm, np.round(true_deg, 1), np.radians(true_deg))
    found = ingest(raw)
    (told,) = [warning for warning in found.warnings if "rounded" in warning]
    assert "to 0.1 deg" in told
    u_rad = np.full(6, np.radians(0.1) / np.sqrt(12.0))
    u_rad[axis] *= times
    np.testing.assert_allclose(found.observations.log.q_u_stated, np.tile(u_rad, (60, 1)))
    _with_positions(raw, arm, np.round(true_deg, 1), np.radians(np.round(true_deg, 1)))
    assert not ingest(raw).observations.log.q_u_stated.any()


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("in_counts", "exact"), [([1], True), ([0, 1, 2], False)])
def test_errors_of_axes_in_counts_are_none_of_the_others(tmp_path, in_counts, exact):
    """They are larger, and of a known size: they must not feign what is sought, nor hide it."""
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    step_deg = np.full(6, 0.01 if exact else 0.1)
    step_deg[in_counts] = 360.0 / 4096
    true_deg = np.degrees(raw.q)
    logged_deg = step_deg * np.round(true_deg / step_deg)
    others = np.delete(np.arange(6), in_counts)
    if exact:
        true_deg[:, others] = logged_deg[:, others]
    _with_positions(raw, arm, logged_deg, np.radians(true_deg))
    u_rad = np.radians(step_deg) / np.sqrt(12.0)
    if exact:
        u_rad[others] = 0.0
    found = ingest(raw).observations.log.q_u_stated
    np.testing.assert_allclose(found, np.tile(u_rad, (60, 1)))


def test_errors_of_joints_far_above_a_rounding_are_told(tmp_path):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    logged_deg = np.round(np.degrees(raw.q), 2)
    off_deg = 0.03 * np.random.default_rng(3).standard_normal(raw.q.shape)
    _with_positions(raw, arm, logged_deg, np.radians(logged_deg + off_deg))
    (told,) = [warning for warning in ingest(raw).warnings if "rounded" in warning]
    assert "readings show errors of joints about 1" in told  # 10.4 times


def test_targets_that_were_not_seen_are_no_sign_of_small_noise(tmp_path):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    logged_deg = np.round(np.degrees(raw.q), 4)
    _with_positions(raw, arm, logged_deg, np.radians(logged_deg))
    at = raw.column("T1_x_mm")
    for k in range(1, len(raw.poses)):  # one of three targets a row
        words = raw.poses[k].split(",")
        words[at : at + 9] = ["" if j // 3 != k % 3 else words[at + j] for j in range(9)]
        raw.poses[k] = ",".join(words)
    assert not [warning for warning in ingest(raw).warnings if "rounded" in warning]


def test_joints_that_follow_are_off_by_the_rounding_of_those_that_lead(tmp_path):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    raw.description["coupling"] = [{"joint": 3, "by": 2, "factor": -1.0, "follows": True}]
    q = raw.q.copy()
    q[:, 2] = -q[:, 1]
    axes = np.delete(np.arange(6), 2)
    _with_positions(raw, arm, np.round(np.degrees(q[:, [*axes, 5]]), 2), q, noise_m=1e-5)
    column = raw.column("q6_deg")
    for k in range(len(raw.poses)):
        words = raw.poses[k].split(",")
        raw.poses[k] = ",".join([*words[:column], *words[column + 1 :]])
    found = ingest(raw)
    (told,) = [warning for warning in found.warnings if "rounded" in warning]
    assert told.startswith("q1, q2, q3, q4, q5: joint positions are rounded to 0.01 deg")
    u_rad = np.radians(0.01) / np.sqrt(12.0)
    np.testing.assert_allclose(found.observations.log.q_u_stated, u_rad)


def test_it_is_said_where_readings_do_not_tell_a_rounding_from_more_noise(tmp_path):
    raw = sighted(tmp_path, "distance", poses=80)
    column = raw.column("q1_deg")

    def said(q_deg):
        for k, of_row in enumerate(q_deg, start=1):
            words = raw.poses[k].split(",")
            words[column : column + 6] = [f"{each:.6f}" for each in of_row]
            raw.poses[k] = ",".join(words)
        found = ingest(raw)
        assert not found.observations.log.q_u_stated.any()
        return [each for each in found.warnings if "whole numbers of 0.1 deg" in each]

    (told,) = said(np.round(np.degrees(raw.q), 1))
    assert "state u_q1_deg, u_q2_deg" in told
    assert not said(np.degrees(raw.q))


def test_a_rounding_far_below_the_errors_of_joints_is_not_shown(tmp_path):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    logged_deg = np.round(np.degrees(raw.q), 4)
    off_deg = 0.03 * np.random.default_rng(3).standard_normal(raw.q.shape)
    _with_positions(raw, arm, logged_deg, np.radians(logged_deg + off_deg))
    assert not [warning for warning in ingest(raw).warnings if "rounded" in warning]


def test_exact_positions_in_decimals_stay_exact_beside_an_effect(tmp_path):
    raw, arm = sighted(tmp_path, "points", poses=60), load_arm("ur10")
    logged_deg = np.round(np.degrees(raw.q), 2)
    q = np.radians(logged_deg)
    q[:, 1] += 5e-4 * np.sin(q[:, 1] + 0.4)
    q[:, 3] += 5e-4 * np.sin(2.0 * q[:, 3])
    _with_positions(raw, arm, logged_deg, q)
    assert not ingest(raw).observations.log.q_u_stated.any()


@pytest.mark.parametrize("span_deg", [300.0, 34.0, 5.0])
def test_a_step_is_told_of_an_axis_that_moves_little(span_deg):
    q_deg = np.random.default_rng(1).uniform(10.0, 10.0 + span_deg, 100)
    assert whole_counts(np.round(q_deg * 8192 / 360.0) * 360.0 / 8192) == 8192.0
    assert decimal_step(np.round(q_deg, 2), slides=False) == Step("0.01 deg", 0.01, "deg")
    assert decimal_step(q_deg, slides=False) is None
    q_mm = np.round(q_deg / span_deg, 3)  # moves by 1 mm
    assert decimal_step(q_mm, slides=True) == Step("0.001 mm", 0.001, "mm")
    assert decimal_step(0.01 * q_deg / span_deg, slides=True) is None
    q_mm = 0.005 * np.round(40.0 * q_deg / span_deg)
    assert rounding_step(q_mm, slides=True) == Step("0.005 mm", 0.005, "mm", False)
    assert rounding_step(q_deg, slides=False) is None


def test_a_row_that_was_typed_does_not_hide_the_step_of_all_others():
    counts = np.random.default_rng(1).integers(-2000, 2000, 100)
    for step, told in (
        (360.0 / 4096, whole_counts),
        (0.01, lambda q: decimal_step(q, slides=False)),
    ):
        q_deg = step * counts
        of_all = told(q_deg)
        q_deg[7] += 0.4 * step
        assert told(q_deg) == of_all
        q_deg[:10] += 0.37 * step
        assert told(q_deg) != of_all


@pytest.mark.parametrize(
    ("bits", "digits"), [(12, 2), (12, 1), (13, 2), (14, 2), (16, 3), (14, 4), (16, 9)]
)
def test_few_printed_digits_do_not_hide_the_counts_of_an_encoder(bits, digits):
    rng, per_turn = np.random.default_rng(1), 2**bits
    told = []
    for n in (30, 60, 120, 300) * 10:
        q_deg = rng.uniform(-150.0, 150.0, n)
        told.append(
            whole_counts(np.round(np.round(q_deg * per_turn / 360) * 360 / per_turn, digits))
        )
    half_a_step_or_more = 10.0**-digits >= 360.0 / per_turn / 2.0
    assert set(told) == {0.0 if half_a_step_or_more else per_turn}


@pytest.mark.parametrize("unit_deg", [1.0, np.degrees(1.0), 360.0])
@pytest.mark.parametrize("step", [1.0, 0.1, 0.5, 0.25, 0.01, 0.002, 0.001])
def test_round_parts_of_a_unit_are_no_counts(unit_deg, step):
    rng = np.random.default_rng(1)
    every = [rng.integers(-150, 150, n) for n in (20, 40, 200)] + [np.arange(25)]
    assert {whole_counts(step * unit_deg * parts) for parts in every} == {0.0}


def test_which_row_was_typed_does_not_matter():
    rng = np.random.default_rng(1)
    for _ in range(100):
        q_deg = np.round(rng.uniform(-150.0, 150.0, 300), 2)
        q_deg[rng.choice(300, 6, replace=False)] += 0.0043
        assert decimal_step(q_deg, slides=False) == Step("0.01 deg", 0.01, "deg")
        q_deg = np.round(rng.uniform(-150.0, 150.0, 101) * 8192 / 360) * 360 / 8192
        q_deg[rng.choice(101, 2, replace=False)] += 0.0043129
        assert whole_counts(q_deg) == 8192.0


@pytest.mark.parametrize(("exact", "seed"), [(False, 8), (False, 9), (True, 8)])
def test_a_target_on_the_last_axis_shows_a_rounding_too(exact, seed):
    """Its readings say little of that joint, and of what turns with it."""
    rng, arm = np.random.default_rng(seed), load_arm("ur10")
    q_deg = rng.uniform(-150.0, 150.0, (120, 6))
    logged = np.radians(np.round(q_deg, 1))
    T = Chain.of(arm).forward(logged if exact else np.radians(q_deg))
    p_m = T[:, :3, 3] + 0.05 * T[:, :3, 2] + rng.normal(0.0, 3e-5, (120, 3))
    cov_m2 = np.tile(2.5e-9 * np.eye(3), (120, 1, 1, 1))
    measured = Points(("T1",), p_m[:, None], cov_m2, None)
    readings = Observations.single(np.arange(120).astype(str), at_rest(logged), measured)
    unknown = np.full((120, 6), np.nan)
    log = JointLog(unknown, unknown, np.zeros(120, dtype=np.int64))
    readings = replace(readings, log=log)
    steps = dict.fromkeys(range(6), Step("0.1 deg", 0.1, "deg"))
    assert with_rounding(readings, steps, arm, None).steps == ({} if exact else steps)
