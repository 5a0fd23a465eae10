"""Differences of the parameters of two fitted models of one arm, and the covariance of these.

Springs are restated at the same reference torque, and tools compared by their whole orientation.
Both models are taken on condition that departures which only one of them has are zero. The
covariance of a `FittedModel` is that of its k parameters, and of six small motions of the base
after them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.errors import ModelError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.rules import COMPARED
from pa10cal.terms.offsets import is_tool, motion_of_base, small_motion
from pa10cal.terms.term import Term, TermParameter

#: Fields of an arm that define its rigid kinematics: those of each row, and its constant frames.
_LAYOUT = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
_FRAMES = ("T_base_row1", "T_row_n_ee")
#: Least share of a variance along a direction that counts as not zero (computing).
_NO_VARIANCE = 1e-12


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
        differs += [
            name
            for name in _FRAMES
            if not np.allclose(
                getattr(one, name), getattr(other, name), rtol=COMPARED.same, atol=COMPARED.same
            )
        ]
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


@dataclass(frozen=True, eq=False)
class Differences:
    """What two models differ by, in the parameters that both have."""

    terms: tuple[Term, ...]  # of the arm, those of the first model that the second has too
    x: Array  # (s,) their parameters in the first model
    # (k,) second less first: those s; the tool, or positions of targets [m] where there is no tool;
    # the six motions of the base
    values: Array
    covariance: Array  # (k, k) expected of `values`
    # which of the k are of the tool or the targets, and which of the base
    tool_or_targets: Index
    base: Index

    @property
    def parameters(self) -> list[TermParameter]:
        """Return the arm's parameters (s,)."""
        return [parameter for term in self.terms for parameter in term.parameters]


@dataclass(frozen=True, eq=False)
class _Part:
    """Differences of p parameters: of a term of the arm, of the tool, or of the base."""

    values: Array  # (p,) second less first
    # (p,) which parameters they are in the first and in the second model
    in_first: Index
    in_second: Index
    # (p, p) derivative of the second model's parameters, as the first has them, by its own
    restated: Array


def differences(first: FittedModel, second: FittedModel) -> Differences:
    """Return what two models, both with a covariance, differ by."""
    only_first, only_second = _free_only_in(first, second), _free_only_in(second, first)
    first, second = _with_zero(first, only_first), _with_zero(second, only_second)
    of_arm = _arm_differences(first, second)
    terms = tuple(term for term, _ in of_arm)
    tool, base = _tool_difference(first, second), _base_difference(first, second)
    targets_m = np.zeros(0) if len(tool.values) else _target_differences(first, second)
    arm_count = sum(len(part.values) for _, part in of_arm)
    frame_count = len(tool.values) + len(targets_m)
    covariance = _covariance(first, second, [*(part for _, part in of_arm), tool, base])
    return Differences(
        terms=terms,
        x=np.concatenate([np.zeros(0), *(first.x[part.in_first] for _, part in of_arm)]),
        values=np.concatenate(
            [*(part.values for _, part in of_arm), tool.values, targets_m, base.values]
        ),
        covariance=_with_targets(covariance, arm_count, len(targets_m)),
        tool_or_targets=arm_count + np.arange(frame_count),
        base=arm_count + frame_count + np.arange(len(BASE)),
    )


def _free_only_in(model: FittedModel, other: FittedModel) -> Index:
    """Return the indices of departures of a model that the other one does not have."""
    of_other = {parameter.name for parameter in other.model.parameters}
    held = [parameter.name not in of_other for parameter in model.model.parameters]
    return np.flatnonzero(model.model.having("link", "zero", "tilt") & np.array(held, bool))


def _with_zero(model: FittedModel, held: Index) -> FittedModel:
    """Return a model on condition that its departures `held` (h,) are zero.

    Of the normal distribution of its parameters and of the base's motions: with covariance C the
    others move by -C_oh C_hh^-1 x_h, and their covariance becomes C_oo - C_oh C_hh^-1 C_ho. A
    departure without variance stays as it is.
    """
    covariance = model.covariance
    assert covariance is not None
    held = held[np.diag(covariance)[held] > 0.0]
    if not len(held):
        return model
    size = np.sqrt(np.diag(covariance)[held])
    correlation = covariance[np.ix_(held, held)] / np.outer(size, size)
    # Departures that are functions of others are conditioned by these already.
    inverse = np.linalg.pinv(correlation, rcond=_NO_VARIANCE, hermitian=True)
    by_held = covariance[:, held] @ (inverse / np.outer(size, size))
    step = -by_held @ model.x[held]
    return replace(
        model,
        x=model.x + step[: len(model.x)],
        T_instr_base=model.T_instr_base @ motion_of_base(step[len(model.x) :]),
        covariance=covariance - by_held @ covariance[held],
    )


