"""Loads written down at the wrong readings: what each reading says of its load.

Torques, and joints that give way, tell the load of a reading apart from what is stated. Where a few
readings tell the load of another configuration while all others tell their own, the loads were
exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.discovery.linear import residual
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.observe.observations import Observations

#: What a reading tells of its load is within this part of the difference from the other load, and
#: known to so many times better.
_NEAR = 0.25
_APART = 3.0
#: It is so many times its uncertainty from the load stated, and the other load leaves no more than
#: this part of the squared error.
_SURELY = 8.0
_LEFT = 0.25
#: More of the readings than this are no slip: then a load is misstated, or a torque wrong.
_MOST = 0.1


@dataclass(frozen=True)
class Exchanged:
    """Readings whose load is that of another configuration."""

    # (P,) the load that each reading tells, one of the campaign's; as stated but for those
    # exchanged
    load_N: Array
    gain: Array  # (P,) part of the squared error of all readings that the other load takes away


def loads_exchanged(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> Exchanged:
    """Find readings whose load is that of another configuration.

    Args:
        readings: P single readings, with what the model needs.
        model: the calibrated model.
        payload: what the arm carries; None where it is not known.
        torques: where the torques of the readings come from.
    """
    stated_N = readings.states.load_N
    nothing = Exchanged(stated_N, np.zeros(len(readings)))
    loads_N = np.unique(stated_N)
    if payload is None or len(loads_N) < 2 or torques == "none":
        return nothing
    left, by_load = _rows(readings, model, payload, torques)
    if not np.any(by_load):
        return nothing
    alone = _less_pose(left, readings)
    scale = MEDIAN_TO_SIGMA * np.median(np.abs(alone), axis=0)
    known = scale > 0.0
    if not known.any():
        return nothing
    white, columns = alone[:, known] / scale[known], by_load[:, known] / scale[known]
    information = np.sum(columns**2, axis=1)
    told_N = np.sum(columns * white, axis=1) / np.maximum(information, np.finfo(float).tiny)
    # A posture that hardly feels the load says little of it.
    usual = MEDIAN_TO_SIGMA * float(np.median(np.abs(told_N) * np.sqrt(information)))
    u_N = usual / np.sqrt(np.maximum(information, np.finfo(float).tiny))
    before = np.sum(white**2, axis=1)
    found = stated_N.copy()
    for load_N in loads_N:
        apart = load_N - stated_N
        allowed_N = _NEAR * np.abs(apart)
        after = np.sum((white - columns * apart[:, None]) ** 2, axis=1)
        nearer = (np.abs(told_N - apart) < allowed_N) & (_APART * u_N < allowed_N)
        nearer &= (np.abs(told_N) > _SURELY * u_N) & (after < _LEFT * before)
        found[nearer & (apart != 0.0)] = load_N
    found = _with_partners(found, readings)
    wrong = found != stated_N
    if not wrong.any() or wrong.mean() > _MOST:
        return nothing
    instead = white - columns * (found - stated_N)[:, None]
    gain = np.sum(white**2 - instead**2, axis=1) / np.sum(white**2)
    return Exchanged(found, np.where(wrong, gain, 0.0))


def _with_partners(told_N: Array, readings: Observations) -> Array:
    """Return the loads told, as stated where no other reading of the pose has the one told.

    Loads are exchanged between two readings. One that tells another load alone is merely off.
    """
    stated_N, found = readings.states.load_N, told_N.copy()
    for row in np.flatnonzero(told_N != stated_N):
        there = (readings.pose == readings.pose[row]) & (stated_N == told_N[row])
        if not np.any(told_N[there] == stated_N[row]):
            found[row] = stated_N[row]
    return found


def _rows(
    readings: Observations, model: FittedModel, payload: Payload, torques: TorqueSource
) -> tuple[Array, Array]:
    """Return rows (P, r) measured less modelled that follow the load, and their derivative."""
    states = readings.states
    if torques == "logged":
        loads = statics_of(model.model, model.x, states, payload)
        return states.tau_Nm - loads.torque_Nm, loads.torque_by_load
    unknown = replace(states, tau_Nm=np.full_like(states.tau_Nm, np.nan))

    def left(more_N: float) -> Array:
        loaded = replace(unknown, load_N=states.load_N + more_N)
        carried, _ = with_torques(model.model, model.x, loaded, payload)
        return -residual(model, readings.with_states(replace(carried, load_N=states.load_N)))

    step_N = float(np.ptp(states.load_N))
    now = left(0.0)
    return now, (now - left(step_N)) / step_N


def _less_pose(left: Array, readings: Observations) -> Array:
    """Return rows less their median over the loads of their pose, where it has several."""
    alone = left.copy()
    _, pose = np.unique(readings.pose, return_inverse=True)
    for number in range(int(pose.max()) + 1):
        rows = np.flatnonzero(pose == number)
        if len(np.unique(readings.states.load_N[rows])) > 1:
            alone[rows] -= np.median(left[rows], axis=0)
    return alone
