"""Joint positions that were rounded: to whole counts of an encoder, or to parts of a unit.

Powers of two of counts a turn are told from the positions alone: nobody programs in them. Other
steps are not: programmed positions are in round parts of a unit, too, and exact. The readings
decide. An arm with springs is fitted to them by least squares, and what remains is compared under
five hypotheses of the errors of joints, each beside noise of any size (`_times_of_rounding`).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.fft import rfft
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
#: and are whole counts of every finer encoder of a power of two.
_FEWEST_COUNTS = 256.0
#: Most counts a turn that are sought where these need not be a power of two (computing).
_MOST_COUNTS = 2**16
#: Parts of a turn into which positions are sorted to find counts (computing).
_BINS = 4 * _MOST_COUNTS
#: Least mean resultant length of the parts of a step, as angles, of positions that are then tried
#: as whole counts: uniform over a fifth of a step it is 0.94 (computing).
_LEAST_RESULTANT = 0.7
#: Units in whose decimals positions may be rounded, by the word for them: as columns have them.
_UNITS_OF_TURNS = {"deg": 1.0, "rad": float(np.degrees(1.0)), "turns": 360.0}
_UNITS_OF_SLIDES = {"mm": 1.0}
#: Steps that are sought, in these units.
_DECIMALS = 10.0 ** -np.arange(7)
#: Factors by which a decimal step is enlarged: whole counts a turn that are decimals of a degree
#: have no others (computing).
_FACTORS = (2.0, 3.0, 5.0)
#: Times a step that another one has to be, to be larger by more than computing (computing).
_LARGER = 1.01
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
#: Errors of joints that are below so many times those of rounding are of a step too large (level).
_TOO_LARGE = 0.5
#: Errors of joints above so many times those of rounding are told beside the step (level).
_TOLD_TIMES = 3.0


class Step(NamedTuple):
    """A step by whole numbers of which the positions of an axis differ."""

    words: str  # with its unit, as `0.001 rad`
    in_column: float  # in the unit of the axis' column
    unit: str  # that unit, `deg` or `mm`
    decimal: bool = True  # a power of ten in the unit of its words

    @classmethod
    def of_counts(cls, counts: float) -> Step:
        """Return the step of an encoder with so many counts a turn."""
        step_deg = 360.0 / counts
        return cls(f"{step_deg:g} deg ({counts:.0f} counts a turn)", step_deg, "deg", False)


class Rounding(NamedTuple):
    """Readings, as uncertain as the rounding that they show makes their joints."""

    readings: Observations
    steps: Mapping[int, Step]  # of the axes, from 0, that were rounded; empty where none was
    times: float  # median size of the errors of those joints, in units of those of rounding
    # steps of axes that may be roundings, as far as the readings tell: they count as exact
    possible: Mapping[int, Step] = MappingProxyType({})


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
            # Fewer are a program's, and hold for every power of two above.
            return float(counts) if counts >= _FEWEST_COUNTS else 0.0
    return 0.0


def rounding_step(q: Array, *, slides: bool) -> Step | None:
    """Return the largest step by whole numbers of which positions (N,) differ; or None.

    A decimal step (`decimal_step`), several of them, or any whole number of counts a turn.
    """
    found = decimal_step(q, slides=slides)
    if found is not None:
        found = _enlarged(found, q)
    counts = None if slides else _fewest_counts(q, 0.0 if found is None else found.in_column)
    return found if counts is None else Step.of_counts(counts)


def _enlarged(step: Step, q: Array) -> Step:
    """Return the largest multiple of a decimal step by which positions (N,) differ."""
    times = 1.0
    for factor in _FACTORS:
        while _differ_by_whole(q, step.in_column * times * factor):
            times *= factor
    if times == 1.0:
        return step
    size, unit = step.words.split()
    in_column = step.in_column * times
    counts = round(360.0 / in_column)
    if step.unit == "deg" and np.isclose(counts * in_column, 360.0, rtol=1e-9):
        return Step.of_counts(counts)
    return Step(f"{float(size) * times:g} {unit}", in_column, step.unit, False)


def _fewest_counts(q_deg: Array, step_deg: float) -> int | None:
    """Return the fewest counts a turn by whole numbers of which positions (N,) differ; or None.

    Of those that are larger than a step.
    """
    least = _fewest_that_part(q_deg)
    if least is None:
        return None
    # The resultant length for so many counts a turn is that harmonic of a histogram over a turn.
    bins = (q_deg / 360.0 % 1.0 * _BINS).astype(np.intp) % _BINS
    harmonics = rfft(np.bincount(bins, minlength=_BINS).astype(np.float32))[: _MOST_COUNTS + 1]
    likely = np.flatnonzero(np.abs(harmonics) > _LEAST_RESULTANT * len(q_deg))
    for counts in likely[likely >= least].tolist():
        if counts * step_deg * _LARGER > 360.0:
            break
        if _differ_by_whole(q_deg, 360.0 / counts):
            return int(counts)
    return None


def _fewest_that_part(q_deg: Array) -> int | None:
    """Return the fewest counts a turn at which positions (N,) can be enough whole numbers; or None.

    An axis that stood still, or came to a few positions again and again, is near whole numbers of
    any step, and of fewer of them than tell one.
    """
    ordered = np.sort(q_deg)

    def parted(counts: int) -> bool:
        """Say whether enough positions are further apart than those of one whole number."""
        apart, at = (1.0 - 3.0 * _OFF_STEP) * 360.0 / counts, 0
        for _ in range(_FEWEST_POSITIONS):
            if at == len(ordered):
                return False
            at = int(np.searchsorted(ordered, ordered[at] + apart))
        return True

    every = range(int(_FEWEST_COUNTS), _MOST_COUNTS + 1)
    found = 0 if parted(every[0]) else bisect_left(every, True, key=parted)
    return every[found] if found < len(every) else None


def decimal_step(q: Array, *, slides: bool) -> Step | None:
    """Return the largest decimal step by whole numbers of which positions (N,) differ; or None.

    In a unit of turns, or in millimetres where the axis slides.
    """
    units, of_column = (_UNITS_OF_SLIDES, "mm") if slides else (_UNITS_OF_TURNS, "deg")
    found = [
        Step(f"{decimal:g} {unit}", size * decimal, of_column)
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


def axes_in_steps(raw: RawRows, arm: Arm) -> dict[int, Step]:
    """Return the steps of axes, from 0, that may be roundings; of none with a stated uncertainty.

    Programmed positions have such steps as well: the readings decide (`with_rounding`).
    """
    steps = {
        axis: rounding_step(raw[name], slides=bool(arm.axes_slide[axis]))
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


def warnings_of_steps(steps: Mapping[int, Step], times: float) -> list[str]:
    """Return a warning for each step to which positions of axes, from 0, are rounded.

    Args:
        times: size of the errors of these joints, in units of those of rounding.
    """
    larger = f"; the readings show errors of joints about {times:.2g} times as large"
    return [
        f"{names}: joint positions are rounded to {step.words}, as the readings show, and count as "
        f"uncertain by that rounding, {uncertainty_of(step.in_column):.2g} {step.unit}"
        f"{larger if times > _TOLD_TIMES else ''}; log them "
        + ("with more decimals" if step.decimal else "in finer steps, if the controller can")
        for step, names in _axes_by(steps).items()
    ]


def warnings_of_possible_steps(steps: Mapping[int, Step]) -> list[str]:
    """Return a warning for each step to which positions of axes, from 0, may be rounded."""
    return [
        f"{names}: joint positions are whole numbers of {step.words}; if that is a rounding, it "
        "explains what the readings leave beyond their stated noise, as more noise does: log more "
        f"decimals, or state {', '.join(f'u_{name}_{step.unit}' for name in names.split(', '))}: "
        f"{uncertainty_of(step.in_column):.2g}"
        for step, names in _axes_by(steps).items()
    ]


def _axes_by(values: Mapping[int, V]) -> dict[V, str]:
    """Return the names of the axes, from 0, of each value."""
    axes: dict[V, list[str]] = {}
    for axis, value in sorted(values.items()):
        axes.setdefault(value, []).append(f"q{axis + 1}")
    return {value: ", ".join(names) for value, names in axes.items()}


def with_rounding(
    readings: Observations, steps: Mapping[int, Step], arm: Arm, payload: Payload | None
) -> Rounding:
    """Return readings as uncertain as the rounding that they show makes their joints.

    One verdict holds for all axes together: a log rounds all of them, or none. Only an axis whose
    step is larger than another's may have that finer step instead, or none.

    Args:
        steps: of the axes, from 0, whose positions are whole numbers of such a step.
        payload: what the arm carries; None where that is not known.
    """
    none, log = Rounding(readings, {}, 1.0), readings.log
    if log is None or not _u_of_axes(steps, arm).any():
        return none
    try:
        once = once_each(readings)
        remainder = _remainder(readings.take(once), log.q_u_stated[once], Chain.of(arm), payload)
        if remainder is None:
            return none
        times, shown = _steps_shown(remainder, steps, arm)
    except (CalibrationError, np.linalg.LinAlgError):
        return none  # base, targets or the size of the errors are not determined
    if times is None:
        return none._replace(possible=steps if _may_be_rounded(remainder, steps, arm) else {})
    u = arm.coupling.uncertainty(_u_of_axes(shown, arm)[None])[0]
    q_u = np.hypot(np.nan_to_num(log.q_u), u)
    rounded = np.hypot(0.0 if log.q_u_rounded is None else log.q_u_rounded, np.full_like(q_u, u))
    uncertain = replace(readings, log=replace(log, q_u=q_u, q_u_rounded=rounded))
    return Rounding(uncertain, shown, times)


def _u_of_axes(steps: Mapping[int, Step], arm: Arm) -> Array:
    """Return standard uncertainties of the axes (m,) by the steps of some, from 0 [rad, m]."""
    u_axes = np.zeros(len(arm.axes_slide))
    for axis, step in steps.items():
        u_axes[axis] = uncertainty_of(step.in_column)
    u: Array = in_radians(u_axes[None], arm.axes_slide)[0]
    return u


def _steps_shown(
    remainder: _Remainder, steps: Mapping[int, Step], arm: Arm
) -> tuple[float | None, Mapping[int, Step]]:
    """Return what `_times_of_rounding` says of steps of axes, from 0, and these steps.

    Positions of an axis that happen to lie on a grid have a larger step than others of their log.
    Where the readings show that it is too large, the next finer step of another axis is tried, and
    at last none, as such an axis may be exact. Most axes keep a step.
    """
    tried = steps
    while 2 * len(tried) > len(steps):
        u = _u_of_axes(tried, arm)
        times = _times_of_rounding(remainder, u)
        if times is not None:
            return times, tried
        finer = _with_finer_steps(remainder, tried, steps, arm)
        if finer == tried:
            break
        tried = finer
    return None, {}


def _with_finer_steps(
    remainder: _Remainder, tried: Mapping[int, Step], steps: Mapping[int, Step], arm: Arm
) -> dict[int, Step]:
    """Return steps of axes, from 0; finer than those tried where the readings show these too large.

    An axis whose positions have no larger step than those of any other keeps its own.
    """

    def finer_than(step: Step) -> list[Step]:
        return [
            other
            for other in steps.values()
            if other.unit == step.unit and other.in_column * _LARGER < step.in_column
        ]

    on_grid = [axis for axis in tried if finer_than(steps[axis])]
    if not on_grid:
        return dict(tried)
    u = _u_of_axes(tried, arm)
    errors_of_any_size = remainder.likeliest(u, np.zeros(len(u)), np.full(len(u), _MOST_TIMES))
    too_large = errors_of_any_size.times < _TOO_LARGE
    found = dict(tried)
    for axis in on_grid:
        if too_large[axis]:
            finer = finer_than(found.pop(axis))
            if finer:
                found[axis] = max(finer, key=lambda step: step.in_column)
    return found


def _times_of_rounding(remainder: _Remainder, u: Array) -> float | None:
    """Return the size of errors of joints, where readings show these as of a rounding; else None.

    The median of the axes that were rounded, in units of their uncertainties u (m,) by rounding.
    Five hypotheses bound the errors of each axis, in these units, beside noise of any size: none;
    1 or more; any size; 1; any size of two joints.
    """
    no_errors, as_rounded, any_size = (np.full(len(u), times) for times in (0.0, 1.0, _MOST_TIMES))

    rounded_at_least = remainder.likeliest(u, as_rounded, any_size)
    noise_alone = remainder.likeliest(u, no_errors, no_errors)
    if rounded_at_least.log < noise_alone.log + _GAIN:
        return None  # joints need no errors

    errors_of_any_size = remainder.likeliest(u, no_errors, any_size)
    if rounded_at_least.log < errors_of_any_size.log - _MOST_LOST:
        return None  # a joint is exact, as none is that was rounded

    just_rounded = remainder.likeliest(u, as_rounded, as_rounded)
    if just_rounded.log > errors_of_any_size.log - _AS_LIKELY:
        return 1.0  # every error is as large as rounding makes it

    # Errors are larger, so there are effects: these alone must not explain what remains.
    with_effects = remainder.moves_most(errors_of_any_size.times * u)
    of_effects = np.where(with_effects, any_size, no_errors)
    effects_alone = remainder.likeliest(u, no_errors, of_effects)
    if rounded_at_least.log <= effects_alone.log + _GAIN:
        return None
    times = float(np.median(rounded_at_least.times[u > 0.0]))
    # At the bound errors are of another kind, beside which readings show no rounding.
    return None if np.isclose(times, _MOST_TIMES) else times


def _may_be_rounded(remainder: _Remainder, steps: Mapping[int, Step], arm: Arm) -> bool:
    """Return whether the noise seems larger than stated, and is not beside errors as of rounding.

    Few readings do not tell these errors from more noise, which is no reason to be silent.
    """
    u = _u_of_axes(steps, arm)
    none, rounded = np.zeros(len(u)), np.ones(len(u))
    more_noise = remainder.likeliest(u, none, none).log
    as_stated = remainder.likeliest(u, none, none, as_stated=True).log
    beside_rounding = remainder.likeliest(u, rounded, rounded, as_stated=True).log
    return as_stated < more_noise - _GAIN < beside_rounding


class _Likeliest(NamedTuple):
    """The likeliest noise and errors of joints under a hypothesis."""

    log: float  # their log likelihood, but for a constant [nat]
    times: Array  # (m,) errors of axes, in units of the uncertainties of the hypothesis


class _Remainder(NamedTuple):
    """What a fitted arm leaves of P poses with b components, beside what joints would move."""

    # (P, b), zero where not seen; over the root of the share of the components that the parameters
    # of the fit left free
    residual: Array
    covariance: Array  # (P, b, b) as stated
    of_known: Array  # (P, b, b) covariance by errors of joints whose size is known already
    of_kinds: Array  # (c, b) which components are of each kind
    seen: Mask  # (P, b) which components were seen
    by_axes: Array  # (P, b, m) derivative by errors of the axes

    def likeliest(
        self, u: Array, least: Array, most: Array, *, as_stated: bool = False
    ) -> _Likeliest:
        """Return the likeliest noise of any size, by kind of component, and errors of joints.

        Args:
            u: (m,) standard uncertainties of the axes.
            least, most: (m,) between which multiples of them the errors of axes may be.
            as_stated: whether the noise is that which is stated, and not of any size.
        """
        kinds = len(self.of_kinds)
        by_axis = np.einsum("pbj,pcj->jpbc", self.by_axes * u, self.by_axes * u)  # covariances
        of_axes = by_axis.reshape(len(u), -1)  # one row an axis, for products with matrices
        # What was not seen has no residual: it must not make the noise look small.
        of_kinds = np.where(self.seen, self.of_kinds[:, None], 0.0)

        def cost(x: Array) -> tuple[float, Array]:
            size = np.einsum("k,kpb->pb", np.exp(x[:kinds]), of_kinds) + ~self.seen
            noise = self.covariance * size[:, :, None] * size[:, None]
            covariance = noise + self.of_known + (x[kinds:] ** 2 @ of_axes).reshape(noise.shape)
            _, log_det = np.linalg.slogdet(covariance)
            inverse = np.linalg.inv(covariance)
            solved = (inverse @ self.residual[:, :, None])[..., 0]
            value = 0.5 * float(np.sum(log_det) + np.sum(self.residual * solved))
            by_covariance = 0.5 * (inverse - solved[:, :, None] * solved[:, None])
            by_kinds = 2.0 * np.einsum("kpb,pbc->k", of_kinds, by_covariance * noise)
            by_times = 2.0 * x[kinds:] * (of_axes @ by_covariance.ravel())
            return value, np.concatenate([by_kinds, by_times])

        start = np.concatenate([np.zeros(kinds), np.clip(1.0, least, most)])
        of_noise = (0.0, 0.0) if as_stated else (-5.0, 10.0)
        bounds = [of_noise] * kinds + list(zip(least, most, strict=True))
        found = minimize(cost, start, jac=True, bounds=bounds, method="L-BFGS-B")
        return _Likeliest(-float(found.fun), np.asarray(found.x[kinds:]))

    def moves_most(self, errors: Array) -> Mask:
        """Return which axes (m,) move the readings most by their errors, in stated noise."""
        stated = np.linalg.cholesky(self.covariance)
        moved = np.linalg.solve(stated, self.by_axes) * errors
        largest = np.argsort(np.sum(moved**2, axis=(0, 1)))[-_WITH_EFFECTS:]
        return np.isin(np.arange(len(errors)), largest)


def _remainder(
    readings: Observations, q_u: Array, chain: Chain, payload: Payload | None
) -> _Remainder | None:
    """Return what a fitted arm leaves; None where too few readings are left, or a log is wrong.

    Args:
        readings: P readings.
        q_u: (P, n) standard uncertainties of joints that are known already, 0 elsewhere [rad, m].
        chain: nominal arm.
        payload: what the arm carries; None where that is not known.

    Raises:
        CalibrationError: when the poses do not determine where base and targets are.
    """
    fit, start = ArmFit.begun(readings, chain, payload)
    measured, by_known = fit.measured, fit.compare(start).by_joints * q_u[:, None]
    of_known = by_known @ by_known.swapaxes(1, 2)
    _, left = fit.weighted_by(measured.stated_covariance + of_known).fitted(start)
    parameter_count = left.taken.shape[2]
    free_share = 1.0 - parameter_count / np.count_nonzero(measured.components_seen)
    if free_share <= 0.0 or left.is_of_a_wrong_log:
        return None
    of_kinds = np.zeros((len(measured.component_kinds), left.residual.shape[1]), dtype=bool)
    for of_kind, (_, columns) in zip(of_kinds, measured.component_kinds, strict=True):
        of_kind[columns] = True
    return _Remainder(
        left.residual[left.usual] / np.sqrt(free_share),
        measured.stated_covariance[left.usual],
        of_known[left.usual],
        of_kinds,
        measured.components_seen[left.usual],
        chain.arm.coupling.by_axes(left.by_joints[left.usual]),
    )
