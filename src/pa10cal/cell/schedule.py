"""In what order the cell measures, from where each joint comes, and when."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.cell.options import SimulateOptions, TrackerOptions
from pa10cal.cell.poses import Poses

#: One configuration of touched balls takes this long; hanging another weight between sweeps takes a
#: pause.
BLOCK_S = 45.0
LOAD_CHANGE_S = 300.0
#: A joint that moves by less than this does not turn its drive round.
LEAST_MOVE_RAD = np.radians(0.01)


@dataclass(frozen=True)
class Schedule:
    """C configurations in the order of time."""

    kind: NDArray[np.str_]  # (C,) `line_x`, `line_y`, `grid` or `holdout`
    pose: NDArray[np.str_]  # (C,) labels; the same label is the same command
    load_N: Array  # (C,) hanging weight
    repeat: NDArray[np.int64]  # (C,) from 1
    start_s: Array  # (C,) when the robot sets out for each
    q: Array  # (C, n) commanded joint positions [rad, or m of a prismatic joint]
    q_from: Array  # (C, n) where the arm comes from

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def arrival(self) -> Array:
        """(C, n) direction in which each joint arrives: -1, 0 (hardly moves) or +1."""
        move = self.q - self.q_from
        arrival: Array = np.where(np.abs(move) < LEAST_MOVE_RAD, 0.0, np.sign(move))
        return arrival


def sweeps(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> Schedule:
    """Order the configurations of a campaign of touched balls.

    Straight moves come first, unloaded, then one sweep of repeats through the grid a load, then
    the held-out points in shuffled order. A sweep runs round a closed path, so that the first
    pose is approached as in every other repeat.
    """
    parts = [
        _sweep("line_x", "LX", poses.line_x, 0.0, 1, settings.path),
        _sweep("line_y", "LY", poses.line_y, 0.0, 1, settings.path),
        *(
            _sweep("grid", "P", poses.grid, load_N, settings.repeats, settings.path)
            for load_N in settings.loads_N
        ),
    ]
    if len(poses.holdout) and settings.holdout_loads_N:
        parts.append(_shuffled(poses, settings, rng))
    loads = np.concatenate([part.load_N for part in parts])
    first = np.cumsum([len(part) for part in parts])[:-1]
    pauses = np.zeros(len(loads))
    pauses[first] = LOAD_CHANGE_S * (loads[first] != loads[first - 1])
    start_s = BLOCK_S * np.arange(len(loads)) + np.cumsum(pauses)
    joined = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(Schedule)
    }
    return Schedule(**{**joined, "start_s": start_s})


def one_after_another(commands: Array, plan: TrackerOptions, rng: np.random.Generator) -> Schedule:
    """Order the configurations of a tracker's campaign, each approached straight from the last.

    Calibration poses come first, then their repeats, then the held-out ones. The first
    configuration is approached from where the arm stands already.

    Args:
        commands: (P, n) commanded joint positions [rad, or m of a prismatic joint].
        plan: share held out, repeats and their order, loads, time a configuration takes.
        rng: draws the order where it is drawn.
    """
    count = len(commands)
    holdout = 0 if plan.holdout_every else round(plan.holdout_share * count)
    grid = count - holdout
    if plan.by_first_joint:
        first = np.argsort(commands[:grid, 0], kind="stable")
        commands = np.concatenate([commands[first], commands[grid:]])
    every = plan.repeat_every
    runs = [
        np.arange(grid),
        *(_run(grid, number, plan, rng) for number in range(1, plan.repeats)),
        np.arange(every - 1, grid, every) if every else np.arange(0),
    ]
    pose = np.concatenate([*runs, np.arange(grid, grid + holdout)])
    repeat = np.repeat(np.arange(1, len(runs) + 1), [len(run) for run in runs])
    labels = np.array(
        [f"P{number:03d}" for number in range(1, grid + 1)]
        + [f"H{number:03d}" for number in range(1, holdout + 1)]
    )
    q = commands[pose]
    return Schedule(
        kind=np.where(pose < grid, "grid", "holdout"),
        pose=labels[pose],
        load_N=np.resize(plan.loads_N, count)[pose],
        repeat=np.concatenate([repeat, np.ones(holdout, dtype=np.int64)]),
        start_s=plan.seconds_a_pose * np.arange(len(pose), dtype=float),
        q=q,
        q_from=np.concatenate([q[:1], q[:-1]]),
    )


def _run(
    count: int, number: int, plan: TrackerOptions, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Return the order of `count` poses in a repeat, numbered from 0."""
    if plan.order == "shuffled":
        return rng.permutation(count)
    backwards = {
        "same": False,
        "there_and_back": number % 2 == 1,
        "there_there_back_back": number >= (plan.repeats + 1) // 2,
    }[plan.order]
    return np.arange(count)[::-1] if backwards else np.arange(count)


def _sweep(kind: str, letter: str, q: Array, load_N: float, repeats: int, path: str) -> Schedule:
    """Run `repeats` times round the closed path through the poses."""
    count = len(q)
    runs = [np.arange(count)] * repeats
    if path == "alternating":
        runs = [run[::-1] if repeat % 2 else run for repeat, run in enumerate(runs)]
    order = np.concatenate(runs)
    came_from = np.concatenate([np.roll(run, 1) for run in runs])
    numbers = np.repeat(np.arange(1, repeats + 1), count)
    loads_N = np.full(len(order), load_N)
    return _configurations(kind, letter, q, order, came_from, loads_N, numbers)


def _shuffled(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> Schedule:
    """Shuffle points, loads and repeats of the held-out points.

    Where shuffling gives one point twice in a row, the arm goes to the first grid pose in
    between.
    """
    point, load, repeat = (
        choice.ravel()
        for choice in np.meshgrid(
            np.arange(len(poses.holdout)),
            np.array(settings.holdout_loads_N),
            np.arange(1, settings.holdout_repeats + 1),
            indexing="ij",
        )
    )
    shuffled = rng.permutation(len(point))
    order = point[shuffled]
    came_from = np.roll(order, 1)
    schedule = _configurations(
        "holdout", "H", poses.holdout, order, came_from, load[shuffled], repeat[shuffled]
    )
    again = (order == came_from)[:, None]
    return replace(schedule, q_from=np.where(again, poses.grid[0], schedule.q_from))


def _configurations(
    kind: str,
    letter: str,
    q: Array,
    order: NDArray[np.intp],
    came_from: NDArray[np.intp],
    load_N: Array,
    repeat: NDArray[np.int64],
) -> Schedule:
    labels = np.array([f"{letter}{number:02d}" for number in range(1, len(q) + 1)])
    return Schedule(
        kind=np.full(len(order), kind),
        pose=labels[order],
        load_N=load_N.astype(float),
        repeat=repeat,
        start_s=np.zeros(len(order)),
        q=q[order],
        q_from=q[came_from],
    )
