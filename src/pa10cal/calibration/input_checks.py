"""What is probably wrong in the input, by the nominal arm and by quick calibrations of it.

What is certain is refused when raw files are read (`campaign.bounds`, `campaign.screens`). What is
found here leaves the campaign running, marked: `docs/raw-data.md` lists all of it in one table.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.checked_campaign import CheckedCampaign, scatter_of_repeats_mm, spread_rows
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import CHECKS
from pa10cal.campaign.conventions import EXPECTED_M, STILL_WRONG, better_convention, puts_right
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.nominal_fit import exchange_text, stated_order, stated_shape
from pa10cal.campaign.own_columns import OwnWords
from pa10cal.campaign.raw_file import words_of
from pa10cal.errors import Pa10calError
from pa10cal.fit.loads import statics_of
from pa10cal.fit.weighed_arm import weights_finding
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.model import Model

Refusal = TypeVar("Refusal", bound=Pa10calError)

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
    """Find what is probably wrong in a campaign, by single readings of all kinds."""
    members = dict(zip(every.by_campaign(), campaign.campaigns, strict=True))
    if members:
        return tuple(
            finding.model_copy(update={"where": f"{name}: {finding.where}"})
            for name, own in every.by_campaign().items()
            for finding in check_input(members[name], arm, own, options)
        )
    single = every.of_kind("grid")
    grid, words = average_repeats(single), words_of(campaign, arm.prismatic)
    checked = CheckedCampaign(
        campaign,
        arm,
        options,
        words,
        grid.take(spread_rows(len(grid))),
        scatter_of_repeats_mm(single),
    )
    # One wrong column explains what others seem to show: the first hypothesis that holds is told.
    hypotheses = (
        _attitudes,
        _scale,
        signs_and_order,
        _joint_zeros,
        _joints_without_motion,
        _gravity_by_torques,
        _small_signs,
        _gravity,
    )
    others = (finding for hypothesis in hypotheses if (finding := hypothesis(checked)))
    return (
        *_temperature(campaign, every, words),
        *weights_finding(arm),
        *_target_places(campaign, arm, grid, options),
        *itertools.islice(others, 1),
    )


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


def _attitudes(checked: CheckedCampaign) -> InputFinding | None:
    """Find the convention of the orientations, where another than the one stated is right."""
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
        where=words.column("qw") if "qw" in words else "qw, qx, qy, qz",
        what=f"the orientations are {np.degrees(better.scatter_rad):.0f} deg off the nominal arm, "
        f"and {np.degrees(better.would_leave_rad):.2g} deg if they are {better.name}",
        remedy=better.remedy,
    )


def _scale(checked: CheckedCampaign) -> InputFinding | None:
    """Find one factor between all readings and the arm: of a tag's size, or of a wrong unit."""
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
    # Calibrated lengths take up any scale: only the arm as described can tell.
    if abs(times - 1.0) < CHECKS.another_scale or not left_m < CHECKS.nominal_left_share * now_m:
        return None
    if left_m > max(CHECKS.not_departures_m, CHECKS.misfit_left_share * now_m):
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
        else _CHECK_ALL,
        would_leave_mm=1e3 * left_m,
    )


def _gravity(checked: CheckedCampaign) -> InputFinding | None:
    """Try gravity along the other axes of the base, with joints elastic under the masses described.

    An arm that hangs or stands on a wall says so by `gravity_m_s2` in the frame of its base.
    """
    # Under weights that nobody stated, an error of joint 1 is as well one of an arm on a wall.
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
    return _other_gravity(
        best,
        others[best],
        f"{now_mm:.3g} mm as stated, {left_mm:.3g} mm then",
        left_mm,
        right=puts_right(left_mm, 1e3 * EXPECTED_M, noise_mm),
    )


def _gravity_by_torques(checked: CheckedCampaign) -> InputFinding | None:
    """Compare logged torques with those of the masses, under gravity along each axis."""
    payload, states = checked.payload, checked.grid.states
    others = _other_directions(payload) if checked.logs_torques else {}
    if payload is None or not others:
        return None
    nominal, logged = Model(Chain.of(checked.arm), ()), states.tau_Nm

    def follows(carried: Payload) -> float:
        of_masses = statics_of(nominal, np.zeros(0), states, carried).torque_Nm
        size = np.sqrt(np.sum(of_masses**2) * np.sum(logged**2))
        return float(np.sum(of_masses * logged) / size) if size > 0.0 else 0.0

    now, follow = follows(payload), {name: follows(other) for name, other in others.items()}
    best = max(follow, key=lambda name: follow[name])
    if follow[best] < CHECKS.follows or now > CHECKS.does_not_follow:
        return None
    shown = f"a correlation of {now:.2f} as stated, {follow[best]:.2f} then"
    return _other_gravity(best, others[best], shown)


