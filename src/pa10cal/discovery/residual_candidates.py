"""Candidates that the residual of a search proposes: lines of gears, wobbling axes, warm-ups.

A search by itself cannot try them: a line may have any number of cycles a turn, a soft bearing
looks nearly like a wobble, and a stretch of time that alone shows a warm-up is predicted from all
others. So the gain of their log evidence is computed in the residual of a search, beside all that
could imitate them. What stands out joins the candidates, and the search decides.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.normal_equations import normal_equations_of
from pa10cal.discovery.in_time import by_pose_and_time
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.preparation import sought
from pa10cal.discovery.rules import CHANGE, LINES, MOTION, PROBABILITIES, WARMING, WOBBLES
from pa10cal.discovery.together import heavier
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.numerics.periodic_spline import b_splines_by_knots, spline_columns
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import may_show_changes, spread_over_time
from pa10cal.rules import ORDER
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, static_loads_in
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.slide import DEGREES, SlideError
from pa10cal.terms.effects.structure import AxisWobble, LateralCompliance
from pa10cal.terms.effects.vocabulary import every_effect
from pa10cal.terms.effects.warm_up import WarmsUp, warm_ups
from pa10cal.terms.forms.catalogue import all_around


@dataclass(frozen=True, eq=False)
class _Rivals:
    """Everything beside which candidates have to gain log evidence.

    Maps of the model may be kept as the derivative by the angles of their joints, since a pose
    touches four of a map's hundreds of columns. They stand last, in knots of the expected size.
    """

    columns: Array  # (P, b, d) whitened, each in its expected size; of all but such maps
    data: Array  # (P, b) whitened, measured less predicted
    by_angle: Array  # (P, b, m) whitened derivative by the angle of each map
    q_rad: Array  # (P, m) these angles
    bases: tuple[Array, ...]  # (K, K) coefficients of the B-splines of each map, by its knots

    @classmethod
    def of(cls, rows: WhitenedPoses, *others: Array) -> _Rivals:
        """Return a model's terms and targets, and other whitened columns (P, b, k)."""
        at, poses, sizes = rows.at, rows.poses, possible_sizes(rows.at.model)
        maps = [term for term in at.model.terms if is_error_map(term)]
        terms = [term for term in at.model.terms if not is_error_map(term)]
        own = jacobians.by_scaled_terms(at, poses, terms, rows.whitener)
        return cls(
            np.concatenate([*own, rows.by_targets, *others], axis=2),
            rows.data,
            rows.whitener @ jacobians.by_joints(at, poses, [term.joint for term in maps]),
            poses.states.q_rad[:, [term.joint - 1 for term in maps]],
            tuple(b_splines_by_knots(m.knots) * sizes[at.model.columns_of(m)] for m in maps),
        )

    @classmethod
    def dense(cls, columns: Array, data: Array) -> _Rivals:
        """Return rivals without such maps."""
        return cls(columns, data, columns[:, :, :0], np.zeros((len(data), 0)), ())

    def without_maps(self, rows: WhitenedPoses) -> _Rivals:
        """Return the rivals without the maps; what these predict is in the data then."""
        states, values_of, data = rows.poses.states, rows.at.values_of, self.data.copy()
        maps = [term for term in rows.at.model.terms if is_error_map(term)]
        for term, by_angle in zip(maps, np.moveaxis(self.by_angle, 2, 0), strict=True):
            data += by_angle * term.shift(states, values_of(term))
        return _Rivals.dense(self.columns, data)

    @cached_property
    def equations(self) -> Gaussian:
        """Return the normal equations of the columns."""
        columns, data = self.columns.reshape(-1, self.columns.shape[2]), self.data.ravel()
        return normal_equations_of(data, columns, self._by_splines(self.by_angle), self.bases)

    @property
    def seen(self) -> int:
        """Return the number of components that were measured; all others are zero."""
        return int(np.count_nonzero(self.data))

    def beside(self, column: Array) -> tuple[Array, csr_array]:
        """Return products with a column (P, b), pose by pose: (P, d), and with all B-splines."""
        of_maps = np.einsum("pbm,pb->pm", self.by_angle, column)[:, None]
        return np.einsum("pbn,pb->pn", self.columns, column), self._by_splines(of_maps)

    def across(self, dense: Array, splines: csr_array, right: Array) -> Array:
        """Return products (n, t) with right sides (R, t), by rows of `columns` and B-splines."""
        of_splines = splines.T @ right
        stops = np.cumsum([0, *(len(basis) for basis in self.bases)])
        of_maps = zip(self.bases, pairwise(stops), strict=True)
        turned = [basis.T @ of_splines[first:last] for basis, (first, last) in of_maps]
        return np.concatenate([dense.T @ right, *turned])

    def with_each(self, candidates: Array) -> Gaussians:
        """Return the equations of each of K candidates, by whitened columns (P, b, K, k)."""
        right, columns = candidates.reshape(self.data.size, -1), self.columns
        dense, splines = columns.reshape(len(right), -1), self._by_splines(self.by_angle)
        across = self.across(dense, splines, right).reshape(-1, *candidates.shape[2:])
        gram = np.einsum("pbki,pbkj->kij", candidates, candidates, optimize=True)
        projection = np.einsum("pbki,pb->ki", candidates, self.data, optimize=True)
        return self.equations.of_each_further(across, gram, projection)

    def _by_splines(self, by_angle: Array) -> csr_array:
        """Return derivatives (P, b, m) by the angles of maps as those by B-splines, (P b, K)."""
        return spline_columns(by_angle, self.q_rad, [len(basis) for basis in self.bases])


