"""Trials drawn at random: complete, reproducible, and such as the cell can measure."""

import json
from collections import Counter

import numpy as np
import pytest

from made_up_robot import nominal_of
from pa10cal.commands.command_line import run_command
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.disturbances import DISTURBANCES, disturb
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.vocabulary import (
    all_effects,
    make_effects,
    nameless,
    outside,
    places_of,
    vocabulary,
)
from pa10cal_lab.cell.options import CellPosesOptions, DisturbanceOptions, SimulateOptions
from pa10cal_lab.cell.poses import place_poses
from pa10cal_lab.cell.raw_log import RawLog
from pa10cal_lab.cell.scenario import TILT_SEEDS, TRACKED_POSES, Bench
from pa10cal_lab.cell.trials import (
    DRIVE_KINDS,
    KINDS,
    STUDIES,
    TOUCHED,
    WILD_BENCHES,
    WILD_KINDS,
    draw_trials,
    subjects_of,
    trial_counts,
)
from pa10cal_lab.cell.write import campaign_description
from pa10cal_lab.options import BlindTrialsOptions, TrialCounts, WildCounts

NOTHING_HIDDEN = ("null", "wrong_noise", "wrong_mass")
SHORT = {"repeats": 1, "loads_N": (0.0, 44.0), "holdout_points": 1, "holdout_repeats": 1}


def hidden(trial):
    return [(effect.id, effect.of) for effect in trial.settings.hidden_effects]


def all_kinds(count, seed=5):
    return [trial for kind in KINDS for trial in draw_trials(kind, count, seed)]


SEEDED = {"touched": KINDS, "tracked": KINDS, "wild": WILD_KINDS, "drives": DRIVE_KINDS}


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize(
    ("study", "kind"), [(study, kind) for study, kinds in SEEDED.items() for kind in kinds]
)
def test_the_same_seed_gives_the_same_trials_and_fewer_are_the_first_of_more(study, kind):
    trials = draw_trials(kind, 6, 1, study)
    assert draw_trials(kind, 6, 1, study) == trials
    assert draw_trials(kind, 4, 1, study) == trials[:4]
    assert draw_trials(kind, 2, 1, study, first=3) == trials[3:5]
    others = {trial.name for trial in draw_trials(kind, 6, 2, study)}
    assert not {trial.name for trial in trials} & others


def test_names_are_different_and_give_nothing_away():
    names = [trial.name for trial in all_kinds(20)]
    assert len(set(names)) == len(names)
    for word in (*KINDS, *all_effects()):
        assert not any(word in name for name in names)


def test_singles_go_through_the_whole_vocabulary_in_either_layout():
    trials = draw_trials("single", 2 * len(vocabulary()), 3)
    for layout in ("grid", "wide"):
        found = [t for t in trials if t.settings.poses.layout == layout]
        assert sorted(hidden(trial)[0][0] for trial in found) == sorted(vocabulary())
    assert all(len(trial.sizes) == 1 for trial in trials)


def test_outside_goes_through_what_has_no_name():
    assert [hidden(t)[0][0] for t in draw_trials("outside", len(outside()), 3)] == list(outside())


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("kind", "members"), [("pair", 2), ("triple", 3)])
def test_several_effects_are_never_the_same_at_the_same_place(kind, members):
    for trial in draw_trials(kind, 100, 4):
        assert len(set(hidden(trial))) == len(hidden(trial)) == len(trial.sizes) == members
        assert {id_ for id_, _ in hidden(trial)} <= set(vocabulary())


def test_sizes_are_even_in_their_logarithm_within_their_bounds():
    sizes = np.array([min(trial.sizes) for trial in draw_trials("single", 200, 6)])
    assert sizes.min() >= 0.1
    assert sizes.max() <= 3.0
    assert np.mean(sizes < np.sqrt(0.3)) == pytest.approx(0.5, abs=0.08)
    pairs = np.array([trial.sizes for trial in draw_trials("pair", 60, 6)])
    assert pairs.min() >= 0.7
    assert pairs.max() <= 3.0


