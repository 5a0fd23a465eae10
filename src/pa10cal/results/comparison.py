"""What `pa10cal compare` writes: how two models of arms of one layout differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pa10cal.results import arrays, record
from pa10cal.results.calibration import Moved


class ComparedModel(record.Part):
    """One of the two models."""

    name: str  # its file, or what it was called
    robot: str  # name of its arm
    campaign: str | None  # campaign it was fitted to; null where not known
    calibration: str | None  # load case of its fit; null where not known
    grade: str | None  # how good its calibration is; null where not known
    health: str | None  # the reason for the grade; null where not known
    covariance: bool  # whether the covariance of its parameters is known
    only_here: tuple[str, ...]  # terms that the other model has not


class ParameterRows(record.Table):
    """Parameters of both models; null where a model has not the parameter."""

    term: arrays.LabelColumn  # its term
    of: arrays.LabelColumn  # where the term sits
    parameter: arrays.LabelColumn  # name of the parameter
    unit: arrays.LabelColumn  # unit of values, uncertainties and difference
    first: arrays.GappyColumn  # value in the first model
    first_std: arrays.GappyColumn  # its standard uncertainty
    second: arrays.GappyColumn  # value in the second model
    second_std: arrays.GappyColumn  # its standard uncertainty
    # second minus first; null too for turns of the tool where both fits began with other
    # orientations of it
    difference: arrays.GappyColumn
    # difference over its combined standard uncertainty; null where that is not known, or the poses
    # of either do not determine the parameter
    over_u: arrays.GappyColumn


class ComparedFrame(record.Part):
    """How far apart two models put one frame, over the postures compared."""

    rms_mm: float  # root mean square distance [mm], each in its own base
    peak_mm: float  # largest distance [mm]
    orientation_deg: float  # root mean square angle [deg]
    # root mean square part [mm] that another place of the base, and of what is mounted on the
    # flange, explains
    base_and_tool_mm: float
    remaining_rms_mm: float  # distance that remains without it, rms [mm]
    remaining_peak_mm: float  # largest distance that remains [mm]
    remaining_deg: float  # angle that remains, rms [deg]
    # distance that should remain, rms, by the uncertainties of both [mm]; null where one is not
    # known
    expected_mm: float | None
    expected_deg: float | None  # angle that should remain, rms [deg]; likewise
    # probability that so much or more remains between two models of the same arm, of place and
    # orientation the less likely, twice; of the other alone where one can only be explained by base
    # and tool; null where an uncertainty is not known
    chance: float | None


class MovedThing(Moved):
    """Something that moved between two campaigns."""

    kind: str  # `joint_zero`, `stiffness`, `link` (another departure), `effect`, `base` or `tool`
    interval95: tuple[float, float] | None  # 95 % interval; likewise
    gain: float  # by how much it raises the evidence [nats]
    alternatives: tuple[str, ...]  # what would raise it about as much in its place


class WhatMoved(record.Part):
    """What moved in an arm between two campaigns."""

    # `unchanged`, `base_or_tool_moved`, `joint_zero_moved`, `stiffness_changed`, `something_else`,
    # or `not_comparable`, where no direction of the arm is identified by both fits
    verdict: str
    # of the differences of links, springs and effects, along the directions that both fits
    # identify, by the sum of both covariances
    chi_square: float
    dof: int  # number of these directions
    chance: float  # probability of so large a chi-square where nothing moved
    # factor of the variances of links and springs, 1 where they differ by no more than noise but
    # for what moved
    factor: float
    moved: tuple[MovedThing, ...]  # what moved, the clearest first
    only_in_one: tuple[str, ...]  # springs and effects that one of the models has alone
    # what may have changed unseen: springs and effects that both models have in unlike forms, tool
    # or targets that only one of them has, and parameters that differ and have no uncertainty
    not_compared: tuple[str, ...] = ()
    # whether both models rest on the same readings, as where one was the prior of the other: they
    # then differ by less than is expected, and a small change may go unseen
    same_readings: bool = False
    line: str  # the same in one sentence


@record.filed("pa10cal-comparison/1", "compare.json", by="compare")
class ComparisonRecord(record.Record):
    """`compare.json`."""

    first: ComparedModel  # the first model
    second: ComparedModel  # the second model
    # what the two descriptions of the arm say differently beside the layout: limits, masses, gears,
    # payload, coupling of joints, controller
    described_otherwise: tuple[str, ...]
    parameters: ParameterRows  # every parameter of either model
    postures: int  # postures compared, drawn from the joint angles that both fits have seen
    loads_N: tuple[float, ...]  # external loads of these, in turn [N]
    # by frame, `flange` and `tool`; empty where no angles were seen by both
    frames: Mapping[Annotated[str, record.Key("frame")], ComparedFrame]
    # whether the flanges agree within the uncertainty of both models; null where that cannot be
    # judged
    agree: bool | None
    line: str  # the same in one sentence, with figures
    # what moved between both campaigns; not given without the covariance of a model
    what_moved: WhatMoved | None = record.optional()


# What `pa10cal drift` writes: the parameters of one arm over campaigns, in order of time.


class DriftRows(record.Table):
    """Every parameter of links, springs and effects in every campaign that determines it.

    Without terms of more than 24 parameters, which are curves.
    """

    campaign: arrays.LabelColumn  # the campaign
    term: arrays.LabelColumn  # term of the parameter
    of: arrays.LabelColumn  # where the term sits
    parameter: arrays.LabelColumn  # name of the parameter
    unit: arrays.LabelColumn  # unit of value and interval
    value: arrays.Column  # value
    std: arrays.Column  # its standard uncertainty
    low: arrays.Column  # lower end of its 95 % interval
    high: arrays.Column  # upper end of it


class DriftStep(record.Part):
    """What moved from one campaign to another."""

    first: str  # the campaign before
    second: str  # the campaign after
    what_moved: WhatMoved  # what moved in between


@record.filed("pa10cal-drift/1", "drift.json", by="drift")
class DriftRecord(record.Record):
    """`drift.json`."""

    robot: str  # the arm
    campaigns: tuple[str, ...]  # campaigns, in order of time as they were given
    parameters: DriftRows  # links, springs and effects of the arm
    steps: tuple[DriftStep, ...]  # from each campaign to the next
    overall: DriftStep | None = None  # from the first to the last; null of two campaigns
    line: str  # what moved and when, in one sentence
