"""Wild trials: campaigns of any arm and instrument, with what ordinary logs have, and with faults.

Kinds of `trials` hide effects in logs that are otherwise in order. These put stressors and faults
into the raw files besides (`lab/cell/disturbances.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np

from pa10cal.lab.cell.disturbances import DISTURBANCES, Disturbance, Need
from pa10cal.lab.cell.effects.effect import Effect, TorqueLogEffect
from pa10cal.lab.cell.effects.vocabulary import nameless, outside, vocabulary
from pa10cal.lab.cell.measured_trials import (
    SUBJECTS,
    draw_measured_trial,
    measured_benches,
)
from pa10cal.lab.cell.options import SimulateOptions
from pa10cal.lab.cell.trials import (
    ATTITUDE_RAD,
    COULOMB_NM,
    DRIFTING,
    OTHER_SIZES,
    POSITION_MM,
    SECONDS_A_POSE,
    STUDIES,
    TOOL_KG,
    TRACKED_DRIFT_C,
    Bench,
    Scenario,
    Trial,
    TrialKind,
    draw_trials,
    hideable,
    idle,
    log_uniform,
    refuse_unless,
)
from pa10cal.observe.kinds import sees_several
from pa10cal.settings_reading import parse_section

#: `right`: nothing wrong; `stressed`: a stressor, nothing hidden; `effect`: one effect of the
#: vocabulary at its plausible size, among a stressor or a joint zero that is off; `beyond`: one
#: that has no name; `fault`: an error in the log, nothing hidden; the others: `measured_trials`.
WildKind = Literal[
    "right", "stressed", "effect", "beyond", "fault", "unstated_masses", "sorted_rows"
]
WILD_KINDS: tuple[WildKind, ...] = get_args(WildKind)
_FIRST_SEED = 900  #: apart from those of the other trials

#: Arms under instruments that do not touch; every joint gives way where masses are described.
WILD_BENCHES = tuple(
    Bench(robot, instrument, tuple(range(1, joints + 1)), logs_torques=joints > 0)
    for instrument in ("pose", "points", "distance")
    for robot, joints in (("ur10", 6), ("irb120", 0), ("iiwa14", 7))
)
#: Repeats of every calibration pose, in turn, with the calibration poses of each.
POSES_BY_REPEATS = {1: 240, 4: 48, 8: 36}
#: One distance a pose needs more of them.
DISTANCE_POSES_BY_REPEATS = {1: 300, 4: 100, 8: 80}
#: Held-out poses of a campaign with repeats, and their part of the others in one without.
HELD_OUT = 16
HELD_OUT_SHARE = 0.2
#: Orders of the poses in the repeats.
ORDERS = ("same", "there_and_back", "there_there_back_back", "shuffled")
#: Links about their motors, from reading to reading [rad].
UNSEEN_RAD = 1e-5
#: Part of the campaigns with loads, of arms with masses, and the loads.
LOADED = 0.3
LOADS_N = (0.0, 44.0)
#: Among what an effect must be found, besides the stressors of every log.
ALSO_AMONG = ("joint_zero",)
#: The PA10 under touched balls; its wide layout is shorter than that of other trials.
TOUCHED = "pa10-touched"
_TOUCHED_POSES = 40
_BENCHES = {**{bench.name: bench for bench in WILD_BENCHES}, TOUCHED: STUDIES["touched"]["wide"]}
#: Friction of the joint whose direction is reversed in the log; else nothing shows it [N m].
FRICTION_NM = 4.0
#: What the calibrated model of these arms has already.
_IN_EVERY_MODEL = ("joint_compliance",)
_NOTHING = "nothing"
_TRIES = 2000
_UNKNOWN = "no such thing in wild trials"


def draw_wild_trials(
    kind: WildKind, count: int, random_seed: int, benches: Sequence[str] = (), only: str = ""
) -> tuple[Trial, ...]:
    """Draw wild trials of one kind; the same arguments give the same trials.

    What is put in takes turns; where it means anything, bench, repeats, order, loads and whether
    torques are logged are drawn. Trials of a smaller count are the first of a larger one.

    Args:
        benches: `ur10-pose` and so on, or `pa10-touched`; none for all.
        only: one disturbance or effect, or another subject; empty for all in turn.

    Raises:
        SettingsError: for a kind, a bench, a disturbance or an effect that does not exist, or one
            that means nothing at any of the benches.
    """
    refuse_unless(kind, WILD_KINDS, "kind", _UNKNOWN)
    measured = kind in SUBJECTS
    known = (*measured_benches(),) if measured else (*_BENCHES,)
    for bench in benches:
        refuse_unless(bench, known, "benches", _UNKNOWN)
    subjects = subjects_of(kind)
    if only:
        refuse_unless(only, subjects, "only", _UNKNOWN)
        subjects = (only,)
    draw = draw_measured_trial if measured else _drawn
    trials = []
    for number in range(count):
        rng = np.random.default_rng([random_seed, _FIRST_SEED + WILD_KINDS.index(kind), number])
        subject = subjects[number % len(subjects)]
        trials.append(draw(kind, number, subject, benches or known, rng))
    return tuple(trials)


def subjects_of(kind: WildKind) -> tuple[str, ...]:
    """Return the disturbances or effects that trials of a kind go through in turn."""
    every = DISTURBANCES.items()
    return {
        "right": (_NOTHING,),
        "stressed": tuple(name for name, each in every if each.stressor),
        "effect": tuple(name for name in vocabulary() if name not in _IN_EVERY_MODEL),
        "beyond": tuple(nameless()),
        "fault": tuple(name for name, each in every if not each.stressor),
        **SUBJECTS,
    }[kind]


def _drawn_use(bench: Bench, rng: np.random.Generator) -> dict[str, Any]:
    """Draw how a bench is used, as `without_touches` holds it."""
    repeats = int(rng.choice(list(POSES_BY_REPEATS)))
    loads_N = LOADS_N if rng.random() < LOADED else LOADS_N[:1]
    logs_torques, targets = bool(rng.random() < 0.5), int(rng.choice([1, 2, 3]))
    if bench.touched:
        return {"repeats": 4, "loads_N": LOADS_N, "logs_torques": True, "targets": 3}
    has_masses = bench.arm.mass_kg is not None
    return {
        "repeats": repeats,
        "loads_N": loads_N if has_masses else LOADS_N[:1],
        "logs_torques": logs_torques and has_masses,
        "targets": targets if sees_several(bench.instrument) else 1,
    }


def _has(bench: Bench, use: Mapping[str, Any]) -> dict[Need, bool]:
    """Return which needs of disturbances a bench meets that is used so."""
    return {
        "loads": len(use["loads_N"]) > 1,
        "masses": bench.arm.mass_kg is not None,
        "springs": bench.touched or bool(bench.flexible_joints),
        "repeats": use["repeats"] > 1,
        "touches": bench.touched,
        "tracker": not bench.touched,
        "attitude": bench.instrument == "pose",
        "targets": use["targets"] > 1,
    }


def _hides(bench: Bench, use: Mapping[str, Any], effect: type[Effect]) -> bool:
    """Return whether an effect does something at a bench that is used so."""
    if bench.touched:
        return not effect.wild
    unlogged = issubclass(effect, TorqueLogEffect) and not use["logs_torques"]
    return not unlogged and bool(bench.places(effect))


def _drawn(
    kind: WildKind, number: int, subject: str, benches: Sequence[str], rng: np.random.Generator
) -> Trial:
    """Draw a trial that puts in a subject, at a bench where that means anything."""
    every = DISTURBANCES
    effect = {**vocabulary(), **nameless()}.get(subject)
    put = [every[subject]] if subject in every else []
    stressors = [*subjects_of("stressed"), *ALSO_AMONG]
    for attempt in range(_TRIES):
        turn = number + number // len(subjects_of(kind)) + attempt // 100
        among = [every[stressors[turn % len(stressors)]]] if kind == "effect" else []
        name = benches[number % len(benches)] if kind == "right" else str(rng.choice(benches))
        bench = _BENCHES[name]
        use = _drawn_use(bench, rng)
        has = _has(bench, use)
        fits = all(has[need] for each in (*put, *among) for need in each.needs)
        if fits and (effect is None or _hides(bench, use, effect)):
            if bench.touched:
                return _touched(kind, effect, (*put, *among), rng)
            scenario = Scenario(kind, number, rng, bench, int(rng.integers(2**31)))
            return _tracked(scenario, use, effect, (*put, *among))
    raise idle(subject, benches, "benches with what it needs among them")


def _tracked(
    scenario: Scenario,
    use: Mapping[str, Any],
    effect: type[Effect] | None,
    put: Sequence[Disturbance],
) -> Trial:
    """Draw the campaign of a tracker."""
    kind, rng, bench = scenario.kind, scenario.rng, scenario.bench
    of_distance = bench.instrument == "distance"
    repeats = use["repeats"]
    poses = (DISTANCE_POSES_BY_REPEATS if of_distance else POSES_BY_REPEATS)[repeats]
    held_out = round(poses * HELD_OUT_SHARE) if repeats == 1 else HELD_OUT
    scenario.settings["without_touches"] = {
        **bench.plan,
        **use,
        "poses": poses + held_out,
        "holdout_share": held_out / (poses + held_out),
        "order": str(rng.choice(ORDERS)) if repeats > 1 else "same",
        "by_first_joint": any(each.id == "temperature_ramp" for each in put),
        "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
        "tool_mass_kg": round(log_uniform(TOOL_KG, rng), 3),
        "unseen_rad": UNSEEN_RAD,
        "position_mm": round(log_uniform(POSITION_MM, rng), 4),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    scenario.settings["disturbances"] = _parameters(put, bench.arm.n, rng)
    if effect is not None:
        of = str(rng.choice(bench.places(effect)))
        size = effect.plausible_size if kind == "effect" else log_uniform(OTHER_SIZES, rng)
        scenario.hide(effect, size, bench.site(of, scenario.robot))
    by_temperature = any(each.by_temperature for each in scenario.effects)
    warms = by_temperature or (kind == "right" and rng.random() < DRIFTING)
    scenario.settings["temperature_drift_C"] = TRACKED_DRIFT_C if warms else 0.0
    return scenario.trial("wild")


def _touched(
    kind: WildKind,
    effect: type[Effect] | None,
    put: Sequence[Disturbance],
    rng: np.random.Generator,
) -> Trial:
    """Draw the campaign of touched balls: one of the other trials, shorter and disturbed."""
    seed = int(rng.integers(2**31))
    disturbances = _parameters(put, len(COULOMB_NM), rng)
    base_kind: TrialKind = "null" if effect is None else "single" if effect.named else "outside"
    place = list(hideable(base_kind)).index(effect.id) if effect is not None else 0
    size = None if effect is None or not effect.named else effect.plausible_size
    drawn = draw_trials(base_kind, place + 1, seed, benches=["wide"], size=size)[place]
    hidden = [entry.model_dump() for entry in drawn.settings.hidden_effects]
    for entry in disturbances:
        if entry["id"] == "direction_reversed":
            of, amount = f"joint {entry['parameters']['joint']}", {"tau_c": FRICTION_NM}
            hidden.append({"id": "friction_torque", "of": of, "parameters": amount})
    raw = drawn.settings.model_dump(exclude={"without_touches"}) | {
        "random_seed": seed,
        "disturbances": disturbances,
        "hidden_effects": hidden,
        "loads_N": (0.0, 22.0, 44.0),
    }
    raw["poses"] |= {"wide_poses": _TOUCHED_POSES}
    settings = parse_section(SimulateOptions, raw, where=drawn.name)
    sizes = drawn.sizes + (1.0,) * (len(hidden) - len(drawn.sizes))
    return Trial(f"wild-{seed:08x}", kind, TOUCHED, settings, sizes)


def _parameters(
    put: Sequence[Disturbance], joints: int, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Draw the parameters of disturbances, for an arm of so many joints."""
    return [{"id": each.id, "parameters": each.drawn(joints, rng)} for each in put]


def trial_counts(counts: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Return the number of trials of each kind, for Snakemake to divide into jobs.

    Args:
        counts: kinds and their numbers, as in the settings: rounds, of kinds that go through
            effects or disturbances in turn.
    """
    rounds = {
        "single": len(vocabulary()),
        "outside": len(outside()),
        "effect": len(vocabulary()),
        "stressed": len(subjects_of("stressed")),
        "beyond": len(subjects_of("beyond")),
        "fault": len(subjects_of("fault")),
    }
    return {kind: number * rounds.get(kind, 1) for kind, number in counts}
