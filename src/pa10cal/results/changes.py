"""What `pa10cal changes` writes: how often a change of an arm is told, and adapting to one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from pa10cal.results.record import Column, Key, Part, Record, Table


class VerdictRate(Part):
    """Verdicts of pairs of campaigns between which one thing happened."""

    happened: str = Field(
        description="`unchanged`, `base_or_tool_moved`, `joint_zero_moved` by 0.2 to 2 mrad, "
        "`stiffness_changed` by 10 to 50 %, or `something_else`: a link longer by 0.1 to 1 mm"
    )
    pairs: int = Field(description="pairs of campaigns")
    right: int = Field(description="pairs with the right verdict, in the right place")
    share: float = Field(description="part of them")
    interval95: tuple[float, float] = Field(description="its 95 % interval (Clopper and Pearson)")
    verdicts: Mapping[Annotated[str, Key("verdict")], int] = Field(
        description="pairs by the verdict they got"
    )


class AdaptedRows(Table):
    """Errors of models that started from one before the change, by poses measured after it."""

    poses: Column = Field(description="poses measured after the change")
    measured_mm: Column = Field(description="rms error of further measured poses [mm], median")
    over_full: Column = Field(
        description="the same over that of a calibration of all poses after the change, median"
    )
    over_full_95: Column = Field(description="the ratio that 95 % of the arms keep below")
    true_mm: Column = Field(description="rms error against the arm itself, without noise [mm]")
    released: Column = Field(description="share of arms whose joint was found to have moved")
    wrong: Column = Field(description="share of arms with something else found to have moved")


class ChangesRecord(Record):
    """`changes.json`: simulated arms before and after something happened to them."""

    SCHEMA: ClassVar[str] = "pa10cal-changes/1"
    FILE: ClassVar[str] = "changes.json"
    COMMAND: ClassVar[str] = "changes"

    robot: str = Field(description="the arm")
    instrument: str = Field(description="what measured")
    poses: int = Field(description="poses of each campaign")
    random_seed: int = Field(description="draws arms, changes, poses and noise")
    verdicts: tuple[VerdictRate, ...] = Field(description="by what happened")
    inside: float = Field(
        description="share of 95 % intervals of moved zeros and stiffnesses that hold the truth"
    )
    adapted: AdaptedRows = Field(
        description="base, tool and the zero of one joint moved: how many poses it takes"
    )
    full_measured_mm: float = Field(
        description="rms error of further measured poses, all poses after the change fitted [mm], "
        "median"
    )
