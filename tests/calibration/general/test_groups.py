"""One robot in several campaigns: sharper and right, whole from halves, and changed in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibrated import general
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, statics
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import find_start, start_of
from pa10cal.calibration.general.contradictions import contradictions
from pa10cal.calibration.general.per_campaign import per_campaign_fits
from pa10cal.calibration.general.unknowns import choose_unknowns
from pa10cal.calibration.noisy_campaign import noisy_campaign
from pa10cal.discovery.log_faults import faults_of_input
from pa10cal.errors import ModelError
from pa10cal.files.arms import load_arm
from pa10cal.fit.forward import Forward
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.model_writing import save_model
from pa10cal.observe.joined import GroupCampaign, join
from pa10cal.observe.pose import Touched
from pa10cal.observe.quantities import Start
from pa10cal.observe.seed import locate_base
from pa10cal.options import BaseFrameOptions, Tolerances
from pa10cal.results.calibration import CampaignAlone, Difference, GroupOfCampaigns

ARM = load_arm("ur10")
NOISE_M = 2e-5
GRAVITY = np.array([0.0, 0.0, -9.81])
MIXED = [("pose", "points"), ("touched", "pose"), ("points", "distance")]


def elsewhere(every, seed):
    """Measure from another place: where instrument and base are to each other is another."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return replace(every, measured=every.measured.in_frame(T))


def touched(points, noise_m):
    """Make of the positions of three targets those of balls whose places are known."""
    measured = points.measured
    places = np.array([[0.04, -0.03, 0.11], [-0.06, 0.02, 0.09], [0.01, 0.07, 0.05]])
    cov = np.tile(max(noise_m, 1e-5) ** 2 * np.eye(3), (len(points), 3, 1, 1))
    seen = np.isfinite(measured.p_instr_m).all(axis=(1, 2))
    touches = np.full((int(seen.sum()), 3), 5)
    found = Touched.of_balls(
        measured.names, 1e3 * places, 1e3 * measured.p_instr_m[seen], 1e6 * cov[seen], touches
    )
    return replace(points.take(seen), measured=found)


@pytest.fixture(name="members")
def _members(see):
    def members(kinds, noise_m, counts=(70, 61), moved_rad=0.0):
        found = []
        for k, (kind, count) in enumerate(zip(kinds, counts, strict=True)):
            seen_as = "points" if kind == "touched" else kind
            every = see("ur10", seen_as, count, seed=1, noise_m=noise_m, size=0.3)
            every = touched(every, noise_m) if kind == "touched" else every
            if k:
                q_rad = every.states.q_rad.copy()
                q_rad[:, 2] += moved_rad
                every = every.with_states(replace(every.states, q_rad=q_rad))
                every = elsewhere(every, 5)
            found.append(GroupCampaign(f"of-{k}", every, find_start(ARM, every)))
        return found

    return members


@pytest.mark.parametrize("kinds", [("pose", "touched"), ("touched", "pose"), ("pose", "points")])
def test_a_fit_starts_from_the_same_tools_by_a_seed_as_without(members, kinds):
    every = join(members(kinds, 0.0))
    found = find_start(ARM, every)
    seed = locate_base(every, ARM, BaseFrameOptions(), "", "group", "synthetic")
    of_seed = start_of(seed, every.measured)
    assert found.p_ee_target_by_campaign_m.keys() == of_seed.p_ee_target_by_campaign_m.keys()
    for name, tool_m in found.p_ee_target_by_campaign_m.items():
        np.testing.assert_allclose(of_seed.p_ee_target_by_campaign_m[name], tool_m, atol=1e-9)


def together(members):
    return general(ARM, join(members))


def shared(calibration):
    """Return values and standard uncertainties of the robot's own parameters, by name."""
    std = np.sqrt(np.diag(calibration.fit.covariance))
    return {
        parameter.name: (value, sigma)
        for parameter, value, sigma in zip(
            calibration.problem.parameters, calibration.fit.x, std, strict=True
        )
        if parameter.name.startswith("delta")
    }


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kinds", MIXED)
def test_intervals_of_a_group_are_narrower_than_of_each_alone_and_right(members, kinds):
    noisy, exact = together(members(kinds, NOISE_M)), together(members(kinds, 0.0))
    found, true = shared(noisy), shared(exact)
    assert found.keys() == true.keys()
    scores = np.array([(found[name][0] - true[name][0]) / found[name][1] for name in found])
    assert 0.4 < np.mean(scores**2) < 2.0
    for member in members(kinds, NOISE_M):
        alone = shared(general(ARM, member.observations))
        ratio = [found[name][1] / alone[name][1] for name in found if name in alone]
        assert len(ratio) > 15
        assert np.median(ratio) < 0.99
        assert max(ratio) < 1.1


