"""How far the weights of an arm may be from those described, and a model that has them unknown.

Where torques are calculated and not logged, what weights differ by goes through the springs into
every pose. Makers state masses to some ten parts in a hundred, centres to a centimetre or two; an
error of the size stated here costs half a nat, one twice as large two, far less than a name needs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.fit.fitted import Fitted
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights, WeightSizes

F = TypeVar("F", bound=Fitted)

#: Standard uncertainty of the mass of a tool that is stated, relative, and of its centre, per axis
#: [m].
TOOL_MASS = 0.12
TOOL_COM_M = 0.02
#: A tool of unknown mass weighs some part of the arm, and sits so far from the flange [m].
UNKNOWN_TOOL_MASS = 0.1
UNKNOWN_TOOL_COM_M = 0.1
#: Standard uncertainty of the direction of gravity in the base frame [rad].
LEVEL_RAD = 1e-3
#: The same of an arm of which no weights are stated: nobody levelled it for them.
LEVEL_ASSUMED_RAD = 5e-3


def weight_sizes(arm: Arm, payload: Payload) -> WeightSizes:
    """Return how far the weights of an arm and its tool may be from those described."""
    if payload.known:
        tool_kg, com_m = payload.mass_kg, TOOL_COM_M
        size_kg = TOOL_MASS * tool_kg
    else:
        total_kg = 0.0 if arm.mass_kg is None else float(arm.mass_kg.sum())
        tool_kg = size_kg = UNKNOWN_TOOL_MASS * total_kg
        com_m = UNKNOWN_TOOL_COM_M
    known = weights_known(arm)
    return WeightSizes(
        link_mass=known.mass,
        link_com_m=known.com_m,
        payload_kg=size_kg,
        payload_kg_m=tool_kg * com_m,
        level_rad=LEVEL_ASSUMED_RAD if known.assumed else LEVEL_RAD,
    )


def unknown_tool(arm: Arm, payload: Payload) -> Weights:
    """Return mass and first moment of a tool of which nothing is known."""
    none = np.zeros(arm.n)
    sizes = replace(weight_sizes(arm, payload), link_mass=none, link_com_m=none, level_rad=0.0)
    return replace(Weights.about(arm, sizes), unknown_tool=True)


def unknown_weights(arm: Arm, payload: Payload, states: PoseStates) -> tuple[Weights, ...]:
    """Return the weights that a calibration fits with the springs: those nobody stated."""
    known = weights_known(arm)
    if known.origin == "stated":
        return () if payload.known else (unknown_tool(arm, payload),)
    weights = Weights.about(arm, weight_sizes(arm, payload))
    loads = states.static_loads
    if known.assumed and not scale_is_known(payload, states) and loads is not None:
        weights = weights.relative(loads.joint_Nm, loads.by_weights)
    return (weights,)


def scale_is_known(payload: Payload, states: PoseStates) -> bool:
    """Return whether loads of known size set the scale of weights that nobody stated."""
    masses_kg = {each.mass_kg for each in payload.of_campaigns if each.known}
    return len(masses_kg) > 1 or bool(np.ptp(states.load_N) > 0.0)


def with_uncertain_weights(model: F, payload: Payload) -> F:
    """Return a model, fitted to calculated torques, with all its weights unknown.

    What it has found of some of them already is kept.
    """
    arm, terms = model.arm, model.model.terms
    if any(isinstance(term, Weights) and 0 in term.columns for term in terms):
        return model  # all of them are unknowns already
    weights = Weights.about(arm, weight_sizes(arm, payload))
    weights = replace(weights, unknown_tool=not payload.known)
    found: dict[int, float] = {}
    for term in terms:
        if isinstance(term, Weights):
            found |= zip(term.columns, model.values_of(term), strict=True)
    own = model.only(*(term for term in terms if not isinstance(term, Weights)))
    values = np.array([found.get(column, 0.0) for column in weights.columns])
    covariance, at = own.covariance, len(own.x) + np.arange(len(values))
    if covariance is not None:
        for axis in (0, 1):
            covariance = np.insert(covariance, np.full(len(at), len(own.x)), 0.0, axis=axis)
        covariance[at, at] = np.square(weights.sizes)
    return replace(
        own,
        model=Model(model.model.chain, (*own.model.terms, weights)),
        x=np.concatenate([own.x, values]),
        covariance=covariance,
    )


def open_unknowns(model: Model) -> int:
    """Return how many parameters of a model nothing but the readings determines."""
    weights = sum(len(term.parameters) for term in model.terms if isinstance(term, Weights))
    return len(model.parameters) - weights
