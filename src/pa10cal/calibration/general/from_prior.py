"""Calibration that starts from a fitted model of the arm: after a crash, a new tool, a new cell.

Base, tool and targets are free. Links, springs and effects are expected where the model has them,
within its covariance. That holds noise alone, so the readings decide how far it is trusted: what
moved, such as the zero of one joint, is found anew while the rest stays; where everything departs
by more than noise, as under a model that lacks an effect, all is trusted less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import GeneralCalibration, at_rest
from pa10cal.calibration.general.fit import Fit, fit
from pa10cal.calibration.general.prior import Moved, Prior, Release
from pa10cal.calibration.general.problem import check_enough, start_of_tool
from pa10cal.calibration.general.unknowns import choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.fit.expected import Disagreement, Expected
from pa10cal.fit.loads import with_torques
from pa10cal.fit.moved import MODEL_ERROR, STIFFNESS, Found, hypotheses, sought
from pa10cal.fit.problem import Problem
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets

#: Searches for what moved, each about the fit with what the one before found.
_MOST_ROUNDS = 4


def calibrate_from(
    prior: Prior,
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None = None,
    options: CalibrationOptions | None = None,
) -> GeneralCalibration:
    """Calibrate an arm of which a fitted model is known.

    Args:
        prior: what is known.
        arm: the nominal arm.
        observations: P poses to fit.
        start: about where base, tool and targets are.
        payload: what the arm carries; None where it is not known.
        options: how to calibrate; None for the defaults.

    Raises:
        CalibrationError: when there are too few poses to find base and tool.
    """
    options = options or CalibrationOptions()
    chain, terms = prior.model.model.chain, prior.terms
    unknowns = choose_unknowns(
        arm, options.tolerances, observations.measured, start.T_instr_base, start.targets_m
    )
    (links,) = (term for term in terms if isinstance(term, Offsets))
    unknowns = replace(unknowns, links=links)
    model = Model(chain, (*terms, *unknowns.frames, unknowns.base))
    states, source = with_torques(
        Model(chain, terms), prior.expected.mean, observations.states, payload
    )
    posed = observations.with_states(states).turned(start.R_ee_target)
    problem = Problem(model, unknowns.places, start.targets_m, start.T_instr_base, posed)
    frames = [start_of_tool(name, start) for name in unknowns.frame_names]
    x = np.concatenate([prior.expected.mean, frames, np.zeros(len(unknowns.base.parameters))])
    check_enough(problem, known=len(prior.expected.mean))

    expected = prior.expected
    possible = hypotheses(arm, terms, expected.mean, expected.covariance)
    released: list[Found] = []
    found = _fitted(problem, problem.start(x), expected, options, None)
    for _ in range(_MOST_ROUNDS):
        k = len(expected.mean)
        covariance = found.covariance[:k, :k] / found.widening**2
        disagreement = Disagreement.of_fit(expected, found.x[:k], covariance)
        more = sought(disagreement, possible, released)
        if not more:
            break
        released += more
        for each in more:
            expected = expected.widened(each.directions)
        found = _fitted(problem, found.x, expected, options, None)
    if source == "masses":
        problem, found = at_rest(
            problem,
            found,
            observations.states,
            payload,
            lambda problem, before: _fitted(problem, before.x, expected, options, before.scatter),
        )
    return GeneralCalibration(
        arm=arm,
        start=start,
        unknowns=unknowns,
        settled=(),
        springs=tuple(term.joint for term in terms if isinstance(term, JointSpring)),
        torques_from=source,
        payload=payload,
        problem=problem,
        fit=found,
        moved=_moved(prior, problem, found, released),
    )


def _fitted(
    problem: Problem,
    x: Array,
    expected: Expected,
    options: CalibrationOptions,
    scatter: dict[str, float] | None,
) -> Fit:
    return fit(
        problem,
        x,
        robust=options.general.robust,
        max_iterations=options.max_iterations,
        scatter_start=scatter,
        expected=expected,
    )


def _moved(prior: Prior, problem: Problem, found: Fit, released: Sequence[Found]) -> Moved:
    """Return what was found anew, and by how much it differs from the prior."""
    mean, before = prior.expected.mean, np.diag(prior.expected.covariance)
    after = np.diag(found.covariance)
    releases, factor = [], 1.0
    for each in released:
        if each.what.kind == MODEL_ERROR:
            factor += each.size**2
            continue
        by = std = None
        unit = ""
        if len(each.what.columns) == 1:
            (k,) = each.what.columns
            by, unit = float(found.x[k] - mean[k]), problem.parameters[k].unit
            std = float(np.sqrt(before[k] + after[k]))
            if each.what.kind == STIFFNESS:
                by, std, unit = by / mean[k], std / mean[k], "1"
        releases.append(Release(each.what.kind, each.what.of, by, std, unit, each.gain))
    fitted_to = prior.model.fitted_to
    return Moved(None if fitted_to is None else fitted_to.campaign, tuple(releases), factor)
