"""Where a frame of a fitted model is, and how it moves with the joints, terms included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.chain import BASE, TOOL, EndPose, end_pose, end_pose_with_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.errors import ModelError
from pa10cal.fit.fitted import FLANGE, TARGET, TOOL_FRAME, FallBack, Fitted, Prediction
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.fit.uncertain_weights import with_weights_by_log
from pa10cal.numerics.periodic_spline import b_splines, b_splines_by_knots
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OF
from pa10cal.terms.term import Term, shows_torque, yields

#: Step of the central differences by which terms change with the joints [rad, m]: of harmonics as
#: fine as those of a gear they are good to nine digits (computing).
_STEP = 1e-6
#: How much heavier than the heaviest load of the fit a load may be: rounding of a unit (computing).
_SAME_LOAD = 1.0 + 1e-6
#: Turns smaller than this have no axis [rad] (computing).
_NO_TURN_RAD = 1e-9


def states_at(
    model: Fitted,
    q: Array,
    load_N: ArrayLike = 0.0,
    arrival: ArrayLike = 0.0,
    temperature_C: ArrayLike | None = None,
    time_s: ArrayLike | None = None,
    *,
    extrapolate: bool = False,
) -> PoseStates:
    """Return the states in which poses are asked for, without torques; see `FittedModel.predict`.

    Args:
        q: (N, n) joint positions; `arrival` is of the axes that the controller counts.
        temperature_C, time_s: nan where they are not given, as in the states returned.

    Raises:
        ModelError: when a load is no load, or heavier than any that the fit has seen; when a side
            of arrival is none; or when there are not as many numbers as poses.
    """
    fitted, count = model.fitted_to, len(q)
    temperature_C = np.nan if temperature_C is None else temperature_C
    time_s = np.nan if time_s is None else time_s
    every_N = _of_every_pose("load_N", load_N, (count,))
    of_temperature = _of_every_pose("temperature_C", temperature_C, (count,))
    of_time = _of_every_pose("time_s", time_s, (count,))
    directions = _of_every_pose("arrival", arrival, (count, len(model.arm.axes_slide)))
    if not np.isin(directions, (-1.0, 0.0, 1.0)).all():
        row, joint = np.argwhere(~np.isin(directions, (-1.0, 0.0, 1.0)))[0]
        where = f"arrival of joint {joint + 1}, pose {row + 1}"
        raise ModelError(
            "no direction of arrival",
            where=where,
            value=float(directions[row, joint]),
            allowed="-1 or 1, the sign of the joint's last motion; 0 where it is not known",
            remedy="correct the value",
        )
    seen_N = () if fitted is None else fitted.loads_N
    wrong = ~(every_N >= 0.0) | ~np.isfinite(every_N)
    if seen_N and not extrapolate:
        wrong |= every_N > _SAME_LOAD * max(seen_N)
    if wrong.any():
        row = int(np.argmax(wrong))
        allowed = f"0 to {max(seen_N):g} N, the heaviest load of its fit" if seen_N else "0 N on"
        raise ModelError(
            "the model does not know this load",
            where=f"load_N of pose {row + 1}",
            value=float(every_N[row]),
            allowed=allowed,
            remedy="calibrate with this load too; or extrapolate (on the command line --force), "
            "which the uncertainty does not cover",
        )
    unknown_Nm, directions = np.full_like(q, np.nan), model.arm.coupling.arrivals(directions)
    return PoseStates(q, unknown_Nm, directions, every_N, of_temperature, of_time)


def _of_every_pose(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return what is given once, or for every pose, as an array of this shape."""
    try:
        return np.broadcast_to(np.asarray(value, dtype=float), shape)
    except (TypeError, ValueError):
        raise ModelError(
            "not one number for all poses, nor one for each",
            where=name,
            value=value,
            allowed=f"a number, or an array of shape {shape}",
            remedy="give as many as there are poses",
        ) from None


