"""General models held against a truth that is known: scores of parameters and of predictions.

A score is (estimate - truth) / standard uncertainty. A parameter that another repeats has no truth
of its own: where the truth departs only by parameters that the model holds, every parameter has.
Where it departs in any way, the model still owes its predictions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri, stdtrit

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import GeneralCalibration
from pa10cal.fit.identifiability import not_identifiable
from pa10cal.fit.loads import with_torques
from pa10cal.observe.observations import Observations
from pa10cal.results.calibration import CalibratedParameter
from pa10cal.results.studies import Coverage, ParameterCoverage
from pa10cal.results.truth import TrueParameter
from pa10cal.terms.joint_spring import JointSpring

_CLASSES = {
    "delta_a_": "lengths",
    "delta_d_": "lengths",
    "delta_": "angles",
    "base_": "base",
    "tool_": "tool",
    "target_": "targets",
    "windup_": "springs",
}


@dataclass(frozen=True)
class KnownTruth:
    """What hides behind a campaign."""

    # of links, by the name of their parameter [m, rad]; those not named are zero
    departures: Mapping[str, float]
    T_instr_base: Array  # (4, 4) base in the instrument's frame [m]
    T_ee_target: Array  # (4, 4) target of an instrument that gives poses
    p_ee_targets_m: Array  # (B, 3) targets of the other instruments
    k_lin_Nm_rad: Array  # (n,) stiffness of the joints, infinite where they are rigid


def parameter_scores(general: GeneralCalibration, truth: KnownTruth) -> dict[str, float]:
    """Return the score of every parameter that has an interval.

    Tilts left at zero count with the uncertainty that they would have had.
    """
    fit, problem = general.fit, general.problem
    values = _true_values(general, truth)
    without = not_identifiable(fit.identifiability, problem.parameters)
    std = np.sqrt(np.diag(fit.covariance))
    scores = {
        parameter.name: float((fit.x[k] - values.get(parameter.name, 0.0)) / std[k])
        for k, parameter in enumerate(problem.parameters)
        if not fit.at_bound[k] and parameter.name not in without
    }
    for name, each in general.settled.items():
        if each.std:
            scores[name] = -values.get(name, 0.0) / each.std
    return scores


def reported_scores(
    parameters: Mapping[str, CalibratedParameter], truth: Mapping[str, TrueParameter]
) -> dict[str, float]:
    """Return the score of every parameter of a record that the poses identify and the truth has."""
    return {
        name: (found.value - truth[name].value) / found.std
        for name, found in parameters.items()
        if found.identifiable and found.std and name in truth
    }


def prediction_scores(general: GeneralCalibration, exact: Observations) -> Array:
    """Return the scores of what the instrument would see in other poses, one by one.

    Args:
        general: a calibrated model.
        exact: poses seen without error.
    """
    problem = general.problem
    x_model = problem.of_model(general.fit.x)
    states, _ = with_torques(problem.model, x_model, exact.states, general.payload)
    exact = exact.with_states(states).turned(general.start.R_ee_target)
    problem = replace(problem, observations=exact)
    rows = problem.rows(general.fit.x)
    spread = rows.jacobian @ general.fit.covariance
    std = np.sqrt(np.sum(spread * rows.jacobian, axis=2))
    scores: Array = (rows.residual / std)[problem.components_seen]
    return scores


def class_of(name: str) -> str:
    """Return the class of a parameter: lengths, angles, base, tool, targets or springs."""
    return next(kind for start, kind in _CLASSES.items() if name.startswith(start))


def _true_values(general: GeneralCalibration, truth: KnownTruth) -> dict[str, float]:
    """Return the truth in the coordinates in which the model was solved."""
    problem, start = general.problem, general.start
    R, p_m = truth.T_instr_base[:3, :3], truth.T_instr_base[:3, 3]
    if not problem.measured.directional:  # only where the fixed point is
        base = np.concatenate([R.T @ p_m - problem.T_instr_base[:3, 3], np.zeros(3)])
    else:
        base = _motions(np.linalg.inv(problem.T_instr_base) @ truth.T_instr_base)
    T_ee_tool = truth.T_ee_target.copy()
    T_ee_tool[:3, :3] = T_ee_tool[:3, :3] @ start.R_ee_target.T
    names = [name.replace(".", "_") for name in (*BASE, *TOOL)]
    values = dict(truth.departures)
    values |= dict(zip(names, [*base, *_motions(T_ee_tool)], strict=True))
    places = problem.measured.target_parameters
    if places:
        p_ee_m = truth.p_ee_targets_m.ravel()
        values |= {parameter.name: float(p) for parameter, p in zip(places, p_ee_m, strict=True)}
    for term in problem.model.terms:
        if isinstance(term, JointSpring):
            stiffness = float(truth.k_lin_Nm_rad[term.joint - 1])
            values[term.parameters[0].name] = term.tau_ref_Nm / stiffness
    return values


def _motions(T: Array) -> Array:
    """Return shifts along x, y, z and turns about the moved x, y, z that come to a pose (4, 4)."""
    turns = Rotation.from_matrix(T[:3, :3]).as_euler("XYZ")
    return np.concatenate([T[:3, 3], turns])


# Do intervals hold what they promise: scores of many campaigns whose truth is known.

LEVEL = 0.95


def coverage(scores: Array) -> Coverage:
    """Summarise scores (campaigns, parameters): (estimate - truth) / standard uncertainty.

    A parameter without an interval in some campaign has nan there. Of the interval of the share,
    campaigns are independent, and the parameters of one campaign are not.
    """
    shares = np.nanmean(_held(scores), axis=1)
    count = len(shares)
    half = (
        float(stdtrit(count - 1, 0.975) * shares.std(ddof=1) / np.sqrt(count)) if count > 1 else 1.0
    )
    inside = float(shares.mean())
    return Coverage(
        inside=inside,
        inside_interval95=(max(0.0, inside - half), min(1.0, inside + half)),
        rms=float(np.sqrt(np.nanmean(scores**2))),
    )


def coverage_by_parameter(names: Sequence[str], scores: Array) -> dict[str, ParameterCoverage]:
    """Summarise the scores (campaigns, parameters) of each parameter."""
    inside = np.nanmean(_held(scores), axis=0).tolist()
    rms = np.sqrt(np.nanmean(scores**2, axis=0)).tolist()
    return {name: ParameterCoverage(inside=inside[k], rms=rms[k]) for k, name in enumerate(names)}


def _held(scores: Array) -> Array:
    """Return 1 where the interval holds the truth, 0 where it does not, nan without one."""
    inside = np.abs(scores) <= ndtri(0.5 + LEVEL / 2.0)
    return np.where(np.isfinite(scores), inside, np.nan)
