"""All that the figures of discovery show: `analysis.json`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.levels import report_base
from pa10cal.calibration.uncertainty import reported_keys
from pa10cal.discovery import lack_of_fit as domain
from pa10cal.discovery.blocked_cv.alone import ByCampaign, Pair, by_campaign
from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
from pa10cal.discovery.gap import Gap
from pa10cal.discovery.lack_of_fit import ChannelTest, Estimate, Periodogram, PureErrorTest
from pa10cal.discovery.linear import possible_sizes
from pa10cal.discovery.verdict import Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results import analysis as parts
from pa10cal.results import evaluation
from pa10cal.results.analysis import (
    AnalysisKeys,
    GapField,
    GapRows,
    NamingStep,
    ParameterShift,
    SearchStep,
)
from pa10cal.results.calibration import (
    CampaignsAgree,
    EffectByCampaign,
    JointErrorAlone,
    ParameterAlone,
)
from pa10cal.results.evaluation import Parameter
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.effect import Effect

#: A parameter known no better than this part of what is possible is not identified by the data.
_IDENTIFIED = 1.0 / 3.0
#: Digits of what is there to be drawn.
_DIGITS = 6


def analysis_keys(found: Verdict[object]) -> AnalysisKeys:
    """Return all that the figures of discovery show."""
    before, after = found.lack_of_fit()
    baseline = found.baseline
    return AnalysisKeys(
        before=lack_of_fit_part(before),
        after=lack_of_fit_part(after),
        steps=tuple(
            SearchStep(
                effects=tuple(name_of(effect) for effect in step.effects),
                gain_nats=step.gain_nats,
                rms_mm=step.rms_mm,
                squared_error_of_a_row=step.squared_error_of_a_row,
            )
            for step in found.steps
        ),
        naming=tuple(
            NamingStep(
                effects=tuple(name_of(effect) for effect in step.effects),
                train=step.train,
                holdout=step.holdout,
            )
            for step in found.naming
        ),
        parameter_shifts=parameter_shifts(baseline, model_parameters(found)),
        gap=GapField(
            train=gap_rows(found.train, baseline),
            holdout=None if found.holdout is None else gap_rows(found.holdout, baseline),
        ),
        noise_floor_mm=found.noise_floor_mm,
    )


def lack_of_fit_part(found: domain.LackOfFit) -> parts.LackOfFit:
    """Return the numbers of a lack of fit."""
    return parts.LackOfFit(
        pose=_channel(found.pose or ChannelTest(None, None, 0.0)),
        torque=None if found.torque is None else _channel(found.torque),
        rms_mm=found.rms_mm,
        floor_mm=found.floor_mm,
        by_load=_parts(found.by_load),
        by_pose=_parts(found.by_pose),
        by_axis=_parts(found.by_axis),
        by_joint=tuple(
            parts.JointPart(
                joint=part.joint,
                rms_rad=part.rms_rad,
                floor_rad=part.floor_rad,
                arrivals=tuple(
                    parts.JointArrival(
                        direction=arrival.direction,
                        cells=arrival.cells,
                        mean_rad=arrival.mean.value,
                        std_rad=_known(arrival.mean.std),
                    )
                    for arrival in part.arrivals
                ),
                periodogram=_periodogram(part.periodogram),
            )
            for part in found.by_joint
        ),
        by_torque=tuple(
            parts.TorquePart(
                joint=part.joint,
                rms_Nm=part.rms_Nm,
                noise_Nm=part.noise_Nm,
                arrivals=tuple(
                    parts.TorqueArrival(
                        direction=arrival.direction,
                        cells=arrival.cells,
                        mean_Nm=arrival.mean.value,
                        std_Nm=_known(arrival.mean.std),
                    )
                    for arrival in part.arrivals
                ),
            )
            for part in found.by_torque
        ),
        drifts=tuple(
            parts.Drift(
                axis=drift.axis,
                by_time_mm_per_h=_estimate(drift.mm_per_h),
                by_temperature_mm_per_K=_estimate(drift.mm_per_K),
            )
            for drift in found.drifts
        ),
        cells=_cells(found),
    )


def _cells(found: domain.LackOfFit) -> parts.Cells:
    states = found.cells.states
    torque = found.torque_left_Nm
    x_mm, y_mm, z_mm = _rounded(found.position_mm).T
    return parts.Cells(
        pose=found.cells.pose,
        load_N=_rounded(states.load_N),
        readings=found.cells.readings,
        time_s=_rounded(states.time_s),
        temperature_C=_rounded(states.temperature_C),
        position_x_mm=x_mm,
        position_y_mm=y_mm,
        position_z_mm=z_mm,
        joints=tuple(
            parts.CellJoint(
                joint=j + 1,
                q_rad=_rounded(states.q_rad[:, j]),
                arrival=_rounded(states.arrival[:, j]),
                error_rad=_rounded(found.joints.error_rad[:, j]),
                std_rad=_rounded(found.joints.std_rad[:, j]),
                torque_residual_Nm=None if torque is None else _rounded(torque[:, j]),
            )
            for j in range(states.n)
        ),
    )


def _channel(found: ChannelTest) -> parts.Channel:
    return parts.Channel(
        shared=_test(found.shared),
        unshared=_test(found.unshared),
        shared_variance_of_a_reading=found.shared_variance,
    )


def _test(found: PureErrorTest | None) -> parts.PureErrorTest | None:
    if found is None:
        return None
    return parts.PureErrorTest(
        chi_square=found.chi_square,
        dof=found.dof,
        pure_error_dof=found.pure_dof,
        F=found.ratio,
        p_value=found.p_value,
    )


def _parts(found: Iterable[domain.Part]) -> tuple[parts.ErrorPart, ...]:
    return tuple(
        parts.ErrorPart(of=part.of, cells=part.cells, rms_mm=part.rms_mm, floor_mm=part.floor_mm)
        for part in found
    )


def _estimate(found: Estimate | None) -> evaluation.Estimate | None:
    if found is None:
        return None
    return evaluation.Estimate(value=found.value, std=_known(found.std))


def _known(number: float) -> float | None:
    return number if np.isfinite(number) else None


def _periodogram(found: Periodogram | None) -> parts.Periodogram | None:
    if found is None:
        return None
    return parts.Periodogram(
        orders=_rounded(found.orders),
        explained_rad=_rounded(found.explained_rad),
        marked=np.array(found.marked),
        marked_rad=_rounded(found.marked_rad),
    )


def _rounded(values: Array) -> Array:
    """Return numbers rounded to what a picture shows."""
    flat = [float(f"{value:.{_DIGITS}g}") for value in np.ravel(values).tolist()]
    return np.array(flat).reshape(np.shape(values))


def model_parameters(found: Verdict[object]) -> dict[str, Parameter]:
    """Return every parameter of the calibrated model as it is with the effects, and the base."""
    baseline, covariance = found.baseline, found.covariance
    own, base = np.arange(len(baseline.x)), len(found.extended.at.x) - np.arange(6, 0, -1)
    report = baseline.model.report(found.model.x[own])
    known = np.sqrt(np.diag(covariance))[own] < _IDENTIFIED * possible_sizes(baseline.model)
    # Small motions of the base are along its own axes, its origin along the instrument's.
    along = np.eye(6)
    along[:3, :3] = baseline.T_instr_base[:3, :3]
    of_base = along @ covariance[np.ix_(base, base)] @ along.T
    of_own = reported_keys(report, covariance[np.ix_(own, own)])
    of_frame = reported_keys(report_base(found.model.T_instr_base), of_base)
    return {
        name: Parameter(**keys, identifiable=bool(np.all(known[row])))
        for (name, keys), row in zip(of_own.items(), report.jacobian != 0.0, strict=True)
    } | {name: Parameter(**keys, identifiable=True) for name, keys in of_frame.items()}


def parameter_shifts(
    baseline: FittedModel, after: dict[str, Parameter]
) -> tuple[ParameterShift, ...]:
    """Return every parameter of the calibrated model, and once the effects joined it."""
    reports = (baseline.model.report(baseline.x), report_base(baseline.T_instr_base))
    before = {
        parameter.name: float(value)
        for report in reports
        for parameter, value in zip(report.parameters, report.values, strict=True)
    }
    return tuple(
        ParameterShift(
            name=name,
            unit=parameter.unit,
            before=before[name],
            after=parameter.value,
            std=parameter.std or 0.0,
            tolerance=parameter.tolerance,
            identifiable=parameter.identifiable,
        )
        for name, parameter in after.items()
    )


def gap_rows(gap: Gap, baseline: FittedModel) -> GapRows:
    """Return every configuration with its residuals before and after, along base axes."""
    poses, T_instr_base = gap.poses, baseline.T_instr_base
    T_instr_ee = T_instr_base @ baseline.model.predict(poses.states, baseline.x)
    p_instr_m = poses.measured.end_poses(T_instr_ee)[:, :3, 3]
    return GapRows(
        pose=poses.pose,
        load_N=poses.states.load_N,
        place_mm=1e3 * (p_instr_m - T_instr_base[:3, 3]) @ T_instr_base[:3, :3],
        before_mm=gap.found_before.position_mm,
        after_mm=gap.found_after.position_mm,
        extrapolated=None if gap.parts is None else ~gap.parts.inside,
    )


def name_of(effect: Effect) -> EffectName:
    """Return an effect's name and place."""
    return EffectName(id=effect.id, of=effect.of)