def test_bases_and_tools_are_each_campaigns_own(members):
    found = together(members(("pose", "points"), 0.0))
    assert found.fit.converged
    names = [parameter.name for parameter in found.problem.parameters]
    assert {"base_x", "base_x@of-1", "tool_rz@of-0", "target_T1_x@of-1"} <= set(names)
    model, every = fitted(found), found.problem.observations
    left = model.deviations(every.turned(model.R_ee_target.T)).distance_mm
    np.testing.assert_allclose(left, 0.0, atol=1e-6)


def test_two_halves_of_a_campaign_give_what_the_whole_gives(see):
    for noise_m, most in ((0.0, 1e-6), (NOISE_M, 0.7)):
        whole = see("ur10", "pose", 120, seed=2, noise_m=noise_m, size=0.3)
        start = find_start(ARM, whole)
        halves = [
            GroupCampaign(f"half-{k}", whole.take(np.arange(len(whole)) % 2 == k), start)
            for k in (0, 1)
        ]
        one, two = shared(general(ARM, whole)), shared(together(halves))
        assert one.keys() == two.keys()
        off = [abs(one[name][0] - two[name][0]) / one[name][1] for name in one]
        assert max(off) < most


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kinds", [("pose", "points"), ("points", "distance")])
@pytest.mark.parametrize("moved_rad", [0.0, 1e-3])
def test_a_robot_that_was_changed_contradicts_itself(members, kinds, moved_rad):
    found = together(members(kinds, NOISE_M, moved_rad=moved_rad))
    found = per_campaign_fits(found.problem, found.fit)
    assert list(found.campaigns) == ["of-0", "of-1"]
    if not moved_rad:
        assert not contradictions(found, {})
        assert all(each.p_value > 1e-3 for each in found.campaigns.values())
        return
    (told,) = contradictions(found, {"delta_theta_3": 3})
    assert (told.where, told.kind, told.joint) == ("delta_theta_3", "joint_zero", 3)
    assert "contradict each other" in told.what
    assert "the arm was changed between them, delta_theta_3 by" in told.what
    worst = found.campaigns["of-0"].worst
    assert abs(abs(worst.value) - moved_rad) < 3.0 * worst.std


def _beams(every):
    """Return positions as an instrument at some distance reads them, and that distance."""
    T = np.eye(4)
    T[:3, 3] = (3.1, -0.7, 0.4)
    return every.measured.in_frame(T).p_instr_m


def _longer_by_scale(p_m):
    return 1.0003 * p_m


def _longer_by_constant(p_m):
    return p_m * (1.0 + 6e-4 / np.linalg.norm(p_m, axis=2, keepdims=True))


@pytest.mark.parametrize(
    ("longer", "kind", "value"),
    [
        (_longer_by_scale, "instrument_scale", 3e-4),
        (_longer_by_constant, "instrument_range", 6e-4),
    ],
)
def test_an_instrument_that_reads_longer_in_one_campaign_is_no_change_of_the_arm(
    see, longer, kind, value
):
    both = []
    for k, count in enumerate((70, 61)):
        every = see("ur10", "points", count, seed=1, noise_m=NOISE_M, size=0.3)
        p_m = longer(_beams(every)) if k else _beams(every)
        every = replace(every, measured=replace(every.measured, p_instr_m=p_m))
        both.append(GroupCampaign(f"of-{k}", every, find_start(ARM, every)))
    found = together(both)
    group = per_campaign_fits(found.problem, found.fit)
    (told,) = contradictions(group, {})
    assert (told.where, told.kind) == ("of-1: the measured positions", kind)
    assert told.what.index("of-1 reads") < told.what.index("less likely the arm was changed")
    own = {each.name: each for each in group.campaigns["of-1"].instrument}[kind]
    assert abs(own.value - value) < 4.0 * own.std < value
    # Three targets of which each coordinate has the noise of the readings.
    assert own.left_mm == pytest.approx(1e3 * np.sqrt(3.0) * NOISE_M, rel=0.2)
    (fault,) = faults_of_input([told])
    assert (fault.kind, fault.remedy) == ("step_in_time", told.remedy)


