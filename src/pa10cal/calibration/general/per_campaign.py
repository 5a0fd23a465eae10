"""What each campaign of a group determines alone, and how it differs from all others.

Everything is linear about the fit of the group: the rows of one campaign, with its own frames free,
give the parameters that it would give alone. Directions that a campaign does not determine stay
where the group has them, within the reach of the unknowns, and do not count. A difference may also
come of one campaign's instrument, or of its tool, whose weight bends the springs: what each cause
explains alone is worked out (`contradictions` compares them).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.rules import GROUPS, UNKNOWNS
from pa10cal.fit.loads import statics_of
from pa10cal.fit.problem import Problem
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results import calibration as records
from pa10cal.terms.statement_faults import ToolStated
from pa10cal.terms.term import TermParameter
from pa10cal.terms.wrapped import OF

#: Names of errors that a campaign's instrument may have alone; kinds of findings, too.
SCALE, RANGE_CONSTANT = "instrument_scale", "instrument_range"
#: Name of a mass of a campaign's tool that is not what is stated.
TOOL_MASS = "tool_mass"


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


class FitOfGroup(NamedTuple):
    """Where another fit than a `GeneralSolution` ended: k unknowns, P poses of b components."""

    x: Array  # (k,) the unknowns
    at_bound: Mask  # (k,) which of them are at the end of their range
    covariance: Array  # (k, k) of the unknowns
    residual: Array  # (P, b) predicted less seen
    weights: Array  # (P,) of the poses
    whitener: Array  # (P, b, b) makes their errors independent, of unit variance


@dataclass(frozen=True, eq=False)
class _Group:
    """The fit of a group of campaigns, linear in steps of its f free unknowns, in reaches."""

    problem: Problem
    fit: GeneralSolution | FitOfGroup
    payload: Payload | None  # what the arm carries, where its weight makes the torques of springs
    free: Index  # (f,) which unknowns are not at a bound
    shared: list[int]  # (s,) which of these belong to the robot, and so to every campaign

    @classmethod
    def of(
        cls, problem: Problem, fit: GeneralSolution | FitOfGroup, payload: Payload | None
    ) -> _Group:
        free = np.flatnonzero(~fit.at_bound)
        base = {parameter.name for parameter in problem.model.terms[-1].parameters}
        names = [problem.parameters[k].name for k in free]
        shared = [j for j, name in enumerate(names) if OF not in name and name not in base]
        return cls(problem, fit, payload, free, shared)

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

    def white(self, name: str, columns: Array) -> Array:
        """Return columns (p, b, k) of the p poses of a campaign as whitened rows, (p b, k)."""
        poses = self.poses[name]
        root = np.sqrt(self.fit.weights[poses])[:, None, None] * self.fit.whitener[poses]
        return np.asarray((root @ columns).reshape(-1, columns.shape[2]))

    @cached_property
    def rows(self) -> dict[str, Gaussian]:
        """Return the whitened rows of each campaign, by its name."""
        return {
            name: Gaussian.of(
                self.white(name, self.by_step[poses]),
                -self.white(name, self.fit.residual[poses][:, :, None])[:, 0],
            )
            for name, poses in self.poses.items()
        }

    def estimate(self, names: Iterable[str]) -> _Estimate:
        """Return what some campaigns say."""
        none = Gaussian.none(len(self.free))
        return _Estimate.of(sum((self.rows[name] for name in names), none))

    def rms_mm(self, poses: Index, residual: Array) -> float:
        """Return the rms position error of p poses by their residual (p, b)."""
        measured = self.problem.observations.measured
        squares = np.sum(residual[:, measured.position_columns] ** 2, axis=1)
        squares = squares / measured.targets_seen[poses]
        return 1e3 * float(np.sqrt(np.average(squares, weights=self.fit.weights[poses])))

    def explained_by(self, name: str, unit: str, what: str, by: Array) -> records.Difference:
        """Return what one more unknown, of a campaign alone, would be and explain.

        Args:
            name: of the campaign.
            unit: of the unknown.
            what: name of the unknown.
            by: (p, b) derivative of the residual of its poses by the unknown.
        """
        poses, every = self.poses[name], sum(self.rows.values(), Gaussian.none(len(self.free)))
        white = self.white(name, by[:, :, None])
        residual = self.white(name, self.fit.residual[poses][:, :, None])[:, 0]
        across = self.white(name, self.by_step[poses]).T @ white
        alone = every.of_further(across, white.T @ white, -white.T @ residual)
        information = float(alone.gram[0, 0])
        value = float(alone.projection[0]) / information
        step = every.mean - every.covariance @ across[:, 0] * value
        left = self.fit.residual + self.by_step @ step
        left[poses] += by * value
        return records.Difference(
            name=what,
            unit=unit,
            value=value,
            std=information**-0.5,
            chi_square=value**2 * information,
            left_mm=self.rms_mm(np.arange(len(left)), left),
        )

    def errors_of_instrument(self, name: str) -> Iterator[records.Difference]:
        """Yield what an error of a campaign's instrument explains: its scale, its range constant.

        The range constant is that of beams which start at the instrument, see `RangeConstant`.
        """
        measured = self.problem.observations.measured
        part, at = dict(measured.campaigns)[name], measured.parts_seen[[*self.poses].index(name)]
        columns = at[1].start + part.position_columns
        beams_m = part.places_m  # from where beams start to the targets, or their lengths
        if part.directional:
            beams_m = beams_m - measured.p_first_instr_of.get(name, np.zeros(3))
        by = np.zeros((len(beams_m), self.fit.residual.shape[1]))
        by[:, columns] = np.nan_to_num(beams_m).reshape(len(by), -1)
        yield self.explained_by(name, "1", SCALE, by)
        if part.three_axes or (part.directional and name not in measured.p_first_instr_of):
            return
        along = beams_m / np.linalg.norm(beams_m, axis=2, keepdims=True)
        by[:, columns] = np.nan_to_num(along).reshape(len(by), -1)
        yield self.explained_by(name, "m", RANGE_CONSTANT, by)

    @cached_property
    def by_tool_mass(self) -> Array:
        """Return the derivative (P, b) of the residual by the mass of the tool [m/kg, rad/kg]."""
        assert self.payload is not None
        problem, model = self.problem, self.problem.model
        x, states = problem.of_model(self.fit.x), problem.observations.states
        loads = statics_of(model, x, states, self.payload)
        tool = ToolStated("tool", True, model.chain.arm.n, self.payload.mass_kg)
        with_tool = replace(
            problem,
            model=replace(model, terms=(*model.terms, tool)),
            observations=problem.observations.with_states(replace(states, static_loads=loads)),
        )
        as_stated = np.insert(self.fit.x, len(x), np.zeros(len(tool.parameters)))
        return with_tool.rows(as_stated).jacobian[:, :, len(x)]

    def error_of_tool(self, name: str) -> records.Difference | None:
        """Return what a mass of a campaign's tool other than stated explains.

        None where nothing is stated, the poses do not show it, or the mass would be negative.
        """
        if self.payload is None:
            return None
        number = [*self.poses].index(name)
        carried = self.payload.of_campaigns[number] if self.payload.of_campaigns else self.payload
        by = self.by_tool_mass[self.poses[name]]
        if not (carried.known and by.any()):
            return None
        found = self.explained_by(name, "kg", TOOL_MASS, by)
        return found if carried.mass_kg + found.value > 0.0 else None


def per_campaign_fits(
    problem: Problem, fit: GeneralSolution | FitOfGroup, payload: Payload | None = None
) -> records.GroupOfCampaigns | None:
    """Compare the campaigns of a group; None for a single campaign, or where nothing is shared.

    Args:
        payload: what the arm carries, where the torques of springs were calculated by its weight;
            else None.
    """
    group = _Group.of(problem, fit, payload)
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
    poses = group.poses[name]
    residual = group.fit.residual[poses]
    together_mm = group.rms_mm(poses, residual)
    alone_mm = group.rms_mm(poses, residual + group.by_step[poses] @ own.step)
    p_value = by_chance(differs.chi_square, differs.dof)
    gain = 1.0 - (alone_mm / together_mm) ** 2 if together_mm > 0.0 else 0.0
    worst = group.parameters[differs.worst]
    column = group.shared[differs.worst]
    by_worst = group.by_step[poses][:, :, column] / group.reach[column]
    return records.CampaignAlone(
        poses=len(poses),
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
            left_mm=group.explained_by(name, worst.unit, worst.name, by_worst).left_mm,
        ),
        instrument=tuple(group.errors_of_instrument(name)),
        tool=group.error_of_tool(name),
    )


def by_chance(chi_square: float, dof: float) -> float:
    """Return the probability of so large a chi-square where nothing differs."""
    return float(chdtrc(dof, chi_square)) if dof > 0.0 else 1.0