def test_a_size_can_be_given_and_changes_nothing_else():
    every = len(vocabulary())
    small, large, drawn = (draw_trials("single", every, 7, size=size) for size in (0.5, 2.0, None))
    for trials in zip(small, large, drawn, strict=True):
        assert [min(trial.sizes) for trial in trials[:2]] == [0.5, 2.0]
        assert len({str(hidden(trial)) for trial in trials}) == 1
        one, two, _ = (
            next(iter(trial.settings.hidden_effects[0].parameters.values())) for trial in trials
        )
        fields = vocabulary()[hidden(trials[0])[0][0]].model_fields.values()
        stiffness = "stiffness" in next(iter(fields)).description
        assert two == pytest.approx((0.25 if stiffness else 4.0) * np.array(one))
        bare = [trial.settings.model_copy(update={"hidden_effects": ()}) for trial in trials]
        assert bare[0] == bare[1] == bare[2]


@pytest.mark.parametrize("kind", NOTHING_HIDDEN)
def test_nothing_is_hidden_where_only_a_statement_is_wrong(kind):
    for trial in draw_trials(kind, 30, 8):
        assert trial.settings.hidden_effects == ()
        assert trial.sizes == ()
        stated_mm, factor = trial.settings.stated_uncertainty_mm, trial.settings.mass_factor
        assert (stated_mm is not None) == (kind == "wrong_noise")
        assert (len(factor) == 6) == (kind == "wrong_mass")
        if stated_mm is not None:
            assert 1.5 <= max(stated_mm / 0.0121, 0.0121 / stated_mm) <= 4.0
        if factor:
            wrong = np.abs(np.array(factor) - 1.0)
            assert np.count_nonzero(wrong) == 1
            assert wrong[0] == 0.0
            assert 0.1 <= wrong.max() <= 0.3


def test_statements_are_wrong_both_ways():
    stated_mm = [t.settings.stated_uncertainty_mm for t in draw_trials("wrong_noise", 20, 9)]
    assert min(stated_mm) < 0.0121 < max(stated_mm)
    factors = np.array([t.settings.mass_factor for t in draw_trials("wrong_mass", 20, 9)])
    assert factors.min() < 1.0 < factors.max()


def test_temperature_drifts_where_it_must_and_in_a_third_of_the_rest():
    drifts = {True: [], False: []}
    for trial in draw_trials("single", 10 * len(vocabulary()), 10):
        grows = vocabulary()[hidden(trial)[0][0]].by_temperature
        drifts[grows].append(trial.settings.temperature_drift_C > 0.0)
    assert all(drifts[True])
    assert np.mean(drifts[False]) == pytest.approx(1 / 3, abs=0.08)


def test_robots_layouts_and_paths_vary():
    settings = [trial.settings for trial in draw_trials("null", 60, 11)]
    assert {one.built for one in settings} == {"drawn"}
    assert {one.path for one in settings} == {"same", "alternating"}
    assert [one.poses.layout for one in settings[:4]] == ["grid", "wide", "grid", "wide"]
    assert {one.repeats for one in settings} == {4, 10}
    assert len({one.random_seed for one in settings}) == 60
    assert len({one.poses.tilt_seed for one in settings}) > 30
    only = draw_trials("null", 5, 11, benches=("wide",))
    assert {trial.settings.poses.layout for trial in only} == {"wide"}


def test_every_place_of_a_trial_takes_its_effect(robot):
    rng = np.random.default_rng(0)
    scara = Bench("gx4_351s", "pose").built
    for name, effect in all_effects().items():
        one = scara if "sliding joint" in effect.places else robot
        places = places_of(effect.trial_places or effect.places, one, loaded=(2, 3, 4, 5))
        assert places
        for of in places:
            site = Site(of, rated_Nm=100.0, typical_Nm=30.0, coulomb_Nm=10.0, half_m=0.3)
            raw = {"id": name, "of": of, "parameters": effect.at_size(site, 1.0, rng)}
            settings = SimulateOptions(hidden_effects=(raw,))
            assert make_effects(settings.hidden_effects, one)[0].of == of


def test_a_drawn_error_map_is_no_single_harmonic():
    rng = np.random.default_rng(1)
    drawn = vocabulary()["joint_error_map"].at_size(Site("joint 1"), 1.0, rng)
    knots = np.array(drawn["knots"])
    assert np.degrees(np.abs(knots).max()) * 3600 == pytest.approx(30.0)
    power = np.abs(np.fft.rfft(knots)) ** 2
    assert power[1:4] / power.sum() == pytest.approx(np.full(3, 1 / 3), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["grid", "wide"])
