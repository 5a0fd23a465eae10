"""A robot of the virtual cell, commanded through its calibrated model and measured again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign import read
from pa10cal.cell.campaign import Campaign, simulate_campaign
from pa10cal.cell.effects.effect import DriveEffect, Motion
from pa10cal.cell.equilibrium import rest_poses
from pa10cal.cell.options import SimulateOptions
from pa10cal.discovery.given import Place, calibrate_with
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.discovery.setup import setup_of
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import pose_difference
from pa10cal.interface import calibrate
from pa10cal.observe.registry import instruments
from pa10cal.studies.simulated import as_read
from pa10cal.terms.model import Model


@dataclass(frozen=True)
class Commanded:
    """N targets, commanded through the arm as designed and through its model."""

    before_mm: Array  # (N,) distance of the true tool from the target, commanded as designed
    after_mm: Array  # (N,) the same, commanded through the model
    after_deg: Array  # (N,) angle between them then
    promised_mm: Array  # (N,) standard uncertainty that the model states
    status: NDArray[np.str_]  # (N,) what compensation says of each


def simulated_model(
    settings: SimulateOptions, effects: Sequence[Place] = ()
) -> tuple[Campaign, read.Campaign, FittedModel]:
    """Measure a robot of the virtual cell and calibrate it, with effects that are known.

    Args:
        settings: robot, instrument, poses, noise, what is hidden.
        effects: what to calibrate with beyond links and springs.
    """
    made = simulate_campaign("commanded", load_arm(settings.robot), settings)
    campaign = as_read(made)
    model = calibrate(campaign)
    if effects:
        options = CalibrationOptions()
        setup = setup_of(campaign.description, campaign.arm, options, DiscoveryOptions())
        model = calibrate_with(campaign.observations, model, setup, effects).model
    return made, campaign, model


def true_flange(made: Campaign, q: Array, load_N: float = 0.0) -> Array:
    """Return where the flange of the true robot comes to rest, in its base, (N, 4, 4) [m].

    Args:
        made: its campaign.
        q: (N, n) joint positions commanded.
        load_N: external load.
    """
    truth, zero = made.truth, np.zeros(len(q))
    motion = Motion(q, np.zeros_like(q), truth.robot.arm.gear_ratio)
    drive = q.copy()
    for effect in truth.effects:
        if isinstance(effect, DriveEffect):
            drive = drive + effect.turn_rad(motion)
    return rest_poses(truth.robot, truth.effects, drive, zero + load_N, zero, zero).T_base_ee


def true_frame(made: Campaign, q: Array, frame: str = "tool", load_N: float = 0.0) -> Array:
    """Return where a frame of the true robot is, in the instrument's frame, (N, 4, 4) [m]."""
    robot = made.truth.robot
    T_instr_ee: Array = robot.T_instr_base @ true_flange(made, q, load_N)
    if frame == "flange":
        return T_instr_ee
    kind = instruments()[made.instrument.kind]
    if kind.measures_pose:
        return T_instr_ee if kind.from_touches else T_instr_ee @ robot.T_ee_target
    T = np.eye(4)
    name = frame.removeprefix("target_")
    at = robot.targets.names.index(name) if name in robot.targets.names else 0
    T[:3, 3] = robot.targets.p_ee_m[at]
    return T_instr_ee @ T


def as_designed(model: FittedModel) -> FittedModel:
    """Return a model whose links and joints are as designed, with base and tool of the fit."""
    tool = tuple(term for term in model.model.terms if term.of == "tool")
    x = np.concatenate([np.zeros(0), *(model.values_of(term) for term in tool)])
    rigid = Model(model.model.chain, tool)
    return replace(model, model=rigid, x=x, covariance=None, falls_back=None)


def command(made: Campaign, model: FittedModel, q: Array, load_N: float = 0.0) -> Commanded:
    """Command the tool of a robot to where it would be as designed, and see where it comes.

    Args:
        made: the robot's campaign.
        model: its calibrated model.
        q: (N, n) joint positions of the program, as for the arm as designed.
        load_N: external load.
    """
    wanted = as_designed(model).predict(q, frame="tool").T
    found = model.compensate(wanted, frame="tool", seed=q, load_N=load_N)
    T_instr_wanted = model.T_instr_base @ wanted
    before, after = (
        pose_difference(true_frame(made, each, load_N=load_N), T_instr_wanted)
        for each in (q, found.q)
    )
    return Commanded(
        1e3 * np.linalg.norm(before[:, :3], axis=1),
        1e3 * np.linalg.norm(after[:, :3], axis=1),
        np.degrees(np.linalg.norm(after[:, 3:], axis=1)),
        found.u_mm,
        found.status,
    )
