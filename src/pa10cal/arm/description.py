"""The nominal description of an arm: Denavit-Hartenberg rows, limits, masses and their uncertainty.

An arm described without masses still sags under its weight. It gets masses and centres assumed
from its lengths alone (`fit.uncertain_weights`), with uncertainties as wide as they are unknown, so
that torques and moments can be computed. Its poses then determine only stiffness over weight.

Hayati's beta replaces d between neighbouring joint axes that are nearly parallel. There the common
normal is not defined: with plain Denavit-Hartenberg rows a small tilt of one axis gives an offset d
of any length. With Ry(beta) every deviation stays small (paper, Section II.C). No degree of freedom
is lost: along parallel axes the offsets of both joints, revolute or prismatic, move the end alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.coupling import CoupledJoint, Coupling
from pa10cal.arrays import Array
from pa10cal.errors import ArmError
from pa10cal.rules import SIZES

WeightsFrom = Literal["stated", "total", "assumed", "logged"]

#: Standard uncertainty of a stated mass, relative, and of its centre, per axis, in an arm of usual
#: size [m].
STATED_MASS = 0.06
STATED_COM_M = 0.01
#: Largest number of joints: the longest snake robots have a third.
MOST_ROWS = 100
#: Axes closer than this to parallel count as such.
NEARLY_PARALLEL_RAD = float(np.radians(5.0))
#: Longest link: booms of cranes reach as far, and arms of which lengths are in millimetres farther.
LONGEST_M = 100.0
#: An arm that reaches less far has no length, but for rounding.
LEAST_REACH_M = 1e-6
#: Least torque that counts as rated, relative to the largest that any joint carried.
_LEAST_RATED = 0.05
#: Fields of an arm with one entry a row.
ROW_FIELDS = (
    "theta_rad",
    "d_m",
    "a_m",
    "alpha_rad",
    "beta_rad",
    "hayati",
    "prismatic",
    "limits_rad",
    "gear_ratio",
    "torque_limit_Nm",
    "mass_kg",
    "com_m",
)


@dataclass(frozen=True)
class WeighedByLog:
    """Differences of the weights from those stated, estimated from logged torques.

    Their order is that of the columns of `StaticLoads.by_weights`: mass and first moments of every
    link, mass of the tool, two tilts of gravity.
    """

    x: Array  # (4 n + 3,) the differences
    covariance: Array  # (4 n + 3, 4 n + 3) of the differences
    # which mass the log contradicts, with both numbers, gains, zeros and friction of torques; empty
    # for none
    said: str = ""
    # (n,) zeros of the logged torques, 0 where not shown; empty where no joint shows one
    zero_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # (n,) friction that they hold by the direction of arrival, 0 where not shown, and its standard
    # uncertainty; empty where no joint shows any
    friction_Nm: Array = field(default_factory=lambda: np.zeros(0))
    u_friction_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # (n,) gains of the logged torques, which are 1 + gain times those of the weights, 0 where not
    # shown, and their standard uncertainties; empty where no joint shows one
    gain: Array = field(default_factory=lambda: np.zeros(0))
    u_gain: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class WeightsKnown:
    """How well the weights of the links are known."""

    # `stated`: in the description; `total`: only the mass of the whole arm is stated; `assumed`:
    # from the lengths of the links; `logged`: stated, but logged torques contradict them
    origin: WeightsFrom
    mass: Array  # (n,) standard uncertainty of each mass, relative
    com_m: Array  # (n,) standard uncertainty of each centre of mass, per axis
    why: str = ""  # why they are not taken as stated, one clause; empty where they are
    by_log: WeighedByLog | None = None  # for stated weights where torques were logged

    @property
    def assumed(self) -> bool:
        """Return whether link masses are assumed, so that stiffness is known relative to them."""
        return self.origin in ("assumed", "total")


def weights_known(arm: Arm) -> WeightsKnown:
    """Return how well an arm's weights are known; where it does not say, as makers state them."""
    if arm.weights_known is not None:
        return arm.weights_known
    com_m = np.full(arm.n, STATED_COM_M * arm.size_ratio)
    return WeightsKnown("stated", np.full(arm.n, STATED_MASS), com_m)


