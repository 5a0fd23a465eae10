"""`<campaign>.truth.json`: all that a simulated campaign hides. No estimate reads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from pa10cal.results.record import (
    CampaignRecord,
    EffectName,
    Key,
    ParameterKey,
    Part,
    PoseMatrix,
    Shape,
    Vector3,
    filed,
)

_Rows = Annotated[NDArray[np.float64], Shape("rows", "joints")]


class TrueParameter(Part):
    """A parameter as the simulated arm has it."""

    value: float = Field(description="value, in `unit`")
    unit: str = Field(description="its unit")


class TrueTool(Part):
    """The tool as it is."""

    mass_kg: float = Field(description="mass [kg]")
    com_m: Vector3 = Field(description="centre of mass in the end-effector frame [m]")
    load_point_m: Vector3 = Field(description="where loads act, in the end-effector frame [m]")
    targets_m: Mapping[Annotated[str, Key("target")], Vector3] = Field(
        description="places of the targets in the end-effector frame [m]"
    )


class TrueEffect(EffectName):
    """An effect that is hidden."""

    parameters: Mapping[Annotated[str, Key("parameter")], JsonValue] = Field(
        description="its parameters, as the virtual cell has them"
    )


class TrueDisturbance(Part):
    """A change of the raw files: a stressor, or a fault of the log."""

    id: str = Field(description="id of the disturbance")
    where: tuple[str, ...] = Field(description="where: poses, joints, loads or keys")


@filed("pa10cal-truth/1", "<campaign>.truth.json", by="simulate")
class TruthRecord(CampaignRecord):
    """What a simulated campaign hides."""

    robot: str = Field(description="name of the arm")
    random_seed: int = Field(description="seed of everything drawn")
    kcub_reading: str = Field(description="where the stiffness of the joints comes from")
    parameters: Mapping[ParameterKey, TrueParameter] = Field(
        description="departures of the rows and stiffness; of an arm that departs in any way "
        "stiffness alone"
    )
    T_instr_base_m: PoseMatrix = Field(description="base frame in the instrument's frame [m]")
    joint_placements_m: Annotated[NDArray[np.float64], Shape("joints", 4, 4)] = Field(
        description="frame of each joint in that of the joint before it [m]"
    )
    T_last_joint_ee_m: PoseMatrix = Field(
        description="end-effector frame in that of the last joint [m]"
    )
    T_ee_target_m: PoseMatrix = Field(description="target in the end-effector frame [m]")
    mass_kg: Annotated[NDArray[np.float64], Shape("links")] = Field(
        description="mass of each link [kg]"
    )
    com_in_joint_frame_m: Annotated[NDArray[np.float64], Shape("links", 3)] = Field(
        description="centre of mass of each link in its joint's frame [m]"
    )
    tool: TrueTool = Field(description="the tool")
    hidden_effects: tuple[TrueEffect, ...] = Field(description="effects hidden")
    disturbances: tuple[TrueDisturbance, ...] = Field(
        (), description="what was changed in the raw files before they were written"
    )
    settings: Mapping[Annotated[str, Key("option")], JsonValue] = Field(
        description="settings it was simulated with"
    )
    poses_rad_or_m: Mapping[Annotated[str, Key("kind")], _Rows] = Field(
        description="commanded joint positions by purpose; empty where they were given"
    )
    q_motor_rad_or_m: _Rows = Field(description="motor positions of every row measured")
