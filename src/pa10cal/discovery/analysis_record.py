"""All that the figures of discovery show: `analysis.json`."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from pa10cal.calibration.levels import report_base
from pa10cal.calibration.uncertainty import reported_keys
from pa10cal.discovery.blocked_cv.alone import ByCampaign, Pair, by_campaign
from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
from pa10cal.discovery.gap import Gap
from pa10cal.discovery.linear import possible_sizes
from pa10cal.discovery.verdict import Verdict
from pa10cal.fit.fitted_model import FittedModel
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


def analysis_keys(found: Verdict[object]) -> AnalysisKeys:
    """Return all that the figures of discovery show."""
    before, after = found.lack_of_fit()
    baseline = found.baseline
    return AnalysisKeys(
        before=before,
        after=after,
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
