"""What each campaign of a group determines alone, and whether campaigns contradict each other.

Everything is linear about the fit of the group: the rows of one campaign, with its own frames free,
give the parameters that it would give alone. Directions that a campaign does not determine stay
where the group has them, within the reach of the unknowns, and do not count.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from pa10cal.arrays import Array
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.rules import GROUPS, UNKNOWNS
from pa10cal.fit.problem import Problem
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results import calibration as records
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.of_campaign import OF

#: Unit in which a parameter is shown, and the factor to it (unit).
_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


class _Estimate(NamedTuple):
    """What some campaigns say of the f free unknowns, as a step from the fit of the group."""

    step: Array  # (f,) in reaches
    covariance: Array  # (f, f) with the prior of the reaches
    sampling: Array  # (f, f) covariance of the step by noise alone

    @classmethod
    def of(cls, rows: Gaussian) -> _Estimate:
        covariance = rows.covariance
        return cls(rows.mean, covariance, covariance @ rows.gram @ covariance)


class _Difference(NamedTuple):
    """How a campaign differs from all others in the s shared parameters."""

    chi_square: float
    dof: float  # effective degrees of freedom
    worst: int  # which parameter explains most of it
    by_one: float  # chi-square of this one alone
    value: float  # its difference
    std: float  # standard uncertainty of that

    @classmethod
    def between(
        cls, own: _Estimate, others: _Estimate, shared: list[int], reach: Array
    ) -> _Difference:
        square = np.ix_(shared, shared)
        precision = np.linalg.inv((own.covariance + others.covariance)[square])
        off = (own.step - others.step)[shared]
        pull = precision @ off
        by_one = pull**2 / np.diag(precision)
        k = int(np.argmax(by_one))
        return cls(
            chi_square=float(off @ pull),
            dof=float(np.trace(precision @ (own.sampling + others.sampling)[square])),
            worst=k,
            by_one=float(by_one[k]),
            value=float(reach[k] * pull[k] / precision[k, k]),
            std=float(reach[k] / np.sqrt(precision[k, k])),
        )


def per_campaign_fits(problem: Problem, fit: GeneralSolution) -> records.GroupOfCampaigns | None:
    """Compare the campaigns of a group; None for a single campaign, or where nothing is shared."""
    campaign, measured = problem.observations.states.campaign, problem.observations.measured
    free = np.flatnonzero(~fit.at_bound)
    base = {parameter.name for parameter in problem.model.terms[-1].parameters}
    names = [problem.parameters[k].name for k in free]
    shared = [j for j, name in enumerate(names) if OF not in name and name not in base]
    if campaign is None or not shared:
        return None
    parameters = [problem.parameters[k] for k in free[shared]]
    reach = reach_of(problem)[free]
    size = reach[shared]
    root = np.sqrt(fit.weights)[:, None, None] * fit.whitener
    jacobian = problem.rows(fit.x).jacobian[:, :, free]
    poses_of = [np.flatnonzero(campaign == k) for k in range(len(measured.campaigns))]
    rows_of = []  # of each campaign, in steps of the free unknowns in reaches
    for poses in poses_of:
        white = (root[poses] @ jacobian[poses] * reach).reshape(-1, len(free))
        residual = np.einsum("pij,pj->pi", root[poses], fit.residual[poses]).ravel()
        rows_of.append(Gaussian.of(white, -residual))
    none = Gaussian.none(len(free))

    def rms_mm(residual: Array, weights: Array) -> float:
        squares = np.sum(residual[:, measured.position_columns] ** 2, axis=1)
        return 1e3 * float(np.sqrt(np.average(squares, weights=weights)))

    campaigns, std_alone = {}, {}
    for number, (name, _) in enumerate(measured.campaigns):
        poses = poses_of[number]
        own = _Estimate.of(none + rows_of[number])
        others = (rows for k, rows in enumerate(rows_of) if k != number)
        differs = _Difference.between(own, _Estimate.of(sum(others, none)), shared, size)
        residual_alone = fit.residual[poses] + jacobian[poses] @ (reach * own.step)
        together_mm = rms_mm(fit.residual[poses], fit.weights[poses])
        alone_mm = rms_mm(residual_alone, fit.weights[poses])
        p_value = float(chdtrc(differs.dof, differs.chi_square)) if differs.dof > 0.0 else 1.0
        gain = 1.0 - (alone_mm / together_mm) ** 2 if together_mm > 0.0 else 0.0
        campaigns[name] = records.CampaignAlone(
            poses=len(poses),
            rms_mm=together_mm,
            alone_rms_mm=alone_mm,
            chi_square=differs.chi_square,
            dof=differs.dof,
            p_value=p_value,
            contradicts=p_value < GROUPS.chance_rate and gain > GROUPS.matters_share,
            worst=records.Difference(
                name=parameters[differs.worst].name,
                unit=parameters[differs.worst].unit,
                value=differs.value,
                std=differs.std,
                chi_square=differs.by_one,
            ),
        )
        std_alone[name] = np.sqrt(np.diag(own.covariance)[shared])
    std = np.sqrt(np.diag(fit.covariance)[free[shared]])
    return records.GroupOfCampaigns(
        campaigns=campaigns,
        parameters={
            parameter.name: records.SharedParameter(
                unit=parameter.unit,
                std=float(std[k]),
                std_alone={name: float(size[k] * own[k]) for name, own in std_alone.items()},
                determined_by=tuple(
                    n for n, own in std_alone.items() if own[k] < UNKNOWNS.determined_share
                ),
            )
            for k, parameter in enumerate(parameters)
        },
    )


def contradictions(
    group: records.GroupOfCampaigns, zeros: Collection[str]
) -> tuple[InputFinding, ...]:
    """Return which campaign contradicts the others, in which parameter and by how much.

    Only the campaign with the largest chi-square is reported: if the arm was changed before one
    campaign, each of the others contradicts the rest too, as that campaign is among it.

    Args:
        zeros: names of the parameters that are zeros of joints.
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
            kind="joint_zero" if worst.name in zeros else "campaigns",
        ),
    )
