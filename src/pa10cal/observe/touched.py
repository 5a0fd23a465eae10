"""Tooling balls, located by touches: they give the pose of the end-effector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.frame.rigid_fit import pose_by_source
from pa10cal.observe.instrument import Array, Index, Stated, Words, group_means
from pa10cal.observe.pose import Pose, pose_of_columns
from pa10cal.observe.targets import names_of_columns, places_of_columns


@dataclass(frozen=True)
class Touched(Pose):
    """Pose of the end-effector in P poses, through the centres of B tooling balls.

    Attributes:
        names: (B,) names of the balls.
        p_instr_balls_m: (P, B, 3) centres of the balls in the instrument's frame.
        cov_balls_m2: (P, B, 3, 3) their covariances.
        touches: (P, B) touches behind each centre.
    """

    names: tuple[str, ...]
    p_instr_balls_m: Array
    cov_balls_m2: Array
    touches: NDArray[np.int64]

    kind: ClassVar[str] = "touch_trigger_cmm"
    words: ClassVar[Words] = Words(
        "position error",
        "Errors are distances of the end-effector, predicted from measured.",
        "Arrows: of the end-effector.",
    )
    from_touches: ClassVar[bool] = True
    _of_all: ClassVar[tuple[str, ...]] = ("names",)

    @override
    def averaged(self, code: Index) -> Self:
        """Average readings; see `Pose.averaged`."""
        count = np.bincount(code)
        return replace(
            super().averaged(code),
            p_instr_balls_m=group_means(self.p_instr_balls_m, code),
            cov_balls_m2=group_means(self.cov_balls_m2, code) / count[:, None, None, None],
            touches=np.rint(group_means(self.touches.astype(float), code) * count[:, None]).astype(
                np.int64
            ),
        )

    @classmethod
    @override
    def from_columns(cls, columns: Mapping[str, Array], stated: Stated) -> Self:
        """Read P poses from columns (P,) of the table of poses."""
        T, cov = pose_of_columns(columns)
        names = names_of_columns(columns)
        p_m, cov_m2, touches = places_of_columns(columns, names)
        return cls(T, cov, pose_by_source(T, p_m, cov_m2), names, p_m, cov_m2, touches)
