"""Instruments that measure position and orientation: a 6-D tracker, and balls that are touched."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pa10cal.arm.statics import ObservedTargets
from pa10cal.arrays import Array, Index, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
from pa10cal.frame import point_fits
from pa10cal.frame.hand_eye import Located, hand_eye_from_poses, seed_from_nominal, target_on_base
from pa10cal.frame.target_problem import scale_of_points, target_misfit_bound_m
from pa10cal.observe import quantities
from pa10cal.observe.base_targets import BaseTargets
from pa10cal.observe.instrument import Instrument, LocatingMethod, group_means
from pa10cal.observe.points import Points
from pa10cal.rules import READINGS

RAW_PLACE = ("x_mm", "y_mm", "z_mm")
RAW_QUATERNION = ("qw", "qx", "qy", "qz")

_PLACE = ("ee_x_mm", "ee_y_mm", "ee_z_mm")
_QUATERNION = ("ee_qw", "ee_qx", "ee_qy", "ee_qz")
_COVARIANCE = "ee_cov_{}{}"


@dataclass(frozen=True)
class Pose(Instrument):
    """Position and orientation of one target in P poses."""

    # (P, 4, 4) target in the instrument's frame [m]; for touched balls the end-effector itself, by
    # the balls' stated positions
    T_instr_target: Array
    # (P, 6, 6) covariance of position [m] and of a small rotation [rad] applied on the left, both
    # along the instrument's axes
    cov: Array
    # (P, 6, a) derivative of the measured pose (position, small left rotation) by the a stated
    # coordinates of targets on an apparatus [m], whose errors are the same in every pose; a = 0
    # where the instrument measures the pose itself
    by_apparatus: Array
    # (P, 6, 6) covariance of a shift [m] and a turn [rad] about the instrument's origin, as of
    # `Points`, which `cov` contains: repeats have that error in common; None for none
    motion_cov: Array | None = field(default=None, kw_only=True)
    # (3, 3) axes of the target along which it was measured, in those of `T_instr_target`, where the
    # instrument's poses in the target's frame were, as by a camera on the tool; None: they were not
    inverse_axes: Array | None = field(default=None, kw_only=True)

    kind: ClassVar[str] = "pose"
    locates_by: ClassVar[LocatingMethod] = "hand_eye_poses"
    words: ClassVar[quantities.Words] = quantities.Words(
        "tracker that measures position and orientation of a target",
        "position error",
        "Errors are distances of the target, predicted from measured.",
        "Arrows: of the target.",
    )
    component_kinds: ClassVar[tuple[tuple[str, slice], ...]] = (
        ("position", slice(0, 3)),
        ("attitude", slice(3, 6)),
    )
    measures_pose: ClassVar[bool] = True
    sees_base: ClassVar[bool] = True
    uses_lines: ClassVar[bool] = True
    least_rows: ClassVar[int] = READINGS.pose_rows
    _of_all: ClassVar[tuple[str, ...]] = ("inverse_axes",)

    @classmethod
    def of(cls, T_instr_target: Array, cov: Array) -> Pose:
        """Return poses that are measured directly, not by targets of an apparatus."""
        return Pose(T_instr_target, cov, np.zeros((len(cov), 6, 0)))

    def averaged(self, code: Index) -> Self:
        T = group_means(self.T_instr_target, code)
        T[:, :3, :3] = nearest_rotation(T[:, :3, :3])
        return replace(
            self.take(np.unique(code, return_index=True)[1]),
            T_instr_target=T,
            cov=group_means(self.cov - self._in_common, code) / np.bincount(code)[:, None, None]
            + group_means(self._in_common, code),
            motion_cov=None if self.motion_cov is None else group_means(self.motion_cov, code),
            by_apparatus=group_means(self.by_apparatus, code),
        )

    @property
    def noise_axes(self) -> Index:
        return np.arange(6)

    @property
    def inverse(self) -> bool:
        return self.inverse_axes is not None

    @property
    def _in_common(self) -> Array:
        """Return the part of the covariance that repeats have in common, (P, 6, 6)."""
        if self.motion_cov is None:
            return np.zeros_like(self.cov)
        along = self._by_motion
        return np.asarray(along @ self.motion_cov @ along.swapaxes(1, 2))

    @property
    def _by_motion(self) -> Array:
        """Return the derivative (P, 6, 6) by a shift and a turn about the instrument's origin."""
        by_motion = np.tile(np.eye(6), (len(self), 1, 1))
        by_motion[:, :3, 3:] = -point_fits.cross_matrix(self.T_instr_target[:, :3, 3])
        return by_motion

    def along_noise_axes(self) -> Array:
        if self.inverse_axes is None:
            return super().along_noise_axes()
        # The inverse (R', p') of a pose (R, p) is (R^T, -R^T p): an error d of p' and a small left
        # rotation w of R' shift p by -R d + p x (R w) and turn R by -R w.
        R, p_m = self.T_instr_target[:, :3, :3] @ self.inverse_axes, self.T_instr_target[:, :3, 3]
        by_inverse = np.zeros((len(self), 6, 6))
        by_inverse[:, :3, :3] = by_inverse[:, 3:, 3:] = -R
        by_inverse[:, :3, 3:] = point_fits.cross_matrix(p_m) @ R
        return np.asarray(np.linalg.inv(by_inverse), dtype=np.float64)

    def with_noise_along_axes(self, u_place_m: Array | None, u_turn_rad: Array | None) -> Self:
        to_axes = self.along_noise_axes()
        cov = to_axes @ (self.cov - self._in_common) @ to_axes.swapaxes(1, 2)
        for u, part in ((u_place_m, slice(0, 3)), (u_turn_rad, slice(3, 6))):
            if u is not None:
                cov[:, part] = cov[:, :, part] = 0.0
                cov[:, part, part] = np.eye(3) * (u**2)[..., None, :]
        back = np.linalg.inv(to_axes)
        return replace(self, cov=back @ cov @ back.swapaxes(1, 2) + self._in_common)

    def less_certain(self, times: Array) -> Self:
        # The six components of a pose are measured together, and so have the same factor.
        own = (self.cov - self._in_common) * times[:, :1, None]
        return replace(self, cov=own + self._in_common)

    def steadied(self, base: BaseTargets) -> Self:
        # Motions of the base are small: the covariance is not turned by them.
        T = np.linalg.inv(base.T_moved) @ self.T_instr_target
        still = replace(self, T_instr_target=T)
        return still.with_end_uncertain(base.cov_at_origin, still.places_m)

    def with_end_uncertain(self, motion_cov: Array, places_m: Array) -> Self:
        noise = self._by_motion @ motion_cov @ self._by_motion.swapaxes(1, 2)
        before = 0.0 if self.motion_cov is None else self.motion_cov
        return replace(self, cov=self.cov + noise, motion_cov=before + motion_cov)

    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Pose:
        return Pose.of(T_instr_ee, np.broadcast_to(np.eye(6), (len(T_instr_ee), 6, 6)))

    @classmethod
    def foreseen(cls, T_instr_ee: Array, stated: quantities.StatedByCampaign) -> Pose:
        """Return the poses of the first stated target; of the end of the chain without one."""
        T = T_instr_ee.copy()
        for place_m in list(stated.targets_m.values())[:1]:
            T[:, :3, 3] += T[:, :3, :3] @ place_m
        u_rad = u_of_attitude(stated)
        cov = np.diag(np.repeat([stated.uncertainty_m**2, u_rad**2], 3))
        return Pose.of(T, np.broadcast_to(cov, (len(T), 6, 6)))

    def compare(self, T_instr_ee: Array, targets_m: Array) -> quantities.Comparison:
        count = len(T_instr_ee)
        error = point_fits.pose_error(T_instr_ee, self.T_instr_target)
        by_end = np.zeros((count, 6, 6))
        by_end[:, :3, :3] = np.eye(3)
        by_end[:, 3:, 3:] = error.by_rotation
        residual = np.concatenate([error.position_m, error.chord], axis=1)
        return quantities.Comparison(residual, by_end, np.zeros((count, 6, 0)))

    def end_poses(self, T_instr_ee: Array) -> Array:
        return self.T_instr_target

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        """Return the targets' positions, and the derivative of the pose by their readings.

        Args:
            targets_m: (t,) stated positions of the balls of an apparatus; not used without one.
        """
        R, origin = self.T_instr_target[:, :3, :3], self.T_instr_target[:, :3, 3]
        count = len(self)
        if not self.by_apparatus.shape[2]:
            direct = np.zeros((count, 6, 3))
            direct[:, :3] = R.transpose(0, 2, 1)
            return ObservedTargets(origin[:, None, :], direct)
        targets = origin[:, None, :] + np.einsum("pij,bj->pbi", R, targets_m.reshape(-1, 3))
        # An error v of the reading of a ball shifts the fitted pose as an error -R^T v of its
        # stated position does. Shift and turn (a) of pose p are along the instrument's axes (k) by
        # stated coordinates (l) of ball b, and along the end's axes (i) by read ones (j).
        by_place = self.by_apparatus.reshape(count, 2, 3, -1, 3)
        by_reading = -np.einsum("pki,pakbl,pjl->paibj", R, by_place, R, optimize=True)
        return ObservedTargets(targets, by_reading.reshape(count, 6, -1))

    def axes_of_end(self, T_instr_ee: Array) -> Array:
        return super().axes_of_end(self.T_instr_target)

    @property
    def by_stated_targets(self) -> Array:
        return self.by_apparatus

    def with_stated_targets(self, by_stated_targets: Array) -> Self:
        return replace(self, by_apparatus=by_stated_targets)

    @property
    def components_seen(self) -> NDArray[np.bool_]:
        return np.ones((len(self), 6), dtype=bool)

    @property
    def stated_covariance(self) -> Array:
        return self.cov

    @property
    def places_m(self) -> Array:
        return self.T_instr_target[:, None, :3, 3]

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        return hand_eye_from_poses(T_base_ee, self.T_instr_target, roughly=roughly)

    def least_misfit_m(self, T_base_ee: Array) -> float:
        T = self.T_instr_target
        return target_misfit_bound_m(T_base_ee, T[:, None, :3, 3], T[:, :3, :3])

    def target_on(self, T_instr_base: Array, T_base_ee: Array) -> Array | None:
        return target_on_base(T_instr_base, T_base_ee, self.T_instr_target)

    def scale(self, T_base_ee: Array) -> float | None:
        return scale_of_points(self.T_instr_target[:, :3, 3], T_base_ee)

    def scaled(self, factor: float) -> Self:
        T = self.T_instr_target.copy()
        T[:, :3, 3] *= factor
        return replace(self, T_instr_target=T)

    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> quantities.Misfit:
        T = self.T_instr_target
        found = hand_eye_from_poses(T_base_ee[used], T[used], weights=weights, roughly=True)
        modelled = found.targets(T_base_ee)[:, 0]
        off = T[:, :3, :3] @ np.swapaxes(modelled[:, :3, :3], 1, 2)
        turn = Rotation.from_matrix(off, assume_valid=True)
        length_m = np.linalg.norm(T[:, :3, 3] - modelled[:, :3, 3], axis=1)
        return quantities.Misfit(length_m[:, None], np.asarray(turn.magnitude()))

    def in_frame(self, T: Array) -> Self:
        both = block_diag(T[:3, :3], T[:3, :3])
        along = both.copy()
        along[:3, 3:] = point_fits.cross_matrix(T[:3, 3]) @ T[:3, :3]
        return replace(
            self,
            T_instr_target=T @ self.T_instr_target,
            cov=both @ self.cov @ both.T,
            by_apparatus=both @ self.by_apparatus,
            motion_cov=None if self.motion_cov is None else along @ self.motion_cov @ along.T,
        )

    def turned(self, R_ee_target: Array) -> Self:
        T = self.T_instr_target.copy()
        T[:, :3, :3] = T[:, :3, :3] @ R_ee_target.T
        axes = None if self.inverse_axes is None else R_ee_target @ self.inverse_axes
        return replace(self, T_instr_target=T, inverse_axes=axes)

    def of_end(self, T_end_shown: Array) -> Self:
        return replace(self, T_instr_target=self.T_instr_target @ np.linalg.inv(T_end_shown))

    @property
    def attitudes(self) -> Array:
        return self.T_instr_target[:, :3, :3]

    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        R = T_instr_base[:3, :3]
        # Shift and small left rotation (P, 6) by the errors of stated coordinates, along the
        # instrument's axes; times R, as rows, along the base's.
        moved = self.by_apparatus @ targets_off_m
        T: Array = T_base_ee.copy()
        T[:, :3, 3] += moved[:, :3] @ R
        turned: Array = Rotation.from_rotvec(moved[:, 3:] @ R).as_matrix() @ T[:, :3, :3]
        T[:, :3, :3] = turned
        return T

    def deviations(
        self, T_base_ee: Array, T_instr_base: Array, targets_m: Array
    ) -> quantities.Deviations:
        error = point_fits.pose_error(T_instr_base @ T_base_ee, self.T_instr_target)
        to_base = T_instr_base[:3, :3]
        chord = np.linalg.norm(error.chord, axis=1)
        angle = 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))
        # The chord is twice the sine of half the angle.
        angle_over_chord = np.divide(angle, chord, out=np.ones_like(angle), where=chord > 0)
        position_mm = 1e3 * error.position_m @ to_base
        return quantities.Deviations(
            np.linalg.norm(position_mm, axis=1),
            position_mm,
            np.degrees(error.chord * angle_over_chord[:, None]) @ to_base,
        )

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, Array], stated: quantities.StatedByCampaign
    ) -> Self:
        T, cov = pose_of_columns(columns)
        motion_cov = quantities.shared_covariance_of(columns)
        axes = np.eye(3) if stated.inverse_poses else None
        nothing = np.zeros((len(T), 6, 0))
        return cls(T, cov, nothing, motion_cov=motion_cov, inverse_axes=axes)

    def to_columns(self) -> dict[str, NDArray[Any]]:
        quaternion = Rotation.from_matrix(self.T_instr_target[:, :3, :3]).as_quat(
            canonical=True, scalar_first=True
        )
        columns = dict(zip(_PLACE, self.T_instr_target[:, :3, 3].T / quantities.MM, strict=True))
        columns |= dict(zip(_QUATERNION, quaternion.T, strict=True))
        columns |= quantities.columns_of_covariance(self.cov, _COVARIANCE)
        return columns | quantities.columns_of_shared(self.motion_cov)

    @classmethod
    def raw_columns(cls, header: Sequence[str]) -> quantities.RawColumns:
        return quantities.RawColumns((RAW_PLACE,), RAW_QUATERNION)

    @classmethod
    def unusable(
        cls, columns: quantities.RawColumns, values: Array
    ) -> Iterable[quantities.Unusable]:
        length = np.linalg.norm(values[:, 3:], axis=1)
        off = np.abs(length - 1.0) >= READINGS.of_length
        found = (f"length {value:.4g}" for value in length[off])
        return (quantities.Unusable(off, "the quaternion is not of unit length", tuple(found)),)

    @classmethod
    def from_raw(
        cls,
        columns: quantities.RawColumns,
        values: Array,
        u: Array,
        stated: quantities.StatedByCampaign,
    ) -> Pose:
        R = Rotation.from_quat(values[:, 3:], scalar_first=True).as_matrix()
        cov = np.zeros((len(values), 6, 6))
        u_m = np.where(np.isnan(u[:, :3]), stated.uncertainty_m, quantities.MM * u[:, :3])
        cov[:, range(3), range(3)] = u_m**2
        cov[:, 3:, 3:] = _rotation_covariance(values[:, 3:], u[:, 3:], u_of_attitude(stated))
        found = Pose.of(homogeneous(R, quantities.MM * values[:, :3]), cov)
        if not stated.inverse_poses:
            return found
        # Uncertainties of positions are those of the inverse, along the target's axes.
        found = replace(found, inverse_axes=np.eye(3))
        back = np.linalg.inv(found.along_noise_axes())
        cov[:, 3:, 3:] = R.swapaxes(1, 2) @ cov[:, 3:, 3:] @ R
        return replace(found, cov=back @ cov @ back.swapaxes(1, 2))


