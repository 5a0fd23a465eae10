"""How often the motor's ripple names the sensor or the gear, by joints alone: no arm, no search.

    python -m benchmarks.motor_ripple [trials of each kind]

Drives are drawn as by the cell's own effects, in poses of one joint with a turn and a half. The
error is estimated from the same poses, as a map would be. The trials of whole campaigns are
`snakemake drive_trials`; these are a thousand times quicker.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.motor_ripple import JointSeries, witnesses
from pa10cal_lab.cell.effects.effect import JointState, Site
from pa10cal_lab.cell.effects.vocabulary import all_effects

Array = NDArray[np.float64]

KINDS = {
    "sensor": ("sensor_error",),
    "gear": ("gear_error",),
    "both": ("sensor_error", "gear_error"),
    "neither": ("motor_ripple",),
}
POSES = (1000, 4000)
#: What reading and other joints leave of a joint's angle, and what a map expects of its waves.
NOISE_RAD = (4e-5, 1e-4)
WAVES, WAVE_RAD = 40, 5e-5
MOVED = 0.8


def main(count: int) -> None:
    """Print what every kind of drive was called."""
    for number, kind in enumerate(KINDS):
        rng = np.random.default_rng([number, 20081122])
        said = Counter(called(kind, rng) for _ in range(count))
        print(f"{kind}: " + ", ".join(f"{word} {times}" for word, times in said.most_common()))


def called(kind: str, rng: np.random.Generator) -> str:
    """Return what a drive of a kind is called."""
    poses = int(np.exp(rng.uniform(*np.log(POSES))))
    q = rng.uniform(-1.5 * np.pi, 1.5 * np.pi, poses)
    moved = rng.random(poses) < MOVED
    motion = JointState(q, moved.astype(float), np.full(1, np.nan))
    true, ratio = np.zeros(poses), np.nan
    for name in KINDS[kind]:
        drawn = all_effects()[name].at_size(Site("joint 1"), float(rng.uniform(0.7, 1.4)), rng)
        if np.isfinite(ratio):  # a motor has one ripple
            drawn["ripple"] = [0.0] * len(drawn["cogs"])
        else:
            ratio = drawn["ratio"]
        true += all_effects()[name](**drawn).at("joint 1").at_joint(motion)  # type: ignore[attr-defined]
    noise_rad = float(np.exp(rng.uniform(*np.log(NOISE_RAD))))
    read = true + rng.normal(0.0, noise_rad, poses)
    fitted = _map(q, read, noise_rad)
    series = JointSeries(
        q, read - fitted, np.full(poses, noise_rad**-2), fitted, np.full(poses, np.nan), moved
    )
    stated = ratio if rng.random() < 0.5 else np.nan
    (witness,) = witnesses([[series]], np.array([stated]))
    if witness is None:
        return "no witness"
    if witness.excludes_gear and witness.excludes_sensor:
        return "neither alone"
    return witness.cause or "undecided"


def _map(q: Array, read: Array, noise_rad: float) -> Array:
    """Return the error by the angle as waves expected to be of one size leave it."""
    phase = np.outer(q, np.arange(1, WAVES + 1))
    columns = np.hstack([np.ones((len(q), 1)), np.cos(phase), np.sin(phase)])
    normal = columns.T @ columns + (noise_rad / WAVE_RAD) ** 2 * np.eye(columns.shape[1])
    found: Array = columns @ np.linalg.solve(normal, columns.T @ read)
    return found


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
