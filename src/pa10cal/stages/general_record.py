"""Calibrations with the general model as JSON, written and read back."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.calibration.accuracy import Accuracy
from pa10cal.calibration.base_parameters import report_base
from pa10cal.calibration.general.calibrate import GeneralCalibration, GeneralOptions
from pa10cal.calibration.general.case import FittedModel, GeneralCase, fitted
from pa10cal.calibration.general.instrument import Seen, place_parameters
from pa10cal.calibration.general.start import Start
from pa10cal.calibration.general.unknowns import tool_frame
from pa10cal.calibration.identifiability import not_identifiable, observability
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.observations import PoseObservations
from pa10cal.campaign.seen import SeenPoints, SeenPoses
from pa10cal.errors import RecordError
from pa10cal.fit.loads import with_torques
from pa10cal.stages.health_record import health_record
from pa10cal.stages.records import read_pose_matrix, read_vector
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Tolerances, link_departures
from pa10cal.terms.term import Term

Array = NDArray[np.float64]
#: The fits of a record: links, springs and frames; without springs; frames alone.
Which = Literal["full", "geometry", "nominal"]


def general_options(settings: CalibrationOptions) -> GeneralOptions:
    """Return the options of the general model that the settings ask for."""
    springs = settings.general.springs
    return GeneralOptions(
        springs=None if springs == "auto" else springs,
        robust=settings.general.robust,
        tolerances=Tolerances(**settings.tolerances.model_dump()),
        max_iterations=settings.max_iterations,
    )


def read_start(seed: dict[str, Any], seen: Seen, path: Path) -> Start:
    """Return where frames and targets are, from `seed/base_frame.json`.

    Args:
        seed: its content.
        seen: what the instrument saw, which says what of it counts.
        path: where it was read from, for the message.

    Raises:
        RecordError: when it lacks a target.
    """
    T_instr_base = read_pose_matrix(seed, "T_instr_base", path)
    T_ee_target, places_m = np.eye(4), np.zeros(0)
    if isinstance(seen, SeenPoses):
        if "T_ee_target" in seed:
            T_ee_target = read_pose_matrix(seed, "T_ee_target", path)
    else:
        stated = seed.get("p_ee_targets_m")
        stated = stated if isinstance(stated, dict) else {}
        names = seen.names if isinstance(seen, SeenPoints) else tuple(stated)[:1]
        missing = [name for name in names or ("target",) if name not in stated]
        if missing:
            raise RecordError(
                f"the record lacks target {missing[0]}",
                where=f"{path}: p_ee_targets_m",
                value=list(stated),
                allowed="a place for every target",
                remedy="run the seed stage again",
            )
        places_m = np.concatenate([read_vector(stated, name, 3, path) for name in names])
    return Start(T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], places_m)


def general_record(case: GeneralCase) -> dict[str, Any]:
    """Return the numbers of `calibration/<load>.json`."""
    full = case.full
    found = full.fit
    load_N = full.problem.sightings.states.load_N
    before, after = _by_load(case.before), _by_load(case.after)
    geometry_after = _by_load(case.geometry_after)
    return {
        "load": case.load,
        "model": "general",
        "loads_fitted": sorted({float(load) for load in load_N}),
        **_fit_record(full),
        "starts": 1,
        "starts_agreeing": 1,
        "rank": found.identifiability.rank,
        "unknowns": len(full.problem.parameters),
        "condition": found.identifiability.condition,
        "singular_values": found.identifiability.singular_values.tolist(),
        "null_directions": [direction.weights for direction in case.unidentified_directions],
        "redundant": [
            {"name": each.name, "said_by": each.said_by} for each in full.unknowns.redundant
        ],
        "observability": asdict(observability(found.identifiability, len(load_N))),
        "springs": list(full.springs),
        "torques_from": full.torques_from,
        "errors": {
            load: {
                "before": before[load],
                "geometry": geometry_after[load],
                "after": after[load],
            }
            for load in after
        },
        "before_is": "nominal arm, base and tool fitted",
        "geometry": _fit_record(case.geometry),
        "nominal": _fit_record(case.nominal),
        "residuals": _residual_records(case),
        "suspected_outliers": [asdict(each) for each in case.suspected_outliers],
        "health": health_record(case.health, full.problem.sightings.pose),
        "warnings": _warnings(case),
        "seconds": case.seconds,
    }


def read_general(
    record: dict[str, Any], arm: Arm, path: Path, which: Which = "full"
) -> FittedModel:
    """Return a fit of a general model's record.

    Args:
        record: content of `calibration/<load>.json`.
        arm: the nominal arm.
        path: where it was read from, for the message.
        which: links, springs and frames; without springs; frames alone.

    Raises:
        RecordError: when it lacks what the model needs.
    """
    fit = record if which == "full" else record[which]
    try:
        solved = fit["solved"]
        links = link_departures(arm, Tolerances()).only(solved["links"])
        springs = tuple(
            JointSpring(int(spring["joint"]), float(spring["tau_ref_Nm"]), cubic=False)
            for spring in solved["springs"]
        )
        tool = tool_frame().only(solved["tool"])
        x = np.array(solved["x"], dtype=float)
        places_m = np.array(solved["places_m"], dtype=float)
        R_ee_target = np.array(solved["R_ee_target"], dtype=float).reshape(3, 3)
        terms: tuple[Term, ...] = (links, *springs, tool)
        if len(x) != sum(len(term.parameters) for term in terms):
            raise ValueError("x does not fit the parameters")
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(
            "the record lacks what its model needs",
            where=str(path),
            value=str(error),
            allowed="the solved parameters of a general model",
            remedy="run the calibrate stage again",
        ) from None
    T_instr_base = read_pose_matrix(fit, "T_instr_base", path)
    return FittedModel(Model(Chain.of(arm), terms), x, T_instr_base, R_ee_target, places_m)


def as_modelled(
    poses: PoseObservations, model: FittedModel, payload: Payload | None
) -> PoseObservations:
    """Return measured poses as the general model predicts them.

    Attitudes are those of the end-effector in place of the target's; torques that were not logged
    are those of the masses described.
    """
    T = poses.T_instr_ee.copy()
    T[:, :3, :3] = T[:, :3, :3] @ model.R_ee_target.T
    states, _ = with_torques(model.model.chain.arm, poses.states, payload)
    return replace(poses, T_instr_ee=T, states=states)


def _fit_record(general: GeneralCalibration) -> dict[str, Any]:
    """Return how a fit ended, its parameters, and what it takes to build it again."""
    found, problem, model = general.fit, general.problem, fitted(general)
    return {
        "status": "converged" if found.converged else "not converged",
        "reason": found.reason,
        "cost": found.cost,
        "dof": found.dof,
        "iterations": found.iterations,
        "scatter": found.scatter,
        "parameters": _parameters(general, model),
        "covariance": {
            "names": [parameter.name for parameter in problem.parameters],
            "matrix": found.covariance.tolist(),
        },
        "T_instr_base": model.T_instr_base.tolist(),
        "solved": {
            "links": [parameter.name for parameter in general.unknowns.links.parameters],
            "springs": [
                {"joint": term.joint, "tau_ref_Nm": term.tau_ref_Nm}
                for term in problem.model.terms
                if isinstance(term, JointSpring)
            ],
            "tool": [parameter.name for parameter in general.unknowns.tool.parameters],
            "x": model.x.tolist(),
            "places_m": model.places_m.tolist(),
            "R_ee_target": model.R_ee_target.tolist(),
        },
    }


def _parameters(general: GeneralCalibration, model: FittedModel) -> dict[str, dict[str, Any]]:
    """Return every parameter with value, standard uncertainty, unit and tolerance."""
    problem, found = general.problem, general.fit
    parameters = problem.parameters
    openly = not_identifiable(found.identifiability, parameters)
    report = model.model.report(model.x)
    count = len(model.x)
    covariance = report.jacobian @ found.covariance[:count, :count] @ report.jacobian.T
    records = {}
    solved_of = np.abs(report.jacobian) > 0
    for k, parameter in enumerate(report.parameters):
        sources = [parameters[j].name for j in np.flatnonzero(solved_of[k])]
        if parameter.name.startswith("K_cub"):
            continue  # springs are linear here
        records[parameter.name] = {
            "value": float(report.values[k]),
            "std": float(np.sqrt(covariance[k, k])),
            "unit": parameter.unit,
            "tolerance": parameter.tolerance,
            "identifiable": not openly.intersection(sources),
            "at_bound": any(found.at_bound[j] for j in np.flatnonzero(solved_of[k])),
        }
    records |= _base_records(general, model)
    everywhere = place_parameters(problem.seen)
    for column, k in enumerate(problem.places, start=len(found.x) - len(problem.places)):
        name = everywhere[k].name
        records[name] = {
            "value": float(found.x[column]),
            "std": float(np.sqrt(found.covariance[column, column])),
            "unit": "m",
            "tolerance": None,
            "identifiable": name not in openly,
            "at_bound": False,
        }
    for settled in general.settled:
        records[settled.parameter.name] = {
            "value": 0.0,
            "std": settled.std,
            "unit": "rad",
            "tolerance": settled.parameter.tolerance,
            "identifiable": True,
            "at_bound": False,
            "settled": True,
        }
    for record in records.values():
        if not record["identifiable"]:
            record["std"] = record["tolerance"]
    return records


def _base_records(general: GeneralCalibration, model: FittedModel) -> dict[str, dict[str, Any]]:
    """Return the base frame's parameters; of a distance only the fixed point's place."""
    names = [parameter.name for parameter in general.unknowns.base.parameters]
    base = report_base(model.T_instr_base)
    every = ["base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz"]
    first = len(model.x)
    covariance = np.zeros((6, 6))
    at = [every.index(name) for name in names]
    width = slice(first, first + len(names))
    covariance[np.ix_(at, at)] = general.fit.covariance[width, width]
    # The motions are along axes of the base as it was put; those of the report the instrument's.
    along = np.eye(6)
    along[:3, :3] = general.problem.T_instr_base[:3, :3]
    jacobian = base.jacobian @ along
    std = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    told = len(names) == len(every)
    return {
        parameter.name: {
            "value": float(value),
            "std": float(sigma),
            "unit": parameter.unit,
            "tolerance": None,
            "identifiable": told or parameter.unit == "m",
            "at_bound": False,
        }
        for parameter, value, sigma in zip(base.parameters, base.values, std, strict=True)
    }


def _by_load(accuracies: dict[float, Accuracy]) -> dict[str, dict[str, Any]]:
    return {f"{load:g}N": asdict(accuracy) for load, accuracy in accuracies.items()}


def _residual_records(case: GeneralCase) -> list[dict[str, Any]]:
    """Return place, position and rotation residual of every grid pose, along base axes."""
    model = fitted(case.full)
    place_mm = 1e3 * model.model.predict(case.grid.states, model.x)[:, :3, 3]
    turned = case.residuals.rotation_deg
    return [
        {
            "pose": str(pose),
            "load_N": float(load),
            "place_mm": place_mm[k].tolist(),
            "position_mm": case.residuals.vector_mm[k].tolist(),
            "rotation_deg": None if turned is None else turned[k].tolist(),
        }
        for k, (pose, load) in enumerate(zip(case.grid.pose, case.grid.states.load_N, strict=True))
    ]


def _warnings(case: GeneralCase) -> list[str]:
    """Return what a reader should know before trusting the fit."""
    found = []
    if not case.full.fit.converged:
        found.append(f"not converged: {case.full.fit.reason}")
    if case.health.verdict != "good":
        found.append(case.health.line)
    if case.full.torques_from == "masses" and case.full.springs:
        found.append("torques were not logged: those of the described masses stand for them")
    return found
