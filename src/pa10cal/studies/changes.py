"""How often what happened to an arm is told, and how many poses it takes to adapt a model.

Arms of the virtual cell depart in any way. Each is measured before and after a change; both
campaigns are calibrated as any other, and the verdict is compared with what happened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import betaincinv

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted
from pa10cal.calibration.general.prior import calibrate_from, prior_of
from pa10cal.cell.individual import draw_individual
from pa10cal.cell.options import TrackerOptions
from pa10cal.cell.robot import Robot
from pa10cal.evaluation.what_moved import what_moved
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.comparison import AdaptedRows, ChangesRecord, VerdictRate, WhatMoved
from pa10cal.studies.simulated import (
    exact_observations,
    measured,
    observations_of,
    payload_of_individual,
)

#: Sizes of what happens; between the ends any is as likely on a scale of logarithms.
ZERO_RAD, SOFTER, LONGER_M = (0.2e-3, 2e-3), (0.1, 0.5), (0.1e-3, 1e-3)
#: Joints with a spring, of which those named may change; joints whose zero neither base nor tool
#: takes up; rows whose length no base takes up.
FLEXIBLE, SOFTENED, ZEROED, LENGTHENED = (2, 3, 4), (2, 3), (2, 3, 4, 5), (2, 3)
HAPPENED = (
    "unchanged",
    "base_or_tool_moved",
    "joint_zero_moved",
    "stiffness_changed",
    "something_else",
)
#: Poses after a change with which a model is adapted.
ADAPTED_TO = (4, 6, 8, 10, 15, 20, 30, 50, 100)
_FURTHER_POSES = 100
#: Streams of random numbers.
_CHANGE, _BEFORE, _AFTER, _FURTHER = 1, 2, 3, 4


@dataclass(frozen=True)
class _Happened:
    """What happens to one arm."""

    change: Change
    of: str = ""  # where, as a verdict names it; empty where no such place is to be told
    # by how much [rad], of a stiffness the part of its windup; None where not scored
    by: float | None = None


def changes_study(
    robot: str, instrument: str, poses: int, pairs: int, seed: int, say: Callable[[str], None]
) -> ChangesRecord:
    """Simulate pairs of campaigns, compare them, and adapt models to the second.

    Args:
        robot: name of a shipped arm of six turning joints with masses.
        instrument: what measures: `pose`, `points` or `distance`.
        poses: of each campaign.
        pairs: of each kind of change, and arms that models are adapted to.
        seed: draws everything.
        say: takes one line for each kind that is done.
    """
    arm = load_arm(robot)
    plan = TrackerOptions(
        instrument=instrument,
        poses=poses,
        holdout_share=0.0,
        flexible_joints=FLEXIBLE,
        hardening=False,
        states_targets=False,
    )
    rates, inside = [], []
    for number, happened in enumerate(HAPPENED):
        told: Counter[str] = Counter()
        right = 0
        for pair in range(pairs):
            what, found = _told(arm, plan, happened, [seed, number, pair])
            told[found.verdict] += 1
            right += _is_right(happened, what, found)
            inside += _inside(what, found)
        rates.append(_rate(happened, pairs, right, told))
        low, high = rates[-1].interval95
        say(f"{happened}: {right} of {pairs} right ({100 * low:.0f} to {100 * high:.0f} %)")
    adapted, full_mm = _adapted(arm, plan, pairs, seed)
    for count, ratio, most in zip(
        adapted.poses, adapted.over_full, adapted.over_full_95, strict=True
    ):
        beside = f"{ratio:.2f} times the error of all ({most:.2f} for 95 % of arms)"
        say(f"{count:.0f} poses after a crash: {beside}")
    return ChangesRecord(
        robot=robot,
        instrument=instrument,
        poses=poses,
        random_seed=seed,
        verdicts=tuple(rates),
        inside=float(np.mean(inside)) if inside else 1.0,
        adapted=adapted,
        full_measured_mm=full_mm,
    )


def _drawn(kind: str, rng: np.random.Generator) -> _Happened:
    """Draw what happens: half of the arms that change otherwise are mounted anew as well."""
    place = bool(rng.integers(2)) if kind != "unchanged" else False
    sign = float(rng.choice([-1.0, 1.0]))
    if kind == "base_or_tool_moved":
        return _Happened(Change(place=True))
    if kind == "joint_zero_moved":
        joint, by = int(rng.choice(ZEROED)), sign * _size(ZERO_RAD, rng)
        return _Happened(Change(place, zero_rad=((joint, by),)), f"joint {joint}", by)
    if kind == "stiffness_changed":
        joint, factor = int(rng.choice(SOFTENED)), 1.0 + sign * _size(SOFTER, rng)
        return _Happened(
            Change(place, softer=((joint, factor),)), f"joint {joint}", 1.0 / factor - 1.0
        )
    if kind == "something_else":
        row = int(rng.choice(LENGTHENED))
        return _Happened(Change(place, longer_m=((row, sign * _size(LONGER_M, rng)),)))
    return _Happened(Change())


def _size(ends: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def _told(
    arm: Arm, plan: TrackerOptions, kind: str, seed: list[int]
) -> tuple[_Happened, WhatMoved]:
    """Return what happened to an arm, and the verdict of both campaigns."""
    rng = np.random.default_rng([*seed, _CHANGE])
    what = _drawn(kind, rng)
    robots = draw_changed(arm, plan, what.change, rng)
    first, second = (
        _calibrated(robot, _seen(robot, plan, [*seed, stream]))
        for robot, stream in zip(robots, (_BEFORE, _AFTER), strict=True)
    )
    found = what_moved(first, second)
    assert found is not None
    return what, found


def _is_right(kind: str, what: _Happened, found: WhatMoved) -> bool:
    """Return whether a verdict is the right one, and of the right place."""
    places = {each.of for each in found.moved if each.kind not in ("base", "tool")}
    return found.verdict == kind and (not what.of or places == {what.of})


def _inside(what: _Happened, found: WhatMoved) -> list[bool]:
    """Return whether intervals of what moved hold the truth."""
    return [
        each.interval95[0] <= what.by <= each.interval95[1]
        for each in found.moved
        if what.by is not None and each.of == what.of and each.interval95 is not None
    ]


def _rate(kind: str, pairs: int, right: int, told: Counter[str]) -> VerdictRate:
    low = float(betaincinv(right, pairs - right + 1, 0.025)) if right else 0.0
    high = float(betaincinv(right + 1, pairs - right, 0.975)) if right < pairs else 1.0
    return VerdictRate(
        happened=kind,
        pairs=pairs,
        right=right,
        share=right / pairs,
        interval95=(low, high),
        verdicts=dict(sorted(told.items())),
    )


def _adapted(arm: Arm, plan: TrackerOptions, arms: int, seed: int) -> tuple[AdaptedRows, float]:
    """Adapt models to arms whose base, tool and one joint zero moved."""
    rows, full = [], []
    counts = [count for count in ADAPTED_TO if count < plan.poses]
    for number in range(arms):
        draw = [seed, len(HAPPENED), number]
        rng = np.random.default_rng([*draw, _CHANGE])
        joint, by = int(rng.choice(ZEROED)), _size(ZERO_RAD, rng)
        robots = draw_changed(arm, plan, Change(True, zero_rad=((joint, by),)), rng)
        model = _calibrated(robots[0], _seen(robots[0], plan, [*draw, _BEFORE]))
        seen, after = _seen(robots[1], plan, [*draw, _AFTER]), robots[1]
        further = plan.model_copy(update={"poses": _FURTHER_POSES})
        measured_after = _seen(after, further, [*draw, _FURTHER])
        exact = exact_observations(after, plan, _FURTHER_POSES, _number([*draw, _FURTHER]))
        full.append(_error_mm(_calibrated(after, seen), measured_after))
        payload = payload_of_individual(after)
        found = []
        for count in counts:
            some = seen.take(slice(count))
            general = calibrate_from(
                prior_of(model, arm, payload), arm, some, find_start(arm, some), payload
            )
            adapted, moved = fitted(general), general.prior
            assert moved is not None
            named = {each.of for each in moved.moved}
            found.append(
                (
                    _error_mm(adapted, measured_after),
                    _error_mm(adapted, exact),
                    f"joint {joint}" in named,
                    bool(named - {f"joint {joint}"}) or moved.factor > 1.0,
                )
            )
        rows.append(found)
    each = np.array(rows, dtype=float)
    ratio = each[:, :, 0] / np.array(full)[:, None]
    return AdaptedRows(
        poses=np.array(counts, dtype=float),
        measured_mm=np.median(each[:, :, 0], axis=0),
        over_full=np.median(ratio, axis=0),
        over_full_95=np.quantile(ratio, 0.95, axis=0),
        true_mm=np.median(each[:, :, 1], axis=0),
        released=each[:, :, 2].mean(axis=0),
        wrong=each[:, :, 3].mean(axis=0),
    ), float(np.median(full))


def _number(seed: list[int]) -> int:
    return int(np.random.SeedSequence(seed).generate_state(1)[0])


def _seen(robot: Robot, plan: TrackerOptions, seed: list[int]) -> Observations:
    return observations_of(measured(robot, plan, _number(seed)))


def _calibrated(robot: Robot, seen: Observations) -> FittedModel:
    start = find_start(robot.arm, seen)
    return fitted(calibrate_general(robot.arm, seen, start, payload_of_individual(robot)))


def _error_mm(model: FittedModel, seen: Observations) -> float:
    away_mm = model.deviations(model.as_modelled(seen)).distance_mm
    return float(np.sqrt(np.mean(away_mm**2)))


# One arm before and after something happened to it: a crash, a new tool, another cell.

#: Base and tool are mounted anew about as well as they were.
_SHIFT_M, _TURN_RAD = 2e-3, 2e-3


@dataclass(frozen=True)
class Change:
    """What happened to an arm."""

    place: bool = False  # whether base and tool are mounted anew
    zero_rad: tuple[tuple[int, float], ...] = ()  # by joint, from 1: how far its zero moved
    softer: tuple[tuple[int, float], ...] = ()  # by joint: factor of its stiffness
    longer_m: tuple[tuple[int, float], ...] = ()  # by row: how much further the next joint is away


def draw_changed(
    arm: Arm, plan: TrackerOptions, change: Change, rng: np.random.Generator
) -> tuple[Robot, Robot]:
    """Draw an individual, and the same after a change.

    Args:
        arm: its description.
        plan: of its campaigns: how it departs, its springs, its tool.
        change: what happens to it.
        rng: draws it, and where base and tool come to stand.
    """
    before = draw_individual(arm, plan, rng)
    return before, _after(before, change, rng)


def _after(robot: Robot, change: Change, rng: np.random.Generator) -> Robot:
    placements = robot.mechanism.placements.copy()
    for joint, angle_rad in change.zero_rad:
        placements[joint - 1, :3, :3] @= Rotation.from_rotvec([0.0, 0.0, angle_rad]).as_matrix()
    for row, length_m in change.longer_m:
        way = placements[row, :3, 3]
        placements[row, :3, 3] += length_m * way / np.linalg.norm(way)
    k_lin = robot.springs.k_lin.copy()
    for joint, factor in change.softer:
        k_lin[joint - 1] *= factor
    changed = replace(
        robot,
        mechanism=replace(robot.mechanism, placements=placements),
        springs=replace(robot.springs, k_lin=k_lin),
    )
    if not change.place:
        return changed
    return replace(
        changed,
        T_instr_base=robot.T_instr_base @ _mounted(rng),
        T_ee_target=robot.T_ee_target @ _mounted(rng),
        targets=replace(robot.targets, p_ee_m=rng.normal(robot.targets.p_ee_m, _SHIFT_M)),
    )


def _mounted(rng: np.random.Generator) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, _TURN_RAD, 3)).as_matrix()
    T[:3, 3] = rng.normal(0.0, _SHIFT_M, 3)
    return T