@dataclass(frozen=True)
class Controller:
    """The arm by which a robot's controller converts between joint positions and poses."""

    compensation: bool  # whether it uses an individual calibration by the maker
    known: bool  # whether that arm is known
    arm: Arm | None = None  # that arm; None where it is not known, or is the one described


@dataclass(frozen=True)
class Arm:
    """A serial arm of n joints as its maker describes it."""

    name: str  # identifier used by campaigns
    title: str  # name shown to readers
    # `standard`: Rz(theta) Tz(d) Tx(a) Rx(alpha); `modified`: Rx Tx Rz Tz
    convention: Literal["standard", "modified"]
    theta_rad: Array  # (n,) joint offsets
    d_m: Array  # (n,) offsets along z
    a_m: Array  # (n,) lengths along x
    alpha_rad: Array  # (n,) twists
    # (n,) whether the row's deviation is in Ry(beta), at its end (`standard`) or start
    # (`modified`), and not in d; see `with_hayati_rows`
    hayati: NDArray[np.bool_]
    prismatic: NDArray[np.bool_]  # (n,) whether the joint slides along its z axis
    # (n, 2) joint limits (metres for a prismatic joint), as the controller counts them
    limits_rad: Array
    gear_ratio: Array  # (n,) motor turns a joint turn; nan where not known
    # (n,) rated joint torques (newtons for a prismatic joint); nan where not known
    torque_limit_Nm: Array
    mass_kg: Array | None  # (n,) link masses, or None where they are not known
    com_m: Array | None  # (n, 3) centres of mass in the frame of the link's own row, or None
    # (n,) nominal beta of the rows; empty for none
    beta_rad: Array = field(default_factory=lambda: np.zeros(0))
    # (4, 4) pose of the frame that the first row starts from, in the base [m]
    T_base_row1: Array = field(default_factory=lambda: np.eye(4))
    # (4, 4) pose of the end-effector in the frame of the last row [m]
    T_row_n_ee: Array = field(default_factory=lambda: np.eye(4))
    # how well masses and centres are known; None: as makers state them
    weights_known: WeightsKnown | None = None
    # whether joints of the arm carry its base, so that gravity turns with it: no weights are known
    base_moves: bool = False
    # joints that move with the axis of another; empty where every joint is an axis
    coupled: tuple[CoupledJoint, ...] = ()
    # notes for the user: rows that were replaced, or the origin of an arm known by name
    remarks: tuple[str, ...] = ()
    # what the controller computes with; None where it is not stated: presumably these rows
    controller: Controller | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.theta_rad)

    @cached_property
    def coupling(self) -> Coupling:
        """Return how joint positions follow from those of the m axes that the controller counts."""
        return Coupling(self.n, self.coupled)

    @property
    def controller_arm(self) -> Arm | None:
        """Return the arm that the controller computes with; None where it is not known."""
        if self.controller is None:
            return self
        if not self.controller.known:
            return None
        return self.controller.arm or self

    @property
    def axes_slide(self) -> NDArray[np.bool_]:
        """Return whether each axis slides, (m,)."""
        return self.prismatic[self.coupling.own]

    @property
    def axis_limits_rad(self) -> Array:
        """Return the limits of the axes, (m, 2)."""
        return self.limits_rad[self.coupling.own]

    @property
    def joint_ranges_rad(self) -> Array:
        """Return the least and largest position of each joint within the limits, (n, 2)."""
        return self.coupling.joint_ranges(self.axis_limits_rad)

    @property
    def reach_m(self) -> float:
        """Return an upper bound of the end-effector's distance from the base's origin."""
        slide_m = np.abs(self.joint_ranges_rad).max(axis=1)[self.prismatic].sum()
        ends = self.T_base_row1[:3, 3], self.T_row_n_ee[:3, 3]
        return float(np.hypot(self.a_m, self.d_m).sum() + slide_m + sum(map(np.linalg.norm, ends)))

    @property
    def size_ratio(self) -> float:
        """Return the extent of the arm over that of arms on which usual sizes [m] were found.

        One within the range of these. The extent is the reach without strokes, or the longest
        stroke.
        """
        slides_m = np.abs(self.joint_ranges_rad).max(axis=1)[self.prismatic]
        longest_m = float(np.ptp(self.joint_ranges_rad, axis=1)[self.prismatic].max(initial=0.0))
        extent_m = max(self.reach_m - float(slides_m.sum()), longest_m)
        return extent_m / float(np.clip(extent_m, *SIZES.extent_m)) or 1.0

    def rated_Nm(self, carried_Nm: Array) -> Array:
        """Return the rated torques (n,); where not known, the largest that the joint carried.

        Args:
            carried_Nm: (n,) largest torque that each joint carried; nan where not known.
        """
        carried_Nm = np.nan_to_num(carried_Nm)
        seen_Nm = np.maximum(carried_Nm, _LEAST_RATED * carried_Nm.max())
        return np.where(np.isnan(self.torque_limit_Nm), seen_Nm, self.torque_limit_Nm)

    def __post_init__(self) -> None:
        n = len(self.theta_rad)
        if n > MOST_ROWS:
            raise ArmError(
                "the arm has too many rows",
                where=self.name,
                value=n,
                allowed=f"at most {MOST_ROWS}, one a joint",
                remedy="describe one arm",
            )
        if not len(self.beta_rad):
            object.__setattr__(self, "beta_rad", np.zeros(n))
        for name in ROW_FIELDS:
            value = getattr(self, name)
            if value is not None and len(value) != n:
                raise ArmError(
                    f"{name} has {len(value)} entries for {n} rows",
                    where=self.name,
                    allowed=f"{n} entries, one a joint",
                    remedy="complete the arm description",
                )
        lengths_of = {
            f"row {row}": np.array([self.a_m[row - 1], self.d_m[row - 1]])
            for row in range(1, n + 1)
        }
        lengths_of |= {"base": self.T_base_row1[:3, 3], "tool": self.T_row_n_ee[:3, 3]}
        for name, lengths_m in lengths_of.items():
            if np.abs(lengths_m).max() > LONGEST_M:
                raise ArmError(
                    f"a link is longer than {LONGEST_M:g} m",
                    where=f"{self.name}: {name}",
                    value=float(lengths_m[np.abs(lengths_m).argmax()]),
                    allowed="lengths in metres",
                    remedy="divide by 1000 if the lengths are in millimetres",
                )


