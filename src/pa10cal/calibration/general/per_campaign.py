"""What each campaign of a group determines alone, and whether campaigns contradict each other.

Everything is linear about the fit of the group: the rows of one campaign, with its own frames free,
give the parameters that it would give alone. Directions that a campaign does not determine stay
where the group has them, within the reach of the unknowns, and do not count.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from pa10cal.arrays import Array, Index
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.rules import GROUPS, UNKNOWNS
from pa10cal.fit.problem import Problem
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results import calibration as records
from pa10cal.results.calibration import InputFinding
from pa10cal.terms.of_campaign import OF
from pa10cal.terms.term import TermParameter

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


@dataclass(frozen=True, eq=False)
class _Group:
    """The fit of a group of campaigns, linear in steps of its f free unknowns, in reaches."""

    problem: Problem
    fit: GeneralSolution
    free: Index  # (f,) which unknowns are not at a bound
    shared: list[int]  # (s,) which of these belong to the robot, and so to every campaign

    @classmethod
    def of(cls, problem: Problem, fit: GeneralSolution) -> _Group:
        free = np.flatnonzero(~fit.at_bound)
        base = {parameter.name for parameter in problem.model.terms[-1].parameters}
        names = [problem.parameters[k].name for k in free]
        shared = [j for j, name in enumerate(names) if OF not in name and name not in base]
        return cls(problem, fit, free, shared)

    @cached_property
    def parameters(self) -> list[TermParameter]:
        """Return the shared parameters, (s,)."""
        return [self.problem.parameters[k] for k in self.free[self.shared]]

    @cached_property
    def reach(self) -> Array:
        """Return the reach of each free unknown, (f,)."""
        return reach_of(self.problem)[self.free]

    @cached_property
    def poses(self) -> dict[str, Index]:
        """Return the poses of each campaign, by its name."""
        observations = self.problem.observations
        names = [name for name, _ in observations.measured.campaigns]
        campaign = observations.states.campaign
        return {name: np.flatnonzero(campaign == k) for k, name in enumerate(names)}

    @cached_property
    def by_step(self) -> Array:
        """Return the derivative (P, b, f) of the residual by a step in reaches."""
        return self.problem.rows(self.fit.x).jacobian[:, :, self.free] * self.reach

    @cached_property
    def rows(self) -> dict[str, Gaussian]:
        """Return the whitened rows of each campaign, by its name."""
        root = np.sqrt(self.fit.weights)[:, None, None] * self.fit.whitener
        rows = {}
        for name, poses in self.poses.items():
            white = (root[poses] @ self.by_step[poses]).reshape(-1, len(self.free))
            residual = np.einsum("pij,pj->pi", root[poses], self.fit.residual[poses]).ravel()
            rows[name] = Gaussian.of(white, -residual)
        return rows

    def estimate(self, names: Iterable[str]) -> _Estimate:
        """Return what some campaigns say."""
        none = Gaussian.none(len(self.free))
        return _Estimate.of(sum((self.rows[name] for name in names), none))

    def rms_mm(self, name: str, step: Array) -> float:
        """Return the rms position error of a campaign after a step (f,) of the unknowns."""
        poses = self.poses[name]
        columns = self.problem.observations.measured.position_columns
        residual_m = (self.fit.residual[poses] + self.by_step[poses] @ step)[:, columns]
        squares = np.sum(residual_m**2, axis=1)
        return 1e3 * float(np.sqrt(np.average(squares, weights=self.fit.weights[poses])))


def per_campaign_fits(problem: Problem, fit: GeneralSolution) -> records.GroupOfCampaigns | None:
    """Compare the campaigns of a group; None for a single campaign, or where nothing is shared."""
    group = _Group.of(problem, fit)
    if problem.observations.states.campaign is None or not group.shared:
        return None
    alone = {name: group.estimate([name]) for name in group.poses}
    of_shared = group.free[group.shared]
    std = np.sqrt(np.diag(fit.covariance)[of_shared])
    std_alone = {
        name: np.sqrt(np.diag(own.covariance)[group.shared]) for name, own in alone.items()
    }
    size = group.reach[group.shared]
    return records.GroupOfCampaigns(
        campaigns={name: _campaign_alone(group, name, own) for name, own in alone.items()},
        parameters={
            parameter.name: records.SharedParameter(
                unit=parameter.unit,
                std=float(std[k]),
                std_alone={name: float(size[k] * own[k]) for name, own in std_alone.items()},
                determined_by=tuple(
                    n for n, own in std_alone.items() if own[k] < UNKNOWNS.determined_share
                ),
            )
            for k, parameter in enumerate(group.parameters)
        },
    )


def _campaign_alone(group: _Group, name: str, own: _Estimate) -> records.CampaignAlone:
    """Return how a campaign differs from all others, by its own estimate."""
    others = group.estimate(other for other in group.poses if other != name)
    differs = _Difference.between(own, others, group.shared, group.reach[group.shared])
    together_mm = group.rms_mm(name, np.zeros(len(group.free)))
    alone_mm = group.rms_mm(name, own.step)
    p_value = float(chdtrc(differs.dof, differs.chi_square)) if differs.dof > 0.0 else 1.0
    gain = 1.0 - (alone_mm / together_mm) ** 2 if together_mm > 0.0 else 0.0
    worst = group.parameters[differs.worst]
    return records.CampaignAlone(
        poses=len(group.poses[name]),
        rms_mm=together_mm,
        alone_rms_mm=alone_mm,
        chi_square=differs.chi_square,
        dof=differs.dof,
        p_value=p_value,
        contradicts=p_value < GROUPS.chance_rate and gain > GROUPS.matters_share,
        worst=records.Difference(
            name=worst.name,
            unit=worst.unit,
            value=differs.value,
            std=differs.std,
            chi_square=differs.by_one,
        ),
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
