"""`calibration/<load>.json` of the general model."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pa10cal.calibration.general.apart import Apart
from pa10cal.calibration.general.calibrate import GeneralCalibration
from pa10cal.calibration.general.case import GeneralCase, fitted
from pa10cal.calibration.levels import report_base
from pa10cal.calibration.records import by_load, fitted_to, reported_keys
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import not_identifiable, observability
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results.calibration import (
    CalibratedParameter,
    CampaignAlone,
    Covariance,
    Difference,
    Fit,
    GeneralCalibrationRecord,
    GeneralErrors,
    GeneralFit,
    GroupOfCampaigns,
    Moved,
    PriorPart,
    Redundant,
    SharedParameter,
    Solved,
    Spring,
)
from pa10cal.results.evaluation import ResidualRows
from pa10cal.results.record import Campaign
from pa10cal.terms.joint_spring import JointSpring

if TYPE_CHECKING:
    from pa10cal.calibration.options import CalibrationOptions

_BASE = ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")


def general_record(
    case: GeneralCase, campaign: Campaign, settings: CalibrationOptions
) -> GeneralCalibrationRecord:
    """Return the record of a load case computed with the general model.

    Args:
        case: the load case.
        campaign: whose it is.
        settings: what it was computed with.
    """
    full = case.full
    identifiability = full.fit.identifiability
    load_N = full.problem.observations.states.load_N
    before, geometry = by_load(case.before), by_load(case.geometry_after)
    about = fitted_to(full.problem.observations, case.load, case.health, campaign)
    return GeneralCalibrationRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        robot=campaign.robot,
        load=case.load,
        loads_fitted=tuple(np.unique(load_N).tolist()),
        **_fit_keys(full, about),
        starts=1,
        starts_agreeing=1,
        rank=identifiability.rank,
        unknowns=len(full.problem.parameters),
        condition=identifiability.condition,
        singular_values=identifiability.singular_values,
        null_directions=tuple(each.weights for each in case.unidentified_directions),
        redundant=tuple(
            Redundant(name=each.name, replaced_by=each.replaced_by)
            for each in full.unknowns.redundant
        ),
        observability=observability(identifiability, len(load_N)),
        springs=full.springs,
        torques_from=full.torques_from,
        errors={
            load: GeneralErrors(before=before[load], geometry=geometry[load], after=after)
            for load, after in by_load(case.after).items()
        },
        before_is="nominal arm, base and tool fitted",
        geometry=GeneralFit(**_fit_keys(case.geometry, about)),
        nominal=GeneralFit(**_fit_keys(case.nominal, about)),
        residuals=_residuals(case),
        suspected_outliers=case.suspected_outliers,
        group=None if case.apart is None else _group(case.apart),
        health=case.health,
        prior=None
        if full.moved is None
        else PriorPart(
            campaign=full.moved.campaign,
            moved=tuple(Moved(**asdict(each)) for each in full.moved.releases),
            factor=full.moved.factor,
            line=full.moved.line,
        ),
        warnings=_warnings(case),
        seconds=None,
        settings=settings.model_dump(mode="json"),
    )


def as_load(record: GeneralCalibrationRecord, load: str) -> GeneralCalibrationRecord:
    """Return the record of a load case under the name of another of the same poses."""

    def renamed(fit: Fit) -> dict[str, Any]:
        known: Any = fit.fitted_model.get("fitted_to")
        about = None if known is None else {**known, "calibration": load}
        return {"fitted_model": {**fit.fitted_model, "fitted_to": about}}

    return record.model_copy(
        update={
            "load": load,
            "geometry": record.geometry.model_copy(update=renamed(record.geometry)),
            "nominal": record.nominal.model_copy(update=renamed(record.nominal)),
            **renamed(record),
        }
    )


def _fit_keys(general: GeneralCalibration, about: FittedTo) -> dict[str, Any]:
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
        "covariance": Covariance(
            names=tuple(parameter.name for parameter in problem.parameters),
            matrix=found.covariance,
        ),
        "T_instr_base": model.T_instr_base,
        "fitted_model": model_to_plain(replace(model, fitted_to=about)),
        "solved": Solved(
            links=tuple(parameter.name for parameter in general.unknowns.links.parameters),
            springs=tuple(
                Spring(joint=term.joint, tau_ref_Nm=term.tau_ref_Nm)
                for term in problem.model.terms
                if isinstance(term, JointSpring)
            ),
            tool=general.unknowns.frame_names,
            x=model.x,
            places_m=model.targets_m,
            R_ee_target=model.R_ee_target,
        ),
    }


def _parameters(general: GeneralCalibration, model: FittedModel) -> dict[str, CalibratedParameter]:
    """Return every parameter with value, standard uncertainty, unit and tolerance."""
    problem, found = general.problem, general.fit
    openly = not_identifiable(found.identifiability, problem.parameters)
    report = model.model.report(model.x)
    count = len(model.x)
    solved_of = np.abs(report.jacobian) > 0
    keys = reported_keys(report, found.covariance[:count, :count])
    records = {}
    for name, sources in zip(keys, solved_of, strict=True):
        if name.startswith("K_cub"):
            continue  # springs are linear here
        solved = np.flatnonzero(sources)
        records[name] = _parameter(
            keys[name],
            identifiable=not openly.intersection(problem.parameters[j].name for j in solved),
            at_bound=any(bool(found.at_bound[j]) for j in solved),
        )
    records |= _base_parameters(general, model)
    everywhere = problem.measured.target_parameters
    for column, k in enumerate(problem.places, start=len(found.x) - len(problem.places)):
        name = everywhere[k].name
        place = {
            "value": float(found.x[column]),
            "std": float(np.sqrt(found.covariance[column, column])),
            "unit": "m",
            "tolerance": None,
        }
        records[name] = _parameter(place, identifiable=name not in openly)
    for settled in general.settled:
        records[settled.parameter.name] = CalibratedParameter(
            value=0.0,
            std=settled.std,
            unit="rad",
            tolerance=settled.parameter.tolerance,
            identifiable=True,
            at_bound=False,
            settled=True,
        )
    return records


def _base_parameters(
    general: GeneralCalibration, model: FittedModel
) -> dict[str, CalibratedParameter]:
    """Return the base frame's parameters; of a distance only the fixed point's place."""
    names = [parameter.name for parameter in general.unknowns.base.parameters]
    base = report_base(model.T_instr_base)
    first = len(model.x)
    covariance = np.zeros((6, 6))
    at = [_BASE.index(name) for name in names]
    width = slice(first, first + len(names))
    covariance[np.ix_(at, at)] = general.fit.covariance[width, width]
    # The motions are along axes of the base as it was put; those of the report the instrument's.
    along = np.eye(6)
    along[:3, :3] = general.problem.T_instr_base[:3, :3]
    whole = len(names) == len(_BASE)
    return {
        name: _parameter(keys, identifiable=whole or keys["unit"] == "m")
        for name, keys in reported_keys(base, along @ covariance @ along.T).items()
    }


def _parameter(
    keys: dict[str, Any], *, identifiable: bool, at_bound: bool = False
) -> CalibratedParameter:
    """Return a parameter; with its tolerance as uncertainty where it is not identifiable."""
    held = {} if identifiable else {"std": keys["tolerance"]}
    return CalibratedParameter(**(keys | held), identifiable=identifiable, at_bound=at_bound)


def _residuals(case: GeneralCase) -> ResidualRows:
    """Return place, position and rotation residual of every grid pose, along base axes."""
    model = fitted(case.full)
    return ResidualRows(
        pose=case.grid.pose,
        load_N=case.grid.states.load_N,
        place_mm=1e3 * model.model.predict(case.grid.states, model.x)[:, :3, 3],
        position_mm=case.residuals.position_mm,
        rotation_deg=case.residuals.rotation_deg,
    )


def _group(apart: Apart) -> GroupOfCampaigns:
    """Return what each campaign of a group says alone."""
    shared = apart.shared
    return GroupOfCampaigns(
        campaigns={
            each.name: CampaignAlone(
                poses=each.poses,
                rms_mm=each.rms_mm,
                alone_rms_mm=each.alone_rms_mm,
                chi_square=each.chi_square,
                dof=each.dof,
                p_value=each.p_value,
                contradicts=each.contradicts,
                worst=Difference(
                    name=shared[each.worst].name,
                    unit=shared[each.worst].unit,
                    value=each.worst_off,
                    std=each.worst_u,
                    chi_square=each.worst_chi_square,
                ),
            )
            for each in apart.campaigns
        },
        parameters={
            parameter.name: SharedParameter(
                unit=parameter.unit,
                std=float(apart.std[k]),
                std_alone={each.name: float(each.std[k]) for each in apart.campaigns},
                determined_by=tuple(
                    each.name for each in apart.campaigns if bool(each.determined[k])
                ),
            )
            for k, parameter in enumerate(shared)
        },
    )


def _warnings(case: GeneralCase) -> tuple[str, ...]:
    """Return what a reader should know before trusting the fit."""
    found = []
    if not case.full.fit.converged:
        found.append(f"not converged: {case.full.fit.reason}")
    if case.health.grade != "good":
        found.append(case.health.line)
    if case.full.torques_from == "masses" and case.full.springs:
        found.append("torques were not logged: those of the described masses are used")
    return tuple(found)
