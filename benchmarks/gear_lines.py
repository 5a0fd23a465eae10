"""Lines of gears whose ratio nobody stated: are they named, with their cycles a turn?

`python -m benchmarks.gear_lines [--count 40] [--seed 1]` draws arms as `benchmarks.lost_motion`,
with kinematics of their own. In three of four arms a wheel in the drive of one joint is off centre:
it turns 15 to 160 times a turn of the joint, and the link is off by 0.03 to 0.5 mrad, and by a
fifth of that twice a turn of the wheel. In the others is no such wheel: nothing, or slow waves.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.lost_motion import Drawn, verdict_of, written
from pa10cal.arrays import Array
from pa10cal.commands.command_line import limit_threads

#: Every so many-th arm has no wheel off its centre; in every other one of these waves are slow.
_WITHOUT = 4
_TURNS, _SIZE_RAD, _TWICE = (15.0, 160.0), (3e-5, 5e-4), 0.2
_SLOW = (1.2, 5.8)
#: How near cycles have to be to count as found.
NEAR = 0.1


def drawn(folder: Path, rng: np.random.Generator, number: int) -> tuple[Drawn, int, float]:
    """Write a campaign; return it, the joint (from 1, 0 for none) and the turns of its waves."""
    wheel, slow = number % _WITHOUT != _WITHOUT - 1, number % (2 * _WITHOUT) == _WITHOUT - 1
    at: list[tuple[int, float]] = [(0, 0.0)]

    def off(q_rad: Array, _side: Array, drawing: np.random.Generator) -> Array:
        joint = int(drawing.integers(6))
        turns = float(np.exp(drawing.uniform(*np.log(_TURNS if wheel else _SLOW))))
        size_rad = float(np.exp(drawing.uniform(*np.log(_SIZE_RAD))))
        phases = drawing.uniform(-np.pi, np.pi, 2)
        found = np.zeros_like(q_rad)
        if wheel or slow:
            angle = turns * q_rad[:, joint]
            found[:, joint] = size_rad * np.cos(angle - phases[0])
            at[0] = joint + 1, turns
        if wheel:
            found[:, joint] += _TWICE * size_rad * np.cos(2.0 * angle - phases[1])
        return found

    return written(folder, rng, off, "a wheel of a gear off its centre"), *at[0]


def main() -> None:
    """Draw, judge, and print a line each and the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    limit_threads()
    became: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        for k in range(asked.first, asked.first + asked.count):
            folder = Path(place) / f"arm{k}"
            arm, joint, turns = drawn(folder, np.random.default_rng([asked.seed, k]), k)
            verdict = verdict_of(folder)
            lines = {
                found.of: float(found.x[-1]) for found in verdict.effects if found.id == "gear_line"
            }
            others = [f"{each.id} of {each.of}" for each in verdict.effects]
            as_map = f"joint_error_map of joint {joint}" in others
            right_place = {f"{each} of joint {joint}" for each in ("gear_line", "joint_error_map")}
            others = [each for each in others if each not in right_place]
            found = lines.get(f"joint {joint}")
            large = arm.rms_mm > arm.noise_mm
            right = found is not None and abs(found - turns) < NEAR
            wheel = turns >= _TURNS[0]
            became["wheels"] += wheel
            became["large"] += wheel and large
            became["named"] += wheel and right
            became["large, named"] += wheel and large and right
            became["as a map"] += as_map and not right
            became["other turns"] += found is not None and not right
            became["other names"] += wheel and bool(others)
            became["without"] += not wheel
            became["without, named"] += not wheel and bool(lines) and not right
            print(
                f"{k}: joint {joint}, {turns:.2f} turns, {arm.rms_mm:.3f} mm of "
                f"{arm.noise_mm:.3f} mm noise, {arm.poses} poses: {verdict.verdict}, "
                f"{', '.join(f'{of} {value:.2f}' for of, value in lines.items()) or 'no line'}; "
                f"{', '.join([*as_map * ['a map of it'], *others]) or 'nothing else'}",
                flush=True,
            )
    print(
        f"{became['named']} of {became['wheels']} wheels named with their turns, "
        f"{became['large, named']} of {became['large']} that move more than the noise; "
        f"{became['as a map']} as a map of that joint, {became['other turns']} with other turns, "
        f"{became['other names']} with another name; "
        f"{became['without, named']} of {became['without']} others have a line that is not there"
    )


if __name__ == "__main__":
    main()
