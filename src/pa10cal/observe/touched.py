"""Tooling balls, located by touches: they give the pose of the end-effector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.arm.statics import ObservedTargets
from pa10cal.arrays import Array, Index
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import Located, fit_rigid_weighted, pose_by_source, seed_from_nominal
from pa10cal.observe.instrument import MM, POSE_SCALE, LocatingMethod, group_means
from pa10cal.observe.pose import Pose, pose_of_columns
from pa10cal.observe.quantities import (
    Stated,
    Words,
    columns_of_places,
    names_of_columns,
    places_of_columns,
)

#: Balls nearer to one line than this do not show a turn about it.
_COLLINEAR_MM = 1.0


@dataclass(frozen=True)
class Touched(Pose):
    """Pose of the end-effector in P poses, through the centres of B tooling balls."""

    names: tuple[str, ...]  # (B,) names of the balls
    p_instr_balls_m: Array  # (P, B, 3) centres of the balls in the instrument's frame
    cov_balls_m2: Array  # (P, B, 3, 3) their covariances
    touches: NDArray[np.int64]  # (P, B) touches behind each centre

    kind: ClassVar[str] = "touch_trigger_cmm"
    locates_by: ClassVar[LocatingMethod] = "rigid_fit_nominal"
    words: ClassVar[Words] = Words(
        "coordinate measuring machine that touches balls on the end-effector",
        "position error",
        "Errors are distances of the end-effector, predicted from measured.",
        "Arrows: of the end-effector.",
    )
    from_touches: ClassVar[bool] = True
    sees_base: ClassVar[bool] = False
    _of_all: ClassVar[tuple[str, ...]] = ("names",)

    @classmethod
    def of_balls(
        cls,
        names: tuple[str, ...],
        p_ee_balls_mm: Array,
        p_instr_balls_mm: Array,
        cov_balls_mm2: Array,
        touches: NDArray[np.int64],
    ) -> Touched:
        """Fit the end-effector to located balls, weighted by their covariances.

        Args:
            names: (B,) names of the balls.
            p_ee_balls_mm: (B, 3) their stated places on the end-effector.
            p_instr_balls_mm: (P, B, 3) their centres.
            cov_balls_mm2: (P, B, 3, 3) covariances of the centres.
            touches: (P, B) touches behind each centre.
        """
        found = fit_rigid_weighted(p_ee_balls_mm, p_instr_balls_mm, cov_balls_mm2)
        T = found.T.copy()
        T[:, :3, 3] *= MM
        cov = found.covariance * np.outer(POSE_SCALE, POSE_SCALE)
        p_m, cov_m2 = MM * p_instr_balls_mm, MM**2 * cov_balls_mm2
        return Touched(T, cov, pose_by_source(T, p_m, cov_m2), names, p_m, cov_m2, touches)

    @classmethod
    @override
    def foreseen(cls, T_instr_ee: Array, stated: Stated) -> Touched:
        """Return the end-effector as the balls stated would give it, each as certain as stated.

        Raises:
            CalibrationError: when there are fewer than three balls, or they are collinear.
        """
        names = tuple(stated.targets_m)
        p_ee_mm = np.array([*stated.targets_m.values()]).reshape(-1, 3) / MM
        if np.linalg.matrix_rank(p_ee_mm - p_ee_mm.mean(axis=0), tol=_COLLINEAR_MM) < 2:
            raise CalibrationError(
                "these balls do not give an orientation",
                where="targets",
                value=p_ee_mm.tolist(),
                allowed="three or more that are not collinear",
                remedy="state the places of three balls",
            )
        turned = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], p_ee_mm)
        p_instr_mm = T_instr_ee[:, None, :3, 3] / MM + turned
        cov_mm2 = (stated.uncertainty_m / MM) ** 2 * np.eye(3)
        cov_mm2 = np.broadcast_to(cov_mm2, (*p_instr_mm.shape, 3))
        touches = np.ones(p_instr_mm.shape[:2], dtype=np.int64)
        return cls.of_balls(names, p_ee_mm, p_instr_mm, cov_mm2, touches)

    @override
    def averaged(self, code: Index) -> Self:
        count = np.bincount(code)
        return replace(
            super().averaged(code),
            p_instr_balls_m=group_means(self.p_instr_balls_m, code),
            cov_balls_m2=group_means(self.cov_balls_m2, code) / count[:, None, None, None],
            touches=np.rint(group_means(self.touches.astype(float), code) * count[:, None]).astype(
                np.int64
            ),
        )

    @override
    def in_frame(self, T: Array) -> Self:
        R = T[:3, :3]
        return replace(
            super().in_frame(T),
            p_instr_balls_m=self.p_instr_balls_m @ R.T + T[:3, 3],
            cov_balls_m2=R @ self.cov_balls_m2 @ R.T,
        )

    @property
    @override
    def counts(self) -> tuple[str, ...]:
        return (f"{self.touches.size} balls",)

    @override
    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        """Return where the balls were; see `Pose.readout`.

        Args:
            targets_m: (t,) stated places of the balls; none to take them from the readings.
        """
        if not len(targets_m):
            R, origin = self.T_instr_target[:, :3, :3], self.T_instr_target[:, None, :3, 3]
            targets_m = np.mean((self.p_instr_balls_m - origin) @ R, axis=0).ravel()
        return super().readout(T_instr_ee, targets_m)

    @override
    def locate(self, T_base_ee: Array) -> Located:
        return seed_from_nominal(self.T_instr_target[:, :3, 3], T_base_ee[:, :3, 3])

    @override
    def target_on(self, T_instr_base: Array, T_base_ee: Array) -> Array | None:
        return None

    @classmethod
    @override
    def from_columns(cls, columns: Mapping[str, Array], stated: Stated) -> Self:
        T, cov = pose_of_columns(columns)
        names = names_of_columns(columns)
        p_m, cov_m2, touches = places_of_columns(columns, names)
        return cls(T, cov, pose_by_source(T, p_m, cov_m2), names, p_m, cov_m2, touches)

    @override
    def to_columns(self) -> dict[str, NDArray[Any]]:
        balls = columns_of_places(self.names, self.p_instr_balls_m, self.cov_balls_m2, self.touches)
        return balls | super().to_columns()
