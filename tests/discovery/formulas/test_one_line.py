"""A map that is one line has its name where the joint was seen all around, and else a formula."""

from types import SimpleNamespace

import numpy as np
import pytest

import made_up_survey
from made_up_arm import Missing, harmonic, measure
from made_up_survey import Hidden, at_joint, observe
from pa10cal.discovery.proposals import with_lines_named, with_proposals
from pa10cal.terms.effects.joint import PeriodicError
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap
from pa10cal.terms.forms import catalogue
from pa10cal.terms.forms.catalogue import all_around


def five_cycles(motion):
    return at_joint(3, 2e-4 * np.sin(5.0 * motion.q_rad[:, 2] + 0.7))


def judged():
    return with_lines_named(with_proposals(observe(Hidden(turn=five_cycles)).discovery))


@pytest.mark.slow
def test_a_line_seen_all_around_has_its_name(monkeypatch):
    monkeypatch.setattr(made_up_survey, "LOW_RAD", -3.0)
    monkeypatch.setattr(made_up_survey, "HIGH_RAD", 3.0)
    found = judged()
    assert found.verdict == "named"
    (finding,) = found.effects
    assert finding.effect == PeriodicError("joint 3", 5.0)
    assert finding.alternatives == ()
    assert found.proposed == ()
    values, std = finding.x, np.sqrt(np.diag(finding.covariance))
    assert (np.abs(values - [2e-4, 0.7, 5.0]) <= 4.0 * std).all()
    assert found.extended.effects == (finding.effect,)
    assert found.holdout.after.mean_mm < 0.5 * found.holdout.before.mean_mm
    assert found.scorer.seen is None  # it holds at any angle, as no map does


@pytest.mark.slow
def test_over_part_of_a_turn_it_stays_a_map_with_a_formula():
    found = judged()  # joints keep within 1.8 rad
    assert [each.id for each in found.effects] == ["joint_error_map"]
    (formula,) = found.proposed
    assert formula.form.formula == "theta_3 += A sin(5 q_3 + phi)"
    assert formula.record.orders[0] <= 5 <= formula.record.orders[1]


@pytest.mark.slow
def test_repeats_fit_the_line_in_the_place_of_their_map_too(monkeypatch):
    hidden = Missing(turn=harmonic(2, 3.0, 2e-4, 0.7))
    proposed = with_proposals(measure(hidden).discovery)
    assert [each.id for each in proposed.effects] == ["joint_error_map"]
    assert with_lines_named(proposed) is proposed  # the window is part of a turn
    monkeypatch.setattr(catalogue, "WIDEST_GAP_RAD", 2.0 * np.pi)
    found = with_lines_named(proposed)
    (finding,) = found.effects
    assert finding.effect == PeriodicError("joint 2", 3.0)
    std = np.sqrt(np.diag(finding.covariance))
    assert (np.abs(finding.x - [2e-4, 0.7, 3.0]) <= 4.0 * std).all()
    assert found.extended.effects == (finding.effect,)


def test_a_map_that_was_withdrawn_when_another_was_named_gets_no_name():
    """As in a group, where the refit of one line may harm a campaign by the map of another."""
    gone = JointErrorMap("joint 3", 36, FadingPrior(1e-4, 6.0))
    form = SimpleNamespace(order=5, form="harmonic", of="joint 3")
    proposal = SimpleNamespace(form=form, instead=(gone,), record=SimpleNamespace(orders=(5, 5)))
    found = SimpleNamespace(
        proposed=(proposal,),
        findings=(),
        falls_back=None,
        context=SimpleNamespace(arm=SimpleNamespace(gear_ratio=np.full(6, np.nan))),
        states=SimpleNamespace(q_rad=np.tile(np.linspace(-3.0, 3.0, 50)[:, None], 6)),
    )
    assert with_lines_named(found) is found


@pytest.mark.parametrize(
    ("angles_deg", "around"),
    [
        (np.arange(-180.0, 180.0, 20.0), True),
        (np.arange(0.0, 720.0, 45.0), True),
        (np.arange(-100.0, 100.0, 1.0), False),
        (np.arange(300.0, 600.0, 1.0), False),
        (np.arange(-160.0, 160.0, 1.0), True),
    ],
)
def test_all_around_leaves_no_wide_gap_in_a_turn(angles_deg, around):
    assert all_around(np.radians(angles_deg)) is around


def test_its_order_is_reported_and_is_no_unknown():
    line = PeriodicError("joint 2", 7.0)
    report = line.report(np.array([3e-4, 4e-4]))
    assert [parameter.name for parameter in report.parameters] == ["A", "phi", "k"]
    np.testing.assert_allclose(report.values, [5e-4, np.arctan2(4.0, 3.0), 7.0])
    assert not report.jacobian[2].any()
    assert line.formula == "theta_2 += A sin(7 q_2 + phi)"
