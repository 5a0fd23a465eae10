"""Command `made_up_irb120`."""

from __future__ import annotations

from pathlib import Path


def made_up_irb120(*, out: Path, truth: Path, random_seed: int = 2008, poses: int = 1000) -> None:
    """Write a synthetic campaign of an IRB 120 in the layout of the data set faro-irb120.

    Args:
        out: folder of its tables.
        truth: file for what is hidden in it.
        random_seed: draws arm, poses and noise.
        poses: configurations.

    Examples:
        pa10cal made_up_irb120 --out data/irb120 --truth irb120.truth.json
    """
    from pa10cal.studies.irb120 import write_tables

    out.mkdir(parents=True, exist_ok=True)
    write_tables(out, truth, random_seed, poses)
    print(f"{out}: a synthetic IRB 120, {poses} configurations; what is hidden in {truth}")
