"""Roles of parameters: what each is an unknown of, whatever it is called."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pa10cal
from made_up_model import fitted
from pa10cal import terms
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.files.arms import load_arm
from pa10cal.options import Tolerances
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame, link_departures, tool_frame
from pa10cal.terms.plain import term_kinds
from pa10cal.terms.term import Traits
from pa10cal.terms.wrapped import OfCampaign, fixed

PACKAGE = Path(pa10cal.__file__).parent


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


def test_zeros_of_joints_are_those_of_joints_that_slide_too():
    arm = load_arm("ur10")
    on_a_rail = replace(arm, prismatic=np.arange(arm.n) == 0)
    model = Model(Chain.of(on_a_rail), (link_departures(on_a_rail, Tolerances()),))
    assert model.joint_zeros == {"delta_d_1": 1} | {f"delta_theta_{k}": k for k in range(2, 7)}


def test_a_class_states_that_it_yields_or_shows_in_torques_where_it_says_how():
    for kind in term_kinds().values():
        assert kind.yields == hasattr(kind, "by_torque"), kind
        assert kind.shows_torque == hasattr(kind, "torque_derivative"), kind


def test_every_effect_and_fault_states_where_it_sits():
    effects = {name: kind for name, kind in term_kinds().items() if issubclass(kind, Effect)}
    assert "load_stated" in effects
    assert [name for name, kind in effects.items() if not hasattr(kind, "sits")] == []


def test_a_model_without_some_roles_keeps_its_terms():
    model = fitted("pa10_6ce", 3, every_term).model
    left = model.without("tilt", "cubic")
    assert [term.id for term in left.terms] == [term.id for term in model.terms]
    gone = {each.name for each in model.parameters} - {each.name for each in left.parameters}
    assert gone == {"delta_beta_2", "cubic_share_2"}
    assert [term.of for term in model.terms_of("windup")] == ["joint 2", "joint 3"]
    assert model.departures["delta_theta_4"] == "theta_4"
    assert "tool_x@second" not in model.departures


@cache
def kinds_of_terms():
    """Return the names of all classes of terms."""
    for module in pkgutil.walk_packages(terms.__path__, f"{terms.__name__}."):
        importlib.import_module(module.name)
    found = [Traits]
    for kind in found:
        found += [each for each in kind.__subclasses__() if each not in found]
    return {kind.__name__ for kind in found}


def nodes_in(package):
    """Yield every node of the syntax of a package's modules, each with its module."""
    for path in sorted((PACKAGE / package).rglob("*.py")):
        yield from ((path, node) for node in ast.walk(ast.parse(path.read_text("utf-8"))))


#: Times that a package asks of which class a term is, in place of what it is an unknown of
#: (`roles`) or of what `terms.term.Traits` holds: may only fall.
CLASSES_ASKED = {"terms": 0, "fit": 0, "calibration": 0, "evaluation": 0, "discovery": 1}


@pytest.mark.parametrize("package", CLASSES_ASKED)
def test_terms_are_asked_what_they_do_and_not_of_which_class_they_are(package):
    asked = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path, node in nodes_in(package)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"
        if kinds_of_terms() & set(re.findall(r"\w+", ast.unparse(node.args[1])))
    ]
    assert len(asked) <= CLASSES_ASKED[package], f"declare it on the term: {asked}"
    assert len(asked) == CLASSES_ASKED[package], "fewer than before: write the new number here"


#: Times that a package asks how a text begins or ends. No parameter is told by its name: what is
#: left are kinds of components, frames, and where a mistake is. May only fall.
ENDS_ASKED = {"fit": 2, "calibration": 3, "evaluation": 0}


@pytest.mark.parametrize("package", ENDS_ASKED)
def test_parameters_are_told_by_their_role_and_not_by_their_name(package):
    asked = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path, node in nodes_in(package)
        if isinstance(node, ast.Attribute)
        and node.attr in ("startswith", "endswith", "removeprefix", "removesuffix")
    ]
    assert len(asked) <= ENDS_ASKED[package], f"ask for the role of the parameter: {asked}"
    assert len(asked) == ENDS_ASKED[package], "fewer than before: write the new number here"
