"""Departures from nominal that no arm was built with, and what they look like, as findings."""

from __future__ import annotations

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.calibration.fit_summary import FitSummary
from pa10cal.calibration.rules import GRADES
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.term import TermParameter


def large_departures(
    ended: FitSummary, arm: Arm | None, over_noise: float
) -> tuple[InputFinding, ...]:
    """Return departures from nominal that no arm was built with, the largest first.

    Args:
        arm: as described; None where that is not known.
        over_noise: remaining error over the noise, by which standard uncertainties are multiplied.
    """
    std = np.sqrt(np.maximum(np.diag(ended.covariance), 0.0))
    excluded = ended.not_identifiable | ended.of_mounting
    found = []
    for parameter, value, sigma in zip(ended.parameters, ended.solution.x, std, strict=True):
        if not parameter.tolerance or parameter.name in excluded:
            continue
        surely = abs(value) - GRADES.chance_errors * over_noise * sigma
        if surely > GRADES.far_off_ratio * parameter.tolerance:
            tolerances = abs(float(value)) / parameter.tolerance
            found.append((tolerances, _finding(ended, arm, parameter, float(value), tolerances)))
    return tuple(finding for _, finding in sorted(found, key=lambda pair: -pair[0]))


def _finding(
    ended: FitSummary, arm: Arm | None, parameter: TermParameter, value: float, tolerances: float
) -> InputFinding:
    coordinate = ended.departures.get(parameter.name, "")
    text = _departure_text(parameter, coordinate, value, tolerances)
    return InputFinding(
        what=text + _looks_like(arm, coordinate, value),
        where=parameter.name,
        remedy="check this value in the description of the arm, and the zero of its joint in "
        "the log",
        kind="departure",
    )


def _departure_text(
    parameter: TermParameter, coordinate: str, value: float, tolerances: float
) -> str:
    """Return a departure in words, angles in degrees and lengths in millimetres.

    Args:
        coordinate: that of the chain, such as `theta_3`.
    """
    kind, _, joint = coordinate.rpartition("_")
    if kind == "theta":
        off = f"{np.degrees(abs(value)):.3g} deg"
        return f"joint {joint} was mastered {off} off ({tolerances:.0f} tolerances)"
    angle = parameter.unit == "rad"
    off = f"{np.degrees(value):.3g} deg" if angle else f"{1e3 * value:.3g} mm"
    return f"{off} from nominal ({tolerances:.0f} tolerances)"


def _looks_like(arm: Arm | None, coordinate: str, value: float) -> str:
    """Return what a departure looks like: whole turns of a motor, or the wrong sign of a length."""
    kind, _, number = coordinate.rpartition("_")
    if arm is None or kind not in ("theta", "a", "d"):
        return ""
    row = int(number) - 1
    if kind != "theta":
        length = float((arm.a_m if kind == "a" else arm.d_m)[row])
        reversed_ = abs(value + 2.0 * length) < GRADES.of_a_length * abs(length)
        return f": as if the sign of its {1e3 * length:.4g} mm were wrong" if reversed_ else ""
    ratio = abs(float(arm.gear_ratio[row]))
    turns = abs(value) * ratio / (2.0 * np.pi)
    whole = round(turns) if np.isfinite(turns) else 0
    if ratio <= 1.0 or not whole or abs(turns - whole) > GRADES.of_a_turn:
        return ""
    return f": {whole} turn{'s' * (whole > 1)} of a motor of ratio {ratio:g}"
