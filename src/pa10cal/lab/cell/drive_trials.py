"""Trials of drives: sensors or gears that err in some joints of any arm, and their motors' ripple.

An arm whose joints turn more than once is measured in one campaign, others in two: whether an error
is a joint's own shows where two turns or two campaigns meet.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.files.arms import load_arm
from pa10cal.lab.cell.effects.effect import Site
from pa10cal.lab.cell.effects.reading import drawn_cogs, drawn_ratio
from pa10cal.lab.cell.effects.vocabulary import all_effects
from pa10cal.lab.cell.options import SimulateOptions
from pa10cal.lab.cell.poses import joint_bounds
from pa10cal.lab.cell.trials import (
    ATTITUDE_RAD,
    Bench,
    Scenario,
    Trial,
    log_uniform,
    refuse_unless,
)

#: What errs; where nothing does, motors ripple all the same.
DriveKind = Literal["sensor", "gear", "both", "neither"]
DRIVE_KINDS: tuple[DriveKind, ...] = get_args(DriveKind)
_FIRST_SEED = 700  #: apart from those of the other trials
_HIDDEN: dict[DriveKind, tuple[str, ...]] = {
    "sensor": ("sensor_error",),
    "gear": ("gear_error",),
    "both": ("sensor_error", "gear_error"),
    "neither": ("motor_ripple",),
}
#: Poses of all campaigns of a trial, joints that err, and what they err by, in the usual size.
POSES = (1000, 4000)
_MOST_JOINTS = 2
_SIZES = (0.7, 1.4)
_POSITION_MM = (0.015, 0.035)
#: Part of the moves that leave a joint where it stood.
_STAYS = 0.2


DRIVE_BENCHES = (
    Bench("ur10", "pose", (2, 3), campaigns=1),
    Bench("iiwa14", "pose", (2, 4), campaigns=2),
    Bench("ur10", "pose", (2, 3), campaigns=2),
    Bench("irb120", "pose", campaigns=2),
)


def draw_drive_trials(kind: DriveKind, count: int, random_seed: int) -> tuple[Trial, ...]:
    """Draw trials of one kind, the benches in turn; the same arguments give the same trials.

    Raises:
        SettingsError: for a kind that does not exist.
    """
    refuse_unless(kind, DRIVE_KINDS)
    trials = []
    for number in range(count):
        rng = np.random.default_rng([random_seed, _FIRST_SEED + DRIVE_KINDS.index(kind), number])
        trials.append(_drawn(kind, DRIVE_BENCHES[number % len(DRIVE_BENCHES)], number, rng))
    return tuple(trials)


def campaigns_of(trial: Trial) -> tuple[SimulateOptions, ...]:
    """Return the settings of each campaign of a trial, in poses and noise of its own.

    The robot is that of the first.
    """
    bench = next(each for each in DRIVE_BENCHES if each.name == trial.bench)
    plan, arm = trial.settings.without_touches, load_arm(trial.settings.robot)
    assert plan is not None
    found = []
    for number in range(bench.campaigns):
        seed = trial.settings.random_seed + number
        commanded = _commanded(arm, plan.poses, np.random.default_rng([seed, number]))
        own = plan.model_copy(update={"commanded": commanded})
        found.append(
            trial.settings.model_copy(update={"random_seed": seed, "without_touches": own})
        )
    return tuple(found)


def _drawn(kind: DriveKind, bench: Bench, number: int, rng: np.random.Generator) -> Trial:
    scenario = Scenario(kind, number, rng, bench, int(rng.integers(2**31 - 8)))
    scenario.settings["without_touches"] = bench.plan | {
        "poses": round(log_uniform(POSES, rng) / bench.campaigns),
        "holdout_share": 0.1,
        "position_mm": log_uniform(_POSITION_MM, rng),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    # All gears of an arm are alike; where its description states a ratio, they have that.
    arm = bench.arm
    drawn, stated = drawn_ratio(rng), float(arm.gear_ratio[0])
    ratio = drawn if np.isnan(stated) else stated
    joints = rng.choice(arm.n - 1, int(rng.integers(1, _MOST_JOINTS, endpoint=True)), False) + 1
    for of in (f"joint {joint}" for joint in sorted(joints.tolist())):
        for name in _HIDDEN[kind]:
            size = log_uniform(_SIZES, rng)
            parameters = all_effects()[name].at_size(Site(of), size, rng)
            parameters["ratio"] = ratio
            parameters["cogs"] = drawn_cogs(ratio, len(parameters["cogs"]), rng)
            if any(each["of"] == of for each in scenario.hidden):  # a motor has one ripple
                parameters["ripple"] = [0.0] * len(parameters["cogs"])
            scenario.put(name, of, parameters, size)
    return scenario.trial("drive")


def _commanded(arm: Arm, poses: int, rng: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Return configurations [deg] over all turns that joints may make; some joints stay."""
    low, high = np.degrees(arm.limits_rad.T)
    if np.all(high - low <= 360.0):
        low, high = np.degrees(joint_bounds(arm))
    drawn = rng.uniform(low, high, (poses, arm.n)).round(4)
    stays = rng.random(drawn.shape) < _STAYS
    stays[0] = False
    last = np.maximum.accumulate(np.where(stays, 0, np.arange(poses)[:, None]), axis=0)
    return tuple(map(tuple, np.take_along_axis(drawn, last, axis=0).tolist()))