@dataclass(frozen=True)
class NeighbouringAxes:
    """The axes of two successive joints."""

    joints: tuple[int, int]  # their numbers, from 1
    row: int  # the row, from 1, whose alpha and beta lead from one axis to the other
    angle_rad: float  # angle between the axes as lines, 0 to pi/2

    @property
    def parallel(self) -> bool:
        """Whether the axes are parallel or nearly so."""
        return self.angle_rad < NEARLY_PARALLEL_RAD


def neighbouring_axes(arm: Arm) -> tuple[NeighbouringAxes, ...]:
    """Return the angles between the axes of joints 1 and 2, 2 and 3, …, in that order."""
    # alpha and beta precede the joint of their row in the modified form, and follow it in the
    # standard form.
    after = 1 if arm.convention == "modified" else 0
    pairs = []
    for joint in range(1, arm.n):
        row = joint + after
        alpha_rad, beta_rad = arm.alpha_rad[row - 1], arm.beta_rad[row - 1]
        across = np.hypot(np.sin(beta_rad), np.sin(alpha_rad) * np.cos(beta_rad))
        along = np.abs(np.cos(alpha_rad) * np.cos(beta_rad))
        pairs.append(NeighbouringAxes((joint, joint + 1), row, float(np.arctan2(across, along))))
    return tuple(pairs)


def with_hayati_rows(arm: Arm) -> Arm:
    """Return the arm with Hayati's beta in place of d in every row between near-parallel axes."""
    hayati = np.zeros(arm.n, dtype=bool)
    for axes in neighbouring_axes(arm):
        hayati[axes.row - 1] = axes.parallel
    return replace(arm, hayati=hayati)
