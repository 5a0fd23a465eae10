"""The checks behind the grade of a calibration, in words: what was found, and up to what it holds.

Each is a test by which `health` grades, from the same numbers and limits. A parameter at the end of
its range has no part in the grade: it is told, and counts neither as passed nor as failed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pa10cal.calibration.grade_evidence import NO_NOISE, GradeEvidence
from pa10cal.results.calibration import GradeCheck, InputFinding, RepeatScatter
from pa10cal.terms.joint_spring import reported_name


def grade_checks(evidence: GradeEvidence, findings: Sequence[InputFinding]) -> Iterator[GradeCheck]:
    """Yield what a grade rests on.

    Args:
        evidence: of the calibration.
        findings: what is suspected of the input.
    """
    solution = evidence.ended.solution
    yield _check("the fit converged", solution.reason, passes=solution.converged)
    more = f"; {len(findings) - 1} more" if findings[1:] else ""
    first = f"{findings[0].where}: {findings[0].what}{more}" if findings else "nothing"
    yield _check("nothing in the input is suspect", first, passes=not findings)
    held = evidence.held_at_bounds
    names = ", ".join(map(reported_name, held)) or "none"
    yield _check("no parameter is at the end of its range", names, passes=None if held else True)
    yield _of_determination(evidence)
    yield _of_noise(evidence)
    yield _of_held_out(evidence)
    if evidence.lost_without_log_mm:
        yield _of_torques(evidence)
    for scatter in evidence.repeats:
        yield _of_repeats(evidence, scatter)
    yield _of_predictions(evidence)


def _check(check: str, found: str, limit: str = "", *, passes: bool | None) -> GradeCheck:
    return GradeCheck(check=check, found=found, limit=limit, passes=passes)


def _of_determination(evidence: GradeEvidence) -> GradeCheck:
    """Return whether the poses determine the parameters; not those that no poses could."""
    undetermined = sorted(map(reported_name, evidence.undetermined))
    condition = evidence.ended.identifiability.condition
    found = (
        f"rank {evidence.rank} of {len(evidence.ended.parameters)}, "
        f"condition number {condition:.4g}"
    )
    if undetermined:
        found += f"; {len(undetermined)} not determined, such as {undetermined[0]}"
    check = "everything that other poses could determine is determined"
    return _check(check, found, passes=evidence.is_determined)


def _of_noise(evidence: GradeEvidence) -> GradeCheck:
    """Return whether noise explains the remaining error, corrected for what the fit absorbed."""
    check = "noise explains the remaining error"
    over, noise_mm = evidence.over_noise, evidence.noise_with_apparatus_mm
    if noise_mm is None:
        return _check(check, "the noise is not known", passes=None)
    if over is None:
        remains = f"{evidence.error_mm:.3f} mm, and {NO_NOISE}"
        return _check(check, remains, passes=None)
    noise = "noise by repeats" if evidence.noise_by_repeats else "stated noise"
    if evidence.apparatus_mm:
        noise += " and targets"
    return _check(
        check,
        f"{evidence.error_mm:.3f} mm with the part that the fit absorbed, {over:.2f} times the "
        f"{noise} of {noise_mm:.3f} mm",
        f"{evidence.most_over_noise:.2f} times",
        passes=over <= evidence.most_over_noise,
    )


def _of_held_out(evidence: GradeEvidence) -> GradeCheck:
    """Return whether held-out poses are predicted as well as the fit promises."""
    check, ratio = "held-out poses agree with what the fit promises", evidence.over_promised
    if evidence.held_out is None:
        return _check(check, "nothing was held out", passes=None)
    error = f"{evidence.held_out.accuracy.rms_mm:.3f} mm rms"
    if ratio is None:
        return _check(check, f"{error}, and predictions are not determined", passes=None)
    return _check(
        check,
        f"{error}, {ratio:.2f} times what is promised",
        f"{evidence.most_over_promised:.2f} times",
        passes=ratio <= evidence.most_over_promised,
    )


def _of_torques(evidence: GradeEvidence) -> GradeCheck:
    """Return whether the torques of the weights, by which models predict, do as the log does."""
    return _check(
        "poses are predicted without the torque log as with it",
        f"{evidence.without_log_mm:.3f} mm by the torques of the weights, {evidence.error_mm:.3f} "
        "mm by the log",
        passes=not evidence.loses_without_log,
    )


def _of_repeats(evidence: GradeEvidence, scatter: RepeatScatter) -> GradeCheck:
    """Return whether the scatter of repeats agrees with the uncertainty that is stated."""
    unit = "mrad" if scatter.is_of_attitude else "mm"
    least, most = evidence.accepted_scatter(scatter)
    return _check(
        f"the stated uncertainty agrees with the scatter of repeats, {scatter.kind}",
        f"{1e3 * scatter.found:.4f} {unit}, stated {1e3 * scatter.stated:.4f} {unit}",
        f"{1e3 * least:.4f} to {1e3 * most:.4f} {unit}",
        passes=least <= scatter.found <= most,
    )


def _of_predictions(evidence: GradeEvidence) -> GradeCheck:
    """Return whether predicted positions are as certain as required."""
    required = "required" if evidence.wanted_mm else "of a single reading"
    u_mm = evidence.poses.u_model_mm
    return _check(
        "predicted positions are certain enough",
        "not determined" if u_mm is None else f"{u_mm:.3f} mm standard uncertainty",
        f"{evidence.required_mm:.3f} mm, {required}",
        passes=evidence.u_model_mm <= evidence.required_mm,
    )