# Lines of gears: periodic errors of joints as often a turn as a gear ratio that nobody stated. No
# map follows a hundred cycles a turn. They show in the periodogram of the residual, at the unevenly
# spaced angles of the poses (Scargle, Astrophysical Journal 263, 1982).


def gear_lines(
    rows: WhitenedPoses,
    error_rate: float,
    known: Collection[str] = (),
    *,
    in_maps: bool = False,
) -> tuple[GearLine, ...]:
    """Return the line of each joint that has one, in the residual of a model or in its maps.

    None for a joint of which two orders fit equally well, as where its angles are whole steps, nor
    at twice a stated gear ratio, which has an effect of its own.

    Args:
        rows: the poses about the model.
        error_rate: probability allowed of finding a line where there is none.
        known: places of lines that the model has.
        in_maps: whether maps are coarse: then a line may stand in the place of each, also one of
            fewer cycles. Fine ones follow those.
    """
    rows = rows.at_most(LINES.most_poses)
    poses, arm = rows.poses, rows.at.arm
    joints = [
        joint
        for joint in (arm.coupling.own[~arm.axes_slide] + 1).tolist()
        if f"joint {joint}" not in known and _angles(poses, joint) >= LINES.least_angles
    ]
    if not joints:
        return ()
    rivals = _Rivals.of(rows)
    beside_maps = _lines(rows, joints, rivals, error_rate)
    # A map may follow a line, which is then in the residual without maps. What a map cannot follow
    # of a line looks like another line beside it.
    maps = [term for term in rows.at.model.terms if is_error_map(term)]
    mapped = [term.joint for term in maps if term.joint in joints]
    rivals, times = rivals.without_maps(rows), LINES.of_map_times
    instead: tuple[GearLine, ...] = ()
    if in_maps and mapped:
        instead = _lines(rows, mapped, rivals, error_rate, times, in_maps=True)
    taken = {line.of for line in instead}
    found = (*instead, *(line for line in beside_maps if line.of not in taken))
    if found or not maps:
        return found
    return _lines(rows, joints, rivals, error_rate, times)


def _angles(poses: Observations, joint: int) -> int:
    """Return the number of different angles of a joint, counted from 1."""
    return len(np.unique(np.round(poses.states.q_rad[:, joint - 1], LINES.angle_decimals)))


