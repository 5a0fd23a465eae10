"""What a fit of the general model gives: the fitted model, its parameters, what it identified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, Mask
from pa10cal.calibration import uncertainty
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.general.calibrate import GeneralCalibration, base_motion
from pa10cal.calibration.load_case import base_parameters
from pa10cal.calibration.rules import GRADES
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import of_one_target
from pa10cal.fit.problem import not_identifiable
from pa10cal.fit.validity import angles_seen
from pa10cal.observe.observations import Observations
from pa10cal.results import calibration as records
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import motion_of_base
from pa10cal.terms.term import Report
from pa10cal.terms.wrapped import about_moved_base


def fitted(general: GeneralCalibration) -> FittedModel:
    """Return the fitted model, with the small motions of the base moved into the base frame."""
    problem, x = general.problem, general.fit.x
    model = Model(problem.model.chain, problem.model.terms[:-1])
    of_model = problem.of_model(x)
    count = len(model.parameters)
    small = base_motion(problem.model, of_model[count:])
    return FittedModel(
        model=model,
        x=about_moved_base(model.terms, of_model[:count], small),
        T_instr_base=problem.T_instr_base @ motion_of_base(small),
        R_ee_target=general.start.R_ee_target,
        R_first_target_of=problem.observations.measured.R_first_target_of,
        targets_m=problem.places_at(x),
        target_names=problem.observations.measured.target_names,
        covariance=_of_model_and_frames(general, general.fit.covariance),
        payload=general.payload,
        seen=angles_seen(problem.observations.states.q_rad),
    )


def _of_model_and_frames(general: GeneralCalibration, covariance: Array) -> Array:
    """Return a covariance of the unknowns (k, k) as one of a model: see `Fitted.covariance`."""
    problem = general.problem
    *terms, of_base = problem.model.terms
    count = len(Model(problem.model.chain, tuple(terms)).parameters)
    of_targets = count + len(BASE) + problem.places
    rows = [*range(count), *(count + BASE.index(name) for name in of_base.coordinates), *of_targets]
    whole = np.zeros((count + len(BASE) + len(problem.places_m),) * 2)
    whole[np.ix_(rows, rows)] = covariance
    return whole


def with_discrepancy(
    general: GeneralCalibration,
    readings: Observations | None = None,
    model: FittedModel | None = None,
) -> FittedModel:
    """Return the fitted model with what it lacks.

    Args:
        readings: single readings of its poses, by which the repeatability of the arm is found; None
            where it is not to be.
        model: the fitted model with weights by the log; None for it as it was fitted.
    """
    model = model or fitted(general)
    poses, expected = general.problem.observations, general.fit.span.expected
    single = None if readings is None else model.as_modelled(readings)
    return replace(model, discrepancy=discrepancy_of(model, poses, expected, readings=single))


def fit_summary(general: GeneralCalibration) -> FitSummary:
    """Return what a fit of the general model identified, and how well."""
    fit, problem = general.fit, general.problem
    parameters = problem.parameters
    unidentified = not_identifiable(fit.identifiability, parameters)
    hidden: frozenset[str] = frozenset()
    payload, assumed = general.payload, weights_known(general.arm).assumed
    if assumed:
        # More poses do not determine weights that nobody stated, so these do not count. Springs and
        # lengths are correlated with them; a spring counts as identified if its windup is known all
        # the same, another unknown if it is known to a part of its typical size.
        std = np.sqrt(np.maximum(np.diag(general.covariance_of_each), 0.0))
        of_windup, of_weights = problem.having("windup"), problem.having("weight")
        size = np.where(of_windup, fit.x, fit.scale)
        known = ~of_weights & np.less(std, GRADES.shown_share * size)
        unidentified -= {*names_of(parameters, known)}
    if assumed or (payload is not None and payload.com_u_m is not None):
        # Nor do springs that only weights leave undetermined: another campaign may find none.
        hidden = frozenset(names_of(parameters, problem.having("weight", "windup", "cubic")))
    root, jacobian = np.sqrt(fit.weights)[:, None, None], problem.rows(fit.x).jacobian
    measured = problem.observations.measured
    return FitSummary(
        solution=fit,
        pose=problem.observations.pose,
        parameters=parameters,
        roles=problem.roles,
        departures=problem.model.departures,
        covariance=general.covariance_of_each,
        of_positions=fit.covariance,
        identifiability=fit.identifiability,
        white=(root * fit.whitener) @ jacobian,
        position=of_one_target(measured, jacobian),
        not_identifiable=unidentified,
        hidden=hidden,
        expected=fit.span.expected,
    )


def parameters_of(
    general: GeneralCalibration, model: FittedModel
) -> dict[str, records.CalibratedParameter]:
    """Return every parameter with value, standard uncertainty, unit and tolerance."""
    problem, found, count = general.problem, general.fit, len(model.x)
    covariance = general.covariance_of_each
    unidentified = not_identifiable(found.identifiability, problem.parameters)
    report = model.model.report(model.x)
    depends = np.abs(report.jacobian) > 0  # reported parameters on those solved, (r, k)

    def depending_on(solved: Mask) -> tuple[str, ...]:
        return names_of(report.parameters, np.asarray((depends & solved[:count]).any(axis=1)))

    held = depending_on(np.array([each.name in unidentified for each in problem.parameters]))
    at_bound = depending_on(found.at_bound)
    of_model = uncertainty.calibrated_parameters(
        report, covariance[:count, :count], held, at_bound, model.model.u_scale
    )
    first = len(found.x) - len(problem.places)
    places = Report(problem.parameters[first:], found.x[first:], np.eye(len(problem.places)))
    not_zero = {name: each for name, each in of_model.items() if name not in report.zero}
    # Distances determine the place of the fixed point, not the orientation of the base.
    whole = len(problem.model.terms[-1].coordinates) == len(BASE)
    of_base = slice(count, count + len(BASE))
    base = base_parameters(
        model.T_instr_base,
        _of_model_and_frames(general, covariance)[of_base, of_base],
        problem.T_instr_base[:3, :3],
        () if whole else ("gamma_x", "gamma_y", "gamma_z"),
    )
    return {
        **not_zero,  # the cubic coefficients of linear springs are zero
        **base,
        **uncertainty.calibrated_parameters(places, covariance[first:, first:], unidentified),
        **general.settled,
    }
