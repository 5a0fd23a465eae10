"""Loads that were written down at the wrong readings, found by the load that each reading shows.

Torques and joints that give way show the load of a reading. If a few readings show the load of
another configuration of their pose, while all others show their own, the loads were exchanged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.discovery.linear import residual
from pa10cal.discovery.rules import NOISE, ROWS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.observe.observations import Observations


def loads_exchanged(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> tuple[Array, Array]:
    """Find single readings whose load is that of another configuration.

    Returns:
        The load (P,) of each reading, one of the campaign's: as stated, but for exchanged ones; and
        the share (P,) of the squared error of all readings that the exchange removes.
    """
    stated_N = readings.states.load_N
    nothing = stated_N, np.zeros(len(readings))
    loads_N = np.unique(stated_N)
    if payload is None or len(loads_N) < 2 or torques == "none":
        return nothing
    deviation, by_load = _load_rows(readings, model, payload, torques)
    if not np.any(by_load):
        return nothing
    # Less the median over the loads of each pose that has several.
    centred = deviation.copy()
    for pose in np.unique(readings.pose):
        rows = np.flatnonzero(readings.pose == pose)
        if len(np.unique(stated_N[rows])) > 1:
            centred[rows] -= np.median(deviation[rows], axis=0)
    scale = NOISE.median_to_sigma * np.median(np.abs(centred), axis=0)
    known = scale > 0.0
    if not known.any():
        return nothing
    white, columns = centred[:, known] / scale[known], by_load[:, known] / scale[known]
    found_N = _likely_loads_N(white, columns, stated_N)
    # Two readings exchange loads; one that shows another load by itself only has a large error.
    shown_N = found_N.copy()
    for row in np.flatnonzero(shown_N != stated_N):
        there = (readings.pose == readings.pose[row]) & (stated_N == shown_N[row])
        if not np.any(shown_N[there] == stated_N[row]):
            found_N[row] = stated_N[row]
    wrong = found_N != stated_N
    if not wrong.any() or wrong.mean() > ROWS.most_slips_share:
        return nothing
    corrected = white - columns * (found_N - stated_N)[:, None]
    gain = np.sum(white**2 - corrected**2, axis=1) / np.sum(white**2)
    return found_N, np.where(wrong, gain, 0.0)


def _likely_loads_N(white: Array, columns: Array, stated_N: Array) -> Array:
    """Return the campaign's load that each reading clearly shows, or else its stated one, (P,).

    Args:
        white: (P, r) whitened deviations under the stated loads.
        columns: (P, r) their derivative by the load.
        stated_N: (P,) stated loads.
    """
    information = np.sum(columns**2, axis=1)
    more_N = np.sum(columns * white, axis=1) / np.maximum(information, np.finfo(float).tiny)
    # A posture that hardly feels the load says little of it.
    scatter = NOISE.median_to_sigma * float(np.median(np.abs(more_N) * np.sqrt(information)))
    u_N = scatter / np.sqrt(np.maximum(information, np.finfo(float).tiny))
    before = np.sum(white**2, axis=1)
    found_N = stated_N.copy()
    for load_N in np.unique(stated_N):
        difference_N = load_N - stated_N
        allowed_N = ROWS.near_load_share * np.abs(difference_N)
        after = np.sum((white - columns * difference_N[:, None]) ** 2, axis=1)
        shown = np.abs(more_N - difference_N) < allowed_N
        shown &= ROWS.load_known_times * u_N < allowed_N
        shown &= np.abs(more_N) > ROWS.load_errors * u_N
        shown &= after < ROWS.load_left_share * before
        found_N[shown & (difference_N != 0.0)] = load_N
    return found_N


def _load_rows(
    readings: Observations, model: FittedModel, payload: Payload, torques: TorqueSource
) -> tuple[Array, Array]:
    """Return deviations (P, r), measured less modelled, and their derivative by the load.

    They are of the torques where these were logged, else of the components of the readings.
    """
    states = readings.states
    if torques == "logged":
        loads = statics_of(model.model, model.x, states, payload)
        return states.tau_Nm - loads.torque_Nm, loads.torque_by_load
    unknown = replace(states, tau_Nm=np.full_like(states.tau_Nm, np.nan))

    def deviation(more_N: float) -> Array:
        loaded = replace(unknown, load_N=states.load_N + more_N)
        carried, _ = with_torques(model.model, model.x, loaded, payload)
        return -residual(model, readings.with_states(replace(carried, load_N=states.load_N)))

    step_N = float(np.ptp(states.load_N))
    now = deviation(0.0)
    return now, (now - deviation(step_N)) / step_N
