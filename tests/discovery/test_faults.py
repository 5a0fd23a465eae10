"""Faults of a log: when a verdict is `check_the_log`, and a fault of the whole log in words."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from pa10cal.discovery.finding import is_named
from pa10cal.discovery.log_faults import (
    DiagnosedFault,
    fault_of,
    faults_of_input,
    log_is_to_be_checked,
)
from pa10cal.discovery.preparation import effects_in
from pa10cal.discovery.verdict import Verdict
from pa10cal.fit.fitted import FittedTo
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.statement_faults import FaultText, LogFault, is_fault
from pa10cal.terms.term import TermParameter


@dataclass(frozen=True)
class Shift(LogFault):
    """A fault that is made up: the base stands off along x."""

    id: ClassVar[str] = "made_up"
    kind: ClassVar[str] = "step_in_time"

    @classmethod
    def everywhere(cls, context):
        del context
        return (cls("base"),)

    @property
    def formula(self):
        return "base.x += shift"

    @property
    def reported(self):
        return (TermParameter("shift", "m", 1e-6, plausible=1e-4),)

    def derivative(self, states, x):
        raise AssertionError("what a verdict does with a fault takes no derivative of it")

    def fault_text(self, x, std):
        return FaultText("base", f"off by {1e3 * x[0]:.2f} ± {1e3 * std[0]:.2f} mm", "look")


@pytest.mark.parametrize(
    ("decides", "effects", "expected"),
    [
        ((), False, False),
        ((), True, False),
        ((True,), True, True),
        ((False,), True, False),
        ((False,), False, True),
        ((False, True), True, True),
    ],
)
def test_a_reading_once_excluded_leaves_effects_standing(decides, effects, expected):
    about = {"kind": "outlier", "where": "pose 7", "what": "off", "remedy": "measure again"}
    faults = [DiagnosedFault(**about, decides=each) for each in decides]
    for unexplained in (False, True):
        checked = log_is_to_be_checked(faults, has_effects=effects, is_unexplained=unexplained)
        assert checked is expected


def test_a_fault_of_the_whole_log_is_told_with_its_uncertainty_and_is_no_name():
    term = Shift("base")
    told = fault_of(term, np.array([1e-4]), np.array([[1e-10]]), 0.5)
    assert (told.kind, told.where, told.gain) == ("step_in_time", "base", 0.5)
    assert "0.10 ± 0.01 mm" in str(told)
    assert not is_named(term)
    assert is_fault(term)


def test_faults_do_not_make_it_harder_to_name_an_effect():
    effects = [BaseDrift("base", 0.0), BaseDrift("base", 1.0)]
    assert effects_in([*effects, Shift("base")]) == effects_in(effects) == 2


def test_what_the_calibration_finds_wrong_in_the_log_is_a_fault_of_it():
    found = faults_of_input(
        [
            InputFinding(
                kind=kind,
                where=where,
                what="off",
                remedy="mend",
                would_leave_mm=left_mm,
                joint=joint,
            )
            for kind, where, left_mm, joint in (
                ("departure", "delta_theta_3", None, 3),
                ("departure", "delta_d_1", None, 1),  # the zero of a joint that slides
                ("departure", "delta_theta_1", None, None),  # the angle of its link
                ("departure", "a_2", None, None),
                ("joint_sign", "q6", 0.05, 6),
                ("joint_zero", "q3", None, 4),  # joint 3 follows, and has no column
                ("gravity", "campaign.yaml: gravity_m_s2", None, None),
            )
        ]
    )
    assert [(fault.kind, fault.where, fault.what) for fault in found] == [
        ("joint_zero", "joint 3", "off"),
        ("joint_zero", "joint 1", "off"),
        ("joint_sign", "joint 6", "off (0.05 mm rms would remain if that is put right)"),
        ("joint_zero", "joint 4", "off"),
    ]
    assert [fault.is_departure for fault in found] == [True, True, False, False]


DEPARTS = {
    "kind": "departure", "where": "delta_theta_3", "what": "1 deg off", "remedy": "check",
    "joint": 3,
}  # fmt: skip
SIGN = {"kind": "joint_sign", "where": "q6", "what": "reversed", "remedy": "negate it", "joint": 6}


@pytest.mark.parametrize(
    ("left_mm", "poses", "effects", "confirmed"),
    [
        (0.15, 20, ("lost motion",), True),
        (0.25, 20, ("lost motion",), False),  # more than the noise is left
        (0.15, 4, ("lost motion",), False),
        (0.15, 20, (), False),
    ],
)
def test_departures_are_no_faults_where_held_out_poses_confirm_them(
    left_mm, poses, effects, confirmed
):
    after = SimpleNamespace(configurations=poses, rms_mm=left_mm)
    verdict = SimpleNamespace(
        trusted_holdout=SimpleNamespace(after=after, noise_rms_mm=0.1),
        effects=effects, holds_nowhere=False, findings=(), faults_of_rows=(), since=None,
    )  # fmt: skip
    verdict.departures_are_confirmed = Verdict.departures_are_confirmed.func(verdict)
    assert verdict.departures_are_confirmed is confirmed
    verdict.prepared = SimpleNamespace(
        faults=faults_of_input([InputFinding(**DEPARTS), InputFinding(**SIGN)])
    )
    zero = () if confirmed else ("joint 3",)
    assert tuple(fault.where for fault in Verdict.faults.fget(verdict)) == (*zero, "joint 6")


def fitted_as(grade, *suspected):
    return FittedTo(
        campaign="mine", provenance="", calibration="combined", instrument="tracker", poses=100,
        temperature_C=None, time_s=(0.0, 1.0), grade=grade, health="of the calibration",
        suspicions=tuple(InputFinding(**each) for each in suspected),
    )  # fmt: skip


@pytest.mark.parametrize(("others", "grade"), [((), "incomplete"), ((SIGN,), "suspect_input")])
def test_a_fit_of_confirmed_departures_is_incomplete(others, grade):
    about = fitted_as("suspect_input", DEPARTS, *others)
    found = about.confirmed()
    assert found.grade == grade
    assert (found == about) is bool(others)
    assert ("1 deg off, as held-out poses confirm" in found.health) is not bool(others)


def test_departures_confirm_no_fit_that_did_not_converge():
    about = fitted_as("not_converged", DEPARTS)
    assert about.confirmed() == about


COUPLING = {"id": "joint_coupling", "of": "joint 3"}
SLIDES = {
    "kind": "joint_coupling", "where": "q3, q4", "what": "joint 3 slides as joint 4 turns",
    "remedy": "set coupling", "effect": COUPLING,
}  # fmt: skip


def test_an_effect_that_was_found_is_no_fault_of_the_log_and_its_model_is_used():
    about, found = fitted_as("suspect_input", SLIDES), [EffectName(**COUPLING)]
    confirmed = about.confirmed(effects=found)
    assert (confirmed.grade, confirmed.suspicions) == ("incomplete", ())
    assert "what looked like a fault of the log is joint_coupling of joint 3" in confirmed.health
    assert about.is_confirmed_as(confirmed)
    assert about.confirmed() == about
    assert about.confirmed(effects=[EffectName(id="backlash", of="joint 3")]) == about
    both = fitted_as("suspect_input", SLIDES, SIGN)
    assert both.confirmed(effects=found) == both


@pytest.mark.parametrize("grade", ["good", "incomplete", "suspect_input", "not_converged"])
def test_a_calibration_across_a_step_of_a_joint_is_of_no_one_state(grade):
    """Even where repeats count the step as noise, so that the calibration is good by itself."""
    about = fitted_as(grade, *[SIGN] * (grade == "suspect_input"))
    since = about.confirmed(steps=True)
    if grade in ("suspect_input", "not_converged"):
        assert since == about
        return
    assert since.grade == "incomplete"
    assert "the extended model is of the arm since the last step" in since.health
    assert about.is_confirmed_as(since)


CONTRADICTS = {
    "what": "june and july contradict each other", "where": "june: tool.mass_kg",
    "remedy": "weigh it", "kind": "payload", "between_campaigns": True,
}  # fmt: skip


@pytest.mark.parametrize(
    ("suspected", "departures", "campaigns", "grade"),
    [
        ((CONTRADICTS,), False, True, "incomplete"),
        ((CONTRADICTS,), True, False, "suspect_input"),
        ((CONTRADICTS, DEPARTS), True, True, "incomplete"),
        ((CONTRADICTS, DEPARTS), False, True, "suspect_input"),
        ((CONTRADICTS, SIGN), True, True, "suspect_input"),
    ],
)
def test_a_fit_whose_campaigns_agree_with_what_was_found_is_incomplete(
    suspected, departures, campaigns, grade
):
    about = fitted_as("suspect_input", *suspected)
    found = about.confirmed(departures=departures, campaigns=campaigns)
    assert found.grade == grade
    assert about.is_confirmed_as(found)
    assert ("with which the campaigns agree" in found.health) is (grade == "incomplete")
    (fault,) = faults_of_input([InputFinding(**CONTRADICTS)])
    assert fault.between_campaigns


@pytest.mark.parametrize("kind", ["payload", "campaigns_differ"])
def test_campaigns_that_no_single_cause_sets_apart_may_lack_an_effect(kind):
    """What is unexplained is told and predicted then, and not the log blamed for it."""
    faults = faults_of_input([InputFinding(**CONTRADICTS | {"kind": kind})])
    for unexplained in (False, True):
        checked = log_is_to_be_checked(faults, has_effects=False, is_unexplained=unexplained)
        assert checked is not (unexplained and kind == "campaigns_differ")
