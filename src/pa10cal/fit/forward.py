"""Forward kinematics of a fitted model's frames: position, derivatives and uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.chain import BASE, TOOL, EndPose, end_pose, end_pose_with_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted import FLANGE, TARGET, TOOL_FRAME, FallBack, Fitted, Prediction
from pa10cal.fit.loads import with_static_loads, with_torques
from pa10cal.fit.uncertain_weights import with_weights_by_log
from pa10cal.numerics.periodic_spline import MapMotion, position_covariance
from pa10cal.rules import LACK
from pa10cal.terms.effects.joint_error_map import JointErrorMap, is_error_map
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term, shows_torque, yields
from pa10cal.terms.wrapped import OF

#: Step of central differences of the terms by the joints [rad, m]: nine digits are right even for
#: harmonics as fine as a gear's (computing).
_STEP = 1e-6
#: Largest load over the heaviest of the fit: rounding of a unit (computing).
_SAME_LOAD = 1.0 + 1e-6
#: Smaller rotations have no axis [rad] (computing).
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
    """Return the states of N poses to be predicted, without torques; see `FittedModel.predict`.

    Args:
        q: (N, n) joint positions.
        arrival: of the axes that the controller counts; the states have that of the joints.
        temperature_C, time_s: None or nan where not given; the states have nan there.

    Raises:
        ModelError: when a load is negative, not finite, or heavier than any of the fit; when a
            temperature or time is infinite; when a direction of arrival is not -1, 0 or 1; or when
            there are not as many numbers as poses.
    """
    fitted, count = model.fitted_to, len(q)
    temperature_C = np.nan if temperature_C is None else temperature_C
    time_s = np.nan if time_s is None else time_s
    loads_N = _of_every_pose("load_N", load_N, (count,))
    temperatures_C = _of_every_pose("temperature_C", temperature_C, (count,))
    times_s = _of_every_pose("time_s", time_s, (count,))
    of_axes = _of_every_pose("arrival", arrival, (count, len(model.arm.axes_slide)))
    _refuse_infinite("temperature_C", temperatures_C)
    _refuse_infinite("time_s", times_s)
    _refuse_other_arrivals(of_axes)
    _refuse_unknown_loads(loads_N, () if fitted is None else fitted.loads_N, extrapolate)
    of_joints = model.arm.coupling.arrivals(of_axes)
    return PoseStates(q, np.full_like(q, np.nan), of_joints, loads_N, temperatures_C, times_s)


def _refuse_infinite(name: str, values: Array) -> None:
    """Refuse an infinite number; nan is one that is not known."""
    if np.isinf(values).any():
        row = int(np.argmax(np.isinf(values)))
        raise ModelError(
            "no finite number",
            where=f"{name} of pose {row + 1}",
            value=float(values[row]),
            allowed="a number; nan where it is not known",
            remedy="correct the value",
        )


def _refuse_other_arrivals(of_axes: Array) -> None:
    """Refuse what is no direction in which an axis arrived."""
    wrong_side = ~np.isin(of_axes, (-1.0, 0.0, 1.0))
    if wrong_side.any():
        row, joint = np.argwhere(wrong_side)[0]
        raise ModelError(
            "no direction of arrival",
            where=f"arrival of joint {joint + 1}, pose {row + 1}",
            value=float(of_axes[row, joint]),
            allowed="-1 or 1, the sign of the joint's last motion; 0 where it is not known",
            remedy="correct the value",
        )


def _refuse_unknown_loads(loads_N: Array, seen_N: Sequence[float], extrapolate: bool) -> None:
    """Refuse loads that are no weight, or heavier than all of a fit."""
    wrong = ~(loads_N >= 0.0) | ~np.isfinite(loads_N)
    if seen_N and not extrapolate:
        wrong |= loads_N > _SAME_LOAD * max(seen_N)
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    remedy = (
        "calibrate with this load too; or extrapolate (on the command line --force), which the "
        "uncertainty does not cover"
    )
    if not 0.0 <= loads_N[row] < np.inf:
        remedy = "give the weight of what hangs at the load point; no other force is computed"
    raise ModelError(
        "the model does not know this load",
        where=f"load_N of pose {row + 1}",
        value=float(loads_N[row]),
        allowed=f"0 to {max(seen_N):g} N, the heaviest load of its fit" if seen_N else "0 N on",
        remedy=remedy,
    )


def _of_every_pose(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a value given once or for every pose as an array of this shape; refuse others."""
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


