"""Command `predict`."""

from __future__ import annotations

from pathlib import Path


def predict(
    *,
    model: Path,
    joints: Path,
    out: Path,
    frame: str = "flange",
    load_N: float = 0.0,
    force: bool = False,
) -> None:
    """Say where a calibrated robot is, at joint positions that it never was measured at.

    Poses are in the robot's base frame, with the standard uncertainty of each position and whether
    the fit has seen such joint angles. docs/using-the-model.md explains the columns.

    Args:
        model: model.yaml of a calibration, or the results that hold it.
        joints: joint positions: id,q1_deg,...[,load_N] (.csv).
        out: poses to write (.csv).
        frame: flange, tool, or target_<name>.
        load_N: external load [N] of rows that give none.
        force: use a model whose input is suspect, and loads heavier than any that it has seen.

    Examples:
        pa10cal predict --model results/cell-a/model/model.yaml --joints joints.csv --out poses.csv
        pa10cal predict --model model.yaml --joints joints.csv --frame tool --load-N 22 --out p.csv
    """
    from pa10cal.campaign.pose_lists import poses_text, read_joints
    from pa10cal.commands.model_in_use import doubtful, loads_of, model_in_use, not_read
    from pa10cal.files.output import write_text

    fitted = model_in_use(model, force=force)
    asked = read_joints(joints, fitted.arm.prismatic)
    loads_N = loads_of(asked.load_N, load_N)
    found = fitted.predict(asked.q, frame=frame, load_N=loads_N, extrapolate=force)
    forced = fitted.grade if doubtful(fitted) else None
    write_text(out, poses_text(asked.ids, found.T, found.u_mm, found.inside, forced))
    outside = int((~found.inside).sum())
    print(
        f"{out}: {frame} of {fitted.arm.name} at {len(found)} joint positions, "
        f"{outside} of them beyond the angles of the fit{not_read(joints, asked.unused)}"
    )
