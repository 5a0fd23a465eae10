"""A load case to calibrate: its input, and the keys of its record that both models share."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates, loads_as_named
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.fit_summary import FitSummary
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.two_level_problem import report_base
from pa10cal.calibration.uncertainty import calibrated_parameters
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.fit.problem import Solution, unidentified_directions
from pa10cal.observe.observations import Observations
from pa10cal.results.calibration import CalibratedParameter, Covariance, Health, InputFinding
from pa10cal.results.evaluation import ResidualRows

#: The load case of all loads together.
COMBINED = "combined"


@dataclass(frozen=True, eq=False)
class LoadCase:
    """The input of a calibration: poses of a campaign, arm and options."""

    campaign: CampaignDescription  # description of the campaign
    arm: Arm  # the nominal arm
    every: Observations  # single readings of all kinds
    load: str = COMBINED  # `combined` or `general` for all loads together, or one such as `44N`
    options: CalibrationOptions = field(default_factory=CalibrationOptions)  # how to calibrate
    findings: tuple[InputFinding, ...] = ()  # findings of the checks of the input
    prior: FittedModel | None = None  # fitted model of the arm as prior; None for none

    @property
    def payload(self) -> Payload | None:
        """Return what the arm carries; None where it is not known."""
        return self.campaign.payload(self.arm)

    def rows(self, states: PoseStates) -> Mask:
        """Return which of P poses belong to the load case, (P,); see `rows_of_load`."""
        return rows_of_load(states, COMBINED if self.load == "general" else self.load)


def load_cases(states: PoseStates) -> tuple[str, ...]:
    """Return the load cases of poses: every load by rising load, then all together.

    Of a group, loads under which every campaign was measured: the others leave open where the
    instruments of some campaigns stood.
    """
    load_N = loads_as_named(states.load_N)
    loads_N = np.unique(load_N)
    if states.campaign is not None:
        for number in np.unique(states.campaign):
            loads_N = np.intersect1d(loads_N, load_N[states.campaign == number])
    return (*(f"{load:g}N" for load in loads_N), COMBINED)


def rows_of_load(states: PoseStates, load: str) -> Mask:
    """Return which of P poses belong to a load case, (P,).

    Raises:
        CalibrationError: when none does, or none of some campaign of a group.
    """
    labels = np.array([f"{value:g}N" for value in loads_as_named(states.load_N)])
    rows = np.ones(len(labels), dtype=bool) if load == COMBINED else labels == load
    campaign = np.zeros(len(labels)) if states.campaign is None else states.campaign
    if not np.array_equal(np.unique(campaign[rows]), np.unique(campaign)):
        raise CalibrationError(
            "no grid pose with this load"
            if not rows.any()
            else "no grid pose with this load in some campaigns of the group",
            where="load case",
            value=load,
            allowed=", ".join(load_cases(states)),
            remedy="choose one of the measured loads",
        )
    return rows


def fit_keys(
    ended: Solution,
    model: FittedModel,
    parameters: Mapping[str, CalibratedParameter],
    names: Sequence[str],
    covariance: Array,
) -> dict[str, Any]:
    """Return the keys of a record for every fit; the covariance (k, k) is of the names given."""
    return {
        "status": "converged" if ended.converged else "not converged",
        "reason": ended.reason,
        "cost": ended.cost,
        "iterations": ended.iterations,
        "parameters": parameters,
        "covariance": Covariance(names=tuple(names), matrix=covariance),
        "T_instr_base": model.T_instr_base,
        "fitted_model": model_to_plain(model),
    }


def case_keys(
    case: LoadCase, ended: FitSummary, found: Health, model: FittedModel, grid: Observations
) -> dict[str, Any]:
    """Return the keys of the record of a load case that both models share.

    Residuals are those of the calibration poses of every load, with the torques of the model.
    """
    identified, deviations = ended.identifiability, model.deviations(grid)
    return {
        "campaign": case.campaign.name,
        "provenance": case.campaign.provenance,
        "robot": case.campaign.robot,
        "load": case.load,
        "loads_fitted": () if model.fitted_to is None else model.fitted_to.loads_N,
        "rank": identified.rank,
        "unknowns": len(ended.parameters),
        "condition": identified.condition,
        "singular_values": identified.singular_values,
        "null_directions": unidentified_directions(identified, ended.parameters),
        "residuals": ResidualRows(
            pose=grid.pose,
            load_N=grid.states.load_N,
            place_mm=1e3 * model.model.predict(grid.states, model.x)[:, :3, 3],
            position_mm=deviations.position_mm,
            rotation_deg=deviations.rotation_deg,
        ),
        "health": found,
        "seconds": None,
        "settings": case.options.model_dump(mode="json"),
    }


def base_parameters(
    T_instr_base: Array, covariance: Array, axes: Array, held: Collection[str] = ()
) -> dict[str, CalibratedParameter]:
    """Return the six parameters of the base frame, see `report_base`.

    Args:
        covariance: (6, 6) of its six small motions.
        axes: (3, 3) axes along which the base shifts by these, in the instrument's frame.
    """
    along = np.eye(6)
    along[:3, :3] = axes
    return calibrated_parameters(report_base(T_instr_base), along @ covariance @ along.T, held)