def test_a_tool_heavier_than_stated_in_one_campaign_is_no_change_of_the_arm(see):
    def tool(mass_kg):
        return Payload(mass_kg, np.array([0.0, 0.02, 0.1]), np.zeros(3), GRAVITY)

    def sagging(payload, drawn):
        def posed(q_rad):
            drawn.append(q_rad)
            coordinates = Chain.of(ARM).coordinates(q_rad)
            loads = statics(Chain.of(ARM), coordinates, np.zeros(len(q_rad)), payload)
            return q_rad - 3e-6 * loads.joint_Nm

        return posed

    both = []
    for k, (count, true_kg) in enumerate(((70, 2.0), (61, 4.5))):
        drawn = []
        posed = sagging(tool(true_kg), drawn)
        every = see("ur10", "points", count, seed=1, noise_m=NOISE_M, size=0.3, posed=posed)
        every = every.with_states(replace(every.states, q_rad=drawn[0]))
        both.append(GroupCampaign(f"of-{k}", every, find_start(ARM, every)))
    payload = replace(tool(2.0), of_campaigns=(tool(2.0), tool(2.0)))
    found = general(ARM, join(both), payload)
    group = per_campaign_fits(found.problem, found.fit, payload)
    (told,) = contradictions(group, {})
    assert (told.where, told.kind) == ("of-1: tool.mass_kg", "payload")
    assert "the tool of of-1 weighs" in told.what
    assert "weigh the tool of of-1, and correct tool.mass_kg" in told.remedy
    own = group.campaigns["of-1"].tool
    assert abs(own.value - 2.5) < 4.0 * own.std < 2.5
    (fault,) = faults_of_input([told])
    assert fault.kind == "payload"
    unknown = replace(tool(0.0), known=False)
    group = per_campaign_fits(found.problem, found.fit, unknown)
    assert group.campaigns["of-1"].tool is None


def differing(chi_square, worst, *instrument, dof=20.0):
    """Return a campaign that differs by so much, of which causes explain so much."""

    def cause(name, unit, explained, value=-2e-3):
        return Difference(
            name=name, unit=unit, value=value, std=1e-5, chi_square=explained, left_mm=0.1
        )

    return CampaignAlone(
        poses=50,
        rms_mm=0.2,
        alone_rms_mm=0.1,
        chi_square=chi_square,
        dof=dof,
        p_value=0.0,
        contradicts=True,
        worst=cause("delta_theta_3", "rad", worst),
        instrument=tuple(cause("instrument_scale", "1", part) for part in instrument),
    )


def told_of(*campaigns):
    named = dict(zip("abc", campaigns, strict=False))
    group = GroupOfCampaigns(campaigns=named, parameters={})
    (told,) = contradictions(group, {"delta_theta_3": 3})
    return told


def test_where_no_single_cause_explains_most_the_nearest_is_told_and_no_joint():
    told = told_of(differing(1000.0, 100.0, 450.0), differing(900.0, 100.0))
    assert "no single cause explains most of it; nearest is that a reads all lengths" in told.what
    assert (told.where, told.kind, told.joint) == ("a", "campaigns_differ", None)
    (fault,) = faults_of_input([told])
    assert (fault.kind, fault.where) == ("step_in_time", "a")
    told = told_of(differing(1000.0, 600.0), differing(1000.0, 600.0))
    assert (told.where, told.kind, told.joint) == ("delta_theta_3", "joint_zero", 3)


@pytest.mark.parametrize("dof", [0.8, 1.0, 5.0])
def test_what_the_likeliest_cause_leaves_is_told_however_little_is_shared(dof):
    told = told_of(*[differing(1000.0, 600.0, dof=dof)] * 2)
    assert "more than that differs" in told.what
    told = told_of(*[differing(1000.0, 999.0, dof=dof)] * 2)
    assert "more than that differs" not in told.what


def test_a_change_of_the_arm_has_a_sign_and_further_campaigns_are_named():
    told = told_of(*(differing(size, 0.9 * size) for size in (800.0, 1000.0, 900.0)))
    assert "delta_theta_3 by -2 ± 0.01 mrad in b" in told.what
    assert told.what.endswith("also against the others, perhaps only because of b: a, c")


def test_the_campaign_that_alone_is_noisier_than_stated_is_named(members):
    every = join(members(("pose", "points"), NOISE_M))
    error_mm = (
        1e3
        * NOISE_M
        * np.linalg.norm(np.random.default_rng(0).normal(size=(len(every), 3)), axis=1)
    )
    second = every.states.campaign == 1

    def noisy(times):
        return noisy_campaign(every, times * error_mm, every.measured.stated_covariance)

    assert noisy(1.0) is None
    assert noisy(2.0) is None  # both are: the model lacks something, or both are stated so
    found = noisy(np.where(second, 2.0, 1.0))
    assert found.name == "of-1"
    assert found.error_mm == pytest.approx(2.0 * found.noise_mm, rel=0.2)
    assert str(found).startswith("of-1 alone is noisier than stated: 0.0")
    alone = every.by_campaign()["of-1"]
    assert noisy_campaign(alone, 2.0 * error_mm[second], alone.measured.stated_covariance) is None


def test_what_one_campaign_leaves_open_another_determines(see, members):
    def held(q_rad):
        return np.where(np.arange(6) == 4, 0.7, q_rad)

    every = see("ur10", "pose", 70, seed=1, noise_m=NOISE_M, size=0.3, posed=held)
    still, moving = (
        GroupCampaign("still", every, find_start(ARM, every)),
        members(MIXED[0], NOISE_M)[1],
    )
    found = together([still, moving])
    found = per_campaign_fits(found.problem, found.fit)
    first, second = found.campaigns
    shared = found.parameters.values()
    assert not all(first in each.determined_by for each in shared)
    assert all(second in each.determined_by for each in shared)
    assert all(each.std <= 1.1 * each.std_alone[second] for each in shared)


