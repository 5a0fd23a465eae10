"""Torsional spring of a joint, paper equation (1): the term, and its deflection in closed form."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, TypeGuard

import numpy as np
from pydantic import Field

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.options import Tolerances
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures
from pa10cal.terms.term import OPTIONAL, Report, Role, Term, TermParameter, Traits

#: Sizes by which the solver scales, near the uncertainties of a good campaign.
_WINDUP_SCALE_RAD = 1e-5
_SHARE_SCALE = 1e-2
#: Ends of the physical range: a joint that counts as rigid, one too soft to carry an arm [rad],
#: and a spring that is all but cubic.
_RIGID_RAD = 1e-7
_SOFTEST_RAD = 0.1
_LARGEST_SHARE = 0.95


def stiffness_by_solved(roles: Sequence[Role], x: Array) -> Array:
    """Return the derivative (k, k) of the parameters, springs as stiffness, by the solved ones.

    Up to the reference torques, which correlations do not show. Roles and values (k,) are those of
    the solved ones, of a spring with its cubic share after its windup.
    """
    derivative = np.eye(len(roles))
    for row in (row for row, role in enumerate(roles) if role == "windup"):
        cubic = roles[row + 1 : row + 2] == ("cubic",)
        rows = [row, row + 1] if cubic else [row]
        spring = JointSpring(1, 1.0, cubic)  # of whichever joint
        by_solved = spring.report(x[rows]).jacobian[: len(rows)]
        derivative[np.ix_(rows, rows)] = by_solved
    return derivative


@dataclass(frozen=True)
class JointSpring(Traits):
    """A spring between motor and link of one joint, under the measured torque.

    Solved in its windup at a reference torque and the share of the cubic part there, which stay
    bounded and nearly independent however few data there are; reported as K_lin and K_cub.
    Stiffness is positive, as the paper requires.
    """

    joint: int  # 1 … n
    # reference torque, best the largest that the joint carried
    tau_ref_Nm: Annotated[float, Field(gt=0.0)]
    cubic: bool = True  # whether K_cub is an unknown; a linear spring has K_cub = 0
    # windup to be expected; None where any is as likely
    plausible_rad: float | None = field(default=None, metadata={OPTIONAL: True})
    id: ClassVar[str] = "joint_spring"
    yields: ClassVar[bool] = True

    @property
    def of(self) -> str:
        return f"joint {self.joint}"

    @property
    def formula(self) -> str:
        return f"theta_{self.joint} -= delta, tau_{self.joint} = K_lin delta + K_cub delta^3"

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        windup = TermParameter(
            f"windup_{self.joint}",
            "rad",
            _WINDUP_SCALE_RAD,
            lower=_RIGID_RAD,
            upper=_SOFTEST_RAD,
            plausible=self.plausible_rad,
        )
        share = TermParameter(
            f"cubic_share_{self.joint}", "1", _SHARE_SCALE, lower=0.0, upper=_LARGEST_SHARE
        )
        return (windup, share) if self.cubic else (windup,)

    @property
    def roles(self) -> tuple[Role, ...]:
        return ("windup", "cubic") if self.cubic else ("windup",)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.joint}",)

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(-x[0] * self._unit(states, x).x[:, None])

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift`, (P, 1, k), by the implicit-function theorem."""
        unit = self._unit(states, x)
        slopes = [-unit.x, -x[0] * unit.by_share]
        return np.stack(slopes[: len(x)], axis=-1)[:, None, :]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        unit = self._unit(states, x)
        share = float(x[1]) if self.cubic else 0.0
        return np.asarray(-x[0] / self.tau_ref_Nm / ((1.0 - share) + 3.0 * share * unit.x**2))

    def report(self, x: Array) -> Report:
        windup, share = x[0], x[1] if self.cubic else 0.0
        tau = self.tau_ref_Nm
        names = (
            TermParameter(f"K_lin_{self.joint}", "N m/rad", 1e3),
            TermParameter(f"K_cub_{self.joint}", "N m/rad^3", 1e7),
        )
        values = tau * np.array([(1.0 - share) / windup, share / windup**3])
        jacobian = tau * np.array(
            [
                [-(1.0 - share) / windup**2, -1.0 / windup],
                [-3.0 * share / windup**4, 1.0 / windup**3],
            ]
        )
        zero = frozenset[str]() if self.cubic else frozenset({names[1].name})
        return Report(names, values, jacobian[:, : len(x)], by_weights=values, zero=zero)

    def only(self, names: Collection[str]) -> JointSpring:
        """Return the spring, linear where its cubic share is not named."""
        return replace(self, cubic=self.cubic and self.parameters[-1].name in names)

    def restated(self, other: Term, x: Array) -> tuple[Array, Array]:
        """Return the spring solved at another reference torque in that of this one."""
        there = other.report(x)
        here = self.solved(float(there.values[0]), float(there.values[1]))
        by_here = self.report(here).jacobian[: len(x)]
        change = np.linalg.solve(by_here, there.jacobian[: len(x)]).astype(np.float64, copy=False)
        return here, change

    def scattered(self, generator: np.random.Generator, spread: float) -> Array:
        """Return a usual spring at spread 0; at 1 its stiffness is scattered over a decade.

        It starts soft in its cubic part: from a hard one the solver can run into a purely cubic
        spring, which is a minimum too, but not the lowest.
        """
        k_lin = 1e4 * 10.0 ** (spread * generator.uniform(-0.5, 0.5))
        k_cub = 1e6 * 10.0 ** (spread * generator.uniform(-1.0, 1.0))
        return self.solved(k_lin, k_cub)

    def solved(self, k_lin: float, k_cub: float) -> Array:
        """Return the solved parameters of a spring of known stiffness."""
        windup = float(deflection_rad(np.array([self.tau_ref_Nm]), k_lin, k_cub)[0])
        return np.array([windup, k_cub * windup**3 / self.tau_ref_Nm][: 2 if self.cubic else 1])

    def _unit(self, states: PoseStates, x: Array) -> UnitDeflection:
        share = float(x[1]) if self.cubic else 0.0
        return unit_deflection(states.tau_Nm[:, self.joint - 1] / self.tau_ref_Nm, share)


