"""What each campaign of a group says alone of the parameters that all share.

Linear about the fit of the group: the rows of one campaign, with its own frames free, give the
parameters that it would give alone, in the unknowns of the group. Directions that it does not
determine stay where the group has them, within the reach of the unknowns, and count for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from pa10cal.arrays import Array
from pa10cal.calibration.general.fit import Fit, reach_of
from pa10cal.fit.problem import Problem
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


@dataclass(frozen=True)
class Alone:
    """What one campaign gives without the others."""

    name: str  # of the campaign
    poses: int  # how many it has
    rms_mm: float  # remaining position error of its poses in the fit of the group
    alone_rms_mm: float  # the same with parameters of its own
    off: Array  # (s,) its shared parameters less those of all others together
    u_off: Array  # (s,) standard uncertainty of that
    std: Array  # (s,) standard uncertainty of its shared parameters
    determined: NDArray[np.bool_]  # (s,) which of them it determines
    chi_square: float  # of its difference from the others
    dof: float  # directions of shared parameters that both determine
    worst: int  # number of the one parameter that, if it alone differed, explains most
    worst_off: float  # by how much it then differs
    worst_u: float  # standard uncertainty of that
    worst_chi_square: float  # how much of the chi-square it explains

    @property
    def p_value(self) -> float:
        """Return the probability of such a difference where nothing differs."""
        return float(chdtrc(self.dof, self.chi_square)) if self.dof > 0.0 else 1.0

    @property
    def gain(self) -> float:
        """Return the part of the squared error that parameters of its own take away."""
        return 1.0 - (self.alone_rms_mm / self.rms_mm) ** 2 if self.rms_mm > 0.0 else 0.0

    @property
    def contradicts(self) -> bool:
        """Return whether it contradicts the others: the arm was changed in between."""
        return self.p_value < _BY_CHANCE and self.gain > _MATTERS


@dataclass(frozen=True)
class Apart:
    """The campaigns of a group, each alone."""

    shared: tuple[Parameter, ...]  # the s parameters that all share
    std: Array  # (s,) their standard uncertainties by all together
    campaigns: tuple[Alone, ...]  # each alone

    @property
    def contradictions(self) -> tuple[InputFinding, ...]:
        """Return which campaign contradicts the others, in which parameter and by how much.

        Of several the one from which most of the error comes: a changed arm changes one campaign
        against all others, and every other against those.
        """
        found = [each for each in self.campaigns if each.contradicts]
        if not found:
            return ()
        worst = max(found, key=lambda each: each.chi_square)
        parameter = self.shared[worst.worst]
        unit, scale = _SHOWN_UNITS.get(parameter.unit, (parameter.unit, 1.0))
        others = " and ".join(each.name for each in self.campaigns if each is not worst)
        return (
            InputFinding(
                what=f"{worst.name} and {others} contradict each other: it differs by "
                f"{scale * abs(worst.worst_off):.3g} {unit} with a standard uncertainty of "
                f"{scale * worst.worst_u:.2g} {unit} (chi-square {worst.chi_square:.0f} for "
                f"{worst.dof:.0f} degrees of freedom, {worst.worst_chi_square:.0f} of it by this "
                "parameter alone): the arm was changed between them",
                where=parameter.name,
                remedy="calibrate the campaigns before and after the change apart, and compare "
                "them",
                kind="joint_zero" if parameter.name.startswith(_JOINT_ZERO) else "campaigns",
                would_leave_mm=None,
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


def apart(problem: Problem, fit: Fit) -> Apart | None:
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
    found = []
    for number, (name, _) in enumerate(problem.measured.campaigns):
        rest = [part for k, part in enumerate(each) if k != number]
        others = _Part(
            np.sum([part.normal for part in rest], axis=0),
            np.sum([part.gradient for part in rest], axis=0),
        )
        at = np.flatnonzero(campaign == number)
        own = each[number].step()
        after = fit.residual[at] + fit.jacobian[at][:, :, free] @ (reach * own)
        before = fit.residual[at][:, positions]
        found.append(
            _alone(
                name,
                (each[number], others),
                np.array(shared),
                reach,
                (_rms_mm(before, fit.weights[at]), _rms_mm(after[:, positions], fit.weights[at])),
                len(at),
            )
        )
    kept = free[shared]
    std = np.sqrt(np.diag(fit.covariance)[kept])
    return Apart(tuple(problem.parameters[k] for k in kept), std, tuple(found))


def _alone(
    name: str,
    parts: tuple[_Part, _Part],
    shared: NDArray[np.intp],
    reach: Array,
    rms_mm: tuple[float, float],
    poses: int,
) -> Alone:
    """Compare one campaign with all others."""
    own, others = parts
    here = np.ix_(shared, shared)
    size = reach[shared]
    off = (own.step() - others.step())[shared]
    width = (own.inverse + others.inverse)[here]
    sampled = (own.sampling() + others.sampling())[here]
    precision = np.linalg.inv(width)
    pull = precision @ off
    each = pull**2 / np.diag(precision)
    worst = int(np.argmax(each))
    std = np.sqrt(np.diag(own.inverse)[shared])
    return Alone(
        name=name,
        poses=poses,
        rms_mm=rms_mm[0],
        alone_rms_mm=rms_mm[1],
        off=size * off,
        u_off=size * np.sqrt(np.diag(width)),
        std=size * std,
        determined=std < _DETERMINED,
        chi_square=float(off @ pull),
        dof=float(np.trace(precision @ sampled)),
        worst=worst,
        worst_off=float(size[worst] * pull[worst] / precision[worst, worst]),
        worst_u=float(size[worst] / np.sqrt(precision[worst, worst])),
        worst_chi_square=float(each[worst]),
    )


def _rms_mm(residual: Array, weights: Array) -> float:
    """Return the root mean square position error of poses, those far off weighing less."""
    return 1e3 * float(np.sqrt(np.average(np.sum(residual**2, axis=1), weights=weights)))
