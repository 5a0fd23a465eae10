"""Lines of gears whose ratio nobody stated: cycles a turn, found from what a model leaves."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.gear_lines import drawn
from benchmarks.lost_motion import verdict_of

from made_up_arm import Missing, harmonic, measure
from made_up_survey import ARM, Hidden, observe
from pa10cal.arm.chain import Chain
from pa10cal.discovery import jacobians
from pa10cal.discovery.finding import effect_parameters
from pa10cal.discovery.gear_lines import gear_lines, stroke_waves
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.slide import SlideError
from pa10cal.terms.model import Model
from pa10cal.terms.wording import parameters_text
from pa10cal_lab.cell.effects.joint import SimulatedGearLine

POSES, RATE, NOISE = 250, 0.01, 2e-5


@pytest.fixture(scope="module")
def given():
    return observe(poses=POSES, held_out=10)


def left_by(at, poses, joint, cycles, size_rad, seed=0):
    """What a model leaves of poses with a line at a joint and noise, predicted less measured."""
    follows = jacobians.by_joints(at, poses, [joint])[:, :, 0]
    q_rad = poses.states.q_rad[:, joint - 1]
    noise = np.random.default_rng(seed).normal(0.0, NOISE, follows.shape)
    return noise - follows * (size_rad * np.sin(cycles * q_rad + 1.0))[:, None]


def found(at, poses, left):
    whiten = np.tile(np.eye(left.shape[1]) / NOISE, (len(poses), 1, 1))
    return gear_lines(WhitenedPoses(at, poses, left, whiten), RATE)


@pytest.mark.parametrize(("joint", "cycles"), [(1, 31.4), (2, 50.0), (3, 101.0), (5, 180.3)])
def test_cycles_are_found_at_their_joint(given, joint, cycles):
    at, poses = given.baseline, given.readings
    (line,) = found(at, poses, left_by(at, poses, joint, cycles, 2e-4))
    assert (line.id, line.of) == ("gear_line", f"joint {joint}")
    assert abs(line.order - cycles) < 0.05
    assert line.multiples == ()


@pytest.mark.parametrize(
    ("k", "waves"), [(60.0, {1: 1.6e-4, 2: 8e-5, 3: 5e-5}), (40.0, {1: 8e-5, 2: 2e-4})]
)
def test_what_is_no_sine_has_waves_at_multiples_of_its_cycles(given, k, waves):
    at, poses = given.baseline, given.readings
    left = sum(left_by(at, poses, 2, m * k, A, seed=m) for m, A in waves.items())
    (line,) = found(at, poses, left)
    assert line.order == pytest.approx(k, abs=0.1)
    assert line.multiples == tuple(waves)[1:]


def test_a_line_may_be_the_double_of_a_ratio_that_is_too_low_for_one(given):
    at, poses = given.baseline, given.readings
    left = sum(left_by(at, poses, 2, k, A) for k, A in ((10.0, 8e-5), (20.0, 2e-4)))
    (line,) = found(at, poses, left)
    assert (line.order, line.multiples) == (pytest.approx(20.0, abs=0.1), ())


def test_cycles_are_fitted_within_what_the_range_of_the_joint_resolves(given):
    at, poses = given.baseline, given.readings
    (line,) = found(at, poses, left_by(at, poses, 2, 50.0, 2e-4))
    turn = 2.0 * np.pi / np.ptp(poses.states.q_rad[:, 1])
    assert line.width == pytest.approx(max(turn, 1.0), abs=1e-3)
    narrow_rad = poses.states.q_rad.copy()
    narrow_rad[:, 1] *= 1.0 / np.ptp(narrow_rad[:, 1])  # 57 deg
    poses = replace(poses, states=replace(poses.states, q_rad=narrow_rad))
    (line,) = found(at, poses, left_by(at, poses, 2, 50.0, 6e-4))
    assert line.width == pytest.approx(2.0 * np.pi, abs=1e-3)
    k = line.parameters[-1]
    assert (k.lower, k.upper) == (line.order - 0.5 * line.width, line.order + 0.5 * line.width)


def test_cycles_at_the_end_of_their_range_are_not_exact():
    line = GearLine("joint 2", 199.288, 6.3)
    covariance = np.diag([1e-10, 0.01, 0.0])  # as a fit leaves what it holds at a bound
    found = effect_parameters(line, np.array([1e-4, -0.4, 196.138]), covariance)
    assert found["k"].std == pytest.approx(6.3 / np.sqrt(12.0))
    assert found["A"].std == pytest.approx(1e-5)
    assert parameters_text(found).endswith("k = 196.1 ± 4")  # no unit of a plain number


def test_noise_has_none(given):
    at, poses = given.baseline, given.readings
    for seed in range(20):
        assert found(at, poses, left_by(at, poses, 1, 50.0, 0.0, seed)) == ()


def test_angles_in_whole_steps_do_not_tell_cycles_apart(given):
    # At steps of 5 degrees 50 cycles a turn look like 22 and like 94.
    at, poses = given.baseline, given.readings
    step = np.radians(5.0)
    states = replace(poses.states, q_rad=step * np.round(poses.states.q_rad / step))
    poses = replace(poses, states=states)
    assert found(at, poses, left_by(at, poses, 2, 50.0, 3e-4)) == ()


def test_what_a_stated_ratio_gives_is_left_to_its_name(given):
    at, poses = given.baseline, given.readings
    chain = Chain.of(replace(ARM, gear_ratio=np.full(ARM.n, 50.0)), bends=at.model.chain.bends)
    stated = replace(at, model=Model(chain, at.model.terms))
    left = left_by(at, poses, 2, 100.0, 2e-4)
    assert found(at, poses, left)
    assert found(stated, poses, left) == ()
    of_motor = left + left_by(at, poses, 2, 50.0, 4e-4)
    (line,) = found(stated, poses, of_motor)
    assert (line.order, line.multiples) == (pytest.approx(50.0, abs=0.1), ())


@pytest.mark.slow
def test_repeats_name_a_line_with_its_cycles():
    verdict = measure(Missing(turn=harmonic(2, 137.0, 2e-4, 1.0)), poses=70).discovery
    (finding,) = verdict.effects
    assert (verdict.verdict, finding.id, finding.of) == ("named", "gear_line", "joint 2")
    assert finding.x == pytest.approx([2e-4, 1.0, 137.0], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("cycles", [5.0, 6.0])
def test_repeats_name_a_line_that_a_map_half_follows_and_nothing_beside_it(cycles):
    """A map of twelve knots does not follow the sine of six cycles a turn."""
    verdict = measure(Missing(turn=harmonic(2, cycles, 3e-4, -0.5)), poses=70).discovery
    (finding,) = verdict.effects
    assert (verdict.verdict, finding.id, finding.of) == ("named", "gear_line", "joint 2")
    assert finding.x == pytest.approx([3e-4, -0.5, cycles], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "cycles"), [(1, (4.0, 8.0)), (2, (4.0, 6.0)), (3, (3.0, 4.0, 7.0))]
)
def test_repeats_take_a_fine_map_where_a_coarse_one_draws_other_effects_of_its_joint(joint, cycles):
    """Else large errors of its encoder that cancel, or a line, would stand beside the map."""

    def turn(states):
        phases = np.linspace(0.5, 2.5, len(cycles))
        each = zip(cycles, phases, strict=True)
        return sum(harmonic(joint, k, 1.2e-4, phase)(states) for k, phase in each)

    verdict = measure(Missing(turn=turn), poses=70).discovery
    (finding,) = verdict.effects
    named = finding.id, finding.of
    assert (verdict.verdict, *named) == ("named", "joint_error_map", f"joint {joint}")
    assert np.ptp(finding.x) < 3e-3


@pytest.mark.slow
def test_blocks_name_a_line_with_its_cycles_and_predict_by_it():
    turn = SimulatedGearLine(A=2e-4, phi=0.4, k=81.3).at("joint 3").added
    verdict = observe(Hidden(turn=turn), poses=300).discovery
    (finding,) = verdict.effects
    assert (verdict.verdict, finding.id, finding.of) == ("named", "gear_line", "joint 3")
    assert finding.x == pytest.approx([2e-4, 0.4, 81.3], rel=0.05)
    assert verdict.holdout.after.mean_mm < 0.5 * verdict.holdout.before.mean_mm


@pytest.mark.slow
@pytest.mark.parametrize("number", [5, 7, 8, 19])
def test_arms_of_other_kinematics(tmp_path, number):
    arm, joint, turns = drawn(tmp_path / "arm", np.random.default_rng([1, number]), number)
    verdict = verdict_of(tmp_path / "arm")
    lines = {each.of: each.x[-1] for each in verdict.effects if each.id == "gear_line"}
    # of slow waves a map follows, and none is a line
    right = {f"joint {joint}": pytest.approx(turns, abs=0.1)} if turns >= 13.0 else {}
    assert lines == right
    assert joint == 0 or arm.rms_mm > 0.0


# Waves along the stroke of a joint that slides, which have no name.


@pytest.fixture(scope="module")
def on_rail(given):
    """The same poses of an arm whose first joint slides, by as many metres as it turned."""
    arm = replace(ARM, prismatic=np.arange(ARM.n) == 0)
    chain = Chain.of(arm, bends=given.baseline.model.chain.bends)
    at = replace(given.baseline, model=Model(chain, given.baseline.model.terms))
    return at, replace(given.survey.context, arm=arm), given.readings


def waves(at, context, poses, left):
    whiten = np.tile(np.eye(left.shape[1]) / NOISE, (len(poses), 1, 1))
    return stroke_waves(WhitenedPoses(at, poses, left, whiten), context, RATE)


def bumps(at, context, poses, length_m, size, seed=0):
    """What a model leaves where a carriage rises and pitches by its supports."""
    (slide,) = SlideError.everywhere(context)
    moves = jacobians.by_coordinates(at.bending_as([slide]), poses, slide.coordinates)
    phase = 2.0 * np.pi / length_m * poses.states.q_rad[:, 0]
    along = np.stack([np.zeros_like(phase), np.cos(phase), np.zeros_like(phase)], axis=1)
    motion = size * np.concatenate([along, 0.3 * np.roll(along, 1, axis=1)], axis=1)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, moves.shape[:2])
    return noise - np.einsum("pbc,pc->pb", moves, motion)


@pytest.mark.parametrize("length_m", [0.06, 0.5])
def test_waves_along_a_stroke_are_told_with_their_length(on_rail, length_m):
    at, context, poses = on_rail
    (wave,) = waves(at, context, poses, bumps(at, context, poses, length_m, 1e-4))
    assert (wave.of, wave.length_m) == ("joint 1", pytest.approx(length_m, rel=0.01))


@pytest.mark.parametrize("size", [0.0, 1e-4])
def test_a_stroke_of_millimetres_has_as_many_waves_as_one_of_metres(on_rail, size):
    at, context, poses = on_rail
    q, span = poses.states.q_rad.copy(), context.q_span_rad.copy()
    q[:, 0] *= 4e-3
    span[0] *= 4e-3
    short = replace(poses, states=replace(poses.states, q_rad=q))
    context = replace(context, q_span_rad=span)
    found = waves(at, context, short, bumps(at, context, short, 1e-3, size))
    assert [wave.of for wave in found] == ["joint 1"] * (size > 0.0)
    assert all(wave.length_m == pytest.approx(1e-3, rel=0.01) for wave in found)


def test_there_is_none_in_noise_nor_where_a_slide_stood_at_a_few_places(on_rail):
    at, context, poses = on_rail
    for seed in range(5):
        assert waves(at, context, poses, bumps(at, context, poses, 0.5, 0.0, seed)) == ()
    q = poses.states.q_rad.copy()
    q[:, 0] = 0.6 * np.round(q[:, 0] / 0.6)
    few = replace(poses, states=replace(poses.states, q_rad=q))
    assert waves(at, context, few, bumps(at, context, few, 0.5, 3e-4)) == ()
