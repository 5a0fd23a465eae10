"""What moved in an arm between two campaigns, by two fitted models and their covariances.

Links, springs and effects that both models hold are compared as they are solved; base and tool are
each campaign's own, and count apart. Differences are expected to scatter with the sum of both
covariances. What moved widens that along its own directions; evidence decides (`fit.moved`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from pa10cal.arm.chain import TOOL
from pa10cal.arrays import Array
from pa10cal.calibration.general.placed import is_tool
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.moved import (
    BASE_MOVED,
    JOINT_ZERO,
    MODEL_ERROR,
    STIFFNESS,
    TOOL_MOVED,
    Hypothesis,
    MovedPart,
    hypotheses,
    sought,
)
from pa10cal.fit.problem import gain_along, widened
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.comparison import MovedThing, WhatMoved
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import MOVED
from pa10cal.terms.of_campaign import small_motion
from pa10cal.terms.term import Term, TermParameter

_PLACES = (BASE_MOVED, TOOL_MOVED)
_VERDICTS = {JOINT_ZERO: "joint_zero_moved", STIFFNESS: "stiffness_changed"}


def what_moved(first: FittedModel, second: FittedModel) -> WhatMoved | None:
    """Return what moved between two models of one arm, in order; None without a covariance."""
    if first.covariance is None or second.covariance is None:
        return None
    found = differences(first, second)
    arm = len(found.x)
    possible = _possible(first, found)
    kept = np.diag(found.covariance) > 0.0
    precision = np.zeros_like(found.covariance)
    precision[np.ix_(kept, kept)] = np.linalg.inv(found.covariance[np.ix_(kept, kept)])
    disagreed = Gaussian.of_products(precision, precision @ found.by)
    moved = sought(disagreed, possible)
    things = tuple(
        _thing(each, moved, possible, disagreed, found)
        for each in moved
        if each.what.kind != MODEL_ERROR
    )
    factor = 1.0 + sum(each.size**2 for each in moved if each.what.kind == MODEL_ERROR)
    of_arm = {each.what.kind for each in moved} - set(_PLACES)
    verdict = "something_else"
    if not of_arm:
        verdict = "base_or_tool_moved" if moved else "unchanged"
    elif len(of_arm) == 1:
        verdict = _VERDICTS.get(next(iter(of_arm)), verdict)
    # Chi-square of the arm's differences along directions that both fits identify.
    scale = np.array([parameter.scale for parameter in found.parameters])
    values, vectors = np.linalg.eigh(found.covariance[:arm, :arm] / np.outer(scale, scale))
    seen = (values > 0.0) & (values < MOVED.open_scales**2)
    along = vectors[:, seen].T @ (found.by[:arm] / scale)
    square, dof = float(np.sum(along**2 / values[seen])), int(np.count_nonzero(seen))
    mine, theirs = (
        {f"{term.id} of {term.of}" for term in model.model.terms_of("effect")}
        for model in (first, second)
    )
    return WhatMoved(
        verdict=verdict,
        chi_square=square,
        dof=dof,
        chance=float(chdtrc(dof, square)) if dof else 1.0,
        factor=factor,
        moved=things,
        only_in_one=tuple(sorted(mine ^ theirs)),
        line=_line(verdict, things, factor),
    )


def _line(verdict: str, things: Sequence[MovedThing], factor: float) -> str:
    told = []
    for thing in things:
        words = f"{thing.of} changed"
        if thing.by is not None and thing.interval95 is not None:
            times, unit = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "1": (1e2, "%")}[thing.unit]
            low, high = (times * end for end in thing.interval95)
            what = {JOINT_ZERO: "the zero of ", STIFFNESS: "the windup of "}.get(thing.kind, "")
            words = (
                f"{what}{thing.of} by {times * thing.by:+.3g} {unit} (95 % interval {low:.3g} to "
                f"{high:.3g} {unit})"
            )
        if thing.alternatives:
            words += f", or {', or '.join(thing.alternatives[:3])}"
        told.append(words)
    if factor > 1.0:
        told.append(
            f"links and springs differ by more than noise explains, {np.sqrt(factor):.0f} times, "
            "as where the models lack an effect"
        )
    words = verdict.replace("_", " ")
    return f"{words}: {'; '.join(told)}" if told else words


def _thing(
    each: MovedPart,
    moved: Sequence[MovedPart],
    possible: Sequence[Hypothesis],
    disagreed: Gaussian,
    found: Differences,
) -> MovedThing:
    """Return one of the things that moved, by how much, and what else would say as much."""
    what, others = each.what, [other for other in moved if other is not each]
    without = disagreed
    for other in others:
        without = widened(without, other.directions)
    gains = {(h.kind, h.of): gain_along(without, h.directions, h.sizes)[0] for h in possible}
    known = {(one.what.kind, one.what.of) for one in moved}
    least = max(gains[what.kind, what.of] - np.log(len(possible) / MOVED.listed), 0.0)
    named = {JOINT_ZERO: "the zero of ", STIFFNESS: "the stiffness of "}
    alternatives = tuple(
        f"{named.get(kind, '')}{of}"
        for (kind, of), gain in sorted(gains.items(), key=lambda item: -item[1])
        if (kind, of) not in known and kind != MODEL_ERROR and gain > least
    )
    by = std = interval95 = None
    unit = ""
    if len(what.columns) == 1:
        (k,) = what.columns
        directions = np.hstack([what.directions, *(other.directions for other in others)])
        information = directions.T @ disagreed.gram @ directions
        # What else moved is as likely as its size says; of the thing itself nothing is expected.
        information += np.diag(np.append(0.0, np.ones(len(information) - 1)))
        covariance = np.linalg.inv(information)
        size, unit = float(what.directions[k, 0]), found.parameters[k].unit
        by = float((covariance @ (directions.T @ disagreed.projection))[0] * size)
        std = float(np.sqrt(covariance[0, 0]) * abs(size))
        if what.kind == STIFFNESS:
            by, std, unit = by / found.x[k], abs(std / found.x[k]), "1"
        interval95 = (by - HALF_WIDTH_95 * std, by + HALF_WIDTH_95 * std)
    return MovedThing(
        kind=what.kind,
        of=what.of,
        by=by,
        std=std,
        unit=unit,
        interval95=interval95,
        gain=each.gain,
        alternatives=alternatives,
    )


def _possible(first: FittedModel, found: Differences) -> tuple[Hypothesis, ...]:
    """Return what may have moved: in the arm, and its base and tool."""
    arm, count = len(found.x), len(found.by)
    of_arm = hypotheses(first.arm, found.terms, found.x, found.covariance[:arm, :arm])
    padded = [
        replace(each, directions=np.pad(each.directions, ((0, count - arm), (0, 0))))
        for each in of_arm
    ]
    frames = []
    for kind, columns in ((BASE_MOVED, found.base), (TOOL_MOVED, found.tool)):
        if len(columns):
            directions = np.zeros((count, len(columns)))
            directions[columns, np.arange(len(columns))] = UNIT
            frames.append(Hypothesis(kind, kind, columns, directions, MOVED.motions))
    return (*padded, *frames)


# What two fitted models of one arm differ by, and with which covariance that is expected.
#
# Springs are taken to the same reference torque, tools to the whole orientation; departures that
# one model holds at zero are held in the other too.

#: A millimetre and a milliradian (unit).
UNIT = 1e-3


@dataclass(frozen=True, eq=False)
class Differences:
    """What two models differ by, in the parameters that both have."""

    terms: tuple[Term, ...]  # of the arm, those of the first model that the second has too
    x: Array  # (s,) their parameters in the first model
    by: Array  # (k,) second less first: of the arm, then of the tool, then six motions of the base
    covariance: Array  # (k, k) that they are expected to scatter with
    tool: NDArray[np.intp]  # columns of the tool
    base: NDArray[np.intp]  # columns of the base

    @property
    def parameters(self) -> list[TermParameter]:
        """Return the arm's parameters."""
        return [parameter for term in self.terms for parameter in term.parameters]


