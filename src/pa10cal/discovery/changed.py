"""Changes at a row of the log that no motion of base or instrument explains.

From a row on a target sits elsewhere on the flange, all readings are longer along the beam, the arm
carries another load than is stated, or the log follows another model of the arm. Each kind is a
step function of time in columns of its own; the kinds, a step of the base among them, are compared
at every row by their log evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array, Index, rms
from pa10cal.discovery import jacobians
from pa10cal.discovery.log_faults import DiagnosedFault
from pa10cal.discovery.nuisances import Jump, Nuisance, Wander, between_rows, steps_in_time
from pa10cal.discovery.pose_columns import by_pose_and_time
from pa10cal.discovery.rules import CHANGE, MOTION
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import mean_noise_error_mm, position_error_mm
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    may_show_changes,
    measured_again,
    spread_over_time,
    step_thresholds,
)
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.statement_faults import ToolStated

#: `zero` is that of a joint, see `joint_steps`.
Kind = Literal["base", "beam", "target", "tool", "load", "model", "zero"]
WORDS: dict[Kind, str] = {
    "base": "a motion of the instrument or the base",
    "beam": "another size of the reflector",
    "target": "a target that slipped",
    "tool": "a tool that moved on the flange",
    "load": "a load that was put on or taken off",
    "model": "a log that follows another model of the arm",
}


@dataclass(frozen=True, eq=False)
class Change(Nuisance):
    """A change of one kind from a time on."""

    kind: Kind
    target: int  # index of the target that slipped; 0 for other kinds
    when: Jump  # its times
    scale: float  # prior standard deviation of each amount, in units of `CHANGE.size`
    rivals: tuple[str, ...]  # other explanations that fit as well, in words
    amounts: Array  # (k,) in units of `scale`

    @property
    @override
    def sizes(self) -> Array:
        return np.full(len(self.amounts), self.scale)

    @override
    def columns(self, at: FittedModel, poses: Observations) -> Array:
        after = poses.states.time_s > self.when.time_s
        of_kind = change_columns(self.kind, self.target, at, poses)
        return np.asarray(self.scale * of_kind * after[:, None, None])

    def faults(self, at: FittedModel, poses: Observations) -> tuple[DiagnosedFault, ...]:
        """Return the change as a fault of the log."""
        later = poses.take(np.flatnonzero(poses.states.time_s > self.when.time_s))
        size_mm = rms(position_error_mm(later.measured, self.shift(at, later)))
        amount_mm = 1e3 * CHANGE.size * self.scale * self.amounts
        names = poses.measured.target_names
        if self.kind == "target":
            name = names[self.target] if self.target < len(names) else "the target"
            moved_mm = float(np.linalg.norm(amount_mm))
            what = f"target {name} moved on the flange by {moved_mm:.2g} mm from there on"
            remedy = "give it another name from there on, or calibrate the parts as two campaigns"
        elif self.kind == "tool":
            what = f"the tool with all targets moved on the flange, these by {size_mm:.2g} mm"
            remedy = "check how it is fixed; calibrate the parts as two campaigns"
        elif self.kind == "beam":
            along_mm = float(amount_mm[0])
            compared = "longer" if along_mm > 0.0 else "shorter"
            what = (
                f"all readings are {compared} by {abs(along_mm):.3g} mm along the beam from there "
                "on: a reflector of another size, or another zero of the distance"
            )
            remedy = "correct the size of the reflector there, and calibrate again"
        elif self.kind == "load":
            mass_kg = float((load_change(at).prior_factor @ (self.scale * self.amounts))[0])
            what = (
                f"from there on the arm carries {abs(mass_kg):.2g} kg {'more' * (mass_kg > 0.0)}"
                f"{'less' * (mass_kg <= 0.0)} than is stated, which moves the targets by "
                f"{size_mm:.2g} mm: a load that was put on or taken off, or another tool"
            )
            remedy = "state it as load_N in its rows, or calibrate the parts as two campaigns"
        else:
            what = (
                f"from there on the log follows another model of the arm, {size_mm:.2g} mm (root "
                "mean square) away: the joints logged are not the same quantity before and after, "
                "as where a controller's accuracy package is switched or the arm is mastered anew"
            )
            remedy = (
                "log the same joint positions throughout (the axes' own, no corrected ones), or "
                "calibrate the readings before and after as two campaigns"
            )
        if self.rivals:
            what += f"; {' or '.join(self.rivals)} would explain it as well"
        where = between_rows(poses, self.when.before_s, self.when.after_s)
        return (DiagnosedFault(kind="step_in_time", where=where, what=what, remedy=remedy),)


class Step(NamedTuple):
    """The step in some columns with the largest gain in log evidence."""

    gain: float  # of log evidence [nat]
    row: int  # first row after it
    scale: float  # times the usual sizes
    remaining: float  # share of the squared error that remains


def change_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Sequence[Effect],
    *,
    logged: bool,
) -> Change | None:
    """Return what changed at a row of poses that are read once; None for nothing, or for the base.

    Nothing is found where no time was recorded, where poses are in the order of a scan, or where a
    joint or the load passes from one side to the other at the row.
    """
    if not may_show_changes(poses):
        return None
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener = poses.take(shown), whitener[shown]
    rows, kinds = StepRows(at, poses, whitener), kinds_of_change(at, poses, logged=logged)
    steps = {kind: rows.best(change_columns(*kind, at, poses)) for kind in kinds}
    changed = max(kinds, key=lambda kind: steps[kind].gain)
    (kind, target), best, of_base = changed, steps[changed], steps["base", 0]
    needed = nats_needed(len(poses) * len(kinds))
    if kind == "base" or best.gain < max(needed, of_base.gain + CHANGE.better_nats):
        return None
    columns = change_columns(kind, target, at, poses)
    when = rows.when(columns, best)
    if not rows.leaves_little(best) or any(
        step_thresholds(poses.states, when.time_s, at.arm.prismatic)
    ):
        return None
    smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    row = np.array([best.row])
    beside = StepRows(at, poses, whitener, *smooth)
    if not beside.leaves_little(beside.best(columns, row)):
        return None
    # The same change coming on gradually takes up most of a step: it must gain beside that, too.
    gradual = [CHANGE.static_sizes * (columns * course) for course in gradual_courses(poses)]
    if StepRows(at, poses, whitener, *smooth, *gradual).best(columns, row).gain < needed:
        return None
    rivals = dict.fromkeys(
        WORDS[other]
        for (other, _), step in steps.items()
        if other != kind and rows.does_as_well(other, step, best)
    )
    found = rows.as_change(changed, when, best, columns, rivals)
    later = poses.take(np.flatnonzero(poses.states.time_s > when.time_s))
    size_mm = rms(position_error_mm(later.measured, found.shift(at, later)))
    stated_mm = mean_noise_error_mm(later.measured, later.measured.stated_covariance)
    return found if size_mm > CHANGE.least_noise_ratio * stated_mm else None


def nats_needed(tried: int) -> float:
    """Return the log evidence that the best of so many steps, each of several sizes, needs."""
    return float(np.log(tried * len(CHANGE.scales) / CHANGE.false_rate))


def gradual_courses(poses: Observations) -> list[Array]:
    """Return powers of time, of poses in its order, each (P, 1, 1)."""
    course = np.linspace(-1.0, 1.0, len(poses))[:, None, None]
    return [course**power for power in range(1, CHANGE.courses + 1)]


class OtherCauses(NamedTuple):
    """What else than a motion of the base explains its steps."""

    loads: tuple[Change, ...]  # loads that were put on or taken off, which explain some of them
    # other explanations that fit as well, in words, by the time of each of the other steps
    rivals: Mapping[float, tuple[str, ...]]

    def faults(
        self, wander: Wander | None, at: FittedModel, poses: Observations
    ) -> tuple[DiagnosedFault, ...]:
        """Return the steps of the base, and what explains some of them, as faults of the log."""
        of_loads_s = [load.when.time_s for load in self.loads]
        steps = steps_in_time(wander, at, poses, self.rivals, of_loads_s)
        return (*steps, *(fault for load in self.loads for fault in load.faults(at, poses)))


NO_OTHER_CAUSES = OtherCauses((), {})


def other_causes(
    wander: Wander | None, at: FittedModel, poses: Observations, whitener: Array, *, logged: bool
) -> OtherCauses:
    """Return what else explains the steps of the base.

    Where poses were measured again after a step, these show that no target moved, but a load or the
    zero of a joint moves them as well.
    """
    if wander is None or not wander.jumps or poses.measured.campaigns:
        return NO_OTHER_CAUSES
    again = measured_again(poses)
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener = poses.take(shown), whitener[shown]
    time_s = poses.states.time_s
    needed = nats_needed(len(wander.jumps))
    every = kinds_of_change(at, poses, logged=logged)
    kinds = [kind for kind in every[1:] if not again or kind[0] == "load"]
    loads, found = [], dict[float, tuple[str, ...]]()
    for jump in wander.jumps:
        others = tuple(other for other in wander.jumps if other is not jump)
        of_others = replace(wander, jumps=others, amounts=None).columns(at, poses)
        rows = StepRows(at, poses, whitener, of_others)
        row = np.array([np.searchsorted(time_s, jump.time_s)])
        of_base = rows.best(change_columns("base", 0, at, poses), row)
        steps = {kind: rows.best(change_columns(*kind, at, poses), row) for kind in kinds}
        load = steps.get(("load", 0))
        if load is not None and load.gain > of_base.gain + CHANGE.as_good_nats:
            columns = change_columns("load", 0, at, poses)
            loads.append(_load_of(jump, load, of_base, rows, columns))
            continue
        rivals = dict.fromkeys(
            WORDS[kind[0]] for kind in kinds if rows.does_as_well(kind[0], steps[kind], of_base)
        )
        # What a step of the base leaves, too, may be what it explains better than a load.
        if load is not None and load.gain > needed and not rows.leaves_little(of_base):
            rivals[WORDS["load"]] = None
        for joint in range(1, at.arm.n + 1):
            step = rows.best(CHANGE.size * jacobians.by_joints(at, poses, (joint,)), row)
            if rows.does_as_well("zero", step, of_base):
                rivals[f"another zero of joint {joint}"] = None
        found[jump.time_s] = tuple(rivals)
    return OtherCauses(tuple(loads), found)


def load_between_repeats(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Sequence[Effect],
    *,
    logged: bool,
) -> OtherCauses:
    """Return the load that was put on or taken off between readings of the same poses, if any.

    Repeats tell what goes with time from what goes with the pose, so that it is sought beside all
    that depends on either. It has to gain more than a motion of the base, and beside gradual loads;
    or more than these, which few repeats, far apart in time, hardly tell from it.
    """
    if not (may_show_changes(poses) and measured_again(poses)):
        return NO_OTHER_CAUSES
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener = poses.take(shown), whitener[shown]
    if ("load", 0) not in kinds_of_change(at, poses, logged=logged):
        return NO_OTHER_CAUSES
    columns = change_columns("load", 0, at, poses)
    smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    rows = StepRows(at, poses, whitener, *smooth)
    load, of_base = rows.best(columns), rows.best(change_columns("base", 0, at, poses))
    gradual = np.concatenate([columns * course for course in gradual_courses(poses)], axis=2)
    at_once = StepRows(at, poses, whitener, *smooth, CHANGE.static_sizes * gradual)
    needed = nats_needed(2 * len(poses))
    if load.gain < max(needed, of_base.gain + CHANGE.as_good_nats):
        return NO_OTHER_CAUSES
    is_sudden = at_once.best(columns, np.array([load.row])).gain >= needed
    by_gradual = rows.best(gradual, np.array([0])).gain
    if not is_sudden and load.gain < by_gradual + CHANGE.as_good_nats:
        return NO_OTHER_CAUSES
    found = _load_of(rows.when(columns, load), load, of_base, rows, columns)
    if not is_sudden and load.gain < by_gradual + CHANGE.better_nats:
        found = replace(found, rivals=(*found.rivals, "a change that came on slowly"))
    return OtherCauses((found,), {})


def _load_of(jump: Jump, step: Step, of_base: Step, rows: StepRows, columns: Array) -> Change:
    """Return the load that explains a jump of the base."""
    rivals = [WORDS["base"]] if rows.does_as_well("base", of_base, step) else []
    return rows.as_change(("load", 0), jump, step, columns, rivals)


def kinds_of_change(
    at: FittedModel, poses: Observations, *, logged: bool
) -> list[tuple[Kind, int]]:
    """Return the kinds of change, each with the index of its target, the base first.

    Args:
        logged: whether torques were logged: those of any load are among them.
    """
    targets = len(np.ravel(at.targets_m)) // 3
    found: list[tuple[Kind, int]] = [("base", 0), ("beam", 0), ("model", 0)]
    found += [("target", b) for b in range(targets)]
    found += [("tool", 0)] if targets > 1 else []
    yields = any(map(is_spring, at.model.terms)) and poses.states.static_loads is not None
    return [*found, ("load", 0)] if yields and not logged else found


def load_change(at: FittedModel) -> ToolStated:
    """Return the load of the last link that an arm may carry besides what is stated, as a term."""
    mass_kg = at.arm.mass_kg
    arm_kg = 0.0 if mass_kg is None else float(mass_kg.sum())
    return ToolStated("tool", of_calculated=True, n=at.arm.n, tool_kg=0.0, arm_kg=arm_kg)


def change_columns(kind: Kind, target: int, at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of predicted less measured components by a change, (P, b, k)."""
    if kind == "base":
        return CHANGE.size * jacobians.by_base(at, poses)
    of_targets = at.compared(poses).by_targets
    if kind == "target":
        return CHANGE.size * of_targets[:, :, 3 * target : 3 * target + 3]
    if kind == "tool":
        places_m = np.reshape(at.targets_m, (-1, 3))
        return CHANGE.size * of_targets @ by_small_motion(places_m).reshape(-1, 6)
    if kind == "beam":
        return CHANGE.size * _along_beam(poses)
    if kind == "load":
        load = load_change(at)
        return jacobians.by_scaled_effects(at, poses, [load], [np.zeros(4)])[0]
    terms = [term for term in at.model.terms if type(term) is Offsets and term.of != "base"]
    own = jacobians.by_scaled_terms(at, poses, terms)
    frames = [CHANGE.frames * of_targets, CHANGE.frames * jacobians.by_base(at, poses)]
    return np.concatenate([*own, *frames], axis=2)


