"""An instrument that gives position and attitude of one target: a 6-D tracker."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.csv_rows import RawRows, numbers
from pa10cal.campaign.length_unit import scale_of_points
from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.campaign.outliers import Misfit
from pa10cal.campaign.pose_rows import MeasuredColumns, PoseRows
from pa10cal.frame.hand_eye import hand_eye_from_poses

Array = NDArray[np.float64]

PLACE = ("x_mm", "y_mm", "z_mm")
ATTITUDE = ("qw", "qx", "qy", "qz")
#: An attitude without a stated uncertainty is as sure as targets this far apart make it.
TARGET_SPREAD_MM = 100.0


@dataclass(frozen=True)
class PoseTracker:
    """A 6-D tracker.

    Attributes:
        uncertainty_mm: standard uncertainty of a position that states none.
    """

    uncertainty_mm: float

    @property
    def columns(self) -> MeasuredColumns:
        """Position and attitude."""
        names = (*PLACE, *ATTITUDE)
        return MeasuredColumns(names, PLACE, may_be_blank=False, checked=_with_unit_quaternions)

    @property
    def targets(self) -> tuple[tuple[str, ...], ...]:
        """The one position."""
        return (PLACE,)

    @property
    def notes(self) -> tuple[str, ...]:
        """None."""
        return ()

    @property
    def least_rows(self) -> int:
        """Four times those that fix base and target."""
        return 8

    def places_mm(self, rows: PoseRows) -> Array:
        """Return the target's position, (N, 1, 3)."""
        return rows.measured[:, None, :3]

    def scale(self, rows: PoseRows, T_base_ee: Array) -> float | None:
        """Return how far the nominal model moves for one measured millimetre."""
        return scale_of_points(rows.measured[:, :3], T_base_ee)

    def misfit(
        self, rows: PoseRows, T_base_ee: Array, used: NDArray[np.intp], weights: Array
    ) -> Misfit:
        """Return the misfit of positions and attitudes."""
        seen = self._T_cmm_target(rows)
        seen[:, :3, 3] *= 1e-3
        found = hand_eye_from_poses(T_base_ee[used], seen[used], weights=weights)
        modelled = found.targets(T_base_ee)[:, 0]
        length_mm = 1e3 * np.linalg.norm(seen[:, :3, 3] - modelled[:, :3, 3], axis=1)
        turn = Rotation.from_matrix(seen[:, :3, :3] @ np.swapaxes(modelled[:, :3, :3], 1, 2))
        return Misfit(length_mm[:, None], np.degrees(turn.magnitude()))

    def with_seen(self, poses: MeasuredPoses, rows: PoseRows) -> MeasuredPoses:
        """Add the target's pose and its covariance."""
        return replace(
            poses, T_instr_ee_mm=self._T_cmm_target(rows), cov_ee_mm=self._covariance(rows)
        )

    def _T_cmm_target(self, rows: PoseRows) -> Array:
        T = np.tile(np.eye(4), (len(rows), 1, 1))
        T[:, :3, 3] = rows.measured[:, :3]
        T[:, :3, :3] = Rotation.from_quat(rows.measured[:, 3:], scalar_first=True).as_matrix()
        return T

    def _covariance(self, rows: PoseRows) -> Array:
        """Return (N, 6, 6) from stated uncertainties, or from that of a centre where none are.

        A small rotation w on the left changes the quaternion by half its product with it, so that
        w is twice the vector part of dq q*.
        """
        cov = np.zeros((len(rows), 6, 6))
        p_u_mm, quaternion_u = rows.measured_u[:, :3], rows.measured_u[:, 3:]
        p_u_mm = np.where(np.isnan(p_u_mm), self.uncertainty_mm, p_u_mm)
        cov[:, range(3), range(3)] = p_u_mm**2
        length = np.linalg.norm(rows.measured[:, 3:], axis=1, keepdims=True)
        quaternion, quaternion_u = rows.measured[:, 3:] / length, quaternion_u / length
        scalar, vector = quaternion[:, :1, None], quaternion[:, 1:]
        cross = np.cross(vector[:, None, :], np.eye(3))  # rows v x e_k: the transpose of [v]x
        by_vector = scalar * np.eye(3) + np.swapaxes(cross, 1, 2)
        turning = 2.0 * np.concatenate([-vector[:, :, None], by_vector], axis=2)
        stated = turning @ (quaternion_u[:, :, None] ** 2 * np.swapaxes(turning, 1, 2))
        unstated = np.isnan(quaternion_u.sum(axis=1))
        assumed = (self.uncertainty_mm / TARGET_SPREAD_MM) ** 2 * np.eye(3)
        cov[:, 3:, 3:] = np.where(unstated[:, None, None], assumed, stated)
        return cov


def _with_unit_quaternions(raw: RawRows) -> RawRows:
    _, quaternion = numbers(raw, ATTITUDE)
    length = np.linalg.norm(quaternion, axis=1)
    keep = np.abs(length - 1.0) < 0.01
    values = [f"length {value:.4g}" for value in length[~keep]]
    return raw.take(keep, "the quaternion is not of unit length", values)
