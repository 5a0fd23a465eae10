"""How much of an orientation error a constant twist of the tool would explain.

After calibration the paper's attitudes agree to 0.05 deg, yet to 1.2 deg on held-out points: a tool
that sat differently on the flange between the two sessions would show just so.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.results.evaluation import ToolTwist


def constant_tool_twist(R_predicted: Array, R_measured: Array) -> ToolTwist:
    """Fit one rotation of the tool to the differences of (P, 3, 3) attitudes."""
    difference = Rotation.from_matrix(R_predicted.transpose(0, 2, 1) @ R_measured)
    twist = difference.mean()
    left = twist.inv() * difference
    return ToolTwist(
        rotation_deg=np.degrees(twist.as_rotvec()),
        angle_deg=float(np.degrees(twist.magnitude())),
        before_deg=float(np.degrees(difference.magnitude()).mean()),
        after_deg=float(np.degrees(left.magnitude()).mean()),
    )
