"""Two models of one made-up robot, as two campaigns would find it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from made_up_model import fitted, fitted_to
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import link_departures, tool_frame

#: Standard uncertainty of every parameter, of its typical size.
PART = 0.02


def parts(arm):
    return (link_departures(arm, Tolerances()), JointSpring(2, 80.0), tool_frame())


def campaign(seed, name="june", robot="pa10_6ce", terms=parts):
    """Return the same robot as measured in a campaign: parameters off by their uncertainty."""
    true = fitted(robot, 3, terms)
    scale = np.concatenate([PART * true.model.scale, np.full(6, 1e-5)])
    x = true.x + np.random.default_rng(seed).normal(0.0, scale[:-6])
    about = fitted_to(name, loads_N=(0.0, 22.0), health="as the noise")
    return replace(true, x=x, covariance=np.diag(scale**2), fitted_to=about)


def shifted(model, **by):
    """Return a model with some parameters moved."""
    x = model.x.copy()
    names = [parameter.name for parameter in model.model.parameters]
    for name, step in by.items():
        x[names.index(name)] += step
    return replace(model, x=x)
