"""Everything that is computed with the general model for one load case."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from pa10cal.arm.chain import BASE
from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array
from pa10cal.calibration import uncertainty
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.general.calibrate import GeneralCalibration, base_motion, calibrate_general
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.general.other_campaign import (
    calibrate_from,
    prior_of,
    refuse_own_readings,
)
from pa10cal.calibration.health import RIGID, GradeEvidence, health
from pa10cal.calibration.load_case import LoadCase, base_parameters, case_keys, fit_keys
from pa10cal.calibration.rules import GRADES, GROUPS, RECORDS, UNKNOWNS
from pa10cal.errors import CalibrationError
from pa10cal.fit.angles_seen import angles_seen
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import not_identifiable
from pa10cal.fit.loads import with_loads_read_by, with_torques
from pa10cal.fit.problem import Problem
from pa10cal.fit.robust_weights import keep_their_distances, suspect_beyond
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.order import with_arrivals
from pa10cal.observe.quantities import Start
from pa10cal.results import calibration as records
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OF, about_moved_base, motion_of_base
from pa10cal.terms.term import Report

# Poses that a fit doubts, each with why; they stay in it, with less weight.


def suspected_outliers(
    problem: Problem, fit: GeneralSolution
) -> tuple[records.SuspectedOutlier, ...]:
    """List the poses a fit doubts, the worst first."""
    limit = suspect_beyond(problem.components_seen)
    rows = np.flatnonzero((fit.distance > limit) | (fit.weights < RECORDS.little_weight))
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    acquitted = keep_their_distances(problem.observations.measured.places_m)
    found = []
    for row in rows[np.argsort(-fit.distance[rows])].tolist():
        why = []  # the kind of component that deviates most is said
        for kind, columns in problem.observations.measured.component_kinds:
            off = float(np.linalg.norm(fit.residual[row, columns]))
            turns = kind.startswith("attitude")
            text = f"{np.degrees(off):.3f} deg" if turns else f"{1e3 * off:.3f} mm"
            times = off / np.sqrt(fit.scatter[kind] ** 2 + variances[row, columns].mean())
            why.append((times, f"{kind} off by {text}, {times:.0f} times the scatter of one axis"))
        rigid = f"; {RIGID}" if acquitted[row] else ""
        found.append(
            records.SuspectedOutlier(
                row=row,
                pose=str(problem.observations.pose[row]),
                load_N=float(problem.observations.states.load_N[row]),
                distance=float(fit.distance[row]),
                weight=float(fit.weights[row]),
                why=max(why)[1] + rigid,
            )
        )
    return tuple(found)


def general_case(
    case: LoadCase, start: Start
) -> tuple[records.GeneralCalibrationRecord, GeneralCalibration]:
    """Compute a load case with every parameter that arm and instrument can identify.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, the arm as described
            does not fit the readings at all, or the prior is of another arm or of these readings.
    """
    arm, every, options, prior = case.arm, case.every, case.options, case.prior
    if prior is not None:  # effects of it may need to know from where a joint arrived
        every, _ = with_arrivals(every, arm)
    single, payload = every.of_kind("grid"), case.payload
    grid, held_out = average_repeats(single), average_repeats(every.of_kind("holdout"))
    rows = case.rows(grid.states.load_N)
    used, rigid = grid.take(rows), options.with_springs(())
    if prior is not None:
        refuse_own_readings(prior, used, case.campaign)
    nominal = calibrate_general(arm, used, start, payload, rigid, links=False)
    if prior is None:
        full = calibrate_general(arm, used, start, payload, options)
    else:
        expected = prior_of(prior, arm, payload)
        full = calibrate_from(expected, arm, used, start, payload, options)
    # Without springs: the whole where it has none, and the frames alone where it had a prior.
    geometry = full if prior is None else nominal
    if full.springs and prior is None:
        geometry = calibrate_general(arm, used, start, payload, rigid)
    calibrated, load_N = fitted(full), grid.states.load_N

    def weighed(poses: Observations) -> Observations:
        states, _ = with_torques(calibrated.model, calibrated.x, poses.states, payload)
        return poses.with_states(with_loads_read_by(calibrated.model.terms, states))

    grid = weighed(grid)
    found = calibrated.deviations(grid)
    noise_mm = uncertainty.position_noise_mm(used.measured, full.problem.stated_covariance)
    left_mm = uncertainty.summarise(found.take(rows)).rms_mm
    _refuse_another_arm(full, left_mm, used.measured.spread_mm, noise_mm)
    off = None
    if len(held_out):
        held_out = weighed(held_out)
        elsewhere = replace(full.problem, observations=held_out.turned(start.R_ee_target))
        position = uncertainty.of_one_target(held_out.measured, elsewhere.rows(full.fit.x).jacobian)
        off = uncertainty.held_out_errors(
            calibrated, every, used, held_out, position, full.fit.covariance
        )
    doubts, known = suspected_outliers(full.problem, full.fit), weights_known(arm)
    flagged = np.zeros(len(grid), dtype=bool)
    flagged[np.flatnonzero(rows)[[doubt.row for doubt in doubts]]] = True
    trusted = np.flatnonzero(rows & ~flagged)
    group = per_campaign_fits(full.problem, full.fit)
    findings = case.findings
    if group is not None:
        zeros = names_of(full.problem.parameters, full.problem.having("zero"))
        findings = (*findings, *contradictions(group, zeros))
    rigid_left = fitted(geometry).deviations(grid)
    of_nominal = fitted(nominal).deviations(grid)
    readings = single.take(case.rows(single.states.load_N))
    evidence = GradeEvidence(
        ended=_fit_summary(full),
        train_rms_mm=uncertainty.summarise(found.take(trusted)).rms_mm,
        held_out=off,
        noise_mm=noise_mm,
        spread_mm=used.measured.spread_mm,
        suspected_outliers=len(doubts),
        acquitted=sum(RIGID in doubt.why for doubt in doubts),
        all_rms_mm=left_mm,
        repeats=uncertainty.scatter_of_repeats(readings, calibrated),
        from_touches=readings.measured.from_touches,
        findings=findings,
        without_springs_mm=None
        if geometry is full
        else uncertainty.summarise(rigid_left.take(trusted)).rms_mm,
        weights=known.origin if known.assumed and full.springs else "",
        com_u_m=payload.com_u_m if payload is not None and full.springs else None,
        wanted_mm=options.wanted_uncertainty_mm,
        nominal_mm=uncertainty.summarise(of_nominal.take(trusted)).rms_mm,
        arm=arm,
        turned_rad=_turned_rad(calibrated, used),
    )
    judged = health(evidence)
    about = FittedTo.of(full.problem.observations, case.load, judged, case.campaign)
    before = uncertainty.summarise_by_load(of_nominal, load_N)
    less = uncertainty.summarise_trusted(of_nominal, found, load_N, flagged)
    of_geometry = uncertainty.summarise_by_load(rigid_left, load_N)
    warnings = []
    if not full.fit.converged:
        warnings.append(f"not converged: {full.fit.reason}")
    if judged.grade != "good":
        warnings.append(judged.line)
    if full.torques_from == "masses" and full.springs:
        of_weights = "assumed weights" if known.assumed else "the described masses"
        warnings.append(f"torques were not logged: those of {of_weights} are used")
    if full.unproven:
        of = f"joint{'s' * (len(full.unproven) > 1)} {', '.join(map(str, full.unproven))}"
        warnings.append(
            f"no spring in {of}: the poses fitted show one, but it does not help to predict "
            "clusters and stretches of poses that are held out"
        )
    record = records.GeneralCalibrationRecord(
        **case_keys(case, evidence.ended, judged, replace(calibrated, fitted_to=about), grid),
        **_general_fit_keys(full, about),
        starts=1,
        starts_agreeing=1,
        redundant=full.redundant,
        springs=full.springs,
        torques_from=full.torques_from,
        errors={
            load: records.LoadErrors(
                before=before[load], geometry=of_geometry[load], after=after, trusted=less.get(load)
            )
            for load, after in uncertainty.summarise_by_load(found, load_N).items()
        },
        geometry=records.Fit(**_general_fit_keys(geometry, about)),
        nominal=records.Fit(**_general_fit_keys(nominal, about)),
        suspected_outliers=doubts,
        group=group,
        prior=full.prior,
        warnings=tuple(warnings),
    )
    return record, full


def as_load(
    record: records.GeneralCalibrationRecord, load: str
) -> records.GeneralCalibrationRecord:
    """Return the record of a load case under the name of another of the same poses."""

    def renamed(fit: records.Fit) -> dict[str, Any]:
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


def _turned_rad(model: FittedModel, poses: Observations) -> float:
    """Return the largest turn of the end-effector from its first pose [rad]."""
    R = model.nominal().as_read(poses)[:, :3, :3]
    cosine = 0.5 * (np.einsum("ij,pij->p", R[0], R) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())


def _general_fit_keys(general: GeneralCalibration, about: FittedTo) -> dict[str, Any]:
    model = replace(fitted(general), fitted_to=about)
    model = replace(model, discrepancy=discrepancy_of(model, general.problem.observations))
    names = [parameter.name for parameter in general.problem.parameters]
    parameters, covariance = _parameters(general, model), general.fit.covariance
    return fit_keys(general.fit, model, parameters, names, covariance)


def _parameters(
    general: GeneralCalibration, model: FittedModel
) -> dict[str, records.CalibratedParameter]:
    problem, found, count = general.problem, general.fit, len(model.x)
    assert model.covariance is not None
    openly = not_identifiable(found.identifiability, problem.parameters)
    is_open = np.array([parameter.name in openly for parameter in problem.parameters])
    report = model.model.report(model.x)
    sources = np.abs(report.jacobian) > 0
    held, at_bound = (
        names_of(report.parameters, np.asarray((sources & of_solved[:count]).any(axis=1)))
        for of_solved in (is_open, found.at_bound)
    )
    of_model = uncertainty.calibrated_parameters(
        report, found.covariance[:count, :count], held, at_bound, model.model.u_scale
    )
    first = len(found.x) - len(problem.places)
    places = Report(problem.parameters[first:], found.x[first:], np.eye(len(problem.places)))
    linear = {name: each for name, each in of_model.items() if name not in report.zero}
    # Of a distance only the fixed point's place is known, not the orientation of the base.
    whole = len(problem.model.terms[-1].coordinates) == len(BASE)
    base = base_parameters(
        model.T_instr_base,
        model.covariance[-6:, -6:],
        problem.T_instr_base[:3, :3],
        () if whole else ("gamma_x", "gamma_y", "gamma_z"),
    )
    return {
        **linear,  # as springs are here
        **base,
        **uncertainty.calibrated_parameters(places, found.covariance[first:, first:], openly),
        **general.settled,
    }


def _refuse_another_arm(
    general: GeneralCalibration, left_mm: float, spread_mm: float, noise_mm: float | None
) -> None:
    rank = general.fit.identifiability.rank
    if rank and left_mm < max(
        GRADES.no_fit_general_share * spread_mm, GRADES.stated_ratio * (noise_mm or 0.0)
    ):
        return
    raise CalibrationError(
        "the arm as described does not fit the readings",
        where=general.arm.name,
        value=f"{left_mm:.1f} mm rms remain; the measured positions spread by {spread_mm:.0f} mm",
        allowed=f"errors below {100 * GRADES.no_fit_general_share:.0f} % of that spread",
        remedy="check robot, order, signs and zeros of the joints, and units",
    )


def fitted(general: GeneralCalibration) -> FittedModel:
    """Return a calibrated model with its base motions taken into the base frame."""
    problem, x = general.problem, general.fit.x
    model = Model(problem.model.chain, problem.model.terms[:-1])
    of_model = problem.of_model(x)
    count = len(model.parameters)
    small = base_motion(problem.model, of_model[count:])
    of_base = [count + BASE.index(name) for name in problem.model.terms[-1].coordinates]
    rows = np.array([*range(count), *of_base], dtype=np.intp)
    covariance = np.zeros((count + len(BASE),) * 2)
    covariance[np.ix_(rows, rows)] = general.fit.covariance[: len(rows), : len(rows)]
    return FittedModel(
        model=model,
        x=about_moved_base(model.terms, of_model[:count], small),
        T_instr_base=problem.T_instr_base @ motion_of_base(small),
        R_ee_target=general.start.R_ee_target,
        R_first_target_of=problem.observations.measured.R_first_target_of,
        targets_m=problem.places_at(x),
        target_names=problem.observations.measured.target_names,
        covariance=covariance,
        payload=general.payload,
        seen=angles_seen(problem.observations.states.q_rad),
    )


def _fit_summary(general: GeneralCalibration) -> FitSummary:
    fit, problem = general.fit, general.problem
    parameters = problem.parameters
    openly = not_identifiable(fit.identifiability, parameters)
    hidden: frozenset[str] = frozenset()
    payload, assumed = general.payload, weights_known(general.arm).assumed
    if assumed:
        # What poses leave open of weights that nobody stated is no lack of poses. It goes with the
        # springs by a little, and these with it: not those whose sag poses show all the same.
        std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        windup = problem.having("windup")
        openly -= {*names_of(parameters, windup & np.less(std, GRADES.shown_share * fit.x))}
    if assumed or (payload is not None and payload.com_u_m is not None):
        # Neither is a spring that goes with them: the next campaign may do without it.
        hidden = frozenset(names_of(parameters, problem.having("weight", "windup", "cubic")))
    root, jacobian = np.sqrt(fit.weights)[:, None, None], problem.rows(fit.x).jacobian
    measured = problem.observations.measured
    position_gram = uncertainty.gram(uncertainty.of_one_target(measured, jacobian))
    return FitSummary(
        solution=fit,
        pose=problem.observations.pose,
        parameters=parameters,
        roles=problem.roles,
        departures=problem.model.departures,
        covariance=fit.covariance,
        identifiability=fit.identifiability,
        white=(root * fit.whitener) @ jacobian,
        position_gram=position_gram,
        not_identifiable=openly,
        hidden=hidden,
    )


# What each campaign of a group says alone of the parameters that all share.
#
# Linear about the fit of the group: the rows of one campaign, with its own frames free, give the
# parameters that it would give alone, in the unknowns of the group. Directions that it does not
# determine stay where the group has them, within the reach of the unknowns, and count for nothing.

#: Of a parameter, as it is shown, and the factor to it (unit).
_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


def contradictions(
    group: records.GroupOfCampaigns, zeros: Collection[str]
) -> tuple[InputFinding, ...]:
    """Return which campaign contradicts the others, in which parameter and by how much.

    Of several the one from which most of the error comes: a changed arm changes one campaign
    against all others, and every other against those.

    Args:
        zeros: names of the parameters that are zeros of joints.
    """
    found = {name: each for name, each in group.campaigns.items() if each.contradicts}
    if not found:
        return ()
    first = max(found, key=lambda name: found[name].chi_square)
    alone, worst = found[first], found[first].worst
    unit, scale = _SHOWN_UNITS.get(worst.unit, (worst.unit, 1.0))
    others = " and ".join(name for name in group.campaigns if name != first)
    return (
        InputFinding(
            what=f"{first} and {others} contradict each other: it differs by "
            f"{scale * abs(worst.value):.3g} {unit} with a standard uncertainty of "
            f"{scale * worst.std:.2g} {unit} (chi-square {alone.chi_square:.0f} for "
            f"{alone.dof:.0f} degrees of freedom, {worst.chi_square:.0f} of it by this "
            "parameter alone): the arm was changed between them",
            where=worst.name,
            remedy="calibrate the campaigns before and after the change apart, and compare them",
            kind="joint_zero" if worst.name in zeros else "campaigns",
        ),
    )


def per_campaign_fits(problem: Problem, fit: GeneralSolution) -> records.GroupOfCampaigns | None:
    """Compare the campaigns of a group; None for a single campaign, or where nothing is shared."""
    campaign = problem.observations.states.campaign
    names = [parameter.name for parameter in problem.parameters]
    free = np.flatnonzero(~fit.at_bound)
    last = {parameter.name for parameter in problem.model.terms[-1].parameters}
    shared = [j for j, k in enumerate(free) if OF not in names[k] and names[k] not in last]
    if campaign is None or not shared:
        return None
    here, parameters = np.ix_(shared, shared), [problem.parameters[k] for k in free[shared]]
    reach = reach_of(problem)[free]
    size = reach[shared]
    root = np.sqrt(fit.weights)[:, None, None] * fit.whitener
    jacobian = problem.rows(fit.x).jacobian[:, :, free]
    rows_of = [
        np.flatnonzero(campaign == k) for k in range(len(problem.observations.measured.campaigns))
    ]
    of_each = []  # what each campaign says of steps of the free unknowns, in reaches
    for at in rows_of:
        white = (root[at] @ jacobian[at] * reach).reshape(-1, len(free))
        left = np.einsum("pij,pj->pi", root[at], fit.residual[at]).ravel()
        of_each.append(Gaussian.of(white, -left))
    positions = problem.observations.measured.position_columns

    def of_parts(parts: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return the step of these campaigns, and its covariance with the reach and by noise."""
        said = sum((of_each[k] for k in parts), Gaussian.none(len(free)))
        inverse = said.covariance
        return said.mean, inverse, inverse @ said.gram @ inverse

    campaigns, std_alone = {}, {}
    for number, (name, _) in enumerate(problem.observations.measured.campaigns):
        at = rows_of[number]
        step, inverse, sampled = of_parts([number])
        others = of_parts([k for k in range(len(rows_of)) if k != number])
        after = fit.residual[at] + jacobian[at] @ (reach * step)
        rms_mm, alone_rms_mm = (
            1e3 * float(np.sqrt(np.average(squares, weights=fit.weights[at])))
            for left in (fit.residual[at], after)
            for squares in (np.sum(left[:, positions] ** 2, axis=1),)
        )
        # Chi-square of the shared parameters, and the one that explains most of it.
        off = (step - others[0])[shared]
        precision = np.linalg.inv((inverse + others[1])[here])
        pull = precision @ off
        chi_square = float(off @ pull)
        dof = float(np.trace(precision @ (sampled + others[2])[here]))
        by_one = pull**2 / np.diag(precision)
        k = int(np.argmax(by_one))
        p_value = float(chdtrc(dof, chi_square)) if dof > 0.0 else 1.0
        gain = 1.0 - (alone_rms_mm / rms_mm) ** 2 if rms_mm > 0.0 else 0.0
        campaigns[name] = records.CampaignAlone(
            poses=len(at),
            rms_mm=rms_mm,
            alone_rms_mm=alone_rms_mm,
            chi_square=chi_square,
            dof=dof,
            p_value=p_value,
            contradicts=p_value < GROUPS.chance_rate and gain > GROUPS.matters_share,
            worst=records.Difference(
                name=parameters[k].name,
                unit=parameters[k].unit,
                value=float(size[k] * pull[k] / precision[k, k]),
                std=float(size[k] / np.sqrt(precision[k, k])),
                chi_square=float(by_one[k]),
            ),
        )
        std_alone[name] = np.sqrt(np.diag(inverse)[shared])
    std = np.sqrt(np.diag(fit.covariance)[free[shared]])
    return records.GroupOfCampaigns(
        campaigns=campaigns,
        parameters={
            parameter.name: records.SharedParameter(
                unit=parameter.unit,
                std=float(std[k]),
                std_alone={name: float(size[k] * own[k]) for name, own in std_alone.items()},
                determined_by=tuple(
                    n for n, own in std_alone.items() if own[k] < UNKNOWNS.determined_share
                ),
            )
            for k, parameter in enumerate(parameters)
        },
    )
