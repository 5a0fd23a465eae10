"""A model in another place: frames are found there; springs and weights of the arm go along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_model import on_springs
from made_up_poses import at_rest, context_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.accuracy import summarise
from pa10cal.calibration.general import calibrate
from pa10cal.calibration.general.fit import fit
from pa10cal.calibration.general.problem import with_unknown_frames
from pa10cal.calibration.general.refit_frames import (
    FrameFit,
    fit_with_targets_shown,
    refit_frames,
    with_tool_of,
)
from pa10cal.calibration.general.unknowns import choose_unknowns
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.fit.uncertain_weights import with_uncertain_weights
from pa10cal.fit.validity import nothing_seen
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint_error_map import BandPrior, SensorError
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures

ARM = load_arm("ur10")
DOWN = np.array([0.0, 0.0, -9.80665])
FIRST = Payload(1.5, np.array([0.01, -0.02, 0.06]), np.zeros(3), DOWN)
SECOND = Payload(6.0, np.array([0.0, 0.03, 0.1]), np.zeros(3), DOWN)
#: What the weights differ by from those described: of the arm, and of the first tool.
OF_ARM = {"weight_2_mass": 1.2, "weight_3_moment_x": -0.4}
OF_TOOL = {"weight_tool_mass": 0.4, "weight_6_moment_z": 0.05}
LEVEL = {"weight_level_1": 3e-3}
STIFFNESS = {2: 4e4, 3: 3e4, 4: 1e4}


def weighing(payload, differ):
    """Return a model with springs whose weights differ from those described."""
    springy = on_springs("ur10", STIFFNESS, payload, {"delta_a_2"})
    springy.x[0] = 3e-4
    found = with_uncertain_weights(springy, payload)
    names = [parameter.name for parameter in found.model.parameters]
    for name, value in differ.items():
        found.x[names.index(name)] = value
    return found


def measured(true, payload, seed):
    """Return exact poses of a model, instrument and target somewhere."""
    rng = np.random.default_rng(seed)
    q_rad = rng.uniform(-2.0, 2.0, (80, ARM.n))
    states = at_rest(q_rad, tau_Nm=np.full_like(q_rad, np.nan), time_s=np.arange(80.0))
    loaded, _ = with_torques(true.model, true.x, states, payload)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=seed).as_matrix(), [0.4, -1.2, 0.3]
    seen = T @ true.model.predict(loaded, true.x)
    cov = np.tile(np.diag([1e-9] * 3 + [1e-8] * 3), (len(seen), 1, 1))
    labels = np.array([f"P{k:03d}" for k in range(len(seen))])
    return Observations.single(labels, states, Pose(seen, cov, np.zeros((len(seen), 6, 0))))


def left_mm(model, poses):
    there = refit_frames(model, model.as_modelled(poses))
    return summarise(there.deviations(model.as_modelled(poses))).rms_mm


@pytest.fixture(scope="module")
def found():
    """Return the model of the first campaign, and exact poses with another tool."""
    first = weighing(FIRST, OF_ARM | OF_TOOL | LEVEL)
    return first, measured(weighing(SECOND, OF_ARM), SECOND, 5)


def test_weights_of_the_arm_go_along_and_the_tool_is_the_campaigns(found):
    first, poses = found
    carried = with_tool_of(first, SECOND)
    value = dict(zip((p.name for p in carried.model.parameters), carried.x, strict=True))
    for name, differs in OF_ARM.items():
        assert value[name] == differs
    assert value["weight_tool_mass"] == value["weight_level_1"] == 0.0
    assert abs(value["weight_6_moment_z"]) < 0.2 * OF_TOOL["weight_6_moment_z"]
    assert left_mm(carried, poses) < 2e-3
    # Neither the tool of before nor the weights as described do.
    assert left_mm(replace(first, payload=SECOND), poses) > 1e-2
    described = weighing(SECOND, {})
    assert left_mm(described, poses) > 1e-2


def test_a_tool_that_is_not_stated_is_the_one_of_before(found):
    first, _ = found
    not_stated = Payload(0.0, np.zeros(3), np.array([0.0, 0.0, 0.2]), -DOWN, known=False)
    carried = with_tool_of(first, not_stated)
    value = dict(zip((p.name for p in carried.model.parameters), carried.x, strict=True))
    assert value["weight_tool_mass"] == OF_TOOL["weight_tool_mass"]
    assert value["weight_level_1"] == 0.0
    there = replace(FIRST, load_point_m=not_stated.load_point_m, gravity_m_s2=-DOWN)
    poses = measured(weighing(there, OF_ARM | OF_TOOL), there, 9)
    assert left_mm(carried, poses) < 1e-5
    # So it is without any uncertain weights, and in each campaign of a group.
    springy = on_springs("ur10", STIFFNESS, SECOND, {"delta_a_2"})
    group = replace(not_stated, of_campaigns=(not_stated, FIRST))
    carried = with_tool_of(springy, group)
    assert [each.mass_kg for each in carried.payload.of_campaigns] == [6.0, 1.5]
    there = replace(SECOND, load_point_m=not_stated.load_point_m, gravity_m_s2=-DOWN)
    assert left_mm(with_tool_of(springy, not_stated), measured(springy, there, 9)) < 1e-5


def test_errors_of_the_targets_of_before_are_not_those_of_another_instrument(found):
    first, _ = found
    by_balls = replace(first, targets_off_m=np.full(9, 1e-4), target_names=("A", "B", "C"))
    poses = measured(first, FIRST, 10)
    assert left_mm(by_balls, poses) < 1e-5
    there = refit_frames(by_balls, by_balls.as_modelled(poses))
    assert there.target_names == ()
    assert len(there.targets_off_m) == 0


def test_why_effects_do_not_hold_everywhere_goes_along(found):
    first, _ = found
    apart = replace(first, falls_back=FallBack(nothing_seen(ARM.n), first, "held-out poses err"))
    carried = with_tool_of(apart, SECOND)
    poses = carried.as_modelled(measured(weighing(SECOND, OF_ARM), SECOND, 5))
    there = refit_frames(carried, poses)
    assert carried.falls_back.why == there.falls_back.why == apart.falls_back.why
    assert there.falls_back.model.payload.mass_kg == SECOND.mass_kg


def test_logged_torques_have_all_weights_in_them(found):
    first, _ = found
    poses = measured(weighing(SECOND, OF_ARM), SECOND, 6)
    true = weighing(SECOND, OF_ARM)
    loaded, _ = with_torques(true.model, true.x, poses.states, SECOND)
    logged_Nm = true.model.with_joint_torques(loaded, true.x).tau_Nm
    poses = poses.with_states(replace(poses.states, tau_Nm=logged_Nm))
    carried = with_tool_of(first, SECOND, logged=True)
    assert not any(term.id == "weights" for term in carried.model.terms)
    assert carried.covariance.shape == (len(carried.x) + 6,) * 2
    assert left_mm(carried, poses) < 2e-3


def test_what_the_other_tool_may_weigh_is_uncertain_in_the_model_carried(found):
    first, poses = found
    carried = with_tool_of(first, SECOND)
    names = [parameter.name for parameter in carried.model.parameters]
    k = names.index("weight_tool_mass")
    assert np.sqrt(carried.covariance[k, k]) == pytest.approx(0.12 * SECOND.mass_kg)
    there = refit_frames(carried, carried.as_modelled(poses))
    assert np.linalg.eigvalsh(there.covariance).min() > -1e-12
    assert there.predict(poses.states.q_rad[:5]).u_mm.min() > 0.0


def with_effect(model, name, x):
    """Return a model with the first effect of that name among those that its arm may have."""
    effect = next(e for e in candidates(context_of(model.arm)) if e.id == name)
    terms = (*model.model.terms, effect)
    bent = replace(model, model=replace(model.model, terms=terms), x=np.append(model.x, x))
    return replace(bent, covariance=np.eye(len(bent.x) + 6) * 1e-12).with_bends()


@pytest.mark.parametrize(
    ("name", "x"), [("base_compliance", [2e-6, 2e-6]), ("link_bending", [5e-6])]
)
def test_links_and_base_bend_under_the_weights_that_go_along(name, x):
    true = with_effect(weighing(SECOND, OF_ARM), name, x)
    assert left_mm(true, measured(true, SECOND, 7)) < 2e-4


@pytest.mark.parametrize(("name", "x"), [("scale", [3e-4]), ("range_constant", [2e-4])])
def test_targets_that_are_read_distorted_are_so_about_frames_fitted_anew(name, x):
    springy = on_springs("ur10", STIFFNESS, SECOND, {"delta_a_2"})
    places_m = np.array([0.1, 0.0, 0.05, -0.1, 0.08, 0.0, 0.0, -0.1, 0.12])
    true = replace(with_effect(springy, name, x), targets_m=places_m)
    poses = true.as_modelled(measured(true.only(*springy.model.terms), SECOND, 8))
    place = np.eye(4)
    place[:3, 3] = [0.4, -1.2, 0.3]
    true = replace(true, T_instr_base=place)
    cov_m2 = np.tile(1e-10 * np.eye(3), (len(poses), 3, 1, 1))
    points = Points(("T1", "T2", "T3"), np.zeros((len(poses), 3, 3)), cov_m2, None)
    T_instr_ee = place @ springy.model.predict(poses.states, springy.x)
    states = replace(poses.states, seen=points.readout(T_instr_ee, places_m))
    T_instr_ee = place @ true.model.predict(states, true.x)
    points = replace(
        points, p_instr_m=points.ideal(T_instr_ee, true.targets_read_m(states)).p_instr_m
    )
    poses = Observations.single(poses.pose, states, points)
    assert summarise(true.deviations(poses)).rms_mm < 1e-9
    there = refit_frames(true, poses)
    assert summarise(there.deviations(poses)).rms_mm < 1e-6


# Uncertainty goes with the model.

BAND = BandPrior(5e-5, 3e-5, 6e-5, 3.0, 8.0, 3.0, 1e-6)


@pytest.fixture(name="model")
def _model():
    links = link_departures(ARM, Tolerances()).only({"delta_a_2", "delta_theta_3"})
    terms = (links, *(SensorError(f"joint {joint}", 36, BAND) for joint in (1, 2)))
    root = np.zeros((2 + 72 + 6,) * 2)
    root[0, 0], root[1, 1] = 1e-4, 1e-4
    for k, term in enumerate(terms[1:]):
        at = slice(2 + 36 * k, 38 + 36 * k)
        root[at, at] = term.prior_factor
    return FittedModel(
        Model(Chain.of(ARM), terms), np.zeros(74), np.eye(4), covariance=root @ root.T
    )


def test_what_frames_take_up_is_uncertain_no_more(model, see):
    rng = np.random.default_rng(8)
    every = see("ur10", "pose", count=120, size=0.0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=3).as_matrix(), [0.4, -1.2, 0.3]
    root = np.linalg.cholesky(model.covariance[:74, :74] + 1e-20 * np.eye(74))
    squares, expected = [], []
    for _ in range(12):
        true = replace(model, x=root @ rng.standard_normal(74))
        seen = T @ true.model.predict(every.states, true.x)
        poses = replace(every, measured=replace(every.measured, T_instr_target=seen))
        moved = refit_frames(model, poses)
        assert moved.covariance.shape == (74 + 6 + 6,) * 2
        squares.append(moved.deviations(poses).distance_mm ** 2)
        expected.append(moved.predict(every.states.q_rad, frame="tool").u_mm ** 2)
    ratio = np.mean(squares) / np.mean(expected)
    assert ratio == pytest.approx(1.0, abs=0.25)
    before = model.predict(every.states.q_rad).u_mm
    assert np.mean(expected) < np.mean(before**2)


# Frames that the poses do not identify.


@pytest.mark.parametrize("kind", ["pose", "points"])
@pytest.mark.parametrize("distinct", [1, 2])
def test_poses_that_do_not_identify_the_frames_are_refused(model, see, kind, distinct):
    readings = see("ur10", kind, count=12, size=0.0, noise_m=1e-5)
    few = readings.take(np.repeat(np.arange(1, 1 + distinct), 5))
    with pytest.raises(CalibrationError, match=r"do not identify .*further apart"):
        refit_frames(model, few)


# Noise that is larger than the instrument states.


def test_frames_are_as_uncertain_as_the_scatter_of_the_readings(see):
    chain = Model(Chain.of(ARM), ())
    known = FittedModel(chain, np.zeros(0), np.eye(4), covariance=np.zeros((6, 6)))
    exact = see("ur10", "pose", count=30, size=0.0)
    measured, q_rad = exact.measured, exact.states.q_rad

    def placed(T_instr_target):
        readings = replace(exact, measured=replace(measured, T_instr_target=T_instr_target))
        found = refit_frames(known, readings)
        predicted = found.predict(q_rad, frame="tool")
        return 1e3 * (found.T_instr_base @ predicted.T)[:, :3, 3], predicted.u_mm

    true_mm, _ = placed(measured.T_instr_target)
    squares, expected = [], []
    for seed in range(20):
        rng, seen = np.random.default_rng(seed), measured.T_instr_target.copy()
        turns = Rotation.from_rotvec(1e-3 * rng.standard_normal((30, 3))).as_matrix()
        seen[:, :3, :3] = turns @ seen[:, :3, :3]
        seen[:, :3, 3] += 1e-4 * rng.standard_normal((30, 3))
        found_mm, u_mm = placed(seen)
        squares.append(np.sum((found_mm - true_mm) ** 2, axis=1))
        expected.append(u_mm**2)
    assert np.mean(squares) == pytest.approx(np.mean(expected), rel=0.2)


def test_poses_without_what_the_model_reads_are_refused(found):
    _, poses = found
    springy = on_springs("ur10", STIFFNESS, FIRST, {"delta_a_2"})
    with pytest.raises(CalibrationError, match=r"80 of 80 poses.*log the torques"):
        refit_frames(springy, poses)


def test_poses_without_temperatures_are_refused_by_what_they_lack(see):
    every = see("ur10", "pose", count=30, size=0.0)
    states = replace(every.states, temperature_C=np.full(30, np.nan))
    rigid = FittedModel(Model(Chain.of(ARM), ()), np.zeros(0), np.eye(4))
    grown = with_effect(rigid, "thermal_growth", [1e-5])
    assert refit_frames(grown, every).covariance is not None
    with pytest.raises(CalibrationError, match=r"lack temperatures that.*; log the temperature"):
        refit_frames(grown, every.with_states(states))
    # Torques are not logged either, but this model does not read them.
    nowhere = replace(states, arrival=np.full((30, ARM.n), np.nan))
    slack = with_effect(rigid, "backlash", [1e-4])
    with pytest.raises(CalibrationError, match=r"lack directions of arrival that.*each joint"):
        refit_frames(slack, every.with_states(nowhere))
    q_rad = np.where(np.arange(30)[:, None] == 3, np.nan, states.q_rad)
    with pytest.raises(CalibrationError, match=r"lack joint positions that.*1 of 30 poses"):
        refit_frames(rigid, every.with_states(replace(states, q_rad=q_rad)))


def test_poses_whose_loads_are_no_numbers_are_refused(found):
    first, poses = found
    sagging = with_effect(first, "base_compliance", [2e-6, 2e-6])
    states = first.as_modelled(poses).states
    no_loads = replace(states, load_N=np.full(len(poses), np.nan))
    loads = statics_of(Model(sagging.model.chain, ()), np.zeros(0), no_loads, FIRST)
    poses = poses.with_states(replace(states, static_loads=loads))
    with pytest.raises(CalibrationError, match=r"lack finite loads that.*80 of 80 poses"):
        refit_frames(sagging, poses)


# Targets that are seen in some poses only, and fits that do not converge.


def test_targets_seen_in_turn_are_as_certain_as_among_few_poses(see):
    """Whatever the number of poses: every pose counts, as which are seen may recur."""
    known = FittedModel(
        Model(Chain.of(ARM), ()), np.zeros(0), np.eye(4), covariance=np.zeros((6, 6))
    )

    def u_mm(count):
        every = see("ur10", "points", count=count, size=0.0, noise_m=1e-5)
        in_turn = every.measured.p_instr_m.copy()
        in_turn[::2, 1], in_turn[1::2, [0, 2]] = np.nan, np.nan
        every = replace(every, measured=replace(every.measured, p_instr_m=in_turn))
        found = refit_frames(known, every)
        return found.predict(every.states.q_rad[:20], frame="tool").u_mm.mean()

    assert u_mm(4000) == pytest.approx(u_mm(1000) / 2.0, rel=0.2)


def test_the_fit_without_heights_of_targets_is_taken_where_the_other_does_not_converge(see):
    every = see("ur10", "points", count=30, size=0.0)
    start = calibrate.find_start(ARM, every)
    unknowns = choose_unknowns(ARM, Tolerances(), every.measured, start)
    fewer = replace(unknowns, targets_kept=unknowns.targets_kept[:-1])

    def fit_with(chosen):
        problem, x_start = with_unknown_frames(
            Model(Chain.of(ARM), ()), np.zeros(0), chosen, start, every
        )
        found = fit(problem, x_start)
        all_free = len(chosen.targets_kept) == len(start.targets_m)
        return FrameFit(problem, x_start, replace(found, converged=not all_free))

    found = fit_with_targets_shown(fewer, start, fit_with)
    assert found.solution.converged
    assert len(found.problem.places) == len(fewer.targets_kept)
