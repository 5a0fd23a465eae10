"""A tracker of poses: position and attitude of one target."""

from __future__ import annotations

from typing import Any, ClassVar

from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.cell.instruments.instrument import Streams, Truth
from pa10cal.cell.instruments.tracker import Tracker, xyz_columns
from pa10cal.cell.robot import Robot

_QUATERNION = ("qw", "qx", "qy", "qz")


class Pose(Tracker):
    """Its attitude is measured apart from its position: errors of the scales do not turn it."""

    kind: ClassVar[str] = "pose"

    @property
    def states_targets(self) -> bool:
        """Return that the campaign takes the target for the end-effector frame."""
        return False

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        """Return the target's position [mm] and attitude, a unit quaternion."""
        T_base_ee, plan = truth.rest.T_base_ee, self.plan
        T = truth.robot.T_instr_target(T_base_ee)
        R_instr_ee = truth.robot.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]
        moved_m = (R_instr_ee @ truth.tool_shift_m[:, :, None])[:, :, 0]
        noise_m = 1e-3 * plan.position_mm * streams["position"].standard_normal((len(T), 3))
        p_m = truth.as_read(T[:, :3, 3] + moved_m) + noise_m
        turn = plan.attitude_rad * streams["attitude"].standard_normal((len(T), 3))
        R = Rotation.from_rotvec(turn).as_matrix() @ T[:, :3, :3]
        quaternion = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
        # Half a turn's uncertainty in every component is that turn's about every axis.
        return {
            **{f"{axis}_mm": (1e3 * p_m[:, k], self.stated_mm) for k, axis in enumerate("xyz")},
            **{
                name: (quaternion[:, k], 0.5 * plan.attitude_rad)
                for k, name in enumerate(_QUATERNION)
            },
        }

    def read_columns(self, robot: Robot) -> dict[str, Any]:
        """Return position and attitude of the target."""
        del robot
        return {
            "position": xyz_columns(""),
            "rotation": {
                "names": list(_QUATERNION),
                "convention": "quaternion_wxyz",
                "u": [f"u_{name}" for name in _QUATERNION],
            },
        }
