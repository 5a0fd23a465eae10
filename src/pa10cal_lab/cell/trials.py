"""Trials: simulated campaigns, drawn at random with hidden effects, that test verdicts.

Every trial is a `Scenario` while it is drawn. Trials of this module: the PA10 under touched balls
with repeats; arms under trackers without repeats; wild ones, whose logs have ordinary imperfections
and faults (`disturbances`); and drives with erroneous sensors or gears. Trials that resemble
campaigns of measured robots are in `measured_trials`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.errors import SettingsError
from pa10cal.observe.kinds import sees_several
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell.disturbances import DISTURBANCES, Disturbance
from pa10cal_lab.cell.effects.effect import SimulatedEffect, Site, TorqueLogEffect
from pa10cal_lab.cell.effects.joint import drawn_cogs, drawn_ratio
from pa10cal_lab.cell.effects.vocabulary import all_effects, nameless, outside, vocabulary
from pa10cal_lab.cell.instruments.touch_trigger_cmm import UNCERTAINTY_MM
from pa10cal_lab.cell.measured_trials import SUBJECTS, draw_measured, measured_benches
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import joint_bounds
from pa10cal_lab.cell.raw_log import Need
from pa10cal_lab.cell.scenario import (
    ATTITUDE_RAD,
    DISTANCE_POSES,
    DRIFTING,
    LAYOUTS,
    OTHER_SIZES,
    POSITION_MM,
    SECONDS_A_POSE,
    SINGLE_SIZES,
    TOOL_KG,
    TRACKED_DRIFT_C,
    TRACKED_POSES,
    Bench,
    Scenario,
    TouchedBench,
    Trial,
    idle,
    log_uniform,
    trial_places,
)

#: `null`: nothing hidden; `single`, `pair`, `triple`: one to three effects of the vocabulary;
#: `outside`: one effect that is not in it; `wrong_noise`, `wrong_mass`: no effect, but the campaign
#: states a wrong uncertainty, or the mass of a link differs from the arm's description.
KINDS = ("null", "single", "pair", "triple", "outside", "wrong_noise", "wrong_mass")
#: `right`: nothing wrong; `stressed`: a stressor and no effect; `effect`: one effect of the
#: vocabulary at its plausible size, with a stressor or a wrong joint zero; `beyond`: one effect
#: without a name; `fault`: an error in the log and no effect; the others: `measured_trials`.
WILD_KINDS = ("right", "stressed", "effect", "beyond", "fault", *SUBJECTS)
#: The erroneous part of a drive. With `neither` motors have ripple all the same.
DRIVE_KINDS = ("sensor", "gear", "both", "neither")


def _named(benches: Iterable[Bench]) -> dict[str, Bench]:
    return {bench.name: bench for bench in benches}


def _benches(
    instrument: str, targets: int | None = None, poses: int = TRACKED_POSES
) -> tuple[Bench, ...]:
    """Return the arms of the trials under an instrument."""
    return (
        Bench("ur10", instrument, (2, 3), targets=targets, poses=poses),
        Bench("irb120", instrument, targets=targets, poses=poses),
        Bench("iiwa14", instrument, (2, 4), logs_torques=True, targets=targets, poses=poses),
    )


#: The PA10 under touched balls, with fewer poses than in the study of touched balls.
TOUCHED = "pa10-touched"
#: Arms under trackers; every joint is flexible where masses are described.
WILD_BENCHES = tuple(
    Bench(robot, instrument, tuple(range(1, joints + 1)), logs_torques=joints > 0)
    for instrument in ("pose", "points", "distance")
    for robot, joints in (("ur10", 6), ("irb120", 0), ("iiwa14", 7))
)
#: An error that is periodic in the joint repeats from turn to turn, in arms whose joints turn more
#: than once (ur10; joint 6 of irb120), and in all arms from campaign to campaign, if there are two.
DRIVE_BENCHES = (
    Bench("ur10", "pose", (2, 3), campaigns=1),
    Bench("iiwa14", "pose", (2, 4), campaigns=2),
    Bench("ur10", "pose", (2, 3), campaigns=2),
    Bench("irb120", "pose", campaigns=2),
)
#: Benches of each study by their names. `points_one` to `distance` measure no orientations, as most
#: laboratories. A distance is one number a pose, so that more poses are needed.
STUDIES: dict[str, dict[str, Bench]] = {
    "touched": _named(TouchedBench(layout=layout) for layout in LAYOUTS),
    "tracked": _named((*_benches("pose"), *_benches("points"))),
    "points_one": _named(_benches("points", targets=1)),
    "points_three": _named(_benches("points", targets=3)),
    "distance": _named(_benches("distance", poses=DISTANCE_POSES)),
    "drives": _named(DRIVE_BENCHES),
}
STUDIES["wild"] = {**_named(WILD_BENCHES), TOUCHED: STUDIES["touched"]["wide"]}
_KINDS_OF = {"wild": WILD_KINDS, "drives": DRIVE_KINDS}
#: Subjects of trials of a kind that has none.
_NO_SUBJECTS = ("",)
#: Number of the random stream of the first kind of each study; the next kinds have the next ones.
_STREAMS = {
    **{"touched": 0, "tracked": 7, "points_one": 107, "points_three": 207, "distance": 307},
    **{"drives": 700, "wild": 900},
}


def draw_trials(
    kind: str,
    count: int,
    random_seed: int,
    study: str = "touched",
    benches: Iterable[str] = (),
    *,
    first: int = 0,
    size: float | None = None,
    only: str = "",
) -> tuple[Trial, ...]:
    """Draw trials of one kind; the same arguments and number give the same trial.

    Every trial has a robot, poses and noise of its own. Kinds with subjects go through these in
    turn: through effects (`single`, `outside`) at the benches where they act, or through effects,
    disturbances and others at a bench that is drawn (wild trials). For other kinds benches take
    turns. Single effects under trackers have their plausible size.

    Args:
        study: of `STUDIES`; each has its own random streams.
        benches: names of those to use, in this order; empty for all of the study.
        first: number of the first trial.
        size: factor of the usual size of all effects; None draws it. It changes nothing else, and
            is not used by wild trials and drives.
        only: for wild trials the one subject to draw; empty for all in turn.

    Raises:
        SettingsError: for a count below one, a negative number or seed, a size that is not above
            zero; for an unknown study, kind, bench or subject; or for one that does nothing at any
            of the benches.
    """
    if count < 1:
        _refuse("no trial to run", "--count", count, ["1 or more"], "request more trials")
    for option, number in (("--first", first), ("--random-seed", random_seed)):
        if number < 0:
            _refuse("it is negative", option, number, ["0 or more"], "give another number")
    if size is not None and not 0.0 < size < np.inf:
        _refuse("no size of an effect", "--size", size, ["above 0"], "give another number")
    chosen, subjects = _checked(study, kind, tuple(benches), only)
    draw: Callable[..., Trial] = partial(_draw_hidden, size=size)
    if kind in SUBJECTS:
        draw = draw_measured
    elif study in ("wild", "drives"):
        draw = _draw_wild if study == "wild" else _draw_drives
    stream = _STREAMS[study] + _kinds_of(study).index(kind)
    return tuple(
        draw(
            kind,
            number,
            subjects[number % len(subjects)],
            chosen,
            np.random.default_rng([random_seed, stream, number]),
        )
        for number in range(first, first + count)
    )


def _kinds_of(study: str) -> tuple[str, ...]:
    """Return the kinds of a study's trials."""
    return _KINDS_OF.get(study, KINDS)