def _lines(
    rows: WhitenedPoses,
    joints: Sequence[int],
    rivals: _Rivals,
    error_rate: float,
    times: float = 1.0,
    *,
    in_maps: bool = False,
) -> tuple[GearLine, ...]:
    """Return the lines of joints in a residual.

    Args:
        rows: the poses about the model.
        joints: where lines are sought.
        rivals: columns of the model, and the residual.
        error_rate: probability allowed of finding a line where there is none.
        times: how many times as much as any other the best order has to gain.
        in_maps: whether lines stand in place of maps, so that orders that maps follow count too.
    """
    by_joint = rows.whitener @ jacobians.by_joints(rows.at, rows.poses, joints)
    q_rad = rows.poses.states.q_rad
    spectra = [
        _Periodogram.of(rivals, by_joint[:, :, k], angles, _lowest_order(angles, in_maps=in_maps))
        for k, angles in enumerate(q_rad.T[np.array(joints) - 1])
    ]
    needed = float(np.log(sum(len(spectrum.orders) for spectrum in spectra) / error_rate))
    found = []
    for joint, spectrum in zip(joints, spectra, strict=True):
        order = spectrum.line(needed, times)
        stated = 2.0 * float(rows.at.arm.gear_ratio[joint - 1])
        if order is not None and not abs(order - stated) < spectrum.width:  # nan if not stated
            # A whole turn resolves a cycle a turn, half a turn two.
            width = round(max(spectrum.width, 1.0), LINES.order_decimals)
            k, multiples = spectrum.with_multiples(order, stated, error_rate)
            k = round(k, LINES.order_decimals)
            found.append(GearLine(f"joint {joint}", k, width, multiples))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Periodogram:
    """Gain of log evidence by waves of one joint's angle."""

    q_rad: Array  # (P,) the joint's angles
    rivals: _Rivals
    by_joint: tuple[Array, csr_array]  # products of the rivals with the joint's column, by pose
    squares: Array  # (P,) squares of the joint's column
    data_by_joint: Array  # (P,) products of the joint's column with the data
    lowest: float  # order from which on a line is sought [cycles a turn]
    highest: float  # and up to which

    @classmethod
    def of(
        cls,
        rivals: _Rivals,
        by_joint: Array,
        q_rad: Array,
        lowest: float,
        highest: float = LINES.orders[1],
    ) -> _Periodogram:
        """Return that of a joint by its whitened column (P, b) and its angles (P,)."""
        return cls(
            q_rad=q_rad,
            rivals=rivals,
            by_joint=rivals.beside(by_joint),
            squares=np.sum(by_joint**2, axis=1),
            data_by_joint=np.sum(by_joint * rivals.data, axis=1),
            lowest=lowest,
            highest=highest,
        )

    @property
    def width(self) -> float:
        """Return the width of a line: one cycle over the range of the joint's angles."""
        return float(2.0 * np.pi / np.ptp(self.q_rad))

    @property
    def orders(self) -> Array:
        """Return the orders that are tried [cycles a turn]."""
        return np.arange(self.lowest, self.highest, LINES.step_widths * self.width)

    def line(self, needed: float, times: float = 1.0) -> float | None:
        """Return the order of the line that gains what is needed [nat]; None if none does.

        Nor if another order, further away, gains nearly as much, or a part of it as stated.
        """
        orders = self.orders
        firsts = range(0, len(orders), LINES.at_once)
        gains = np.concatenate([self.gains(orders[k : k + LINES.at_once]) for k in firsts])
        best = int(np.argmax(gains))
        if gains[best] < needed:
            return None
        apart = np.abs(orders - orders[best]) > LINES.widths_apart * self.width
        other = np.max(gains[apart], initial=-np.inf)
        if other > min(gains[best] - LINES.better_nats, gains[best] / times):
            return None
        step = LINES.step_widths * self.width
        finest = minimize_scalar(
            lambda order: -float(self.gains(np.array([order]))[0]),
            bounds=(orders[best] - step, orders[best] + step),
            method="bounded",
        )
        if self.lowest < LINES.orders[0] and finest.x < self.lowest:  # a smooth error is no line
            return None
        return float(finest.x)

    def with_multiples(
        self, order: float, stated: float, error_rate: float
    ) -> tuple[float, tuple[int, ...]]:
        """Return k of the line of an order, and the multiples of it that the residual shows too.

        What repeats k times a turn need not be a sine. The line may itself be the double of k, if
        the wave of k is smaller. Each of these orders is given by that of the line: a wave has to
        gain no more than the few that are tried demand, beside the waves before it.

        Args:
            order: of the line [cycles a turn].
            stated: order that has a name of its own; nan for none.
            error_rate: probability allowed of finding a multiple where there is none.
        """
        if order < LINES.orders[0]:  # in the place of a map, which follows such multiples
            return order, ()
        halved = 0.5 * order
        half = (0.5,) if halved >= LINES.orders[0] else ()
        tried = (*half, *range(2, LINES.most_multiple + 1))
        needed = float(np.log(len(tried) / error_rate))
        waves = [1.0]
        for each in tried:
            has_name = abs(each * order - stated) < self.width
            if not has_name and self._gain_beside(waves, each, order) > needed:
                waves.append(each)
        k = min(waves)
        further = sorted(round(wave / k) for wave in waves)
        return k * order, tuple(further[1:])

    def _gain_beside(self, waves: Sequence[float], another: float, order: float) -> float:
        """Return the gain by another multiple of an order, beside waves of some multiples."""
        one = np.array([order])
        return float((self.gains(one, [*waves, another]) - self.gains(one, waves))[0])

    def gains(self, orders: Array, multiples: Sequence[float] = (1.0,)) -> Array:
        """Return the gain of log evidence by a line of each of K orders, scatter profiled, (K,).

        Args:
            orders: (K,) cycles a turn.
            multiples: of each order, of which there are waves.
        """
        phase = self.q_rad[:, None, None] * orders[:, None] * multiples
        waves = LINES.size_rad * np.concatenate([np.sin(phase), np.cos(phase)], axis=-1)
        across = self.rivals.across(*self.by_joint, waves.reshape(len(phase), -1))
        across = across.reshape(-1, *waves.shape[1:])
        weighted = (waves * self.squares[:, None, None]).transpose(1, 2, 0)
        gram = weighted @ waves.transpose(1, 0, 2)
        projection = np.tensordot(self.data_by_joint, waves, axes=1)
        further = self.rivals.equations.of_each_further(across, gram, projection)
        return np.asarray(further.gains(self.rivals.seen)[0] / PROBABILITIES.blocks)


