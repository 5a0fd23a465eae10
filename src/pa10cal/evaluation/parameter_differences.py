"""Differences of the parameters of two fitted models of one arm, and the covariance of these.

Springs are restated at the same reference torque, and tools compared by their whole orientation.
Both models are taken on condition that departures which only one of them has are zero. What cannot
be compared is listed. The covariance of a `FittedModel` is that of its k parameters, and of six
small motions of the base after them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.errors import ModelError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.covariances import precision_of
from pa10cal.rules import COMPARED
from pa10cal.terms.effects.effect import is_effect
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.offsets import (
    base_frame,
    is_tool,
    motion_of_base,
    small_motion,
    tool_frame,
)
from pa10cal.terms.term import Term, TermParameter

#: Fields of an arm that define its rigid kinematics: those of each row, and its constant frames.
_LAYOUT = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
_FRAMES = ("T_base_row1", "T_row_n_ee")
#: What the tool and targets of a model are called where they are not compared.
_END = "tool or targets"
#: Size of a difference of targets [m] (unit).
_TARGET_SCALE_M = 1e-3


def refuse_other_layout(one: Arm, other: Arm, names: tuple[str, str]) -> None:
    """Raise ModelError when two arms differ in their nominal layout, naming the models."""
    differs = [
        f"{word}: {getattr(one, name)!r} and {getattr(other, name)!r}"
        for word, name in (("joints", "n"), ("convention", "convention"))
        if getattr(one, name) != getattr(other, name)
    ]
    if not differs:
        for name in _LAYOUT:
            mine, theirs = (np.asarray(getattr(arm, name), dtype=float) for arm in (one, other))
            differs += [
                f"{name} of row {row + 1}: {mine[row]:g} and {theirs[row]:g}"
                for row in np.flatnonzero(~(np.abs(mine - theirs) <= COMPARED.same))
            ]
        for name in _FRAMES:
            T_one, T_other = getattr(one, name), getattr(other, name)
            if not np.allclose(T_one, T_other, rtol=COMPARED.same, atol=COMPARED.same):
                differs.append(f"{name}: {_apart(T_one, T_other)}")
    if differs:
        more = f", and {len(differs) - 3} more" if len(differs) > 3 else ""
        where = f"{names[0]} ({one.name}), {names[1]} ({other.name})"
        raise ModelError(
            "models of arms of different layouts are not compared",
            where=where,
            value="; ".join(differs[:3]) + more,
            allowed="two models of the same arm",
            remedy="give two models whose nominal rows are the same",
        )


def _apart(T_one: Array, T_other: Array) -> str:
    """Return the distance between two frames (4, 4) [m], and the turn between them, in words."""
    distance_mm = 1e3 * float(np.linalg.norm(T_other[:3, 3] - T_one[:3, 3]))
    turn_deg = np.degrees(Rotation.from_matrix(T_one[:3, :3].T @ T_other[:3, :3]).magnitude())
    return f"{distance_mm:.4g} mm and {turn_deg:.4g} deg apart"


@dataclass(frozen=True, eq=False)
class Differences:
    """What two models differ by: k values, of the arm, of tool or targets, and of the base."""

    terms: tuple[Term, ...]  # of the arm, those of the first model that the second has too
    x: Array  # (s,) their parameters in the first model
    # (k,) of which parameters: those s; the tool's, or positions of targets [m] where there is no
    # tool; the six motions of the base
    parameters: tuple[TermParameter, ...]
    values: Array  # (k,) second less first
    covariance: Array  # (k, k) expected of `values`; zero where both models have no uncertainty
    # which of the k are of the tool or the targets, and which of the base
    tool_or_targets: Index
    base: Index
    only_in_one: tuple[str, ...]  # springs and effects that one of the models has alone
    # what may have changed unseen: springs and effects that both models have in unlike forms, tool
    # or targets that only one of them has, and parameters that differ and have no uncertainty
    not_compared: tuple[str, ...]

    @property
    def of_arm(self) -> slice:
        """Return which of the k are of the arm: the first s."""
        return slice(0, len(self.x))


@dataclass(frozen=True, eq=False)
class _Part:
    """Differences of p parameters: of a term of the arm, of the tool or targets, or of the base."""

    parameters: tuple[TermParameter, ...]  # (p,) as the first model has them
    values: Array  # (p,) second less first
    # (p,) which they are in the covariance of the first and of the second model
    in_first: Index
    in_second: Index
    # (p, p) derivative of the second model's parameters, as the first has them, by its own
    restated: Array


def differences(first: FittedModel, second: FittedModel) -> Differences:
    """Return what two models, both with a covariance, differ by."""
    only_first, only_second = _departures_only_in(first, second), _departures_only_in(second, first)
    never_zero = {*_nonzero_held(first, only_first), *_nonzero_held(second, only_second)}
    first, second = _with_zero(first, only_first), _with_zero(second, only_second)
    common = _common_terms(first, second)
    of_arm = [_term_difference(first, second, *pair) for pair in common]
    end, base = _tool_difference(first, second), _base_difference(first, second)
    if not end.parameters:
        end = _target_difference(first, second)
    parts = [*of_arm, end, base]
    arm_count, end_count = sum(len(part.values) for part in of_arm), len(end.values)
    parameters = tuple(parameter for part in parts for parameter in part.parameters)
    values = np.concatenate([part.values for part in parts])
    covariance = _covariance(first, second, parts)
    not_compared = never_zero | _in_unlike_forms(first, second)
    not_compared |= _differ_without_uncertainty(parameters, values, covariance)
    if not end_count and (_has_end(first) or _has_end(second)):
        not_compared.add(_END)
    return Differences(
        terms=tuple(_common_part(*pair) for pair in common),
        x=np.concatenate([np.zeros(0), *(first.x[part.in_first] for part in of_arm)]),
        parameters=parameters,
        values=values,
        covariance=covariance,
        tool_or_targets=arm_count + np.arange(end_count),
        base=arm_count + end_count + np.arange(len(BASE)),
        only_in_one=tuple(sorted(_springs_and_effects(first) ^ _springs_and_effects(second))),
        not_compared=tuple(sorted(not_compared)),
    )


# Departures that one model has alone, and the other holds at zero.


def _departures_only_in(model: FittedModel, other: FittedModel) -> Index:
    """Return the indices of departures of a model that the other one does not have."""
    of_other = {parameter.name for parameter in other.model.parameters}
    alone = [parameter.name not in of_other for parameter in model.model.parameters]
    return np.flatnonzero(model.model.having("link", "zero", "tilt") & np.array(alone, bool))


def _with_zero(model: FittedModel, departures: Index) -> FittedModel:
    """Return a model on condition that some of its departures (h,) are zero.

    Of the normal distribution of its parameters and of the base's motions: with covariance C the
    others move by -C_oh C_hh^-1 x_h, and their covariance becomes C_oo - C_oh C_hh^-1 C_ho. Those
    without variance are not conditioned on: see `_nonzero_held`.
    """
    covariance = model.covariance
    assert covariance is not None
    free = departures[np.diag(covariance)[departures] > 0.0]
    if not len(free):
        return model
    # Departures that are functions of others are conditioned by these already.
    by_free = covariance[:, free] @ precision_of(covariance[np.ix_(free, free)])
    step, frames = -by_free @ model.x[free], len(model.x) + len(BASE)
    return replace(
        model,
        x=model.x + step[: len(model.x)],
        T_instr_base=model.T_instr_base @ motion_of_base(step[len(model.x) : frames]),
        targets_m=model.targets_m + step[frames:],
        covariance=covariance - by_free @ covariance[free],
    )


def _nonzero_held(model: FittedModel, departures: Index) -> set[str]:
    """Return the names of those departures that are not zero and have no variance.

    Nothing says how the other parameters would be if these were zero.
    """
    assert model.covariance is not None
    held = departures[(np.diag(model.covariance)[departures] <= 0.0) & (model.x[departures] != 0.0)]
    return {model.model.parameters[k].name for k in held.tolist()}


# Terms of the arm: links, springs and effects.


def _of_arm(model: FittedModel) -> list[Term]:
    """Return the terms of the arm as it is built.

    Without weights: they count from those described, of the tool of each campaign among them.
    """
    return [
        term
        for term in model.model.terms
        if term.stays_with_arm and "weight" not in term.roles and not is_tool(term)
    ]


def _common_terms(first: FittedModel, second: FittedModel) -> list[tuple[Term, Term]]:
    """Return the terms of the arm that both models have, each as either has it."""
    of_second = _of_arm(second)
    return [(term, other) for term in _of_arm(first) for other in of_second if term.same_as(other)]


def _in_unlike_forms(first: FittedModel, second: FittedModel) -> set[str]:
    """Return the terms that both models have, in forms whose parameters mean different things."""
    common = _common_terms(first, second)
    unmatched_first = {_name(term) for term in _of_arm(first)} - {_name(one) for one, _ in common}
    return unmatched_first & {_name(term) for term in _of_arm(second)}


def _springs_and_effects(model: FittedModel) -> set[str]:
    return {_name(term) for term in model.model.terms if is_effect(term) or is_spring(term)}


def _name(term: Term) -> str:
    return f"{term.id} of {term.of}"


def _common_part(term: Term, other: Term) -> Term:
    """Return a term with the parameters alone that it is compared in.

    A constant term adds each of its parameters to a coordinate of the chain, so those that both
    models have are compared. The parameters of any other term have a meaning only together.
    """
    if not term.constant:
        return term
    return term.only({parameter.name for parameter in other.parameters})


def _term_difference(first: FittedModel, second: FittedModel, term: Term, other: Term) -> _Part:
    """Return the difference of one term of the arm, as either model has it."""
    names = [[parameter.name for parameter in each.parameters] for each in (term, other)]
    compared = _common_part(term, other).parameters
    in_first, in_second = (
        model.model.parameter_indices(each)[[own.index(parameter.name) for parameter in compared]]
        for model, each, own in zip((first, second), (term, other), names, strict=True)
    )
    x_second, restated = term.restated(other, second.x[in_second])
    return _Part(compared, x_second - first.x[in_first], in_first, in_second, restated)


# Tool, targets and base, which each campaign has of its own.


def _tool_difference(first: FittedModel, second: FittedModel) -> _Part:
    """Return the difference of the tool's position [m] and orientation [rad].

    Only of coordinates that both models have; empty where one has no tool, or one for each
    campaign. A tool's rotations are Euler angles about `R_ee_target`, where the fit of that model
    began, so whole orientations are compared. The difference is a rotation vector along axes of the
    end-effector, and stands for that of the angles, which are small.
    """
    one, other = _tool_of(first), _tool_of(second)
    if one is None or other is None:
        none = np.zeros(0, dtype=np.intp)
        return _Part((), np.zeros(0), none, none, np.eye(0))
    turned_rad = (other.orientation * one.orientation.inv()).as_rotvec()
    difference = np.concatenate([other.position_m - one.position_m, turned_rad])
    common = [k for k, name in enumerate(TOOL) if name in one.index and name in other.index]
    in_first, in_second = (
        np.array([tool.index[TOOL[k]] for k in common], dtype=np.intp) for tool in (one, other)
    )
    parameters = tuple(tool_frame().parameters[k] for k in common)
    return _Part(parameters, difference[common], in_first, in_second, np.eye(len(common)))


@dataclass(frozen=True, eq=False)
class _Tool:
    """The tool of a model, one for all its poses."""

    position_m: Array  # (3,) its departure from the end of the chain
    orientation: Rotation  # in the end-effector
    index: dict[str, int]  # index of its parameters in the model, by coordinates of the chain


def _tool_of(model: FittedModel) -> _Tool | None:
    """Return the tool of a model; None where it has none, or one for each campaign."""
    term = next((term for term in model.model.terms if is_tool(term)), None)
    if term is None or term.holds == "campaign":
        return None
    index = dict(zip(term.coordinates, model.model.parameter_indices(term).tolist(), strict=True))
    motion = np.array([model.x[index[name]] if name in index else 0.0 for name in TOOL])
    turn = Rotation.from_euler("XYZ", motion[3:])
    return _Tool(motion[:3], turn * Rotation.from_matrix(model.R_ee_target), index)


def _has_end(model: FittedModel) -> bool:
    """Return whether a model has a tool, or targets."""
    return len(model.targets_m) > 0 or any(is_tool(term) for term in model.model.terms)


def _base_difference(first: FittedModel, second: FittedModel) -> _Part:
    """Return the six small motions of the base from the first model to the second [m, rad]."""
    motion = small_motion(np.linalg.inv(first.T_instr_base) @ second.T_instr_base)
    six = np.arange(len(BASE))
    parameters = base_frame().parameters
    return _Part(parameters, motion, len(first.x) + six, len(second.x) + six, np.eye(len(BASE)))


def _target_difference(first: FittedModel, second: FittedModel) -> _Part:
    """Return the differences of x, y and z of the targets that both models name [m]."""
    in_first, in_second = (
        dict(zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True))
        for model in (first, second)
    )
    common = [name for name in in_first if name in in_second]
    parameters = tuple(
        TermParameter(f"target_{name}_{axis}", "m", _TARGET_SCALE_M)
        for name in common
        for axis in "xyz"
    )
    by_m = [in_second[name] - in_first[name] for name in common]
    of_first, of_second = (_target_columns(model, common) for model in (first, second))
    values = np.concatenate([np.zeros(0), *by_m])
    return _Part(parameters, values, of_first, of_second, np.eye(len(values)))


def _target_columns(model: FittedModel, names: Sequence[str]) -> Index:
    """Return which coordinates of targets are in a model's covariance, three for each name."""
    rows = np.array([model.target_names.index(name) for name in names], dtype=np.intp)
    columns = len(model.x) + len(BASE) + 3 * rows[:, None] + np.arange(3)
    return np.asarray(columns.ravel())


# Covariance of the differences.


def _differ_without_uncertainty(
    parameters: Sequence[TermParameter], values: Array, covariance: Array
) -> set[str]:
    """Return the names of parameters (k,) that differ, and of which neither model has a variance.

    The base's are none of them: readings that do not show the base in some direction leave it as it
    was described.
    """
    count = len(values) - len(BASE)
    scale = np.array([parameter.scale for parameter in parameters[:count]])
    differ = np.abs(values[:count]) > COMPARED.same * scale
    unknown = np.diag(covariance)[:count] <= 0.0
    return {parameters[k].name for k in np.flatnonzero(differ & unknown).tolist()}


def _covariance(first: FittedModel, second: FittedModel, parts: list[_Part]) -> Array:
    """Return the covariance of the differences that the models' contain: the sum of both."""
    assert first.covariance is not None
    assert second.covariance is not None
    in_first = np.concatenate([part.in_first for part in parts])
    in_second = np.concatenate([part.in_second for part in parts])
    restated = block_diag(*(part.restated for part in parts))
    of_second = restated @ second.covariance[np.ix_(in_second, in_second)] @ restated.T
    return np.asarray(first.covariance[np.ix_(in_first, in_first)] + of_second)
