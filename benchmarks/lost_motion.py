"""Lost motion of 0.1 to 0.5 mrad: is it named where the link lags, and not where it leads?

`python -m benchmarks.lost_motion [--count 40] [--seed 1]` draws arms of six joints and 0.6 to 2.5 m
whose motors are logged and whose links stay behind, as a gear's flank leaves them; one arm of five
has a link that leads, which no gear does and which must never be called backlash. A tracker reads
three reflectors. The forward kinematics are those of `benchmarks.low_cost`, not the program's.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.low_cost import Hobby, write_campaign
from pa10cal.arrays import Array
from pa10cal.commands.command_line import limit_threads

if TYPE_CHECKING:
    from pa10cal.discovery.verdict import Verdict

_AXES = ("z", "y", "y", "x", "y", "x")
#: Of an arm that reaches 1 m: links after each joint [m].
_LINKS_M = np.array(
    [[0.08, 0, 0.25], [0, 0, 0.42], [0.03, 0, 0], [0.38, 0, 0], [0.08, 0, 0], [0.05, 0, 0]]
)
#: Every so many-th arm leads.
_LEADS = 5


@dataclass(frozen=True)
class Drawn:
    """An arm whose links are not where their motors are, and what is known of it."""

    off_rad: Array  # (P, 6) how far links are ahead of their motors
    rms_mm: float  # what that moves the reflectors by
    noise_mm: float
    poses: int


#: How far links are ahead of their motors (P, 6) [rad], by their angles and sides of arrival.
Off = Callable[[Array, Array, np.random.Generator], Array]


def written(folder: Path, rng: np.random.Generator, off: Off, what: str) -> Drawn:
    """Write a campaign of a drawn arm whose links are off; return what is in it."""
    size = rng.uniform(0.6, 2.5)
    designed = Hobby(_AXES, size * _LINKS_M, np.zeros(6))
    built = Hobby(
        _AXES,
        designed.links_m + rng.normal(0.0, 3e-4, (6, 3)),
        np.radians(rng.normal(0.0, 0.1, 6)),
    )
    poses, noise_mm = int(rng.integers(120, 241)), float(rng.uniform(0.01, 0.05))
    q_rad = rng.uniform(-1.5, 1.5, (poses, 6))
    # The arm is where it was before, then moves: the sides on which it arrives are those of moves.
    side = np.sign(np.diff(q_rad, axis=0, prepend=rng.uniform(-1.5, 1.5, (1, 6))))
    off_rad = off(q_rad, side, rng)
    T = built.gripper(q_rad + off_rad)
    targets = rng.uniform(-0.15, 0.15, (3, 3)) + np.array([0.05, 0.0, 0.0])
    seen = T[:, None, :3, 3] + np.einsum("pij,tj->pti", T[:, :3, :3], targets)
    exact = built.gripper(q_rad)
    moved = seen - exact[:, None, :3, 3] - np.einsum("pij,tj->pti", exact[:, :3, :3], targets)
    stands = Rotation.from_euler("zyx", rng.uniform([-3, -0.02, -0.02], [3, 0.02, 0.02]))
    p_mm = 1e3 * (stands.apply(seen.reshape(-1, 3)) + rng.uniform(-2, 2, 3))
    p_mm = p_mm.reshape(seen.shape) + rng.normal(0.0, noise_mm, seen.shape)
    known = np.column_stack([20.0 * np.arange(poses), np.zeros(poses), np.ones(poses)])
    write_campaign(
        folder,
        designed,
        ["time_s", "load_N", "repeat", *_columns()],
        np.hstack([known, np.degrees(q_rad), side, p_mm.reshape(poses, 9)]),
        provenance=f"SYNTHETIC: {what}",
        instrument={"kind": "points", "uncertainty_mm": round(noise_mm, 4)},
        targets_mm={f"T{t + 1}": [round(1e3 * float(x), 1) for x in targets[t]] for t in range(3)},
    )
    rms_mm = 1e3 * float(np.sqrt(np.mean(np.sum(moved**2, axis=2))))
    return Drawn(off_rad, rms_mm, noise_mm, poses)


def with_lost_motion(
    folder: Path, rng: np.random.Generator, leads: bool
) -> tuple[Drawn, int, float]:
    """Write a campaign of an arm with lost motion in one joint.

    Returns:
        What was drawn, the joint, counted from 1, and how far its link stays behind [rad], below 0
        where it leads.
    """
    at: list[tuple[int, float]] = []

    def off(q_rad: Array, side: Array, drawing: np.random.Generator) -> Array:
        joint, size_rad = int(drawing.integers(6)), float(drawing.uniform(1e-4, 5e-4))
        b_rad = -size_rad if leads else size_rad
        at.append((joint + 1, b_rad))
        found = np.zeros_like(q_rad)
        found[:, joint] = -b_rad * side[:, joint]
        return found

    drawn = written(folder, rng, off, "lost motion in one joint")
    return drawn, *at[0]


def _columns() -> list[str]:
    joints = [f"q{j}_deg" for j in range(1, 7)]
    sides = [f"arrival{j}" for j in range(1, 7)]
    return [*joints, *sides, *(f"T{t}_{axis}_mm" for t in (1, 2, 3) for axis in "xyz")]


def verdict_of(folder: Path) -> Verdict:
    """Return the verdict of a campaign."""
    from pa10cal.interface import calibrate, discover, read_campaign

    campaign = read_campaign(folder)
    return discover(campaign, calibrate(campaign))


def judged(folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return the word of a campaign's verdict and the effects that it names, `id of place`."""
    verdict = verdict_of(folder)
    return verdict.verdict, tuple(
        f"{found.effect.id} of {found.effect.of}" for found in verdict.effects
    )


def main() -> None:
    """Draw, judge, and print a line each and the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    limit_threads()
    became: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        for k in range(asked.count):
            leads = k % _LEADS == _LEADS - 1
            folder = Path(place) / f"arm{k}"
            rng = np.random.default_rng([asked.seed, k])
            drawn, joint, b_rad = with_lost_motion(folder, rng, leads)
            word, named = judged(folder)
            right = f"backlash of joint {joint}" in named
            others = [name for name in named if name != f"backlash of joint {joint}"]
            became["leads" if leads else "lags"] += 1
            became["leads, called backlash"] += leads and any("backlash" in each for each in named)
            became["lags, named"] += right and not leads
            became["other names"] += bool(others) and not leads
            print(
                f"{k}: joint {joint}, {1e3 * b_rad:.2f} mrad, {drawn.rms_mm:.3f} mm of "
                f"{drawn.noise_mm:.3f} mm noise, {drawn.poses} poses: {word}, "
                f"{', '.join(named) or 'no effect'}"
            )
    print(
        f"{became['lags, named']} of {became['lags']} lagging links named, "
        f"{became['other names']} with another name; {became['leads, called backlash']} of "
        f"{became['leads']} leading links called backlash"
    )


if __name__ == "__main__":
    main()
