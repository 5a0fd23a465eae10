"""Fitted models made up of terms and values, and what becomes of poses made up."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from made_up_poses import context_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.calibrate import find_start
from pa10cal.calibration.general.case import general_case
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage
from pa10cal.options import Tolerances
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures, tool_frame

PAYLOAD = Payload(2.4, np.array([0.01, 0.0, 0.05]), np.zeros(3), np.array([0.0, 0.0, -9.81]))


def postures(arm, seed, count=7):
    rng = np.random.default_rng(seed)
    low, high = np.clip(arm.limits_rad, -2.5, 2.5).T
    return rng.uniform(low, high, (count, arm.n))


def vocabulary(arm):
    """Every term that can be made of the arm: links, a spring, the tool, all effects everywhere."""
    context = context_of(arm, largest_tau_Nm=np.full(arm.n, 50.0), commanded=False)
    effects = [
        effect
        for effect in candidates(context)
        if not (effect.id == "transmission_error" and np.isnan(arm.gear_ratio).any())
    ]
    spring = [JointSpring(2, 80.0)] if not arm.prismatic[1] else []
    return (link_departures(arm, Tolerances()), *spring, tool_frame(), *effects)


def fitted(robot, seed, terms=None):
    arm, rng = load_arm(robot), np.random.default_rng(seed)
    terms = vocabulary(arm) if terms is None else terms(arm)
    values = []
    for term in terms:
        x = (
            0.5
            * np.array([p.scale for p in term.parameters])
            * rng.normal(size=len(term.parameters))
        )
        if isinstance(term, JointSpring):
            x = term.solved(3e4, 1e7)
        elif hasattr(term, "starts"):
            x[getattr(term, "linear", 0) :] = term.starts[-1][getattr(term, "linear", 0) :]
            x = np.clip(
                x, [p.lower if p.lower is not None else -np.inf for p in term.parameters], np.inf
            )
        values.append(x)
    x = np.concatenate(values)
    root = 1e-7 * rng.normal(size=(len(x) + 6, 3))
    return FittedModel(
        model=Model(Chain.of(arm, bends=tuple(range(1, arm.n))), terms),
        x=x,
        T_instr_base=np.eye(4),
        covariance=root @ root.T,
        payload=PAYLOAD,
        fitted_to=fitted_to("c1"),
        seen=AngleCoverage(tuple(np.array([[-1.0, 1.0]]) for _ in range(arm.n)), (False,) * arm.n),
    )


def on_springs(robot, stiffness, payload, links=None):
    """Return an arm whose joints give way by stiffness [N m/rad], links as designed."""
    arm = load_arm(robot)
    offsets = link_departures(arm, Tolerances())
    offsets = offsets if links is None else offsets.only(links)
    springs = tuple(JointSpring(joint, 50.0, cubic=False) for joint in stiffness)
    values = [spring.solved(k, 0.0) for spring, k in zip(springs, stiffness.values(), strict=True)]
    x = np.concatenate([np.zeros(len(offsets.parameters)), *values])
    model, covariance = Model(Chain.of(arm), (offsets, *springs)), np.eye(len(x) + 6) * 1e-12
    return FittedModel(model, x, np.eye(4), payload=payload, covariance=covariance)


def fitted_to(campaign, **changes):
    """Return what a model was fitted to."""
    usual = {"provenance": "synthetic", "calibration": "combined", "instrument": "pose"}
    poses = {"poses": 81, "temperature_C": 21.5, "time_s": (10.0, 3000.0), "grade": "good"}
    return FittedTo(campaign=campaign, **{**usual, **poses, **changes})


def case_of(arm, every):
    """Return record and fit of all poses with the general model, of a campaign without weights."""
    campaign = SimpleNamespace(
        name="made-up", provenance="made up", robot=arm.name, payload=lambda _arm: None
    )
    start = find_start(arm, every)
    return general_case(LoadCase(campaign, arm, every, "combined", CalibrationOptions()), start)