def _arm_differences(first: FittedModel, second: FittedModel) -> list[tuple[Term, _Part]]:
    """Return the terms of the arm that both models have, and what they differ by.

    A term that is constant adds each of its parameters to a coordinate of the chain, so those that
    both models have are compared. The parameters of any other term have a meaning only together: it
    is left out where they differ, such as a spring that is cubic in one model alone. So are
    weights: they count from those described, of the tool of each campaign among them.
    """
    found = []
    of_second = {(term.id, term.of): term for term in second.model.terms}
    for term in first.model.terms:
        other = of_second.get((term.id, term.of))
        if other is None or "weight" in term.roles or is_tool(term) or not term.stays_with_arm:
            continue
        in_first = first.model.parameter_indices(term)
        in_second = second.model.parameter_indices(other)
        if term.constant:
            names = [parameter.name for parameter in other.parameters]
            common = [k for k, parameter in enumerate(term.parameters) if parameter.name in names]
            in_other = [names.index(term.parameters[k].name) for k in common]
            in_first, in_second = in_first[common], in_second[in_other]
            term = term.only({term.parameters[k].name for k in common})
        elif term.parameters != other.parameters:
            continue
        x_second, restated = term.restated(other, second.x[in_second])
        part = _Part(x_second - first.x[in_first], in_first, in_second, restated)
        found.append((term, part))
    return found


def _tool_difference(first: FittedModel, second: FittedModel) -> _Part:
    """Return the difference of the tool's position [m] and orientation [rad].

    Only of coordinates that both models have; empty where one has no tool, or one for each
    campaign. A tool's rotations are Euler angles about `R_ee_target`, where the fit of that model
    began, so whole orientations are compared. The difference is a rotation vector along axes of the
    end-effector, and stands for that of the angles, which are small.
    """
    places_m, orientations, indices_of = [], [], []
    for model in (first, second):
        term = next((term for term in model.model.terms if is_tool(term)), None)
        if term is None or term.holds == "campaign":
            none = np.zeros(0, dtype=np.intp)
            return _Part(np.zeros(0), none, none, np.eye(0))
        indices = model.model.parameter_indices(term)
        values = dict(zip(term.coordinates, model.x[indices], strict=True))
        motion = np.array([values.get(name, 0.0) for name in TOOL])
        turn = Rotation.from_euler("XYZ", motion[3:])
        places_m.append(motion[:3])
        orientations.append(turn * Rotation.from_matrix(model.R_ee_target))
        indices_of.append(dict(zip(term.coordinates, indices, strict=True)))
    turned_rad = (orientations[1] * orientations[0].inv()).as_rotvec()
    difference = np.concatenate([places_m[1] - places_m[0], turned_rad])
    common = [k for k, name in enumerate(TOOL) if all(name in each for each in indices_of)]
    in_first, in_second = (
        np.array([each[TOOL[k]] for k in common], dtype=np.intp) for each in indices_of
    )
    return _Part(difference[common], in_first, in_second, np.eye(len(common)))


def _base_difference(first: FittedModel, second: FittedModel) -> _Part:
    """Return the six small motions of the base from the first model to the second [m, rad]."""
    motion = small_motion(np.linalg.inv(first.T_instr_base) @ second.T_instr_base)
    six = np.arange(len(BASE))
    return _Part(motion, len(first.x) + six, len(second.x) + six, np.eye(len(BASE)))


def _target_differences(first: FittedModel, second: FittedModel) -> Array:
    """Return the differences of targets that both models name, x, y, z of each [m]."""
    in_first, in_second = (
        dict(zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True))
        for model in (first, second)
    )
    common = [name for name in in_first if name in in_second]
    return np.concatenate([np.zeros(0), *(in_second[name] - in_first[name] for name in common)])


def _covariance(first: FittedModel, second: FittedModel, parts: list[_Part]) -> Array:
    """Return the covariance of the differences of these parts: the sum of both models'."""
    assert first.covariance is not None
    assert second.covariance is not None
    in_first = np.concatenate([part.in_first for part in parts])
    in_second = np.concatenate([part.in_second for part in parts])
    restated = block_diag(*(part.restated for part in parts))
    of_second = restated @ second.covariance[np.ix_(in_second, in_second)] @ restated.T
    return np.asarray(first.covariance[np.ix_(in_first, in_first)] + of_second)


def _with_targets(covariance: Array, arm_count: int, target_count: int) -> Array:
    """Return a covariance with `target_count` coordinates of targets after those of the arm.

    A model does not keep their covariance. They are assumed to be known better than the base, which
    is further away: its largest variance of a position stands for theirs. A target that was seen in
    few poses may be known worse; then its noise may pass for a tool that moved.
    """
    targets = arm_count + np.arange(target_count)
    whole = np.zeros((len(covariance) + target_count,) * 2)
    others = np.delete(np.arange(len(whole)), targets)
    whole[np.ix_(others, others)] = covariance
    whole[targets, targets] = np.diag(covariance)[-6:-3].max()
    return whole
