"""What a campaign hides, as a record that no estimating stage reads."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.cell.built import BuiltRobot
from pa10cal.cell.campaign import Campaign

Array = NDArray[np.float64]

TRUTH_SCHEMA = "pa10cal-truth/1"
_UNITS = {"a_m": "m", "alpha_rad": "rad", "d_m": "m", "theta_rad": "rad", "beta_rad": "rad"}


def truth_record(campaign: Campaign) -> dict[str, Any]:
    """Return all that `campaign` hides, with units, ready for JSON."""
    truth, settings = campaign.truth, campaign.settings
    robot = truth.robot
    poses = {
        "line_x": truth.poses.line_x,
        "line_y": truth.poses.line_y,
        "grid": truth.poses.grid,
        "holdout": truth.poses.holdout,
    }
    return {
        "schema": TRUTH_SCHEMA,
        "campaign": campaign.name,
        "robot": robot.arm.name,
        "random_seed": settings.random_seed,
        "kcub_reading": robot.springs.source,
        "parameters": _parameters(robot),
        "T_instr_base_m": robot.T_instr_base.tolist(),
        "mass_kg": robot.mass_kg.tolist(),
        "com_m": robot.com_m.tolist(),
        "tool": {
            "mass_kg": robot.apparatus.mass_kg,
            "com_m": robot.apparatus.com_m.tolist(),
            "load_point_m": robot.apparatus.load_point_m.tolist(),
            "balls_m": dict(
                zip(robot.apparatus.ball_names, robot.apparatus.balls_m.tolist(), strict=True)
            ),
        },
        "hidden_effects": [
            {"id": effect.id, "of": effect.of, "parameters": effect.model_dump()}
            for effect in truth.effects
        ],
        "settings": settings.model_dump(mode="json"),
        "poses_rad": {kind: q_rad.tolist() for kind, q_rad in poses.items()},
    }


def _parameters(robot: BuiltRobot) -> dict[str, dict[str, Any]]:
    """Return departures and springs by name; a row has no beta or no d, as its maker says."""
    parameters: dict[str, dict[str, Any]] = {}
    hayati = robot.arm.hayati
    for field in fields(robot.departures):
        name = field.name.rsplit("_", 1)[0]
        for i, value in enumerate(getattr(robot.departures, field.name)):
            if not (name == "beta" and not hayati[i]) and not (name == "d" and hayati[i]):
                parameters[f"delta_{name}_{i + 1}"] = {
                    "value": float(value),
                    "unit": _UNITS[field.name],
                }
    for joint in np.flatnonzero(robot.springs.flexible).tolist():
        k_lin, k_cub = float(robot.springs.k_lin[joint]), float(robot.springs.k_cub[joint])
        parameters[f"K_lin_{joint + 1}"] = {"value": k_lin, "unit": "N m/rad"}
        parameters[f"K_cub_{joint + 1}"] = {"value": k_cub, "unit": "N m/rad^3"}
    return parameters
