"""The record of a load case with the general model: its fits, their errors, the grade."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.calibration import accuracy, uncertainty
from pa10cal.calibration.general.as_model import (
    fit_summary,
    fitted,
    parameters_of,
    with_discrepancy,
)
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general
from pa10cal.calibration.general.contradictions import contradictions
from pa10cal.calibration.general.fit import GeneralSolution
from pa10cal.calibration.general.other_campaign import calibrate_from
from pa10cal.calibration.general.per_campaign import per_campaign_fits
from pa10cal.calibration.general.prior import prior_of, refuse_own_readings
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.health import RIGID, check_the_arm, health
from pa10cal.calibration.load_case import LoadCase, case_keys, fit_keys
from pa10cal.calibration.noisy_campaign import noisy_campaign
from pa10cal.calibration.rules import GRADES, GROUPS, RECORDS
from pa10cal.errors import CalibrationError
from pa10cal.fit.discrepancy import by_uncertain_joints_mm, lacking_mm
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import torque_noise
from pa10cal.fit.loads import with_loads_read_by, with_torques
from pa10cal.fit.logged_torques import lost_without_log_mm
from pa10cal.fit.position_errors import of_one_target, position_noise_mm
from pa10cal.fit.problem import Problem
from pa10cal.fit.robust_weights import suspect_beyond
from pa10cal.fit.weighed_arm import weighed_model
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.points import keep_their_distances
from pa10cal.observe.quantities import Deviations, Start
from pa10cal.observe.time_order import at_one_end
from pa10cal.results import calibration as records


def suspected_outliers(
    problem: Problem, fit: GeneralSolution
) -> tuple[records.SuspectedOutlier, ...]:
    """List the suspected outliers of a fit, the worst first; they stay in it, with less weight."""
    limit = suspect_beyond(problem.components_seen)
    rows = np.flatnonzero((fit.distance > limit) | (fit.weights < RECORDS.little_weight))
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    rigid_outliers = keep_their_distances(problem.observations.measured)
    found = []
    for row in rows[np.argsort(-fit.distance[rows])].tolist():
        reasons = []  # one for each kind of component; the largest deviation is reported
        for kind, columns in problem.observations.measured.component_kinds:
            off = float(np.linalg.norm(fit.residual[row, columns]))
            turns = kind.startswith("attitude")
            text = f"{np.degrees(off):.3f} deg" if turns else f"{1e3 * off:.3f} mm"
            times = off / np.sqrt(fit.scatter[kind] ** 2 + variances[row, columns].mean())
            reasons.append(
                (times, f"{kind} off by {text}, {times:.0f} times the scatter of one axis")
            )
        rigid = f"; {RIGID}" if rigid_outliers[row] else ""
        found.append(
            records.SuspectedOutlier(
                row=row,
                pose=str(problem.observations.pose[row]),
                load_N=float(problem.observations.states.load_N[row]),
                distance=float(fit.distance[row]),
                weight=float(fit.weights[row]),
                why=max(reasons)[1] + rigid,
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
    found = _FittedCase.of(case, start)
    full, model, load_N = found.full, found.model, found.grid.states.load_N
    evidence = found.evidence()
    judged = health(evidence)
    prior = None if case.prior is None else case.prior.fitted_to
    fitted_poses, open_targets = full.problem.observations, _open_targets(full)
    about = FittedTo.of(fitted_poses, case.load, judged, case.campaign, prior, open_targets)
    of_geometry, of_nominal = found.of_geometry, found.of_nominal
    before = accuracy.summarise_by_load(of_nominal, load_N)
    by_geometry = accuracy.summarise_by_load(of_geometry, load_N)
    trusted = accuracy.summarise_trusted(of_nominal, found.deviations, load_N, found.flagged)
    geometry, nominal = (
        records.Fit(**_general_fit_keys(each, with_discrepancy(each, found.readings), about))
        for each in (found.geometry, found.nominal)
    )
    record = records.GeneralCalibrationRecord(
        **case_keys(case, evidence.ended, judged, replace(model, fitted_to=about), found.grid),
        **_general_fit_keys(full, model, about),
        starts=1,
        starts_agreeing=1,
        redundant=full.redundant,
        springs=full.springs,
        torques_from=full.torques_from,
        errors={
            load: records.LoadErrors(
                before=before[load],
                geometry=by_geometry[load],
                after=after,
                trusted=trusted.get(load),
            )
            for load, after in accuracy.summarise_by_load(found.deviations, load_N).items()
        },
        geometry=geometry,
        nominal=nominal,
        suspected_outliers=found.outliers,
        group=found.group,
        prior=full.prior,
        warnings=_warnings(
            full, judged, some_logged=bool(np.isfinite(found.readings.states.tau_Nm).any())
        ),
    )
    return record, full


@dataclass(frozen=True, eq=False)
class _FittedCase:
    """A load case with its fits, and what these leave of the calibration poses of every load."""

    case: LoadCase
    every: Observations  # single readings of all kinds, with the directions of arrival
    start: Start
    used: Observations  # the averaged poses of the load case, which were fitted
    full: GeneralCalibration  # with all that can be identified, about the prior if there is one
    geometry: GeneralCalibration  # without springs; with a prior, the frames alone
    nominal: GeneralCalibration  # the frames alone, about the nominal arm
    model: FittedModel  # that of the full calibration
    grid: Observations  # averaged calibration poses of every load, with the torques of the model
    rows: Mask  # which of these belong to the load case

    @classmethod
    def of(cls, case: LoadCase, start: Start) -> _FittedCase:
        """Fit a load case; refuse readings that the arm as described does not fit at all."""
        arm, every, payload, options = case.arm, case.every, case.payload, case.options
        if case.prior is not None:  # its effects may depend on the direction of arrival
            every, _ = with_arrivals(every, arm)
        grid = average_repeats(every.of_kind("grid"))
        rows = case.rows(grid.states)
        used = grid.take(rows)
        rigid = options.with_springs(())
        if case.prior is not None:
            refuse_own_readings(case.prior, used, case.campaign)
        # First the fit with most unknowns: it says how many poses are needed.
        if case.prior is not None:
            expected = prior_of(case.prior, arm, payload)
            full = calibrate_from(expected, arm, used, start, payload, options)
        else:
            full = calibrate_general(arm, used, start, payload, options)
        nominal = calibrate_general(arm, used, start, payload, rigid, links=False)
        geometry = full if case.prior is None else nominal
        if case.prior is None and full.springs:
            geometry = calibrate_general(arm, used, start, payload, rigid)
        weighed = weighed_model(fitted(full), full.problem.observations)
        model = with_discrepancy(full, _single_readings(case, every), weighed)
        grid = _with_model_torques(model, grid, payload)
        found = cls(case, every, start, used, full, geometry, nominal, model, grid, rows)
        _refuse_another_arm(found)
        return found

    @cached_property
    def readings(self) -> Observations:
        """Return the single readings of the poses fitted."""
        return _single_readings(self.case, self.every)

    @cached_property
    def deviations(self) -> Deviations:
        """Return the errors of the calibrated model."""
        return self.model.deviations(self.grid)

    @cached_property
    def of_geometry(self) -> Deviations:
        """Return the errors without springs; with a prior, with its frames alone fitted."""
        return fitted(self.geometry).deviations(self.grid)

    @cached_property
    def of_nominal(self) -> Deviations:
        """Return the errors of the nominal arm, with its frames fitted."""
        return fitted(self.nominal).deviations(self.grid)

    @property
    def all_rms_mm(self) -> float:
        """Return the rms error of the poses fitted, suspected outliers among them."""
        return accuracy.summarise(self.deviations.take(self.rows)).rms_mm

    @property
    def noise_mm(self) -> float:
        """Return the rms error that the stated noise makes."""
        stated = self.full.problem.stated_covariance
        return position_noise_mm(self.used.measured, stated)

    @property
    def torques_mm(self) -> float:
        """Return the rms error by the noise of logged torques; 0 where none were logged."""
        if self.full.torques_from != "logged":
            return 0.0
        problem, model = self.full.problem, self.model
        poses, stated = problem.observations, problem.stated_covariance
        residual = model.compared(poses).residual
        noise = torque_noise(model, poses, self.case.payload, residual, stated)
        return 0.0 if noise is None else position_noise_mm(poses.measured, noise.cov)

    @cached_property
    def outliers(self) -> tuple[records.SuspectedOutlier, ...]:
        """Return the suspected outliers among the poses fitted."""
        return suspected_outliers(self.full.problem, self.full.fit)

    @cached_property
    def flagged(self) -> Mask:
        """Return which poses are suspected outliers."""
        flagged = np.zeros(len(self.grid), dtype=bool)
        flagged[np.flatnonzero(self.rows)[[outlier.row for outlier in self.outliers]]] = True
        return flagged

    @cached_property
    def group(self) -> records.GroupOfCampaigns | None:
        """Return what each campaign of a group says alone; None for a single campaign."""
        full = self.full
        by_masses = full.torques_from == "masses" and full.springs
        return per_campaign_fits(full.problem, full.fit, full.payload if by_masses else None)

    def held_out_errors(self) -> accuracy.HeldOut | None:
        """Return the errors of held-out poses; None without any."""
        full, held_out = self.full, average_repeats(self.every.of_kind("holdout"))
        if not len(held_out):
            return None
        held_out = _with_model_torques(self.model, held_out, self.case.payload)
        turned = replace(full.problem, observations=held_out.turned(self.start.R_ee_target))
        position = of_one_target(held_out.measured, turned.rows(full.fit.x).jacobian)
        return accuracy.held_out_errors(
            self.model, self.every, self.used, held_out, position, full.fit.covariance
        )

    def evidence(self) -> GradeEvidence:
        """Return what the grade rests on."""
        case, full, used, model = self.case, self.full, self.used, self.model
        known, payload, findings = weights_known(case.arm), case.payload, case.findings
        if self.group is not None:
            zeros = full.problem.model.joint_zeros
            findings = (*findings, *contradictions(self.group, zeros))
        trusted = np.flatnonzero(self.rows & ~self.flagged)

        def trusted_rms_mm(found: Deviations) -> float:
            return accuracy.summarise(found.take(trusted)).rms_mm

        without_springs = None if self.geometry is full else self.of_geometry
        repeats = uncertainty.scatter_of_repeats(self.readings, model)
        return GradeEvidence(
            ended=fit_summary(full),
            train_rms_mm=trusted_rms_mm(self.deviations),
            held_out=self.held_out_errors(),
            # Repeats hold the noise of torques already.
            noise_mm=self.noise_mm if repeats else float(np.hypot(self.noise_mm, self.torques_mm)),
            discrepancy_mm=lacking_mm(model.discrepancy, used.states.q_rad),
            lost_without_log_mm=lost_without_log_mm(model, self.grid.take(self.rows)),
            joints_mm=by_uncertain_joints_mm(model.model, model.x, self.grid.take(self.rows)),
            spread_mm=_spread_mm(case.arm, used),
            suspected_outliers=len(self.outliers),
            rigid_outliers=sum(RIGID in outlier.why for outlier in self.outliers),
            at_one_end=at_one_end(used.states, self.flagged[self.rows]),
            all_rms_mm=self.all_rms_mm,
            repeats=repeats,
            from_touches=self.readings.measured.from_touches,
            findings=findings,
            without_springs_mm=None if without_springs is None else trusted_rms_mm(without_springs),
            weights=known.origin if known.assumed and full.springs else "",
            com_u_m=payload.com_u_m if payload is not None and full.springs else None,
            wanted_mm=case.options.wanted_uncertainty_mm,
            nominal_mm=trusted_rms_mm(self.of_nominal),
            arm=case.arm,
            turned_rad=_turned_rad(model, used),
            hardly_moved=_hardly_moved(case.arm, used.states.q_rad),
            noisy_campaign=noisy_campaign(
                self.grid.take(trusted),
                self.deviations.distance_mm[trusted],
                full.problem.stated_covariance[~self.flagged[self.rows]],
            ),
            not_shown=tuple(full.settled),
            alike=full.alike,
        )


def _with_model_torques(
    model: FittedModel, poses: Observations, payload: Payload | None
) -> Observations:
    """Return poses with the torques and static loads of a model where none were logged."""
    states, _ = with_torques(model.model, model.x, poses.states, payload)
    return poses.with_states(with_loads_read_by(model.model.terms, states))


def _warnings(
    full: GeneralCalibration, judged: records.Health, *, some_logged: bool
) -> tuple[str, ...]:
    warnings = []
    if not full.fit.converged:
        warnings.append(f"not converged: {full.fit.reason}")
    if judged.grade != "good":
        warnings.append(judged.line)
    if full.torques_from == "masses" and full.springs:
        assumed = weights_known(full.arm).assumed
        of_weights = "assumed weights" if assumed else "the described masses"
        followers = sorted({c.joint for c in full.arm.coupled if c.follows})
        joints = ", ".join(f"joint {joint}" for joint in followers)
        of_joints = f" of {joints} (follows: true)" if followers and some_logged else ""
        warnings.append(f"torques{of_joints} were not logged: those of {of_weights} are used")
    if full.held_rigid:
        warnings.append(
            f"no spring in {_joints_text(full.held_rigid)}: there are too few poses for springs; "
            "what the joints deflect is taken as an error of geometry"
        )
    if names := _open_targets(full):
        warnings.append(
            f"{', '.join(names)}: neither the geometry of the arm shows it nor tool.balls_mm "
            "states it, so it stays where the search started, unless an effect that tilts the "
            "flange shows it; along it all targets may be off by the length of the tool in the "
            "frames of base and flange (not in the instrument's)"
        )
    if full.unproven:
        warnings.append(
            f"no spring in {_joints_text(full.unproven)}: the poses fitted show one, but it does "
            "not help to predict clusters and stretches of poses that are held out"
        )
    return tuple(warnings)


def _open_targets(full: GeneralCalibration) -> tuple[str, ...]:
    """Return the coordinates of targets that neither the arm's geometry shows nor anybody states.

    With all axes parallel these are the height of one target, which is that of the base.
    """
    measured = full.problem.observations.measured
    if measured.places_stated:
        return ()
    of_targets = {parameter.name for parameter in measured.target_parameters}
    return tuple(each.name for each in full.redundant if each.name in of_targets)


def _joints_text(joints: tuple[int, ...]) -> str:
    return f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"


def as_load(
    record: records.GeneralCalibrationRecord, load: str
) -> records.GeneralCalibrationRecord:
    """Return the record of a load case under the name of another load case of the same poses."""

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
    """Return the largest turn of the end-effector between two poses [rad]."""
    R = model.nominal().as_read(poses)[:, :3, :3]
    batches = np.split(R, range(GROUPS.at_once, len(R), GROUPS.at_once))
    traces = (float(np.tensordot(some, R, ((1, 2), (1, 2))).min()) for some in batches)
    cosine = 0.5 * (min(traces) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _hardly_moved(arm: Arm, q: Array) -> tuple[str, ...]:
    """Return the joints that hardly moved over poses (P, n), in words; those that turn alone."""
    found = []
    for joint in arm.coupling.own[~arm.prismatic[arm.coupling.own]].tolist():
        low, high = np.degrees([q[:, joint].min(), q[:, joint].max()]).tolist()
        if high - low < np.degrees(GRADES.hardly_turned_rad):
            where = f"at {low:.4g} deg" if f"{low:.4g}" == f"{high:.4g}" else ""
            between = f"between {low:.4g} and {high:.4g} deg"
            found.append(f"joint {joint + 1}, which stood {where or between} in all")
    return tuple(found)


def _general_fit_keys(
    general: GeneralCalibration, model: FittedModel, about: FittedTo
) -> dict[str, Any]:
    model = replace(model, fitted_to=about)
    names = [parameter.name for parameter in general.problem.parameters]
    parameters, covariance = parameters_of(general, model), general.fit.covariance
    return fit_keys(general.fit, model, parameters, names, covariance)


def _single_readings(case: LoadCase, every: Observations) -> Observations:
    """Return the single readings of the calibration poses of a load case."""
    single = every.of_kind("grid")
    return single.take(case.rows(single.states))


def _spread_mm(arm: Arm, used: Observations) -> float:
    """Return the spread of the places where targets were, or would be if unrelated to the joints.

    The latter where few places were touched again and again: it is that of the arm's end, each
    joint at its positions in other rows.
    """
    spread_mm, places_m = used.measured.spread_mm, used.measured.places_m
    distinct = np.unique(places_m.reshape(len(places_m), -1).round(6), axis=0)
    if len(distinct) > GRADES.touched_share * len(places_m):
        return spread_mm
    q = used.states.q_rad
    shifts = [k * len(q) // (q.shape[1] + 1) for k in range(q.shape[1])]
    shuffled = np.column_stack([np.roll(q[:, k], shift) for k, shift in enumerate(shifts)])
    ends_m = Chain.of(arm).forward(shuffled)[:, :3, 3]
    return max(spread_mm, 1e3 * float(np.sqrt(ends_m.var(axis=0).sum())))


def _refuse_another_arm(found: _FittedCase) -> None:
    """Refuse a fit that leaves more than any calibrated arm does, and than the noise explains."""
    rank, left_mm = found.full.fit.identifiability.rank, found.all_rms_mm
    spread_mm = _spread_mm(found.case.arm, found.used)
    if rank and left_mm < max(
        GRADES.no_fit_general_share * spread_mm, GRADES.stated_ratio * found.noise_mm
    ):
        return
    repeats = uncertainty.scatter_of_repeats(found.readings, found.model)
    raise CalibrationError(
        "the arm as described does not fit the readings",
        where=found.full.arm.name,
        value=f"{left_mm:.1f} mm rms remain; the positions spread by {spread_mm:.0f} mm",
        allowed=f"errors below {100 * GRADES.no_fit_general_share:.0f} % of that spread",
        remedy=check_the_arm(left_mm, noise_is_stated=bool(rank) and not repeats),
    )