def _with_payload_of(model: Fitted, campaign: str) -> Fitted:
    """Return a model under the payload of one campaign of a group, with weights by its log.

    Without a campaign, and for one without a payload of its own, it is that of the first.
    """
    carried = () if model.payload is None else model.payload.of_campaigns
    payload_of = dict(zip(model.R_first_target_of, carried, strict=False))
    payload = payload_of.get(campaign, model.payload)
    model = replace(model, payload=payload)
    weights = model.arm.weights_known
    logged = weights is not None and (weights.origin == "logged" or weights.by_log is not None)
    if payload is None or not logged or not any(map(yields, model.model.terms)):
        return model
    return with_weights_by_log(model, payload)


def _tool_in_end(model: Fitted, campaign: str) -> Array:
    """Return the frame (4, 4) of the tool in the end of the chain, as a campaign measured it."""
    T_end_tool = np.eye(4)
    T_end_tool[:3, :3] = model.R_ee_target @ model.R_first_target_of.get(campaign, np.eye(3))
    return np.asarray(model.T_end_shown @ T_end_tool)


@dataclass(frozen=True)
class Forward:
    """Forward kinematics of a frame of a fitted model."""

    whole: Fitted  # the fitted model
    physical: Model  # its terms that move the robot, without errors of instrument and torque log
    x: Array  # parameters of these
    columns: NDArray[np.intp]  # of these among the parameters of the whole model
    on_tool: bool  # whether the frame moves with the tool, at the chain's end, not with the flange
    T_end_frame: Array  # (4, 4) the frame in the end of the chain
    # (m,) its coordinates among those of the targets, or none: x, y and z
    at_target: NDArray[np.intp]

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
        of_frame = frame.partition(OF)[2]
        number = [*model.R_first_target_of, of_frame].index(of_frame) if of_frame else 0
        model = _with_payload_of(model, of_frame)
        # For a group `tool` is that of the first campaign that measured poses.
        tools = model.tools
        tool = tools.get(frame) or next(iter(tools.values()), None)
        on_tool = frame in tools or (frame == TOOL_FRAME and bool(tools or not model.target_names))

        def moves(term: Term) -> bool:
            """Return whether a term moves the frame in the base."""
            if not moves_robot(term) or not term.moves_in(number):
                return False
            if on_tool:
                return term not in tools.values() or term is tool
            # Positions of targets are constant in the flange, but move as the tool yields.
            of_tool = bool(term.coordinates) and set(term.coordinates) <= set(TOOL)
            return not of_tool or not (term.constant or frame == FLANGE)

        moving = [term for term in model.model.terms if moves(term)]
        columns = model.model.parameter_indices(*moving)
        T_end_frame, at_target = np.eye(4), np.zeros(0, np.intp)
        if on_tool:
            T_end_frame = _tool_in_end(model, "" if tool is None else tool.name)
        elif frame != FLANGE:
            name = frame.removeprefix(TARGET)
            row = model.target_names.index(name) if frame != TOOL_FRAME else 0
            at_target = 3 * row + np.arange(3)
            T_end_frame[:3, 3] = model.targets_m[at_target]
        # A term of one campaign acts in that campaign only; here it acts in every pose.
        terms = [term.term if term is tool else term for term in moving]
        physical = Model(model.model.chain, tuple(terms))
        return cls(model, physical, model.x[columns], columns, on_tool, T_end_frame, at_target)

    def states(self, given: PoseStates) -> PoseStates:
        """Return states with torques and loads by the weights; torques that were given are dropped.

        A temperature that is not given is the mean of the fit.

        Raises:
            ModelError: when the model has springs and the masses that load them are not known.
        """
        whole, payload, q = self.whole, self.whole.payload, given.q_rad
        temperature_C, fitted = given.temperature_C, whole.fitted_to
        if fitted is not None and fitted.temperature_C is not None:
            temperature_C = np.where(np.isnan(temperature_C), fitted.temperature_C, temperature_C)
        states = PoseStates(
            q, np.full_like(q, np.nan), given.arrival, given.load_N, temperature_C, given.time_s
        )
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
        # Effects bend by the loads in the posture of the arm that is bent by them.
        return with_static_loads(self.physical, self.x, states, payload)

    def T_base_frame(self, states: PoseStates) -> Array:
        """Return the frame in the base, (N, 4, 4) [m]."""
        T: Array = end_pose(self.physical.chain, self._coordinates(states)) @ self.T_end_frame
        return T

    def end(self, states: PoseStates) -> EndPose:
        """Return the end of the chain, which carries the frame, and its screws."""
        return end_pose_with_screws(self.physical.chain, self._coordinates(states))

    def by_joints(self, states: PoseStates, *, terms: bool) -> tuple[Array, Array]:
        """Return the frame in the base (N, 4, 4), and its derivative by the joints (N, 6, n).

        Args:
            terms: whether the derivative includes that of the terms, by angles and by weights; else
                it is that of the geometry alone, with an error of some per cent in a tenth of the
                time.
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
        lever_m = (end.T[:, :3, :3] @ self.T_end_frame[:3, 3])[:, :, None]
        of_frame: Array = moved.copy()
        of_frame[:, :3] += np.cross(moved[:, 3:], lever_m, axis=1)
        return of_frame

    def uncertainty_mm(self, states: PoseStates, end: EndPose) -> Array:
        """Return the standard uncertainty of the frame's position, (N,), from the covariance."""
        variance = np.trace(self.position_covariance(states, end), axis1=1, axis2=2)
        return np.asarray(1e3 * np.sqrt(np.maximum(variance, 0.0)))

    def unknown_arrival_mm(self, states: PoseStates) -> Array:
        """Return the standard uncertainty by directions of arrival that are not given, (N,).

        A joint may arrive from either side. The prediction is in the middle, and the standard
        uncertainty half the distance between both sides. Joints count as independent.
        """
        variance = np.zeros(len(states))
        ahead, behind = (
            replace(states, arrival=np.full_like(states.arrival, side)) for side in (1.0, -1.0)
        )
        if not any(self._depends_on_side(term, ahead, behind) for term in self.physical.terms):
            return variance
        for joint in range(states.n):
            rows = np.flatnonzero(states.arrival[:, joint] == 0.0)
            if not len(rows):
                continue
            of_rows, T_by_side = states.take(rows), []
            for side in (1.0, -1.0):
                arrival = of_rows.arrival.copy()
                arrival[:, joint] = side
                states_of_side = self.states(replace(of_rows, arrival=arrival))
                T_by_side.append(self.T_base_frame(states_of_side))
            apart_mm = 1e3 * (T_by_side[0] - T_by_side[1])[:, :3, 3]
            variance[rows] += 0.5**2 * (apart_mm**2).sum(axis=1)
        return np.sqrt(variance)

    def unknown_temperature_mm(self, given: PoseStates) -> Array:
        """Return the standard uncertainty by temperatures that are not given, (N,).

        They are assumed to be distributed as those of the fit. The prediction is at their mean, and
        the standard uncertainty half the distance between one standard deviation above and below.
        """
        u_mm, fitted = np.zeros(len(given)), self.whole.fitted_to
        rows = np.flatnonzero(np.isnan(given.temperature_C))
        depends = any(term.depends_on == "temperature_C" for term in self.physical.terms)
        if not depends or not len(rows) or fitted is None or not fitted.temperature_std_C:
            return u_mm
        at_mean, places_m = self.states(given.take(rows)), []
        for away_C in (fitted.temperature_std_C, -fitted.temperature_std_C):
            away = replace(at_mean, temperature_C=at_mean.temperature_C + away_C)
            places_m.append(self.T_base_frame(self.states(away))[:, :3, 3])
        u_mm[rows] = 1e3 * 0.5 * np.linalg.norm(places_m[0] - places_m[1], axis=1)
        return u_mm

    def beyond_maps_mm(self, states: PoseStates) -> Array:
        """Return the standard uncertainty by maps beyond the angles seen, (N,); 0 where seen."""
        variance_mm2, seen = np.zeros(len(states)), self.whole.seen
        # Errors of a sensor or a gear are periodic for sure, and have other names.
        maps = [
            term
            for term in self.physical.terms
            if is_error_map(term) and term.id == JointErrorMap.id
        ]
        if seen is None or not maps:
            return variance_mm2
        end = self.end(states)
        for term in maps:
            x = self.x[self.physical.columns_of(term)]
            joint = term.joint - 1
            away_rad = np.abs(seen.beyond(joint, states.q_rad[:, joint]))
            off_rad = term.most_change(x, seen.intervals[joint], away_rad)
            columns = self.physical.chain.columns(term.coordinates)
            screw = self.at_frame(end, end.screws[:, :, columns])
            variance_mm2 += (1e3 * off_rad) ** 2 * np.sum(screw[:, :3, 0] ** 2, axis=1)
        return np.sqrt(variance_mm2)

    def unmodelled_growth_mm(self, given: PoseStates, T_base_frame: Array) -> Array:
        """Return the standard uncertainty by temperatures unlike those of the fit, (N,).

        Links grow, and the frame moves in proportion to its distance from the base; 0 where a term
        of the model depends on temperature, or temperatures are not known.
        """
        fitted = self.whole.fitted_to
        depends = any(term.depends_on == "temperature_C" for term in self.physical.terms)
        if depends or fitted is None or fitted.temperature_C is None:
            return np.zeros(len(given))
        away_K = np.abs(np.nan_to_num(given.temperature_C - fitted.temperature_C))
        unseen_K = away_K - LACK.usual_temperatures * (fitted.temperature_std_C or 0.0)
        distance_mm = 1e3 * np.linalg.norm(T_base_frame[:, :3, 3], axis=1)
        return np.asarray(LACK.growth_per_K * np.maximum(unseen_K, 0.0) * distance_mm)

    def uncertain_joints_mm(self, states: PoseStates) -> Array:
        """Return the standard uncertainty by that of the joint positions, (N,): as in the fit.

        It is 0 where these were exact, as far as the campaign says.
        """
        fitted = self.whole.fitted_to
        if fitted is None or fitted.u_q_rad is None:
            return np.zeros(len(states))
        moved_m = self.by_joints(states, terms=False)[1][:, :3] * np.array(fitted.u_q_rad)
        return np.asarray(1e3 * np.sqrt(np.sum(moved_m**2, axis=(1, 2))))

    def _depends_on_side(self, term: Term, ahead: PoseStates, behind: PoseStates) -> bool:
        """Return whether a term differs between states of either direction of arrival."""
        x = self.x[self.physical.columns_of(term)]
        if not np.array_equal(term.shift(ahead, x), term.shift(behind, x)):
            return True
        if not shows_torque(term):
            return False
        return not np.array_equal(term.torque_Nm(ahead, x), term.torque_Nm(behind, x))

    def position_covariance(self, states: PoseStates, end: EndPose) -> Array:
        """Return the covariance of the frame's position along base axes, (N, 3, 3) [m²]."""
        chain, terms = self.physical.chain, self.physical.terms
        maps = [term for term in terms if is_error_map(term)]
        others = tuple(term for term in terms if not is_error_map(term))
        dense = self.physical.parameter_indices(*others)
        without = replace(
            self, physical=Model(chain, others), x=self.x[dense], columns=self.columns[dense]
        )
        moved = without.by_parameters(states, end)[:, :3]
        map_motions = []
        for term in maps:
            screw = self.at_frame(end, end.screws[:, :, chain.columns(term.coordinates)])
            columns = self.physical.parameter_indices(term)
            map_motions.append(MapMotion(columns, states.q_rad[:, term.joint - 1], screw[:, :3, 0]))
        covariance = self.covariance
        dense = np.append(dense, np.arange(len(self.x), len(covariance)))
        return position_covariance(covariance, dense, moved, map_motions)

    def by_parameters(self, states: PoseStates, end: EndPose) -> Array:
        """Return the derivative (N, 6, k) of the frame by what `covariance` is of.

        It is the velocity of the frame's origin over its angular velocity, along base axes.
        """
        by_x = self.physical.jacobian_at(states, self.x, end)
        by_base = end.screws[:, :, self.physical.chain.columns(BASE)]
        of_end = self.at_frame(end, np.concatenate([by_x, by_base], axis=2))
        if not len(self.at_target):
            return of_end
        by_target = np.concatenate([end.T[:, :3, :3], np.zeros((len(states), 3, 3))], axis=1)
        return np.concatenate([of_end, by_target], axis=2)

    @property
    def covariance(self) -> Array:
        """Return the covariance of x, the base, and the frame itself if it is a target.

        The model must have one.
        """
        covariance = self.whole.covariance
        assert covariance is not None
        assert len(covariance) == len(self.whole.x) + len(BASE) + len(self.whole.targets_m)
        base = len(self.whole.x) + np.arange(len(BASE))
        chosen = np.concatenate([self.columns, base, base[-1] + 1 + self.at_target])
        return np.asarray(covariance[np.ix_(chosen, chosen)])

    def _coordinates(self, states: PoseStates) -> Array:
        return self.physical.chain_coordinates(states, self.x)


