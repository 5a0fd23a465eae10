"""A calibrated arm in another place: only base and tool are found anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE
from pa10cal.arm.tolerances import Tolerances
from pa10cal.calibration.general.case import base_motion
from pa10cal.calibration.general.fit import fit
from pa10cal.calibration.general.problem import start_of_tool
from pa10cal.calibration.general.start import find_start
from pa10cal.calibration.general.unknowns import choose_unknowns
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FallBack, FittedModel
from pa10cal.fit.problem import Problem
from pa10cal.observe.observations import Observations
from pa10cal.terms.fixed import fixed
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OF, about_moved_base, motion_of_base

Array = NDArray[np.float64]

#: Poses that say enough of how frames follow the arm, and how many of them are taken at once.
_ENOUGH_POSES = 2000
_AT_ONCE = 300


def refit_frames(model: FittedModel, observations: Observations) -> FittedModel:
    """Fit base and tool, or targets, of a calibrated model to other observations of the same arm.

    Args:
        model: the calibrated model; everything in it but base, tool and targets stays.
        observations: P poses of the arm, with what its terms need.

    Raises:
        CalibrationError: when the fit does not converge, or the poses do not fix the frames.
    """
    arm = model.model.chain.arm
    start = find_start(arm, observations)
    unknowns = choose_unknowns(
        arm, Tolerances(), observations.measured, start.T_instr_base, start.targets_m
    )
    arm_terms, known, columns = [], [], []
    for term in model.model.terms:
        if not (_is_tool(term.coordinates) or OF in term.of):
            own = np.arange(len(model.x))[model.model.columns_of(term)]
            arm_terms.append(term)
            known.append(fixed(term, model.x[own]))
            columns.append(own)
    of_arm = np.concatenate([np.zeros(0, dtype=np.intp), *columns])
    chain = model.model.chain
    with_frames = Model(chain, (*known, *unknowns.frames, unknowns.base))
    problem = Problem(
        with_frames,
        unknowns.places,
        start.targets_m,
        start.T_instr_base,
        observations.turned(start.R_ee_target),
    )
    x_model = np.array([start_of_tool(each.name, start) for each in with_frames.parameters])
    found = fit(problem, problem.start(x_model))
    if not found.converged:
        raise CalibrationError(
            "base and tool could not be fitted",
            where="grid poses",
            value=found.reason,
            allowed="poses that identify base and tool",
            remedy="measure more poses, with attitudes further apart",
        )
    of_model = problem.of_model(found.x)
    away = model.falls_back
    terms, frames = (*arm_terms, *unknowns.frames), len(unknowns.frame_names)
    small = base_motion(with_frames, of_model[frames:])
    covariance = None
    if model.covariance is not None:
        opened = replace(problem, model=Model(chain, (*terms, unknowns.base)))
        own = model.covariance[np.ix_(of_arm, of_arm)]
        x = np.concatenate([model.x[of_arm], found.x])
        covariance = _with_frames(opened, x, own, unknowns.base.coordinates)
    x_terms = np.concatenate([model.x[of_arm], of_model[:frames]])
    return replace(
        model,
        model=Model(chain, terms),
        x=about_moved_base(terms, x_terms, small),
        covariance=covariance,
        T_instr_base=start.T_instr_base @ motion_of_base(small),
        R_ee_target=start.R_ee_target,
        targets_m=problem.places_at(found.x),
        falls_back=None
        if away is None
        else FallBack(away.within, refit_frames(away.model, observations)),
    )


def _with_frames(problem: Problem, x: Array, of_arm: Array, base: tuple[str, ...]) -> Array:
    """Return the covariance of the arm, of frames found anew, and of the base's six motions.

    Frames follow what the arm's own parameters are off by: what they can take up of an error of the
    arm is no error of a prediction any more.

    Args:
        problem: with the terms of the arm, those of the frames and the base's own as unknowns.
        x: where the fit ended.
        of_arm: (a, a) covariance of the arm's parameters.
        base: coordinates of the base that were unknowns.
    """
    poses, own = len(problem.observations), len(of_arm)
    # Some thousand poses say how frames follow; each has a column for every parameter of a map.
    every = max(1, poses // _ENOUGH_POSES)
    normal = np.zeros((len(x) - own, len(x)))
    for first in range(0, poses, every * _AT_ONCE):
        rows = np.arange(first, min(first + every * _AT_ONCE, poses), every)
        part = replace(problem, observations=problem.observations.take(rows))
        root = np.linalg.inv(np.linalg.cholesky(part.stated_covariance))
        white = (root @ part.rows(x).jacobian).reshape(-1, len(x))
        normal += every * white[:, own:].T @ white
    of_frames = normal[:, own:]
    scale = 1.0 / np.sqrt(np.diag(of_frames))
    inverse = np.linalg.pinv(of_frames * np.outer(scale, scale)) * np.outer(scale, scale)
    follow = -inverse @ normal[:, :own]
    across = follow @ of_arm
    whole = np.block([[of_arm, across.T], [across, across @ follow.T + inverse]])
    terms = len(problem.model.parameters) - len(base)
    found = np.zeros((terms + len(BASE),) * 2)
    at = np.concatenate([np.arange(terms), terms + np.array([BASE.index(name) for name in base])])
    kept = np.arange(len(problem.model.parameters))
    found[np.ix_(at, at)] = whole[np.ix_(kept, kept)]
    return found


def _is_tool(coordinates: tuple[str, ...]) -> bool:
    return bool(coordinates) and all(name.startswith("tool.") for name in coordinates)
