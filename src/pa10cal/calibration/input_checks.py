"""Checks for what is probably wrong in the input, by the nominal arm and quick calibrations.

What is certainly wrong is refused when raw files are read (`campaign.bounds`, `campaign.screens`).
Findings of these checks do not stop a campaign: `docs/raw-data.md` lists all of them in one table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.calibration.checked_campaign import CheckedCampaign, scatter_of_repeats_mm, spread_rows
from pa10cal.calibration.joint_slips import (
    joint_zeros,
    joints_without_motion,
    signs_and_order,
    small_screws,
    small_signs,
)
from pa10cal.calibration.log_changes import CHECK_ALL
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import CHECKS
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.conventions import (
    STILL_WRONG,
    attitudes_off_rad,
    better_convention,
    puts_right,
)
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.raw_file import words_of
from pa10cal.campaign.target_labels import exchange_text, stated_order, stated_shape
from pa10cal.errors import Pa10calError
from pa10cal.files.coupling import coupled_joints
from pa10cal.fit.loads import statics_of
from pa10cal.fit.weighed_arm import weights_finding
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.model import Model

Refusal = TypeVar("Refusal", bound=Pa10calError)

#: Directions of gravity in the frame of the base, by the words of a finding.
_DIRECTIONS = {
    "along +x": (1.0, 0.0, 0.0),
    "along -x": (-1.0, 0.0, 0.0),
    "along +y": (0.0, 1.0, 0.0),
    "along -y": (0.0, -1.0, 0.0),
    "along +z (upside down)": (0.0, 0.0, 1.0),
    "along -z": (0.0, 0.0, -1.0),
}


def check_input(
    campaign: CampaignDescription, arm: Arm, every: Observations, options: CalibrationOptions
) -> tuple[InputFinding, ...]:
    """Return what is probably wrong in a campaign, by single readings of all kinds."""
    members = dict(zip(every.by_campaign(), campaign.campaigns, strict=True))
    if members:
        return tuple(
            finding.model_copy(update={"where": f"{name}: {finding.where}", "joint": None})
            for name, own in every.by_campaign().items()
            for finding in check_input(members[name], arm, own, options)
        )
    single = every.of_kind("grid")
    if campaign.coupling is not None:  # a campaign of a group may have its own
        arm = replace(arm, coupled=coupled_joints(campaign.coupling, arm.prismatic, campaign.name))
    grid, words = average_repeats(single), words_of(campaign, arm.axes_slide)
    checked = CheckedCampaign(
        campaign,
        arm,
        options,
        words,
        grid.take(spread_rows(len(grid))),
        scatter_of_repeats_mm(single),
    )
    # One wrong column may look like other mistakes too: only the first hypothesis that holds is
    # reported.
    hypotheses = (
        _attitudes,
        _scale,
        signs_and_order,
        joint_zeros,
        joints_without_motion,
        _attitudes_in_no_convention,
        _gravity_by_torques,
        small_signs,
        small_screws,
        direction_of_gravity,
    )
    first: tuple[InputFinding, ...] = ()
    for hypothesis in hypotheses:
        finding = hypothesis(checked)
        if finding is not None:
            first = (finding,)
            break
    # A wrong scale changes the distances between targets, too.
    scaled = any(finding.kind == "scale" for finding in first)
    return (
        *_temperature(campaign, every, words),
        *weights_finding(arm),
        *(() if scaled else _target_places(campaign, arm, grid, options)),
        *first,
    )


def explained(error: Refusal, findings: Sequence[InputFinding]) -> Refusal:
    """Return a refusal with the findings of the checks, its likely causes, as remedy.

    A joint without motion may also be locked: then the refusal's own remedy still stands.
    """
    if not findings:
        return error
    remedy = "check the input: " + "; ".join(str(finding) for finding in findings)
    if error.remedy and all(finding.kind == "joint_without_motion" for finding in findings):
        remedy += f"; if that is right, {error.remedy}"
    return type(error)(
        error.what,
        where=error.where,
        value=error.value,
        allowed=error.allowed,
        remedy=remedy,
    )


def _attitudes(checked: CheckedCampaign) -> InputFinding | None:
    """Find that another convention of the orientations than the stated one is right."""
    grid, measured, words = checked.grid, checked.grid.measured, checked.words
    if measured.attitudes is None or measured.from_touches:
        return None
    columns = checked.campaign.columns
    files = () if columns is None else (columns.poses, columns.readings)
    stated = next((each.rotation for each in files if each is not None and each.rotation), None)
    T_instr_target = np.tile(np.eye(4), (len(grid), 1, 1))
    T_instr_target[:, :3, :3] = measured.attitudes
    T_instr_target[:, :3, 3] = measured.places_m[:, 0]
    T_base_ee = Chain.of(checked.arm).forward(grid.states.q_rad)
    better = better_convention(T_base_ee, T_instr_target, stated, words.key("qw"))
    if better is None:
        return None
    return InputFinding(
        kind="attitude_convention",
        where=_columns_of_attitude(checked),
        what=f"the orientations are on average {np.degrees(better.off_rad):.0f} deg off the "
        f"nominal arm, and {np.degrees(better.would_leave_rad):.2g} deg if they are {better.name}",
        remedy=better.remedy,
    )


def _attitudes_in_no_convention(checked: CheckedCampaign) -> InputFinding | None:
    """Find orientations that no position of base and target brings near the nominal arm.

    Neither does a convention that is known, nor another sign or order of joints.
    """
    measured = checked.grid.measured
    if measured.attitudes is None or measured.from_touches:
        return None
    off_rad = attitudes_off_rad(measured, Chain.of(checked.arm).forward(checked.grid.states.q_rad))
    if off_rad < CHECKS.attitude_off_rad:
        return None
    return InputFinding(
        kind="attitude_convention",
        where=_columns_of_attitude(checked),
        what=f"half of the orientations are {np.degrees(off_rad):.0f} deg or more off the nominal "
        "arm, in every convention that is known",
        remedy="check which columns hold the orientation, of which frame in which, and the joints",
    )


def _columns_of_attitude(checked: CheckedCampaign) -> str:
    return checked.words.column("qw") if "qw" in checked.words else "qw, qx, qy, qz"


def _scale(checked: CheckedCampaign) -> InputFinding | None:
    """Find one factor between all readings and the arm, as by a tag's size or a wrong unit."""
    grid, measured = checked.grid, checked.grid.measured
    T_base_ee = Chain.of(checked.arm).forward(grid.states.q_rad)
    first = None if measured.from_touches else measured.scale(T_base_ee)
    if (
        first is None
        or not CHECKS.scales[0] / CHECKS.about_scale < first < CHECKS.scales[1] * CHECKS.about_scale
    ):
        return None

    def scaled(factor: float) -> CheckedCampaign:
        return replace(checked, grid=replace(grid, measured=measured.scaled(factor)))

    q = grid.states.q_rad
    best = minimize_scalar(
        lambda log: scaled(float(np.exp(log))).nominal_misfit_m(q),
        bounds=(
            float(np.log(first / CHECKS.about_scale)),
            float(np.log(first * CHECKS.about_scale)),
        ),
        method="bounded",
        options={"xatol": CHECKS.scale_precision},
    )
    factor = float(np.exp(best.x))
    now_m, left_m = checked.nominal_misfit_m(q), float(best.fun)
    times = 1.0 / factor
    # Calibrated lengths take up any scale, so the nominal arm decides.
    if abs(times - 1.0) < CHECKS.another_scale or not left_m < CHECKS.nominal_left_share * now_m:
        return None
    if left_m > max(checked.not_departures_m, CHECKS.misfit_left_share * now_m):
        return None
    right = scaled(factor).may_be_offered(q, left_m)
    then = "" if right else f", {STILL_WRONG}"
    return InputFinding(
        kind="scale",
        where="the measured positions",
        what=f"readings are {times:.4g} times as long as the arm moves: the nominal arm fits to "
        f"{1e3 * now_m:.3g} mm as read, {1e3 * left_m:.3g} mm if they are divided by that{then}",
        remedy=f"divide the positions by {times:.4g}: check the size of the tag or target as the "
        "instrument holds it, and the unit of the file"
        if right
        else CHECK_ALL,
        would_leave_mm=1e3 * left_m,
    )


