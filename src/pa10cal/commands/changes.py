"""Command `changes`."""

from __future__ import annotations

from pathlib import Path


def changes(
    *,
    out: Path,
    robot: str = "ur10",
    instrument: str = "pose",
    poses: int = 150,
    pairs: int = 40,
    seed: int = 20261122,
) -> None:
    """Count how often a change of a simulated arm is told, and adapt models to it.

    Args:
        out: record to write (.json).
        robot: shipped arm of six turning joints with masses.
        instrument: what measures: pose, points or distance.
        poses: of each campaign.
        pairs: pairs of campaigns of each kind of change.
        seed: draws arms, changes, poses and noise.

    Examples:
        pa10cal changes --out changes.json
        pa10cal changes --out points.json --instrument points --pairs 20
    """
    from functools import partial

    from pa10cal.results.codec import write
    from pa10cal.studies.changes import changes_study

    say = partial(print, flush=True)
    record = changes_study(robot, instrument, poses, pairs, seed, say)
    write(record, out)
    say(f"95 % intervals of what moved hold the truth in {100 * record.inside:.0f} %")