def differences(first: FittedModel, second: FittedModel) -> Differences:
    """Return what two models differ by."""
    terms, mine, theirs, changes, by = [], [], [], [], []
    others = {(term.id, term.of): term for term in second.model.terms}
    for term in first.model.terms:
        other = others.get((term.id, term.of))
        if other is None or "weight" in term.roles or is_tool(term) or not term.stays_with_arm:
            continue
        a, b = first.model.parameter_indices(term), second.model.parameter_indices(other)
        if term.constant:
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
        x, change = term.restated(other, second.x[b])
        terms.append(term)
        mine.append(a)
        theirs.append(b)
        changes.append(change)
        by.append(x - first.x[a])
    own, away = np.concatenate(mine), np.concatenate(theirs)
    tool, tool_1, tool_2 = _tools(first, second)
    base_1, base_2 = len(first.x) + np.arange(6), len(second.x) + np.arange(6)
    C1 = _aligned(first, np.concatenate([own, tool_1, base_1]), _gone(first, second))
    C2 = _aligned(second, np.concatenate([away, tool_2, base_2]), _gone(second, first))
    change = block_diag(*changes, np.eye(len(C2) - len(away)))
    frames = np.arange(len(own), len(C1))
    base = small_motion(np.linalg.inv(first.T_instr_base) @ second.T_instr_base)
    places = np.zeros(0)
    if not len(tool):  # targets that both models name, x, y, z of each [m]
        named_1, named_2 = (
            dict(zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True))
            for model in (first, second)
        )
        both = [name for name in named_1 if name in named_2]
        places = np.concatenate([places, *(named_2[name] - named_1[name] for name in both)])
    covariance = C1 + change @ C2 @ change.T
    # Of targets no covariance is kept: they are known better than the base is, which stands far.
    of_base = np.diag(covariance)[-6:-3].max()
    covariance = block_diag(covariance, of_base * np.eye(len(places)))
    return Differences(
        terms=tuple(terms),
        x=first.x[own],
        by=np.concatenate([*by, tool, base, places]),
        covariance=covariance,
        tool=frames[: len(tool)] if len(tool) else np.arange(len(C1), len(covariance)),
        base=frames[-6:],
    )


def _gone(model: FittedModel, other: FittedModel) -> NDArray[np.intp]:
    """Return departures that the other model has not: it holds them at zero."""
    theirs = {parameter.name for parameter in other.model.parameters}
    lacking = [parameter.name not in theirs for parameter in model.model.parameters]
    return np.flatnonzero(model.model.having("link", "zero", "tilt") & np.array(lacking, bool))


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

    Of an orientation the whole differs: each model counts from that with which its own fit began.
    """
    none = np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    places, turns = [], []
    columns = []
    for model in (first, second):
        term = next((term for term in model.model.terms if is_tool(term)), None)
        if term is None or term.holds == "campaign":
            return none
        at = model.model.parameter_indices(term)
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
