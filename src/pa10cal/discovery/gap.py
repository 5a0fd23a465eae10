"""How much nearer the extended model comes to the measurement: paired, pose by pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import gammaln, stdtrit

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.uncertainty import summarise
from pa10cal.discovery.finding import name_of
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.analysis import GapRows, NamingStep
from pa10cal.results.discovery import LoadGap, Reduction, SetGap
from pa10cal.results.evaluation import Accuracy, BeforeAfter
from pa10cal.terms.effects.effect import Effect

_LEVEL = 0.95


@dataclass(frozen=True)
class PairedErrors:
    """The gap between two models and measurement on some configurations."""

    poses: Observations  # P configurations
    # found_before and found_after: deviations of the calibrated baseline and of the extended model,
    # configuration by configuration
    found_before: Deviations
    found_after: Deviations
    noise_floor_mm: float  # mean error that their noise alone would leave
    # (P,) configurations that keep to the joint positions that the fit has seen; the others are
    # extrapolated. None where that is not needed
    inside: Mask | None = None
    # deviations before and after with the motion of the base that was found taken out of the
    # readings. It is in no model, and in none of the other numbers. None where no motion was
    # found.
    without_motion: tuple[Deviations, Deviations] | None = None
    # deviations with all that the search held and has no name in the model as well, which is not
    # the one that is written; None where it held nothing of the kind
    with_rivals: Deviations | None = None

    @cached_property
    def before(self) -> Accuracy:
        """Return the errors of the calibrated baseline."""
        return summarise(self.found_before)

    @cached_property
    def after(self) -> Accuracy:
        """Return the errors of the extended model."""
        return summarise(self.found_after)

    @cached_property
    def reduction(self) -> Reduction:
        """Return the mean reduction of the error, paired over poses."""
        return self.reduction_of(slice(None))

    def reduction_of(self, rows: Mask | slice) -> Reduction:
        """Return the mean reduction over some configurations, paired over their poses.

        Its interval is the mean where there is one pose.
        """
        saved_mm = self.found_before.distance_mm - self.found_after.distance_mm
        _, group = np.unique(self.poses.pose[rows], return_inverse=True)
        by_pose = np.bincount(group, saved_mm[rows]) / np.bincount(group)
        count, mean = len(by_pose), float(by_pose.mean())
        half = 0.0
        if count > 1:
            spread = float(by_pose.std(ddof=1)) / np.sqrt(count)
            half = float(stdtrit(count - 1, 0.5 + _LEVEL / 2.0)) * spread
        return Reduction(mean_mm=mean, interval95_mm=(mean - half, mean + half), poses=count)

    def accuracies(self, rows: Mask | None) -> BeforeAfter | None:
        """Return the errors over some configurations; None where there is none."""
        if rows is None or not rows.any():
            return None
        return BeforeAfter(
            before=summarise(self.found_before, rows), after=summarise(self.found_after, rows)
        )

    def record(self, suspected: Mask | None = None) -> SetGap:
        """Return the gap as it is written: over all loads, by load, and by what the fit saw.

        Configurations that have a suspected reading (P,) are counted apart as well.
        """
        load_N, still = self.poses.states.load_N, self.without_motion
        loads = {f"{load:g}N": load_N == load for load in np.unique(load_N)}
        return SetGap(
            before=self.before,
            after=self.after,
            noise_floor_mm=self.noise_floor_mm,
            reduction=self.reduction,
            per_load={
                load: LoadGap(
                    before=summarise(self.found_before, rows),
                    after=summarise(self.found_after, rows),
                    reduction=self.reduction_of(rows),
                )
                for load, rows in loads.items()
            },
            inside=self.accuracies(self.inside),
            outside=None if self.inside is None else self.accuracies(~self.inside),
            trusted=None
            if suspected is None or not suspected.any()
            else self.accuracies(~suspected),
            without_motion=None
            if still is None
            else BeforeAfter(before=summarise(still[0]), after=summarise(still[1])),
            with_rivals=None if self.with_rivals is None else summarise(self.with_rivals),
        )

    def rows(self, baseline: FittedModel) -> GapRows:
        """Return every configuration with its residuals before and after, along base axes."""
        poses, T_instr_base = self.poses, baseline.T_instr_base
        T_instr_ee = T_instr_base @ baseline.model.predict(poses.states, baseline.x)
        p_instr_m = poses.measured.end_poses(T_instr_ee)[:, :3, 3]
        return GapRows(
            pose=poses.pose,
            load_N=poses.states.load_N,
            place_mm=1e3 * (p_instr_m - T_instr_base[:3, 3]) @ T_instr_base[:3, :3],
            before_mm=self.found_before.position_mm,
            after_mm=self.found_after.position_mm,
            extrapolated=None if self.inside is None else ~self.inside,
        )

    def beside(self, other: PairedErrors) -> PairedErrors:
        """Return it with what another has that is in no model, where it has none of its own."""
        return replace(
            self,
            without_motion=self.without_motion or other.without_motion,
            with_rivals=self.with_rivals or other.with_rivals,
        )

    @property
    def noise_rms_mm(self) -> float:
        """Return the root mean square error that noise alone would leave, equal along all axes."""
        measured = self.poses.measured
        count = np.median(measured.components_seen[:, measured.position_columns].sum(axis=1))
        d = max(float(count), 1.0)
        of_mean = np.sqrt(d / 2.0) * np.exp(gammaln(d / 2.0) - gammaln((d + 1.0) / 2.0))
        return float(of_mean * self.noise_floor_mm)


@dataclass(frozen=True)
class Named:
    """The model with the first few of the effects."""

    effects: tuple[Effect, ...]  # those that are in it, in the order of what they take away
    # on_train and on_holdout: its deviations; None without held-out poses
    on_train: Deviations
    on_holdout: Deviations | None
    without: tuple[Named, ...] = ()  # of the model with all effects, the model without each of them

    @property
    def judging(self) -> Deviations:
        """Return its deviations at held-out poses, or else at those fitted."""
        return self.on_train if self.on_holdout is None else self.on_holdout

    @property
    def record(self) -> NamingStep:
        """Return its errors as they are written."""
        return NamingStep(
            effects=tuple(map(name_of, self.effects)),
            train=summarise(self.on_train),
            holdout=None if self.on_holdout is None else summarise(self.on_holdout),
        )

    def falling_back(self, within: AngleCoverage, gaps: Mapping[str, PairedErrors | None]) -> Named:
        """Return it with the calibrated model beyond some joint positions."""
        train, holdout = gaps["train"], gaps["holdout"]
        assert train is not None

        def fallen(left: Deviations, found: PairedErrors) -> Deviations:
            outside = ~within.inside(found.poses.states.q_rad)
            return left.with_others(outside, found.found_before)

        held_out = self.on_holdout
        return Named(
            self.effects,
            fallen(self.on_train, train),
            held_out if held_out is None or holdout is None else fallen(held_out, holdout),
            tuple(step.falling_back(within, gaps) for step in self.without),
        )


def gap(
    poses: Observations,
    before: FittedModel,
    after: FittedModel,
    noise_floor_mm: float,
    seen: AngleCoverage | None = None,
    T_moved: Array | None = None,
) -> PairedErrors:
    """Compare two models on averaged poses, as each predicts them by itself.

    Args:
        poses: P measured configurations, complete.
        before: the calibrated model.
        after: the extended model, as it is exported.
        noise_floor_mm: mean error that the noise of these configurations would leave.
        seen: joint positions that the fit of the extended model has seen; None where it has seen
            all that it may predict.
        T_moved: (P, 4, 4) how the base had moved at each, which neither model holds; None where it
            had not.
    """
    return PairedErrors(
        poses,
        left_by(before, poses),
        left_by(after, poses),
        noise_floor_mm,
        inside=None if seen is None else seen.inside(poses.states.q_rad),
        without_motion=None
        if T_moved is None
        else (left_by(before, poses, T_moved), left_by(after, poses, T_moved)),
    )


def beside_motion(found: PairedErrors) -> PairedErrors:
    """Return the gap with the motion of the base taken out of the readings, where it was found."""
    if found.without_motion is None:
        return found
    before, after = found.without_motion
    return PairedErrors(found.poses, before, after, found.noise_floor_mm, found.inside)


def fallen_back(found: PairedErrors, outside: Mask) -> PairedErrors:
    """Return the gap where some configurations (P,) are left to the calibrated model."""
    return replace(found, found_after=found.found_after.with_others(outside, found.found_before))


def trusted(found: PairedErrors | None, suspected: Mask | None) -> PairedErrors | None:
    """Return the gap without configurations that are suspected; None where nothing is left."""
    if found is None or suspected is None or not suspected.any():
        return found
    if suspected.all():
        return None
    rows, still = ~suspected, found.without_motion
    return replace(
        found,
        poses=found.poses.take(rows),
        found_before=found.found_before.take(rows),
        found_after=found.found_after.take(rows),
        inside=None if found.inside is None else found.inside[rows],
        without_motion=None if still is None else (still[0].take(rows), still[1].take(rows)),
        with_rivals=None if found.with_rivals is None else found.with_rivals.take(rows),
    )


def in_order(
    train: PairedErrors,
    holdout: PairedErrors | None,
    effects: tuple[Effect, ...],
    fitted_with: Callable[[tuple[Effect, ...]], FittedModel],
) -> tuple[Named, ...]:
    """Return the errors of the calibrated model, and as effects join it, the largest first.

    They join in the order of what the model with all of them loses without each: alone, an effect
    may be masked by another. The last is the gap that is given.
    """

    def with_only(some: tuple[Effect, ...]) -> Named:
        model = fitted_with(some)
        on_holdout = None if holdout is None else left_by(model, holdout.poses)
        return Named(some, left_by(model, train.poses), on_holdout)

    held_out = None if holdout is None else holdout.found_before
    steps = [Named((), train.found_before, held_out)]
    without = dict.fromkeys(effects, steps[0])
    if len(effects) > 1:
        rest = {each: tuple(other for other in effects if other != each) for each in effects}
        without = {each: with_only(rest[each]) for each in effects}
        effects = tuple(sorted(effects, key=lambda each: -summarise(without[each].judging).rms_mm))
        steps += [with_only(effects[:count]) for count in range(1, len(effects) - 1)]
        steps.append(replace(without[effects[-1]], effects=effects[:-1]))
    if effects:
        held_out = None if holdout is None else holdout.found_after
        every = tuple(without[each] for each in effects)
        steps.append(Named(effects, train.found_after, held_out, every))
    return tuple(steps)


def left_by(model: FittedModel, poses: Observations, T_moved: Array | None = None) -> Deviations:
    """Return what a model leaves of complete poses, at which the base had moved (P, 4, 4)."""
    T_base_ee = model.as_read(poses) if T_moved is None else T_moved @ model.as_read(poses)
    return poses.measured.deviations(T_base_ee, model.T_instr_base, model.targets_m)
