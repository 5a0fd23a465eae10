"""What poses carry: torques where none were logged, and what weights do to the structure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields, replace
from typing import Any, Literal, TypeVar

import numpy as np

from pa10cal.arm.chain import BASE, TOOL, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates, StaticLoads, Statics, statics
from pa10cal.arrays import Array, Index
from pa10cal.rules import MASSES
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights

S = TypeVar("S", Statics, StaticLoads)

#: Poses that are worked out at once: statics and predictions take kilobytes a pose for a moment
#: (computing).
BLOCK = 10_000


#: Where the torques of poses come from: a log, the masses described, or they are not known.
TorqueSource = Literal["logged", "masses", "none"]


def with_torques(
    model: Model, x: Array, states: PoseStates, payload: Payload | None
) -> tuple[PoseStates, TorqueSource]:
    """Return states with torques, and where those come from.

    Logged ones where every pose has them; else those of the masses described, at the posture that
    the model says; else none (nan). At the nominal posture, departures and sag of an arm would
    leave up to 15 um of a UR10 to be found as an effect.

    Args:
        model, x: chain and terms, with the parameters of these. Effects play no part: they may
            need what is not known yet, and move weights by next to nothing.
    """
    if np.all(np.isfinite(states.tau_Nm)):
        return states, "logged"
    chain = model.chain
    if payload is None or chain.arm.mass_kg is None:
        return states, "none"
    # What springs give way by needs torques itself: those of the nominal arm, near enough.
    states = _under_weights(Model(chain, ()), np.zeros(0), states, payload)
    own = tuple(term for term in model.terms if {"effect", "field"}.isdisjoint(term.roles))
    if own:
        states = _under_weights(
            Model(chain, own), x[model.parameter_indices(*own)], states, payload
        )
    return states, "masses"


def blocks(count: int) -> Iterator[Index]:
    """Yield the numbers up to a count, `BLOCK` of them at a time; none once where it is 0."""
    yield from (
        np.arange(first, min(first + BLOCK, count)) for first in range(0, count or 1, BLOCK)
    )


def with_loads_read_by(terms: Iterable[Term], states: PoseStates) -> PoseStates:
    """Return states without the static loads where no term reads these: they are large."""
    if not all({"effect", "weight", "field"}.isdisjoint(term.roles) for term in terms):
        return states
    return replace(states, static_loads=None)


def _under_weights(model: Model, x: Array, states: PoseStates, payload: Payload) -> PoseStates:
    found = _in_order(
        (at, each.static_loads) for at, each in _statics_of(model, x, states, payload)
    )
    return replace(states, tau_Nm=found.joint_Nm, static_loads=found)


def statics_of(model: Model, x: Array, states: PoseStates, payload: Payload) -> Statics:
    """Return the static loads of an arm in the poses that a model predicts.

    Gravity is along the base's own axes; and what the instrument reads too much, which moves the
    tool in the model, moves no weight: motions of base and tool count for nothing here. Weights are
    those described where a term of the model says what they differ by, else those of a log.
    """
    return _in_order(_statics_of(model, x, states, payload))


def _statics_of(
    model: Model, x: Array, states: PoseStates, payload: Payload
) -> Iterator[tuple[Index, Statics]]:
    """Yield rows and their static loads, of one campaign and no more than `BLOCK` at once."""
    coordinates = model.chain_coordinates(states, x)
    coordinates[:, model.chain.columns(BASE + TOOL)] = 0.0
    by_log = weights_known(model.chain.arm).by_log
    amounts = np.zeros(4 * model.chain.arm.n + 3)
    if by_log is not None and not (payload.of_campaigns or any(map(holds_weights, model.terms))):
        amounts = by_log.x
    of = [(np.arange(len(states)), payload)]
    if payload.of_campaigns and states.campaign is not None:
        every = enumerate(payload.of_campaigns)
        of = [(np.flatnonzero(states.campaign == k), own) for k, own in every]
    chain = model.chain
    for rows, own in of:
        if amounts.any():
            arm, own = weighed(model.chain.arm, own, amounts)
            chain = Chain.of(arm, bends=model.chain.bends)
        for at in (rows[block] for block in blocks(len(rows))):
            yield at, statics(chain, coordinates[at], states.load_N[at], own)


def weighed(arm: Arm, payload: Payload, amounts: Array) -> tuple[Arm, Payload]:
    """Return an arm and what it carries with other weights, by columns of `by_weights` (4 n + 3,).

    A mass stays above a hundredth of what is described.
    """
    assert arm.mass_kg is not None
    assert arm.com_m is not None
    of_links = amounts[: 4 * arm.n].reshape(arm.n, 4)
    mass_kg = np.maximum(arm.mass_kg + of_links[:, 0], MASSES.least_drawn_share * arm.mass_kg)
    heavy = mass_kg > 0.0
    com_m = arm.com_m.copy()
    com_m[heavy] += of_links[heavy, 1:] / mass_kg[heavy, None]
    of_tool_kg, *level_rad = amounts[4 * arm.n :].tolist()
    gravity = payload.gravity_m_s2
    across = np.linalg.norm(gravity) * np.linalg.svd(gravity[None])[2][1:]
    carried = replace(
        payload,
        mass_kg=max(payload.mass_kg + of_tool_kg, 0.0),
        gravity_m_s2=gravity + np.array(level_rad) @ across,
    )
    return replace(arm, mass_kg=mass_kg, com_m=com_m), carried


def _in_order(parts: Iterable[tuple[Index, S]]) -> S:
    """Return records of arrays as one, each row where it belongs."""
    rows, each = zip(*parts, strict=True)
    if len(each) == 1:
        only: S = each[0]
        return only
    count = sum(map(len, rows))

    def whole(found: tuple[Any, ...]) -> Any:
        if not isinstance(found[0], np.ndarray):
            return _in_order(zip(rows, found, strict=True))
        values = np.empty((count, *found[0].shape[1:]))
        for at, part in zip(rows, found, strict=True):
            values[at] = part
        return values

    names = [field.name for field in fields(each[0])]
    together: S = type(each[0])(
        *(whole(tuple(getattr(one, name) for one in each)) for name in names)
    )
    return together