def test_a_single_campaign_is_not_held_against_others(see):
    every = see("ur10", "pose", 60, noise_m=NOISE_M)
    alone = general(ARM, every)
    assert per_campaign_fits(alone.problem, alone.fit) is None


def test_every_campaigns_tool_and_targets_are_frames_by_name(members, tmp_path):
    model = fitted(together(members(("pose", "pose"), 0.0)))
    assert model.frames == ("flange", "tool", "tool@of-0", "tool@of-1")
    save_model(model, tmp_path / "model.yaml")
    back, q = load_model(tmp_path / "model.yaml"), np.full((1, 6), 0.4)
    first, second = (back.predict(q, frame=f"tool@of-{k}") for k in (0, 1))
    np.testing.assert_array_equal(back.predict(q, frame="tool").T, first.T)
    # The same tool was there in both, which every campaign has found for itself.
    np.testing.assert_allclose(second.T[:, :3, 3], first.T[:, :3, 3], atol=1e-7)
    held = back.T_flange_frame("tool@of-1")
    T = back.predict(q).T[0] @ held
    np.testing.assert_allclose(second.T[0], T, atol=1e-9)
    found = back.compensate(second.T, frame="tool@of-1", seed=q)
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    with pytest.raises(ModelError, match="tool@of-0, tool@of-1"):
        back.predict(q, frame="tool@other")


def test_a_frame_of_a_campaign_is_predicted_under_its_own_tool(members):
    light, heavy = (Payload(kg, np.zeros(3), np.zeros(3), GRAVITY) for kg in (1.0, 9.0))
    model = fitted(together(members(("pose", "pose"), 0.0)))
    group = replace(model, payload=replace(light, of_campaigns=(light, heavy)))
    q = np.full((1, 6), 0.4)
    for k, own in enumerate((light, heavy)):
        one = replace(model, payload=own)
        there = [each.predict(q, frame=f"tool@of-{k}").T for each in (group, one)]
        np.testing.assert_array_equal(*there)
        np.testing.assert_array_equal(
            group.states(q).tau_Nm, replace(model, payload=light).states(q).tau_Nm
        )
    torques = [Forward.of(group, f"tool@of-{k}").whole.payload.mass_kg for k in (0, 1)]
    assert torques == [1.0, 9.0]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("kinds", [("pose", "pose"), ("points", "pose")])
def test_a_tool_keeps_the_attitude_that_it_had_in_its_own_campaign(members, kinds, tmp_path):
    first, second = members(kinds, 0.0)
    R = Rotation.from_euler("XYZ", [0.3, -1.1, 2.0]).as_matrix()
    turned = second.observations.turned(R.T)
    mounted = replace(second, observations=turned, start=find_start(ARM, turned))
    save_model(fitted(together([first, mounted])), tmp_path / "model.yaml")
    group = load_model(tmp_path / "model.yaml").T_flange_frame("tool@of-1")
    alone, before = (
        fitted(general(ARM, each.observations)).T_flange_frame("tool") for each in (mounted, second)
    )
    np.testing.assert_allclose(group, alone, atol=1e-4)
    np.testing.assert_allclose(group[:3, :3], before[:3, :3] @ R, atol=1e-4)


@pytest.mark.parametrize(
    ("kinds", "tool"),
    [(("points", "pose"), "tool@of-1"), (("points", "distance"), "target_T1@of-0")],
)
def test_tool_is_that_of_poses_else_the_first_target(members, kinds, tool):
    model = fitted(together(members(kinds, 0.0)))
    assert tool in model.frames
    np.testing.assert_array_equal(model.T_flange_frame("tool"), model.T_flange_frame(tool))


def test_unknowns_are_chosen_by_poses_in_any_order_and_of_some_campaigns_too(members):
    found = together(members(("points", "pose"), 0.0))
    measured, model = found.problem.observations.measured, fitted(found)
    start = Start(model.T_instr_base, np.zeros(3), np.eye(3), model.targets_m)
    of_one = [np.flatnonzero(measured.campaign == k) for k in (0, 1)]
    mixed = np.random.default_rng(0).permutation(len(measured.campaign))
    both, shuffled, first, second = (
        choose_unknowns(ARM, Tolerances(), measured.take(rows), start)
        for rows in (slice(None), mixed, *of_one)
    )
    assert shuffled.links == both.links
    assert len(both.targets_kept) == len(shuffled.targets_kept) == len(first.targets_kept) == 9
    assert not len(second.targets_kept)  # the targets are those of the first campaign
