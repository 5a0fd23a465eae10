"""Trials of trackers: reproducible, never twice in a pose, and effects where they do something."""

from collections import Counter

import numpy as np
import pytest

from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.lab.cell.campaign import simulate_campaign
from pa10cal.lab.cell.effects.vocabulary import all_effects, nameless, outside, vocabulary
from pa10cal.lab.cell.scenario import TRACKED_POSES
from pa10cal.lab.cell.trials import KINDS, STUDIES, draw_trials
from pa10cal.terms.effects.effect import candidates

SHORT = {"poses": 20}
BENCHES = STUDIES["tracked"]
REFLECTORS = ("points_one", "points_three", "distance")


def draw_tracker_trials(kind, count, seed, study="tracked", benches=()):
    return draw_trials(kind, count, seed, study, benches)


def hidden(trial):
    return [(effect.id, effect.of) for effect in trial.settings.hidden_effects]


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_trials_and_fewer_are_the_first_of_more(kind):
    trials = draw_tracker_trials(kind, 6, 1)
    assert draw_tracker_trials(kind, 6, 1) == trials
    assert draw_tracker_trials(kind, 4, 1) == trials[:4]
    assert not {trial.name for trial in trials} & {t.name for t in draw_tracker_trials(kind, 6, 2)}


def test_no_pose_is_repeated_and_a_share_is_held_out():
    for trial in draw_tracker_trials("null", 6, 3):
        made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
        schedule = made.truth.schedule
        assert len(set(schedule.pose)) == len(schedule) == TRACKED_POSES
        assert np.mean(schedule.kind == "holdout") == pytest.approx(0.3)
        assert trial.settings.hidden_effects == ()


def test_benches_take_turns_and_singles_go_through_the_vocabulary():
    nulls = draw_tracker_trials("null", 2 * len(BENCHES), 4)
    assert Counter(trial.bench for trial in nulls) == dict.fromkeys(BENCHES, 2)
    singles = draw_tracker_trials("single", 6 * len(vocabulary()), 4)
    assert Counter(hidden(trial)[0][0] for trial in singles) == dict.fromkeys(vocabulary(), 6)
    by_bench = Counter(t.bench for t in singles if hidden(t)[0][0] == "backlash")
    assert by_bench == dict.fromkeys(BENCHES, 1)
    assert {t.bench.split("-")[0] for t in singles if hidden(t)[0][0] == "link_bending"} == {
        "ur10",
        "iiwa14",
    }


def test_torque_effects_are_put_where_torques_are_logged_and_joints_yield():
    for name in ("friction_torque", "torque_gain"):
        trials = [
            trial
            for trial in draw_tracker_trials("single", 4 * len(vocabulary()), 5)
            if hidden(trial)[0][0] == name
        ]
        for trial in trials:
            plan = trial.settings.without_touches
            assert plan.logs_torques
            assert int(hidden(trial)[0][1].removeprefix("joint ")) in plan.flexible_joints


def test_every_effect_does_something_where_it_is_put():
    kinds = [("single", len(vocabulary())), ("outside", len(outside()))]
    for trial in [trial for kind, count in kinds for trial in draw_tracker_trials(kind, count, 6)]:
        settings = trial.settings
        plan = settings.without_touches.model_copy(update=SHORT)
        short = settings.model_copy(update={"without_touches": plan})
        arm = load_arm(settings.robot)
        bare = short.model_copy(update={"hidden_effects": ()})
        made, plain = (simulate_campaign("x", arm, each).tables["poses"] for each in (short, bare))
        assert not made.equals(plain), hidden(trial)


def test_singles_have_the_size_that_the_vocabulary_holds_for_plausible():
    """The cell knows nothing of the vocabulary's terms: two statements, held together here."""
    from pa10cal.lab.cell.effects.effect import Site
    from pa10cal.terms.effects.effect import CandidateContext

    arm = load_arm("ur10")
    context = CandidateContext(
        arm=arm,
        flexible_joints=(2, 3),
        reference_temperature_C=21.0,
        tau_span_Nm=arm.torque_limit_Nm,
        T_instr_base=np.eye(4),
        p_instr_middle_m=np.zeros(3),
        q_span_rad=arm.limits_rad,
        time_span_s=(0.0, 3600.0),
    )
    terms = {term.id: term for term in candidates(context) if term.of not in ("joint 2", "joint 3")}
    assert {name for name, term in terms.items() if not term.generic} == set(vocabulary())
    rng = np.random.default_rng(0)
    for name, effect in vocabulary().items():
        term = terms[name]
        joint = int(term.of.removeprefix("joint ")) if term.of.startswith("joint") else 0
        rated_Nm = float(arm.torque_limit_Nm[joint - 1])
        site = Site(term.of, rated_Nm=rated_Nm, typical_Nm=1.0, coulomb_Nm=0.1 * rated_Nm)
        drawn = effect.at_size(site, effect.plausible_size, rng)
        first = np.abs(next(iter(drawn.values())))
        x = term.starts[-1].copy()
        x[0] = term.parameters[0].plausible
        plausible = abs(term.report(x).values[0])
        allowed = 0.75 if np.size(first) > 1 else 0.12
        assert first.max() == pytest.approx(plausible, rel=allowed), name


def test_wrong_statements_are_those_of_trackers():
    noise = draw_tracker_trials("wrong_noise", 6, 7)
    for trial in noise:
        factor = trial.settings.stated_uncertainty_mm / trial.settings.without_touches.position_mm
        assert 1.5 <= max(factor, 1.0 / factor) <= 4.0
    for trial in draw_tracker_trials("wrong_mass", 6, 7):
        masses = load_arm(trial.settings.robot).mass_kg
        assert len(trial.settings.mass_factor) == (0 if masses is None else len(masses))


def test_refuses_benches_at_which_an_effect_does_nothing():
    with pytest.raises(SettingsError, match="does nothing at any of the benches"):
        draw_tracker_trials("single", len(vocabulary()), 1, benches=["irb120-pose"])
    with pytest.raises(SettingsError, match="no such layout"):
        draw_tracker_trials("null", 1, 1, benches=["ur10-distance"])
    with pytest.raises(SettingsError, match="unknown kind of trial"):
        draw_tracker_trials("double", 1, 1)
    drawn = {name for name, each in all_effects().items() if each.drawn}
    assert set(nameless()) | set(vocabulary()) == drawn


@pytest.mark.parametrize("study", REFLECTORS)
def test_studies_without_attitudes_have_their_own_instrument_and_draws(study):
    trials = draw_tracker_trials("single", 6, 7, study)
    plans = [trial.settings.without_touches for trial in trials]
    kind, targets = {"points_one": ("points", 1), "points_three": ("points", 3)}.get(
        study, ("distance", 1)
    )
    assert {(plan.instrument, plan.target_count) for plan in plans} == {(kind, targets)}
    assert {trial.bench for trial in trials} <= set(STUDIES[study])
    others = [draw_tracker_trials("single", 6, 7, other) for other in REFLECTORS]
    assert len({trial.name for drawn in others for trial in drawn}) == 6 * len(REFLECTORS)
