"""The schedule of a simulated campaign: order, times and approaches of its configurations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.poses import Poses

#: Duration of one configuration of touched balls, and of a change of the load between sweeps.
BLOCK_S = 45.0
LOAD_CHANGE_S = 300.0
#: Least motion of a joint that reverses its drive.
LEAST_MOVE_RAD = np.radians(0.01)


@dataclass(frozen=True)
class Schedule:
    """C configurations in order of time."""

    kind: NDArray[np.str_]  # (C,) `line_x`, `line_y`, `grid` or `holdout`
    pose: NDArray[np.str_]  # (C,) labels; the same label is the same command
    load_N: Array  # (C,) hanging weight
    repeat: NDArray[np.int64]  # (C,) from 1
    start_s: Array  # (C,) when the robot starts to move there
    q: Array  # (C, n) commanded joint positions [rad, or m of a prismatic joint]
    q_from: Array  # (C, n) joint positions that the arm comes from

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def arrival(self) -> Array:
        """Return the direction in which each joint arrives, (C, n): -1, 0 (hardly moves) or +1."""
        move = self.q - self.q_from
        return np.where(np.abs(move) < LEAST_MOVE_RAD, 0.0, np.sign(move))


def sweeps(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> Schedule:
    """Return the schedule of a campaign of touched balls.

    Straight moves come first, unloaded; then, for each load, all repeats of the grid; then the
    held-out points in shuffled order. A repeat is a closed path, so that its first pose is always
    approached from the last.
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
    load_N = np.concatenate([part.load_N for part in parts])
    first = np.cumsum([len(part.load_N) for part in parts])[:-1]
    pauses_s = np.zeros(len(load_N))
    pauses_s[first] = LOAD_CHANGE_S * (load_N[first] != load_N[first - 1])
    return Schedule(
        kind=np.concatenate([part.kind for part in parts]),
        pose=np.concatenate([part.pose for part in parts]),
        load_N=load_N,
        repeat=np.concatenate([part.repeat for part in parts]),
        start_s=BLOCK_S * np.arange(len(load_N)) + pauses_s.cumsum(),
        q=np.concatenate([part.q for part in parts]),
        q_from=np.concatenate([part.q_from for part in parts]),
    )


def one_after_another(commands: Array, plan: TrackerOptions, rng: np.random.Generator) -> Schedule:
    """Return the schedule of a tracker's campaign, each configuration approached from the last.

    Calibration poses come first, then their repeats, then held-out poses. The arm starts at the
    first configuration.

    Args:
        commands: (P, n) commanded joint positions [rad, or m of a prismatic joint].
        plan: share held out, repeats and their order, loads, duration of a configuration.
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


class _Part(NamedTuple):
    """Fields of a `Schedule`, without times, of some configurations."""

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    q: Array
    q_from: Array


def _sweep(kind: str, letter: str, q: Array, load_N: float, repeats: int, path: str) -> _Part:
    """Return the configurations of `repeats` rounds of the closed path through the poses."""
    count = len(q)
    runs = [np.arange(count)] * repeats
    if path == "alternating":
        runs = [run[::-1] if repeat % 2 else run for repeat, run in enumerate(runs)]
    order = np.concatenate(runs)
    q_from = q[np.concatenate([np.roll(run, 1) for run in runs])]
    numbers = np.repeat(np.arange(1, repeats + 1), count)
    kinds, loads_N = np.full(len(order), kind), np.full(len(order), load_N)
    return _Part(kinds, _labels(letter, q)[order], loads_N, numbers, q[order], q_from)


def _shuffled(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> _Part:
    """Return the held-out points, their loads and repeats in shuffled order.

    Between two visits of one point in a row the arm goes to the first grid pose.
    """
    loads_N, repeats = np.array(settings.holdout_loads_N), settings.holdout_repeats
    shape = len(poses.holdout), len(loads_N), repeats
    shuffled = rng.permutation(int(np.prod(shape)))
    order, load, repeat = np.unravel_index(shuffled, shape)
    before = np.roll(order, 1)
    again = (order == before)[:, None]
    q = poses.holdout
    q_from = np.where(again, poses.grid[0], q[before])
    kinds, labels = np.full(len(order), "holdout"), _labels("H", q)
    return _Part(kinds, labels[order], loads_N[load], 1 + repeat, q[order], q_from)


def _labels(letter: str, q: Array) -> NDArray[np.str_]:
    """Return the labels of poses (P, n): a letter and a number from 01."""
    return np.array([f"{letter}{number:02d}" for number in range(1, len(q) + 1)])
