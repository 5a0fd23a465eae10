"""Command `compensate`."""

from __future__ import annotations

from pathlib import Path


def compensate(
    *,
    model: Path,
    targets: Path,
    out: Path,
    frame: str = "flange",
    load_N: float = 0.0,
    force: bool = False,
) -> None:
    """Find the joint positions to command so that a calibrated robot comes to its targets.

    Every target has a row, in order, with a status: ok, outside_limits, unreachable or
    near_singular. Of several branches the nearest to the row's seed is taken, without a seed the
    nearest to the row before. docs/using-the-model.md explains the columns.

    Args:
        model: model.yaml of a calibration, or the results that hold it.
        targets: poses in the robot's base frame: id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,load_N][,q1_deg,
            ...] (.csv).
        out: joint positions to write (.csv).
        frame: flange, tool, or target_<name>.
        load_N: external load [N] of rows that give none.
        force: use a model whose input is suspect, and loads heavier than any that it has seen.

    Examples:
        pa10cal compensate --model model.yaml --targets targets.csv --out commands.csv
        pa10cal compensate --model model.yaml --targets t.csv --frame tool --load-N 22 --out c.csv
    """
    import numpy as np

    from pa10cal.campaign.pose_lists import commands_text, read_targets
    from pa10cal.commands.model_in_use import doubtful, loads_of, model_in_use, not_read
    from pa10cal.files.output import write_text

    fitted = model_in_use(model, force=force)
    arm = fitted.arm
    asked = read_targets(targets, arm.prismatic)
    found = fitted.compensate(
        asked.T,
        frame=frame,
        seed=asked.seed,
        load_N=loads_of(asked.load_N, load_N),
        extrapolate=force,
    )
    columns = {
        "status": found.status,
        "error_mm": found.error_mm,
        "u_mm": found.u_mm,
        "error_deg": found.error_deg,
        "inside": found.inside,
    }
    if doubtful(fitted):
        columns["forced"] = np.full(len(found), fitted.grade)
    write_text(out, commands_text(asked.ids, found.q, arm.prismatic, columns))
    words, counts = np.unique(found.status, return_counts=True)
    said = ", ".join(f"{count} {word}" for word, count in zip(words, counts, strict=True))
    rest = not_read(targets, asked.unused)
    print(f"{out}: {len(found)} targets of the {frame} of {arm.name}: {said}{rest}")
