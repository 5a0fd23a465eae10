"""How much nearer the extended model comes to the measurement: paired, pose by pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, stdtrit

from pa10cal.arrays import Array
from pa10cal.calibration.uncertainty import summarise
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.evaluation import Accuracy
from pa10cal.terms.effects.effect import Effect

_LEVEL = 0.95


@dataclass(frozen=True)
class Paired:
    """Mean reduction of the position error, poses being the unit."""

    mean_mm: float  # mean over poses
    # low_mm and high_mm: its 95 % interval; equal to the mean where there is one pose
    low_mm: float
    high_mm: float
    poses: int  # how many


@dataclass(frozen=True)
class Parts:
    """The gap inside the joint positions that the fit has seen, and beyond them."""

    # (P,) configurations that keep to the positions seen; the others are extrapolated
    inside: NDArray[np.bool_]
    # before_inside and after_inside: accuracies over these; None where there is none
    before_inside: Accuracy | None
    after_inside: Accuracy | None
    # before_beyond and after_beyond: over the others
    before_beyond: Accuracy | None
    after_beyond: Accuracy | None


@dataclass(frozen=True)
class Gap:
    """The gap between model and measurement on some configurations."""

    # before and after: errors of the calibrated baseline and of the extended model
    before: Accuracy
    after: Accuracy
    by_load: dict[float, tuple[Accuracy, Accuracy]]  # the same for every load
    reduction: Paired  # paired over poses
    reduction_by_load: dict[float, Paired]  # the same for every load
    # found_before and found_after: deviations, configuration by configuration
    found_before: Deviations
    found_after: Deviations
    poses: Observations  # the configurations
    noise_floor_mm: float  # mean error that their noise alone would leave
    # inside and beyond what the fit has seen; None where it is not needed
    parts: Parts | None = None
    # deviations before and after with the motion of the base that was found taken out of the
    # readings. It is in no model, and in none of the other numbers. None where no motion was
    # found.
    without_motion: tuple[Deviations, Deviations] | None = None
    # deviations with all that the search held and has no name in the model as well, which is not
    # the one that is written; None where it held nothing of the kind
    with_rivals: Deviations | None = None

    def beside(self, other: Gap) -> Gap:
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
    def left_mm(self) -> float:
        """Return the root mean square error that remains, held out where there are such poses."""
        return summarise(self.on_train if self.on_holdout is None else self.on_holdout).rms_mm

    @property
    def train(self) -> Accuracy:
        """Return its errors over the poses fitted."""
        return summarise(self.on_train)

    @property
    def holdout(self) -> Accuracy | None:
        """Return its errors over held-out poses; None without any."""
        return None if self.on_holdout is None else summarise(self.on_holdout)

    def falling_back(self, within: AnglesSeen, gaps: Mapping[str, Gap | None]) -> Named:
        """Return it with the calibrated model beyond some joint positions."""

        def fallen(left: Deviations | None, found: Gap | None) -> Deviations | None:
            if left is None or found is None:
                return left
            outside = ~within.inside(found.poses.states.q_rad)
            return left.with_others(outside, found.found_before)

        on_train = fallen(self.on_train, gaps["train"])
        assert on_train is not None
        without = tuple(each.falling_back(within, gaps) for each in self.without)
        return Named(self.effects, on_train, fallen(self.on_holdout, gaps["holdout"]), without)


def gap(
    poses: Observations,
    before: FittedModel,
    after: FittedModel,
    noise_floor_mm: float,
    seen: AnglesSeen | None = None,
    T_moved: Array | None = None,
) -> Gap:
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
    inside = None if seen is None else seen.inside(poses.states.q_rad)
    found = gap_of(
        poses, [left_by(each, poses) for each in (before, after)], noise_floor_mm, inside
    )
    if T_moved is None:
        return found
    still = left_by(before, poses, T_moved), left_by(after, poses, T_moved)
    return replace(found, without_motion=still)


def beside_motion(found: Gap) -> Gap:
    """Return the gap with the motion of the base taken out of the readings, where it was found."""
    if found.without_motion is None:
        return found
    inside = None if found.parts is None else found.parts.inside
    return gap_of(found.poses, list(found.without_motion), found.noise_floor_mm, inside)


def fallen_back(found: Gap, outside: NDArray[np.bool_]) -> Gap:
    """Return the gap where some configurations (P,) are left to the calibrated model."""
    after = found.found_after.with_others(outside, found.found_before)
    inside = None if found.parts is None else found.parts.inside
    fallen = gap_of(found.poses, [found.found_before, after], found.noise_floor_mm, inside)
    return fallen.beside(found)


def trusted(found: Gap | None, suspected: NDArray[np.bool_] | None) -> Gap | None:
    """Return the gap without configurations that are suspected; None where nothing is left."""
    if found is None or suspected is None or not suspected.any():
        return found
    if suspected.all():
        return None
    inside = None if found.parts is None else found.parts.inside[~suspected]
    deviations = [found.found_before.take(~suspected), found.found_after.take(~suspected)]
    rest = gap_of(found.poses.take(~suspected), deviations, found.noise_floor_mm, inside)
    if found.with_rivals is not None:
        rest = replace(rest, with_rivals=found.with_rivals.take(~suspected))
    if found.without_motion is None:
        return rest
    before, after = (each.take(~suspected) for each in found.without_motion)
    return replace(rest, without_motion=(before, after))


def reduction(found: Gap, rows: NDArray[np.bool_]) -> Paired:
    """Return the mean reduction over some configurations (P,), paired over their poses."""
    saved_mm = found.found_before.distance_mm - found.found_after.distance_mm
    return _paired(saved_mm[rows], found.poses.pose[rows])


def in_order(
    train: Gap,
    holdout: Gap | None,
    effects: tuple[Effect, ...],
    with_only: Callable[[tuple[Effect, ...]], Named],
) -> tuple[Named, ...]:
    """Return the errors of the calibrated model, and as effects join it, the largest first.

    They join in the order of what the model with all of them loses without each: alone, an effect
    may be masked by another.

    Args:
        train, holdout: the gap before and with all effects.
        effects: all of them.
        with_only: fits the model with some of them.
    """

    def ends(after: bool) -> tuple[Deviations, Deviations | None]:
        pairs = [
            None if each is None else (each.found_after if after else each.found_before)
            for each in (train, holdout)
        ]
        assert pairs[0] is not None
        return pairs[0], pairs[1]

    steps = [Named((), *ends(after=False))]
    without = dict.fromkeys(effects, steps[0])
    if len(effects) > 1:
        rest = {each: tuple(other for other in effects if other != each) for each in effects}
        without = {each: with_only(rest[each]) for each in effects}
        effects = tuple(sorted(effects, key=lambda each: -without[each].left_mm))
        steps += [with_only(effects[:count]) for count in range(1, len(effects) - 1)]
        steps.append(replace(without[effects[-1]], effects=effects[:-1]))
    if effects:
        every = tuple(without[each] for each in effects)
        steps.append(Named(effects, *ends(after=True), every))
    return tuple(steps)


def gap_of(
    poses: Observations,
    found: list[Deviations],
    noise_floor_mm: float,
    inside: NDArray[np.bool_] | None,
) -> Gap:
    """Return the gap of deviations before and after."""
    saved = found[0].distance_mm - found[1].distance_mm
    load_N = poses.states.load_N
    loads = [float(load) for load in np.unique(load_N)]
    return Gap(
        before=summarise(found[0]),
        after=summarise(found[1]),
        by_load={
            load: (summarise(found[0], load_N == load), summarise(found[1], load_N == load))
            for load in loads
        },
        reduction=_paired(saved, poses.pose),
        reduction_by_load={
            load: _paired(saved[load_N == load], poses.pose[load_N == load]) for load in loads
        },
        found_before=found[0],
        found_after=found[1],
        poses=poses,
        noise_floor_mm=noise_floor_mm,
        parts=None if inside is None else _parts(inside, found),
    )


def left_by(model: FittedModel, poses: Observations, T_moved: Array | None = None) -> Deviations:
    """Return what a model leaves of complete poses, at which the base had moved (P, 4, 4)."""
    T_base_ee = model.as_read(poses) if T_moved is None else T_moved @ model.as_read(poses)
    return poses.measured.deviations(T_base_ee, model.T_instr_base, model.targets_m)


def _parts(inside: NDArray[np.bool_], found: list[Deviations]) -> Parts:
    accuracies = [
        summarise(deviations, rows) if rows.any() else None
        for rows in (inside, ~inside)
        for deviations in found
    ]
    return Parts(inside, *accuracies)


def _paired(saved_mm: Array, pose: NDArray[np.str_]) -> Paired:
    _, group = np.unique(pose, return_inverse=True)
    by_pose = np.bincount(group, saved_mm) / np.bincount(group)
    count, mean = len(by_pose), float(by_pose.mean())
    half = 0.0
    if count > 1:
        spread = float(by_pose.std(ddof=1)) / np.sqrt(count)
        half = float(stdtrit(count - 1, 0.5 + _LEVEL / 2.0)) * spread
    return Paired(mean, mean - half, mean + half, count)
