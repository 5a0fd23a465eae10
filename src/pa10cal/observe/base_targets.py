"""Targets fixed to the base or the floor, read in every configuration.

They stand still, so that what moves them together is the instrument, or the base with them. That
motion is taken out of the readings before anything else is done with these.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Rows, homogeneous, take_rows
from pa10cal.frame.point_fits import cross_matrix
from pa10cal.observe import quantities

#: Names of the components of a motion.
_MOTION = tuple(f"motion_{name}" for name in ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"))
_COV = "motion_cov_{}{}"


@dataclass(frozen=True)
class Knocked:
    """A base target that moved relative to the others."""

    targets: tuple[str, ...]  # its name; several where they explain the readings equally well
    pose: str  # label of the first configuration after the motion
    time_s: float  # of that configuration
    shift_mm: float  # distance that it moved, in the directions that can be measured

    def __str__(self) -> str:
        return (
            f"{' or '.join(self.targets)} moved by {self.shift_mm:.3f} mm against the others, "
            f"before pose {self.pose} ({self.time_s:.12g} s)"
        )


@dataclass(frozen=True)
class Misread:
    """Wrong single readings of a base target."""

    target: str  # its name
    readings: int  # number of wrong readings
    pose: str  # label of the configuration of the worst
    off_mm: float  # distance of the worst from the target

    def __str__(self) -> str:
        times = f"{self.readings} readings" if self.readings > 1 else "one reading"
        most = ", the furthest" if self.readings > 1 else ""
        off_mm = float(f"{self.off_mm:.3g}")
        return f"{times} of {self.target}{most} {off_mm:g} mm off (pose {self.pose})"


@dataclass(frozen=True)
class MotionFound:
    """How the motion of base targets was estimated."""

    # `still`: there is none; `walk`: smoothed in time; `each`: for each configuration by itself
    form: Literal["still", "walk", "each"]
    # middle of the targets in the instrument's frame, about which they turn
    about_mm: tuple[float, float, float]
    turns: bool  # whether rotation can be estimated, as by three targets that are not in line
    noise: float  # scatter of their readings over the stated uncertainty
    # targets that moved relative to the others; readings of the shorter period are not used
    knocked: tuple[Knocked, ...]
    misread: tuple[Misread, ...]  # targets with wrong readings, which are not used
    without: int  # number of configurations without usable readings


@dataclass(frozen=True)
class BaseTargets:
    """Readings of K fixed targets in P configurations, and the motion that they show."""

    names: tuple[str, ...]  # (K,) `base1` and so on
    p_instr_m: Array  # (P, K, 3) positions as read, nan where not seen
    u_m: Array  # (P, K, 3) their stated standard uncertainties
    motion: Array  # (P, 6) shift [m] and turn [rad] of the readings, about `found.about_mm`
    motion_cov: Array  # (P, 6, 6) covariance of the motion
    found: MotionFound | None = None  # how the motion was estimated; None where it is not yet

    @classmethod
    def read(cls, names: tuple[str, ...], p_instr_m: Array, u_m: Array) -> BaseTargets:
        """Return targets whose motion is not yet estimated."""
        count = len(p_instr_m)
        return cls(names, p_instr_m, u_m, np.zeros((count, 6)), np.zeros((count, 6, 6)))

    def take(self, rows: Rows) -> BaseTargets:
        """Return the targets in these configurations."""
        return take_rows(self, rows, "names", "found")

    @property
    def T_moved(self) -> Array:
        """Return the motion as transforms (P, 4, 4) in the instrument's frame.

        They move positions at rest to those that were read.
        """
        R = Rotation.from_rotvec(self.motion[:, 3:]).as_matrix()
        return homogeneous(R, self.about_m + self.motion[:, :3] - R @ self.about_m)

    @property
    def about_m(self) -> Array:
        """Return the point (3,) about which the targets turn."""
        return quantities.MM * np.array(self.found.about_mm if self.found else (0.0, 0.0, 0.0))

    @property
    def cov_at_origin(self) -> Array:
        """Return the covariance (P, 6, 6) of shift and turn about the origin of the instrument."""
        to_origin = np.eye(6)
        to_origin[:3, 3:] = cross_matrix(self.about_m)
        return np.asarray(to_origin @ self.motion_cov @ to_origin.T)

    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return the readings and their motion as columns (P,) of the table of poses."""
        columns = quantities.columns_of_places(self.names, self.p_instr_m)
        columns |= quantities.columns_of_places([f"{name}_u" for name in self.names], self.u_m)
        columns |= dict(zip(_MOTION, (self.motion / quantities.MM_RAD_TO_SI).T, strict=True))
        return columns | quantities.columns_of_covariance(self.motion_cov, _COV)

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, NDArray[Any]], found: MotionFound | None
    ) -> BaseTargets | None:
        """Return the targets of a table's columns; None where it has none.

        Raises:
            KeyError: for a column that is missing.
        """
        if _MOTION[0] not in columns:
            return None
        names = tuple(
            name.removesuffix("_x_mm") for name in columns if re.fullmatch(r"base\d+_x_mm", name)
        )
        if not names:
            raise KeyError("base1_x_mm")
        return cls(
            names,
            quantities.places_of(columns, names),
            quantities.places_of(columns, [f"{name}_u" for name in names]),
            quantities.MM_RAD_TO_SI * np.column_stack([columns[name] for name in _MOTION]),
            quantities.covariance_of(columns, _COV),
            found,
        )