def _lowest_order(q_rad: Array, *, in_maps: bool) -> float:
    """Return the order from which on a line is sought at angles (P,) of a joint.

    What a map follows may be a line of a lower order, of a joint that was not seen all around: a
    line of a whole number is no better known there than others, and has no name of its own.
    """
    if not in_maps or all_around(q_rad):
        return LINES.orders[0]
    of_range = LINES.least_cycles * 2.0 * np.pi / float(np.ptp(q_rad))
    return min(max(LINES.lowest_in_map, of_range), LINES.orders[0])


# Waves along strokes: supports of a rail, teeth of a rack or turns of a screw err as often as they
# come along it. Polynomials of the stroke follow no such wave, and no effect has it as its form:
# where nothing predicts what is left, it is told where the waves are and how long.


class StrokeWave(NamedTuple):
    """A wave of what a model leaves, along the stroke of a joint that slides."""

    of: str  # the joint
    length_m: float


def stroke_waves(
    rows: WhitenedPoses, context: CandidateContext, error_rate: float
) -> tuple[StrokeWave, ...]:
    """Return the wave of each slide along whose stroke the residual of a model has one.

    It may be of any of the six small motions of the carriage; the one that shows it best counts.
    None where two lengths fit equally well, as where a joint stood at places in even steps.

    Args:
        rows: the poses about the model.
        context: what decides which joints slide.
        error_rate: probability allowed of finding a wave where there is none.
    """
    rows = rows.at_most(LINES.most_poses)
    slides = [
        slide
        for slide in SlideError.everywhere(context)
        if _angles(rows.poses, slide.joint) >= LINES.least_angles
    ]
    if not slides:
        return ()
    rows = replace(rows, at=rows.at.bending_as(slides))
    rivals, spectra = _Rivals.of(rows), {}
    for slide in slides:
        q_m = rows.poses.states.q_rad[:, slide.joint - 1]
        # Polynomials follow at most half as many waves as their degree; as many waves come along
        # the stroke as along a turn, however long it is.
        range_m = float(np.ptp(q_m))
        lowest, highest = np.pi * DEGREES / range_m, 2.0 * np.pi * LINES.orders[1] / range_m
        moves = rows.whitener @ jacobians.by_coordinates(rows.at, rows.poses, slide.coordinates)
        spectra[slide.of] = [
            _Periodogram.of(rivals, move, q_m, lowest, highest) for move in np.moveaxis(moves, 2, 0)
        ]
    tried = sum(len(each.orders) for of_slide in spectra.values() for each in of_slide)
    needed = float(np.log(max(tried, 1) / error_rate))
    return tuple(
        StrokeWave(of, 2.0 * np.pi / order)
        for of, of_slide in spectra.items()
        if (order := _strongest_line(of_slide, needed)) is not None
    )