def test_the_cell_measures_every_single_at_its_largest(arm, layout):
    for trial in draw_trials("single", len(vocabulary()), 12, benches=(layout,), size=3.0):
        campaign = simulate_campaign(trial.name, arm, trial.settings.model_copy(update=SHORT))
        assert [effect.id for effect in campaign.truth.effects] == [hidden(trial)[0][0]]
        assert np.isfinite(campaign.truth.rest.T_base_ee).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "single"])
def test_the_stage_writes_the_trials_of_the_other_kinds(tmp_path, kind):
    for trial in draw_trials(kind, 4, 13):
        raw = trial.settings.model_copy(update=SHORT).model_dump_json()
        out, truth = tmp_path / trial.name, tmp_path / f"{trial.name}.json"
        argv = ["--name", trial.name, "--settings", raw, "--out", str(out), "--truth", str(truth)]
        assert run_command("simulate", argv) == 0
        record = json.loads(truth.read_text())
        assert [(one["id"], one["of"]) for one in record["hidden_effects"]] == hidden(trial)
        text = (out / "campaign.yaml").read_text()
        assert not any(id_ in text for id_, _ in hidden(trial))


@pytest.mark.slow
def test_attitudes_of_the_grid_are_all_within_reach(arm, robot):
    nominal = nominal_of(robot)
    for seed in range(1, TILT_SEEDS["grid"] + 1):
        poses = place_poses(arm, nominal, CellPosesOptions(tilt_seed=seed), 10)
        assert len(poses.holdout) == 10


# Trackers: never twice in a pose, and effects where they do something.

SHORT_PLAN = {"poses": 20}
BENCHES = STUDIES["tracked"]
REFLECTORS = ("points_one", "points_three", "distance")


def test_no_pose_is_repeated_and_a_share_is_held_out():
    for trial in draw_trials("null", 6, 3, "tracked"):
        made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
        schedule = made.truth.schedule
        assert len(set(schedule.pose)) == len(schedule) == TRACKED_POSES
        assert np.mean(schedule.kind == "holdout") == pytest.approx(0.3)
        assert trial.settings.hidden_effects == ()


def test_benches_take_turns_and_singles_go_through_the_vocabulary():
    nulls = draw_trials("null", 2 * len(BENCHES), 4, "tracked")
    assert Counter(trial.bench for trial in nulls) == dict.fromkeys(BENCHES, 2)
    singles = draw_trials("single", 6 * len(vocabulary()), 4, "tracked")
    # A tracker has one scale, not three, and reads along beams, not along axes that are not square.
    of_machines = {"cmm_scale", "cmm_squareness"}
    names = [*({*vocabulary()} - of_machines), "scale", "range_constant"]
    assert Counter(hidden(trial)[0][0] for trial in singles) == dict.fromkeys(names, 6)
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
            for trial in draw_trials("single", 4 * len(vocabulary()), 5, "tracked")
            if hidden(trial)[0][0] == name
        ]
        for trial in trials:
            plan = trial.settings.without_touches
            assert plan.logs_torques
            assert int(hidden(trial)[0][1].removeprefix("joint ")) in plan.flexible_joints


def test_every_effect_does_something_where_it_is_put():
    singles = draw_trials("single", len(vocabulary()), 6, "tracked")
    for trial in (*singles, *draw_trials("outside", len(outside()), 6, "tracked")):
        settings = trial.settings
        plan = settings.without_touches.model_copy(update=SHORT_PLAN)
        short = settings.model_copy(update={"without_touches": plan})
        arm = load_arm(settings.robot)
        bare = short.model_copy(update={"hidden_effects": ()})
        made, plain = (simulate_campaign("x", arm, each).tables["poses"] for each in (short, bare))
        assert not made.equals(plain), hidden(trial)


