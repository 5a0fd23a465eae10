"""A calibrated arm in another place: only base and tool are found anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
from pa10cal.terms.fixed import Fixed
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OF, about_moved_base, motion_of_base


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
    fixed, first = [], 0
    for term in model.model.terms:
        width = len(term.parameters)
        if not (_is_tool(term.coordinates) or OF in term.of):
            fixed.append(Fixed(term, model.x[first : first + width]))
        first += width
    chain = model.model.chain
    with_frames = Model(chain, (*fixed, *unknowns.frames, unknowns.base))
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
    terms, own = (*fixed, *unknowns.frames), len(unknowns.frame_names)
    small = base_motion(with_frames, of_model[own:])
    return replace(
        model,
        model=Model(chain, terms),
        x=about_moved_base(terms, of_model[:own], small),
        T_instr_base=start.T_instr_base @ motion_of_base(small),
        R_ee_target=start.R_ee_target,
        targets_m=problem.places_at(found.x),
        falls_back=None
        if away is None
        else FallBack(away.within, refit_frames(away.model, observations)),
    )


def _is_tool(coordinates: tuple[str, ...]) -> bool:
    return bool(coordinates) and all(name.startswith("tool.") for name in coordinates)