def u_of_attitude(stated: quantities.StatedByCampaign) -> float:
    """Return the standard uncertainty [rad] of orientations about each axis.

    It is the stated one, else that by positions of targets some centimetres apart.
    """
    if stated.attitude_rad is not None:
        return stated.attitude_rad
    return stated.uncertainty_m / READINGS.target_spread_m


def _rotation_covariance(quaternion: Array, u: Array, assumed_rad: float) -> Array:
    """Return the covariance (P, 3, 3) of a small rotation applied on the left.

    The rotation is twice the vector part of dq q*, for a quaternion q (P, 4), scalar first. Where
    the uncertainty u (P, 4) of one of its numbers is not stated (nan), it is the assumed one.
    """
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    quaternion, u = quaternion / length, u / length
    scalar, vector = quaternion[:, :1, None], quaternion[:, 1:]
    cross = np.cross(vector[:, None, :], np.eye(3))  # rows v x e_k: the transpose of [v]x
    by_vector = scalar * np.eye(3) + np.swapaxes(cross, 1, 2)
    turning = 2.0 * np.concatenate([-vector[:, :, None], by_vector], axis=2)
    stated = turning @ (u[:, :, None] ** 2 * np.swapaxes(turning, 1, 2))
    unstated = np.isnan(u.sum(axis=1))
    return np.where(unstated[:, None, None], assumed_rad**2 * np.eye(3), stated)


