"""What is probably wrong in the input, by the nominal arm and by quick calibrations of it.

What is certain is refused when raw files are read (`campaign.bounds`, `campaign.screens`). What is
found here leaves the campaign running, marked: `docs/raw-data.md` lists all of it in one table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.joint_checks import (
    Asked,
    above_noise,
    joint_zeros,
    scatter_of_repeats_mm,
    signs_and_order,
    small_signs,
)
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.conventions import EXPECTED_M, STILL_WRONG, better_convention, puts_right
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.labels import exchange_text, stated_order, stated_shape
from pa10cal.campaign.own_words import OwnWords
from pa10cal.campaign.raw_file import words_of
from pa10cal.errors import Pa10calError
from pa10cal.fit.loads import statics_of
from pa10cal.fit.weighed_arm import weights_finding
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.health import InputFinding
from pa10cal.terms.model import Model

Refusal = TypeVar("Refusal", bound=Pa10calError)

#: Poses that a check looks at, spread over all.
MOST_POSES = 100
#: Temperatures at which arms are measured.
LABORATORY_C = (0.0, 50.0)
#: Part of the error that another direction of gravity must leave.
GRAVITY_LEFT = 0.5
#: Logged torques that follow those of the masses correlate with them by so much.
FOLLOWS = 0.9
DOES_NOT_FOLLOW = 0.8
_AXES = {
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
    """Find what is probably wrong in the input, before it is calibrated.

    Args:
        campaign: its description.
        arm: the nominal arm.
        every: single readings of all kinds.
        options: how to calibrate.
    """
    members = dict(zip(every.by_campaign(), campaign.campaigns, strict=True))
    if members:
        return tuple(
            finding.model_copy(update={"where": f"{name}: {finding.where}"})
            for name, own in every.by_campaign().items()
            for finding in check_input(members[name], arm, own, options)
        )
    grid = average_repeats(every.of_kind("grid"))
    some = _some(grid)
    words = words_of(campaign, arm.prismatic)
    found = (
        *_temperature(campaign, every, words),
        *weights_finding(arm),
        *_shape(campaign, arm, grid, options),
    )
    repeats_mm = scatter_of_repeats_mm(every.of_kind("grid"))
    asked = Asked(campaign, arm, options, words, repeats_mm)
    others = _attitudes(asked, some) or signs_and_order(asked, some) or joint_zeros(asked, some)
    if not others and campaign.payload(arm) is not None and _logs_torques(some):
        others = _gravity_by_torques(campaign, arm, some)
    if not others and above_noise(arm, some, options):
        others = small_signs(asked, some) or _gravity(asked, some)
    return (*found, *others)


def explained(error: Refusal, findings: Sequence[InputFinding]) -> Refusal:
    """Return a refusal with what was found in the input, the likely cause, as its remedy."""
    if not findings:
        return error
    return type(error)(
        error.what,
        where=error.where,
        value=error.value,
        allowed=error.allowed,
        remedy="check the input: " + "; ".join(str(finding) for finding in findings),
    )


def _some(observations: Observations) -> Observations:
    count = len(observations)
    rows = np.unique(np.linspace(0, count - 1, min(count, MOST_POSES)).astype(int))
    return observations.take(rows)


def _attitudes(asked: Asked, grid: Observations) -> tuple[InputFinding, ...]:
    """Find the convention of the orientations, where another than the one stated is right."""
    measured, words = grid.measured, asked.words
    if measured.attitudes is None or measured.from_touches:
        return ()
    T_instr_target = np.tile(np.eye(4), (len(grid), 1, 1))
    T_instr_target[:, :3, :3] = measured.attitudes
    T_instr_target[:, :3, 3] = measured.places_m[:, 0]
    T_base_ee = Chain.of(asked.arm).forward(grid.states.q_rad)
    better = better_convention(T_base_ee, T_instr_target, asked.rotation, words.key("qw"))
    if better is None:
        return ()
    return (
        InputFinding(
            kind="attitude_convention",
            where=words.column("qw") if "qw" in words else "qw, qx, qy, qz",
            what=f"the orientations are {np.degrees(better.scatter_rad):.0f} deg off the nominal "
            "arm, "
            f"and {np.degrees(better.would_leave_rad):.2g} deg if they are {better.name}",
            remedy=better.remedy,
            would_leave_mm=None,
        ),
    )


def _logs_torques(grid: Observations) -> bool:
    return bool(np.isfinite(grid.states.tau_Nm).all())


def _gravity(asked: Asked, some: Observations) -> tuple[InputFinding, ...]:
    """Try gravity along the other axes of the base, under springs that give to the masses.

    An arm that hangs or stands on a wall says so by `gravity_m_s2` in the frame of its base.
    """
    payload = asked.campaign.payload(asked.arm)
    # Under weights that nobody stated, an error of joint 1 is as well one of an arm on a wall.
    if payload is None or _logs_torques(some) or weights_known(asked.arm).assumed:
        return ()
    others = _other_directions(payload)
    if not others:
        return ()
    now_mm, _ = asked.calibrated_mm(some, payload)
    left = {name: asked.calibrated_mm(some, other) for name, other in others.items()}
    best = min(left, key=lambda name: left[name][0])
    left_mm, noise_mm = left[best]
    if not left_mm < GRAVITY_LEFT * now_mm < np.inf:
        return ()
    now, then = f"{now_mm:.3g} mm", f"{left_mm:.3g} mm"
    right = puts_right(left_mm, 1e3 * EXPECTED_M, noise_mm)
    return (_other_gravity(best, others[best], now, then, left_mm, right=right),)


def _gravity_by_torques(
    campaign: CampaignDescription, arm: Arm, some: Observations
) -> tuple[InputFinding, ...]:
    """Compare logged torques with those of the masses, under gravity along each axis."""
    payload = campaign.payload(arm)
    others = {} if payload is None else _other_directions(payload)
    if payload is None or not others:
        return ()
    nominal, logged = Model(Chain.of(arm), ()), some.states.tau_Nm

    def follows(carried: Payload) -> float:
        of_masses = statics_of(nominal, np.zeros(0), some.states, carried).torque_Nm
        size = np.sqrt(np.sum(of_masses**2) * np.sum(logged**2))
        return float(np.sum(of_masses * logged) / size) if size > 0.0 else 0.0

    now = follows(payload)
    best = max(others, key=lambda name: follows(others[name]))
    if follows(others[best]) < FOLLOWS or now > DOES_NOT_FOLLOW:
        return ()
    found, then = f"a correlation of {now:.2f}", f"{follows(others[best]):.2f}"
    return (_other_gravity(best, others[best], found, then),)


def _other_directions(payload: Payload) -> dict[str, Payload]:
    """Return the payload under gravity along every axis of the base that is not the one stated."""
    size = float(np.linalg.norm(payload.gravity_m_s2))
    if size == 0.0:
        return {}
    stated = payload.gravity_m_s2 / size
    return {
        name: replace(payload, gravity_m_s2=size * np.array(axis))
        for name, axis in _AXES.items()
        if np.array(axis) @ stated < 0.9
    }


def _other_gravity(
    name: str,
    other: Payload,
    now: str,
    then: str,
    would_leave_mm: float | None = None,
    *,
    right: bool = True,
) -> InputFinding:
    vector = ", ".join(f"{part + 0.0:.6g}" for part in other.gravity_m_s2)
    return InputFinding(
        kind="gravity",
        where="campaign.yaml: gravity_m_s2",
        what=f"gravity seems to act {name} of the base: {now} as stated, {then} then"
        + ("" if right else f", {STILL_WRONG}"),
        remedy=f"set gravity_m_s2: [{vector}]"
        + ("" if would_leave_mm is not None else ", or check the signs of the logged torques")
        if right
        else "check gravity_m_s2, and the masses in the arm's description",
        would_leave_mm=would_leave_mm,
    )


def _shape(
    campaign: CampaignDescription, arm: Arm, grid: Observations, options: CalibrationOptions
) -> Iterator[InputFinding]:
    """Compare the places of targets with those stated: among each other, and on the arm."""
    measured, names = grid.measured, measured_targets(grid)
    if len(names) < 2 or not set(names) <= set(campaign.tool.balls_mm):
        return
    stated_mm = np.array([campaign.tool.balls_mm[name] for name in names])
    off = stated_shape(1e3 * target_places(grid), stated_mm)
    allowed_mm = 10.0 * (options.apparatus_uncertainty_mm if measured.from_touches else 1.0)
    if off is None or off.largest_mm < max(allowed_mm, 5.0 * off.u_mm):
        # Distances do not show what is exchanged in a pair, or in a regular ring.
        some = _some(grid)
        order = stated_order(
            Chain.of(arm).forward(some.states.q_rad), target_places(some), stated_mm
        )
        if order is not None:
            shown = "the nominal arm carries each of them where the other is stated to be"
            yield _exchanged(exchange_text(order, names), shown)
    elif off.order is not None:
        shown = f"distances between targets are up to {off.largest_mm:.3g} mm off as stated"
        yield _exchanged(exchange_text(off.order, names), shown)
    else:
        yield InputFinding(
            kind="target_places",
            where=f"tool.balls_mm: {names[off.target]}",
            what=f"target {names[off.target]} is not where it is stated to be: its distance from "
            f"another is {off.largest_mm:.3g} mm off, known to {off.u_mm:.2g} mm",
            remedy="check its stated place",
            would_leave_mm=None,
        )


def _exchanged(swapped: str, shown: str) -> InputFinding:
    return InputFinding(
        kind="target_label",
        where=f"tool.balls_mm: {swapped}",
        what=f"the names of {swapped} seem exchanged: {shown}",
        remedy="exchange their stated places, or rename their columns",
        would_leave_mm=None,
    )


def _temperature(
    campaign: CampaignDescription, every: Observations, words: OwnWords
) -> Iterator[InputFinding]:
    reference_C = campaign.reference_temperature_C
    measured_C = every.states.temperature_C
    known_C = measured_C[np.isfinite(measured_C)]
    stated = {"campaign.yaml: reference_temperature_C": reference_C}
    if len(known_C):
        stated[words.column("temperature_C")] = float(np.median(known_C))
    for where, temperature_C in stated.items():
        if LABORATORY_C[0] <= temperature_C <= LABORATORY_C[1]:
            continue
        fahrenheit_C = (temperature_C - 32.0) / 1.8
        remedy = "state temperatures in degrees Celsius"
        if LABORATORY_C[0] <= fahrenheit_C <= LABORATORY_C[1]:
            key = words.key("temperature_C")
            if where.startswith("campaign.yaml"):
                remedy = f"set reference_temperature_C: {fahrenheit_C:.3g}"
            elif key:
                remedy = words.set_unit("temperature_C", "F", "")
        yield InputFinding(
            kind="temperature",
            where=where,
            what=f"{temperature_C:g} deg C is no usual temperature of a laboratory; in degrees "
            f"Fahrenheit it would be {fahrenheit_C:.0f} deg C",
            remedy=remedy,
            would_leave_mm=None,
        )


def measured_targets(grid: Observations) -> tuple[str, ...]:
    """Return the names of the targets or balls that an instrument measured one by one."""
    names = getattr(grid.measured, "names", ())
    return tuple(names)


def target_places(grid: Observations) -> Array:
    """Return where targets or balls were measured, (P, B, 3) [m]."""
    balls = getattr(grid.measured, "p_instr_balls_m", None)
    return grid.measured.places_m if balls is None else balls