def is_spring(term: Term) -> TypeGuard[JointSpring]:
    """Return whether a term is a spring of which something is unknown."""
    return "windup" in term.roles


# The paper's model: link departures and a spring on each flexible joint.

#: Torque at which springs are stated of joints whose rated torque is not known.
_UNRATED_NM = 100.0


def baseline(
    arm: Arm,
    flexible_joints: tuple[int, ...],
    tolerances: Tolerances,
    *,
    cubic: bool = True,
    tau_ref_Nm: Array | None = None,
) -> Model:
    """Build the paper's model of an arm (Section II.C, Table I).

    Args:
        flexible_joints: joints 1 … n with a spring; the others are rigid.
        cubic: whether the springs have a cubic coefficient.
        tau_ref_Nm: (n,) torques at which the springs' solved parameters are stated, best the
            largest in the data; the rated torques where None, or a
            common size where those are not known. The model is the same.

    Raises:
        CalibrationError: when a flexible joint is not one of the arm's that turn.
    """
    for joint in flexible_joints:
        there = 1 <= joint <= arm.n
        if not there or arm.prismatic[joint - 1]:
            raise CalibrationError(
                "the joint is prismatic, and springs are torsional" if there else "no such joint",
                where="calibration.flexible_joints",
                value=joint,
                allowed=f"1 to {arm.n}, and a joint that turns",
                remedy="correct the list",
            )
    tau_Nm = arm.rated_Nm(np.full(arm.n, _UNRATED_NM)) if tau_ref_Nm is None else tau_ref_Nm
    springs = tuple(
        JointSpring(joint, float(tau_Nm[joint - 1]), cubic)
        for joint in sorted(set(flexible_joints))
    )
    return Model(Chain.of(arm), (link_departures(arm, tolerances), *springs))


def nominal(arm: Arm) -> Model:
    """Build the nominal rigid model, without any parameter."""
    return Model(Chain.of(arm), ())


# The spring of a joint, paper equation (1) tau = K_lin delta + K_cub delta^3, in closed form.

#: Below this s t^2 the root is t + s (t - t^3) to rounding.
_SERIES_SUFFICES = 1e-9
#: Below this ratio of cubic to linear part a spring is linear to rounding.
_LINEAR = 1e-18
#: Reported stiffness by the parameter that is solved in its place.
_REPORTED = {"windup": "K_lin", "cubic_share": "K_cub"}


def reported_name(name: str) -> str:
    """Return what readers call a solved parameter: `K_cub_3` for `cubic_share_3`; others as is."""
    kind, _, joint = name.rpartition("_")
    return f"{_REPORTED[kind]}_{joint}" if kind in _REPORTED else name


@dataclass(frozen=True)
class UnitDeflection:
    """Deflection of a spring in units of that under the reference torque."""

    x: Array  # (P,) the root
    by_share: Array  # (P,) its derivative by the cubic share


def unit_deflection(t: Array, share: float) -> UnitDeflection:
    """Solve (1 - s) x + s x^3 = t for x; 0 <= s < 1 the share, t (P,) the torques."""
    if share * max(1.0, float(np.max(t**2, initial=0.0))) <= _SERIES_SUFFICES:
        x = t + share * (t - t**3)
    else:
        # Cardano in its hyperbolic form has no cancellation; one Newton step removes rounding.
        reach = np.sqrt(3.0 * share / (1.0 - share))
        x = 2.0 / reach * np.sinh(np.arcsinh(1.5 * reach * t / (1.0 - share)) / 3.0)
        square = x * x  # a third power costs as much as all the rest
        x = x - ((1.0 - share) * x + share * x * square - t) / (
            (1.0 - share) + 3.0 * share * square
        )
    square = x * x
    slope = (1.0 - share) + 3.0 * share * square
    return UnitDeflection(x, (x - x * square) / slope)


def deflection_rad(tau_Nm: Array, k_lin: float, k_cub: float) -> Array:
    """Solve tau = K_lin delta + K_cub delta^3 for delta, (P,) [rad].

    K_lin > 0 in N m/rad, K_cub >= 0 in N m/rad^3.
    """
    linear = tau_Nm / k_lin
    if k_cub * np.max(linear**2, initial=0.0) <= _LINEAR * k_lin:
        return linear
    unit_rad = np.sqrt(k_lin / k_cub)
    # In this unit linear and cubic part are equal at x = 1: s = 1/2, t = tau / (2 K_lin unit).
    return np.asarray(unit_rad * unit_deflection(tau_Nm / (2.0 * k_lin * unit_rad), 0.5).x)