def pose_of_columns(columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the poses (P, 4, 4) [m] of a table of poses, and their covariance (P, 6, 6)."""
    p_mm, quaternion = (
        np.column_stack([columns[name] for name in names]) for names in (_PLACE, _QUATERNION)
    )
    R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return homogeneous(R, quantities.MM * p_mm), quantities.covariance_of(columns, _COVARIANCE)


@dataclass(frozen=True)
class Touched(Pose):
    """Pose of the end-effector in P poses, by the centres of B touched tooling balls."""

    balls: Points  # the centres
    touches: NDArray[np.int64]  # (P, B) number of touches of each ball

    kind: ClassVar[str] = "touch_trigger_cmm"
    locates_by: ClassVar[LocatingMethod] = "rigid_fit_nominal"
    words: ClassVar[quantities.Words] = quantities.Words(
        "coordinate measuring machine that touches balls on the end-effector",
        "position error",
        "Errors are distances of the end-effector, predicted from measured.",
        "Arrows: of the end-effector.",
    )
    from_touches: ClassVar[bool] = True
    three_axes: ClassVar[bool] = True
    sees_base: ClassVar[bool] = False

    @classmethod
    def of_balls(
        cls,
        names: tuple[str, ...],
        p_ee_balls_mm: Array,
        p_instr_balls_mm: Array,
        cov_balls_mm2: Array,
        touches: NDArray[np.int64],
    ) -> Touched:
        """Return poses of the end-effector fitted to balls, weighted by their covariances.

        Args:
            names: of the balls.
            p_ee_balls_mm: (B, 3) stated positions on the end-effector.
            p_instr_balls_mm: (P, B, 3) measured centres.
            cov_balls_mm2: (P, B, 3, 3) their covariances.
            touches: (P, B) number of touches of each.
        """
        fit = point_fits.fit_rigid_weighted(p_ee_balls_mm, p_instr_balls_mm, cov_balls_mm2)
        T = fit.T.copy()
        T[:, :3, 3] *= quantities.MM
        cov = fit.covariance * np.outer(quantities.MM_RAD_TO_SI, quantities.MM_RAD_TO_SI)
        p_m, cov_m2 = quantities.MM * p_instr_balls_mm, quantities.MM**2 * cov_balls_mm2
        balls = Points(names, p_m, cov_m2, quantities.MM * p_ee_balls_mm)
        return Touched(T, cov, point_fits.pose_by_source(T, p_m, cov_m2), balls, touches)

    @classmethod
    def foreseen(cls, T_instr_ee: Array, stated: quantities.StatedByCampaign) -> Touched:
        """Return the end-effector as measured by the stated balls with the stated uncertainty.

        Raises:
            CalibrationError: when there are fewer than three balls, or they are collinear.
        """
        names = tuple(stated.targets_m)
        p_ee_mm = np.array([*stated.targets_m.values()]).reshape(-1, 3) / quantities.MM
        about_mean_mm = p_ee_mm - p_ee_mm.sum(axis=0) / max(len(p_ee_mm), 1)
        if np.linalg.matrix_rank(about_mean_mm, tol=READINGS.collinear_mm) < 2:
            raise CalibrationError(
                "these balls do not give an orientation",
                where="targets",
                value=p_ee_mm.tolist(),
                allowed="three or more that are not collinear",
                remedy="state the places of three balls",
            )
        turned = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], p_ee_mm)
        p_instr_mm = T_instr_ee[:, None, :3, 3] / quantities.MM + turned
        cov_mm2 = (stated.uncertainty_m / quantities.MM) ** 2 * np.eye(3)
        cov_mm2 = np.broadcast_to(cov_mm2, (*p_instr_mm.shape, 3))
        touches = np.ones(p_instr_mm.shape[:2], dtype=np.int64)
        return cls.of_balls(names, p_ee_mm, p_instr_mm, cov_mm2, touches)

    def averaged(self, code: Index) -> Self:
        touches = group_means(self.touches.astype(float), code) * np.bincount(code)[:, None]
        return replace(
            super().averaged(code),
            balls=self.balls.averaged(code),
            touches=np.rint(touches).astype(np.int64),
        )

    # Whatever changes the pose changes the balls that it was fitted to.

    def in_frame(self, T: Array) -> Self:
        return replace(super().in_frame(T), balls=self.balls.in_frame(T))

    def scaled(self, factor: float) -> Self:
        return replace(super().scaled(factor), balls=self.balls.scaled(factor))

    def steadied(self, base: BaseTargets) -> Self:
        return replace(super().steadied(base), balls=self.balls.steadied(base))

    def less_certain(self, times: Array) -> Self:
        of_balls = np.repeat(times[:, :1], self.balls.components_seen.shape[1], axis=1)
        return replace(super().less_certain(times), balls=self.balls.less_certain(of_balls))

    def with_end_uncertain(self, motion_cov: Array, places_m: Array) -> Self:
        balls = self.balls.with_end_uncertain(motion_cov, places_m)
        return replace(super().with_end_uncertain(motion_cov, places_m), balls=balls)

    @property
    def single_targets(self) -> Points:
        return self.balls

    @property
    def counts(self) -> tuple[str, ...]:
        return (f"{self.touches.size} balls",)

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        """Return the balls' positions; see `Pose.readout`.

        Args:
            targets_m: (t,) stated positions of the balls; empty for their mean measured positions.
        """
        if not len(targets_m):
            R, origin = self.T_instr_target[:, :3, :3], self.T_instr_target[:, None, :3, 3]
            targets_m = np.mean((self.balls.p_instr_m - origin) @ R, axis=0).ravel()
        return super().readout(T_instr_ee, targets_m)

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        del roughly  # its solution is closed
        return seed_from_nominal(self.T_instr_target[:, :3, 3], T_base_ee[:, :3, 3])

    def least_misfit_m(self, T_base_ee: Array) -> float:
        return 0.0

    def target_on(self, T_instr_base: Array, T_base_ee: Array) -> Array | None:
        return None

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, Array], stated: quantities.StatedByCampaign
    ) -> Self:
        T, cov = pose_of_columns(columns)
        balls = Points.from_columns(columns, stated)
        touches = np.column_stack([columns[f"ball{name}_touches"] for name in balls.names])
        by_balls = point_fits.pose_by_source(T, balls.p_instr_m, balls.cov_m2)
        return cls(T, cov, by_balls, balls, touches.astype(np.int64))

    def to_columns(self) -> dict[str, NDArray[Any]]:
        of_balls = zip(self.balls.names, self.touches.T, strict=True)
        touches = {f"ball{name}_touches": times for name, times in of_balls}
        return self.balls.to_columns() | touches | super().to_columns()
