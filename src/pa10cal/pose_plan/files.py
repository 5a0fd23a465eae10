"""Files of a plan: boxes to keep out of, the poses, and what to expect of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.rows import position_columns
from pa10cal.errors import SettingsError
from pa10cal.files.output import whole_files
from pa10cal.pose_plan.options import KeepOut, KeepOutBox
from pa10cal.pose_plan.plan import PosePlan
from pa10cal.results.plan import (
    ExpectedEffect,
    ExpectedParameter,
    PlannedPose,
    PlanRecord,
    ToolExpected,
)
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import read_yaml

_PLACE = ("x_mm", "y_mm", "z_mm")


def read_keep_out(path: Path) -> tuple[KeepOutBox, ...]:
    """Read boxes to keep out of: a list of {min_mm, max_mm, name}.

    Raises:
        SettingsError: when the file cannot be read, holds no list, or a box has no volume.
    """
    content = read_yaml(path, SettingsError, what="the boxes to keep out of cannot be read")
    if not isinstance(content, list):
        raise SettingsError(
            "the file holds no list of boxes",
            where=str(path),
            value=content,
            allowed="a list of {min_mm: [x, y, z], max_mm: [x, y, z], name: ...}",
            remedy="begin every box with a hyphen, see docs/plan.md",
        )
    return parse_section(KeepOut, {"boxes": content}, where=str(path)).boxes


def save_plan(plan: PosePlan, path: Path) -> None:
    """Write the poses as CSV, and what to expect of them as JSON beside it, both or none.

    Raises:
        OutputError: when they cannot be written there.
    """
    expected = plan_record(plan).model_dump_json(indent=1) + "\n"
    with whole_files(path, path.with_suffix(".json")) as (poses, beside):
        poses.write_text(plan_text(plan), encoding="utf-8", newline="\n")
        beside.write_text(expected, encoding="utf-8", newline="\n")


def plan_text(plan: PosePlan) -> str:
    """Return the poses as `id,q1_deg,…,x_mm,y_mm,z_mm,u_tool_mm`."""
    places_mm, u_mm = 1e3 * plan.p_base_target_m, plan.u_tool_mm
    lines = [",".join(["id", *position_columns(plan.arm.prismatic), *_PLACE, "u_tool_mm"])]
    for name, q, p, u in zip(plan.ids, _positions(plan), places_mm, u_mm, strict=True):
        words = [f"{value:.3f}" for value in (*q, *p)]
        lines.append(",".join([str(name), *words, f"{u:.4f}"]))
    return "\n".join(lines) + "\n"


def _positions(plan: PosePlan) -> Array:
    """Return the joint positions (N, n) as files have them [deg; mm of a sliding joint]."""
    return np.where(plan.arm.prismatic, 1e3 * plan.q, np.degrees(plan.q))


def plan_record(plan: PosePlan) -> PlanRecord:
    """Return the record of a plan."""
    rows = zip(plan.ids, _positions(plan), plan.p_base_target_m, plan.u_tool_mm, strict=True)
    return PlanRecord(
        robot=plan.arm.name,
        instrument=plan.kind.kind,
        poses=tuple(
            PlannedPose(id=str(name), q=tuple(q.tolist()), target_mm=1e3 * p, u_tool_mm=float(u))
            for name, q, p, u in rows
        ),
        tool=ToolExpected(plan_mm=plan.u_tool_all_mm, random_mm=plan.u_tool_random_mm),
        parameters={
            parameter.name: ExpectedParameter(std=float(u), unit=parameter.unit)
            for parameter, u in zip(plan.parameters, plan.u_parameters, strict=True)
        },
        not_identified=plan.not_identified,
        springs=plan.springs,
        effects=tuple(
            ExpectedEffect(
                id=each.effect.id,
                of=each.effect.of,
                u_alone=each.u_alone,
                u_among_all=each.u_among_all,
            )
            for each in plan.effects
        ),
        criterion=plan.log_dets,
        candidates=len(plan.candidates.q),
        drawn=plan.candidates.drawn,
        removed=plan.candidates.removed,
        travel=plan.travel_rad,
        options=plan.options.model_dump(mode="json"),
    )
