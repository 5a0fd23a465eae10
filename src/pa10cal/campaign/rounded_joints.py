"""Joint positions that were rounded: to whole counts of an encoder, or to decimals of a unit.

Whole counts are told from the positions alone: nobody programs in powers of two. Decimals are not:
programmed positions are in round parts of a unit, too, and exact. The readings decide. An arm with
springs is fitted to them by least squares, and what remains is compared under five hypotheses of
the errors of joints, each beside noise of any size (`_show_rounding`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.optimize import minimize

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.fitted_arm import ArmFit, once_each
from pa10cal.campaign.joint_positions import in_radians, position_columns
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.errors import CalibrationError
from pa10cal.observe.observations import Observations

V = TypeVar("V")

#: Resolutions of encoders that are sought [counts a turn]: powers of two, as programmed positions
#: are in round parts of a degree.
_COUNTS = 2.0 ** np.arange(17)
#: Fewest counts a turn that an encoder has: eighths of a turn (45 deg) and the like are programmed,
#: and would else be taken for whole counts of any finer encoder.
_FEWEST_COUNTS = 256.0
#: Units in whose decimals positions may be rounded, by the word for them: as columns have them.
_UNITS_OF_TURNS = {"deg": 1.0, "rad": float(np.degrees(1.0)), "turns": 360.0}
_UNITS_OF_SLIDES = {"mm": 1.0}
#: Steps that are sought, in these units.
_DECIMALS = 10.0 ** -np.arange(7)
#: Part of a step by which positions may be off it: printed digits (computing).
_OFF_STEP = 0.1
#: The same at most, where few digits are printed: of 20 positions anywhere, one set in a million is
#: within it (level).
_MOST_OFF_STEP = 0.25
#: Share of the rows that may be off further: positions that were typed, or interpolated (size).
_OTHERS = 0.02
#: Fewest different whole numbers of steps at which an axis stood, by which a step is told: fewer
#: are all near whole numbers of some step (level).
_FEWEST_POSITIONS = 20

#: Errors of joints are sought up to so many times those of rounding (computing).
_MOST_TIMES = 30.0
#: Gain in log likelihood that rounding needs over noise alone, and over errors of the joints that
#: effects may have errors of [nat] (level).
_GAIN = 10.0
#: How far rounding in every joint may be below errors of any size, which may be zero: further, and
#: a joint is exact [nat] (level).
_MOST_LOST = 8.0
#: How far errors just as large as those of rounding may be below errors of any size: no further,
#: and the joints have no other errors [nat] (level).
_AS_LIKELY = 4.0
#: Joints that effects may have errors of, where positions are exact (chosen).
_WITH_EFFECTS = 2


class DecimalStep(NamedTuple):
    """A step by whole numbers of which the positions of an axis differ."""

    words: str  # with the unit of its decimals, as `0.001 rad`
    in_column: float  # in the unit of the axis' column
    unit: str  # that unit, `deg` or `mm`


def whole_counts(q_deg: Array) -> float:
    """Return the counts a turn to which positions (N,) were rounded; 0 for none.

    The fewest counts by whole numbers of which they differ; 0 where these are fewer than an encoder
    has. Printed positions are off them by up to half a unit of the last digit.
    """
    printed = decimal_step(q_deg, slides=False)
    half_digit_deg = 0.0 if printed is None else printed.in_column / 2.0
    for counts in _COUNTS.tolist():
        step_deg = 360.0 / counts
        off = max(_OFF_STEP, half_digit_deg / step_deg)
        if off < _MOST_OFF_STEP and _differ_by_whole(q_deg, step_deg, off):
            return float(counts) if counts >= _FEWEST_COUNTS else 0.0
    return 0.0


def decimal_step(q: Array, *, slides: bool) -> DecimalStep | None:
    """Return the largest decimal step by whole numbers of which positions (N,) differ; or None.

    In a unit of turns, or in millimetres where the axis slides.
    """
    units, of_column = (_UNITS_OF_SLIDES, "mm") if slides else (_UNITS_OF_TURNS, "deg")
    found = [
        DecimalStep(f"{decimal:g} {unit}", size * decimal, of_column)
        for unit, size in units.items()
        for decimal in _DECIMALS.tolist()
        if _differ_by_whole(q, size * decimal)
    ]
    return max(found, key=lambda step: step.in_column, default=None)


def _differ_by_whole(q: Array, step: float, off: float = _OFF_STEP) -> bool:
    """Return whether positions (N,), but for a few, differ by whole steps, and by many of them.

    Their parts of a step, on a circle, lie within twice `off` where all but a few are closest.
    """
    if len(q) < _FEWEST_POSITIONS:
        return False
    part = np.sort(q / step % 1.0)
    turned = np.concatenate([part, part + 1.0])
    most = int(np.ceil((1.0 - _OTHERS) * len(q)))
    widths = turned[most - 1 : most - 1 + len(q)] - part
    closest = int(np.argmin(widths))
    if widths[closest] > 2.0 * off:
        return False
    middle = part[closest] + widths[closest] / 2.0
    moved = q / step - middle
    whole = np.abs(moved - np.round(moved)) <= off
    return len(np.unique(np.round(moved[whole]))) >= _FEWEST_POSITIONS


def axes_in_counts(raw: RawRows, arm: Arm) -> dict[int, float]:
    """Return the counts a turn of axes, from 0, that turn and whose positions are whole counts.

    Axes with stated uncertainties are not among them.
    """
    counts = {
        axis: whole_counts(raw[name])
        for axis, name in _without_stated_uncertainty(raw, arm).items()
        if not arm.axes_slide[axis]
    }
    return {axis: per_turn for axis, per_turn in counts.items() if per_turn}


def axes_in_decimals(raw: RawRows, arm: Arm) -> dict[int, DecimalStep]:
    """Return the decimal steps of axes, from 0; of none with a stated uncertainty."""
    steps = {
        axis: decimal_step(raw[name], slides=bool(arm.axes_slide[axis]))
        for axis, name in _without_stated_uncertainty(raw, arm).items()
    }
    return {axis: step for axis, step in steps.items() if step is not None}


def _without_stated_uncertainty(raw: RawRows, arm: Arm) -> dict[int, str]:
    """Return the columns of the axes, from 0, whose uncertainty the file does not state."""
    names = enumerate(position_columns(arm.axes_slide))
    return {
        axis: name for axis, name in names if not np.isfinite(raw.numbers_of([f"u_{name}"])).any()
    }


def uncertainty_of(step: float) -> float:
    """Return the standard uncertainty of positions that are rounded to a step."""
    return step / float(np.sqrt(12.0))  # uniform over one step


def notes_on_counts(counts_per_turn: Mapping[int, float]) -> list[str]:
    """Return a note for each resolution of axes, from 0, whose positions are whole counts."""
    return [
        f"{names}: positions are whole counts of encoders ({counts:.0f} a turn), and "
        f"count as uncertain by that rounding, {uncertainty_of(360.0 / counts):.2g} deg"
        for counts, names in _axes_by(counts_per_turn).items()
    ]


def warnings_of_decimals(steps: Mapping[int, DecimalStep]) -> list[str]:
    """Return a warning for each step to which positions of axes, from 0, are rounded."""
    return [
        f"{names}: joint positions are rounded to {step.words}, as the readings show, and count as "
        f"uncertain by that rounding, {uncertainty_of(step.in_column):.2g} {step.unit}; log them "
        "with more decimals"
        for step, names in _axes_by(steps).items()
    ]


def _axes_by(values: Mapping[int, V]) -> dict[V, str]:
    """Return the names of the axes, from 0, of each value."""
    axes: dict[V, list[str]] = {}
    for axis, value in sorted(values.items()):
        axes.setdefault(value, []).append(f"q{axis + 1}")
    return {value: ", ".join(names) for value, names in axes.items()}


def with_rounding(
    readings: Observations, steps: Mapping[int, DecimalStep], arm: Arm, payload: Payload | None
) -> tuple[Observations, Mapping[int, DecimalStep]]:
    """Return readings as uncertain as decimals make their joints, and the steps; none if exact.

    Args:
        steps: of the axes, from 0, whose positions are whole numbers of such a step.
        payload: what the arm carries; None where that is not known.
    """
    u_axes = np.zeros(len(arm.axes_slide))
    for axis, step in steps.items():
        u_axes[axis] = uncertainty_of(step.in_column)
    u = arm.coupling.uncertainty(in_radians(u_axes[None], arm.axes_slide))[0]
    log = readings.log
    if log is None or not u.any() or not _show_rounding(readings, Chain.of(arm), payload, u):
        return readings, {}
    q_u = np.hypot(np.nan_to_num(log.q_u), u)
    rounded = np.hypot(0.0 if log.q_u_rounded is None else log.q_u_rounded, np.full_like(q_u, u))
    return replace(readings, log=replace(log, q_u=q_u, q_u_rounded=rounded)), steps


def _show_rounding(readings: Observations, chain: Chain, payload: Payload | None, u: Array) -> bool:
    """Return whether readings show errors of joints as of a rounding, with uncertainties u (n,).

    Every hypothesis bounds the errors of each joint, in units of u, beside noise of any size.
    """
    try:
        remainder = _remainder(readings.take(once_each(readings)), chain, payload)
    except (CalibrationError, np.linalg.LinAlgError):
        return False  # base and targets are not determined
    if remainder is None:
        return False
    no_errors, as_rounded, any_size = (np.full(len(u), times) for times in (0.0, 1.0, _MOST_TIMES))

    rounded_at_least = remainder.likeliest(u, as_rounded, any_size)
    noise_alone = remainder.likeliest(u, no_errors, no_errors)
    if rounded_at_least.log < noise_alone.log + _GAIN:
        return False  # joints need no errors

    errors_of_any_size = remainder.likeliest(u, no_errors, any_size)
    if rounded_at_least.log < errors_of_any_size.log - _MOST_LOST:
        return False  # a joint is exact, as none is that was rounded

    just_rounded = remainder.likeliest(u, as_rounded, as_rounded)
    if just_rounded.log > errors_of_any_size.log - _AS_LIKELY:
        return True  # every error is as large as rounding makes it

    # Errors are larger, so there are effects: these alone must not explain what remains.
    with_effects = remainder.moves_most(errors_of_any_size.times * u)
    of_effects = np.where(with_effects, any_size, no_errors)
    effects_alone = remainder.likeliest(u, no_errors, of_effects)
    return rounded_at_least.log > effects_alone.log + _GAIN


class _Likeliest(NamedTuple):
    """The likeliest noise and errors of joints under a hypothesis."""

    log: float  # their log likelihood, but for a constant [nat]
    times: Array  # (n,) errors of joints, in units of the uncertainties of the hypothesis


class _Remainder(NamedTuple):
    """What a fitted arm leaves of P poses with b components, beside what joints would move."""

    # (P, b), zero where not seen; over the root of the share of the components that the parameters
    # of the fit left free
    residual: Array
    covariance: Array  # (P, b, b) as stated
    of_kinds: Array  # (c, b) which components are of each kind
    by_joints: Array  # (P, b, n) derivative by errors of the joints

    def likeliest(self, u: Array, least: Array, most: Array) -> _Likeliest:
        """Return the likeliest noise of any size, by kind of component, and errors of joints.

        Args:
            u: (n,) standard uncertainties of the joints.
            least, most: (n,) between which multiples of them the joints' errors may be.
        """
        kinds = len(self.of_kinds)
        of_joints = np.einsum("pbj,pcj->jpbc", self.by_joints, self.by_joints)
        of_joints = (of_joints * (u**2)[:, None, None, None]).reshape(len(u), -1)  # covariances

        def cost(x: Array) -> tuple[float, Array]:
            size = np.exp(x[:kinds]) @ self.of_kinds
            noise = self.covariance * size[:, None] * size
            covariance = noise + (x[kinds:] ** 2 @ of_joints).reshape(noise.shape)
            _, log_det = np.linalg.slogdet(covariance)
            inverse = np.linalg.inv(covariance)
            solved = (inverse @ self.residual[:, :, None])[..., 0]
            value = 0.5 * float(np.sum(log_det) + np.sum(self.residual * solved))
            by_covariance = 0.5 * (inverse - solved[:, :, None] * solved[:, None])
            by_kinds = 2.0 * self.of_kinds @ (by_covariance * noise).sum(axis=(0, 2))
            by_times = 2.0 * x[kinds:] * (of_joints @ by_covariance.ravel())
            return value, np.concatenate([by_kinds, by_times])

        start = np.concatenate([np.zeros(kinds), np.clip(1.0, least, most)])
        bounds = [(-5.0, 10.0)] * kinds + list(zip(least, most, strict=True))
        found = minimize(cost, start, jac=True, bounds=bounds, method="L-BFGS-B")
        return _Likeliest(-float(found.fun), np.asarray(found.x[kinds:]))

    def moves_most(self, errors: Array) -> Mask:
        """Return which joints (n,) move the readings most by their errors, in stated noise."""
        stated = np.linalg.cholesky(self.covariance)
        moved = np.linalg.solve(stated, self.by_joints) * errors
        largest = np.argsort(np.sum(moved**2, axis=(0, 1)))[-_WITH_EFFECTS:]
        return np.isin(np.arange(len(errors)), largest)


def _remainder(readings: Observations, chain: Chain, payload: Payload | None) -> _Remainder | None:
    """Return what a fitted arm leaves; None where too few readings are left, or a log is wrong.

    Raises:
        CalibrationError: when the poses do not determine where base and targets are.
    """
    fit, start = ArmFit.begun(readings, chain, payload)
    _, left = fit.fitted(start)
    measured = fit.measured
    free_share = 1.0 - left.taken.shape[2] / np.count_nonzero(measured.components_seen)
    if free_share <= 0.0 or left.is_of_a_wrong_log:
        return None
    of_kinds = np.zeros((len(measured.component_kinds), left.residual.shape[1]), dtype=bool)
    for of_kind, (_, columns) in zip(of_kinds, measured.component_kinds, strict=True):
        of_kind[columns] = True
    return _Remainder(
        left.residual[left.usual] / np.sqrt(free_share),
        measured.stated_covariance[left.usual],
        of_kinds,
        left.by_joints[left.usual],
    )
