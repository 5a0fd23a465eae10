"""Departures from nominal that no arm was built with, and what they look like, as findings."""

from __future__ import annotations

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.calibration.fit_summary import FitSummary
from pa10cal.calibration.rules import GRADES
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.term import TermParameter


def impossible_departures(
    ended: FitSummary, arm: Arm | None, over_noise: float
) -> tuple[InputFinding, ...]:
    """Return departures from nominal that no arm was built with, the largest first.

    Args:
        arm: as described; None where that is not known.
        over_noise: remaining error over the noise, by which standard uncertainties are multiplied.
    """
    std = over_noise * np.sqrt(np.maximum(np.diag(ended.covariance), 0.0))
    excluded = ended.not_identifiable | ended.of_mounting
    found = []
    for parameter, value, u in zip(ended.parameters, ended.solution.x.tolist(), std, strict=True):
        if not parameter.tolerance or parameter.name in excluded:
            continue
        tolerances = abs(value) / parameter.tolerance
        surely = abs(value) - GRADES.chance_errors * u
        if surely > GRADES.far_off_ratio * parameter.tolerance:
            coordinate = ended.departures.get(parameter.name, "")
            as_built = GRADES.chance_errors * float(np.hypot(u, parameter.tolerance))
            joint = _joint_of_zero(arm, coordinate)
            text = _departure_text(parameter, joint, value, tolerances)
            text += _looks_like(arm, coordinate, value, as_built)
            found.append((tolerances, _departure(parameter, text, joint)))
    return tuple(finding for _, finding in sorted(found, key=lambda pair: -pair[0]))


def common_lengthening(ended: FitSummary, arm: Arm) -> float | None:
    """Return the share by which all long links are longer than described; None if they differ.

    Links of which the length is known to `GRADES.length_known` of it count, two at least. They are
    alike within `GRADES.alike_share` of their mean: chance rarely makes two links so alike, and of
    lengths no better known than that it hides a common share more often than not.
    """
    coordinates = [ended.departures.get(each.name, "") for each in ended.parameters]
    lengths_m = dict(enumerate(arm.a_m.tolist(), 1)), dict(enumerate(arm.d_m.tolist(), 1))
    of_kind = dict(zip("ad", lengths_m, strict=True))
    std_m = np.sqrt(np.maximum(np.diag(ended.covariance), 0.0))
    found = []
    for k, coordinate in enumerate(coordinates):
        kind, _, number = coordinate.rpartition("_")
        if kind in of_kind and ended.parameters[k].name not in ended.of_mounting:
            length_m = abs(of_kind[kind][int(number)])
            if std_m[k] < GRADES.length_known * length_m:
                share = ended.solution.x[k] / of_kind[kind][int(number)]
                found.append((length_m, float(share)))
    longest_m = max((length_m for length_m, _ in found), default=0.0)
    shares = [share for length_m, share in found if length_m > GRADES.long_share * longest_m]
    if len(shares) < 2:
        return None
    mean = float(np.mean(shares))
    alike = np.abs(np.array(shares) - mean) < GRADES.alike_share * abs(mean)
    return mean if abs(mean) > GRADES.longer_share and alike.all() else None


def _departure(parameter: TermParameter, text: str, joint: int | None) -> InputFinding:
    return InputFinding(
        what=text,
        where=parameter.name,
        remedy="check this value in the description of the arm, and the zero of its joint in "
        "the log",
        kind="departure",
        joint=joint,
    )


def _joint_of_zero(arm: Arm | None, coordinate: str) -> int | None:
    """Return the joint, from 1, whose zero a chain coordinate is: theta, or d where it slides."""
    kind, _, number = coordinate.rpartition("_")
    if kind not in ("theta", "d"):
        return None
    slides = arm is not None and bool(arm.prismatic[int(number) - 1])
    return int(number) if (kind == "d") == slides else None


def _departure_text(
    parameter: TermParameter, joint: int | None, value: float, tolerances: float
) -> str:
    """Return a departure in words, angles in degrees and lengths in millimetres.

    Args:
        joint: the joint whose zero it is; None for other departures.
    """
    scale, unit = (np.degrees(1.0), "deg") if parameter.unit == "rad" else (1e3, "mm")
    if joint is None:
        return f"{scale * value:.3g} {unit} from nominal ({tolerances:.0f} tolerances)"
    off = f"{scale * abs(value):.3g} {unit}"
    return f"joint {joint} was mastered {off} off ({tolerances:.0f} tolerances)"


def _looks_like(arm: Arm | None, coordinate: str, value: float, as_built: float) -> str:
    """Return what a departure looks like: whole turns of a motor, or the wrong sign of a length.

    Args:
        as_built: departure that the build of the arm and its uncertainty make [rad, m].
    """
    kind, _, number = coordinate.rpartition("_")
    if arm is None or kind not in ("theta", "a", "d"):
        return ""
    row = int(number) - 1
    if kind != "theta":
        length = float((arm.a_m if kind == "a" else arm.d_m)[row])
        reversed_ = abs(value + 2.0 * length) < GRADES.of_a_length * abs(length)
        return f": as if the sign of its {1e3 * length:.4g} mm were wrong" if reversed_ else ""
    ratio = abs(float(arm.gear_ratio[row]))
    per_rad = ratio / (2.0 * np.pi)
    turns = abs(value) * per_rad
    whole = round(turns) if np.isfinite(turns) else 0
    # Any departure is near some number of turns: it has to be as near as the build allows.
    near = min(GRADES.of_a_turn, as_built * per_rad)
    if ratio <= 1.0 or arm.prismatic[row] or not whole or abs(turns - whole) > near:
        return ""
    return f": {whole} turn{'s' * (whole > 1)} of a motor of ratio {ratio:g}"
