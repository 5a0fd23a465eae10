"""What is known of an arm before it is measured: Denavit-Hartenberg rows, limits, masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import ArmError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """A serial arm of n joints as its maker describes it.

    Attributes:
        name: identifier used by campaigns.
        title: name shown to readers.
        convention: `standard`: Rz(theta) Tz(d) Tx(a) Rx(alpha); `modified`: Rx Tx Rz Tz.
        theta_rad: (n,) joint offsets.
        d_m: (n,) offsets along z.
        a_m: (n,) lengths along x.
        alpha_rad: (n,) twists.
        hayati: (n,) whether the row ends with Ry(beta) and has no departure in d.
        prismatic: (n,) whether the joint slides along its z axis.
        limits_rad: (n, 2) joint limits (metres for a prismatic joint).
        gear_ratio: (n,) motor turns a joint turn.
        torque_limit_Nm: (n,) rated joint torques.
        mass_kg: (n,) link masses, or None where they are not known.
        com_m: (n, 3) centres of mass in the frame of the link's own row, or None.
    """

    name: str
    title: str
    convention: Literal["standard", "modified"]
    theta_rad: Array
    d_m: Array
    a_m: Array
    alpha_rad: Array
    hayati: NDArray[np.bool_]
    prismatic: NDArray[np.bool_]
    limits_rad: Array
    gear_ratio: Array
    torque_limit_Nm: Array
    mass_kg: Array | None
    com_m: Array | None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.theta_rad)

    def __post_init__(self) -> None:
        n = len(self.theta_rad)
        for field in (
            "d_m",
            "a_m",
            "alpha_rad",
            "hayati",
            "prismatic",
            "limits_rad",
            "gear_ratio",
            "torque_limit_Nm",
            "mass_kg",
            "com_m",
        ):
            value = getattr(self, field)
            if value is not None and len(value) != n:
                raise ArmError(
                    f"{field} has {len(value)} entries for {n} rows",
                    where=self.name,
                    allowed=f"{n} entries, one a joint",
                    remedy="complete the arm description",
                )
        if np.any(np.abs(self.d_m) > 10) or np.any(np.abs(self.a_m) > 10):
            raise ArmError(
                "a link is longer than 10 m",
                where=self.name,
                value=float(max(np.abs(self.d_m).max(), np.abs(self.a_m).max())),
                allowed="lengths in metres",
                remedy="divide by 1000 if the lengths are in millimetres",
            )