def direction_of_gravity(checked: CheckedCampaign) -> InputFinding | None:
    """Find that gravity acts along another axis of the base, by calibrations with elastic joints.

    For an arm that hangs or is mounted on a wall `gravity_m_s2` has to be stated.
    """
    # Without stated weights, an error of joint 1 cannot be told from the sag of an arm on a wall.
    if checked.logs_torques or weights_known(checked.arm).assumed or not checked.above_noise:
        return None
    others = _other_directions(checked.payload)
    if not others:
        return None
    now_mm, _ = checked.calibrated_mm(checked.payload)
    tried = {name: checked.calibrated_mm(other) for name, other in others.items()}
    best = min(tried, key=lambda name: tried[name][0])
    left_mm, noise_mm = tried[best]
    if not left_mm < CHECKS.gravity_left_share * now_mm < np.inf:
        return None
    # Sags under another gravity imitate errors of joints that change with their angles.
    rival_mm = checked.with_errors_of_joints_mm(checked.payload)
    if not left_mm < CHECKS.gravity_left_share * rival_mm:
        return None
    return _other_gravity(
        best,
        others[best],
        f"{now_mm:.3g} mm as stated, {left_mm:.3g} mm then",
        left_mm,
        right=puts_right(left_mm, 1e3 * checked.expected_m, noise_mm),
    )


def _gravity_by_torques(checked: CheckedCampaign) -> InputFinding | None:
    """Find that gravity acts along another axis, by logged torques and those of the masses."""
    payload, states = checked.payload, checked.grid.states
    others = _other_directions(payload) if checked.logs_torques else {}
    if payload is None or not others:
        return None
    nominal, logged = Model(Chain.of(checked.arm), ()), states.tau_Nm

    def correlation(carried: Payload) -> float:
        of_masses = statics_of(nominal, np.zeros(0), states, carried).joint_Nm
        size = np.sqrt(np.sum(of_masses**2) * np.sum(logged**2))
        return float(np.sum(of_masses * logged) / size) if size > 0.0 else 0.0

    now = correlation(payload)
    then = {name: correlation(other) for name, other in others.items()}
    best = max(then, key=lambda name: then[name])
    if then[best] < CHECKS.follows or now > CHECKS.does_not_follow:
        return None
    shown = f"a correlation of {now:.2f} as stated, {then[best]:.2f} then"
    return _other_gravity(best, others[best], shown)