def moves_robot(term: Term) -> bool:
    """Return whether a term moves the robot, and not only what instrument or log show of it."""
    return term.error_of in ("robot", "statement")


def predicted(model: Fitted, given: PoseStates, frame: str) -> Prediction:
    """Predict a frame in given states, under the weights described; see `FittedModel.predict`."""
    forward, q = Forward.of(model, frame), given.q_rad
    states = forward.states(given)
    if model.covariance is None:
        T, u_parameters_mm = forward.T_base_frame(states), np.full(len(q), np.nan)
    else:
        end = forward.end(states)
        T, u_parameters_mm = end.T @ forward.T_end_frame, forward.uncertainty_mm(states, end)
        u_parameters_mm = np.hypot(u_parameters_mm, forward.unknown_arrival_mm(states))
        u_parameters_mm = np.hypot(u_parameters_mm, forward.unknown_temperature_mm(given))
    u_mm = np.hypot(u_parameters_mm, forward.beyond_maps_mm(states))
    if model.discrepancy is not None:
        u_mm = np.hypot(u_mm, model.discrepancy.error_at_mm(q))
    u_mm = np.hypot(u_mm, forward.uncertain_joints_mm(states))
    u_mm = np.hypot(u_mm, forward.unmodelled_growth_mm(given, T))
    if model.otherwise is not None:
        apart_mm = _apart_mm(forward, Forward.of(model.otherwise.model, frame), given, T)
        u_mm = np.hypot(u_mm, np.sqrt(model.otherwise.probability) * apart_mm)
    prediction = Prediction(T, u_mm, u_parameters_mm, model.inside(q))
    if model.falls_back is None:
        return prediction
    other = predicted(model.falls_back.model, given, frame)
    within = model.falls_back.within
    outside = ~within.inside(q)
    # Where effects hold nowhere, `within` is empty whatever poses were measured.
    inside = other.inside if within.nowhere else prediction.inside & ~outside
    T_other = T_base_away(model.falls_back, model) @ other.T
    return prediction.with_others(outside, T_other, inside)


