"""What two fitted models of one arm differ by, and with which covariance that is expected.

Springs are taken to the same reference torque, tools to the whole attitude; departures that one
model holds at zero are held in the other too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import TOOL
from pa10cal.arrays import Array
from pa10cal.calibration.general.prior import of_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.of_campaign import OfCampaign, small_motion
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights

#: A millimetre and a milliradian.
UNIT = 1e-3


@dataclass(frozen=True, eq=False)
class Differences:
    """What two models differ by, in the parameters that both have."""

    terms: tuple[Term, ...]  # of the arm, those of the first model that the second has too
    x: Array  # (s,) their parameters in the first model
    by: Array  # (k,) second less first: of the arm, then of the tool, then six motions of the base
    covariance: Array  # (k, k) that they are expected to scatter with
    scale: Array  # (k,) typical sizes
    tool: NDArray[np.intp]  # columns of the tool
    base: NDArray[np.intp]  # columns of the base


def differences(first: FittedModel, second: FittedModel) -> Differences:
    """Return what two models differ by."""
    terms, mine, theirs, changes, by = [], [], [], [], []
    others = {(term.id, term.of): term for term in second.model.terms}
    for term in first.model.terms:
        other = others.get((term.id, term.of))
        if other is None or isinstance(term, Weights) or _is_tool(term) or not of_arm(term):
            continue
        a = np.arange(len(first.x))[first.model.columns_of(term)]
        b = np.arange(len(second.x))[second.model.columns_of(other)]
        if isinstance(term, Offsets) and isinstance(other, Offsets):
            names = [parameter.name for parameter in other.parameters]
            pairs = [
                (k, names.index(parameter.name))
                for k, parameter in enumerate(term.parameters)
                if parameter.name in names
            ]
            term = term.only({term.parameters[k].name for k, _ in pairs})
            a, b = a[[k for k, _ in pairs]], b[[k for _, k in pairs]]
        elif term.parameters != other.parameters:
            continue
        x, change = second.x[b], np.eye(len(b))
        if isinstance(term, JointSpring) and isinstance(other, JointSpring):
            x, change = _as_solved_by(term, other, x)
        terms.append(term)
        mine.append(a)
        theirs.append(b)
        changes.append(change)
        by.append(x - first.x[a])
    own, away = np.concatenate(mine), np.concatenate(theirs)
    from_second = np.zeros((len(own), len(away)))
    at = 0
    for change in changes:
        step = slice(at, at + len(change))
        from_second[step, step] = change
        at = step.stop
    tool, tool_1, tool_2 = _tools(first, second)
    base_1, base_2 = len(first.x) + np.arange(6), len(second.x) + np.arange(6)
    C1 = _aligned(first, np.concatenate([own, tool_1, base_1]), _gone(first, second))
    C2 = _aligned(second, np.concatenate([away, tool_2, base_2]), _gone(second, first))
    change = np.eye(len(C2))
    change[: len(own), : len(own)] = from_second
    arm, frames = len(own), np.arange(len(own), len(C1))
    base = small_motion(np.linalg.inv(first.T_instr_base) @ second.T_instr_base)
    scale = [parameter.scale for term in terms for parameter in term.parameters]
    places = _targets(first, second) if not len(tool) else np.zeros(0)
    covariance = C1 + change @ C2 @ change.T
    # Of targets no covariance is kept: they are known better than the base is, which stands far.
    of_base = np.diag(covariance)[-6:-3].max()
    covariance = block_diag(covariance, of_base * np.eye(len(places)))
    return Differences(
        terms=tuple(terms),
        x=first.x[own],
        by=np.concatenate([*by, tool, base, places]),
        covariance=covariance,
        scale=np.array([*scale, *[UNIT] * (len(covariance) - arm)]),
        tool=frames[: len(tool)] if len(tool) else np.arange(len(C1), len(covariance)),
        base=frames[-6:],
    )


def _targets(first: FittedModel, second: FittedModel) -> Array:
    """Return by how much targets are elsewhere that both models name, x, y, z of each [m]."""
    mine, theirs = (
        dict(zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True))
        for model in (first, second)
    )
    return np.concatenate(
        [np.zeros(0), *(theirs[name] - mine[name] for name in mine if name in theirs)]
    )


def _as_solved_by(mine: JointSpring, other: JointSpring, x: Array) -> tuple[Array, Array]:
    """Return a spring's parameters as another spring of the same joint has them, and how they go.

    Both are solved at a reference torque of their own.
    """
    report = other.report(x)
    same = mine.solved(float(report.values[0]), float(report.values[1]))
    count = len(same)
    change = np.linalg.solve(mine.report(same).jacobian[:count], report.jacobian[:count])
    return same, np.asarray(change, dtype=np.float64)


def _is_tool(term: Term) -> bool:
    return bool(term.coordinates) and set(term.coordinates) <= set(TOOL)


def _gone(model: FittedModel, other: FittedModel) -> NDArray[np.intp]:
    """Return departures that the other model has not: it holds them at zero."""
    theirs = {parameter.name for term in other.model.terms for parameter in term.parameters}
    gone = [
        k
        for term in model.model.terms
        if isinstance(term, Offsets) and not _is_tool(term)
        for k, parameter in zip(
            np.arange(len(model.x))[model.model.columns_of(term)], term.parameters, strict=True
        )
        if parameter.name not in theirs
    ]
    return np.array(gone, dtype=np.intp)


def _aligned(model: FittedModel, at: NDArray[np.intp], gone: NDArray[np.intp]) -> Array:
    """Return the covariance of some parameters, given others that are held."""
    assert model.covariance is not None
    covariance = model.covariance
    whole = covariance[np.ix_(at, at)]
    gone = gone[np.diag(covariance)[gone] > 0.0]
    if not len(gone):
        return whole
    across = covariance[np.ix_(at, gone)]
    held: Array = whole - across @ np.linalg.solve(covariance[np.ix_(gone, gone)], across.T)
    return held


def _tools(
    first: FittedModel, second: FittedModel
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Return by how much the tool differs, and where both models hold it; empty where one has none.

    Of an attitude the whole differs: each model counts from that with which its own fit began.
    """
    none = np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    places, turns = [], []
    columns = []
    for model in (first, second):
        term = next((term for term in model.model.terms if _is_tool(term)), None)
        if term is None or isinstance(term, OfCampaign):
            return none
        at = np.arange(len(model.x))[model.model.columns_of(term)]
        values = dict(zip(term.coordinates, model.x[at], strict=True))
        motion = np.array([values.get(name, 0.0) for name in TOOL])
        places.append(motion[:3])
        turns.append(
            Rotation.from_euler("XYZ", motion[3:]) * Rotation.from_matrix(model.R_ee_target)
        )
        columns.append(dict(zip(term.coordinates, at, strict=True)))
    by = np.concatenate([places[1] - places[0], (turns[1] * turns[0].inv()).as_rotvec()])
    both = [k for k, name in enumerate(TOOL) if all(name in each for each in columns)]
    one, other = (np.array([each[TOOL[k]] for k in both], dtype=np.intp) for each in columns)
    return by[both], one, other