def test_singles_have_the_size_that_the_vocabulary_holds_for_plausible():
    """The cell knows nothing of the vocabulary's terms: two statements, held together here."""
    arm = load_arm("ur10")
    context = CandidateContext(
        arm=arm,
        flexible_joints=(2, 3),
        reference_temperature_C=21.0,
        largest_tau_Nm=arm.torque_limit_Nm,
        p_instr_middle_m=np.zeros(3),
        q_span_rad=arm.limits_rad,
        time_span_s=(0.0, 3600.0),
    )
    # An axis that tilts is hidden as a soft bearing, of another form.
    every = [term for term in candidates(context) if term.role_in_search != "substitute"]
    terms = {term.id: term for term in every if term.of not in ("joint 2", "joint 3")}
    elsewhere = (
        "along_move",
        "depth_scale",
        "joint_coupling",
        "link_growth",
        "range_constant",
        "scale",
        "move_settling",
    )  # drawn by other studies
    apart = {name: all_effects()[name] for name in elsewhere}
    simulated = vocabulary() | apart
    assert {name for name, term in terms.items() if not term.generic} == set(simulated)
    rng = np.random.default_rng(0)
    for name, effect in simulated.items():
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
    noise = draw_trials("wrong_noise", 6, 7, "tracked")
    for trial in noise:
        factor = trial.settings.stated_uncertainty_mm / trial.settings.without_touches.position_mm
        assert 1.5 <= max(factor, 1.0 / factor) <= 4.0
    for trial in draw_trials("wrong_mass", 6, 7, "tracked"):
        masses = load_arm(trial.settings.robot).mass_kg
        assert masses is not None
        assert len(trial.settings.mass_factor) == len(masses)
    with pytest.raises(SettingsError, match="wrong_mass does nothing at any of the benches"):
        draw_trials("wrong_mass", 1, 7, "tracked", ("irb120-pose",))


def test_refuses_benches_at_which_an_effect_does_nothing():
    with pytest.raises(SettingsError, match="does nothing at any of the benches"):
        draw_trials("single", len(vocabulary()), 1, "tracked", ["irb120-pose"])
    with pytest.raises(SettingsError, match="--layouts: no such layout of poses"):
        draw_trials("null", 1, 1, "touched", ["ur10"])
    with pytest.raises(SettingsError, match=r"--layouts: no such bench .*allowed: ur10-pose"):
        draw_trials("null", 1, 1, "tracked", ["ur10-distance"])
    with pytest.raises(SettingsError, match=r"--layouts: no such bench .*allowed: ur10-1"):
        draw_trials("gear", 1, 1, "drives", ["ur10"])
    with pytest.raises(SettingsError, match=r"unknown kind of trial \(got 'double'\).*triple"):
        draw_trials("double", 1, 1, "tracked")
    with pytest.raises(SettingsError, match="--count: no trial to run"):
        draw_trials("null", 0, 1, first=3)
    drawn = {name for name, each in all_effects().items() if each.drawn}
    assert set(nameless()) | set(vocabulary()) == drawn


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_refuses_a_size_that_hides_nothing(size):
    with pytest.raises(SettingsError, match=r"--size: no size of an effect .*above 0"):
        draw_trials("single", 1, 1, "tracked", size=size)


@pytest.mark.parametrize(
    ("subject", "bench", "needed"),
    [
        ("transmission_error", "iiwa14-pose", "that has: geared joint; add"),
        ("friction_torque", "ur10-pose", "masses, logged torques, a spring in the joint; add"),
    ],
)
def test_tells_what_an_effect_needs_where_it_does_nothing(subject, bench, needed):
    with pytest.raises(SettingsError, match=f"{subject} does nothing .*{needed}"):
        draw_trials("single", 1, 1, "tracked", [bench], only=subject)


def test_refuses_a_study_or_a_subject_that_is_unknown():
    with pytest.raises(SettingsError, match=r"unknown study \(got 'tacked'\).*tracked"):
        draw_trials("single", 1, 1, "tacked")
    with pytest.raises(SettingsError, match=r"no such subject \(got 'rust'\).*backlash"):
        draw_trials("single", 1, 1, "tracked", only="rust")


