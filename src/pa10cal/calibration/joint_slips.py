"""Slips in how joints were logged: signs, order, joints that move together, zeros.

Would much less error be left if they were changed? One change after the other is tried, by the
nominal arm, and where it hardly shows them, by quick calibrations.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import neighbouring_axes
from pa10cal.arrays import Array
from pa10cal.calibration.checked_campaign import CheckedCampaign
from pa10cal.calibration.rules import CHECKS, UNKNOWNS
from pa10cal.campaign.conventions import STILL_WRONG
from pa10cal.campaign.raw_rows import ColumnMap
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.frame.target_problem import SURELY, first_of_least
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.joint import JointCoupling, moved_along

#: What is to be looked at where nothing that was tried puts it right.
CHECK_ALL = "check robot, and order, signs, zeros and units of all joints"


@dataclass(frozen=True)
class _Change:
    """A change of what the controller is taken to count."""

    kind: str  # `joint_sign`, `joint_order` or `joint_coupling`
    # axes, from 1; the one that is reversed, the two that are exchanged, that which each is logged
    # as where all are shifted, or the one that moves with another
    axes: tuple[int, ...]
    factor: float = 0.0  # of the other that is added, in radians or metres

    def of(self, positions: Array) -> Array:
        """Return positions of axes (P, m) with the change made."""
        changed, at = positions.copy(), [axis - 1 for axis in self.axes]
        if self.kind == "joint_sign":
            changed[:, at] *= -1.0
        elif self.kind == "joint_order":
            changed[:, sorted(at)] = positions[:, at if len(at) > 2 else sorted(at)[::-1]]
        else:
            changed[:, at[0]] += self.factor * changed[:, at[1]]
        return changed

    @property
    def text(self) -> str:
        """Say what seems wrong."""
        if self.kind == "joint_sign" and len(self.axes) > 1:
            return "the signs of all joints are reversed"
        if self.kind == "joint_sign":
            return f"the sign of joint {self.axes[0]} is reversed"
        if len(self.axes) > 2:
            return f"the columns are shifted: joint 1 stands in that of joint {self.axes[0]}"
        return f"joints {self.axes[0]} and {self.axes[1]} are exchanged"

    def where(self, words: ColumnMap) -> str:
        """Say which columns are meant."""
        return ", ".join(words.joint(axis) for axis in self.axes)


@dataclass(frozen=True)
class _Log:
    """A log as it is, or changed."""

    checked: CheckedCampaign
    made: tuple[_Change, ...] = ()

    @property
    def q(self) -> Array:
        """Return the positions of the joints, (P, n)."""
        return self.checked.arm.coupling.to_joints(self._made_of(self.checked.axes))

    @property
    def nominal_m(self) -> float:
        """Return the misfit of the nominal arm."""
        return self.checked.nominal_misfit_m(self.q)

    def may_be_below(self, misfit_m: float) -> bool:
        """Return whether the misfit of the nominal arm may be less."""
        return self.checked.least_misfit_m(self.q) <= SURELY * misfit_m

    def with_change(self, change: _Change) -> _Log:
        """Return the log with one more change."""
        return replace(self, made=(*self.made, change))

    def _made_of(self, positions: Array) -> Array:
        for change in self.made:
            positions = change.of(positions)
        return positions

    @property
    def remedy(self) -> str:
        """Say what to state, so that the changes are made."""
        checked, words = self.checked, self.checked.words
        columns = [change for change in self.made if change.kind != "joint_coupling"]
        moved = replace(self, made=tuple(columns))
        slides = checked.arm.axes_slide
        stated = np.array([checked.signs, checked.offsets_deg, range(1, len(slides) + 1)], float)
        changed = moved._made_of(stated)
        order, remedies = np.abs(changed[2]).astype(int), []
        exchanged = bool((order != stated[2]).any())
        if exchanged:
            units = np.where(slides, "mm", "deg")
            names = [f"q{k}_{units[k - 1]}" for k in order]
            which = ", ".join(words.joint(int(k)) for k in order)
            by_hand = f"put the columns in the order {which}"
            if (order != stated[2]).sum() == 2:
                which = next(each.where(words) for each in columns if each.kind == "joint_order")
                by_hand = f"exchange the columns {which}"
            remedies.append(words.set_names(names) if words.key(names[0]) else by_hand)
        if (changed[0] != stated[0]).any():
            signs = ", ".join(str(int(sign)) for sign in changed[0])
            remedies.append(f"set joint_signs: [{signs}]")
        if (changed[1] != stated[1]).any():
            remedies.append(_set_offsets(changed[1]))
        if self.coupled != checked.arm.coupled:
            remedies.append(set_coupling(self.coupled, checked.arm))
        also = "" if exchanged or not columns else ", or reverse the axis in the arm's description"
        return " and ".join(remedies) + also

    @property
    def coupled(self) -> tuple[CoupledJoint, ...]:
        """Return how joints move together in the changed log, whatever signs and order are."""
        arm, coupling = self.checked.arm, self.checked.arm.coupling
        axes = np.eye(len(coupling.own))
        columns = tuple(change for change in self.made if change.kind != "joint_coupling")
        # q = C M c of the log's axes c; and M = F S, with S what signs and order alone do.
        signs_and_order = replace(self, made=columns)._made_of(axes).T
        matrix = coupling.matrix @ self._made_of(axes).T @ np.linalg.inv(signs_and_order)
        found = []
        for joint, axis in np.argwhere(np.abs(matrix) > UNKNOWNS.no_part).tolist():
            if joint != coupling.own[axis]:
                by, follows = int(coupling.own[axis]) + 1, joint not in coupling.own
                found.append(CoupledJoint(joint + 1, by, float(matrix[joint, axis]), follows))
        stated = {(each.joint, each.by): each for each in arm.coupled}
        return tuple(
            stated[key] if key in stated and np.isclose(stated[key].factor, each.factor) else each
            for each in found
            for key in [(each.joint, each.by)]
        )

    def finding(self, now_mm: float, left_mm: float, fits: str, *, right: bool) -> InputFinding:
        """Return what is told of the changes."""
        coupled = any(change.kind == "joint_coupling" for change in self.made)
        text = " and ".join(
            self._coupled_text(change) if change.kind == "joint_coupling" else change.text
            for change in self.made
        )
        if coupled:
            arm = self.checked.arm
            counted = coupling_in_words(replace(arm, coupled=self.coupled))
            text += f" ({counted or 'each by itself'})"
        then = "that is put right" if right else f"so, {STILL_WRONG}"
        return InputFinding(
            kind="joint_coupling" if coupled else self.made[0].kind,
            where="; ".join(change.where(self.checked.words) for change in self.made),
            what=f"{text}: {fits} {now_mm:.3g} mm as logged, {left_mm:.3g} mm if {then}",
            remedy=self.remedy if right else CHECK_ALL,
            would_leave_mm=left_mm,
        )

    def _coupled_text(self, change: _Change) -> str:
        """Say how a joint moves with another."""
        arm, (axis, by) = self.checked.arm, change.axes
        joint, other = (int(arm.coupling.own[k - 1]) + 1 for k in (axis, by))
        if arm.prismatic[joint - 1] and not arm.prismatic[other - 1]:
            return f"joint {joint} slides as joint {other} turns"
        if joint == other + 1:
            between = neighbouring_axes(arm)[other - 1]
            row = between.row - 1
            along = np.sign(np.cos(arm.alpha_rad[row]) * np.cos(arm.beta_rad[row]))
            if between.parallel and not arm.prismatic[joint - 1] and change.factor == -along:
                return (
                    f"joint {joint} is logged to the horizontal, not to the link of joint {other}"
                )
        return f"joint {joint} moves with joint {other}"


def _set_offsets(offsets_deg: Iterable[float]) -> str:
    return f"set joint_offsets_deg: [{', '.join(f'{each + 0.0:.6g}' for each in offsets_deg)}]"


def _signs_and_order(log: _Log) -> Iterator[_Change]:
    slides = log.checked.arm.axes_slide
    yield _Change("joint_sign", tuple(range(1, len(slides) + 1)))
    for axis in range(1, len(slides) + 1):
        yield _Change("joint_sign", (axis,))
    pairs = itertools.combinations(range(1, len(slides) + 1), 2)
    # Of equals the nearest.
    for one, other in sorted(pairs, key=lambda pair: pair[1] - pair[0]):
        if slides[one - 1] == slides[other - 1]:
            yield _Change("joint_order", (one, other))
    if len(slides) > 2 and not log.made:
        for by in range(1, len(slides)):
            logged_as = np.roll(np.arange(len(slides)), by)
            if np.array_equal(slides[logged_as], slides):
                yield _Change("joint_order", tuple((logged_as + 1).tolist()))


def _couplings(log: _Log) -> Iterator[_Change]:
    """Yield joints that move with another of their kind, as far or against it, nearest first."""
    slides = log.checked.arm.axes_slide
    pairs = itertools.permutations(range(1, len(slides) + 1), 2)
    for joint, by in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
        if slides[joint - 1] == slides[by - 1]:
            yield from (_Change("joint_coupling", (joint, by), factor) for factor in (1.0, -1.0))


def _screws(
    log: _Log, error: Callable[[_Log], float], step_mm: float, about: _Change | None = None
) -> Iterator[_Change]:
    """Yield joints that slide as a neighbour turns, each by the pitch that leaves least error.

    The square of an error is nearly a parabola of the pitch; a step each way tells it. `about` is
    a pitch to improve.
    """
    slides = log.checked.arm.axes_slide
    step = 1e-3 * step_mm / (2.0 * np.pi)
    axes = range(1, len(slides) + 1)
    pairs = [(k, by) for k in axes for by in (k - 1, k + 1) if slides[k - 1] and by in axes]
    for pair in (
        [pair for pair in pairs if not slides[pair[1] - 1]] if about is None else [about.axes]
    ):
        middle = 0.0 if about is None else about.factor
        below, here, above = (
            error(log.with_change(_Change("joint_coupling", pair, middle + part * step))) ** 2
            for part in (-1.0, 0.0, 1.0)
        )
        if np.isfinite([below, here, above]).all() and (below + above) / 2.0 > here:
            best = middle + 0.5 * step * (below - above) / (below + above - 2.0 * here)
            pitch_mm = float(f"{1e3 * 2.0 * np.pi * best:.4g}")  # as it is told
            yield _Change("joint_coupling", pair, 1e-3 * pitch_mm / (2.0 * np.pi))


def _nominal_screws(log: _Log) -> Iterator[_Change]:
    return _screws(log, lambda changed: changed.nominal_m, CHECKS.screw_steps_mm[0])


def signs_and_order(checked: CheckedCampaign) -> InputFinding | None:
    """Change signs and order of joints one after the other, as long as much less is left.

    Where that does not put the log right, joints that move together are tried among the changes.
    """
    log = _Log(checked)
    first_m = log.nominal_m
    if first_m < CHECKS.not_departures_m:
        return None
    found: list[tuple[bool, InputFinding]] = []
    for changes in (
        lambda log: list(_signs_and_order(log)),
        lambda log: [*_signs_and_order(log), *_couplings(log), *_nominal_screws(log)],
    ):
        changed, left_m = _changed_in_turn(log, changes)
        # Where nothing at all fits, infinity is left, and no change of it is less.
        least_m = max(CHECKS.not_departures_m, CHECKS.misfit_left_share * first_m)
        most_m = min(CHECKS.nominal_left_share * first_m, least_m)
        if not left_m <= most_m or not np.isfinite(left_m):
            continue
        changed = _with_pitches_calibrated(changed)
        left_m = changed.nominal_m
        right = checked.may_be_offered(changed.q, left_m)
        told = 1e3 * first_m, 1e3 * left_m, "the nominal arm fits to"
        found.append((right, changed.finding(*told, right=right)))
        if right:
            return found[-1][1]
    return found[0][1] if found else None


def _with_pitches_calibrated(log: _Log) -> _Log:
    """Return the log with pitches by calibrations: the nominal arm leaves departures in them."""
    made = list(log.made)
    screws = [k for k, each in enumerate(made) if each.factor not in (-1.0, 0.0, 1.0)]
    for k, step_mm in itertools.product(screws, CHECKS.screw_steps_mm[1:]):

        def error(changed: _Log, k: int = k) -> float:
            own = replace(log, made=(*made[:k], changed.made[-1], *made[k + 1 :]))
            return log.checked.calibrated_mm(log.checked.payload, own.q)[0]

        made[k] = next(_screws(log, error, step_mm, about=made[k]), made[k])
    return replace(log, made=tuple(made))


def _changed_in_turn(log: _Log, changes: Callable[[_Log], Sequence[_Change]]) -> tuple[_Log, float]:
    """Return the log with the best changes made one after the other, and its nominal misfit."""
    left_m = log.nominal_m
    for _ in range(CHECKS.most_changes):
        best = _least_misfit(
            [log.with_change(each) for each in changes(log)], CHECKS.change_left_share * left_m
        )
        if best is None:
            break
        left_m, log = best
    return log, left_m


def _least_misfit(logs: Sequence[_Log], most_m: float) -> tuple[float, _Log] | None:
    """Return the first log with the least misfit, at most so large; None where there is none."""
    least_m = [each.checked.least_misfit_m(each.q) for each in logs]
    best = first_of_least(least_m, lambda k: logs[k].nominal_m, most_m)
    return None if best is None else (best[0], logs[best[1]])


def small_signs(checked: CheckedCampaign) -> InputFinding | None:
    """Try slips whose error departures partly take up, as of a wrist, by calibrating.

    These are signs, order, and neighbours that move together.
    """
    if not checked.above_noise:
        return None
    log = _Log(checked)
    near = (each for each in _couplings(log) if abs(each.axes[0] - each.axes[1]) == 1)
    most_m, tried = CHECKS.worth_trying * log.nominal_m, []
    for changed in map(log.with_change, (*_signs_and_order(log), *near)):
        if not changed.may_be_below(most_m):
            continue
        nominal_m = changed.nominal_m
        if nominal_m < most_m:
            tried.append((checked.calibrated_mm(None, changed.q)[0], nominal_m, changed))
    if not tried:
        return None
    now_mm, _ = checked.calibrated_mm(None)
    left_mm, nominal_m, best = min(tried, key=lambda each: each[0])
    if not left_mm < CHECKS.calibrated_left_share * now_mm < np.inf:
        return None
    right = checked.may_be_offered(best.q, nominal_m)
    return best.finding(now_mm, left_mm, "the arm calibrates to", right=right)


def small_screws(checked: CheckedCampaign) -> InputFinding | None:
    """Find a quill that rises a little as it turns, by calibrating: the rest of a correction."""
    slides = checked.arm.axes_slide
    if slides.all() or not slides.any():
        return None
    now_mm, noise_mm = checked.calibrated_mm(checked.payload)
    if not CHECKS.screw_above_noise * noise_mm < now_mm < np.inf:
        return None

    def error(changed: _Log) -> float:
        return checked.calibrated_mm(checked.payload, changed.q)[0]

    log = _Log(checked)
    tried = [
        (error(changed), changed)
        for changed in map(log.with_change, _screws(log, error, CHECKS.screw_steps_mm[1]))
    ]
    if not tried:
        return None
    left_mm, best = min(tried, key=lambda each: each[0])
    if not left_mm < CHECKS.calibrated_left_share * now_mm:
        return None
    best = _with_pitches_calibrated(best)
    left_mm = error(best)
    right = checked.may_be_offered(best.q, best.nominal_m)
    finding = best.finding(now_mm, left_mm, "the arm calibrates to", right=right)
    joint, by = (int(checked.arm.coupling.own[axis - 1]) + 1 for axis in best.made[-1].axes)
    if moved_along(checked.arm).get(joint) != by:
        return finding
    effect = EffectName(id=JointCoupling.id, of=f"joint {joint}")
    return finding.model_copy(update={"effect": effect})


def joint_zeros(checked: CheckedCampaign) -> InputFinding | None:
    """Find the zero of a joint that is off by more than any mastering, by calibrating."""
    arm, q = checked.arm, checked.grid.states.q_rad
    first_m = checked.nominal_misfit_m(q)
    found = None if first_m < CHECKS.not_departures_m else checked.calibration(checked.payload)
    if found is None:
        return None
    values = {p.name: x for p, x in zip(found.problem.parameters, found.fit.x, strict=True)}
    zeros_rad = np.array([values.get(f"delta_theta_{k}", 0.0) for k in range(1, arm.n + 1)])
    zeros_rad[arm.prismatic] = 0.0
    coupling, k = arm.coupling, int(np.argmax(np.abs(zeros_rad)))
    if abs(zeros_rad[k]) < float(np.radians(CHECKS.no_mastering_deg)):
        return None
    moved = q.copy()
    moved[:, k] += zeros_rad[k]
    left_m = checked.nominal_misfit_m(moved)
    if left_m > CHECKS.nominal_left_share * first_m:
        return None
    right = checked.may_be_offered(moved, left_m)
    off_deg = float(np.degrees(zeros_rad[k]))
    off = coupling.to_axes(zeros_rad[k] * np.eye(arm.n)[k])
    off = np.where(arm.axes_slide, 1e3 * off, np.degrees(off))
    stated = np.array(checked.offsets_deg)
    offsets = np.where(off == 0.0, stated, np.round(stated + off, 3))
    then = "" if right else f", {STILL_WRONG}"
    return InputFinding(
        kind="joint_zero",
        where=checked.words.joint(int(np.searchsorted(coupling.own, k)) + 1),
        what=f"the zero of joint {k + 1} is {abs(off_deg):.3g} deg off: the nominal arm fits "
        f"to {1e3 * first_m:.3g} mm as logged, {1e3 * left_m:.3g} mm without that{then}",
        remedy=f"check the zero of this joint in the log, or {_set_offsets(offsets)}"
        if right
        else CHECK_ALL,
        would_leave_mm=1e3 * left_m,
    )


def joints_without_motion(checked: CheckedCampaign) -> InputFinding | None:
    """Name joints with the same number in all poses, where the nominal arm is far from them all."""
    axes = checked.axes
    still = np.flatnonzero(np.ptp(axes, axis=0) == 0.0)
    if not len(still) or len(still) == axes.shape[1]:
        return None
    left_m = checked.nominal_misfit_m(checked.grid.states.q_rad)
    spread_m = 1e-3 * checked.grid.measured.spread_mm
    if left_m < max(CHECKS.not_departures_m, CHECKS.no_arm_share * spread_m):
        return None
    where = ", ".join(checked.words.joint(int(k) + 1) for k in still)
    last = bool((still == np.arange(axes.shape[1])[-len(still) :]).all())
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
