"""Static loads of poses by the weights of arm and payload, and torques where none were logged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields, replace
from typing import Any, Literal, TypeVar

import numpy as np

from pa10cal.arm.chain import BASE, TOOL, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import CarriedWeights, Payload, PoseStates, StaticLoads, statics
from pa10cal.arrays import Array, Index
from pa10cal.rules import MASSES
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights

Loads = TypeVar("Loads", StaticLoads, CarriedWeights)
#: Where the torques of poses come from: a log, the masses described, or they are not known.
TorqueSource = Literal["logged", "masses", "none"]

#: Number of poses in a block: statics and predictions take some kilobytes a pose (computing).
BLOCK = 10_000


def with_torques(
    model: Model, x: Array, states: PoseStates, payload: Payload | None
) -> tuple[PoseStates, TorqueSource]:
    """Return states with torques, and where those come from.

    Torques are the logged ones where every pose has them; else those of the masses described, at
    the posture that the model predicts; else nan. At the nominal posture, neglected deviations and
    sag would cause errors of up to 15 um in a UR10, which would be taken for an effect.

    Args:
        model, x: chain and terms, with the parameters of these. Effects are not applied: they may
            need loads that are not known yet, and hardly move the weights.
    """
    if np.all(np.isfinite(states.tau_Nm)):
        return states, "logged"
    chain = model.chain
    if payload is None or chain.arm.mass_kg is None:
        return states, "none"
    # Deflection of springs needs torques itself: those of the nominal arm are close enough.
    states = _under_weights(Model(chain, ()), np.zeros(0), states, payload)
    no_effects = tuple(term for term in model.terms if {"effect", "field"}.isdisjoint(term.roles))
    if no_effects:
        x_of_these = x[model.parameter_indices(*no_effects)]
        states = _under_weights(Model(chain, no_effects), x_of_these, states, payload)
    return states, "masses"


def with_static_loads(model: Model, x: Array, states: PoseStates, payload: Payload) -> PoseStates:
    """Return states with the static loads of the arm in the postures that a model predicts.

    Effects that bend, and weights, need loads to begin with: those that the states have, or else
    those of the nominal arm. Torques stay as they are.
    """
    if states.static_loads is None and model.terms_of("effect", "weight", "field"):
        rigid = Model(model.chain, ())
        states = replace(states, static_loads=statics_of(rigid, np.zeros(0), states, payload))
    return replace(states, static_loads=statics_of(model, x, states, payload))


def blocks(count: int) -> Iterator[Index]:
    """Yield the row numbers below a count in blocks of `BLOCK`; for 0 a single empty block."""
    for first in range(0, count or 1, BLOCK):
        yield np.arange(first, min(first + BLOCK, count))


def with_loads_read_by(terms: Iterable[Term], states: PoseStates) -> PoseStates:
    """Return states, without their large static loads if none of the terms reads these."""
    if not all({"effect", "weight", "field"}.isdisjoint(term.roles) for term in terms):
        return states
    return replace(states, static_loads=None)


def _under_weights(model: Model, x: Array, states: PoseStates, payload: Payload) -> PoseStates:
    """Return states with the static loads of a model, and the torques of these."""
    loaded = with_static_loads(model, x, states, payload)
    assert loaded.static_loads is not None
    return replace(loaded, tau_Nm=loaded.static_loads.joint_Nm)


def statics_of(model: Model, x: Array, states: PoseStates, payload: Payload) -> StaticLoads:
    """Return the static loads of an arm in the postures that a model predicts.

    Motions of base and tool are left out: gravity is along the axes of the base itself, and errors
    of the instrument, which the model has as motions of the tool, move no weight. Weights are those
    described if a term of the model holds their deviations, else those estimated from a log.
    """
    return _merged(_statics_of(model, x, states, payload))


def _statics_of(
    model: Model, x: Array, states: PoseStates, payload: Payload
) -> Iterator[tuple[Index, StaticLoads]]:
    """Yield rows and their static loads, of one campaign and no more than `BLOCK` at once."""
    chain = model.chain
    coordinates = model.chain_coordinates(states, x)
    coordinates[:, chain.columns(BASE + TOOL)] = 0.0
    by_log, of_campaigns = weights_known(chain.arm).by_log, payload.of_campaigns
    described = bool(of_campaigns) or any(map(holds_weights, model.terms))
    if by_log is not None and by_log.x.any() and not described:
        arm, payload = weighed(chain.arm, payload, by_log.x)
        chain = Chain.of(arm, bends=chain.bends)
    rows_and_payloads = [(np.arange(len(states)), payload)]
    if of_campaigns and states.campaign is not None:
        rows_and_payloads = [
            (np.flatnonzero(states.campaign == number), of_campaign)
            for number, of_campaign in enumerate(of_campaigns)
        ]
    for rows, carried in rows_and_payloads:
        for block in blocks(len(rows)):
            at = rows[block]
            yield at, statics(chain, coordinates[at], states.load_N[at], carried)


def weighed(arm: Arm, payload: Payload, amounts: Array) -> tuple[Arm, Payload]:
    """Return an arm and its payload with weights changed by amounts (4 n + 3,).

    Amounts are ordered as the columns of `StaticLoads.by_weights`. A mass stays above
    `MASSES.least_drawn_share` of the one described.
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


def _merged(parts: Iterable[tuple[Index, Loads]]) -> Loads:
    """Return records of some rows each as one record, by rows; records within are merged too."""
    rows, records = zip(*parts, strict=True)
    first: Loads = records[0]
    if len(records) == 1:
        return first
    count = sum(map(len, rows))
    merged: dict[str, Any] = {}
    for field in fields(first):
        values: list[Any] = [getattr(record, field.name) for record in records]
        if isinstance(values[0], np.ndarray):
            merged[field.name] = np.empty((count, *values[0].shape[1:]))
            for at, value in zip(rows, values, strict=True):
                merged[field.name][at] = value
        else:
            merged[field.name] = _merged(zip(rows, values, strict=True))
    return replace(first, **merged)