@dataclass(frozen=True)
class Forward:
    """Forward kinematics of a frame of a fitted model."""

    whole: Fitted  # the fitted model
    # its terms that move the robot; what an instrument reads falsely and what a torque log shows
    # falsely move none
    physical: Model
    x: Array  # their parameters
    columns: NDArray[np.intp]  # places of these in the parameters of the whole model
    on_tool: bool  # whether the frame follows the end of the chain, tool included, not the flange
    T_end_frame: Array  # (4, 4) the frame in the end of the chain

    @classmethod
    def of(cls, model: Fitted, frame: str = FLANGE) -> Forward:
        """Return the forward kinematics of one of a model's frames.

        Raises:
            ModelError: when it has no such frame.
        """
        if frame not in model.frames:
            raise ModelError(
                "unknown frame",
                where="frame",
                value=frame,
                allowed=", ".join(model.frames),
                remedy="correct the name",
            )
        # A frame of a campaign of a group moves under what the arm carried there.
        carried = () if model.payload is None else model.payload.of_campaigns
        payload_of = dict(zip(model.R_first_target_of, carried, strict=False))
        payload = payload_of.get(frame.partition(OF)[2], model.payload)
        model = replace(model, payload=payload)
        known, soft = model.arm.weights_known, any(yields(term) for term in model.model.terms)
        logged = known is not None and (known.origin == "logged" or known.by_log is not None)
        if logged and soft and payload is not None:
            model = with_weights_by_log(model, payload)
        # Of a group `tool` is that of the first campaign that measured poses.
        tools = model.tools
        own = tools.get(frame) or next(iter(tools.values()), None)
        on_tool = frame in tools or (frame == TOOL_FRAME and bool(tools or not model.target_names))

        def moves(term: Term) -> bool:
            """Return whether a term moves the frame in the base."""
            if term.of == "instrument" or term.falsifies_log:
                return False
            if on_tool:
                return term not in tools.values() or term is own
            # Targets are placed in the flange, and go with a tool that gives way.
            of_tool = bool(term.coordinates) and set(term.coordinates) <= set(TOOL)
            return not of_tool or not (term.constant or frame == FLANGE)

        moving = [term for term in model.model.terms if moves(term)]
        chosen = model.model.parameter_indices(*moving)
        T = np.eye(4)
        if on_tool:
            campaign = "" if own is None else own.name
            T[:3, :3] = model.R_ee_target @ model.R_first_target_of.get(campaign, np.eye(3))
        elif frame != FLANGE:
            name = frame.removeprefix(TARGET)
            row = model.target_names.index(name) if frame != TOOL_FRAME else 0
            T[:3, 3] = model.targets_m.reshape(-1, 3)[row]
        terms = tuple(own.term if own is not None and term is own else term for term in moving)
        physical = Model(model.model.chain, terms)
        return cls(model, physical, model.x[chosen], chosen, on_tool, T)

    def states(self, given: PoseStates) -> PoseStates:
        """Return states with what their weights do, whatever torques they had.

        A temperature that is not given is the mean of the fit.

        Raises:
            ModelError: when the model has springs and the masses that load them are not known.
        """
        whole, payload, q = self.whole, self.whole.payload, given.q_rad
        temperature_C, fitted = given.temperature_C, whole.fitted_to
        if fitted is not None and fitted.temperature_C is not None:
            temperature_C = np.where(np.isnan(temperature_C), fitted.temperature_C, temperature_C)
        of_pose = given.load_N, temperature_C, given.time_s
        states = PoseStates(q, np.full_like(q, np.nan), given.arrival, *of_pose)
        states, source = with_torques(whole.model, whole.x, states, payload)
        if source == "none" or payload is None:
            for term in filter(yields, self.physical.terms):
                raise ModelError(
                    "the weights that load the arm are not known",
                    where=f"{term.id} of {term.of}",
                    allowed="an arm with mass_kg and com_m, and a payload",
                    remedy="describe the masses and calibrate again",
                )
            return replace(states, tau_Nm=np.zeros_like(q))
        if not self.physical.terms_of("effect", "field"):
            return states
        # Effects that bend need the static loads; those of the nominal arm come first.
        rigid = Model(self.physical.chain, ())
        for model, values in ((rigid, np.zeros(0)), (self.physical, self.x)):
            loads = statics_of(model, values, states, payload).static_loads
            states = replace(states, static_loads=loads)
        return states

    def T_base_frame(self, states: PoseStates) -> Array:
        """Return where the frame is, (N, 4, 4) [m]."""
        T: Array = end_pose(self.physical.chain, self._coordinates(states)) @ self.T_end_frame
        return T

    def end(self, states: PoseStates) -> EndPose:
        """Return the end of the chain that carries the frame, and its screws."""
        return end_pose_with_screws(self.physical.chain, self._coordinates(states))

    def by_joints(self, states: PoseStates, *, terms: bool) -> tuple[Array, Array]:
        """Return where the frame is (N, 4, 4), and its derivative by the joints (N, 6, n).

        Args:
            terms: whether the derivative holds how the terms themselves change with the joints,
                through angles and through weights; else only that of the geometry, which is off by
                some parts in a hundred and takes a tenth of the time.
        """
        chain = self.physical.chain
        if terms:
            end = self.end(states)
            columns = []
            for step in _STEP * np.eye(states.n):
                ahead, behind = (
                    self._coordinates(
                        self.states(replace(states, q_rad=states.q_rad + sign * step))
                    )
                    for sign in (1.0, -1.0)
                )
                columns.append((ahead - behind) / (2.0 * _STEP))
            moved = end.screws @ np.stack(columns, axis=-1)
        else:
            end = end_pose_with_screws(
                chain, self._coordinates(states), chain.joint_columns.tolist()
            )
            moved = end.screws[:, :, chain.joint_columns]
        return end.T @ self.T_end_frame, self.at_frame(end, moved)

    def at_frame(self, end: EndPose, moved: Array) -> Array:
        """Return motions (N, 6, k) of the end of the chain as those of the frame's origin."""
        arm_m = (end.T[:, :3, :3] @ self.T_end_frame[:3, 3])[:, :, None]
        found: Array = moved.copy()
        found[:, :3] += np.cross(moved[:, 3:], arm_m, axis=1)
        return found

    def uncertainty_mm(self, states: PoseStates, end: EndPose) -> Array:
        """Return the standard uncertainty of the frame's position, (N,), from the covariance."""
        variance = np.trace(self.position_covariance(states, end), axis1=1, axis2=2)
        return np.asarray(1e3 * np.sqrt(np.maximum(variance, 0.0)))

    def unknown_arrival_mm(self, states: PoseStates) -> Array:
        """Return how far sides of arrival that are not given move the frame's position, (N,).

        A joint may come from either side: the prediction is the middle, and the standard deviation
        half the distance between both. Joints count as independent.
        """
        variance = np.zeros(len(states))
        ahead, behind = (
            replace(states, arrival=np.full_like(states.arrival, side)) for side in (1.0, -1.0)
        )
        if not any(self._shows_side(term, ahead, behind) for term in self.physical.terms):
            return variance
        for joint in range(states.n):
            rows = np.flatnonzero(states.arrival[:, joint] == 0.0)
            if not len(rows):
                continue
            at, ends = states.take(rows), []
            for side in (1.0, -1.0):
                arrival = at.arrival.copy()
                arrival[:, joint] = side
                ends.append(self.T_base_frame(self.states(replace(at, arrival=arrival))))
            apart_mm = 1e3 * (ends[0] - ends[1])[:, :3, 3]
            variance[rows] += 0.5**2 * (apart_mm**2).sum(axis=1)
        return np.sqrt(variance)

    def unknown_temperature_mm(self, given: PoseStates) -> Array:
        """Return how far temperatures that are not given move the frame's position, (N,).

        They are expected where those of the fit were: the prediction is at their mean, and the
        standard deviation half the distance between a standard deviation above and below.
        """
        found, fitted = np.zeros(len(given)), self.whole.fitted_to
        rows = np.flatnonzero(np.isnan(given.temperature_C))
        grows = any(term.depends_on == "temperature_C" for term in self.physical.terms)
        if not grows or not len(rows) or fitted is None or not fitted.temperature_std_C:
            return found
        at, ends = self.states(given.take(rows)), []
        for away_C in (fitted.temperature_std_C, -fitted.temperature_std_C):
            warm = replace(at, temperature_C=at.temperature_C + away_C)
            ends.append(self.T_base_frame(self.states(warm))[:, :3, 3])
        found[rows] = 1e3 * 0.5 * np.linalg.norm(ends[0] - ends[1], axis=1)
        return found

    def _shows_side(self, term: Term, ahead: PoseStates, behind: PoseStates) -> bool:
        """Return whether a term differs between both sides of arrival."""
        x = self.x[self.physical.columns_of(term)]
        pairs = [(term.shift(ahead, x), term.shift(behind, x))]
        if shows_torque(term):
            pairs.append((term.torque_Nm(ahead, x), term.torque_Nm(behind, x)))
        return any(not np.array_equal(one, other) for one, other in pairs)

    def position_covariance(self, states: PoseStates, end: EndPose) -> Array:
        """Return the covariance of the frame's position along base axes, (N, 3, 3) [m²]."""
        chain, terms = self.physical.chain, self.physical.terms
        maps = [term for term in terms if is_error_map(term)]
        others = tuple(term for term in terms if not is_error_map(term))
        dense = self.physical.parameter_indices(*others)
        without = Forward(
            self.whole, Model(chain, others), self.x[dense], dense, self.on_tool, self.T_end_frame
        )
        moved = without.by_parameters(states, end)[:, :3]
        turned = [
            MapMotion(
                self.physical.parameter_indices(term),
                states.q_rad[:, term.joint - 1],
                self.at_frame(end, end.screws[:, :, chain.columns(term.coordinates)])[:, :3, 0],
            )
            for term in maps
        ]
        dense = np.append(dense, len(self.x) + np.arange(6))
        return position_covariance(self.covariance, dense, moved, turned)

    def by_parameters(self, states: PoseStates, end: EndPose) -> Array:
        """Return motions of the frame by the parameters that move the robot and by the base.

        Returns:
            (N, 6, k) velocity of its origin over its angular velocity, along base axes.
        """
        by_x = self.physical.jacobian_at(states, self.x, end)
        by_base = end.screws[:, :, self.physical.chain.columns(BASE)]
        return self.at_frame(end, np.concatenate([by_x, by_base], axis=2))

    @property
    def covariance(self) -> Array:
        """Return the covariance (k, k) of these parameters; the model must have one."""
        covariance = self.whole.covariance
        assert covariance is not None
        chosen = np.concatenate([self.columns, len(self.whole.x) + np.arange(6)])
        own: Array = covariance[np.ix_(chosen, chosen)]
        return own

    def _coordinates(self, states: PoseStates) -> Array:
        return self.physical.chain_coordinates(states, self.x)


