"""How far the weights of an arm may be from those described, and a model that has them unknown.

Where torques are calculated and not logged, what weights differ by goes through the springs into
every pose. Makers state masses to some ten parts in a hundred, centres to a centimetre or two; an
error of the size stated here costs half a nat, one twice as large two, far less than a name needs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights, WeightSizes

#: Standard uncertainty of a link's mass, relative, and of its centre, per axis [m].
LINK_MASS = 0.06
LINK_COM_M = 0.01
#: The same of a tool whose mass is stated.
TOOL_MASS = 0.12
TOOL_COM_M = 0.02
#: A tool of unknown mass weighs some part of the arm, and sits so far from the flange [m].
UNKNOWN_TOOL_MASS = 0.1
UNKNOWN_TOOL_COM_M = 0.1
#: Standard uncertainty of the direction of gravity in the base frame [rad].
LEVEL_RAD = 1e-3


def weight_sizes(arm: Arm, payload: Payload) -> WeightSizes:
    """Return how far the weights of an arm and its tool may be from those described."""
    if payload.known:
        tool_kg, com_m = payload.mass_kg, TOOL_COM_M
        size_kg = TOOL_MASS * tool_kg
    else:
        total_kg = 0.0 if arm.mass_kg is None else float(arm.mass_kg.sum())
        tool_kg = size_kg = UNKNOWN_TOOL_MASS * total_kg
        com_m = UNKNOWN_TOOL_COM_M
    return WeightSizes(
        link_mass=LINK_MASS,
        link_com_m=LINK_COM_M,
        payload_kg=size_kg,
        payload_kg_m=tool_kg * com_m,
        level_rad=LEVEL_RAD,
    )


def unknown_tool(arm: Arm, payload: Payload) -> Weights:
    """Return mass and first moment of a tool of which nothing is known."""
    sizes = replace(weight_sizes(arm, payload), link_mass=0.0, link_com_m=0.0, level_rad=0.0)
    return replace(Weights.about(arm, sizes), unknown_tool=True)


def with_uncertain_weights(model: FittedModel, payload: Payload) -> FittedModel:
    """Return a model, fitted to calculated torques, with all its weights unknown.

    What it has found of some of them already is kept.
    """
    arm, terms = model.arm, model.model.terms
    weights = Weights.about(arm, weight_sizes(arm, payload))
    weights = replace(weights, unknown_tool=not payload.known)
    found: dict[int, float] = {}
    own = np.zeros(0, dtype=np.intp)
    for term in terms:
        places = np.arange(len(model.x))[model.model.columns_of(term)]
        if isinstance(term, Weights):
            found |= zip(term.columns, model.x[places], strict=True)
        else:
            own = np.append(own, places)
    values = np.array([found.get(column, 0.0) for column in weights.columns])
    covariance = None
    if model.covariance is not None:
        with_base = np.append(own, len(model.x) + np.arange(6))
        size = len(with_base) + len(values)
        at = np.append(np.arange(len(own)), np.arange(size - 6, size))
        covariance = np.diag(np.concatenate([np.zeros(len(own)), weights.sizes, np.zeros(6)]) ** 2)
        covariance[np.ix_(at, at)] = model.covariance[np.ix_(with_base, with_base)]
    kept = tuple(term for term in terms if not isinstance(term, Weights))
    return replace(
        model,
        model=Model(model.model.chain, (*kept, weights)),
        x=np.concatenate([model.x[own], values]),
        covariance=covariance,
    )


def open_unknowns(model: Model) -> int:
    """Return how many parameters of a model nothing but the readings determines."""
    weights = sum(len(term.parameters) for term in model.terms if isinstance(term, Weights))
    return len(model.parameters) - weights