@pytest.mark.parametrize("study", REFLECTORS)
def test_studies_without_attitudes_have_their_own_instrument_and_draws(study):
    trials = draw_trials("single", 6, 7, study)
    plans = [trial.settings.without_touches for trial in trials]
    kind, targets = {"points_one": ("points", 1), "points_three": ("points", 3)}.get(
        study, ("distance", 1)
    )
    assert {(plan.instrument, plan.target_count) for plan in plans} == {(kind, targets)}
    assert {trial.bench for trial in trials} <= set(STUDIES[study])
    others = [draw_trials("single", 6, 7, other) for other in REFLECTORS]
    assert len({trial.name for drawn in others for trial in drawn}) == 6 * len(REFLECTORS)


# Wild trials: stressors, faults and effects, at benches where they mean something.


def put_in(trial):
    return [entry.id for entry in trial.settings.disturbances]


def log_of(trial):
    made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
    return RawLog.of(campaign_description(made), made.tables, made.truth.robot.arm)


def test_benches_and_subjects_take_turns():
    count = 1 + len(WILD_BENCHES)
    right = Counter(trial.bench for trial in draw_trials("right", count, 3, "wild"))
    assert right == dict.fromkeys([*(bench.name for bench in WILD_BENCHES), TOUCHED], 1)
    for kind in ("stressed", "fault"):
        subjects = subjects_of(kind)
        trials = draw_trials(kind, len(subjects), 3, "wild")
        assert [put_in(trial)[0] for trial in trials] == list(subjects)
    assert set(subjects_of("stressed")) | set(subjects_of("fault")) == set(DISTURBANCES)


def test_the_turn_of_subjects_stays_for_it_decides_what_a_seed_draws() -> None:
    """A published rate belongs to trials of a seed: classes that change places draw others."""
    assert subjects_of("stressed") == (
        *("link_masses_off", "heavy_tails", "random_walk", "temperature_ramp", "misstated_noise"),
        *("one_uncertainty", "gross_errors", "level_off", "unknown_tool"),
    )
    assert subjects_of("fault") == (
        *("joint_zero", "joint_sign", "joints_exchanged", "direction_reversed", "attitudes"),
        *("jump", "labels_exchanged", "poses_exchanged", "loads_exchanged", "load_misstated"),
        *("held_out_reading_off", "one_reading_off", "log_cut", "unit", "uncertainty_off"),
        *("gravity", "payload_off", "payload_centre_off", "length_typo", "places_exchanged"),
    )


def test_an_effect_hides_among_a_stressor():
    for trial in draw_trials("effect", 12, 3, "wild"):
        assert len(trial.settings.hidden_effects) == len(put_in(trial)) == 1
    for trial in draw_trials("beyond", 12, 3, "wild"):
        assert len(trial.settings.hidden_effects) == 1
        assert not put_in(trial)


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_changes_the_raw_files_and_says_where(name):
    kind = "stressed" if DISTURBANCES[name].stressor else "fault"
    (trial,) = draw_trials(kind, 1, 5, "wild", only=name)
    clean, log = log_of(trial), log_of(trial)
    places = disturb(log, trial.settings.disturbances, trial.settings.random_seed)
    assert len(places) == 1
    assert places[0]
    changed = clean.description != log.description
    for key, table in clean.tables.items():
        changed = changed or not table.equals(log.tables[key])
    assert changed


NEAR = {"robot": "gx4_351s", "without_touches": {"poses": 8}}
EVERY = {"robot": "ur10", "without_touches": {"poses": 8, "holdout_every": 3, "clock": "none"}}


@pytest.mark.parametrize(
    ("campaign", "name", "parameters", "message"),
    [
        (NEAR, "joint_zero", {"joint": 3}, "no angle of this joint .*got 3.*q1_deg, q2_deg, q4"),
        (NEAR, "joint_sign", {"joint": 9}, "no angle of this joint"),
        (NEAR, "joints_exchanged", {"joint": 1}, "no angle of this joint"),
        (NEAR, "direction_reversed", {"joint": 1}, "does nothing .* a campaign with touches"),
        (NEAR, "labels_exchanged", {}, "a campaign with targets"),
        (NEAR, "places_exchanged", {}, "a campaign with stated_targets"),
        (EVERY, "held_out_reading_off", {}, "a campaign with held_out"),
        (EVERY, "heavy_tails", {"dof": 2.0}, "dof"),
        (EVERY, "one_reading_off", {}, None),
        (EVERY, "jump", {}, None),
    ],
)
def test_a_disturbance_that_is_not_possible_is_refused(campaign, name, parameters, message):
    settings = SimulateOptions.model_validate(campaign)
    entries = [DisturbanceOptions(id=name, parameters=parameters)]
    made = simulate_campaign("raw", load_arm(settings.robot), settings)
    log = RawLog.of(campaign_description(made), made.tables, made.truth.robot.arm)
    if message is None:
        assert disturb(log, entries, 1)
    else:
        with pytest.raises(SettingsError, match=message):
            disturb(log, entries, 1)


