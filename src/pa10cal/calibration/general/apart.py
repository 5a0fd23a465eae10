"""What each campaign of a group says alone of the parameters that all share.

Linear about the fit of the group: the rows of one campaign, with its own frames free, give the
parameters that it would give alone, in the unknowns of the group. Directions that it does not
determine stay where the group has them, within the reach of the unknowns, and count for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from pa10cal.arrays import Array
from pa10cal.calibration.general.fit import Fit, reach_of
from pa10cal.fit.problem import Problem
from pa10cal.results.calibration import (
    CampaignAlone,
    Difference,
    GroupOfCampaigns,
    SharedParameter,
)
from pa10cal.results.health import InputFinding
from pa10cal.terms.of_campaign import OF
from pa10cal.terms.term import Parameter

#: A parameter is determined by a campaign that knows it to this part of what it may well be.
_DETERMINED = 0.1
#: Campaigns contradict each other where chance makes such a difference more rarely than this, and
#: parameters of its own take away that part of one's squared error. A model that lacks an effect
#: differs from campaign to campaign by more than chance, and is not better for that.
_BY_CHANCE = 1e-3
_MATTERS = 0.1
_JOINT_ZERO = "delta_theta_"
_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


def contradictions(group: GroupOfCampaigns) -> tuple[InputFinding, ...]:
    """Return which campaign contradicts the others, in which parameter and by how much.

    Of several the one from which most of the error comes: a changed arm changes one campaign
    against all others, and every other against those.
    """
    found = {name: each for name, each in group.campaigns.items() if each.contradicts}
    if not found:
        return ()
    first = max(found, key=lambda name: found[name].chi_square)
    alone, worst = found[first], found[first].worst
    unit, scale = _SHOWN_UNITS.get(worst.unit, (worst.unit, 1.0))
    others = " and ".join(name for name in group.campaigns if name != first)
    return (
        InputFinding(
            what=f"{first} and {others} contradict each other: it differs by "
            f"{scale * abs(worst.value):.3g} {unit} with a standard uncertainty of "
            f"{scale * worst.std:.2g} {unit} (chi-square {alone.chi_square:.0f} for "
            f"{alone.dof:.0f} degrees of freedom, {worst.chi_square:.0f} of it by this "
            "parameter alone): the arm was changed between them",
            where=worst.name,
            remedy="calibrate the campaigns before and after the change apart, and compare them",
            kind="joint_zero" if worst.name.startswith(_JOINT_ZERO) else "campaigns",
        ),
    )


@dataclass(frozen=True)
class _Part:
    """Normal equations of some poses, free unknowns in reaches, with what is expected of them."""

    normal: Array
    gradient: Array

    @property
    def inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.normal + np.eye(len(self.normal))), dtype=float)

    def step(self) -> Array:
        return -self.inverse @ self.gradient

    def sampling(self) -> Array:
        """Return the covariance of `step`, by the noise of the rows alone."""
        inverse = self.inverse
        return np.asarray(inverse @ self.normal @ inverse)


def apart(problem: Problem, fit: Fit) -> GroupOfCampaigns | None:
    """Compare the campaigns of a group; None for a single campaign, or where nothing is shared."""
    campaign = problem.observations.states.campaign
    names = [parameter.name for parameter in problem.parameters]
    free = np.flatnonzero(~fit.at_bound)
    last = {parameter.name for parameter in problem.model.terms[-1].parameters}
    shared = [j for j, k in enumerate(free) if OF not in names[k] and names[k] not in last]
    if campaign is None or not shared:
        return None
    reach = reach_of(problem)[free]
    root = np.sqrt(fit.weights)[:, None, None] * fit.whitener
    each = []
    for number in range(len(problem.measured.campaigns)):
        at = np.flatnonzero(campaign == number)
        white = (root[at] @ fit.jacobian[at][:, :, free] * reach).reshape(-1, len(free))
        left = np.einsum("pij,pj->pi", root[at], fit.residual[at]).ravel()
        each.append(_Part(white.T @ white, white.T @ left))
    positions = problem.measured.position_columns
    parameters = [problem.parameters[k] for k in free[shared]]
    campaigns, alone = {}, {}
    for number, (name, _) in enumerate(problem.measured.campaigns):
        own, at = each[number], np.flatnonzero(campaign == number)
        rest = [part for part in each if part is not own]
        others = _Part(
            np.sum([part.normal for part in rest], axis=0),
            np.sum([part.gradient for part in rest], axis=0),
        )
        after = fit.residual[at] + fit.jacobian[at][:, :, free] @ (reach * own.step())
        rms_mm, alone_rms_mm = (
            _rms_mm(left[:, positions], fit.weights[at]) for left in (fit.residual[at], after)
        )
        chi_square, dof, worst = _difference(own, others, np.array(shared), reach, parameters)
        p_value = float(chdtrc(dof, chi_square)) if dof > 0.0 else 1.0
        gain = 1.0 - (alone_rms_mm / rms_mm) ** 2 if rms_mm > 0.0 else 0.0
        campaigns[name] = CampaignAlone(
            poses=len(at),
            rms_mm=rms_mm,
            alone_rms_mm=alone_rms_mm,
            chi_square=chi_square,
            dof=dof,
            p_value=p_value,
            contradicts=p_value < _BY_CHANCE and gain > _MATTERS,
            worst=worst,
        )
        alone[name] = np.sqrt(np.diag(own.inverse)[shared])
    std = np.sqrt(np.diag(fit.covariance)[free[shared]])
    return GroupOfCampaigns(
        campaigns=campaigns,
        parameters={
            parameter.name: SharedParameter(
                unit=parameter.unit,
                std=float(std[k]),
                std_alone={name: float(reach[at] * own[k]) for name, own in alone.items()},
                determined_by=tuple(name for name, own in alone.items() if own[k] < _DETERMINED),
            )
            for k, (at, parameter) in enumerate(zip(shared, parameters, strict=True))
        },
    )


def _difference(
    own: _Part,
    others: _Part,
    shared: NDArray[np.intp],
    reach: Array,
    parameters: Sequence[Parameter],
) -> tuple[float, float, Difference]:
    """Compare the shared parameters of one campaign with those of all others.

    Returns:
        Chi-square, its degrees of freedom, and the parameter that explains most of it.
    """
    here = np.ix_(shared, shared)
    off = (own.step() - others.step())[shared]
    sampled = (own.sampling() + others.sampling())[here]
    precision = np.linalg.inv((own.inverse + others.inverse)[here])
    pull = precision @ off
    each = pull**2 / np.diag(precision)
    worst = int(np.argmax(each))
    size, exact = reach[shared[worst]], precision[worst, worst]
    return (
        float(off @ pull),
        float(np.trace(precision @ sampled)),
        Difference(
            name=parameters[worst].name,
            unit=parameters[worst].unit,
            value=float(size * pull[worst] / exact),
            std=float(size / np.sqrt(exact)),
            chi_square=float(each[worst]),
        ),
    )


def _rms_mm(residual: Array, weights: Array) -> float:
    """Return the root mean square position error of poses, those far off weighing less."""
    return 1e3 * float(np.sqrt(np.average(np.sum(residual**2, axis=1), weights=weights)))
