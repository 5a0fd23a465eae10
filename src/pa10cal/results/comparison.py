"""What `pa10cal compare` writes: how two models of arms of one layout differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.calibration import Moved
from pa10cal.results.record import (
    Column,
    GappyColumn,
    Key,
    LabelColumn,
    Part,
    Record,
    Table,
    filed,
    optional,
)


class ComparedModel(Part):
    """One of the two models."""

    name: str = Field(description="its file, or what it was called")
    robot: str = Field(description="name of its arm")
    campaign: str | None = Field(description="campaign it was fitted to; null where not known")
    calibration: str | None = Field(description="load case of its fit; null where not known")
    grade: str | None = Field(description="how good its calibration is; null where not known")
    health: str | None = Field(description="the reason for the grade; null where not known")
    covariance: bool = Field(description="whether the covariance of its parameters is known")
    only_here: tuple[str, ...] = Field(description="terms that the other model has not")


class ParameterRows(Table):
    """Parameters of both models; null where a model has not the parameter."""

    term: LabelColumn = Field(description="its term")
    of: LabelColumn = Field(description="where the term sits")
    parameter: LabelColumn = Field(description="name of the parameter")
    unit: LabelColumn = Field(description="unit of values, uncertainties and difference")
    first: GappyColumn = Field(description="value in the first model")
    first_std: GappyColumn = Field(description="its standard uncertainty")
    second: GappyColumn = Field(description="value in the second model")
    second_std: GappyColumn = Field(description="its standard uncertainty")
    difference: GappyColumn = Field(
        description="second minus first; null too for turns of the tool where both fits began with "
        "other orientations of it"
    )
    over_u: GappyColumn = Field(
        description="difference over its combined standard uncertainty; null where that is not "
        "known, or the poses of either do not determine the parameter"
    )


class ComparedFrame(Part):
    """How far apart two models put one frame, over the postures compared."""

    rms_mm: float = Field(description="root mean square distance [mm], each in its own base")
    peak_mm: float = Field(description="largest distance [mm]")
    orientation_deg: float = Field(description="root mean square angle [deg]")
    base_and_tool_mm: float = Field(
        description="root mean square part [mm] that another place of the base, and of what is "
        "mounted on the flange, explains"
    )
    remaining_rms_mm: float = Field(description="distance that remains without it, rms [mm]")
    remaining_peak_mm: float = Field(description="largest distance that remains [mm]")
    remaining_deg: float = Field(description="angle that remains, rms [deg]")
    expected_mm: float | None = Field(
        description="distance that should remain, rms, by the uncertainties of both [mm]; null "
        "where one is not known"
    )
    expected_deg: float | None = Field(description="angle that should remain, rms [deg]; likewise")
    chance: float | None = Field(
        description="probability that so much or more remains between two models of the same arm, "
        "of place and orientation the less likely, twice; null where an uncertainty is not known"
    )


class MovedThing(Moved):
    """Something that moved between two campaigns."""

    kind: str = Field(
        description="`joint_zero`, `stiffness`, `link` (another departure), `effect`, `base` or "
        "`tool`"
    )
    interval95: tuple[float, float] | None = Field(description="95 % interval; likewise")
    gain: float = Field(description="by how much it raises the evidence [nats]")
    alternatives: tuple[str, ...] = Field(
        description="what would raise it about as much in its place"
    )


class WhatMoved(Part):
    """What moved in an arm between two campaigns."""

    verdict: str = Field(
        description="`unchanged`, `base_or_tool_moved`, `joint_zero_moved`, `stiffness_changed`, "
        "or `something_else`"
    )
    chi_square: float = Field(
        description="of the differences of links, springs and effects, along the directions that "
        "both fits identify, by the sum of both covariances"
    )
    dof: int = Field(description="number of these directions")
    chance: float = Field(description="probability of so large a chi-square where nothing moved")
    factor: float = Field(
        description="factor of the variances of links and springs, 1 where they differ by no more "
        "than noise but for what moved"
    )
    moved: tuple[MovedThing, ...] = Field(description="what moved, the clearest first")
    only_in_one: tuple[str, ...] = Field(description="effects that one of the models has alone")
    line: str = Field(description="the same in one sentence")


@filed("pa10cal-comparison/1", "compare.json", by="compare")
class ComparisonRecord(Record):
    """`compare.json`."""

    first: ComparedModel = Field(description="the first model")
    second: ComparedModel = Field(description="the second model")
    described_otherwise: tuple[str, ...] = Field(
        description="what the two descriptions of the arm say differently beside the layout: "
        "limits, masses, gears, payload"
    )
    parameters: ParameterRows = Field(description="every parameter of either model")
    postures: int = Field(
        description="postures compared, drawn from the joint angles that both fits have seen"
    )
    loads_N: tuple[float, ...] = Field(description="external loads of these, in turn [N]")
    frames: Mapping[Annotated[str, Key("frame")], ComparedFrame] = Field(
        description="by frame, `flange` and `tool`; empty where no angles were seen by both"
    )
    agree: bool | None = Field(
        description="whether the flanges agree within the uncertainty of both models; null where "
        "that cannot be judged"
    )
    line: str = Field(description="the same in one sentence, with figures")
    what_moved: WhatMoved | None = optional(
        "what moved between both campaigns; not given without the covariance of a model"
    )


# What `pa10cal drift` writes: the parameters of one arm over campaigns, in order of time.


class DriftRows(Table):
    """Every parameter of the arm in every campaign that has it."""

    campaign: LabelColumn = Field(description="the campaign")
    term: LabelColumn = Field(description="term of the parameter")
    of: LabelColumn = Field(description="where the term sits")
    parameter: LabelColumn = Field(description="name of the parameter")
    unit: LabelColumn = Field(description="unit of value and interval")
    value: Column = Field(description="value")
    std: Column = Field(description="its standard uncertainty")
    low: Column = Field(description="lower end of its 95 % interval")
    high: Column = Field(description="upper end of it")


class DriftStep(Part):
    """What moved from one campaign to the next."""

    first: str = Field(description="the campaign before")
    second: str = Field(description="the campaign after")
    what_moved: WhatMoved = Field(description="what moved in between")


@filed("pa10cal-drift/1", "drift.json", by="drift")
class DriftRecord(Record):
    """`drift.json`."""

    robot: str = Field(description="the arm")
    campaigns: tuple[str, ...] = Field(description="campaigns, in order of time as they were given")
    parameters: DriftRows = Field(description="links, springs and effects of the arm")
    steps: tuple[DriftStep, ...] = Field(description="from each campaign to the next")
    line: str = Field(description="what moved and when, in one sentence")