def _checked(
    study: str, kind: str, names: Sequence[str], only: str
) -> tuple[dict[str, Bench], tuple[str, ...]]:
    """Return the benches and the subjects of trials; refuse names that the study does not have.

    Args:
        study: of `STUDIES`.
        kind: of the study.
        names: of the benches; empty for all.
        only: the one subject; empty for all.
    """
    if study not in STUDIES:
        _refuse("unknown study", "study", study, STUDIES)
    if kind not in _kinds_of(study):
        _refuse("unknown kind of trial", "kind", kind, _kinds_of(study))
    known = measured_benches() if kind in SUBJECTS else STUDIES[study]
    for name in names:
        if name not in known:
            what = "no such layout of poses" if study == "touched" else "no such bench"
            _refuse(what, "--benches" if study == "wild" else "--layouts", name, known)
    subjects = subjects_of(kind)
    if only and only not in subjects:
        if subjects == _NO_SUBJECTS:
            what = f"trials of kind {kind} have no subjects"
            _refuse(what, "--only", only, ["no subject"], "leave --only out")
        _refuse("no such subject", "--only", only, dict.fromkeys(subjects))
    return {name: known[name] for name in names or known}, (only,) if only else subjects


def _refuse(
    what: str, where: str, value: object, allowed: Iterable[str], remedy: str = "name one of these"
) -> NoReturn:
    raise SettingsError(what, where=where, value=value, allowed=", ".join(allowed), remedy=remedy)


