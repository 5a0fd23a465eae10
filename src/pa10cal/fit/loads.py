"""What poses carry: torques where none were logged, and what weights do to the structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload, Statics, statics
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model

Array = NDArray[np.float64]

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
        states: P states.
        payload: what the arm carries; None where it is not known.
    """
    if np.all(np.isfinite(states.tau_Nm)):
        return states, "logged"
    chain = model.chain
    if payload is None or chain.arm.mass_kg is None:
        return states, "none"
    # What springs give way by needs torques itself: those of the nominal arm, near enough.
    found = statics_of(Model(chain, ()), np.zeros(0), states, payload)
    states = replace(states, tau_Nm=found.torque_Nm, static_loads=found.static_loads)
    own = tuple(term for term in model.terms if not isinstance(term, Effect))
    if own:
        x = np.concatenate([x[model.columns_of(term)] for term in own])
        found = statics_of(Model(chain, own), x, states, payload)
        states = replace(states, tau_Nm=found.torque_Nm, static_loads=found.static_loads)
    return states, "masses"


def statics_of(model: Model, x: Array, states: PoseStates, payload: Payload) -> Statics:
    """Return the static loads of an arm in the poses that a model predicts.

    Gravity is along the base's own axes; and what the instrument reads too much, which moves the
    tool in the model, moves no weight: motions of base and tool count for nothing here.

    Args:
        model, x: chain and terms, with the parameters of these.
        states: P states.
        payload: what the arm carries.
    """
    coordinates = model.chain_coordinates(states, x)
    coordinates[:, model.chain.columns(BASE + TOOL)] = 0.0
    if not payload.of_campaigns or states.campaign is None:
        return statics(model.chain, coordinates, states.load_N, payload)
    rows = [np.flatnonzero(states.campaign == k) for k in range(len(payload.of_campaigns))]
    each = [
        statics(model.chain, coordinates[at], states.load_N[at], own)
        for at, own in zip(rows, payload.of_campaigns, strict=True)
        if len(at)
    ]
    back = np.argsort(np.concatenate(rows))
    together: Statics = _joined(each, back)
    return together


def _joined(each: Sequence[Any], back: NDArray[np.intp]) -> Any:
    """Return groups of arrays as one, their rows in the order of the poses."""
    values = zip(*([getattr(one, f.name) for f in fields(one)] for one in each), strict=True)
    return type(each[0])(
        *(
            np.concatenate(found)[back]
            if isinstance(found[0], np.ndarray)
            else _joined(found, back)
            for found in values
        )
    )