def _other_directions(payload: Payload | None) -> dict[str, Payload]:
    """Return the payload under gravity along each axis of the base but the stated one."""
    size = 0.0 if payload is None else float(np.linalg.norm(payload.gravity_m_s2))
    if payload is None or size == 0.0:
        return {}
    return {
        name: replace(payload, gravity_m_s2=size * np.array(axis))
        for name, axis in _DIRECTIONS.items()
        if np.array(axis) @ payload.gravity_m_s2 < CHECKS.same_gravity * size
    }


def _other_gravity(
    name: str, other: Payload, shown: str, left_mm: float | None = None, *, right: bool = True
) -> InputFinding:
    vector = ", ".join(f"{part + 0.0:.6g}" for part in other.gravity_m_s2)
    also = "" if left_mm is not None else ", or check the signs of the logged torques"
    return InputFinding(
        kind="gravity",
        where="campaign.yaml: gravity_m_s2",
        what=f"gravity seems to act {name} of the base: {shown}"
        + ("" if right else f", {STILL_WRONG}"),
        remedy=f"set gravity_m_s2: [{vector}]{also}"
        if right
        else "check gravity_m_s2, and the masses in the arm's description",
        would_leave_mm=left_mm,
    )


def _target_places(
    campaign: CampaignDescription, arm: Arm, grid: Observations, options: CalibrationOptions
) -> Iterator[InputFinding]:
    """Find wrong or exchanged places of targets, by their distances and by the nominal arm."""
    measured = grid.measured
    # An instrument that touches balls holds them apart from the poses that they give.
    targets = getattr(measured, "balls", measured)
    names, places_m = tuple(getattr(targets, "names", ())), targets.places_m
    if len(names) < 2 or not set(names) <= set(campaign.tool.balls_mm):
        return
    stated_mm = np.array([campaign.tool.balls_mm[name] for name in names])
    off = stated_shape(1e3 * places_m, stated_mm)
    of_touches_mm = options.apparatus_uncertainty_mm if measured.from_touches else arm.size_ratio
    allowed_mm = CHECKS.shape_ratio * of_touches_mm
    if off is None or off.largest_mm < max(allowed_mm, CHECKS.shape_errors * off.u_mm):
        # Distances do not show an exchange in a pair of targets, or in a regular ring.
        some = spread_rows(len(grid))
        nominal = Chain.of(arm).forward(grid.states.q_rad[some])
        order = stated_order(nominal, places_m[some], stated_mm)
        shown = "the nominal arm carries each of them where the other is stated to be"
        if order is None:
            return
    elif off.order is not None:
        order = off.order
        shown = f"distances between targets are up to {off.largest_mm:.3g} mm off as stated"
    else:
        yield InputFinding(
            kind="target_places",
            where=f"tool.balls_mm: {names[off.target]}",
            what=f"target {names[off.target]} is not where it is stated to be: its distance from "
            f"another is {off.largest_mm:.3g} mm off, known to {off.u_mm:.2g} mm",
            remedy="check its stated place",
        )
        return
    swapped = exchange_text(order, names)
    yield InputFinding(
        kind="target_label",
        where=f"tool.balls_mm: {swapped}",
        what=f"the names of {swapped} seem exchanged: {shown}",
        remedy="exchange their stated places, or rename their columns",
    )


def _temperature(
    campaign: CampaignDescription, every: Observations, words: ColumnMap
) -> Iterator[InputFinding]:
    reference_C = campaign.reference_temperature_C
    measured_C = every.states.temperature_C
    known_C = measured_C[np.isfinite(measured_C)]
    stated = {"campaign.yaml: reference_temperature_C": reference_C}
    if len(known_C):
        stated[words.column("temperature_C")] = float(np.median(known_C))
    for where, temperature_C in stated.items():
        if CHECKS.laboratory_C[0] <= temperature_C <= CHECKS.laboratory_C[1]:
            continue
        fahrenheit_C = (temperature_C - 32.0) / 1.8
        remedy = "state temperatures in degrees Celsius"
        if CHECKS.laboratory_C[0] <= fahrenheit_C <= CHECKS.laboratory_C[1]:
            if where.startswith("campaign.yaml"):
                remedy = f"set reference_temperature_C: {fahrenheit_C:.3g}"
            elif words.key("temperature_C"):
                remedy = words.set_unit("temperature_C", "F", "")
        yield InputFinding(
            kind="temperature",
            where=where,
            what=f"{temperature_C:g} deg C is no usual temperature of a laboratory; in degrees "
            f"Fahrenheit it would be {fahrenheit_C:.0f} deg C",
            remedy=remedy,
        )
