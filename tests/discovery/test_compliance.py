"""Joints that give way under weights that nobody stated: named on synthetic arms, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pa10cal
from mended import write_simulated
from pa10cal.arrays import rms
from pa10cal.discovery import compliance
from pa10cal.discovery.verdict_records import extended_parameters, verdict_keys
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.weights import holds_weights
from pa10cal.terms.wording import sentences
from pa10cal_lab.cell.trials import draw_trials

SEED = 20261123


def judged(tmp_path_factory, subject):
    (trial,) = draw_trials("unstated_masses", 1, SEED, "wild", ("ur10-pose",), only=subject)
    folder = write_simulated(tmp_path_factory.mktemp(subject) / "raw", trial.settings, trial.name)
    campaign = pa10cal.read_campaign(folder)
    model = pa10cal.calibrate(campaign)
    return trial, campaign, model, pa10cal.discover(campaign, model)


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    return judged(tmp_path_factory, "some_springs")


@pytest.fixture(scope="module")
def rigid(tmp_path_factory):
    return judged(tmp_path_factory, "no_springs")


@pytest.mark.slow
def test_joints_that_give_way_are_named(soft):
    trial, campaign, model, verdict = soft
    hidden = {entry.of for entry in trial.settings.hidden_effects}
    named = {finding.of for finding in verdict.gives_way}
    assert hidden
    assert named == hidden
    assert campaign.arm.weights_known.origin == "assumed"
    assert "no masses are stated" in model.fitted_to.health


@pytest.mark.slow
def test_where_loads_set_the_scale_a_stiffness_is_that_of_the_model(soft):
    *_, verdict = soft
    problem = compliance._LinearProblem.of(verdict)
    model = problem.at.model
    terms = [replace(term, u_scale=0.0) if holds_weights(term) else term for term in model.terms]
    scaled = replace(problem, at=replace(problem.at, model=replace(model, terms=tuple(terms))))
    for name in verdict.gives_way:
        (spring,) = (each for each in terms if is_spring(each) and each.of == name.of)
        K, relative = scaled.stiffness(spring), problem.stiffness(spring)
        assert K.Nm_rad == pytest.approx(spring.report(problem.at.values_of(spring)).values[0])
        assert K.u_Nm_rad < 0.5 * relative.u_Nm_rad
        assert (K.sag_rad, K.sag_u_rad) == (relative.sag_rad, relative.sag_u_rad)


@pytest.mark.slow
def test_stiffness_and_sag_are_as_uncertain_as_differences_make_them(soft):
    *_, verdict = soft
    problem = compliance._LinearProblem.of(verdict)
    at = problem.at
    (spring,) = filter(is_spring, at.model.terms)
    unknown = problem.is_weight[: len(at.x)].copy()
    unknown[at.model.columns_of(spring).start] = True
    by_x = np.zeros((2, len(at.x)))
    for k in np.flatnonzero(unknown):
        step = 1e-5 * problem.prior_std[k] * (np.arange(len(at.x)) == k)
        more, less = (
            replace(problem, at=replace(at, x=at.x + side * step)).stiffness(spring)
            for side in (1.0, -1.0)
        )
        changes = more.Nm_rad - less.Nm_rad, more.sag_rad - less.sag_rad
        by_x[:, k] = np.divide(changes, 2.0 * step[k])
    found = problem.stiffness(spring)
    of_scale = found.Nm_rad * at.model.u_scale
    assert found.u_Nm_rad == pytest.approx(np.hypot(problem._u(by_x[0]), of_scale), rel=1e-6)
    assert found.u_Nm_rad > of_scale
    assert found.sag_u_rad == pytest.approx(problem._u(by_x[1]), rel=1e-6)


@pytest.mark.slow
def test_what_they_take_away_is_said(soft):
    trial, *_, verdict = soft
    record = verdict_keys(verdict)
    true = {entry.of: entry.parameters["K"] for entry in trial.settings.hidden_effects}
    assert record.verdict in ("named", "ambiguous")
    for effect in record.effects:
        assert effect.id == "joint_compliance"
        assert effect.weights == "assumed"
        assert effect.parameters["K"].value > 0.0
        # The arm weighs 29 kg where 74 are assumed: poses show the sag, and not the stiffness.
        evidence, K = effect.evidence, effect.parameters["K"]
        assert evidence.sag_u_mrad < 0.2 * evidence.sag_mrad
        assert abs(K.value - true[effect.of]) < HALF_WIDTH_95 * K.std
        assert K.std > 0.5 * K.value
        assert evidence.held_out_rigid_mm > evidence.held_out_gives_way_mm
        assert evidence.lost_without_it_nats > evidence.needed_nats
    explained = record.explained
    assert explained.share > 0.5
    assert explained.of[0].weights == "assumed"
    assert explained.before_mm > explained.after_mm
    assert "under the arm's weight" in " ".join(sentences(explained))


@pytest.mark.slow
def test_a_model_with_assumed_weights_is_saved_and_read_back(soft, tmp_path):
    *_, verdict = soft
    verdict.model.save(tmp_path / "model.yaml")
    again = pa10cal.load_model(tmp_path / "model.yaml")
    assert again.arm.weights_known.origin == "assumed"
    q = np.tile([[0.1], [0.5], [1.0]], again.arm.n)
    np.testing.assert_allclose(again.predict(q).T, verdict.model.predict(q).T, atol=1e-9)


@pytest.mark.slow
def test_every_stiffness_that_is_said_is_as_uncertain_as_the_weights(soft):
    _, _, model, verdict = soft
    for said in (model, verdict.model):
        springs = [each for each in said.every_reported() if each[1].name.startswith("K_lin")]
        assert springs
        assert all(std > 0.5 * value for _, _, value, std in springs)
    relative = {
        name: p.std / p.value for name, p in extended_parameters(verdict).items() if "K_lin" in name
    }
    assert relative
    assert min(relative.values()) > 0.5


@pytest.mark.slow
def test_a_joint_that_would_sag_farther_than_joints_do_is_no_name(soft, monkeypatch):
    *_, verdict = soft
    limit = (1e-6, "no joint does")
    monkeypatch.setattr(compliance, "most_wound_up", lambda reach_m, commanded: limit)
    found = compliance.with_compliance(replace(verdict, gives_way=()))
    assert found.gives_way == ()
    assert found.verdict == "unexplained"
    assert {place.of for place in found.unexplained} == {each.of for each in verdict.gives_way}
    assert all("mrad: no joint does; if" in place.why for place in found.unexplained)
    assert all("state joints: commanded" in place.why for place in found.unexplained)


@pytest.mark.slow
def test_a_spring_that_is_shown_and_not_named_is_said(soft, monkeypatch):
    *_, verdict = soft
    monkeypatch.setattr(compliance, "NAMES", replace(compliance.NAMES, most_alternatives=-1))
    found = compliance.with_compliance(replace(verdict, gives_way=()))
    assert found.gives_way == ()
    assert {place.of for place in found.unexplained} == {each.of for each in verdict.gives_way}
    assert all(
        "other effect explains the data as well" in each.why
        or "other effects explain the data as well" in each.why
        for each in found.unexplained
    )


@pytest.mark.slow
def test_with_all_joints_rigid_those_without_a_name_give_way(soft, monkeypatch):
    *_, verdict = soft
    nameless = verdict.gives_way[0]
    springs = list(filter(is_spring, verdict.extended.at.model.terms))
    monkeypatch.setattr(compliance, "_springs", lambda found: springs)
    rivals = {("joint_compliance", spring.of): () for spring in springs}
    monkeypatch.setattr(compliance, "_rivals", lambda found, problem: rivals)
    monkeypatch.setattr(compliance, "needed_nats", lambda count, rate: -1e9)
    monkeypatch.setattr(
        compliance, "_why_not_named", lambda found, each: "so" if each.of == nameless.of else None
    )
    found = compliance.with_compliance(replace(verdict, gives_way=(), unexplained=()))
    assert {each.of for each in found.gives_way} == {s.of for s in springs} - {nameless.of}
    (left,) = found.unexplained
    assert left.why == f"joint_compliance of {nameless.of} fits best, but is not named: so"
    for each in found.gives_way:  # they hardly yield
        assert each.proof.all_rigid_mm < 0.5 * nameless.proof.all_rigid_mm
        assert each.proof.all_rigid_mm == pytest.approx(rms(each.proof.all_rigid_each_mm))


@pytest.mark.slow
def test_a_rigid_arm_has_no_joint_that_gives_way(rigid):
    *_, verdict = rigid
    assert verdict.gives_way == ()
    assert verdict.effects == ()
