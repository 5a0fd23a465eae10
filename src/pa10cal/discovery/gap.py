"""How much nearer the extended model comes to the measurement: paired, pose by pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.special import gammaln, stdtrit

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.uncertainty import summarise
from pa10cal.discovery.finding import Finding, name_of
from pa10cal.discovery.linear import rms
from pa10cal.discovery.other_numbers import FIELD
from pa10cal.discovery.rules import JUDGING
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.analysis import GapRows, NamingStep
from pa10cal.results.discovery import LoadGap, Reduction, SetGap
from pa10cal.results.evaluation import Accuracy, BeforeAfter
from pa10cal.results.explained import Explained, ExplainedEffect
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.field import NO_NAME, Field


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

    @cached_property
    def campaigns(self) -> dict[str, Mask]:
        """Return which configurations (P,) are of each campaign of a group; none of one alone."""
        number = np.asarray(self.poses.states.campaign)
        names = [name for name, _ in self.poses.measured.campaigns]
        return {name: number == k for k, name in enumerate(names) if np.any(number == k)}

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
            half = float(stdtrit(count - 1, 0.5 + JUDGING.gap_level / 2.0)) * spread
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

        def each(parts: Mapping[str, Mask]) -> dict[str, LoadGap]:
            return {
                name: LoadGap(
                    before=summarise(self.found_before, rows),
                    after=summarise(self.found_after, rows),
                    reduction=self.reduction_of(rows),
                )
                for name, rows in parts.items()
            }

        return SetGap(
            before=self.before,
            after=self.after,
            noise_floor_mm=self.noise_floor_mm,
            reduction=self.reduction,
            per_load=each(loads),
            per_campaign=each(self.campaigns) or None,
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

    def with_nuisances_of(self, other: PairedErrors) -> PairedErrors:
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
        errors_of(before, poses),
        errors_of(after, poses),
        noise_floor_mm,
        inside=None if seen is None else seen.inside(poses.states.q_rad),
        without_motion=None
        if T_moved is None
        else (errors_of(before, poses, T_moved), errors_of(after, poses, T_moved)),
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


@dataclass(frozen=True)
class ErrorsByName:
    """What remains as effects join the calibrated model one by one, the largest first."""

    steps: tuple[NamingStep, ...]  # the calibrated model, then with one effect more each
    # deviations at held-out poses, or else at those fitted, of the model with all effects but one
    without: Mapping[Effect, Deviations]


def errors_by_name(
    train: PairedErrors,
    holdout: PairedErrors | None,
    effects: Sequence[Effect],
    fitted_with: Callable[[tuple[Effect, ...]], FittedModel],
    within: AngleCoverage | None = None,
) -> ErrorsByName:
    """Return the errors of the calibrated model, and as effects join it, the largest first.

    They join in the order of what the model with all of them loses without each: alone, an effect
    may be masked by another. The last step is the gap that is given. Where effects hold within some
    joint positions alone, models are the calibrated one beyond.
    """
    gaps = [train] if holdout is None else [train, holdout]
    before = [of.found_before for of in gaps]

    def left_with(some: Sequence[Effect]) -> list[Deviations]:
        model, left = fitted_with(tuple(some)), []
        for of in gaps:
            found = errors_of(model, of.poses)
            if within is not None:
                found = found.with_others(~within.inside(of.poses.states.q_rad), of.found_before)
            left.append(found)
        return left

    joining: list[tuple[Sequence[Effect], list[Deviations]]] = [((), before)]
    without = dict.fromkeys(effects, before)
    if len(effects) > 1:
        for each in effects:
            without[each] = left_with([other for other in effects if other != each])
        effects = sorted(effects, key=lambda each: -summarise(without[each][-1]).rms_mm)
        joining += [(effects[:k], left_with(effects[:k])) for k in range(1, len(effects) - 1)]
        joining.append((effects[:-1], without[effects[-1]]))
    if effects:
        joining.append((effects, [of.found_after for of in gaps]))
    steps = tuple(
        NamingStep(
            effects=tuple(map(name_of, some)),
            train=summarise(left[0]),
            holdout=summarise(left[1]) if len(left) > 1 else None,
        )
        for some, left in joining
    )
    return ErrorsByName(steps, {each: without[each][-1] for each in effects})


def errors_of(model: FittedModel, poses: Observations, T_moved: Array | None = None) -> Deviations:
    """Return what a model leaves of complete poses, at which the base had moved (P, 4, 4)."""
    T_base_ee = model.as_read(poses) if T_moved is None else T_moved @ model.as_read(poses)
    return poses.measured.deviations(T_base_ee, model.T_instr_base, model.targets_m)


# How much of the error beyond noise is explained, and by what.
#
# The share of all effects is what the mean square error over held-out poses falls by, from the
# calibrated model to the one that is exported, as part of what it had beyond noise. It is divided
# among them by what the exported model loses without each, all else fitted again: joining one by
# one, an effect may be masked by another. Shares sum to the whole. Errors without one are told as
# no larger than those without any.


def taken_away(
    finding: Finding,
    before_mm: Array,
    after_mm: Array,
    weights: Literal["assumed"] | None = None,
) -> ExplainedEffect:
    """Return what an effect takes away of errors (P,), its share of the whole not yet known."""
    said = finding.explanations
    itself = finding.id, finding.of
    others = (one for one in said.smallest_set if (one.id, one.of) != itself)
    names = {name_of(one): said.of(one) for one in others}
    here = {name.id: p for name, p in names.items() if name.of == finding.of}
    elsewhere = {name: p for name, p in names.items() if name.of != finding.of}
    return ExplainedEffect(
        ids=(finding.id, *here),
        of=finding.of,
        elsewhere=tuple(elsewhere),
        weights=weights,
        probability=said.of(finding.effect),
        others_probability=(*here.values(), *elsewhere.values()),
        share=0.0,
        before_mm=rms(before_mm),
        after_mm=rms(after_mm),
    )


def by_field(by_joint: Array, before_mm: Array, after_mm: Array) -> ExplainedEffect:
    """Return what a field takes away of errors (P,), by the part (n,) that goes with each joint."""
    joints = {str(k): float(part) for k, part in enumerate(by_joint, start=1)}
    return ExplainedEffect(
        ids=(Field.id,),
        of=NO_NAME,
        joints={joint: part for joint, part in joints.items() if part >= FIELD.least_joint_part},
        share=0.0,
        before_mm=rms(before_mm),
        after_mm=rms(after_mm),
    )


def explained_by(
    effects: Sequence[ExplainedEffect],
    before_mm: float,
    noise_mm: float,
    over: Literal["held-out poses", "fitted poses"] = "held-out poses",
) -> Explained | None:
    """Return what effects take away; None where there is no more than noise to explain.

    Args:
        effects: the last of them ends at the model with all.
        before_mm: root mean square error of the model without any.
        noise_mm: root mean square error that noise alone would leave.
        over: what the poses are.
    """
    beyond = before_mm**2 - noise_mm**2
    least = 1.0 if effects else JUDGING.more_than_noise**2
    if not beyond > (least - 1.0) * noise_mm**2 or not before_mm > 0.0:
        return None
    after_mm = effects[-1].after_mm if effects else before_mm
    share = float(np.clip((before_mm**2 - after_mm**2) / beyond, 0.0, 1.0))
    taken = [max(effect.before_mm**2 - effect.after_mm**2, 0.0) for effect in effects]
    each = share / sum(taken) if sum(taken) > 0.0 else 0.0
    entries = [
        effect.model_copy(
            update={"share": each * own, "before_mm": min(effect.before_mm, before_mm)}
        )
        for effect, own in zip(effects, taken, strict=True)
    ]
    return Explained(
        share=share,
        of=tuple(sorted(entries, key=lambda entry: -entry.share)),
        without_a_name=1.0 - share,
        over=over,
        before_mm=before_mm,
        after_mm=after_mm,
        noise_mm=noise_mm,
    )
