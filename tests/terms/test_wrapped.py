"""Terms around a term: of one campaign, and of parameters that are settled."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import states_of
from pa10cal.arm.chain import Chain
from pa10cal.errors import TermError
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.joint import FrictionTorque
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.readings import Scale
from pa10cal.terms.effects.structure import BaseCompliance
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame, motion_of_base, small_motion
from pa10cal.terms.plain import term_from_plain, term_to_plain
from pa10cal.terms.term import shows_torque
from pa10cal.terms.wrapped import FixedTorque, OfCampaign, OfPart, about_moved_base, fixed


def states(campaign):
    return states_of(load_arm("ur10"), poses=4, campaign=campaign)


OTHER = OfCampaign(base_frame(), 1, "ur10-c")


def test_it_moves_the_poses_of_its_campaign_alone():
    model = Model(Chain.of(load_arm("ur10")), (OTHER,))
    x = 1e-2 * np.arange(1, 7)
    campaign = np.array([0, 1, 1, 0])
    bare = Model(model.chain, ())
    moved = model.predict(states(campaign), x) - bare.predict(states(campaign), np.zeros(0))
    assert np.abs(moved).max(axis=(1, 2)).astype(bool).tolist() == [False, True, True, False]
    jacobian = model.predict_with_jacobian(states(campaign), x).jacobian
    assert jacobian.any(axis=(1, 2)).tolist() == [False, True, True, False]
    whole = Model(model.chain, (base_frame(),)).predict_with_jacobian(states(None), x).jacobian
    np.testing.assert_allclose(jacobian[1:3], whole[1:3], atol=1e-14)


def test_where_no_campaign_is_meant_the_first_is():
    x = np.ones(6)
    assert not OTHER.shift(states(None), x).any()
    assert OfCampaign(base_frame(), 0, "ur10-a").shift(states(None), x).all()


def test_its_parameters_bear_the_name_of_the_campaign():
    assert OTHER.parameters[0].name == "base_x@ur10-c"
    assert OTHER.report(np.zeros(6)).parameters == OTHER.parameters
    assert OTHER.of == "base@ur10-c"
    assert "ur10-c" in OTHER.formula


def test_it_goes_through_plain_data():
    plain = json.loads(json.dumps(term_to_plain(OTHER)))
    assert term_from_plain(plain, where="model.yaml") == OTHER
    del plain["form"]["name"]
    with pytest.raises(TermError, match="one campaign is incomplete"):
        term_from_plain(plain, where="model.yaml")


def test_a_spring_belongs_to_the_robot():
    with pytest.raises(TermError, match="cannot belong to one campaign"):
        OfCampaign(JointSpring(2, 100.0), 1, "ur10-c")


def test_bases_stay_where_they_are_when_the_first_becomes_the_frame():
    rng = np.random.default_rng(2)
    small, own = 1e-2 * rng.normal(size=(2, 6))
    x = np.concatenate([own, [7.0]])
    terms = (OTHER, base_frame().only({"base_z"}))
    found = about_moved_base(terms, x, small)
    np.testing.assert_allclose(
        motion_of_base(small) @ motion_of_base(found[:6]), motion_of_base(small + own), atol=1e-14
    )
    assert found[6] == 7.0
    np.testing.assert_allclose(small_motion(motion_of_base(own)), own, atol=1e-14)
    assert Rotation.from_matrix(motion_of_base(own)[:3, :3]).magnitude() > 0


def test_springs_give_way_to_what_joints_carry_all_the_same():
    states = states_of(load_arm("ur10"), poses=20)
    chain = Chain.of(load_arm("ur10"))
    spring, gain = JointSpring(2, 100.0, cubic=False), FrictionTorque("joint 2", 100.0)
    x_spring, x_gain = np.full(len(spring.parameters), 1e-3), np.array([8.0])
    known = Model(chain, (fixed(spring, x_spring), fixed(gain, x_gain)))
    free = Model(chain, (spring, gain))
    x = np.concatenate([x_spring, x_gain])
    np.testing.assert_array_equal(known.predict(states, np.zeros(0)), free.predict(states, x))
    np.testing.assert_array_equal(known.torque_Nm(states, np.zeros(0)), free.torque_Nm(states, x))
    assert known.predict_with_jacobian(states, np.zeros(0)).jacobian.shape == (20, 6, 0)
    assert isinstance(fixed(gain, x_gain), FixedTorque)
    assert free.torque_jacobian(states.take([]), x).shape == (0, 6, len(x))
    assert not shows_torque(fixed(spring, x_spring))
    assert not np.allclose(
        known.predict(states, np.zeros(0)), Model(chain, ()).predict(states, x[:0])
    )


@pytest.mark.parametrize(
    "term", [BaseDrift("base", 0.0), Scale("instrument"), BaseCompliance("base")]
)
def test_what_is_around_a_term_bends_varies_and_errs_as_it_does(term):
    for around in (OfCampaign(term, 1, "b"), OfPart(term, 0.0, 9.0, "b"), fixed(term, np.ones(3))):
        for trait in ("bends", "depends_on", "error_of", "coordinates"):
            assert getattr(around, trait) == getattr(term, trait), (around, trait)
