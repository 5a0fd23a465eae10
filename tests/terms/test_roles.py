"""Roles of parameters: what each is an unknown of, whatever it is called."""

from __future__ import annotations

from dataclasses import replace

from made_up_model import fitted
from pa10cal.arm.description import Arm
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OfCampaign
from pa10cal.terms.term import base_frame, fixed, link_departures, tool_frame


def every_term(arm: Arm):
    return (
        link_departures(arm, Tolerances()),
        JointSpring(2, 80.0),
        replace(JointSpring(3, 80.0), cubic=False),
        Backlash("joint 1"),
        OfCampaign(tool_frame(), 1, "second"),
        fixed(JointSpring(4, 80.0), [1e-3, 0.1]),
        base_frame(),
    )


def test_each_parameter_has_one_and_terms_keep_theirs():
    model = fitted("pa10_6ce", 3, every_term).model
    assert len(model.roles) == len(model.parameters)
    said = dict(zip((each.name for each in model.parameters), model.roles, strict=True))
    assert said["delta_theta_4"] == "zero"
    assert said["delta_beta_2"] == "tilt"
    assert {said[f"delta_{kind}_1"] for kind in ("a", "alpha", "d")} == {"link"}
    assert (said["windup_2"], said["cubic_share_2"]) == ("windup", "cubic")
    assert said["windup_3"] == "windup"
    assert "cubic_share_3" not in said
    assert said["tool_x@second"] == "tool"
    assert said["base_rz"] == "base"
    assert [role for name, role in said.items() if name.startswith("backlash")] == ["effect"]
    assert model.having("tilt", "zero").sum() == 1 + model.chain.arm.n
    assert not Model(model.chain, ()).having("link").any()
