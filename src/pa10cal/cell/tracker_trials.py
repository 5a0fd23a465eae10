"""Trials of arms under trackers that never come back to a pose; see `trials`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.cell.campaign import robot_of
from pa10cal.cell.effects.effect import Effect, Site, TorqueLogEffect
from pa10cal.cell.effects.vocabulary import places_of
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.poses import joint_bounds
from pa10cal.cell.robot import Robot
from pa10cal.cell.trials import (
    DRIFTING,
    KINDS,
    MEMBERS,
    OTHER_SIZES,
    Trial,
    TrialKind,
    by_temperature,
    hide,
    hideable,
    in_turn,
    joint_of,
    log_uniform,
    misstated,
    refuse_unknown,
    takes_turns,
    trial_places,
)
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.settings_reading import parse_section

#: Configurations of a tracker's trial, and the share held out.
TRACKED_POSES = 300
DISTANCE_POSES = 430
TRACKED_HOLDOUT = 0.3
#: Coulomb friction of these arms, of the rated torque.
COULOMB_PER_RATED = 0.1


@dataclass(frozen=True)
class Bench:
    """An arm under a tracker."""

    robot: str  # name of an arm description
    instrument: str  # kind of the tracker
    flexible_joints: tuple[int, ...] = ()  # joints with a linear spring, of an arm with masses
    logs_torques: bool = False  # whether some of its trials log torques
    targets: int | None = None  # how many an instrument of several sees; None draws that
    poses: int = TRACKED_POSES  # configurations of a trial

    @property
    def name(self) -> str:
        """Return arm and instrument, and how many targets it sees where that is not drawn."""
        return "-".join(map(str, filter(None, (self.robot, self.instrument, self.targets))))


def _benches(
    instrument: str, targets: int | None = None, poses: int = TRACKED_POSES
) -> tuple[Bench, ...]:
    """Return the arms of the trials under an instrument."""
    return (
        Bench("ur10", instrument, (2, 3), targets=targets, poses=poses),
        Bench("irb120", instrument, targets=targets, poses=poses),
        Bench("iiwa14", instrument, (2, 4), logs_torques=True, targets=targets, poses=poses),
    )


BENCHES = (*_benches("pose"), *_benches("points"))
#: Studies of what most laboratories have: no attitude is measured. A distance is one number a pose,
#: which needs more of them.
REFLECTORS: dict[str, tuple[Bench, ...]] = {
    "points_one": _benches("points", targets=1),
    "points_three": _benches("points", targets=3),
    "distance": _benches("distance", poses=DISTANCE_POSES),
}
#: Bounds between which a tracker's trials are drawn, evenly in the logarithm: noise of a coordinate
#: [mm], noise of an attitude [rad], time a configuration takes [s], mass of the tool [kg].
POSITION_MM = (0.015, 0.05)
ATTITUDE_RAD = (5e-5, 2e-4)
SECONDS_A_POSE = (20.0, 60.0)
TOOL_KG = (0.5, 3.0)
#: Swing of the hall's temperature in a trial that has one: over these shorter campaigns it comes to
#: the change of the others.
TRACKED_DRIFT_C = 5.0
#: Part of a tracker's trials with loads, which take turns [N]; and how many targets `points` has.
LOADED = 0.5
LOADS_N = (0.0, 30.0)
TARGETS = (1, 3)
#: A joint whose torque varies by less than this part of the rated torque is not loaded.
_LEAST_LOADED = 0.02
_TYPICAL_POSES = 200
#: Between the streams of two studies.
_APART = 100


def draw_tracker_trials(
    kind: TrialKind,
    count: int,
    random_seed: int,
    benches: Sequence[Bench] = BENCHES,
    size: float | None = None,
    study: str = "",
) -> tuple[Trial, ...]:
    """Draw trials of a tracker in which no pose is repeated; see `draw_trials`.

    Singles go through the vocabulary in turn, each effect through the benches where it does
    something, at the size that the vocabulary holds for plausible. Of other kinds the benches take
    turns.

    Args:
        kind: what they hide.
        count: how many.
        random_seed: draws them.
        benches: arms under trackers.
        size: factor of the usual size of all effects; None for the plausible size of singles, and
            sizes drawn of the others.
        study: one of `REFLECTORS`, whose trials are drawn apart; empty for trackers in general.

    Raises:
        SettingsError: for a kind that does not exist.
    """
    refuse_unknown(kind)
    stream = len(KINDS) + KINDS.index(kind)
    stream += _APART * (1 + list(REFLECTORS).index(study)) if study else 0
    known = [KnownBench.of(bench) for bench in benches]
    trials = []
    for number in range(count):
        rng = np.random.default_rng([random_seed, stream, number])
        bench, effects = _bench_in_turn(kind, number, known)
        trials.append(_tracked(kind, number, bench, effects, size, rng))
    return tuple(trials)


def _tracked(
    kind: TrialKind,
    number: int,
    bench: KnownBench,
    known: dict[str, type[Effect]],
    size: float | None,
    rng: np.random.Generator,
) -> Trial:
    robot, asked = bench.robot, bench.asked
    seed = int(rng.integers(2**31))
    drifts = bool(rng.random() < DRIFTING)
    logs_torques = asked.logs_torques and bool(rng.random() < 0.5)
    loads_N = LOADS_N if robot.arm.mass_kg is not None and rng.random() < LOADED else (0.0,)
    position_mm = log_uniform(POSITION_MM, rng)
    plan = {
        "instrument": asked.instrument,
        "poses": asked.poses,
        "holdout_share": TRACKED_HOLDOUT,
        "loads_N": loads_N,
        "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
        "flexible_joints": asked.flexible_joints,
        "hardening": False,
        "tool_mass_kg": round(log_uniform(TOOL_KG, rng), 3),
        "targets": int(rng.choice(TARGETS)),
        "position_mm": position_mm,
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    if asked.targets is not None:
        plan["targets"] = asked.targets
    raw = {"random_seed": seed, "robot": asked.robot, "without_touches": plan}
    own = robot_of(robot.arm, parse_section(SimulateOptions, raw, where=f"trial {number}"))
    hidden: list[dict[str, Any]] = []
    sizes: list[float] = []
    while len(hidden) < MEMBERS.get(kind, 0):
        name = in_turn(number, known) if takes_turns(kind) else str(rng.choice(list(known)))
        effect = known[name]
        factor = effect.plausible_size if kind == "single" else log_uniform(OTHER_SIZES, rng)
        site = bench.site(str(rng.choice(bench.places(effect))), own)
        hide(hidden, sizes, effect, site, factor if size is None else size, rng)
        logs_torques = logs_torques or issubclass(effect, TorqueLogEffect)
    raw |= {
        "hidden_effects": hidden,
        "temperature_drift_C": TRACKED_DRIFT_C if drifts or by_temperature(hidden) else 0.0,
        "without_touches": {**plan, "logs_torques": logs_torques},
        **misstated(kind, robot.arm, position_mm, rng),
    }
    settings = parse_section(SimulateOptions, raw, where=f"trial {number}")
    return Trial(f"blind-{seed:08x}", kind, asked.name, settings, tuple(sizes))


@dataclass(frozen=True)
class KnownBench:
    """What may be hidden at a bench."""

    asked: Bench  # arm and instrument
    robot: Robot  # one such robot
    typical_Nm: Array  # (n,) torques of its joints, root mean square about their mean

    @classmethod
    def of(cls, asked: Bench) -> KnownBench:
        """Return what may be hidden at a bench."""
        arm = load_arm(asked.robot)
        plan = {"instrument": asked.instrument, "flexible_joints": asked.flexible_joints}
        settings = parse_section(
            SimulateOptions, {"robot": asked.robot, "without_touches": plan}, where=asked.name
        )
        robot = robot_of(arm, settings)
        q = np.random.default_rng(0).uniform(*joint_bounds(arm), (_TYPICAL_POSES, arm.n))
        return cls(asked, robot, robot.mechanism.statics(q, np.zeros(len(q))).torque_Nm.std(axis=0))

    def site(self, of: str, own: Robot) -> Site:
        """Return what the size of an effect at a place goes by.

        Args:
            of: the place.
            own: the robot of the trial.
        """
        arm, joint = self.robot.arm, joint_of(of)
        rated_Nm = float(np.nan_to_num(arm.torque_limit_Nm[joint - 1])) if joint else 0.0
        x_m, y_m, z_m = own.T_instr_base[:3, 3].tolist()
        return Site(
            of,
            rated_Nm=rated_Nm,
            typical_Nm=float(self.typical_Nm[joint - 1]) if joint else 0.0,
            coulomb_Nm=COULOMB_PER_RATED * rated_Nm,
            half_m=0.5 * arm.reach_m,
            middle_m=(x_m, y_m, z_m),
        )

    def places(self, effect: type[Effect]) -> list[str]:
        """Return where an effect does something at this bench."""
        arm = self.robot.arm
        if effect.by_weights and arm.mass_kg is None:
            return []
        loaded = np.flatnonzero(self.typical_Nm > _LEAST_LOADED * arm.torque_limit_Nm) + 1
        places = places_of(trial_places(effect), self.robot, loaded.tolist())
        if issubclass(effect, TorqueLogEffect) and not self.asked.logs_torques:
            return []
        soft = [f"joint {joint}" for joint in self.asked.flexible_joints]
        return [place for place in places if place in soft or not effect.by_spring]


def _bench_in_turn(
    kind: TrialKind, number: int, benches: Sequence[KnownBench]
) -> tuple[KnownBench, dict[str, type[Effect]]]:
    """Return the bench of a trial, and the effects that may be hidden there."""
    known = hideable(kind)
    if takes_turns(kind):
        turn, _ = divmod(number, len(known))
        effect = known[in_turn(number, known)]
        fit = [bench for bench in benches if bench.places(effect)]
        if fit:
            return fit[turn % len(fit)], known
        raise SettingsError(
            f"{effect.id} does nothing at any of the benches",
            where="benches",
            value=", ".join(bench.asked.name for bench in benches),
            allowed="an arm with masses and logged torques among them",
            remedy="add one",
        )
    bench = benches[number % len(benches)]
    return bench, {name: each for name, each in known.items() if bench.places(each)}
