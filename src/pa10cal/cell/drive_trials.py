"""Trials of drives: sensors or gears that err in some joints of any arm, and their motors' ripple.

An arm whose joints turn more than once is measured in one campaign, others in two: whether an error
is a joint's own shows where two turns or two campaigns meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.cell.effects.effect import Site
from pa10cal.cell.effects.reading import drawn_cogs, drawn_ratio
from pa10cal.cell.effects.vocabulary import all_effects
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.poses import joint_bounds
from pa10cal.cell.tracker_trials import ATTITUDE_RAD
from pa10cal.cell.trials import Trial, log_uniform
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.settings_reading import parse_section

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


@dataclass(frozen=True)
class DriveBench:
    """An arm under a tracker of poses."""

    robot: str  # name of an arm description
    campaigns: int  # in which it is measured
    flexible_joints: tuple[int, ...] = ()  # joints with a linear spring, of an arm with masses

    @property
    def name(self) -> str:
        """Return arm and number of campaigns."""
        return f"{self.robot}-{self.campaigns}"


DRIVE_BENCHES = (
    DriveBench("ur10", 1, (2, 3)),
    DriveBench("iiwa14", 2, (2, 4)),
    DriveBench("ur10", 2, (2, 3)),
    DriveBench("irb120", 2),
)


def draw_drive_trials(kind: DriveKind, count: int, random_seed: int) -> tuple[Trial, ...]:
    """Draw trials of one kind, the benches in turn; the same arguments give the same trials.

    Args:
        kind: what errs.
        count: how many.
        random_seed: draws them.

    Raises:
        SettingsError: for a kind that does not exist.
    """
    if kind not in DRIVE_KINDS:
        raise SettingsError(
            "unknown kind of trial",
            where="kind",
            value=kind,
            allowed=", ".join(DRIVE_KINDS),
            remedy="name one of these",
        )
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


def _drawn(kind: DriveKind, bench: DriveBench, number: int, rng: np.random.Generator) -> Trial:
    arm = load_arm(bench.robot)
    seed = int(rng.integers(2**31 - 8))
    plan = {
        "instrument": "pose",
        "poses": round(log_uniform(POSES, rng) / bench.campaigns),
        "holdout_share": 0.1,
        "flexible_joints": bench.flexible_joints,
        "hardening": False,
        "position_mm": log_uniform(_POSITION_MM, rng),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
    }
    # All gears of an arm are alike; where its description states a ratio, they have that.
    drawn, stated = drawn_ratio(rng), float(arm.gear_ratio[0])
    ratio = drawn if np.isnan(stated) else stated
    joints = rng.choice(arm.n - 1, int(rng.integers(1, _MOST_JOINTS, endpoint=True)), False) + 1
    hidden: list[dict[str, Any]] = []
    sizes: list[float] = []
    for joint in sorted(joints.tolist()):
        for name in _HIDDEN[kind]:
            size = log_uniform(_SIZES, rng)
            parameters = all_effects()[name].at_size(Site(f"joint {joint}"), size, rng)
            parameters["ratio"] = ratio
            parameters["cogs"] = drawn_cogs(ratio, len(parameters["cogs"]), rng)
            if hidden and hidden[-1]["of"] == f"joint {joint}":  # a motor has one ripple
                parameters["ripple"] = [0.0] * len(parameters["cogs"])
            hidden.append({"id": name, "of": f"joint {joint}", "parameters": parameters})
            sizes.append(size)
    raw = {
        "random_seed": seed,
        "robot": bench.robot,
        "without_touches": plan,
        "hidden_effects": hidden,
    }
    settings = parse_section(SimulateOptions, raw, where=f"trial {number}")
    return Trial(f"drive-{seed:08x}", kind, bench.name, settings, tuple(sizes))


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