def _apart_mm(forward: Forward, other: Forward, given: PoseStates, T: Array) -> Array:
    """Return how far another model is from predictions T (N, 4, 4) of a model, (N,).

    Where it depends on directions of arrival that are not given, and the model does not, it is on
    either side of its prediction. Beside a false reading the base is elsewhere, too.
    """
    T_other = other.T_base_frame(other.states(given))
    if any(term.error_of == "readings" for term in forward.whole.model.terms):
        T_other = np.linalg.inv(forward.whole.T_instr_base) @ other.whole.T_instr_base @ T_other
    apart_m = (T_other - T)[:, :3, 3]
    own_mm, by_side_mm = (each.unknown_arrival_mm(each.states(given)) for each in (forward, other))
    further_mm2 = np.maximum(by_side_mm**2 - own_mm**2, 0.0)
    return np.asarray(np.sqrt(1e6 * (apart_m**2).sum(axis=1) + further_mm2))


def T_base_away(fall_back: FallBack, model: Fitted) -> Array:
    """Return the base of the model that a model falls back to, in the model's own, (4, 4)."""
    return np.asarray(np.linalg.inv(model.T_instr_base) @ fall_back.model.T_instr_base)


def pose_difference(T: Array, T_wanted: Array) -> Array:
    """Return the motion (N, 6) from poses to wanted ones: translation [m], rotation vector [rad].

    Both are along base axes.
    """
    R = T_wanted[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    sin = 0.5 * np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    size = np.linalg.norm(sin, axis=1)
    angle = np.arctan2(size, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    # At half a turn the sine vanishes, and with it the axis: any axis leads away from there.
    sin[(size < _NO_TURN_RAD) & (angle > 1.0)] = [_NO_TURN_RAD, 0.0, 0.0]
    scale = np.where(angle > _NO_TURN_RAD, angle / np.maximum(size, _NO_TURN_RAD), 1.0)
    return np.hstack([T_wanted[:, :3, 3] - T[:, :3, 3], scale[:, None] * sin])


def T_flange_frame(model: Fitted, frame: str) -> Array:
    """Return the pose of a frame in the flange, unloaded, (4, 4) [m].

    Raises:
        ModelError: when the frame is unknown.
    """
    forward = Forward.of(model, frame)
    chain, at_flange = model.rigid_part()
    physical = replace(forward.whole, model=forward.physical, x=forward.x, covariance=None)
    at_end, tool = at_flange.copy(), chain.columns(TOOL)
    at_end[tool] = physical.rigid_part(tool=forward.on_tool)[1][tool]
    T_base_flange, T_base_end = end_pose(chain, np.stack([at_flange, at_end]))
    return np.asarray(np.linalg.inv(T_base_flange) @ T_base_end @ forward.T_end_frame)
