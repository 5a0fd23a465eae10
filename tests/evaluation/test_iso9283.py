"""Pose accuracy and repeatability after ISO 9283, against examples worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.evaluation import iso9283
from pa10cal.evaluation.iso9283 import iso9283_record, repeatability
from pa10cal.evaluation.model_errors import held_out_errors
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.joined import concatenated
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.points import Distance, Points
from pa10cal.rules import COMPARED
from pa10cal.terms.model import Model

CAMPAIGN = SimpleNamespace(name="mine", provenance="made up", robot="pa10_6ce")


@pytest.mark.parametrize(
    ("p_mm", "expected_mm"),
    [
        # Every distance is 1 mm, so they do not scatter.
        ([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], 1.0),
        # Mean 1 mm; distances 1, 1, 1, 3 mm: mean 1.5, standard deviation 1; 1.5 + 3 x 1.
        ([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [4, 0, 0]], 4.5),
    ],
)
def test_repeatability_of_positions(p_mm, expected_mm):
    RP_mm, RP_deg = repeatability(1e-3 * np.array(p_mm), None)
    assert RP_mm == pytest.approx(expected_mm)
    assert RP_deg is None


def test_repeatability_of_angles_is_three_standard_deviations_about_each_axis():
    angles_deg = np.array([[0.0, 0, -0.1], [0, 0, 0], [0, 0, 0.1]])
    R = (Rotation.from_rotvec(angles_deg, degrees=True) * Rotation.random(rng=1)).as_matrix()
    _, RP_deg = repeatability(np.zeros((3, 3)), R)
    np.testing.assert_allclose(RP_deg, [0.0, 0.0, 0.3], atol=1e-6)


def repeated(repeats, *, arrival=1.0):
    """Two configurations, the first attained (0, 0, 3) mm off and repeated; the second once."""
    arm = load_arm("pa10_6ce")
    q_rad = np.repeat([[0.3, 0.2, 0.5, 0.1, 0.4, 0.2], [0.1] * 6], [repeats, 1], axis=0)
    T = Chain.of(arm).forward(q_rad)
    along = np.zeros(repeats)
    along[-1] = 1e-3 * repeats  # mean 1 mm
    T[:repeats, 0, 3] += along
    T[:repeats, 2, 3] += 3e-3
    arrivals = np.ones_like(q_rad)
    arrivals[0] = arrival
    labels = np.array(["P1"] * repeats + ["P2"])
    every = measured_poses(labels, at_rest(q_rad, arrival=arrivals), T, np.zeros((len(T), 6, 6)))
    return every, judged(every)


def judged(every):
    """Return the errors of the nominal arm."""
    chain = Chain.of(load_arm("pa10_6ce"))
    model = FittedModel(Model(chain, ()), np.zeros(0), np.eye(4))
    return {"grid": {"linear": held_out_errors(model, average_repeats(every))}}


def test_accuracy_is_the_mean_attained_less_the_commanded_pose():
    every, models = repeated(5)
    found = iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3))
    rows = found.repeatability
    assert rows.pose.tolist() == ["P1"]
    assert rows.repeats.tolist() == [5]
    # Distances 1, 1, 1, 1, 4 mm: mean 1.6, variance (4 x 0.36 + 5.76) / 4 = 1.8.
    assert rows.RP_mm[0] == pytest.approx(1.6 + 3.0 * np.sqrt(1.8))
    of = found.accuracy["linear"]
    np.testing.assert_allclose(of.rows.AP_xyz_mm[0], [1.0, 0.0, 3.0], atol=1e-9)
    assert of.AP_mean_mm == of.AP_largest_mm == pytest.approx(np.sqrt(10.0))
    assert of.AP_largest_deg == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("arrival", "alone"),
    [(1.0, True), (-1.0, False), (0.0, True)],  # unknown in the first repeat
)
def test_says_whether_joints_arrived_from_one_side(arrival, alone):
    found = iso9283_record(CAMPAIGN, "combined", *repeated(6, arrival=arrival), np.eye(3))
    assert found.repeatability.one_direction.tolist() == [alone]


def test_directions_known_in_some_repeats_only_are_not_known():
    assert iso9283._one_direction(np.array([[0.0, 0], [1, 0], [0, 0], [0, 0]])) is None
    assert iso9283._one_direction(np.array([[0.0, 0], [1, 0], [1, 0], [1, 0]])) is True
    assert iso9283._one_direction(np.array([[1.0, 0], [1, 0], [0, 0], [-1, 0]])) is False
    assert iso9283._one_direction(np.zeros((4, 2))) is None


def test_repeats_before_and_after_a_knock_are_not_pooled():
    every, _ = repeated(12)
    time_s = np.arange(13.0)
    T = every.measured.T_instr_target.copy()
    T[:12, 0, 3] = T[0, 0, 3] + 2e-3 * (time_s[:12] > 5.5)
    every = every.with_measured(T_instr_target=T)
    every = every.with_states(replace(every.states, time_s=time_s))
    chain = Chain.of(load_arm("pa10_6ce"))
    model = FittedModel(Model(chain, ()), np.zeros(0), np.eye(4))
    cut = average_repeats(every, (5.5,))
    models = {"grid": {"linear": held_out_errors(model, cut)}}
    found = iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3), (5.5,))
    assert found.repeatability.repeats.tolist() == [6, 6]
    np.testing.assert_allclose(found.repeatability.RP_mm, 0.0, atol=1e-9)
    off_mm = found.accuracy["linear"].rows.AP_xyz_mm
    np.testing.assert_allclose(off_mm[1] - off_mm[0], [2.0, 0.0, 0.0], atol=1e-9)
    with pytest.raises(ValueError, match="of 3 configurations, which are not the 2 of"):
        iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3))
    why = iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3), (3.5, 7.5)).note
    assert why.endswith("repeats between two sudden motions of base or instrument")


@pytest.mark.parametrize(("timed", "alone"), [(False, None), (True, [False])])
def test_without_a_log_of_directions_the_order_of_poses_tells_them_or_nothing(timed, alone):
    repeats, elsewhere = 6, np.array([[0.8, 0.7, 1.0, 0.6, 0.9, 0.7], [-0.2] * 6] * 3)
    q_rad = np.empty((2 * repeats, 6))
    q_rad[::2], q_rad[1::2] = elsewhere, [0.3, 0.2, 0.5, 0.1, 0.4, 0.2]
    labels = np.full(2 * repeats, "P0")
    labels[::2] = [f"P{k}" for k in range(1, repeats + 1)]
    time_s = 10.0 * np.arange(2 * repeats) if timed else np.zeros(2 * repeats)
    T = Chain.of(load_arm("pa10_6ce")).forward(q_rad)
    states = at_rest(q_rad, time_s=time_s)
    every = measured_poses(labels, states, T, np.zeros((len(T), 6, 6)))
    found = iso9283_record(CAMPAIGN, "combined", every, judged(every), np.eye(3)).repeatability
    assert found.pose.tolist() == ["P0"]
    assert (found.one_direction is None) if alone is None else found.one_direction.tolist() == alone


def test_a_group_has_the_orientations_of_its_campaigns_or_why_there_is_nothing():
    every, _ = repeated(6)
    parts = [replace(every, pose=np.char.add(f"{name}/", every.pose)) for name in "ab"]
    group = concatenated(parts, ("a", "b"))
    found = iso9283_record(CAMPAIGN, "combined", group, judged(group), np.eye(3))
    alone = iso9283_record(CAMPAIGN, "combined", every, judged(every), np.eye(3))
    np.testing.assert_allclose(found.repeatability.RP_deg, [alone.repeatability.RP_deg[0]] * 2)
    states = at_rest(np.zeros((6, 6)))
    blind = [
        Observations.single(np.full(6, f"{name}/P"), states, Distance(np.ones(6), np.ones(6)))
        for name in "ab"
    ]
    note = iso9283_record(CAMPAIGN, "combined", concatenated(blind, ("a", "b")), {}, np.eye(3)).note
    assert "a distance alone" in note


def test_says_why_there_is_none():
    every, models = repeated(COMPARED.least_repeats - 1)
    found = iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3))
    assert found.note == f"no configuration has {COMPARED.least_repeats} repeats"
    assert found.accuracy is found.repeatability is None
    assert iso9283_record(CAMPAIGN, "combined", every, {}, np.eye(3)).note is not None
    blind = SimpleNamespace(measured=SimpleNamespace(directional=Distance.directional))
    assert "a distance alone" in iso9283_record(CAMPAIGN, "combined", blind, {}, np.eye(3)).note


def test_a_configuration_of_which_no_target_was_seen_every_time_is_left_out():
    places_m = np.ones((2 * COMPARED.least_repeats, 2, 3))
    places_m[0, 0], places_m[1, 1] = np.nan, np.nan  # of the first, each target once
    places_m[COMPARED.least_repeats, 0] = np.nan  # of the second, one target once
    seen = SimpleNamespace(directional=True, measures_pose=False, places_m=places_m)
    code = np.repeat([0, 1], COMPARED.least_repeats)
    assert iso9283._repeated(SimpleNamespace(measured=seen), code).tolist() == [1]


def test_repeats_without_a_target_in_all_of_them_are_not_called_too_few():
    count = COMPARED.least_repeats
    p_m, cov_m2 = np.ones((count, 2, 3)), np.tile(1e-8 * np.eye(3), (count, 2, 1, 1))
    p_m[0, 0], p_m[1, 1] = np.nan, np.nan
    states = at_rest(np.zeros((count, 6)))
    every = Observations.single(np.full(count, "P1"), states, Points(("1", "2"), p_m, cov_m2, None))
    found = iso9283_record(CAMPAIGN, "combined", every, {"grid": {}}, np.eye(3))
    assert found.note == "no target was observed in all repeats of a configuration"


def test_kinds_judged_by_different_models_are_refused():
    every, models = repeated(5)
    models = {"grid": models["grid"], "holdout": {}}
    with pytest.raises(ValueError, match="judged by different models"):
        iso9283_record(CAMPAIGN, "combined", every, models, np.eye(3))


def test_a_group_that_repeats_distances_alone_says_so():
    count = COMPARED.least_repeats
    states = at_rest(np.zeros((count, 6)))
    measured = Distance(np.ones(count), np.ones(count))
    ranged = Observations.single(np.full(count, "a/P1"), states, measured)
    seen = Points(("1",), np.ones((count, 1, 3)), np.tile(1e-8 * np.eye(3), (count, 1, 1, 1)), None)
    located = Observations.single(np.char.add("b/P", np.arange(count).astype(str)), states, seen)
    group = concatenated([ranged, located], ("a", "b"))
    found = iso9283_record(CAMPAIGN, "combined", group, {"grid": {}}, np.eye(3))
    assert found.note == "only distances were repeated, which show no position or orientation"
