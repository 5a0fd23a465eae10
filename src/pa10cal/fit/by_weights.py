"""Models fitted to logged torques, under the torques of the weights, by which they predict.

A fit takes the torques of its springs from the log, a prediction those of the weights. The two
differ where the log has a gain, or states a tool or a load wrongly: springs are then right with the
log and wrong without it, and no error of poses whose torques were logged shows that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, standard_error_of_sum
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.fit.uncertain_weights import with_weights_by_log
from pa10cal.observe.observations import Observations
from pa10cal.rules import LACK
from pa10cal.terms.model import Model
from pa10cal.terms.term import shows_torque, yields

F = TypeVar("F", bound=Fitted)


def is_fitted_to_log(model: Fitted) -> bool:
    """Return whether springs of a model were fitted to logged torques, and weights are known."""
    known, springs = weights_known(model.arm), any(map(yields, model.model.terms))
    logged = known.origin == "logged" or known.by_log is not None
    return logged and springs and model.payload is not None and model.arm.mass_kg is not None


def under_weights(model: F, poses: Observations) -> tuple[F, Observations]:
    """Return a model without errors of the torque log, and poses with the torques of the weights.

    Args:
        model: was fitted to a log, see `is_fitted_to_log`.
        poses: with all else that the model's terms read.
    """
    payload = model.payload
    assert payload is not None
    of_robot = [
        term for term in model.model.terms if not (shows_torque(term) and term.error_of == "log")
    ]
    whole = with_weights_by_log(model.only(*of_robot), payload)
    nowhere = replace(
        poses.states, tau_Nm=np.full_like(poses.states.tau_Nm, np.nan), static_loads=None
    )
    states, _ = with_torques(whole.model, whole.x, nowhere, payload)
    # Effects that bend need the loads of the arm: those of the nominal one first.
    for at, x in ((Model(whole.model.chain, ()), np.zeros(0)), (whole.model, whole.x)):
        states = replace(states, static_loads=statics_of(at, x, states, payload))
    return whole, poses.with_states(states)


def further_off_mm2(model: Fitted, poses: Observations) -> Array:
    """Return by how much squared errors are larger as a model predicts than with the log, (P,)."""
    # An apparatus is as stated in both: what a fit makes of it stands for a constant of the log.
    model = replace(model, targets_off_m=np.zeros(0))
    if not np.array_equal(model.T_end_shown, np.eye(4)):
        poses = replace(poses, measured=poses.measured.of_end(model.T_end_shown))
    by_log_mm = model.deviations(poses).distance_mm
    whole, weighed = under_weights(model, poses)
    return np.asarray(whole.deviations(weighed).distance_mm ** 2 - by_log_mm**2)


def lost_without_log_mm(model: Fitted, *poses: Observations) -> float:
    """Return the rms error that a model's predictions have beyond that with the log [mm].

    It is 0 where chance explains it, or torques were not logged. Noise of the log moves the poses
    of a fit and not predictions, so that these may be better.

    Args:
        poses: averaged poses, as modelled, in sets, such as those fitted and those held out: the
            largest of the sets counts.
    """
    if not is_fitted_to_log(model):
        return 0.0
    return max((_lost_mm(model, each) for each in poses if len(each)), default=0.0)


def _lost_mm(model: Fitted, poses: Observations) -> float:
    more_mm2 = further_off_mm2(model, poses)
    if not np.isfinite(more_mm2).all():
        return 0.0
    # Loads at one pose go with each other: they count as one.
    pose = np.unique(poses.pose, return_inverse=True)[1]
    of_poses_mm2 = np.bincount(pose, more_mm2).astype(float)
    if of_poses_mm2.sum() <= LACK.surely * standard_error_of_sum(of_poses_mm2):
        return 0.0
    return float(np.sqrt(more_mm2.mean()))
