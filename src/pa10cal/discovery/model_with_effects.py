"""The calibrated model with effects and small motions of its base, in which every search ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array, Index, Mask, homogeneous, nearest_rotation
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.rules import UNKNOWNS
from pa10cal.discovery.rules import BLOCKS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.least_squares import Bounds
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.rules import SCATTER
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame, motion_of_base
from pa10cal.terms.wrapped import about_moved_base


@dataclass(frozen=True, eq=False)
class ModelWithEffects:
    """The calibrated model with effects, its base moved by a term of its own.

    It has k + t unknowns: the parameters of the calibrated model, those of effect by effect, six
    small motions of the base, and last the t coordinates of the instrument's targets.
    """

    effects: tuple[Effect, ...]
    # terms: those of the calibrated model, the effects, and last the small motions of the base
    at: FittedModel
    converged: bool  # whether the solver stopped by itself
    iterations: int  # steps that it took

    @property
    def model(self) -> Model:
        """Return chain and terms."""
        return self.at.model

    @property
    def x(self) -> Array:
        """Return all unknowns, (k + t,)."""
        return all_unknowns(self.at)

    def columns_of(self, effect: Effect) -> slice:
        """Return where the parameters of one of its effects are among the unknowns."""
        return self.model.columns_of(effect)

    def baseline_columns(self) -> Index:
        """Return where the unknowns are that belong to no effect."""
        of_no_effect = np.ones(len(self.x), dtype=bool)
        for effect in self.effects:
            of_no_effect[self.columns_of(effect)] = False
        return np.flatnonzero(of_no_effect)

    def reported(self, effect: Effect, covariance: Array) -> tuple[Array, Array]:
        """Return the reported parameters (k',) of an effect and their covariance (k', k').

        `covariance` is that of all unknowns, (k + t, k + t).
        """
        columns = self.columns_of(effect)
        report = effect.report(self.at.x[columns])
        of_solved = covariance[columns, columns]
        return report.values, report.covariance(of_solved, self.at.model.u_scale)

    def fitted(self, covariance: Array | None = None) -> FittedModel:
        """Return the model with the motion of its base in the base frame, not in a term.

        Its discrepancy is not known. `covariance` (k + t, k + t) is that of all unknowns; None
        where it is not needed.
        """
        k, terms = len(self.at.x) - 6, self.model.terms[:-1]
        return replace(
            self.at,
            model=Model(self.model.chain, terms),
            x=about_moved_base(terms, self.at.x[:k], self.at.x[k:]),
            T_instr_base=moved_base(self.at.T_instr_base, self.at.x[k:]),
            covariance=covariance,
            discrepancy=None,  # that of the model without effects
        )


def with_base_motion(baseline: FittedModel, effects: tuple[Effect, ...] = ()) -> Model:
    """Return the calibrated model's chain and terms, effects, and small motions of the base."""
    terms = (*baseline.model.terms, *effects, base_frame())
    return Model(baseline.model.chain, terms)


def identified_geometry(baseline: FittedModel, measured: Instrument) -> ChosenUnknowns:
    """Return the geometric parameters that calibrations of this arm and instrument identify."""
    start = Start(
        baseline.T_instr_base, np.zeros(3), baseline.R_ee_target, targets_m=baseline.targets_m
    )
    return choose_unknowns(baseline.arm, Tolerances(), measured, start)


def bounds_of_unknowns(baseline: FittedModel, model: Model, measured: Instrument) -> Bounds:
    """Return the ranges of a model's parameters and of the targets' coordinates, (k + t,).

    Coordinates that the geometry does not identify are held where they are stated: with all axes
    parallel, the height of a target and that of the base are one. Where nobody states them they are
    unknowns of a wide prior (`sizes_of_unknowns`): what tilts under a load carries the targets by
    their height, which its loads then show.
    """
    count = len(baseline.targets_m)
    bounds = Bounds.of((*model.parameters, *measured.target_parameters[:count]))
    if not count or not measured.places_stated:
        return bounds
    held = _not_by_geometry(baseline, measured)
    at = len(model.parameters) + np.flatnonzero(held)
    bounds.lower[at] = bounds.upper[at] = baseline.targets_m[held]
    return bounds


def _not_by_geometry(baseline: FittedModel, measured: Instrument) -> Mask:
    """Return which coordinates of targets (t,) the geometry of the arm does not identify."""
    held = np.ones(len(baseline.targets_m), dtype=bool)
    held[identified_geometry(baseline, measured).targets_kept] = False
    return held


def sizes_of_unknowns(baseline: FittedModel, model: Model, measured: Instrument) -> Array:
    """Return the prior standard deviation of all unknowns, (k + t,), about the baseline.

    Of targets it is that of a tool where geometry leaves some open that nobody states: these may
    be anywhere on the flange, and the others with them.
    """
    sizes, count = possible_sizes(model, measured), len(baseline.targets_m)
    if count and not measured.places_stated and _not_by_geometry(baseline, measured).any():
        sizes[-count:] = UNKNOWNS.unstated_target_m
    return sizes


def with_open_targets_held(
    covariance_of: Callable[[Mask], Array], free: Mask, prior_variances: Array
) -> Array:
    """Return the covariance (k, k) of free unknowns, targets that nothing determines held.

    They are held one by one, as calibrations hold them where they started.

    Args:
        covariance_of: of which unknowns are free, zero for the others.
        free: (k,) those that may be.
        prior_variances: (t,) of the last unknowns, the coordinates of targets.
    """
    first, free = len(free) - len(prior_variances), free.copy()
    covariance = covariance_of(free)
    while len(prior_variances):
        share = np.diag(covariance)[first:] / prior_variances
        if share.max() < BLOCKS.open_share:
            break
        free[first + int(share.argmax())] = False
        covariance = covariance_of(free)
    return covariance


def held_unknowns(baseline: FittedModel, model: Model, measured: Instrument) -> Mask:
    """Return which of a model's unknowns (k + t,) fits hold, or no reading shows."""
    held = bounds_of_unknowns(baseline, model, measured).fixed
    base = model.columns_of(model.terms[-1])
    held[base] |= ~identifiable_base_motions(measured)
    return held


def identifiable_base_motions(measured: Instrument) -> Mask:
    """Return which small motions of the base (6,) are identifiable: turns only by directions.

    An instrument of distances measures no directions.
    """
    return np.array([measured.directional or name not in BASE[3:] for name in BASE])


def all_unknowns(at: FittedModel) -> Array:
    """Return the parameters of a model's terms, then the coordinates of its targets, (k + t,)."""
    return np.concatenate([at.x, at.targets_m])


def with_unknowns(at: FittedModel, x: Array) -> FittedModel:
    """Return a model with other values of `all_unknowns`, (k + t,)."""
    k = len(at.model.parameters)
    return replace(at, x=x[:k], targets_m=x[k:])


def with_targets_off(
    fitted: FittedModel, off_m: Array, apparatus_m: float, poses: Observations
) -> FittedModel:
    """Return a model with errors of the stated places of an apparatus' targets.

    They move what the instrument reads. Where they are larger than places on an apparatus can be
    uncertain, the arm's end is elsewhere than its rows have it, and `tool` is where they show it
    (not of a group, where every campaign may have an apparatus of its own).

    Args:
        off_m: (a,) errors of stated coordinates [m]; empty without an apparatus.
        apparatus_m: standard uncertainty of these.
        poses: complete poses that show them.
    """
    fitted, errors = replace(fitted, targets_off_m=off_m), off_m / apparatus_m
    by_chance = chdtri(max(len(errors), 1), SCATTER.accused_rate)
    if poses.measured.campaigns or errors @ errors <= by_chance:
        return fitted
    T_base_ee = fitted.model.predict(poses.states, fitted.x)
    shown = np.linalg.inv(T_base_ee) @ fitted.as_read(poses)
    R = nearest_rotation(shown[:, :3, :3].mean(axis=0))
    return replace(fitted, T_end_shown=homogeneous(R, shown[:, :3, 3].mean(axis=0)))


def moved_base(T_instr_base: Array, small: Array) -> Array:
    """Return a base frame moved by the six small motions (6,) of a model's base term."""
    return np.asarray(T_instr_base @ motion_of_base(small))
