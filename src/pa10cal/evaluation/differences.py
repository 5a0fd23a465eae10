"""Differences of two fitted models of one arm, and the covariance expected of them.

Springs are restated at the same reference torque, tools compared by their whole orientation; a
departure that one model holds at zero is held in the other too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import TOOL
from pa10cal.arrays import Array, Index
from pa10cal.calibration.general.placed import is_tool
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.of_campaign import motion_of_base, small_motion
from pa10cal.terms.term import Term, TermParameter

#: Least share of a variance along a direction that counts as not zero (computing).
_NO_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Differences:
    """What two models differ by, in the parameters that both have."""

    terms: tuple[Term, ...]  # of the arm, those of the first model that the second has too
    x: Array  # (s,) their parameters in the first model
    # (k,) second less first: those s, then the tool, the six motions of the base, and positions of
    # targets where there is no tool
    by: Array
    covariance: Array  # (k, k) expected of these
    tool: Index  # columns of the tool or the targets
    base: Index  # columns of the base

    @property
    def parameters(self) -> list[TermParameter]:
        """Return the arm's parameters."""
        return [parameter for term in self.terms for parameter in term.parameters]


@dataclass(frozen=True, eq=False)
class _TermDifference:
    """A term of the arm in two models."""

    term: Term  # that of the first model, with the parameters that both have
    # indices_1 and indices_2: (k,) of these parameters in the first and second model
    indices_1: Index
    indices_2: Index
    by: Array  # (k,) second less first
    # (k, k) derivative of the second model's parameters, as the first has them, by its own
    restated: Array


def differences(first: FittedModel, second: FittedModel) -> Differences:
    """Return what two models differ by."""
    first, second = (
        _with_zero(first, _held_in(second, first)),
        _with_zero(second, _held_in(first, second)),
    )
    assert first.covariance is not None
    assert second.covariance is not None
    of_arm = _arm_differences(first, second)
    none = np.zeros(0, dtype=np.intp)
    arm_1 = np.concatenate([none, *(each.indices_1 for each in of_arm)])
    arm_2 = np.concatenate([none, *(each.indices_2 for each in of_arm)])
    tool_by, tool_1, tool_2 = _tool_difference(first, second)
    base_1, base_2 = len(first.x) + np.arange(6), len(second.x) + np.arange(6)
    base_by = small_motion(np.linalg.inv(first.T_instr_base) @ second.T_instr_base)
    in_1, in_2 = np.concatenate([arm_1, tool_1, base_1]), np.concatenate([arm_2, tool_2, base_2])
    C_1, C_2 = first.covariance[np.ix_(in_1, in_1)], second.covariance[np.ix_(in_2, in_2)]
    restated = block_diag(*(each.restated for each in of_arm), np.eye(len(C_2) - len(arm_2)))
    covariance = C_1 + restated @ C_2 @ restated.T
    targets_m = np.zeros(0) if len(tool_by) else _target_differences(first, second)
    # The covariance of targets is not kept. They are known better than the base, which is further
    # away: its largest variance of a position stands for theirs.
    target_variance = np.diag(covariance)[-6:-3].max()
    covariance = block_diag(covariance, target_variance * np.eye(len(targets_m)))
    frames = np.arange(len(arm_1), len(C_1))
    return Differences(
        terms=tuple(each.term for each in of_arm),
        x=first.x[arm_1],
        by=np.concatenate([*(each.by for each in of_arm), tool_by, base_by, targets_m]),
        covariance=covariance,
        tool=frames[: len(tool_by)] if len(tool_by) else np.arange(len(C_1), len(covariance)),
        base=frames[-6:],
    )


def _arm_differences(first: FittedModel, second: FittedModel) -> list[_TermDifference]:
    """Return the terms that stay with the arm and that both models have; no weights, no tool."""
    found = []
    of_second = {(term.id, term.of): term for term in second.model.terms}
    for term in first.model.terms:
        other = of_second.get((term.id, term.of))
        if other is None or "weight" in term.roles or is_tool(term) or not term.stays_with_arm:
            continue
        indices_1 = first.model.parameter_indices(term)
        indices_2 = second.model.parameter_indices(other)
        if term.constant:
            names = [parameter.name for parameter in other.parameters]
            common = [k for k, parameter in enumerate(term.parameters) if parameter.name in names]
            in_other = [names.index(term.parameters[k].name) for k in common]
            indices_1, indices_2 = indices_1[common], indices_2[in_other]
            term = term.only({term.parameters[k].name for k in common})
        elif term.parameters != other.parameters:
            continue
        x_2, restated = term.restated(other, second.x[indices_2])
        by = x_2 - first.x[indices_1]
        found.append(_TermDifference(term, indices_1, indices_2, by, restated))
    return found


def _held_in(other: FittedModel, model: FittedModel) -> Index:
    """Return the indices of departures of a model that the other one holds at zero."""
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
    # Some of them may be functions of others: along these directions the condition is none.
    inverse = np.linalg.pinv(correlation, rcond=_NO_VARIANCE, hermitian=True)
    follow = covariance[:, held] @ (inverse / np.outer(size, size))
    step = -follow @ model.x[held]
    return replace(
        model,
        x=model.x + step[: len(model.x)],
        T_instr_base=model.T_instr_base @ motion_of_base(step[len(model.x) :]),
        covariance=covariance - follow @ covariance[held],
    )


def _tool_difference(first: FittedModel, second: FittedModel) -> tuple[Array, Index, Index]:
    """Return the difference of the tool's motion, and its indices in both models.

    Only of coordinates that both models have; empty where one has no tool, or one for each
    campaign. Orientations are compared whole: each model counts from that its own fit began with.
    """
    places, orientations, indices_of = [], [], []
    for model in (first, second):
        term = next((term for term in model.model.terms if is_tool(term)), None)
        if term is None or term.holds == "campaign":
            none = np.zeros(0, dtype=np.intp)
            return np.zeros(0), none, none
        indices = model.model.parameter_indices(term)
        values = dict(zip(term.coordinates, model.x[indices], strict=True))
        motion = np.array([values.get(name, 0.0) for name in TOOL])
        turn = Rotation.from_euler("XYZ", motion[3:])
        places.append(motion[:3])
        orientations.append(turn * Rotation.from_matrix(model.R_ee_target))
        indices_of.append(dict(zip(term.coordinates, indices, strict=True)))
    turned = (orientations[1] * orientations[0].inv()).as_rotvec()
    by = np.concatenate([places[1] - places[0], turned])
    common = [k for k, name in enumerate(TOOL) if all(name in each for each in indices_of)]
    in_first, in_second = (
        np.array([each[TOOL[k]] for k in common], dtype=np.intp) for each in indices_of
    )
    return by[common], in_first, in_second


def _target_differences(first: FittedModel, second: FittedModel) -> Array:
    """Return the differences of targets that both models name, x, y, z of each [m]."""
    in_first, in_second = (
        dict(zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True))
        for model in (first, second)
    )
    common = [name for name in in_first if name in in_second]
    return np.concatenate([np.zeros(0), *(in_second[name] - in_first[name] for name in common)])