def test_repeats_run_in_the_order_of_the_settings():
    for trial in draw_trials("right", 30, 7, "wild", [bench.name for bench in WILD_BENCHES]):
        made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
        schedule, plan = made.truth.schedule, trial.settings.without_touches
        grid = schedule.kind == "grid"
        runs = schedule.pose[grid].reshape(plan.repeats, -1)
        assert np.array_equal(
            schedule.repeat[grid].reshape(runs.shape)[:, 0], 1 + np.arange(plan.repeats)
        )
        back = [not np.array_equal(run, runs[0]) for run in runs]
        if plan.order == "there_there_back_back":
            assert back == [False] * (plan.repeats // 2 + plan.repeats % 2) + [True] * (
                plan.repeats // 2
            )
        if plan.order == "there_and_back":
            assert back == [number % 2 == 1 for number in range(plan.repeats)]
        assert all(sorted(run) == sorted(runs[0]) for run in runs)


def test_refuses_what_wild_trials_do_not_know():
    with pytest.raises(SettingsError, match="unknown kind of trial"):
        draw_trials("tame", 1, 1, "wild")
    with pytest.raises(SettingsError, match="--only: no such subject"):
        draw_trials("fault", 1, 1, "wild", only="rust")
    with pytest.raises(SettingsError, match=r"no such subject \(got 'rust'\); allowed: nothing; "):
        draw_trials("right", 1, 1, "wild", only="rust")
    with pytest.raises(SettingsError, match="leave --only out"):
        draw_trials("null", 1, 1, "tracked", only="rust")
    with pytest.raises(SettingsError) as refused:
        draw_trials("sorted_rows", 1, 1, "wild", only="rust")
    assert str(refused.value).count("nothing") == 1
    with pytest.raises(SettingsError, match="does nothing at any of the benches"):
        draw_trials("fault", 1, 1, "wild", ["irb120-distance"], only="attitudes")
    (trial,) = draw_trials("right", 1, 1, "wild")
    with pytest.raises(SettingsError, match="unknown disturbance"):
        disturb(log_of(trial), (DisturbanceOptions(id="rust"),), 1)


# Numbers of blind trials.


def test_singles_and_effects_outside_count_their_rounds():
    full = trial_counts(TrialCounts(null=7, single=2, outside=3, pair=1))
    assert full["null"] == 7
    assert full["pair"] == 1
    assert full["single"] == 2 * len(vocabulary())
    assert full["outside"] == 3 * len(outside())


def test_rounds_of_wild_trials_go_through_what_the_cell_puts_in():
    wild = trial_counts(WildCounts(right=3, stressed=1, effect=1, beyond=1, fault=1))
    found = {kind: len(subjects_of(kind)) for kind in ("stressed", "beyond", "fault")}
    assert {kind: wild[kind] for kind in found} == found
    assert wild["right"] == 3
    # A trial more than subjects, as the frozen record of wild trials has.
    assert wild["effect"] == len(vocabulary()) == len(subjects_of("effect")) + 1


def test_the_studies_are_as_large_as_their_bars_need():
    options = BlindTrialsOptions()
    tracked = trial_counts(options.tracked)
    assert tracked["null"] >= 150
    assert tracked["single"] >= 150
    assert trial_counts(options.full)["single"] >= 380
    assert trial_counts(options.reduced)["single"] == len(vocabulary())
    assert sum(trial_counts(options.wild).values()) >= 300
    assert trial_counts(options.unstated) == {"unstated_masses": 210}
    assert trial_counts(options.sorted_by_joint)["sorted_rows"] >= 100  # none may go wrong
    assert trial_counts(options.mixed) == {"mixed": 300}