def subjects_of(kind: str) -> tuple[str, ...]:
    """Return the subjects that trials of a kind go through in turn; one empty text for none."""
    every = DISTURBANCES.items()
    known = {
        "single": tuple(vocabulary()),
        "outside": tuple(outside()),
        "right": ("nothing",),
        "stressed": tuple(name for name, each in every if each.stressor),
        "effect": tuple(name for name, each in vocabulary().items() if not each.in_every_model),
        "beyond": tuple(nameless()),
        "fault": tuple(name for name, each in every if not each.stressor),
        **SUBJECTS,
    }
    return known.get(kind, _NO_SUBJECTS)


def trial_counts(counts: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Return the number of trials of each kind, for Snakemake to divide into jobs.

    A round of `effect` has a trial more than subjects, of which the first begins the next round:
    the frozen record of wild trials has so many.

    Args:
        counts: kinds and their numbers, as in the settings: for kinds that go through subjects
            the number of rounds.
    """
    in_turn = ("single", "outside", "stressed", "beyond", "fault")
    rounds = {kind: len(subjects_of(kind)) for kind in in_turn}
    rounds["effect"] = len(subjects_of("effect")) + 1
    return {kind: number * rounds.get(kind, 1) for kind, number in counts}


# Effects hidden in logs that are otherwise in order.

#: Number of effects that a kind hides.
_MEMBERS: Mapping[str, int] = {"single": 1, "outside": 1, "pair": 2, "triple": 3}
#: Factor, up or down, of a wrongly stated uncertainty.
_NOISE_FACTORS = (1.5, 4.0)
#: Relative error, up or down, of the mass of one link but the first, which loads no joint.
_MASS_EXCESS = (0.1, 0.3)


def _draw_hidden(
    kind: str,
    number: int,
    subject: str,
    benches: Mapping[str, Bench],
    rng: np.random.Generator,
    *,
    size: float | None = None,
) -> Trial:
    """Draw a trial that hides a subject or effects of the vocabulary, or has a wrong statement.

    A wrong mass needs an arm whose masses are stated: other benches are passed over.
    """
    effects = outside() if kind == "outside" else vocabulary()
    bench = _bench_in_turn(kind, number, subject, benches, effects)
    scenario = Scenario(kind, rng, bench, int(rng.integers(2**31)))
    drifts, plan = bench.drawn_plan(rng)
    scenario.settings |= plan
    names = [name for name, effect in effects.items() if bench.places(effect)]
    while len(scenario.hidden) < _MEMBERS.get(kind, 0):
        effect = effects[subject or str(rng.choice(names))]
        drawn_size = effect.plausible_size
        if kind != "single" or bench.touched:
            drawn_size = log_uniform(SINGLE_SIZES if kind == "single" else OTHER_SIZES, rng)
        scenario.hide(effect, drawn_size if size is None else size)
    uncertainty_mm = UNCERTAINTY_MM
    if not bench.touched:
        measurement = scenario.settings["without_touches"]
        # An effect of the log of torques is hidden in a log. The robot does not depend on it.
        measurement["logs_torques"] |= any(issubclass(e, TorqueLogEffect) for e in scenario.effects)
        uncertainty_mm = measurement["position_mm"]
    warms = drifts or any(effect.by_temperature for effect in scenario.effects)
    scenario.settings["temperature_drift_C"] = bench.drift_C if warms else 0.0
    scenario.settings |= _wrong_statement(kind, uncertainty_mm, bench.arm, rng)
    return scenario.trial()


def _bench_in_turn(
    kind: str,
    number: int,
    subject: str,
    benches: Mapping[str, Bench],
    effects: Mapping[str, type[SimulatedEffect]],
) -> Bench:
    """Return the bench of a trial: those at which its subject acts take turns."""
    every = list(benches.values())
    if not subject:
        fit = [b for b in every if kind != "wrong_mass" or b.arm.mass_kg is not None]
        if not fit:
            raise idle(kind, benches, "an arm with masses among them")
        return fit[number % len(fit)]
    fit = [bench for bench in every if bench.places(effects[subject])]
    if not fit:
        raise idle(subject, benches, _needed_by(effects[subject]))
    turn, place = divmod(number, len(effects))
    # Layouts of touched balls take turns from effect to effect as well.
    return fit[(turn + place if fit[0].touched else turn) % len(fit)]


def _needed_by(effect: type[SimulatedEffect]) -> str:
    """Return what a bench needs for an effect to act there, in words."""
    needs = {
        " or ".join(trial_places(effect)): True,
        "stated masses": effect.by_weights,
        "logged torques": issubclass(effect, TorqueLogEffect),
        "a spring in the joint": effect.by_spring,
    }
    return f"a bench among them that has: {', '.join(need for need in needs if needs[need])}"


def _wrong_statement(
    kind: str, uncertainty_mm: float, arm: Arm, rng: np.random.Generator
) -> dict[str, Any]:
    """Draw the settings of a wrong uncertainty or a wrong mass; none for other kinds."""
    sign = float(rng.choice([-1.0, 1.0]))
    if kind == "wrong_noise":
        factor = float(np.exp(sign * rng.uniform(*np.log(_NOISE_FACTORS))))
        return {"stated_uncertainty_mm": uncertainty_mm * factor}
    if kind == "wrong_mass":
        factors = np.ones(arm.n)
        factors[rng.integers(1, arm.n)] += sign * rng.uniform(*_MASS_EXCESS)
        return {"mass_factor": factors.tolist()}
    return {}


# Wild trials: any arm and instrument, with what ordinary logs have, and with faults.

#: Number of calibration poses, by the number of repeats of each: more for distances, which are one
#: number a pose.
_POSES_BY_REPEATS = {1: 240, 4: 48, 8: 36}
_DISTANCE_POSES_BY_REPEATS = {1: 300, 4: 100, 8: 80}
#: Number of held-out poses of a campaign with repeats; share of the calibration poses without.
_HELD_OUT, _HELD_OUT_SHARE = 16, 0.2
#: Orders of the poses in the repeats.
_ORDERS = ("same", "there_and_back", "there_there_back_back", "shuffled")
#: Scatter of links about their motors, from reading to reading [rad].
_UNSEEN_RAD = 1e-5
#: Share of the campaigns that have loads, if the arm has masses; and the loads.
_LOADED, _LOADS_N = 0.3, (0.0, 44.0)
#: Disturbances among which an effect has to be found, besides the stressors.
_ALSO_AMONG = ("joint_zero",)
#: Number of poses of touched balls.
_TOUCHED_POSES = 40
#: Friction of the joint whose direction is reversed in the log, without which that has no effect
#: [N m].
_FRICTION_NM = 4.0
#: Largest number of benches that are drawn until a trial is possible; and for one stressor, before
#: the next takes its place.
_TRIES, _TRIES_A_STRESSOR = 2000, 100


def _draw_wild(
    kind: str, number: int, subject: str, benches: Mapping[str, Bench], rng: np.random.Generator
) -> Trial:
    """Draw a trial of a subject at a bench where it has an effect."""
    names = list(benches)
    effect = {**vocabulary(), **nameless()}.get(subject)
    stressors = [*subjects_of("stressed"), *_ALSO_AMONG]
    for attempt in range(_TRIES):
        put_in = [DISTURBANCES[subject]] if subject in DISTURBANCES else []
        if kind == "effect":
            turn = number + number // len(subjects_of(kind)) + attempt // _TRIES_A_STRESSOR
            put_in.append(DISTURBANCES[stressors[turn % len(stressors)]])
        name = names[number % len(names)] if kind == "right" else str(rng.choice(names))
        bench = benches[name]
        use = _drawn_use(bench, rng)
        meets = _needs_met(bench, use)
        possible = all(meets[need] for disturbance in put_in for need in disturbance.needs)
        if possible and (effect is None or _acts(bench, use, effect)):
            scenario = Scenario(kind, rng, bench, int(rng.integers(2**31)))
            if bench.touched:
                return _wild_touched(scenario, effect, put_in)
            return _wild_tracked(scenario, use, effect, put_in)
    raise idle(subject, names, "benches with what it needs among them")


def _drawn_use(bench: Bench, rng: np.random.Generator) -> dict[str, Any]:
    """Draw repeats, loads, torques and targets at a bench, as keys of `without_touches`."""
    repeats = int(rng.choice(list(_POSES_BY_REPEATS)))
    loads_N = _LOADS_N if rng.random() < _LOADED else _LOADS_N[:1]
    logs_torques, targets = bool(rng.random() < 0.5), int(rng.choice([1, 2, 3]))
    if bench.touched:
        return {"repeats": 4, "loads_N": _LOADS_N, "logs_torques": True, "targets": 3}
    has_masses = bench.arm.mass_kg is not None
    return {
        "repeats": repeats,
        "loads_N": loads_N if has_masses else _LOADS_N[:1],
        "logs_torques": logs_torques and has_masses,
        "targets": targets if sees_several(bench.instrument) else 1,
    }


def _needs_met(bench: Bench, use: Mapping[str, Any]) -> dict[Need, bool]:
    """Return which needs of disturbances a bench meets in a use."""
    return {
        "loads": len(use["loads_N"]) > 1,
        "masses": bench.arm.mass_kg is not None,
        "springs": bench.touched or bool(bench.flexible_joints),
        "repeats": use["repeats"] > 1,
        "held_out": True,
        "touches": bench.touched,
        "tracker": not bench.touched,
        "attitude": bench.instrument == "pose",
        "targets": use["targets"] > 1,
        "stated_targets": use["targets"] > 1,
    }


def _acts(bench: Bench, use: Mapping[str, Any], effect: type[SimulatedEffect]) -> bool:
    """Return whether an effect acts at a bench in a use."""
    if bench.touched:
        return not effect.wild
    unlogged = issubclass(effect, TorqueLogEffect) and not use["logs_torques"]
    return not unlogged and bool(bench.places(effect))


def _wild_tracked(
    scenario: Scenario,
    use: Mapping[str, Any],
    effect: type[SimulatedEffect] | None,
    put_in: Sequence[Disturbance],
) -> Trial:
    """Draw the campaign of a tracker."""
    kind, rng, bench = scenario.kind, scenario.rng, scenario.bench
    of_distance, repeats = bench.instrument == "distance", use["repeats"]
    poses = (_DISTANCE_POSES_BY_REPEATS if of_distance else _POSES_BY_REPEATS)[repeats]
    held_out = round(poses * _HELD_OUT_SHARE) if repeats == 1 else _HELD_OUT
    scenario.settings["without_touches"] = {
        **bench.plan,
        **use,
        "poses": poses + held_out,
        "holdout_share": held_out / (poses + held_out),
        "order": str(rng.choice(_ORDERS)) if repeats > 1 else "same",
        "by_first_joint": any(each.id == "temperature_ramp" for each in put_in),
        "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
        "tool_mass_kg": round(log_uniform(TOOL_KG, rng), 3),
        "unseen_rad": _UNSEEN_RAD,
        "position_mm": round(log_uniform(POSITION_MM, rng), 4),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    scenario.settings["disturbances"] = _entries(put_in, scenario)
    if effect is not None:
        of = str(rng.choice(bench.places(effect)))
        size = effect.plausible_size if kind == "effect" else log_uniform(OTHER_SIZES, rng)
        scenario.hide(effect, size, bench.site(of, scenario.robot))
    by_temperature = any(each.by_temperature for each in scenario.effects)
    warms = by_temperature or (kind == "right" and rng.random() < DRIFTING)
    scenario.settings["temperature_drift_C"] = TRACKED_DRIFT_C if warms else 0.0
    return scenario.trial("wild")


def _wild_touched(
    scenario: Scenario, effect: type[SimulatedEffect] | None, put_in: Sequence[Disturbance]
) -> Trial:
    """Draw the campaign of touched balls: one of the touched study, with disturbances in its log.

    Its seed, disturbances, loads and number of poses are those below, and a joint whose direction
    is reversed gets friction.
    """
    disturbances = _entries(put_in, scenario)
    touched = _of_touched_study(scenario.seed, scenario.bench, effect)
    hidden = [entry.model_dump() for entry in touched.settings.hidden_effects]
    for entry in disturbances:
        if entry["id"] == "direction_reversed":
            of, amount = f"joint {entry['parameters']['joint']}", {"tau_c": _FRICTION_NM}
            hidden.append({"id": "friction_torque", "of": of, "parameters": amount})
    raw = touched.settings.model_dump(exclude={"without_touches"}) | {
        "random_seed": scenario.seed,
        "disturbances": disturbances,
        "hidden_effects": hidden,
        "loads_N": (0.0, 22.0, 44.0),
    }
    raw["poses"] |= {"wide_poses": _TOUCHED_POSES}
    settings = parse_section(SimulateOptions, raw, where=touched.name)
    sizes = touched.sizes + (1.0,) * (len(hidden) - len(touched.sizes))
    return Trial(f"wild-{scenario.seed:08x}", scenario.kind, TOUCHED, settings, sizes)


def _of_touched_study(seed: int, bench: Bench, effect: type[SimulatedEffect] | None) -> Trial:
    """Draw a trial as the touched study has them, of one effect at its plausible size or of none.

    An effect without a name has a size that is drawn, as there. The number of a trial, which would
    choose among benches, is that of the first one of its effect.
    """
    kind, number, subject, size = "null", 0, "", None
    if effect is not None and effect.named:
        kind, subject, size = "single", effect.id, effect.plausible_size
        number = list(vocabulary()).index(subject)
    elif effect is not None:
        kind, subject = "outside", effect.id
        number = list(outside()).index(subject)
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    return _draw_hidden(kind, number, subject, {TOUCHED: bench}, rng, size=size)


def _entries(put_in: Sequence[Disturbance], scenario: Scenario) -> list[dict[str, Any]]:
    """Draw the parameters of disturbances, as entries of the settings."""
    joints, rng = scenario.bench.arm.n, scenario.rng
    return [{"id": each.id, "parameters": each.draw_parameters(joints, rng)} for each in put_in]


# Drives: errors of sensors or gears in some joints of any arm, and ripple of their motors.

_EFFECTS_OF_DRIVES: Mapping[str, tuple[str, ...]] = {
    "sensor": ("sensor_error",),
    "gear": ("gear_error",),
    "both": ("sensor_error", "gear_error"),
    "neither": ("motor_ripple",),
}
#: Number of poses of all campaigns of a trial; largest number of erroneous joints; factor of their
#: usual error; noise of positions.
DRIVE_POSES = (1000, 4000)
_MOST_JOINTS = 2
#: Campaigns of a trial have seeds one after the other: this many stay below 2^31.
_MOST_CAMPAIGNS = 8
_DRIVE_SIZES = (0.7, 1.4)
_DRIVE_POSITION_MM = (0.015, 0.035)
#: Share of the moves in which a joint stays.
_STAYS = 0.2


def _draw_drives(
    kind: str, number: int, _subject: str, benches: Mapping[str, Bench], rng: np.random.Generator
) -> Trial:
    """Draw a trial of drives; the poses of its campaigns are drawn by `campaigns_of`."""
    bench = list(benches.values())[number % len(benches)]
    scenario = Scenario(kind, rng, bench, int(rng.integers(2**31 - _MOST_CAMPAIGNS)))
    scenario.settings["without_touches"] = bench.plan | {
        "poses": round(log_uniform(DRIVE_POSES, rng) / bench.campaigns),
        "holdout_share": 0.1,
        "position_mm": log_uniform(_DRIVE_POSITION_MM, rng),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    arm = bench.arm
    drawn = drawn_ratio(rng)  # of all gears whose ratio is not stated
    joints = rng.choice(arm.n - 1, int(rng.integers(1, _MOST_JOINTS, endpoint=True)), False) + 1
    for joint in sorted(joints.tolist()):
        of, stated = f"joint {joint}", float(arm.gear_ratio[joint - 1])
        ratio = drawn if np.isnan(stated) else stated
        for name in _EFFECTS_OF_DRIVES[kind]:
            size = log_uniform(_DRIVE_SIZES, rng)
            parameters = all_effects()[name].at_size(Site(of), size, rng)
            parameters["ratio"] = ratio
            parameters["cogs"] = drawn_cogs(ratio, len(parameters["cogs"]), rng)
            if any(each["of"] == of for each in scenario.hidden):  # a motor has one ripple
                parameters["ripple"] = [0.0] * len(parameters["cogs"])
            scenario.put(name, of, parameters, size)
    return scenario.trial("drive")


def campaigns_of(trial: Trial) -> tuple[SimulateOptions, ...]:
    """Return the settings of each campaign of a trial of drives, with poses and noise of its own.

    All have the robot of the first. Positions are drawn from the whole range of each joint where
    some joint turns more than once, else from the part of it that other trials use.
    """
    bench, plan = STUDIES["drives"][trial.bench], trial.settings.without_touches
    assert plan is not None
    campaigns = []
    for number in range(bench.campaigns):
        seed = trial.settings.random_seed + number
        commanded = _commanded(bench.arm, plan.poses, np.random.default_rng([seed, number]))
        own = plan.model_copy(update={"commanded": commanded})
        changed = {"random_seed": seed, "without_touches": own}
        campaigns.append(trial.settings.model_copy(update=changed))
    return tuple(campaigns)


def _commanded(arm: Arm, poses: int, rng: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Return configurations (poses, n) [deg] drawn over the joints' ranges; some joints stay."""
    low, high = np.degrees(arm.limits_rad.T)
    # Errors that repeat from turn to turn need all turns. Where no joint of the arm turns more than
    # once, all keep off their limits.
    if np.all(high - low <= 360.0):
        low, high = np.degrees(joint_bounds(arm))
    drawn = rng.uniform(low, high, (poses, arm.n)).round(4)
    stays = rng.random(drawn.shape) < _STAYS
    stays[0] = False
    last = np.maximum.accumulate(np.where(stays, 0, np.arange(poses)[:, None]), axis=0)
    return tuple(map(tuple, np.take_along_axis(drawn, last, axis=0).tolist()))
