"""What poses carry: torques where none were logged, and what weights do to the structure."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE, TOOL, Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload, Statics, statics
from pa10cal.terms.model import Model

Array = NDArray[np.float64]

#: Where the torques of poses come from: a log, the masses described, or they are not known.
TorqueSource = Literal["logged", "masses", "none"]


def with_torques(
    arm: Arm, states: PoseStates, payload: Payload | None
) -> tuple[PoseStates, TorqueSource]:
    """Return states with torques, and where those come from.

    Logged ones where every pose has them; else those of the masses described; else none (nan).

    Args:
        arm: the nominal arm.
        states: P states.
        payload: what the arm carries; None where it is not known.
    """
    if np.all(np.isfinite(states.tau_Nm)):
        return states, "logged"
    if payload is None or arm.mass_kg is None:
        return states, "none"
    chain = Chain.of(arm)
    weights = statics(chain, chain.coordinates(states.q_rad), states.load_N, payload)
    return replace(states, tau_Nm=weights.torque_Nm), "masses"


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
    return statics(model.chain, coordinates, states.load_N, payload)