def _other_directions(payload: Payload | None) -> dict[str, Payload]:
    """Return the payload under gravity along every axis of the base that is not the one stated."""
    size = 0.0 if payload is None else float(np.linalg.norm(payload.gravity_m_s2))
    if payload is None or size == 0.0:
        return {}
    return {
        name: replace(payload, gravity_m_s2=size * np.array(axis))
        for name, axis in _AXES.items()
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
    """Compare the places of targets with those stated: among each other, and on the arm."""
    measured = grid.measured
    # Targets or balls that the instrument measured one by one, (P, B, 3).
    targets = getattr(measured, "balls", measured)
    names, places_m = tuple(getattr(targets, "names", ())), targets.places_m
    if len(names) < 2 or not set(names) <= set(campaign.tool.balls_mm):
        return
    stated_mm = np.array([campaign.tool.balls_mm[name] for name in names])
    off = stated_shape(1e3 * places_m, stated_mm)
    of_touches_mm = options.apparatus_uncertainty_mm if measured.from_touches else 1.0
    allowed_mm = CHECKS.shape_ratio * of_touches_mm
    if off is None or off.largest_mm < max(allowed_mm, CHECKS.shape_errors * off.u_mm):
        # Distances do not show what is exchanged in a pair, or in a regular ring.
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
    campaign: CampaignDescription, every: Observations, words: OwnWords
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


# Signs, order and zeros of the joints: would much less error be left if they were changed?

_CHECK_ALL = "check robot, and order, signs, zeros and units of all joints"


@dataclass(frozen=True)
class _Change:
    """A change of the joint columns."""

    kind: str  # `joint_sign` or `joint_order`
    joints: tuple[int, ...]  # from 1; the one that is reversed, or the two that are exchanged

    def of(self, q: Array) -> Array:
        """Return joint columns (P, n) with the change made."""
        q, at = q.copy(), [joint - 1 for joint in self.joints]
        if self.kind == "joint_sign":
            q[:, at] *= -1.0
        else:
            q[:, at] = q[:, at[::-1]]
        return q

    @property
    def text(self) -> str:
        """Say what seems wrong."""
        if self.kind == "joint_sign" and len(self.joints) > 1:
            return "the signs of all joints are reversed"
        if self.kind == "joint_sign":
            return f"the sign of joint {self.joints[0]} is reversed"
        return f"joints {self.joints[0]} and {self.joints[1]} are exchanged"

    def where(self, words: OwnWords) -> str:
        """Say which columns are meant."""
        return ", ".join(words.joint(joint) for joint in self.joints)


def _remedies(made: Sequence[_Change], checked: CheckedCampaign) -> str:
    """Say what to state, so that the changes are made."""
    words, n = checked.words, checked.arm.n
    stated = np.array([checked.signs, checked.offsets_deg, range(1, n + 1)], dtype=float)
    changed = stated
    for change in made:
        changed = change.of(changed)
    order = np.abs(changed[2]).astype(int)
    remedies = []
    exchanged = bool((order != stated[2]).any())
    if exchanged:
        units = np.where(checked.arm.prismatic, "mm", "deg")
        names = [f"q{k}_{units[k - 1]}" for k in order]
        moved = next(change.where(words) for change in made if change.kind == "joint_order")
        by_hand = f"exchange the columns {moved}"
        remedies.append(words.set_names(names) if words.key(names[0]) else by_hand)
    if (changed[0] != stated[0]).any():
        remedies.append(f"set joint_signs: [{', '.join(str(int(sign)) for sign in changed[0])}]")
    if (changed[1] != stated[1]).any():
        remedies.append(_set_offsets(changed[1]))
    also = "" if exchanged else ", or reverse the axis in the arm's description"
    return " and ".join(remedies) + also


def _set_offsets(offsets_deg: Iterable[float]) -> str:
    return f"set joint_offsets_deg: [{', '.join(f'{each + 0.0:.6g}' for each in offsets_deg)}]"


def _changes(arm: Arm) -> Iterator[_Change]:
    yield _Change("joint_sign", tuple(range(1, arm.n + 1)))
    for joint in range(1, arm.n + 1):
        yield _Change("joint_sign", (joint,))
    pairs = itertools.combinations(range(1, arm.n + 1), 2)
    # Of equals the nearest.
    for one, other in sorted(pairs, key=lambda pair: pair[1] - pair[0]):
        if arm.prismatic[one - 1] == arm.prismatic[other - 1]:
            yield _Change("joint_order", (one, other))


def signs_and_order(checked: CheckedCampaign) -> InputFinding | None:
    """Change signs and order of joints one after the other, as long as much less is left."""
    q = checked.grid.states.q_rad
    first_m = left_m = checked.nominal_misfit_m(q)
    if first_m < CHECKS.not_departures_m:
        return None
    made: list[_Change] = []
    for _ in range(CHECKS.most_changes):
        tried = [(checked.nominal_misfit_m(each.of(q)), each) for each in _changes(checked.arm)]
        least_m, best = min(tried, key=lambda each: each[0])
        if least_m > CHECKS.change_left_share * left_m:
            break
        q, left_m = best.of(q), least_m
        made.append(best)
    # Where nothing at all fits, infinity is left, and no change of it is less.
    least_m = max(CHECKS.not_departures_m, CHECKS.misfit_left_share * first_m)
    most_m = min(CHECKS.nominal_left_share * first_m, least_m)
    if not left_m <= most_m or not np.isfinite(left_m):
        return None
    right = checked.may_be_offered(q, left_m)
    return _changed(made, checked, 1e3 * first_m, 1e3 * left_m, "the nominal arm fits to", right)


def _small_signs(checked: CheckedCampaign) -> InputFinding | None:
    """Try signs and order whose error departures partly take up, as of a wrist, by calibrating."""
    if not checked.above_noise:
        return None
    q = checked.grid.states.q_rad
    most_m, tried = CHECKS.worth_trying * checked.nominal_misfit_m(q), []
    for change in _changes(checked.arm):
        nominal_m = checked.nominal_misfit_m(change.of(q))
        if nominal_m < most_m:
            tried.append((checked.calibrated_mm(None, change.of(q))[0], nominal_m, change))
    if not tried:
        return None
    now_mm, _ = checked.calibrated_mm(None)
    left_mm, nominal_m, best = min(tried, key=lambda each: each[0])
    if not left_mm < CHECKS.calibrated_left_share * now_mm < np.inf:
        return None
    right = checked.may_be_offered(best.of(q), nominal_m)
    return _changed([best], checked, now_mm, left_mm, "the arm calibrates to", right)


def _changed(
    made: Sequence[_Change],
    checked: CheckedCampaign,
    now_mm: float,
    left_mm: float,
    fits: str,
    right: bool,
) -> InputFinding:
    text = " and ".join(change.text for change in made)
    then = "that is put right" if right else f"so, {STILL_WRONG}"
    return InputFinding(
        kind=made[0].kind,
        where="; ".join(change.where(checked.words) for change in made),
        what=f"{text}: {fits} {now_mm:.3g} mm as logged, {left_mm:.3g} mm if {then}",
        remedy=_remedies(made, checked) if right else _CHECK_ALL,
        would_leave_mm=left_mm,
    )


def _joint_zeros(checked: CheckedCampaign) -> InputFinding | None:
    """Find the zero of a joint that is off by more than any mastering, by calibrating."""
    arm, q = checked.arm, checked.grid.states.q_rad
    first_m = checked.nominal_misfit_m(q)
    found = None if first_m < CHECKS.not_departures_m else checked.calibration(checked.payload)
    if found is None:
        return None
    values = {p.name: x for p, x in zip(found.problem.parameters, found.fit.x, strict=True)}
    zeros_rad = np.array([values.get(f"delta_theta_{k}", 0.0) for k in range(1, arm.n + 1)])
    zeros_rad[arm.prismatic] = 0.0
    k = int(np.argmax(np.abs(zeros_rad)))
    if abs(zeros_rad[k]) < float(np.radians(CHECKS.no_mastering_deg)):
        return None
    moved = q.copy()
    moved[:, k] += zeros_rad[k]
    left_m = checked.nominal_misfit_m(moved)
    if left_m > CHECKS.nominal_left_share * first_m:
        return None
    right = checked.may_be_offered(moved, left_m)
    off_deg, offsets = float(np.degrees(zeros_rad[k])), checked.offsets_deg
    offsets[k] = round(offsets[k] + off_deg, 3)
    then = "" if right else f", {STILL_WRONG}"
    return InputFinding(
        kind="joint_zero",
        where=checked.words.joint(k + 1),
        what=f"the zero of joint {k + 1} is {abs(off_deg):.3g} deg off: the nominal arm fits "
        f"to {1e3 * first_m:.3g} mm as logged, {1e3 * left_m:.3g} mm without that{then}",
        remedy=f"check the zero of this joint in the log, or {_set_offsets(offsets)}"
        if right
        else _CHECK_ALL,
        would_leave_mm=1e3 * left_m,
    )


def _joints_without_motion(checked: CheckedCampaign) -> InputFinding | None:
    """Name joints with the same number in all poses, where the nominal arm is far from them all."""
    q = checked.grid.states.q_rad
    still = np.flatnonzero(np.ptp(q, axis=0) == 0.0)
    if not len(still) or len(still) == checked.arm.n:
        return None
    left_m = checked.nominal_misfit_m(q)
    spread_m = 1e-3 * checked.grid.measured.spread_mm
    if left_m < max(CHECKS.not_departures_m, CHECKS.no_arm_share * spread_m):
        return None
    where = ", ".join(checked.words.joint(int(k) + 1) for k in still)
    last = bool((still == np.arange(checked.arm.n - len(still), checked.arm.n)).all())
    shifted = "; or the columns hold the joints that come after theirs, the first ones lost"
    one = len(still) == 1
    return InputFinding(
        kind="joint_without_motion",
        where=where,
        what=f"the same number in all poses, and the nominal arm is {1e3 * left_m:.3g} mm off: "
        f"{'a joint' if one else 'joints'} that moved {'was' if one else 'were'} not logged"
        + (shifted if last else ""),
        remedy="export what was logged of "
        + ("this joint" if one else "these joints")
        + (", and check the order of all columns" if last else ""),
    )
