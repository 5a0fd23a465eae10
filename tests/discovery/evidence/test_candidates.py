"""What poses can tell is settled before residuals are looked at, linear about one fit."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from made_up_arm import Missing, at_joint, measure
from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.evidence.candidates import indistinguishable, linearise, split_testable
from pa10cal.discovery.evidence.fit import fit
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.evidence.problem import prepare
from pa10cal.discovery.model_with_effects import with_base_motion, with_unknowns
from pa10cal.discovery.rules import CANDIDATES
from pa10cal.observe.kinds import instruments
from pa10cal.terms.effects.effect import JointEffect
from pa10cal.terms.effects.joint import TransmissionError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.term import TermParameter


@dataclass(frozen=True)
class MadeUp(JointEffect):
    """An effect of one joint in one parameter, its shape given by a subclass."""

    id: ClassVar[str] = "made_up"
    plausible: ClassVar[float] = 3e-4
    formula = "made up"

    @property
    def reported(self):
        return (TermParameter("size", "rad", 1e-5, plausible=self.plausible),)

    def derivative(self, states: PoseStates, x):
        return self.shape(states)[:, None, None]

    def shape(self, states: PoseStates):
        return np.sin(40.0 * states.q_rad[:, self.joint - 1])


class Constant(MadeUp):
    def shape(self, states):
        return np.ones(len(states))


class NearlyConstant(MadeUp):
    def shape(self, states):
        return 1.0 + 1e-3 * super().shape(states)


class LargeNearlyConstant(MadeUp):
    """Of which 1 % is no zero of the joint, and that is plain to see."""

    plausible: ClassVar[float] = 1e-2

    def shape(self, states):
        return 1.0 + 1.5e-2 * super().shape(states)


class SmallNearlyConstant(LargeNearlyConstant):
    plausible: ClassVar[float] = 1e-3


class Tiny(MadeUp):
    plausible: ClassVar[float] = 1e-9


class Warm(MadeUp):
    def shape(self, states):
        return states.temperature_C - 21.0


class OfMotion(MadeUp):
    """Nothing at all in these poses."""

    def shape(self, states):
        return np.zeros(len(states))


def without_effects(measured, found):
    """Return a fit as found, with its effects taken out and all else as it is."""
    x = found.x[found.baseline_columns()]
    model = with_base_motion(measured.baseline)
    return replace(found, effects=(), sizes=(), at=replace(found.at, model=model, x=x))


class TestLinearise:
    NAMES = (("transmission_error", "joint 2"), ("friction_torque", "joint 3"))

    @pytest.mark.parametrize("factor", [1.0, 4.0])
    def test_effects_put_back_are_as_if_they_had_not_been_in_the_fit(self, null, factor):
        effects = tuple(null.effect(*name) for name in self.NAMES)
        found = fit(null.problem, effects, (1, 1), NO_SHARED_ERROR)
        first, last = found.columns_of(effects[0]).start, found.columns_of(effects[-1]).stop
        x = found.x.copy()
        x[first:last] = factor * np.array([2e-4, -1e-4, 1.5])
        found = replace(found, at=with_unknowns(found.at, x))
        back = linearise(null.problem, found, effects)
        without = linearise(null.problem, without_effects(null, found), effects)
        # Exactly linear torques; poses to second order in the size of the effects.
        np.testing.assert_allclose(back.torque_data, without.torque_data, atol=1e-9)
        moved = sum(
            block.pose @ found.at.values_of(effect)
            for block, effect in zip(back.blocks, effects, strict=True)
        )
        left = back.pose_data - without.pose_data
        assert np.linalg.norm(moved) > 100.0
        assert np.linalg.norm(left) < 2e-3 * factor * np.linalg.norm(moved)

    def test_rows_of_an_effect_are_what_it_adds_to_the_prediction(self, null):
        effects = tuple(null.effect(*name) for name in self.NAMES)
        lin = linearise(null.problem, null.start, effects)
        x = np.array([2e-5, -1e-5])
        with_it = fit(null.problem, effects[:1], (1,), NO_SHARED_ERROR)
        at = with_it.columns_of(effects[0])
        first, last = at.start, at.stop
        own = np.insert(null.start.x, [first] * (last - first), 0.0)
        there, absent = own.copy(), own
        there[first:last] = x
        rows = [
            null.problem.pose.noise_whitened(
                with_unknowns(with_it.at, at).compared(null.problem.cells).residual[:, :, None]
            )[:, 0]
            for at in (there, absent)
        ]
        np.testing.assert_allclose(
            lin.blocks[0].pose @ x, rows[0] - rows[1], atol=1e-3 * np.abs(rows[0] - rows[1]).max()
        )
        assert not lin.blocks[0].torque.any()
        assert lin.blocks[1].torque.any()
        assert lin.blocks[1].pose.any()  # joint 3 has a spring

    def test_candidates_come_in_the_order_asked_for(self, null):
        effects = tuple(null.effect(*name) for name in self.NAMES)
        found = fit(null.problem, effects[1:], (1,), NO_SHARED_ERROR)
        there = linearise(null.problem, found, effects)
        back = linearise(null.problem, found, effects[::-1])
        for one, other in zip(there.blocks, back.blocks[::-1], strict=True):
            np.testing.assert_allclose(one.pose, other.pose)
            np.testing.assert_array_equal(one.factor, other.factor)
        assert there.own.shape[1] == len(null.start.x)

    def test_a_shape_to_look_for_has_columns_for_each_start(self, null):
        effect = null.effect("soft_windup", "joint 2")
        (block,) = linearise(null.problem, null.start, (effect,)).blocks
        assert block.pose.shape[1] == len(effect.starts) > 1
        assert block.factor.shape == (len(effect.starts),) * 2


NOT_LOGGED, UNSEEN = "what it depends on was not logged", "the poses do not exercise it"


class TestTestable:
    def divide(self, null, *effects):
        shown, refused = split_testable(null.problem, null.start, effects)
        assert len(shown) + len(refused) == len(effects)
        return shown, {entry.effect: entry for entry in refused}

    @pytest.mark.parametrize("kind", [Constant, NearlyConstant, SmallNearlyConstant])
    def test_what_the_poses_show_is_testable_and_what_the_model_absorbs_is_not(self, null, kind):
        shown, refused = self.divide(null, kind("joint 2"), MadeUp("joint 2"))
        assert shown == (MadeUp("joint 2"),)
        entry = refused[kind("joint 2")]
        left, rest = entry.why.split(" % ")
        assert rest == "remains beside the model's own parameters"
        assert float(left) < 100.0 * CANDIDATES.least_share
        assert entry.by_these_poses

    def test_a_smaller_part_suffices_where_it_is_clear_of_the_noise(self, null):
        shown, _ = self.divide(null, LargeNearlyConstant("joint 2"))
        assert shown == (LargeNearlyConstant("joint 2"),)

    @pytest.mark.parametrize(
        ("effect", "why", "by_these_poses"),
        [
            (Warm("joint 2"), NOT_LOGGED, False),
            (("thermal_growth", "arm"), NOT_LOGGED, False),
            (
                TransmissionError("joint 2", np.nan),
                "the gear ratio of the joint is not known",
                False,
            ),
            (OfMotion("joint 2"), UNSEEN, True),
            (("torque_gain", "joint 1"), UNSEEN, True),  # its axis is upright: no weight loads it
            (Tiny("joint 2"), "ten times its plausible size would not rise above the noise", True),
        ],
        ids=str,
    )
    def test_what_they_do_not_is_refused_with_the_reason(self, null, effect, why, by_these_poses):
        effect = null.effect(*effect) if isinstance(effect, tuple) else effect
        _, refused = self.divide(null, effect)
        assert (refused[effect].why, refused[effect].by_these_poses) == (why, by_these_poses)

    def test_what_was_logged_after_all_is_testable(self, null):
        readings = null.problem.readings
        warm = 21.0 + 4.0 * np.sin(readings.states.time_s / 2000.0)
        readings = replace(readings, states=replace(readings.states, temperature_C=warm))
        problem = prepare(readings, null.baseline, null.setup)
        start = fit(problem, (), (), NO_SHARED_ERROR)
        assert split_testable(problem, start, (Warm("joint 2"),))[0] == (Warm("joint 2"),)

    def test_an_effect_that_needs_masses_is_not_where_they_are_not_known(self, null):
        setup = replace(null.setup, payload=None)
        problem = prepare(null.readings, null.baseline, setup)
        start = fit(problem, (), (), NO_SHARED_ERROR)
        names = [("link_bending", "forearm"), ("friction_torque", "joint 3")]
        shown, refused = split_testable(problem, start, tuple(null.effect(*name) for name in names))
        assert not shown
        why = {entry.effect.id: entry.why for entry in refused}
        assert "moments of the weights" in why["link_bending"]
        assert why["friction_torque"] == "the torques of the weights are not known"
        assert not any(entry.by_these_poses for entry in refused)

    @pytest.mark.parametrize(("angles", "is_shown"), [(6, False), (12, False), (24, True)])
    def test_a_map_of_a_joint_needs_enough_angles_of_a_grid(self, null, angles, is_shown):
        # Joints 4, 5 and 6 take as many values each: any so many numbers are a map of any of them.
        states = null.problem.cells.states
        q_rad = states.q_rad.copy()
        attitude = np.arange(len(q_rad)) * angles // len(q_rad)
        for joint in (3, 4, 5):
            around = 2.0 * np.pi * np.random.default_rng(joint).permutation(angles) / angles
            q_rad[:, joint] = around[attitude]
        cells = replace(null.problem.cells, states=replace(states, q_rad=q_rad))
        problem = replace(null.problem, cells=cells)
        maps = tuple(JointErrorMap(f"joint {joint}") for joint in (4, 5, 6))
        shown, refused = split_testable(problem, null.start, maps)
        assert shown == (maps if is_shown else ())
        why = f"the joint took {angles} angles, too few to show what it does between them"
        assert {(entry.why, entry.by_these_poses) for entry in refused} <= {(why, True)}


def test_a_tracker_has_one_scale_and_a_machine_that_touches_three(null):
    assert {each.id for each in null.every} & {"cmm_scale", "scale"} == {"scale"}
    kinds = instruments().items()
    assert {word for word, kind in kinds if kind.three_axes} == {"touch_trigger_cmm"}


class TestAlike:
    def test_a_twisting_forearm_looks_like_a_yielding_joint_4(self, null):
        same = indistinguishable(null.problem, null.start, null.family)
        np.testing.assert_array_equal(same, same.T)
        assert same.diagonal().all()
        pairs = {
            frozenset((null.family[i].id, null.family[j].id))
            for i, j in zip(*np.nonzero(np.triu(same, 1)), strict=True)
        }
        assert pairs == {frozenset(("link_torsion", "joint_compliance"))}

    def test_what_differs_by_what_the_model_absorbs_is_indistinguishable(self, null):
        class Shifted(MadeUp):
            def shape(self, states):
                return 5.0 + super().shape(states)

        class Elsewhere(MadeUp):
            def shape(self, states):
                return np.cos(40.0 * states.q_rad[:, self.joint - 1])

        three = (MadeUp("joint 2"), Shifted("joint 2"), Elsewhere("joint 2"))
        same = indistinguishable(null.problem, null.start, three)
        expected = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], dtype=bool)
        np.testing.assert_array_equal(same, expected)

    def test_nothing_generic_stands_for_another(self, null):
        class Unnamed(MadeUp):
            generic: ClassVar[bool] = True

        same = indistinguishable(null.problem, null.start, (MadeUp("joint 2"), Unnamed("joint 2")))
        np.testing.assert_array_equal(same, np.eye(2, dtype=bool))

    def test_is_settled_by_the_poses_and_not_by_what_is_missing_there(self, null):
        same = indistinguishable(null.problem, null.start, null.family)

        def turn(states):
            return at_joint(4, -states.tau_Nm[:, 3] / 6000.0)

        other = measure(Missing(turn=turn))
        again = indistinguishable(
            other.problem,
            other.start,
            tuple(other.effect(effect.id, effect.of) for effect in null.family),
        )
        np.testing.assert_array_equal(same, again)
