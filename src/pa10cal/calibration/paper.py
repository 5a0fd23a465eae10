"""The record of a load case with the paper's model: cubic and linear springs, errors, grade."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration import accuracy, uncertainty
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.health import health
from pa10cal.calibration.load_case import LoadCase, base_parameters, case_keys, fit_keys
from pa10cal.calibration.rules import GRADES, UNKNOWNS
from pa10cal.calibration.two_level_fit import Calibration, calibrate, pull_beyond_bounds
from pa10cal.calibration.two_level_problem import align_nominal
from pa10cal.errors import CalibrationError
from pa10cal.fit.discrepancy import discrepancy_of, lacking_mm
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_noise_mm
from pa10cal.fit.problem import identify_beyond, not_identifiable, possible_sizes
from pa10cal.fit.repeatability import repeatability_mm
from pa10cal.fit.validity import Discrepancy
from pa10cal.fit.weighed_arm import weighed_model
from pa10cal.observe.observations import Observations, average_repeats, poses_of
from pa10cal.observe.pose import Pose
from pa10cal.results import calibration as records
from pa10cal.results.calibration import Health, InputFinding
from pa10cal.terms.joint_spring import baseline, nominal, reported_name
from pa10cal.terms.term import Report


def paper_case(
    case: LoadCase, T_instr_base_seed: Array
) -> tuple[records.PaperCalibrationRecord, FittedModel]:
    """Compute a load case on two levels, with the paper's unknowns.

    Args:
        T_instr_base_seed: (4, 4) base frame by straight moves, for comparison, not as a start.

    Raises:
        CalibrationError: when the instrument measures no poses, no grid pose has that load, or
            there are too few of them.
    """
    campaign, arm, every, options = case.campaign, case.arm, case.every, case.options
    if not every.measured.measures_pose:
        raise CalibrationError(
            "the paper's model needs positions and orientations of one campaign",
            where="calibration.model",
            value=options.model,
            allowed=f"auto or general for {campaign.instrument_kinds}",
            remedy="set calibration.model to auto",
        )
    readings = poses_of(every, "grid", average=False)
    rows = case.rows(readings.states)
    chosen = readings.take(rows)
    grid, used = average_repeats(readings), average_repeats(chosen)
    u_apparatus_m = 1e-3 * options.apparatus_uncertainty_mm
    joints, tau_ref_Nm = options.flexible_joints, np.abs(used.states.tau_Nm).max(axis=0)

    def calibrated(*, cubic: bool) -> Calibration:
        model = baseline(arm, joints, options.tolerances, cubic=cubic, tau_ref_Nm=tau_ref_Nm)
        return calibrate(model, used, options, chosen, u_apparatus_m)

    cubic = calibrated(cubic=True)
    linear = calibrated(cubic=False) if joints else cubic
    load_N, payload, rigid = grid.states.load_N, case.payload, nominal(arm)
    stated = poses_of(every, "grid", average=False, covariance="instrument").take(rows)
    model, linear_model = (
        replace(each, discrepancy=_discrepancy_of(each, used, stated))
        for each in (weighed_model(fit.model(payload), chosen) for fit in (cubic, linear))
    )
    before, from_seed = (
        accuracy.summarise_by_load(FittedModel(rigid, np.zeros(0), T).deviations(grid), load_N)
        for T in (align_nominal(rigid, grid), T_instr_base_seed)
    )
    noise = uncertainty.with_own_scatter(used, chosen, model.model, model.x)
    evidence = replace(
        _evidence(case, cubic, noise, stated),
        discrepancy_mm=lacking_mm(model.discrepancy, used.states.q_rad),
    )
    found = health(evidence)
    about = FittedTo.of(used, case.load, found, campaign)
    model, linear_model = (replace(each, fitted_to=about) for each in (model, linear_model))
    from_seed_frame = np.linalg.inv(T_instr_base_seed) @ cubic.T_instr_base
    cosine = (np.trace(from_seed_frame[:3, :3]) - 1) / 2
    seed_angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    record = records.PaperCalibrationRecord(
        **case_keys(case, evidence.ended, found, model, grid),
        **_paper_fit_keys(cubic, model),
        errors={
            load: records.LoadErrors(
                before=before[load], before_seed_frame=from_seed[load], after=after
            )
            for load, after in accuracy.summarise_by_load(model.deviations(grid), load_N).items()
        },
        inner_poses=cubic.inner_poses,
        linear=records.LinearFit(
            **_paper_fit_keys(linear, linear_model),
            after=accuracy.summarise_by_load(linear_model.deviations(grid), load_N),
        ),
        warnings=_warnings(cubic, found, seed_angle_deg),
    )
    return record, model


def _discrepancy_of(
    model: FittedModel, used: Observations[Pose], stated: Observations[Pose]
) -> Discrepancy | None:
    """Return what a model lacks, by averaged poses, and by their readings with stated noise.

    The noise of the averaged poses is that of repeats already.
    """
    found = discrepancy_of(model, used)
    if found is None:
        return None
    of_repeats_mm = repeatability_mm(model, model.as_modelled(stated))
    return replace(found, repeatability_mm=of_repeats_mm)


def _paper_fit_keys(calibration: Calibration, model: FittedModel) -> dict[str, Any]:
    report = model.model.report(model.x)
    by_solved, of_solved = report.jacobian, calibration.covariance[:-6, :-6]
    names = [parameter.name for parameter in report.parameters]
    of_reported = by_solved @ of_solved @ by_solved.T
    parameters = parameter_records(calibration)
    return {
        **fit_keys(calibration.solution, model, parameters, names, of_reported),
        "starts": len(calibration.starts),
        "starts_agreeing": calibration.starts_agreeing,
    }


def parameter_records(calibration: Calibration) -> dict[str, records.CalibratedParameter]:
    """Return every parameter with value, standard uncertainty, unit and tolerance."""
    outer = calibration.level.model.report(calibration.solution.x)
    covariance, T_instr_base = calibration.covariance, calibration.T_instr_base
    held = frozenset(map(reported_name, calibration.not_identifiable))
    at_bound = _at_bound(calibration, outer)
    return {
        **uncertainty.calibrated_parameters(outer, covariance[:-6, :-6], held, at_bound),
        **base_parameters(T_instr_base, covariance[-6:, -6:], T_instr_base[:3, :3]),
    }


def _warnings(cubic: Calibration, found: Health, seed_angle_deg: float) -> tuple[str, ...]:
    warnings = []
    if not cubic.converged:
        warnings.append(f"not converged: {cubic.solution.reason}")
    bound = sorted(_at_bound(cubic, cubic.level.model.report(cubic.solution.x)))
    if bound:
        pull = float(pull_beyond_bounds(cubic).max())
        meaning = (
            "the data fit best with a stiffness that is not positive, as happens when an effect is "
            "missing from the model"
            if pull > GRADES.paper_pull
            else "indistinguishable from the bound with these data"
        )
        warnings.append(
            f"{', '.join(bound)} at the end of the physical range, {pull:.1f} standard "
            f"uncertainties beyond it: {meaning}"
        )
    over = found.train_rms_mm / found.noise_mm if found.noise_mm else 0.0
    if over > GRADES.paper_incomplete:
        warnings.append(
            f"the remaining error is {over:.0f} times the noise of the readings: the model is "
            "incomplete, and the uncertainties do not cover the missing effect"
        )
    if cubic.starts_agreeing < 2 <= len(cubic.starts):
        warnings.append(f"only one of {len(cubic.starts)} starts found this minimum")
    if seed_angle_deg > GRADES.far_from_seed_deg:
        warnings.append(f"the base frame is {seed_angle_deg:.2f} deg from its seed")
    return tuple(warnings)


def _at_bound(calibration: Calibration, report: Report) -> frozenset[str]:
    """Return the reported parameters that depend on a parameter at its bound.

    A linear spring's K_cub is at its end, zero, while its K_lin is an ordinary number.
    """
    held = np.flatnonzero(calibration.solution.at_bound)
    depends = np.abs(report.jacobian[:, held]).sum(axis=1) > 0
    at_zero = depends & (report.values == 0.0)
    return frozenset(names_of(report.parameters, at_zero if at_zero.any() else depends))


def _evidence(
    case: LoadCase,
    cubic: Calibration,
    noise: Observations[Pose],
    stated: Observations[Pose],
) -> GradeEvidence:
    """Return what the grade rests on.

    Args:
        noise: the poses fitted, with the covariance that repeats show.
        stated: single readings, with the covariance that the instrument states.
    """
    level, solution, problem = cubic.level, cubic.solution, cubic.problem
    used, jacobian = level.observations, cubic.jacobian
    x, model = np.concatenate([solution.x, np.zeros(6)]), cubic.model(None)
    hidden, last = _hidden(cubic, x), str(level.model.chain.arm.n)
    # The departures of the last row contain the mounting of the apparatus as well.
    departures = level.model.departures
    of_last_row = {
        name for name, coordinate in departures.items() if coordinate.rpartition("_")[2] == last
    }
    ended = FitSummary(
        solution=replace(solution, x=x, at_bound=np.append(solution.at_bound, np.zeros(6, bool))),
        pose=used.pose,
        parameters=problem.parameters,
        roles=problem.roles,
        departures=departures,
        covariance=cubic.covariance,
        identifiability=cubic.identifiability,
        white=np.linalg.inv(np.linalg.cholesky(noise.measured.cov)) @ jacobian,
        position=jacobian[:, :3],
        not_identifiable=cubic.not_identifiable,
        hidden=hidden,
        of_mounting=hidden | of_last_row,
    )
    noise_mm = position_noise_mm(noise.measured, noise.measured.cov)
    held_out, held_out_errors = poses_of(case.every, "holdout"), None
    if len(held_out):
        position = replace(problem, observations=held_out).rows(x).jacobian[:, :3]
        held_out_errors = accuracy.held_out_errors(
            model, case.every, used, held_out, position, cubic.covariance
        )
    scatter, findings = uncertainty.scatter_of_repeats(stated, model), case.findings
    if scatter:
        usual_mm = 1e3 * scatter[0].found * np.sqrt(3.0 * np.mean(1.0 / used.readings))
        if noise_mm > GRADES.paper_gross * usual_mm:  # by the mean square, and by the median
            finding = InputFinding(
                what=f"the mean square of repeats is {noise_mm:.2g} mm, their median "
                f"{usual_mm:.2g} mm: a few readings are far from their repeats",
                where="repeated poses",
                remedy="look for exchanged labels and gross errors among them",
                kind="outlier",
            )
            findings = (*findings, finding)
    return GradeEvidence(
        ended=ended,
        train_rms_mm=accuracy.summarise(model.deviations(used)).rms_mm,
        held_out=held_out_errors,
        noise_mm=noise_mm,
        spread_mm=used.measured.spread_mm,
        noise_is_found=bool(scatter),
        apparatus_mm=_apparatus_mm(cubic, case.options.apparatus_uncertainty_mm),
        repeats=scatter,
        from_touches=stated.measured.from_touches,
        findings=findings,
        wanted_mm=case.options.wanted_uncertainty_mm,
        arm=case.arm,
    )


def _apparatus_mm(cubic: Calibration, u_mm: float) -> float:
    """Return the rms position error after the fit by the places of balls on their apparatus.

    Args:
        u_mm: standard uncertainty of these places, per axis.
    """
    level, jacobian = cubic.level, cubic.jacobian
    weights = level.weights[:, None]
    errors = 1e-3 * u_mm * weights * level.observations.measured.by_apparatus
    rows = (weights * jacobian).reshape(-1, jacobian.shape[2])
    columns = errors.reshape(len(rows), -1)
    fitted = rows @ np.linalg.lstsq(rows, columns, rcond=None)[0]
    residual_m = (columns - fitted).reshape(errors.shape)[:, :3] * level.r_max_m
    return 1e3 * float(np.sqrt(np.sum(residual_m**2) / len(residual_m)))


def _hidden(calibration: Calibration, x: Array) -> frozenset[str]:
    """Return the parameters that no pose identifies, as the base frame or its noise hides them.

    The rank of the problem at random joint positions and torques decides.
    """
    problem = calibration.problem
    generator = np.random.default_rng(0)
    observations = problem.observations.take(
        generator.integers(len(problem.observations), size=UNKNOWNS.paper_postures)
    )
    states, arm = observations.states, problem.model.chain.arm
    low, high = arm.axis_limits_rad.T
    axes_rad = generator.uniform(low, high, (UNKNOWNS.paper_postures, len(low)))
    drawn = replace(
        states,
        q_rad=arm.coupling.to_joints(axes_rad),
        tau_Nm=generator.permuted(states.tau_Nm, axis=0),
    )
    rows = replace(problem, observations=observations.with_states(drawn)).rows(x).jacobian
    weighted = (calibration.level.weights[:, None] * rows).reshape(-1, len(x))
    identifiability = identify_beyond(
        weighted, problem.scale, possible_sizes(problem.model), calibration.row_noise
    )
    return not_identifiable(identifiability, problem.parameters)
