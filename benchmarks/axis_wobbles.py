"""Axes that wobble, and bearings that are only soft, hidden in trials of trackers: what is named.

`python -m benchmarks.axis_wobbles wobbles|bearings|null|single|pair --seed SEED --count COUNT`
draws trials of `blind_trials --measured tracked`, puts the effect in and judges them. Wobbles move
the end by 1.5 to 6 times the noise of a coordinate, but for what of them is geometry; bearings
have one to eight times the usual softness. A line a trial, then the counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm
from pa10cal.command_settings import ChainOptions
from pa10cal.commands.command_line import limit_threads
from pa10cal.files.arms import load_arm
from pa10cal_lab.blind_trials import try_trial
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.outside import SoftBearing
from pa10cal_lab.cell.effects.structure import SimulatedAxisWobble
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import joint_bounds
from pa10cal_lab.cell.scenario import Trial
from pa10cal_lab.cell.trials import draw_trials

#: How far wobbles move the end, in noises of a coordinate, in turn.
_TIMES = (1.5, 6.0, 3.0, 2.0, 4.5, 1.7, 2.5, 3.6)
#: Rings of bearings run out by no more than makes so large a tilt [rad].
_MOST_RAD = 1e-3
#: A point of the tool in the frame of the flange [m].
_TOOL_M = (0.1, 0.0, 0.12)
#: Trials into which the effect is put.
_AS = {"wobbles": "null", "bearings": "null"}
_RINGS = ("lower_x", "lower_y", "upper_x", "upper_y")


def not_geometry(rings: Mapping[str, Any]) -> np.ndarray:
    """Return the tilts (6,) of two rings that no geometry has, as `axis_wobble` counts them."""
    of_x, of_y = (
        (np.array(rings[f"upper_{side}"]) - np.array(rings[f"lower_{side}"])) / rings["apart_m"]
        for side in "xy"
    )
    about_x, about_y = -of_y, of_x
    turning = 0.5 * ((about_x[0] + 1j * about_x[1]) + 1j * (about_y[0] + 1j * about_y[1]))
    return np.array([turning.real, turning.imag, *about_x[2:4], *about_y[2:4]])


def moved_mm(arm: Arm, joint: int, tilts: np.ndarray) -> float:
    """Return by how much such tilts move a point of the tool in usual poses, rms [mm]."""
    q_rad = np.random.default_rng(0).uniform(*joint_bounds(arm), (400, arm.n))
    chain = Chain.of(arm)
    at = frames(chain, chain.coordinates(q_rad))
    T_base_joint = at.T_base_joints[joint - 1]
    cos, sin = np.cos(q_rad[:, joint - 1]), np.sin(q_rad[:, joint - 1])
    turning = (tilts[0] + 1j * tilts[1]) * (cos - 1j * sin)
    twice = [cos**2 - sin**2, 2.0 * sin * cos]
    about_x = turning.real + tilts[2:4] @ twice
    about_y = turning.imag + tilts[4:] @ twice
    axis = T_base_joint[:, :3, 0] * about_x[:, None] + T_base_joint[:, :3, 1] * about_y[:, None]
    tool = at.T_base_ee[:, :3, 3] + at.T_base_ee[:, :3, :3] @ np.array(_TOOL_M)
    moved = np.cross(axis, tool - T_base_joint[:, :3, 3])
    return float(1e3 * np.sqrt(np.mean(np.sum(moved**2, axis=1))))


def with_wobble(trial: Trial, rng: np.random.Generator, times: float) -> Trial:
    """Return a trial that hides nothing with a wobble of a joint that turns by half a turn."""
    settings, arm = trial.settings, load_arm(trial.settings.robot)
    low, high = joint_bounds(arm)
    joints = [k + 1 for k in range(arm.n) if high[k] - low[k] > np.pi + 0.1]
    for _ in range(100):
        joint = int(rng.choice(joints))
        rings = SimulatedAxisWobble.at_size(Site(f"joint {joint}"), 1.0, rng)
        usual_mm = moved_mm(arm, joint, not_geometry(rings)) / np.sqrt(3.0)
        factor = times * settings.without_touches.position_mm / usual_mm
        rings |= {name: [factor * each for each in rings[name]] for name in _RINGS}
        if np.linalg.norm(not_geometry(rings)) < _MOST_RAD:
            break  # else this joint is too near the end
    return _hiding(trial, SimulatedAxisWobble.id, joint, rings)


def with_bearing(trial: Trial, rng: np.random.Generator) -> Trial:
    """Return a trial that hides nothing with a bearing that is softer about one axis or both."""
    size = float(np.exp(rng.uniform(np.log(1.0), np.log(8.0))))
    joint = int(rng.integers(2, load_arm(trial.settings.robot).n - 1))
    soft = SoftBearing.at_size(Site(f"joint {joint}"), size, rng)
    if rng.random() < 0.5:
        soft["stiff"] = soft["soft"] * float(rng.uniform(0.1, 0.8))
    return _hiding(trial, SoftBearing.id, joint, soft)


def _hiding(trial: Trial, effect: str, joint: int, parameters: dict[str, Any]) -> Trial:
    given = trial.settings.model_dump()
    given["hidden_effects"] = [{"id": effect, "of": f"joint {joint}", "parameters": parameters}]
    return replace(trial, settings=SimulateOptions.model_validate(given), sizes=(1.0,))


def drawn(kind: str, number: int, random_seed: int) -> Trial:
    """Return one trial."""
    (trial,) = draw_trials(_AS.get(kind, kind), 1, random_seed, "tracked", first=number)
    rng = np.random.default_rng([random_seed, number])
    if kind == "wobbles":
        return with_wobble(trial, rng, _TIMES[number % len(_TIMES)])
    return with_bearing(trial, rng) if kind == "bearings" else trial


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge trials, and count where a wobble is named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.axis_wobbles")
    parser.add_argument("kind", choices=("wobbles", "bearings", "null", "single", "pair"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=8)
    given = parser.parse_args(arguments)
    limit_threads()
    right = wrong = 0
    for number in range(given.first, given.first + given.count):
        trial = drawn(given.kind, number, given.seed)
        hidden = [(each.id, each.of) for each in trial.settings.hidden_effects]
        verdict, _ = try_trial(trial, ChainOptions())
        effects = getattr(verdict, "effects", ())
        named = [each.of for each in effects if each.id == SimulatedAxisWobble.id]
        there = [of for name, of in hidden if name == SimulatedAxisWobble.id]
        right += bool(there) and there == named
        wrong += bool(set(named) - set(there))
        told = ", ".join(f"{each.id} of {each.of} {each.probability:.2f}" for each in effects)
        print(f"{number}: {hidden or 'nothing'}: {told or 'no name'}", flush=True)
    print(f"a wobble named at its joint: {right} of {given.count}; elsewhere or of none: {wrong}")


if __name__ == "__main__":
    main()
