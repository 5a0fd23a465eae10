"""In what order the cell measures, from where each joint comes, and when."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.cell.poses import Poses
from pa10cal.settings import SimulateSettings

Array = NDArray[np.float64]

#: One configuration takes this long; hanging another weight between sweeps takes a pause.
BLOCK_S = 45.0
LOAD_CHANGE_S = 300.0
#: A joint that moves by less than this does not turn its drive round.
LEAST_MOVE_RAD = np.radians(0.01)


@dataclass(frozen=True)
class Schedule:
    """C configurations in the order of time.

    Attributes:
        kind: (C,) `line_x`, `line_y`, `grid` or `holdout`.
        pose: (C,) labels; the same label is the same command.
        load_N: (C,) hanging weight.
        repeat: (C,) from 1.
        start_s: (C,) when the robot sets out for each.
        q_rad: (C, n) commanded joint angles.
        q_from_rad: (C, n) where the arm comes from.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    start_s: Array
    q_rad: Array
    q_from_rad: Array

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def arrival(self) -> Array:
        """(C, n) direction in which each joint arrives: -1, 0 (hardly moves) or +1."""
        move = self.q_rad - self.q_from_rad
        arrival: Array = np.where(np.abs(move) < LEAST_MOVE_RAD, 0.0, np.sign(move))
        return arrival


def make_schedule(poses: Poses, settings: SimulateSettings, rng: np.random.Generator) -> Schedule:
    """Order the configurations of a campaign.

    Straight moves come first, unloaded, then one sweep of repeats through the grid a load, then
    the held-out points in shuffled order. A sweep runs round a closed path, so that the first
    pose is approached as in every other repeat.
    """
    sweeps = [
        _sweep("line_x", "LX", poses.line_x, 0.0, 1, settings.path),
        _sweep("line_y", "LY", poses.line_y, 0.0, 1, settings.path),
        *(
            _sweep("grid", "P", poses.grid, load_N, settings.repeats, settings.path)
            for load_N in settings.loads_N
        ),
    ]
    if len(poses.holdout) and settings.holdout_loads_N:
        sweeps.append(_shuffled(poses, settings, rng))
    loads = np.concatenate([sweep.load_N for sweep in sweeps])
    sweep_starts = np.cumsum([len(sweep) for sweep in sweeps])[:-1]
    pauses = np.zeros(len(loads))
    pauses[sweep_starts] = LOAD_CHANGE_S * (loads[sweep_starts] != loads[sweep_starts - 1])
    start_s = BLOCK_S * np.arange(len(loads)) + np.cumsum(pauses)
    joined = {
        field.name: np.concatenate([getattr(sweep, field.name) for sweep in sweeps])
        for field in fields(Schedule)
    }
    return Schedule(**{**joined, "start_s": start_s})


def _sweep(
    kind: str, letter: str, q_rad: Array, load_N: float, repeats: int, path: str
) -> Schedule:
    """Run `repeats` times round the closed path through the poses."""
    count = len(q_rad)
    runs = [np.arange(count)] * repeats
    if path == "alternating":
        runs = [run[::-1] if repeat % 2 else run for repeat, run in enumerate(runs)]
    order = np.concatenate(runs)
    came_from = np.concatenate([np.roll(run, 1) for run in runs])
    numbers = np.repeat(np.arange(1, repeats + 1), count)
    loads_N = np.full(len(order), load_N)
    return _configurations(kind, letter, q_rad, order, came_from, loads_N, numbers)


def _shuffled(poses: Poses, settings: SimulateSettings, rng: np.random.Generator) -> Schedule:
    """Shuffle points, loads and repeats of the held-out points.

    Where shuffling asks for one point twice in a row, the arm goes to the first grid pose in
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
    return replace(schedule, q_from_rad=np.where(again, poses.grid[0], schedule.q_from_rad))


def _configurations(
    kind: str,
    letter: str,
    q_rad: Array,
    order: NDArray[np.intp],
    came_from: NDArray[np.intp],
    load_N: Array,
    repeat: NDArray[np.int64],
) -> Schedule:
    labels = np.array([f"{letter}{number:02d}" for number in range(1, len(q_rad) + 1)])
    return Schedule(
        kind=np.full(len(order), kind),
        pose=labels[order],
        load_N=load_N.astype(float),
        repeat=repeat,
        start_s=np.zeros(len(order)),
        q_rad=q_rad[order],
        q_from_rad=q_rad[came_from],
    )
