"""`plan.json`: poses to measure, and what to expect of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import JsonValue

from pa10cal.files.table_cells import csv_text
from pa10cal.results.arrays import Vector3
from pa10cal.results.discovery import SuggestedPose
from pa10cal.results.record import Key, ParameterKey, Part, Record, filed


class PlannedPose(Part):
    """One pose to measure."""

    id: str  # its name in the plan
    q: tuple[float, ...]  # joint positions [deg; mm of a sliding joint]
    target_mm: Vector3  # where the first target comes, in the base frame [mm]
    # expected standard uncertainty of the target's position there, once all poses are measured and
    # calibrated [mm]
    u_tool_mm: float


class ExpectedParameter(Part):
    """What is expected of one parameter of the model."""

    std: float  # expected standard uncertainty
    unit: str  # its unit


class ExpectedEffect(Part):
    """How well the poses would show one missing effect, in its plausible size."""

    id: str  # of the vocabulary of effects
    of: str  # where it sits
    # expected standard uncertainty over its plausible size, nothing else missing; 1 where the poses
    # say nothing
    u_alone: float
    u_among_all: float  # the same, every other effect may be there too


class ToolExpected(Part):
    """Expected standard uncertainty of the first target's position, over the candidates."""

    plan_mm: float  # with the plan, root mean square [mm]
    random_mm: float  # with as many of the candidates drawn at random, median of several sets [mm]


@filed("pa10cal-plan/1", "plan.json", by="plan")
class PlanRecord(Record):
    """`plan.json`."""

    robot: str  # name of the arm
    instrument: str  # kind of the instrument
    poses: tuple[PlannedPose, ...]  # in the order in which to drive to them
    tool: ToolExpected  # uncertainty of the tool over the candidates
    parameters: Mapping[ParameterKey, ExpectedParameter]  # every unknown of the model
    not_identified: tuple[str, ...]  # unknowns that these poses hardly determine
    springs: tuple[int, ...]  # joints to which the model gives a spring, from 1
    # missing effects of the vocabulary; those of time, temperature and direction of arrival are not
    # in it
    effects: tuple[ExpectedEffect, ...]
    # what the exchange of poses makes larger, at its start and after each [nats]
    criterion: tuple[float, ...]
    candidates: int  # poses from which the plan was chosen
    drawn: int  # poses that were drawn for them
    # drawn poses that each limit removed, one after the other
    removed: Mapping[Annotated[str, Key("limit")], int]
    travel: float  # sum over moves of the furthest that a joint turns or slides [rad, m]
    options: Mapping[Annotated[str, Key("option")], JsonValue]  # options of the plan


def suggestion_table(
    suggestions: Sequence[SuggestedPose], axes_slide: Sequence[bool], *, with_sides: bool
) -> str:
    """Return the configurations to measure as the text of a CSV file that a robot can read.

    Only the header where there are none. They may say from which side each axis should arrive.
    """
    numbers = range(1, len(axes_slide) + 1)
    sides = [*(f"arrive{k}_from" for k in numbers), "separation_nats"] if with_sides else []
    units = ("mm" if slides else "deg" for slides in axes_slide)
    axes = [f"q{k}_{unit}" for k, unit in zip(numbers, units, strict=True)]
    header = ["order", *axes, "load_N", *sides, "for"]
    rows = []
    for order, pose in enumerate(suggestions, start=1):
        cells = [order, *(f"{angle:.4f}" for angle in pose.q_deg), f"{pose.load_N:g}"]
        if with_sides and pose.arrive_from is not None:
            cells += [f"{side:+.0f}" for side in pose.arrive_from]
            cells += [f"{pose.separation_nats:.2f}"]
        else:
            cells += [""] * len(sides)
        rows.append([*cells, "; ".join(pose.for_)])
    return csv_text(header, rows)