# Effects as each campaign of a group alone has them, for `discovery/verdict.json`.


def by_campaign_part(found: Verdict[object]) -> tuple[EffectByCampaign, ...] | None:
    """Return every effect of a verdict as each campaign of a group has it; None without any."""
    if not isinstance(found, VerdictByBlocks):
        return None
    return tuple(map(_part, by_campaign(found.survey, found.extended))) or None


def _part(each: ByCampaign) -> EffectByCampaign:
    return EffectByCampaign(
        id=each.effect.id,
        of=each.effect.of,
        parameters=None
        if each.curves
        else {
            name: {
                parameter.name: ParameterAlone(value=float(value), std=float(std))
                for parameter, value, std in zip(
                    report.parameters,
                    report.values,
                    np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T)),
                    strict=True,
                )
            }
            for name, (report, covariance) in each.reports.items()
        },
        errors={
            name: JointErrorAlone(error_mrad=1e3 * curve.error_rad, visited=curve.visited)
            for name, curve in each.curves.items()
        }
        or None,
        agreement=tuple(map(_agreement, each.pairs)),
    )


def _agreement(pair: Pair) -> CampaignsAgree:
    known = bool(np.isfinite(pair.correlation))
    found = asdict(pair) if known else dict.fromkeys(asdict(pair))
    return CampaignsAgree(
        first=pair.first,
        second=pair.second,
        correlation=found["correlation"],
        correlation95=found["correlation95"],
        slope=found["slope"],
        slope95=found["slope95"],
        first_rms_mrad=1e3 * pair.rms_rad[0] if known else None,
        second_rms_mrad=1e3 * pair.rms_rad[1] if known else None,
        difference_rms_mrad=1e3 * pair.difference_rad if known else None,
        share_of_turn=pair.share,
    )