def _strongest_line(spectra: Sequence[_Periodogram], needed: float) -> float | None:
    """Return the order of the line that gains most in several spectra of one joint, if any does."""
    lines = [(each, order) for each in spectra if (order := each.line(needed)) is not None]
    gains = [float(each.gains(np.array([order]))[0]) for each, order in lines]
    return lines[int(np.argmax(gains))][1] if lines else None


# Axes that wobble as their joints turn. A bearing that is softer about one axis than about another
# tilts under weights that turn with the joint, nearly as a wobble does. So the tilts of every axis
# are tested beside all that may give way, with large prior sizes: bearings about any axes, links,
# base and tool, under the weights as described and, where nobody stated these, by each weight.


@dataclass(frozen=True)
class _SoftAnyWay(LateralCompliance):
    """A bearing that tilts about each of its two axes under the moments about both."""

    names = ("C_xx", "C_xy", "C_yx", "C_yy")

    def per_unit(self, states: PoseStates) -> Array:
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(np.einsum("pk,ij->pijk", moment_Nm, np.eye(2)).reshape(-1, 2, 4))


def wobbles(
    rows: WhitenedPoses,
    context: CandidateContext,
    payload: Payload | None,
    error_rate: float,
    known: Collection[str],
) -> tuple[AxisWobble, ...]:
    """Return the wobble that is significant in a model's residual, and clearly the best; or none.

    Args:
        rows: the poses about the model.
        context: where effects may sit.
        payload: what the arm carries; None where no weight is known.
        error_rate: probability allowed of finding a wobble where there is none.
        known: places of wobbles that were tried.
    """
    rows = rows.at_most(LINES.most_poses)
    there = {*known, *(term.of for term in rows.at.model.terms if term.id == AxisWobble.id)}
    tried = [wobble for wobble in AxisWobble.everywhere(context) if wobble.of not in there]
    if not tried:
        return ()
    rows = replace(rows, at=rows.at.with_bends(range(1, rows.at.arm.n)))
    at, poses, whiten = rows.at, rows.poses, rows.whitener
    rivals = _Rivals.of(rows, *_giving_way(rows, context, payload))
    starts = [wobble.starts[0] for wobble in tried]
    tilts = np.stack(jacobians.by_scaled_effects(at, poses, tried, starts, whiten), axis=2)
    gains = rivals.with_each(tilts).gains(rivals.seen)[0] / PROBABILITIES.blocks
    best, *others = np.argsort(-gains).tolist()
    needed = float(np.log(len(tried) / error_rate))
    ambiguous = bool(others) and gains[others[0]] > gains[best] - WOBBLES.better_nats
    return () if gains[best] < needed or ambiguous else (tried[best],)


def _giving_way(
    rows: WhitenedPoses, context: CandidateContext, payload: Payload | None
) -> Iterator[Array]:
    """Yield whitened columns (P, b, k) of everything compliant but springs, in large sizes."""
    if payload is None or rows.poses.states.static_loads is None:
        return
    kinds = [kind for kind in every_effect() if kind.bends and kind is not LateralCompliance]
    soft: list[Effect] = [effect for kind in kinds for effect in kind.everywhere(context)]
    soft += _SoftAnyWay.everywhere(context)
    starts = [effect.starts[0] for effect in soft]

    def columns(poses: Observations) -> Array:
        found = jacobians.by_scaled_effects(rows.at, poses, soft, starts, rows.whitener)
        return WOBBLES.sizes * np.concatenate(found, axis=2)

    described, arm = columns(rows.poses), rows.at.arm
    yield described
    if weights_known(arm).assumed:
        for each in heavier(rows.poses, weight_sizes(arm, payload).columns(arm)):
            yield columns(each) - described


# Joints and links that warm up: an arm that was not warm errs most in its first poses, less and
# less. Warm-ups of all joints and long links together, with one time constant, are compared with
# what else may settle or move in the first poses: base or instrument, tool, targets. All that
# depends on the pose, and drifts, are integrated out besides.


