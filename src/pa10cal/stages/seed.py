"""Stage seed: the base frame in the instrument's frame, from the straight-line moves."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.stages.command import limit_threads, run_stage

if TYPE_CHECKING:
    from pa10cal.campaign.observations import PoseObservations
    from pa10cal.frame.nominal_fit import NominalSeed
    from pa10cal.frame.straight_lines import LineSeed, StraightLine


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("seed", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, required=True, help="folder of raw files")
    parser.add_argument("--poses", type=Path, required=True, help="table of poses (.parquet)")
    parser.add_argument("--settings", default="{}", help="base_frame section: JSON or YAML file")
    parser.add_argument("--out", type=Path, required=True, help="base frame (.json)")


def _run(arguments: argparse.Namespace) -> None:
    import numpy as np

    from pa10cal.arm.chain import Chain
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import observations, read_pose_table
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import BASE_FRAME
    from pa10cal.frame.nominal_fit import seed_from_nominal
    from pa10cal.frame.straight_lines import LineLimits, seed_from_lines
    from pa10cal.settings import BaseFrameSettings, read_settings_argument

    settings = read_settings_argument(BaseFrameSettings, arguments.settings)
    campaign = read_campaign(arguments.campaign_dir)
    table = read_pose_table(arguments.poses, campaign.name)
    chain = Chain.of(load_arm(campaign.robot))
    grid = observations(table, "grid")
    unloaded = grid.take(grid.states.load_N == grid.states.load_N.min())
    line_x, line_y = (observations(table, kind) for kind in ("line_x", "line_y"))
    _refuse_one_move(len(line_x), len(line_y), arguments.poses)

    def positions(*kinds: PoseObservations) -> tuple[Any, Any]:
        """Measured and nominal positions of the end-effector."""
        measured = np.vstack([poses.T_cmm_ee[:, :3, 3] for poses in kinds])
        nominal = np.vstack([chain.forward(poses.states.q_rad)[:, :3, 3] for poses in kinds])
        return measured, nominal

    if len(line_x) or len(line_y):
        limits = LineLimits(
            min_length_m=1e-3 * settings.min_length_mm,
            max_bend_m=1e-3 * settings.max_bend_mm,
            min_angle_rad=np.radians(settings.min_angle_deg),
        )
        from_lines = seed_from_lines(
            positions(line_x), positions(line_y), positions(line_x, line_y, unloaded), limits
        )
        record = _line_record(from_lines)
    else:
        record = _nominal_record(seed_from_nominal(*positions(unloaded)))
    header = {"schema": BASE_FRAME, "campaign": campaign.name, "provenance": campaign.provenance}
    write_json(arguments.out, header | record)
    print(
        f"{campaign.name}: base frame by {record['method']}, directions known to "
        f"{1e3 * record['x_direction_u_rad']:.3f} and {1e3 * record['y_direction_u_rad']:.3f} "
        f"mrad, origins scatter by {record['origin_scatter_mm']:.3f} mm"
    )


def _refuse_one_move(points_x: int, points_y: int, poses: Path) -> None:
    """Refuse a move along one axis only, which gives no base frame."""
    from pa10cal.errors import CalibrationError

    if bool(points_x) == bool(points_y):
        return
    there, absent = ("line_x", "line_y") if points_x else ("line_y", "line_x")
    raise CalibrationError(
        f"there are {there} rows, but no {absent} rows",
        where=str(poses),
        allowed="both straight moves, or neither",
        remedy=f"add the {absent} rows to the campaign, or remove its {there} rows too: the base "
        "frame is then fitted to the nominal model",
    )


def _line_record(seed: LineSeed) -> dict[str, Any]:
    import numpy as np

    def line(found: StraightLine) -> dict[str, Any]:
        return {
            "direction_cmm": found.direction_cmm.tolist(),
            "direction_u_rad": found.direction_u_rad,
            "length_mm": 1e3 * found.length_m,
            "bend_rms_mm": 1e3 * found.bend_rms_m,
            "points": found.points,
        }

    return {
        "method": "straight_lines",
        **_frame(seed.T_cmm_base),
        "x_direction_u_rad": seed.line_x.direction_u_rad,
        "y_direction_u_rad": seed.line_y.direction_u_rad,
        "line_x": line(seed.line_x),
        "line_y": line(seed.line_y),
        "angle_between_lines_deg": float(np.degrees(seed.angle_rad)),
        "origin_scatter_mm": 1e3 * seed.origin_scatter_m,
        "origin_poses": seed.origin_poses,
        "origin_from": "line moves and grid poses at the lowest load",
    }


def _nominal_record(seed: NominalSeed) -> dict[str, Any]:
    return {
        "method": "rigid_fit_nominal",
        **_frame(seed.T_cmm_base),
        "x_direction_u_rad": float(seed.axis_u_rad[0]),
        "y_direction_u_rad": float(seed.axis_u_rad[1]),
        "origin_scatter_mm": 1e3 * seed.residual_rms_m,
        "origin_poses": seed.poses,
        "origin_from": "grid poses at the lowest load",
    }


def _frame(T_cmm_base: Any) -> dict[str, Any]:
    return {
        "R_cmm_base": T_cmm_base[:3, :3].tolist(),
        "origin_cmm_m": T_cmm_base[:3, 3].tolist(),
        "T_cmm_base": T_cmm_base.tolist(),
    }


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
