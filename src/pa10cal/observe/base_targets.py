"""Targets that are fixed to the base or the floor, read with every configuration.

They stand still, so that what moves them together is the instrument, or the base with them. The
motion is taken out of the readings before anything else is done with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.frame.pose_error import cross_matrix
from pa10cal.observe.quantities import Rows

_AXES = "xyz"
_MM = 1e-3
#: Names of the components of a motion, and what one unit of each column is.
_MOTION = tuple(f"motion_{name}" for name in ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"))
_SCALE = np.array([_MM, _MM, _MM, 1.0, 1.0, 1.0])
_COV = "motion_cov"
_UPPER = tuple((i, j) for i in range(6) for j in range(i, 6))


@dataclass(frozen=True)
class Knocked:
    """A base target that moved against the others."""

    targets: tuple[str, ...]  # its name; several where they explain what was seen equally well
    pose: str  # label of the first configuration after it
    time_s: float
    shift_mm: float  # how far, in the directions that show

    def __str__(self) -> str:
        return (
            f"{' or '.join(self.targets)} moved by {self.shift_mm:.3f} mm against the others, "
            f"before pose {self.pose} ({self.time_s:g} s)"
        )


@dataclass(frozen=True)
class Misread:
    """Single readings that are not of their base target."""

    target: str  # its name
    readings: int  # how many of them
    pose: str  # label of the configuration of the furthest
    off_mm: float  # how far that is from where the target stands

    def __str__(self) -> str:
        times = f"{self.readings} readings" if self.readings > 1 else "one reading"
        most = ", the furthest" if self.readings > 1 else ""
        return f"{times} of {self.target}{most} {self.off_mm:.3g} mm off (pose {self.pose})"


@dataclass(frozen=True)
class MotionFound:
    """How the motion of base targets was found."""

    form: str  # `still`: none shows; `walk`: smoothed in time; `each`: each configuration by itself
    # middle of the targets in the instrument's frame, about which they turn
    about_mm: tuple[float, float, float]
    turns: bool  # whether they show turns, as three that are not in line do
    noise: float  # scatter of their readings over the stated uncertainty
    # targets that moved against the others; their readings of the shorter stretch are not used
    knocked: tuple[Knocked, ...]
    misread: tuple[Misread, ...]  # targets with wrong readings, which are not used
    without: int  # configurations without a reading that could be used

    def plain(self) -> dict[str, Any]:
        """Return it in plain data."""
        return asdict(self)

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> MotionFound:
        """Read what `plain` gave."""
        knocked = tuple(
            Knocked(tuple(each["targets"]), each["pose"], each["time_s"], each["shift_mm"])
            for each in plain["knocked"]
        )
        misread = tuple(Misread(**each) for each in plain["misread"])
        x, y, z = plain["about_mm"]
        return cls(**{**plain, "about_mm": (x, y, z), "knocked": knocked, "misread": misread})


@dataclass(frozen=True)
class BaseTargets:
    """K fixed targets as they were read in P configurations, and the motion that they show."""

    names: tuple[str, ...]  # (K,) their names, `base1` and so on
    p_instr_m: Array  # (P, K, 3) as read, nan where one was not seen
    u_m: Array  # (P, K, 3) stated standard uncertainties
    motion: Array  # (P, 6) shift [m] and turn [rad] of what was read, about `found.about_mm`
    motion_cov: Array  # (P, 6, 6) their covariance
    found: MotionFound | None = None  # how they were found; None where they were not looked at yet

    @classmethod
    def read(cls, names: tuple[str, ...], p_instr_m: Array, u_m: Array) -> BaseTargets:
        """Return targets whose motion is not known."""
        count = len(p_instr_m)
        return cls(names, p_instr_m, u_m, np.zeros((count, 6)), np.zeros((count, 6, 6)))

    def take(self, rows: Rows) -> BaseTargets:
        """Return some of the configurations."""
        return replace(
            self,
            p_instr_m=self.p_instr_m[rows],
            u_m=self.u_m[rows],
            motion=self.motion[rows],
            motion_cov=self.motion_cov[rows],
        )

    @property
    def T_moved(self) -> Array:
        """Return the motion (P, 4, 4) of all that the instrument read."""
        T = np.tile(np.eye(4), (len(self.motion), 1, 1))
        T[:, :3, :3] = Rotation.from_rotvec(self.motion[:, 3:]).as_matrix()
        about_m = self.about_m
        T[:, :3, 3] = about_m + self.motion[:, :3] - T[:, :3, :3] @ about_m
        return T

    @property
    def about_m(self) -> Array:
        """Return the point (3,) about which they turn."""
        return _MM * np.array(self.found.about_mm if self.found else (0.0, 0.0, 0.0))

    @property
    def cov_at_origin(self) -> Array:
        """Return the covariance (P, 6, 6) of shift and turn about the origin of the instrument."""
        to_origin = np.eye(6)
        to_origin[:3, 3:] = cross_matrix(self.about_m)
        found: Array = to_origin @ self.motion_cov @ to_origin.T
        return found

    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return columns (P,) of the table of poses."""
        columns: dict[str, NDArray[Any]] = {}
        for k, name in enumerate(self.names):
            for i, axis in enumerate(_AXES):
                columns[f"{name}_{axis}_mm"] = self.p_instr_m[:, k, i] / _MM
                columns[f"{name}_u_{axis}_mm"] = self.u_m[:, k, i] / _MM
        columns |= dict(zip(_MOTION, (self.motion / _SCALE).T, strict=True))
        return columns | columns_of_covariance(self.motion_cov, _COV)

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, NDArray[Any]], found: MotionFound | None
    ) -> BaseTargets | None:
        """Read what `to_columns` gave; None where a table has no base targets."""
        if _MOTION[0] not in columns:
            return None
        names = tuple(
            name.removesuffix("_x_mm")
            for name in columns
            if name.startswith("base") and name.endswith("_x_mm") and "_u_" not in name
        )

        def places_m(inner: str) -> Array:
            return _MM * np.stack(
                [
                    np.column_stack([columns[f"{name}_{inner}{axis}_mm"] for axis in _AXES])
                    for name in names
                ],
                axis=1,
            )

        cov = covariance_of(columns, _COV)
        assert cov is not None
        return cls(
            names,
            places_m(""),
            places_m("u_"),
            _SCALE * np.column_stack([columns[name] for name in _MOTION]),
            cov,
            found,
        )


def columns_of_covariance(cov: Array, name: str) -> dict[str, NDArray[Any]]:
    """Return covariances (P, 6, 6) of small motions [m, rad] as columns of a table of poses."""
    in_table = cov / np.outer(_SCALE, _SCALE)
    return {f"{name}_{i}{j}": in_table[:, i, j] for i, j in _UPPER}


def covariance_of(columns: Mapping[str, NDArray[Any]], name: str) -> Array | None:
    """Read what `columns_of_covariance` gave; None where there is none."""
    if f"{name}_00" not in columns:
        return None
    cov = np.zeros((len(columns[f"{name}_00"]), 6, 6))
    for i, j in _UPPER:
        cov[:, i, j] = cov[:, j, i] = columns[f"{name}_{i}{j}"]
    return np.asarray(cov * np.outer(_SCALE, _SCALE))
