"""The gap: errors of the calibrated and the extended model, and the parts that effects explain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, stdtrit

from pa10cal.arrays import Array, Mask, take_rows
from pa10cal.calibration.accuracy import summarise
from pa10cal.discovery.finding import name_of
from pa10cal.discovery.rules import JUDGING
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.analysis import GapRows, NamingStep
from pa10cal.results.discovery import LoadGap, Reduction, SetGap
from pa10cal.results.evaluation import Accuracy, BeforeAfter
from pa10cal.terms.effects.effect import Effect


@dataclass(frozen=True)
class PairedErrors:
    """The errors of two models at P poses, paired pose by pose."""

    poses: Observations  # averaged and complete
    found_before: Deviations  # measured less predicted, by the calibrated model
    found_after: Deviations  # the same by the extended model
    noise_floor_mm: float  # mean error that the noise of these poses alone would leave
    # (P,) poses within the joint positions of the fit, the others being extrapolated; None where
    # that does not matter
    inside: Mask | None = None
    # the same errors less the motion of the base that was found, which is in neither model; None
    # where no motion was found
    without_motion: PairedErrors | None = None
    # deviations of the extended model with the smooth functions that the search held as well; None
    # where it held none
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

    def take(self, rows: Mask) -> PairedErrors:
        """Return the errors at some poses (P,)."""
        return take_rows(self, rows, "noise_floor_mm")

    @cached_property
    def campaigns(self) -> dict[str, Mask]:
        """Return the poses (P,) of each campaign of a group; empty for no group."""
        number = np.asarray(self.poses.states.campaign)
        names = [name for name, _ in self.poses.measured.campaigns]
        return {name: number == k for k, name in enumerate(names) if np.any(number == k)}

    def reduction_of(self, rows: Mask | slice) -> Reduction:
        """Return the mean reduction at some poses, with its interval over poses of one label.

        Of one label the interval is the mean itself.
        """
        saved_mm = self.found_before.distance_mm - self.found_after.distance_mm
        by_pose = means_by_label(saved_mm[rows], self.poses.pose[rows])
        mean, half = float(by_pose.mean()), half_width_of_mean(by_pose)
        return Reduction(mean_mm=mean, interval95_mm=(mean - half, mean + half), poses=len(by_pose))

    def accuracies(self, rows: Mask | None) -> BeforeAfter | None:
        """Return the errors at some poses (P,); None where there are none."""
        if rows is None or not rows.any():
            return None
        before, after = summarise(self.found_before, rows), summarise(self.found_after, rows)
        return BeforeAfter(before=before, after=after)

    def record(self, suspected: Mask | None = None) -> SetGap:
        """Return the gap as it is written, also without poses (P,) that are suspected."""
        still = self.without_motion
        load_N = self.poses.states.load_N
        name = np.array([f"{load:g}N" for load in load_N.tolist()])
        loads = {one: name == one for one in dict.fromkeys(name[np.argsort(load_N)].tolist())}

        def by_part(parts: Mapping[str, Mask]) -> dict[str, LoadGap]:
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
            per_load=by_part(loads),
            per_campaign=by_part(self.campaigns) or None,
            inside=self.accuracies(self.inside),
            outside=None if self.inside is None else self.accuracies(~self.inside),
            trusted=self.accuracies(~suspected)
            if suspected is not None and suspected.any()
            else None,
            without_motion=None
            if still is None
            else BeforeAfter(before=still.before, after=still.after),
            with_rivals=None if self.with_rivals is None else summarise(self.with_rivals),
        )

    def rows(self, baseline: FittedModel) -> GapRows:
        """Return every pose with its residuals before and after, along base axes."""
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
        """Return the gap, with motion and rivals of another gap where it has none itself."""
        return replace(
            self,
            without_motion=self.without_motion or other.without_motion,
            with_rivals=self.with_rivals or other.with_rivals,
        )

    @property
    def noise_rms_mm(self) -> float:
        """Return the root mean square error of isotropic noise whose mean is the noise floor."""
        measured = self.poses.measured
        count = np.median(measured.components_seen[:, measured.position_columns].sum(axis=1))
        d = max(float(count), 1.0)
        # The root mean square of a chi distribution of d degrees of freedom, over its mean.
        of_mean = np.sqrt(d / 2.0) * np.exp(gammaln(d / 2.0) - gammaln((d + 1.0) / 2.0))
        return float(of_mean * self.noise_floor_mm)


class Gaps(NamedTuple):
    """Errors of the calibrated model and of another, by set of poses."""

    train: PairedErrors  # at the poses fitted
    holdout: PairedErrors | None  # at held-out poses; None without any


def means_by_label(values: Array, pose: NDArray[np.str_]) -> Array:
    """Return the mean (n,) of values (P,) of each label, as of one pose under several loads."""
    _, group = np.unique(pose, return_inverse=True)
    return np.asarray(np.bincount(group, values) / np.bincount(group))


def half_width_of_mean(values: Array) -> float:
    """Return half the interval of the mean of independent values (n,); 0 of one alone."""
    if len(values) < 2:
        return 0.0
    spread = float(values.std(ddof=1) / np.sqrt(len(values)))
    return float(stdtrit(len(values) - 1, 0.5 + JUDGING.gap_level / 2.0)) * spread


def gap(
    poses: Observations,
    before: FittedModel,
    after: FittedModel,
    noise_floor_mm: float,
    seen: AngleCoverage | None = None,
    T_moved: Array | None = None,
) -> PairedErrors:
    """Return the errors of the calibrated and the extended model at averaged, complete poses.

    Args:
        noise_floor_mm: mean error that the noise of these poses would leave.
        seen: joint positions of the fit of the extended model; None where it holds everywhere.
        T_moved: (P, 4, 4) motion of the base at each pose, which is in neither model; None for
            none.
    """
    found = PairedErrors(
        poses,
        errors_of(before, poses),
        errors_of(after, poses),
        noise_floor_mm,
        inside=None if seen is None else seen.inside(poses.states.q_rad),
    )
    if T_moved is None:
        return found
    of_before, of_after = (errors_of(model, poses, T_moved) for model in (before, after))
    without_motion = replace(found, found_before=of_before, found_after=of_after)
    return replace(found, without_motion=without_motion)


def fallen_back(found: PairedErrors, outside: Mask) -> PairedErrors:
    """Return the gap where the calibrated model predicts some of the poses (P,)."""
    return replace(found, found_after=found.found_after.replaced_where(outside, found.found_before))


def trusted(found: PairedErrors | None, suspected: Mask | None) -> PairedErrors | None:
    """Return the gap without suspected poses; None where none remains."""
    if found is None or suspected is None or not suspected.any():
        return found
    return None if suspected.all() else found.take(~suspected)


@dataclass(frozen=True)
class ErrorsByName:
    """The errors as effects join the calibrated model one by one, the largest first."""

    steps: tuple[NamingStep, ...]  # the calibrated model, then with one effect more each
    # deviations of the model with all effects but one, the largest effect first
    fitted_without: Mapping[Effect, Deviations]  # at the poses fitted
    held_out_without: Mapping[Effect, Deviations]  # at held-out poses; empty where there are none


def errors_by_name(
    train: PairedErrors,
    holdout: PairedErrors | None,
    effects: Sequence[Effect],
    fitted_with: Callable[[tuple[Effect, ...]], FittedModel],
    within: AngleCoverage | None = None,
) -> ErrorsByName:
    """Return the errors of the calibrated model, and as effects join it, the largest first.

    Their order is by the error of the model without each: alone, an effect may be masked by
    another. The last step is the given gap. Where effects hold within some joint positions only,
    the errors beyond are those of the calibrated model.
    """
    gaps = [train] if holdout is None else [train, holdout]
    before = [paired.found_before for paired in gaps]

    def errors_with(some: Sequence[Effect]) -> list[Deviations]:
        model, errors = fitted_with(tuple(some)), []
        for paired in gaps:
            found = errors_of(model, paired.poses)
            if within is not None:
                outside = ~within.inside(paired.poses.states.q_rad)
                found = found.replaced_where(outside, paired.found_before)
            errors.append(found)
        return errors

    joining: list[tuple[Sequence[Effect], list[Deviations]]] = [((), before)]
    without = dict.fromkeys(effects, before)
    if len(effects) > 1:
        for effect in effects:
            without[effect] = errors_with([other for other in effects if other != effect])
        effects = sorted(effects, key=lambda effect: -summarise(without[effect][-1]).rms_mm)
        joining += [(effects[:k], errors_with(effects[:k])) for k in range(1, len(effects) - 1)]
        joining.append((effects[:-1], without[effects[-1]]))
    if effects:
        joining.append((effects, [paired.found_after for paired in gaps]))
    steps = tuple(
        NamingStep(
            effects=tuple(map(name_of, some)),
            train=summarise(errors[0]),
            holdout=summarise(errors[1]) if len(errors) > 1 else None,
        )
        for some, errors in joining
    )
    return ErrorsByName(
        steps,
        fitted_without={effect: without[effect][0] for effect in effects},
        held_out_without={effect: without[effect][1] for effect in effects} if holdout else {},
    )


def errors_of(model: FittedModel, poses: Observations, T_moved: Array | None = None) -> Deviations:
    """Return the deviations of complete poses from a model, by default with a base that stands."""
    T_base_ee = model.as_read(poses) if T_moved is None else T_moved @ model.as_read(poses)
    return poses.measured.deviations(
        T_base_ee, model.T_instr_base, model.targets_read_m(poses.states)
    )
