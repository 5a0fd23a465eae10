"""`<campaign>.truth.json`: all that a simulated campaign hides. No estimate reads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from pa10cal.results import record

_Rows = Annotated[NDArray[np.float64], record.Shape("rows", "joints")]


class TrueParameter(record.Part):
    """A parameter as the simulated arm has it."""

    value: float  # value, in `unit`
    unit: str  # its unit


class TrueTool(record.Part):
    """The tool as it is."""

    mass_kg: float  # mass [kg]
    com_m: record.Vector3  # centre of mass in the end-effector frame [m]
    load_point_m: record.Vector3  # where loads act, in the end-effector frame [m]
    # places of the targets in the end-effector frame [m]
    targets_m: Mapping[Annotated[str, record.Key("target")], record.Vector3]


class TrueEffect(record.EffectName):
    """An effect that is hidden."""

    # its parameters, as the virtual cell has them
    parameters: Mapping[Annotated[str, record.Key("parameter")], JsonValue]


class TrueDisturbance(record.Part):
    """A change of the raw files: a stressor, or a fault of the log."""

    id: str  # id of the disturbance
    where: tuple[str, ...]  # where: poses, joints, loads or keys


@record.filed("pa10cal-truth/1", "<campaign>.truth.json", by="simulate")
class TruthRecord(record.CampaignRecord):
    """What a simulated campaign hides."""

    robot: str  # name of the arm
    random_seed: int  # seed of everything drawn
    kcub_reading: str  # where the stiffness of the joints comes from
    # departures of the rows and stiffness; of an arm that departs in any way stiffness alone
    parameters: Mapping[record.ParameterKey, TrueParameter]
    T_instr_base_m: record.PoseMatrix  # base frame in the instrument's frame [m]
    # frame of each joint in that of the joint before it [m]
    joint_placements_m: Annotated[NDArray[np.float64], record.Shape("joints", 4, 4)]
    T_last_joint_ee_m: record.PoseMatrix  # end-effector frame in that of the last joint [m]
    T_ee_target_m: record.PoseMatrix  # target in the end-effector frame [m]
    mass_kg: Annotated[NDArray[np.float64], record.Shape("links")]  # mass of each link [kg]
    # centre of mass of each link in its joint's frame [m]
    com_in_joint_frame_m: Annotated[NDArray[np.float64], record.Shape("links", 3)]
    tool: TrueTool  # the tool
    hidden_effects: tuple[TrueEffect, ...]  # effects hidden
    # what was changed in the raw files before they were written
    disturbances: tuple[TrueDisturbance, ...] = ()
    settings: Mapping[
        Annotated[str, record.Key("option")], JsonValue
    ]  # settings it was simulated with
    # commanded joint positions by purpose; empty where they were given
    poses_rad_or_m: Mapping[Annotated[str, record.Key("kind")], _Rows]
    q_motor_rad_or_m: _Rows  # motor positions of every row measured
