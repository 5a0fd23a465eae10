"""A broad band of waves in a joint's angle: made by its sensor, or by its gear.

Both have the same form, and poses alone cannot tell them apart: which name is given is decided by a
witness outside the map (`discovery/sensor_or_gear.py`). Neither is sought beside the map whose
place it takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.spectrum import Band, Spectrum

#: Knots a turn that follow every order in which such errors were ever found.
FINE = 360
#: Sizes found on a measured arm (a UR10 in two campaigns): where a search finds its own, those.
TYPICAL = Band(
    slow_rad=1.2e-4,
    below_rad=4.5e-5,
    level_rad=7.5e-5,
    first_order=7.0,
    last_order=23.0,
    decay=3.4,
    floor_rad=4.5e-6,
)


@dataclass(frozen=True)
class SensorError(JointErrorMap):
    """An error of the sensor at the joint's output, periodic in the joint's angle."""

    knots: int = FINE
    spectrum: Spectrum | None = TYPICAL
    id: ClassVar[str] = "sensor_error"
    sought: ClassVar[bool] = False
    advice: ClassVar[str] = "; calibrate the joint's sensor against the map"


@dataclass(frozen=True)
class GearError(JointErrorMap):
    """An error of the gear, periodic in the angle of the joint's output."""

    knots: int = FINE
    spectrum: Spectrum | None = TYPICAL
    id: ClassVar[str] = "gear_error"
    sought: ClassVar[bool] = False
    advice: ClassVar[str] = "; look at the joint's gear"