def _along_beam(poses: Observations) -> Array:
    """Return the direction of each target from the instrument, by components, (P, b, 1)."""
    places_m = poses.measured.places_m
    length_m = np.linalg.norm(places_m, axis=2, keepdims=True)
    along = (places_m / np.maximum(length_m, np.finfo(float).tiny)).reshape(len(poses), -1)
    column = np.zeros((*poses.measured.components_seen.shape, 1))
    column[:, poses.measured.position_columns, 0] = np.nan_to_num(along)
    return column


class StepRows:
    """Whitened rows in order of time, and the log evidence of steps at each of them."""

    def __init__(
        self, at: FittedModel, poses: Observations, whitener: Array, *beside: Array
    ) -> None:
        """Whiten P poses, with columns (P, b, k) in addition to those of model and targets."""
        own = jacobians.by_scaled_terms(at, poses, at.model.terms)
        nuisances = [CHANGE.static_sizes * columns for columns in own]
        nuisances += [MOTION.targets_m * at.compared(poses).by_targets, *beside]
        self._whitener, self._nuisances = whitener, whitener @ np.concatenate(nuisances, axis=2)
        self._data = (whitener @ -at.compared(poses).residual[:, :, None])[:, :, 0]
        self._unchanged = Gaussian.of(self._nuisances, self._data)
        self._time_s = poses.states.time_s
        self._seen = int(poses.measured.components_seen.sum())
        stated = whitener @ poses.measured.stated_covariance @ whitener.swapaxes(1, 2)
        self._stated = float(np.trace(stated, axis1=1, axis2=2).sum())  # squares, if right
        # A step is between rows of different times, with enough rows on either side.
        rows = np.flatnonzero(np.diff(self._time_s, prepend=-np.inf) > 0.0)
        least = CHANGE.least_side
        self._possible = rows[(rows >= least) & (rows <= len(poses) - least)]

    def best(self, columns: Array, rows: Index | None = None) -> Step:
        """Return the best step in columns at any row, or at some rows."""
        rows = self._possible if rows is None else rows
        if not len(rows):
            return Step(gain=-np.inf, row=0, scale=1.0, remaining=1.0)
        gain, remaining = self._gains(columns, rows, CHANGE.scales)
        k, of_scale = np.unravel_index(np.argmax(gain), gain.shape)
        scale = CHANGE.scales[int(of_scale)]
        return Step(float(gain[k, of_scale]), int(rows[k]), scale, float(remaining[k, of_scale]))

    def leaves_little(self, step: Step) -> bool:
        """Return whether a step leaves little of the squared error, or of that beyond noise.

        Noise is as stated, but for what the nuisances take up of it.
        """
        gram = self._unchanged.gram
        taken = float(np.trace(np.linalg.solve(gram + np.eye(len(gram)), gram)))
        free = max(1.0 - taken / self._seen, 0.0)
        noise = free * self._stated / max(self._unchanged.residual_squares, np.finfo(float).tiny)
        if step.remaining <= CHANGE.most_left_share:
            return True
        return noise < 1.0 and step.remaining - noise < CHANGE.most_left_beyond * (1.0 - noise)

    def does_as_well(self, kind: Kind, step: Step, best: Step) -> bool:
        """Return whether a step of another kind does as well as the best.

        By log evidence, or by the likelihood of the remaining squares: having more amounts does not
        count against it. Except for another model of the arm, which can imitate all other kinds.
        """
        if best.gain - step.gain < CHANGE.as_good_nats:
            return True
        ratio = max(step.remaining / best.remaining, np.finfo(float).tiny)
        misfit = 0.5 * self._seen * float(np.log(ratio))
        return kind != "model" and misfit < CHANGE.as_good_nats

    def when(self, columns: Array, step: Step) -> Jump:
        """Return the times of a step, by the rows at which it is nearly as good as at the best."""
        gains = self._gains(columns, self._possible, (step.scale,))[0][:, 0]
        good = self._possible[gains > np.max(gains, initial=-np.inf) - CHANGE.row_nats]
        first, last = (good[0], good[-1]) if len(good) else (step.row, step.row)
        before_s, after_s = self._time_s[[step.row - 1, step.row]]
        middle_s = float(0.5 * (before_s + after_s))
        return Jump(middle_s, float(self._time_s[first - 1]), float(self._time_s[last]))

    def as_change(
        self, of: tuple[Kind, int], when: Jump, step: Step, columns: Array, rivals: Iterable[str]
    ) -> Change:
        """Return a step of a kind and target as a change."""
        amounts, _ = self.amounts_known(columns, step.scale, step.row)
        return Change(*of, when, step.scale, tuple(rivals), amounts)

    def amounts_known(self, columns: Array, scale: float, row: int) -> tuple[Array, Array]:
        """Return the most likely amounts of a step at a row, and their covariance (k, k).

        Amounts (k,) are in units of the scale.

        What remains beyond noise counts as noise.
        """
        steps = self._steps(columns, np.array([row])).in_sizes(np.array([scale]))
        noise = max(1.0, float(steps.residual_squares[0]) / self._seen)
        precision = steps.gram[0] + np.eye(columns.shape[2])
        return np.asarray(steps.mean[0]), noise * np.linalg.inv(precision)

    def _steps(self, columns: Array, rows: Index) -> Gaussians:
        """Return the normal equations of steps in columns (P, b, k) at each of R rows, (R,).

        Nuisances are integrated out.
        """
        step = self._whitener @ columns
        every = np.concatenate([self._nuisances, step, self._data[:, :, None]], axis=2)
        by_row = every.swapaxes(1, 2) @ step
        from_row_on = np.cumsum(by_row[::-1], axis=0)[::-1]
        products = from_row_on[rows]  # (R, h + k + 1, k)
        h = self._nuisances.shape[2]
        return self._unchanged.of_each_further(
            products[:, :h].swapaxes(0, 1), products[:, h:-1], products[:, -1]
        )

    def _gains(self, columns: Array, rows: Index, scales: Sequence[float]) -> tuple[Array, Array]:
        """Return gains of log evidence and shares of squares that remain, (R, S) each.

        The scatter is profiled.
        """
        steps = self._steps(columns, rows)
        gains = np.empty((len(rows), len(scales)))
        remaining = np.empty_like(gains)
        for k, scale in enumerate(scales):
            scaled = steps.in_sizes(np.array([scale]))
            gains[:, k], remaining[:, k] = scaled.gains(self._seen, CHANGE.same_squares)
        return gains, remaining
