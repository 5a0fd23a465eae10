"""The grade of a calibration, by its convergence, rank and errors.

A grade is one word, and one sentence that says what to do. The rule stands in `docs/general.md`,
its thresholds in `rules`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.calibration.fit_summary import correlated
from pa10cal.calibration.grade_checks import grade_checks
from pa10cal.calibration.grade_evidence import NO_NOISE, GradeEvidence
from pa10cal.calibration.rules import GRADES
from pa10cal.results import calibration as records
from pa10cal.results.evaluation import BETWEEN
from pa10cal.terms.joint_spring import reported_name

#: Kinds of findings that are refuted if they would leave a larger error than the fit.
OF_JOINTS = ("joint_sign", "joint_order", "joint_coupling")
#: Why readings that are far from the model may be right.
RIGID = (
    "the targets keep their distances, so the readings are right: the model lacks something there, "
    "or a joint was misread"
)


def health(evidence: GradeEvidence) -> records.Health:
    """Judge a calibration by its convergence and its remaining errors."""
    ended, held_out = evidence.ended, evidence.held_out
    grade, line, findings = graded(evidence)
    return records.Health(
        grade=grade,
        line=line,
        checks=tuple(grade_checks(evidence, findings)),
        converged=ended.solution.converged,
        reason=ended.solution.reason,
        iterations=ended.solution.iterations,
        at_bounds=tuple(map(reported_name, ended.at_bound)),
        rank=evidence.rank,
        unknowns=len(ended.parameters),
        condition=ended.identifiability.condition,
        not_identifiable=tuple(sorted(map(reported_name, ended.not_identifiable))),
        correlated_pairs=correlated(ended),
        train_rms_mm=evidence.train_rms_mm,
        held_out_rms_mm=None if held_out is None else held_out.accuracy.rms_mm,
        noise_mm=evidence.noise_mm,
        error_over_noise=evidence.over_noise,
        held_out_over_expected=evidence.over_expected,
        repeats=evidence.repeats,
        findings=findings,
        departures=evidence.departures,
        poses=evidence.poses,
        outliers_show="; ".join(_shown_by_outliers(evidence)),
    )


def graded(evidence: GradeEvidence) -> tuple[records.Grade, str, tuple[records.InputFinding, ...]]:
    """Grade a calibration.

    Returns:
        The grade, one sentence with the reason and the remedy, and what is suspected of the input.
    """
    solution = evidence.ended.solution
    if not solution.converged:
        # Of the checks alone: what such a fit itself shows to be suspect may be its own.
        found, remedy = evidence.findings, "raise calibration.max_iterations, or measure more poses"
        if found:
            remedy = f"check the input first: {_first(found)}"
        return "not_converged", f"the fit did not converge: {solution.reason}; {remedy}", found
    errors = _errors(evidence)
    findings = (
        *(each for each in evidence.findings if not _is_settled(each, evidence)),
        *_suspected(evidence),
    )
    if findings:
        return "suspect_input", f"{errors}; check the input: {_first(findings)}", findings
    remarks = "".join(f"; {remark}" for remark in _remarks(evidence))
    if lacks := _lacking(evidence):
        return "incomplete", f"{errors}, {lacks}{remarks}", ()
    if few := _few(evidence):
        return "few_poses", f"{errors}; {few}{remarks}", ()
    if uncertain := _uncertain(evidence):
        return "few_poses", f"{uncertain}; {errors}{remarks}", ()
    if evidence.u_model_mm > GRADES.small_share * evidence.error_mm:
        remarks = (
            "; near these poses predicted positions have a standard uncertainty of "
            f"{evidence.u_promised_mm:.3f} mm in the frame of the instrument{remarks}"
        )
    return (
        "good",
        f"{errors}{_beside_noise(evidence)}; these poses determine every parameter that such an "
        f"instrument can (rank {evidence.rank}){_not_shown(evidence)}{remarks}",
        (),
    )


def _not_shown(evidence: GradeEvidence) -> str:
    """Return which tilts these poses do not show, so that the fit left them at zero."""
    names = evidence.not_shown
    if not names:
        return ""
    what = "tilt" if len(names) == 1 else "tilts"
    return f" but for the {what} that these poses do not show, taken as zero: {_listed(names)}"


def _first(findings: Sequence[records.InputFinding]) -> str:
    """Return the first finding in words, and how many others there are."""
    more = f"; {len(findings) - 1} more in health.findings" if findings[1:] else ""
    return f"{findings[0]}{more}"


def _beside_noise(evidence: GradeEvidence) -> str:
    """Return how the remaining error of a good calibration compares with the noise."""
    noise_mm, over = evidence.noise_with_apparatus_mm, evidence.over_noise
    if noise_mm is None:
        return ""
    if over is not None and over > GRADES.noticed_ratio:
        return f", {_compared(evidence)}{over:.2g} times the noise of {noise_mm:.3f} mm"
    if f"{noise_mm:.3f}" == f"{evidence.train_rms_mm:.3f}":
        return ", as the noise explains"
    if not noise_mm:
        return f", and {NO_NOISE}"
    return f", as the noise of {noise_mm:.3f} mm explains"


def _compared(evidence: GradeEvidence) -> str:
    """Return the error that is compared with the noise, where it is not the one stated before."""
    noise_mm, over = evidence.noise_with_apparatus_mm or np.inf, evidence.over_noise or 0.0
    if f"{evidence.train_rms_mm / noise_mm:.2g}" == f"{over:.2g}":
        return ""
    return f"{evidence.error_mm:.3f} mm with the part that the fit absorbed, "


def _is_settled(finding: records.InputFinding, evidence: GradeEvidence) -> bool:
    """Return whether poses confirm what a check found as a departure, or refute it.

    A sign, order or coupling of joints that would leave a larger error than the confirmed model
    cannot be right.
    """
    if finding in evidence.departures:
        return True
    if not evidence.confirmed:
        return False
    left_mm = finding.would_leave_mm
    return finding.kind in OF_JOINTS and left_mm is not None and left_mm > evidence.train_rms_mm


def _errors(evidence: GradeEvidence) -> str:
    """Return in words the remaining errors of fitted and of held-out poses."""
    fitted = f"{evidence.train_rms_mm:.3f} mm"
    text = f"remaining error {fitted} rms over the poses fitted"
    if (count := evidence.suspected_outliers) and evidence.all_rms_mm is not None:
        text = (
            f"remaining error {evidence.all_rms_mm:.3f} mm rms over the poses fitted ({fitted} "
            f"without {count} far from the model)"
        )
    held_out = evidence.held_out
    if held_out is None:
        return text
    error = f"{held_out.accuracy.rms_mm:.3f} mm"
    where = f" {held_out.where}" if held_out.where else ""
    if text.endswith("fitted") and error == fitted:
        text += f" and over held-out poses{where}"
    else:
        text += f", {error} over held-out poses{where}"
    if held_out.between is not None:
        text += f", {held_out.between.rms_mm:.3f} mm {BETWEEN}"
    if held_out.suspected:
        text += f" without {held_out.suspected} with a suspected reading"
    return text


def check_the_arm(left_mm: float, *, noise_is_stated: bool) -> str:
    """Return what to check where the arm does not fit, by the error that the fit leaves.

    A noise that nothing but its statement confirms may also be larger than stated, or assumed.
    """
    remedy = "check robot, order, signs and zeros of the joints, and units"
    if not noise_is_stated:
        return remedy
    return (
        f"{remedy}; or, if the instrument errs by {left_mm:.2g} mm, state its uncertainty "
        "(instrument.uncertainty_mm)"
    )


def _suspected(evidence: GradeEvidence) -> Iterator[records.InputFinding]:
    """Return what the fit shows to be probably wrong in the input."""
    if evidence.misfits_arm and not evidence.springs_explain_most:
        yield records.InputFinding(
            what="the arm as described does not fit the readings",
            where="the whole campaign",
            remedy=check_the_arm(
                evidence.train_rms_mm,
                noise_is_stated=not (evidence.repeats or evidence.noise_is_found),
            ),
            kind="other_arm",
        )
    yield from _stated(evidence)
    if not evidence.confirmed:
        confirmed = evidence.departures
        yield from (each for each in evidence.large_departures if each not in confirmed)


def _stated(evidence: GradeEvidence) -> Iterator[records.InputFinding]:
    """Return where the stated uncertainty disagrees with repeats, or with the remaining error."""
    for scatter in evidence.repeats:
        least, most = evidence.accepted_scatter(scatter)
        if not least <= scatter.found <= most:
            unit = "mrad" if scatter.is_of_attitude else "mm"
            causes = (
                "whether readings were copied or averaged"
                if scatter.found < least
                else "whether the instrument, a target or the load changed between repeats (see "
                "the verdict); else the arm does not come back to a pose"
            )
            yield records.InputFinding(
                what=f"{1e3 * scatter.stated:.2g} {unit} is stated, repeats scatter by "
                f"{1e3 * scatter.found:.2g} {unit}",
                where=f"stated uncertainty of the {scatter.kind}",
                remedy=f"check its unit and value, and {causes}",
                kind="stated_uncertainty",
            )
    if evidence.repeats or evidence.noise_is_found or not evidence.noise_mm:
        return
    ratio = evidence.error_mm / evidence.noise_mm
    # The unit in which the noise seems to be stated, by the ratio of the remaining error to it.
    units = {"metres, multiply it by 1000": 1e3, "micrometres, divide it by 1000": 1e-3}
    log_off = {name: abs(np.log(max(ratio, GRADES.tiny) / by)) for name, by in units.items()}
    unit = min(log_off, key=lambda name: log_off[name])
    other_unit = log_off[unit] < np.log(GRADES.of_unit)
    # Noise that is stated too large by another factor is only a remark: see `_remarks`.
    if (ratio < 1.0 and other_unit) or ratio > GRADES.unit_ratio:
        looks = f": it looks like {unit}" if other_unit else ""
        yield records.InputFinding(
            what=f"{evidence.noise_mm:.2g} mm is stated, {evidence.error_mm:.2g} mm remain",
            where="stated uncertainty of the position (instrument.uncertainty_mm)",
            remedy=f"check its unit and value{looks}",
            kind="stated_uncertainty",
        )


def _lacking(evidence: GradeEvidence) -> str:
    """Return in words why the model is incomplete; empty where it is not."""
    parts = []
    over = evidence.over_noise
    if over is not None and over > evidence.most_over_noise:
        stated = "" if evidence.noise_is_found or evidence.repeats else "stated "
        text = (
            f"{_compared(evidence)}{over:.2g} times the {stated}noise of "
            f"{evidence.noise_with_apparatus_mm:.3f} mm: the model is missing an effect"
        )
        if stated:
            text += ", or the stated uncertainty is too small"
        if over >= GRADES.stated_ratio:
            text += ", or the instrument moved between readings"
        parts.append(text)
    if (ratio := evidence.over_expected) is not None:
        parts.append(
            f"{ratio:.2g} times the error that the fit promises for held-out poses: they differ "
            "from the poses fitted, or the model is missing an effect"
        )
    if evidence.loses_without_log:
        parts.append(
            f"{evidence.without_log_mm:.3f} mm without the log, by the torques of the weights as "
            "predictions have them: logged torques have a gain, or are not those of weights, tool "
            "and loads as stated; u_mm of predictions holds it"
        )
    rigid_mm = evidence.without_springs_mm
    # Such an error would be graded as that of another robot, if springs did not explain so much.
    if parts and evidence.misfits_arm and evidence.springs_explain_most and rigid_mm is not None:
        parts.append(
            f"a soft arm: with rigid joints {rigid_mm:.3f} mm remain, springs explain the larger "
            "part"
        )
    return "; ".join(parts) + "; see the verdict" if parts else ""


def _few(evidence: GradeEvidence) -> str:
    """Return in words what these poses do not identify, with the remedy; empty where nothing."""
    names, unknowns = evidence.undetermined, len(evidence.ended.parameters)
    identified = f"the poses identify {evidence.rank} of {unknowns} unknowns"
    if not np.isfinite(evidence.u_model_mm):
        # Half as many poses as unknowns; twice that of distances, one reading a pose.
        measured, readings = len(evidence.ended.white), max(evidence.rows, 1)
        poses = max(-(-unknowns // 2), -(-unknowns * measured // readings))
        return f"{identified}; measure at least {poses} poses, well spread"
    if not names:
        return ""
    turned_rad = evidence.turned_rad
    if {*names} <= {*evidence.ended.targets_not_seen}:
        remedy = "these targets are not seen in these poses; see the fit of all loads"
    elif {*names} <= {*evidence.ended.having("weight")}:
        remedy = (
            "state the mass of the tool and its centre (tool in campaign.yaml), or measure under "
            "loads: joints as stiff as these hardly show weights"
        )
    elif turned_rad is not None and turned_rad < GRADES.hardly_turned_rad:
        remedy = (
            "measure poses in other orientations: the tool hardly turned "
            f"({np.degrees(turned_rad):.2g} deg at most)"
        )
    elif evidence.hardly_moved:
        remedy = f"measure poses that move {' and '.join(evidence.hardly_moved)}"
    else:
        remedy = "measure poses that move every joint over its range"
    return f"not identifiable with these poses: {_listed(names)} ({identified}); {remedy}"


def _uncertain(evidence: GradeEvidence) -> str:
    """Return in words how many more poses the required uncertainty needs; empty where none.

    If none is required, it is that of a single reading.
    """
    u_mm, wanted_mm = evidence.u_model_mm, evidence.required_mm
    if u_mm <= wanted_mm:
        return ""
    more = int(np.ceil(len(evidence.ended.white) * ((u_mm / wanted_mm) ** 2 - 1.0)))
    word = "good" if u_mm <= evidence.single_mm else "more uncertain than single readings"
    text = f"{word}: {u_mm:.3f} mm standard uncertainty of predicted positions"
    would_reach = f"{more} more pose{'s' * (more > 1)} would reach"
    if f"{wanted_mm:.3f}" == f"{u_mm:.3f}":
        whose = "of single readings" if evidence.wanted_mm is None else "required"
        return f"{text}, hardly above the {wanted_mm:.3f} mm {whose}; {would_reach} it"
    return f"{text}; {would_reach} {wanted_mm:.3f} mm"


def _remarks(evidence: GradeEvidence) -> Iterator[str]:
    """Return what a reader should know besides the grade."""
    if held := evidence.held_at_bounds:
        yield f"{_listed(held)} at the end of the physical range"
    if evidence.weights:
        yield (
            f"no masses are stated, so weights are assumed from {records.ASSUMED[evidence.weights]}"
            ": stiffness is relative to them"
        )
    log = None if evidence.arm is None else weights_known(evidence.arm).by_log
    if log is not None and log.said:
        yield log.said
    if evidence.com_u_m is not None:
        yield (
            "the tool's centre of mass is not stated (tool.com_mm is 0, 0, 0): it counts as "
            f"unknown by {1e3 * evidence.com_u_m:.0f} mm"
        )
    if departures := evidence.departures:
        more = f" ({len(departures) - 1} more in health.departures)" if departures[1:] else ""
        first = departures[0]
        remedy = f"; {first.remedy}" if first.kind == "joint_zero" else ""
        by = "held-out poses confirm" if evidence.confirmed else "poses that fit to the noise show"
        yield f"{first.where}: {first.what}, as {by}{more}{remedy}"
    if (share := evidence.longer_by) is not None:
        yield (
            f"all long links are {100 * abs(share):.2g} % {'longer' if share > 0.0 else 'shorter'} "
            "than described, which scales all predictions: check the size of the tag, board or "
            "target, and the scale of the instrument"
        )
    if evidence.noisy_campaign is not None:
        yield str(evidence.noisy_campaign)
    if evidence.alike is not None:
        yield str(evidence.alike)
    for scatter in evidence.repeats:
        told = GRADES.repeats_told < scatter.ratio <= GRADES.stated_ratio
        if told and not scatter.is_of_attitude:
            yield (
                f"repeats scatter by {1e3 * scatter.found:.2g} mm, {scatter.ratio:.2g} times what "
                "is stated: the arm's own repeatability, or a change between them; u_mm holds it"
            )
    if evidence.below_noise and not (evidence.repeats or evidence.noise_is_found):
        yield (
            f"the stated noise of {evidence.noise_mm:.2g} mm is larger than what remains: effects "
            "below it stay hidden until a smaller one is stated (instrument.uncertainty_mm)"
        )
    nominal_mm = evidence.nominal_mm
    if nominal_mm is not None and nominal_mm <= GRADES.noticed_ratio * evidence.train_rms_mm:
        yield f"the nominal arm fits as well ({nominal_mm:.3f} mm): nothing is to be calibrated"
    if evidence.ended.identifiability.condition > GRADES.condition:
        yield f"condition number {evidence.ended.identifiability.condition:.1e}"
    if count := evidence.suspected_outliers:
        many = "s" if count > 1 else ""
        yield f"{count} suspected outlier{many}; weights in the fit: tables/suspected_outliers"
        yield from _shown_by_outliers(evidence)


def _shown_by_outliers(evidence: GradeEvidence) -> Iterator[str]:
    """Yield why suspected outliers are no wrong readings, but what the model lacks."""
    if evidence.rigid_outliers:
        yield f"in {evidence.rigid_outliers} of them {RIGID}"
    if evidence.at_one_end:
        yield evidence.at_one_end


def _listed(names: Sequence[str]) -> str:
    """Return the first names, and whether there are others."""
    shown = ", ".join(map(reported_name, names[: GRADES.most_names]))
    return shown + (" and others" if names[GRADES.most_names :] else "")