def predicted(model: Fitted, given: PoseStates, frame: str) -> Prediction:
    """Predict a frame in some states, under the weights described; see `FittedModel.predict`."""
    forward, q = Forward.of(model, frame), given.q_rad
    states = forward.states(given)
    if model.covariance is None:
        T, u_parameters_mm = forward.T_base_frame(states), np.full(len(q), np.nan)
    else:
        end = forward.end(states)
        T, u_parameters_mm = end.T @ forward.T_end_frame, forward.uncertainty_mm(states, end)
        u_parameters_mm = np.hypot(u_parameters_mm, forward.unknown_arrival_mm(states))
        u_parameters_mm = np.hypot(u_parameters_mm, forward.unknown_temperature_mm(given))
    u_mm = u_parameters_mm
    if model.discrepancy is not None:
        u_mm = np.hypot(u_mm, model.discrepancy.error_at_mm(q))
    found = Prediction(T, u_mm, u_parameters_mm, model.inside(q))
    if model.falls_back is None:
        return found
    away = predicted(model.falls_back.model, given, frame)
    within = model.falls_back.within
    outside = ~within.inside(q)
    # Effects that hold nowhere say nothing about where the robot was measured.
    inside = away.inside if within.nowhere else found.inside & ~outside
    return found.with_others(outside, T_base_away(model.falls_back, model) @ away.T, inside)


