"""Command `plan`: which poses to measure, before any is measured."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.pose_plan.options import PlanOptions

if TYPE_CHECKING:
    from pa10cal.pose_plan.plan import PosePlan


def plan(
    *,
    robot: str,
    instrument: str,
    poses: int,
    out: Path,
    keep_out: Path | None = None,
    workspace_mm: tuple[float, ...] | None = None,
    reach_mm: float | None = None,
    floor_mm: float | None = None,
    instrument_at_mm: tuple[float, ...] | None = None,
    facing_deg: float | None = None,
    uncertainty_mm: float | None = None,
    loads_N: tuple[float, ...] | None = None,
    tool_kg: float | None = None,
    options: PlanOptions | None = None,
) -> None:
    """Choose which poses to measure, before any is measured.

    Of the poses within the joint limits, the workspace and the line of sight, the command chooses
    those with the most information on the model's parameters and on effects that it may lack.
    docs/plan.md explains the limits, the files, and how to go on from there.

    Args:
        robot: name of an arm, shipped or of robot_descriptions, or the file of one (.yaml).
        instrument: pose, points, distance, or touch_trigger_cmm.
        poses: how many to measure.
        out: poses to write (.csv); what to expect of them goes into a JSON file beside it.
        keep_out: boxes that arm, tool and lines of sight stay out of (.yaml): a list of {min_mm,
            max_mm, name} in the base frame.
        workspace_mm: box that the target stays in, in the base frame: least x y z, largest x y z.
        reach_mm: radius about the base's origin that the target stays in.
        floor_mm: height over the base's origin that the tool stays above; without it 0.
        instrument_at_mm: where the instrument is, in the base frame: x y z.
        facing_deg: largest angle between the end-effector's z axis and the way to the instrument.
        uncertainty_mm: standard uncertainty of a measured coordinate or distance; without it 0.05.
        loads_N: external loads; every pose is measured under each.
        tool_kg: mass of the tool, where it is known.
        options: everything else, such as targets_mm, joints_deg, effects, candidates.

    Examples:
        pa10cal plan --robot ur10 --instrument pose --poses 40 --out plan.csv
        pa10cal plan --robot my_arm.yaml --instrument points --poses 60 --out plan.csv \\
          --keep-out box.yaml --instrument-at-mm 2500 0 1200 --facing-deg 60
    """
    from pa10cal.errors import OutputError, SettingsError
    from pa10cal.files.arms import arm_asked
    from pa10cal.pose_plan.plan import plan_poses
    from pa10cal.pose_plan.setup import read_keep_out
    from pa10cal.settings_reading import parse_section

    if out.suffix == ".json":
        raise OutputError(
            "what to expect of the poses is written to this file",
            where="--out",
            value=str(out),
            allowed="the path of a CSV file",
            remedy=f"give {out.with_suffix('.csv')}",
        )
    own_options: dict[str, Any] = {
        "reach_mm": reach_mm,
        "floor_mm": floor_mm,
        "instrument_at_mm": instrument_at_mm,
        "facing_deg": facing_deg,
        "uncertainty_mm": uncertainty_mm,
        "loads_N": loads_N,
        "tool_kg": tool_kg,
    }
    if workspace_mm is not None:
        if len(workspace_mm) != 6:
            raise SettingsError(
                "not the two corners of a box",
                where="--workspace-mm",
                value=workspace_mm,
                allowed="six numbers: least x y z, largest x y z",
                remedy="give both corners",
            )
        own_options["workspace_mm"] = (workspace_mm[:3], workspace_mm[3:])
    if keep_out is not None:
        own_options["keep_out"] = [box.model_dump() for box in read_keep_out(keep_out)]
    # What has an option of its own wins over the same key of --options.
    every = (options or PlanOptions()).model_dump()
    every |= {name: value for name, value in own_options.items() if value is not None}
    arm = arm_asked(robot)
    chosen = plan_poses(arm, instrument, poses, parse_section(PlanOptions, every, where="plan"))
    chosen.save(out)
    print("\n".join([*arm.remarks, *_lines(chosen, out)]))


def _lines(chosen: PosePlan, out: Path) -> Iterator[str]:
    """Yield what to expect of a plan: uncertainty, parameters, effects, and what limits removed."""
    from pa10cal.discovery.rules import JUDGING
    from pa10cal.pose_plan.setup import PlanSetup

    expected = chosen.expected
    yield f"{out}: {len(chosen)} poses of {chosen.arm.name}, in an order of short moves"
    yield f"{out.with_suffix('.json')}: what to expect of them"
    yield (
        f"tool position: {expected.tool.plan_mm:.3f} mm expected standard uncertainty over the "
        f"poses that the limits allow ({len(chosen)} of them at random: "
        f"{expected.tool.random_mm:.3f} mm)"
    )
    springs = ", ".join(map(str, expected.springs)) or "none"
    identified = "all identified"
    if expected.not_identified:
        identified = f"hardly determined: {', '.join(expected.not_identified)}"
    yield f"parameters: {len(expected.parameters)}, springs at joints: {springs}; {identified}"
    if expected.effects:
        least = JUDGING.identified_share  # an effect shows if its relative uncertainty is less
        shown_alone = sum(effect.u_alone < least for effect in expected.effects)
        shown_among_all = sum(effect.u_among_all < least for effect in expected.effects)
        yield (
            f"missing effects: {shown_alone} of {len(expected.effects)} would show in their "
            f"plausible size, {shown_among_all} whatever others are missing too"
        )
    if not chosen.kind.directional and chosen.options.instrument_at_mm is None:
        place_m = PlanSetup(chosen.arm, chosen.kind, chosen.options).instrument_place_m
        place = ", ".join(f"{1e3 * coordinate_m:.0f}" for coordinate_m in place_m)
        yield f"instrument taken to be at {place} mm of the base; state --instrument-at-mm"
    removed = ", ".join(f"{name} {count}" for name, count in expected.removed.items() if count)
    kept, drawn = expected.candidates, expected.drawn
    yield f"chosen from {kept} poses; of {drawn} drawn the limits removed: {removed or 'none'}"