def warm_ups_shown(
    rows: WhitenedPoses, context: CandidateContext, *, logged: bool
) -> tuple[WarmsUp, ...]:
    """Return the warm-up of every joint and long link if they are significant together; or none.

    With the most likely time constant. None where the base, the tool or a target that settles or
    moves explains the residual as well, and none where rows do not tell time.

    Args:
        rows: the poses about a model that was fitted to them.
        context: where effects may sit.
        logged: whether torques were logged.
    """
    tried, poses = warm_ups(context), rows.poses
    if not tried or not may_show_changes(poses):
        return ()
    rows = rows.take(spread_over_time(poses, MOTION.most_readings))
    first_s, last_s = context.time_span_s
    shortest_s, longest, count = WARMING.time_constants
    if shortest_s >= longest * (last_s - first_s):
        return ()
    taus_s = np.geomspace(shortest_s, longest * (last_s - first_s), count)
    rivals = _poses_and_drifts(rows, context, logged=logged)
    gains = _gains_at_best_size(rivals, _warm_up_columns(rows, tried, taus_s))
    best, needed = int(np.argmax(gains)), np.log(count * len(CHANGE.scales) / MOTION.false_rate)
    # With the longest time constant it is a drift.
    if best == count - 1 or gains[best] < needed:
        return ()
    # Nor may it rest on one pose, of which a joint may be misread.
    since_s = rows.poses.states.time_s - first_s
    off = np.exp(-since_s / taus_s[best]) * np.linalg.norm(rows.data, axis=1)
    others = rows.take(np.delete(np.arange(len(off)), int(np.argmax(off))))
    by_others = _gains_at_best_size(
        _poses_and_drifts(others, context, logged=logged),
        _warm_up_columns(others, tried, taus_s[[best]]),
    )
    if by_others[0] < needed:
        return ()
    if gains[best] < _best_motion(rows, rivals, since_s, taus_s) + WARMING.better_nats:
        return ()
    return tuple(replace(effect, tau_s=float(taus_s[best])) for effect in tried)


def _warm_up_columns(rows: WhitenedPoses, tried: tuple[WarmsUp, ...], taus_s: Array) -> Array:
    """Return whitened columns (P, b, K, m) of m warm-ups with each of K time constants."""
    shapes = [replace(effect, tau_s=float(tau_s)) for tau_s in taus_s for effect in tried]
    starts = [shape.starts[0] for shape in shapes]
    columns = jacobians.by_scaled_effects(rows.at, rows.poses, shapes, starts, rows.whitener)
    every = np.concatenate(columns, axis=2)
    return every.reshape(*every.shape[:2], len(taus_s), len(tried))


def _poses_and_drifts(rows: WhitenedPoses, context: CandidateContext, *, logged: bool) -> _Rivals:
    """Return all that depends on the pose, and drifts."""
    at, poses, whiten = rows.at, rows.poses, rows.whitener
    effects = sought(context, at.model.terms)
    smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    own = jacobians.by_scaled_terms(at, poses, at.model.terms, whiten)
    columns = [
        *(CHANGE.static_sizes * each for each in own),
        MOTION.targets_m * rows.by_targets,
        *(whiten @ each for each in smooth),
    ]
    return _Rivals.dense(np.concatenate(columns, axis=2), rows.data)


def _gains_at_best_size(rivals: _Rivals, candidates: Array) -> Array:
    """Return the gain of log evidence (K,) by each of K candidates, by columns (P, b, K, k)."""
    further, sizes = rivals.with_each(candidates), np.array(CHANGE.scales)[:, None]
    gains = [further.in_sizes(size).gains(rivals.seen)[0] for size in sizes]
    return np.asarray(np.max(gains, axis=0) / PROBABILITIES.blocks)


def _best_motion(rows: WhitenedPoses, rivals: _Rivals, since_s: Array, taus_s: Array) -> float:
    """Return the gain by motions of the base or of all targets that settle, or step early.

    By times (P,) from the first reading on, and time constants with which they may settle.
    """
    early_s = since_s[since_s < ORDER.end_share * since_s.max()]
    steps_s = np.quantile(early_s, np.linspace(0.0, 1.0, MOTION.coarse_times))
    settling = np.exp(-since_s[:, None] / taus_s)
    courses = np.concatenate([settling, since_s[:, None] <= steps_s], axis=1)[:, None, :, None]
    of_base = rows.whitener @ jacobians.by_base(rows.at, rows.poses)
    motions = [each for each in (of_base, rows.by_targets) if each.shape[2]]
    gains = (
        _gains_at_best_size(rivals, WARMING.base_m * each[:, :, None, :] * courses)
        for each in motions
    )
    return max(float(gain.max()) for gain in gains)
