"""Noise of logged torques where repeats do not show it: it moves predictions through springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.state import PoseStates, StaticLoads
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.discovery.linear import by_every_joint
from pa10cal.discovery.noise import Noise
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.observe.observations import Observations
from pa10cal.terms.term import yields

#: Torques a row above which their scatter about the weights says how noisy they are.
_ROWS_A_COLUMN = 2


def with_torque_noise(
    noise: Noise, at: FittedModel, poses: Observations, payload: Payload | None
) -> Noise:
    """Return stated noise with what the noise of logged torques adds to it by way of the springs.

    Noise found from pairs of readings holds it already.

    Args:
        noise: of P poses.
        at: the model.
        poses: P complete poses whose torques were logged.
        payload: what the arm carried; None where the masses are not known.
    """
    springs = [term for term in at.model.terms if yields(term)]
    if noise.differences or payload is None or not springs:
        return noise
    weights = statics_of(at.model, at.x, poses.states, payload).static_loads
    torque_Nm = _scatter_about_weights_Nm(poses.states, weights)
    turned_rad = np.zeros(poses.states.q_rad.shape)
    for spring in springs:
        x = at.x[at.model.columns_of(spring)]
        turned_rad[:, spring.joint - 1] += spring.by_torque(poses.states, x)
    moved = by_every_joint(at, poses) * (turned_rad * torque_Nm)[:, None, :]
    return replace(noise, cov=noise.cov + moved @ np.swapaxes(moved, 1, 2), torque_Nm=torque_Nm)


def _scatter_about_weights_Nm(states: PoseStates, weights: StaticLoads) -> Array:
    """Return what logged torques scatter by, (n,), about those of weights known but for factors.

    Zero of a joint with too few poses to say.
    """
    left_Nm = states.tau_Nm - weights.joint_Nm
    found = np.zeros(states.n)
    for j in range(states.n):
        columns = np.column_stack(
            [
                np.ones(len(states)),
                states.arrival[:, j],
                states.load_N,
                weights.joint_Nm[:, j],
                weights.by_weights[:, j],
            ]
        )
        x, _, rank, _ = np.linalg.lstsq(columns, left_Nm[:, j], rcond=1e-9)
        dof = len(states) - int(rank)
        if dof >= _ROWS_A_COLUMN * int(rank):
            found[j] = np.sqrt(np.sum((left_Nm[:, j] - columns @ x) ** 2) / dof)
    return found
