"""Joint positions that were rounded: to whole counts of an encoder, or to decimals of a unit.

Programmed positions are in round parts of a unit, too, and exact: whether decimals are a rounding,
the readings decide. An arm with springs is fitted to them, by least squares. What remains must be
likelier with the errors of a rounding in every joint than with noise alone, and about as likely as
where any joint may be exact. Effects make errors of joints, too: where what remains is not as large
as rounding makes it, it must not be explained by those joints alone that show the largest errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.optimize import minimize

from pa10cal.arm.chain import TOOL, Chain, end_pose_with_screws
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, statics
from pa10cal.arrays import Array, drawn
from pa10cal.campaign.joint_positions import in_radians, position_columns
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.errors import CalibrationError
from pa10cal.observe.observations import Observations

V = TypeVar("V")

#: Resolutions of encoders that are told from a list of positions [counts a turn]: powers of two, as
#: programmed positions are in round parts of a degree; few parts of a turn are programmed, too.
_COUNTS, _FEWEST_COUNTS = 2.0 ** np.arange(17), 256.0
#: Units in whose decimals positions may be rounded, by the word for them: as columns have them.
_UNITS_OF_TURNS = {"deg": 1.0, "rad": float(np.degrees(1.0)), "turns": 360.0}
_UNITS_OF_SLIDES = {"mm": 1.0}
#: Steps that are told, in these units.
_DECIMALS = 10.0 ** -np.arange(7)
#: Part of a step by which each position may be off it: printed digits (computing).
_OFF_STEP = 0.1
#: Fewest different positions by which a step is told (level).
_FEWEST_POSITIONS = 20

#: Poses to which the arm is fitted, at most, and steps of that fit (computing).
_MOST_POSES, _STEPS = 300, 3
#: Poses that leave more than so many times the median square are not compared (size).
_GROSS = 25.0
#: A log that leaves so many times what is stated is wrong, and shows no rounding (size).
_WRONG = 1e3
#: Singular values below this part of the largest are not determined (computing).
_NOT_DETERMINED = 1e-6
#: Joints that effects may have errors of, where positions are exact (chosen).
_WITH_EFFECTS = 2
#: Gain in log likelihood that rounding needs, and the most that it may be below that of joints with
#: errors of any size, where those of no joint are below those of rounding, and where all are as
#: large [nat] (level).
_GAIN, _MOST_LOST, _AS_LIKELY = 10.0, 8.0, 4.0
#: Errors of joints are at most so many times as of rounding (computing).
_MOST_TIMES = 30.0


class DecimalStep(NamedTuple):
    """A step of which all positions of an axis are whole numbers."""

    words: str  # with the unit of its decimals, as `0.001 rad`
    in_column: float  # in the unit of the axis' column
    unit: str  # that unit, `deg` or `mm`


def whole_counts(q_deg: Array) -> float:
    """Return the counts a turn to which all positions (N,) were rounded; 0 for none.

    The fewest counts of which every position is a whole number.
    """
    for counts in _COUNTS.tolist():
        if _are_whole(q_deg, 360.0 / counts):
            return float(counts) if counts >= _FEWEST_COUNTS else 0.0
    return 0.0


def decimal_step(q: Array, *, slides: bool) -> DecimalStep | None:
    """Return the largest decimal step of which all positions (N,) are whole numbers; or None.

    In a unit of turns, or in millimetres where the axis slides.
    """
    units, of_column = (_UNITS_OF_SLIDES, "mm") if slides else (_UNITS_OF_TURNS, "deg")
    found = [
        DecimalStep(f"{decimal:g} {unit}", size * decimal, of_column)
        for unit, size in units.items()
        for decimal in _DECIMALS.tolist()
        if _are_whole(q, size * decimal)
    ]
    return max(found, key=lambda step: step.in_column, default=None)


def _are_whole(q: Array, step: float) -> bool:
    """Return whether positions (N,) differ by whole steps."""
    positions = np.unique(q)
    if len(positions) < _FEWEST_POSITIONS:
        return False
    moved = (positions - positions[0]) / step
    return bool(np.abs(moved - np.round(moved)).max() < _OFF_STEP)


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
    """Return whether readings show errors of joints as of a rounding, with uncertainties u (n,)."""
    _, once = np.unique(readings.states.q_rad, axis=0, return_index=True)  # repeats share theirs
    once = np.sort(once)[drawn(len(once), _MOST_POSES)]
    try:
        left = _Left.of(readings.take(once), chain, payload)
    except (CalibrationError, np.linalg.LinAlgError):
        return False  # base and targets are not determined
    if left is None:
        return False
    none, one, most = (np.full(len(u), times) for times in (0.0, 1.0, _MOST_TIMES))
    by_rounding, _ = left.log_likelihood(u, one, most)
    of_noise, _ = left.log_likelihood(u, none, none)
    if by_rounding < of_noise + _GAIN:
        return False
    of_any, times = left.log_likelihood(u, none, most)
    if by_rounding < of_any - _MOST_LOST:
        return False
    if left.log_likelihood(u, one, one)[0] > of_any - _AS_LIKELY:
        return True
    moved_m = times * u * np.sqrt(np.sum(left.by_joints**2, axis=(0, 1)))
    with_effects = np.isin(np.arange(len(u)), np.argsort(moved_m)[-_WITH_EFFECTS:])
    of_effects, _ = left.log_likelihood(u, none, np.where(with_effects, most, 0.0))
    return by_rounding > of_effects + _GAIN


class _Left(NamedTuple):
    """What the fitted arm leaves of P poses with b components, less the unknowns that it took."""

    residual: Array  # (P, b), zero where not seen
    covariance: Array  # (P, b, b) as stated
    of_kinds: Array  # (c, b) which components are of each kind
    by_joints: Array  # (P, b, n) derivative by errors of the joints

    @classmethod
    def of(cls, readings: Observations, chain: Chain, payload: Payload | None) -> _Left | None:
        """Fit links, springs, base, tool and targets; None where too few readings are left."""
        q_rad, measured = readings.states.q_rad, readings.measured
        located = measured.locate(chain.forward(q_rad), roughly=True)
        coordinates, targets_m = chain.coordinates(q_rad), np.zeros(0)
        if located.T_ee_target is not None:
            measured = readings.turned(located.T_ee_target[:3, :3]).measured
            coordinates[:, chain.columns(TOOL[:3])] += located.T_ee_target[:3, 3]
        elif located.p_ee_targets_m is not None:
            targets_m = located.p_ee_targets_m.ravel()
        R, joints = located.T_instr_base[:3, :3], chain.joint_columns
        torque = _relative_torques(readings, chain, payload)
        root = np.linalg.inv(np.linalg.cholesky(measured.stated_covariance))
        for _ in range(_STEPS):
            end = end_pose_with_screws(chain, coordinates)
            seen = measured.compare(located.T_instr_base @ end.T, targets_m)
            turned = np.concatenate([R @ end.screws[:, :3], R @ end.screws[:, 3:]], axis=1)
            moved = seen.by_end @ turned
            by_springs = moved[:, :, joints] * torque[:, None]
            columns = np.concatenate([moved, by_springs, seen.by_targets], axis=2)
            rows = (root @ columns).reshape(-1, columns.shape[2])
            wanted = -(root @ seen.residual[:, :, None]).ravel()
            step, _, rank, _ = np.linalg.lstsq(rows, wanted, rcond=_NOT_DETERMINED)
            of_chain, of_springs, of_targets = np.split(
                step, [moved.shape[2], moved.shape[2] + len(joints)]
            )
            coordinates += of_chain
            coordinates[:, joints] += torque * of_springs
            targets_m = targets_m + of_targets
        residual = seen.residual + columns @ step
        spare = 1.0 - rank / np.count_nonzero(measured.components_seen)
        if spare <= 0.0:
            return None
        square = np.sum((root @ residual[:, :, None])[..., 0] ** 2, axis=1)
        if np.median(square) > _WRONG**2 * residual.shape[1]:  # as by a reversed joint
            return None
        usual = square <= _GROSS * np.median(square)
        kinds = np.zeros((len(measured.component_kinds), residual.shape[1]), dtype=bool)
        for kind, (_, columns_of_kind) in zip(kinds, measured.component_kinds, strict=True):
            kind[columns_of_kind] = True
        return cls(
            residual[usual] / np.sqrt(spare),
            measured.stated_covariance[usual],
            kinds,
            moved[usual][:, :, joints],
        )

    def log_likelihood(self, u: Array, least: Array, most: Array) -> tuple[float, Array]:
        """Return the largest log likelihood of noise of any size and errors of joints, and these.

        Args:
            u: (n,) standard uncertainties of the joints.
            least, most: (n,) between which multiples of them the joints' errors may be.
        """
        kinds = len(self.of_kinds)
        joints = np.einsum("pbj,pcj->jpbc", self.by_joints, self.by_joints)
        joints = (joints * (u**2)[:, None, None, None]).reshape(len(u), -1)

        def cost(x: Array) -> tuple[float, Array]:
            size = np.exp(x[:kinds]) @ self.of_kinds
            noise = self.covariance * size[:, None] * size
            covariance = noise + (x[kinds:] ** 2 @ joints).reshape(noise.shape)
            _, log_det = np.linalg.slogdet(covariance)
            inverse = np.linalg.inv(covariance)
            solved = (inverse @ self.residual[:, :, None])[..., 0]
            value = 0.5 * float(np.sum(log_det) + np.sum(self.residual * solved))
            by_covariance = 0.5 * (inverse - solved[:, :, None] * solved[:, None])
            by_kinds = 2.0 * self.of_kinds @ (by_covariance * noise).sum(axis=(0, 2))
            by_times = 2.0 * x[kinds:] * (joints @ by_covariance.ravel())
            return value, np.concatenate([by_kinds, by_times])

        start = np.concatenate([np.zeros(kinds), np.clip(1.0, least, most)])
        bounds = [(-5.0, 10.0)] * kinds + list(zip(least, most, strict=True))
        found = minimize(cost, start, jac=True, bounds=bounds, method="L-BFGS-B")
        return -float(found.fun), np.asarray(found.x[kinds:])


def _relative_torques(readings: Observations, chain: Chain, payload: Payload | None) -> Array:
    """Return torques (P, n) by which springs turn joints, at most 1; 0 where they are not known."""
    states, arm = readings.states, chain.arm
    torque = states.tau_Nm
    logged = np.isfinite(torque).all()
    if payload is not None and payload.gravity_m_s2.any() and not logged:
        torque = statics(chain, chain.coordinates(states.q_rad), states.load_N, payload).joint_Nm
    torque = np.where(arm.prismatic, 0.0, np.nan_to_num(torque))
    return np.asarray(torque / np.maximum(np.abs(torque).max(axis=0), 1e-9))