def T_base_away(away: FallBack, model: Fitted) -> Array:
    """Return the base of what a model falls back to, in the model's own base, (4, 4)."""
    T: Array = np.linalg.inv(model.T_instr_base) @ away.model.T_instr_base
    return T


def pose_difference(T: Array, T_wanted: Array) -> Array:
    """Return the motion (N, 6) from poses to others: of the origin, and about base axes [rad]."""
    R = T_wanted[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    sin = 0.5 * np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    size = np.linalg.norm(sin, axis=1)
    angle = np.arctan2(size, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    # Half a turn has no axis to be read off like this: any will do to leave it.
    sin[(size < _NO_TURN_RAD) & (angle > 1.0)] = [_NO_TURN_RAD, 0.0, 0.0]
    scale = np.where(angle > _NO_TURN_RAD, angle / np.maximum(size, _NO_TURN_RAD), 1.0)
    return np.hstack([T_wanted[:, :3, 3] - T[:, :3, 3], scale[:, None] * sin])


# Covariance of predicted positions, maps of joints by the few B-splines that each pose touches.
#
# A map has hundreds of knots, and every one of them moves every pose a little. In B-splines only
# four do: 10 000 poses then take a second, and no matrix of poses by knots is made.

#: Poses whose covariances of parameters are gathered at once (computing).
_AT_ONCE = 1000


@dataclass(frozen=True, eq=False)
class MapMotion:
    """What a map does to N poses."""

    columns: Index  # (K,) its knots among the parameters
    q_rad: Array  # (N,) the joint's angle
    moved: Array  # (N, 3) velocity of the position by the angle


def position_covariance(
    covariance: Array, dense: Index, moved: Array, maps: Sequence[MapMotion]
) -> Array:
    """Return the covariance of N positions, (N, 3, 3).

    Args:
        covariance: (k, k) of the parameters.
        dense: (d,) those that move poses by `moved`.
        moved: (N, 3, d) velocity of the position by each.
        maps: the other parameters.
    """
    order = np.concatenate([dense, *(each.columns for each in maps)])
    own, first = covariance[np.ix_(order, order)], len(dense)
    at: list[Index] = []
    by: list[Array] = []
    for each in maps:
        knots = len(each.columns)
        rows, to_splines = slice(first, first + knots), b_splines_by_knots(knots)
        own[rows] = to_splines @ own[rows]
        own[:, rows] = own[:, rows] @ to_splines.T
        splines = b_splines(knots, each.q_rad)
        at.append(first - len(dense) + splines.indices.astype(np.intp).reshape(-1, 4))
        by.append(each.moved[:, :, None] * splines.data.reshape(-1, 1, 4))
        first += knots
    d = len(dense)
    found = np.empty((len(moved), 3, 3))
    for start in range(0, len(moved), _AT_ONCE):
        block = slice(start, start + _AT_ONCE)
        with_all = moved[block] @ own[:d]  # (B, 3, k) with everything
        found[block] = with_all[:, :, :d] @ np.swapaxes(moved[block], 1, 2)
        if maps:
            touched = np.concatenate([each[block] for each in at], axis=1)
            velocity = np.concatenate([each[block] for each in by], axis=2)
            across = np.take_along_axis(with_all[:, :, d:], touched[:, None, :], axis=2)
            between = across @ np.swapaxes(velocity, 1, 2)
            of_pose = own[d + touched[:, :, None], d + touched[:, None, :]]
            of_maps = velocity @ of_pose @ np.swapaxes(velocity, 1, 2)
            found[block] += between + np.swapaxes(between, 1, 2) + of_maps
    return found


def T_flange_frame(model: Fitted, frame: str) -> Array:
    """Return where a frame is in the flange, unloaded, (4, 4) [m].

    Raises:
        ModelError: when the frame is unknown.
    """
    forward = Forward.of(model, frame)
    chain, at_flange = model.rigid_part()
    on_tool = replace(forward.whole, model=forward.physical, x=forward.x, covariance=None)
    at_end, tool = at_flange.copy(), chain.columns(TOOL)
    at_end[tool] = on_tool.rigid_part(tool=forward.on_tool)[1][tool]
    T_base_flange, T_base_end = end_pose(chain, np.stack([at_flange, at_end]))
    T: Array = np.linalg.inv(T_base_flange) @ T_base_end @ forward.T_end_frame
    return T
