"""What speaks against the verdict that nothing is missing.

Errors, repeatability and stated uncertainty have to agree, and the calibration and logged torques
to have nothing against it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pa10cal.calibration.grade_evidence import most_stated
from pa10cal.calibration.rules import GRADES
from pa10cal.discovery.rules import NAMES
from pa10cal.discovery.verdict import Verdict
from pa10cal.fit.position_errors import mean_noise_error_mm
from pa10cal.fit.uncertain_weights import open_unknowns
from pa10cal.terms.weights import holds_weights

#: Grades of the calibration that rule out the verdict `none`.
AGAINST_NONE = ("suspect_input", "not_converged")
#: The same where repeats show the noise. Without repeats the grade `incomplete` rests on a stated
#: uncertainty, which may be off by `names.agree_ratio`.
AGAINST_NONE_BY_REPEATS = (*AGAINST_NONE, "incomplete")


def reasons_against_none(found: Verdict) -> Iterator[str]:
    """Yield what speaks against the verdict that nothing is missing, in words."""
    yield from _disagreements(found)
    train = found.train
    weights = [term for term in found.model.model.terms if holds_weights(term)]
    before_mm, after_mm = train.before.mean_mm, train.after.mean_mm
    if (
        weights
        and after_mm < NAMES.most_left_share * before_mm
        and train.reduction.interval95_mm[0] > 0.0
    ):
        # Loads and stiffness that are off by one factor are weights that are off by its inverse.
        loads = "or all loads do from load_N by one factor, " * bool(
            np.ptp(train.poses.states.load_N)
        )
        yield (
            f"the error falls from {before_mm:.3g} to {after_mm:.3g} mm if the weights may differ "
            f"from the description: they do, {loads}or an effect of gravity is present (such as "
            "encoder_eccentricity of a joint that lifts); logged torques would show which"
        )
    torque = found.scorer.torque_test
    if (
        torque is not None
        and NAMES.most_torque_ratio < torque.F
        and torque.p_value < NAMES.torque_p_value
    ):
        yield (
            f"the logged torques differ from those of the weights: F = {torque.F:.3g}, "
            "as with wrong loads, masses or directions"
        )
    by_repeats, grade = found.noise_floor_from is None, found.baseline.grade
    fitted = found.baseline.fitted_to
    shown = "" if fitted is None else fitted.outliers_show
    if grade == "incomplete" and shown:
        yield f"the calibration is {grade}, with suspected outliers: {shown}"
    elif grade in (AGAINST_NONE_BY_REPEATS if by_repeats else AGAINST_NONE):
        suspicions = () if fitted is None else fitted.suspicions
        yield ": ".join([f"the calibration is {grade}", *(str(each) for each in suspicions[:1])])


def _disagreements(found: Verdict) -> Iterator[str]:
    """Yield disagreements between errors, repeatability and stated uncertainty, in words."""
    train, holdout = found.train, found.trusted_holdout
    measured, floor_mm = train.poses.measured, train.noise_floor_mm
    # Residuals of the fit are smaller than errors by the parameters it takes up; predictions have
    # its uncertainty in addition.
    unknowns, components = open_unknowns(found.model.model), int(measured.components_seen.sum())
    fitted_share = min(unknowns / max(components, 1), GRADES.most_taken_share)
    compared = [
        ("the remaining error", train.after.mean_mm / np.sqrt(1.0 - fitted_share), floor_mm)
    ]
    if holdout is not None:
        expected_mm = float(np.hypot(holdout.noise_floor_mm, floor_mm * np.sqrt(fitted_share)))
        compared.append(("the held-out error", holdout.after.mean_mm, expected_mm))
    # Errors below the repeatability are not those of these readings. Errors below a stated
    # uncertainty cannot be seen, and need not be.
    by_repeats = found.noise_floor_from is None
    source = "the repeatability" if by_repeats else f"the noise by {_origin(found)}"
    for name, value_mm, expected_mm in compared:
        below = by_repeats and value_mm < expected_mm / NAMES.agree_ratio
        if below or value_mm > NAMES.agree_ratio * expected_mm:
            yield f"{name} is {value_mm:.3g} mm where {source} gives {expected_mm:.3g} mm"
    stated_mm = mean_noise_error_mm(measured, measured.stated_covariance)
    joints_mm = GRADES.joint_rad * measured.spread_mm
    most = most_stated(NAMES.agree_ratio, from_touches=measured.from_touches)
    too_small = stated_mm > most * floor_mm
    if too_small or floor_mm > NAMES.agree_ratio * np.hypot(stated_mm, joints_mm):
        yield (
            f"{source} is {floor_mm:.3g} mm where the stated uncertainty gives {stated_mm:.3g} mm"
        )


def _origin(found: Verdict) -> str:
    """Return where the noise of a verdict comes from, in words without a reason."""
    return (found.noise_floor_from or "").partition(":")[0]
