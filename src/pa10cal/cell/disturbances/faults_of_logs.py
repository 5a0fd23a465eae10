"""Faults of a whole log: joints with another sign or zero, attitudes read wrong, a step in time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from pydantic import Field

from pa10cal.cell.disturbances.disturbance import Disturbance
from pa10cal.cell.disturbances.stressors import displaced
from pa10cal.cell.effects.effect import Finite, FinitePositive
from pa10cal.cell.instruments.touch_trigger_cmm import APPROACH_S, DWELL_S
from pa10cal.cell.raw_log import RawLog


class JointFault(Disturbance):
    """A fault of the log of one joint."""

    joint: int = Field(ge=1, description="joint, from 1")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return a joint between the first, whose zero is the base's, and the last, the tool's."""
        return {"joint": int(rng.integers(2, joints))}


class JointZero(JointFault):
    """The zero of a joint is off in the log."""

    id = "joint_zero"
    kinds = ("joint_zero",)

    off_deg: Finite = Field(3.0, description="by how much")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return 2 to 4 degrees, either way."""
        off_deg = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 4.0))
        return {**super().drawn(joints, rng), "off_deg": round(off_deg, 3)}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Shift every angle of the joint."""
        del rng
        log.set_angles_of(self.joint, log.angles_of(self.joint) + self.off_deg)
        return [f"joint {self.joint}"]


class JointSign(JointFault):
    """A joint is logged with the wrong sign, its torque too."""

    id = "joint_sign"
    kinds = ("joint_sign",)

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Turn the sign round."""
        del rng
        log.set_angles_of(self.joint, -log.angles_of(self.joint))
        if torque := log.torques_of(self.joint):
            log.joints[torque] *= -1.0
        return [f"joint {self.joint}"]


class JointsExchanged(JointFault):
    """The columns of two neighbouring joints are exchanged."""

    id = "joints_exchanged"
    kinds = ("joint_sign", "label")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange a joint with the one before it."""
        del rng
        before = log.angles_of(self.joint - 1).copy()
        log.set_angles_of(self.joint - 1, log.angles_of(self.joint))
        log.set_angles_of(self.joint, before)
        return [f"joint {self.joint - 1}", f"joint {self.joint}"]


class DirectionReversed(JointFault):
    """The approaches of a joint are logged as if it came from the other side."""

    id = "direction_reversed"
    kinds = ("direction",)
    needs = ("touches",)

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return joint 2 or 3, those with most friction."""
        del joints
        return {"joint": int(rng.integers(2, 4))}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Mirror the samples of every approach about the dwell that follows."""
        del rng
        approach = len(APPROACH_S)
        q = log.angles_of(self.joint).to_numpy().reshape(-1, approach + len(DWELL_S)).copy()
        rest = q[:, approach:].mean(axis=1, keepdims=True)
        q[:, :approach] = 2.0 * rest - q[:, :approach]
        log.joints[f"q{self.joint}_deg"] = q.ravel()
        return [f"joint {self.joint}"]


class Attitudes(Disturbance):
    """Quaternions do not stand as their headers say."""

    id = "attitudes"
    needs = ("attitude",)

    read: Literal["xyzw", "inverse"] = Field("xyzw", description="what stands under w, x, y, z")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return either."""
        del joints
        return {"read": str(rng.choice(["xyzw", "inverse"]))}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Put the scalar last, or turn the vector round."""
        del rng
        wxyz = log.quaternions()
        wrong = np.roll(wxyz, -1, axis=1) if self.read == "xyzw" else wxyz * [1, -1, -1, -1]
        log.set_quaternions(wrong)
        return ["qw, qx, qy, qz"]


class Jump(Disturbance):
    """The instrument moves once, some way through the campaign."""

    id = "jump"
    kinds = ("step_in_time",)

    size_mm: FinitePositive = Field(0.1, description="by how much")
    after: FinitePositive = Field(0.5, description="part of the configurations before it")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return 0.1 to 0.5 mm about the middle."""
        del joints
        size_mm = float(np.exp(rng.uniform(*np.log([0.1, 0.5]))))
        return {"size_mm": round(size_mm, 3), "after": round(float(rng.uniform(0.35, 0.65)), 3)}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Move everything read from there on, the same way."""
        count = len(log.configurations)
        later = np.arange(count) >= self.after * count
        log.move(later[:, None] * displaced(log.kind, self.size_mm, rng))
        first = log.configurations.iloc[int(np.argmax(later))]
        return [f"time {first['time_s']:g} s"]
