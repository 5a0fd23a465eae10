"""Faults of a campaign: of single rows, of a whole log, of what is stated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from pa10cal.cell.disturbances.disturbance import (
    Disturbance,
    between,
    describe,
    displaced,
    log_between,
    off_by,
    one_of,
    state_times,
)
from pa10cal.cell.effects.effect import Finite, FinitePositive
from pa10cal.cell.instruments.touch_trigger_cmm import APPROACH_S, DWELL_S
from pa10cal.cell.raw_log import RawLog

# Faults of a whole log: joints with another sign or zero, orientations read wrong, a step in time.


class JointFault(Disturbance):
    """A fault of the log of one joint."""

    # A joint between the first, whose zero is the base's, and the last, the tool's.
    usual: ClassVar = {"joint": lambda joints, rng: int(rng.integers(2, joints))}

    joint: int = Field(ge=1, description="joint, from 1")


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

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Shift every angle of the joint."""
        log.set_angles_of(self.joint, log.angles_of(self.joint) + self.off_deg)
        return [f"joint {self.joint}"]


class JointSign(JointFault):
    """A joint is logged with the wrong sign, its torque too."""

    id = "joint_sign"
    kinds = ("joint_sign",)

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Turn the sign round."""
        log.set_angles_of(self.joint, -log.angles_of(self.joint))
        if torque := log.torques_of(self.joint):
            log.joints[torque] *= -1.0
        return [f"joint {self.joint}"]


class JointsExchanged(JointFault):
    """The columns of two neighbouring joints are exchanged."""

    id = "joints_exchanged"
    kinds = ("joint_sign", "label")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Exchange a joint with the one before it."""
        before = log.angles_of(self.joint - 1).copy()
        log.set_angles_of(self.joint - 1, log.angles_of(self.joint))
        log.set_angles_of(self.joint, before)
        return [f"joint {self.joint - 1}", f"joint {self.joint}"]


class DirectionReversed(JointFault):
    """The approaches of a joint are logged as if it came from the other side."""

    id = "direction_reversed"
    kinds = ("direction",)
    needs = ("touches",)
    # Joints 2 and 3 have most friction.
    usual: ClassVar = {"joint": lambda _joints, rng: int(rng.integers(2, 4))}

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Mirror the samples of every approach about the dwell that follows."""
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
    usual: ClassVar = {"read": one_of("xyzw", "inverse")}

    read: Literal["xyzw", "inverse"] = Field("xyzw", description="what stands under w, x, y, z")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Put the scalar last, or turn the vector round."""
        wxyz = log.quaternions()
        wrong = np.roll(wxyz, -1, axis=1) if self.read == "xyzw" else wxyz * [1, -1, -1, -1]
        log.set_quaternions(wrong)
        return ["qw, qx, qy, qz"]


class Jump(Disturbance):
    """The instrument moves once, some way through the campaign."""

    id = "jump"
    kinds = ("step_in_time",)
    usual: ClassVar = {"size_mm": log_between(0.1, 0.5), "after": between(0.35, 0.65)}

    size_mm: FinitePositive = Field(0.1, description="by how much")
    after: FinitePositive = Field(0.5, description="part of the configurations before it")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Move everything read from there on, the same way."""
        count = len(log.configurations)
        later = np.arange(count) >= self.after * count
        log.move(later[:, None] * displaced(log.kind, self.size_mm, rng))
        first = log.configurations.iloc[int(np.argmax(later))]
        return [f"time {first['time_s']:g} s"]


# Faults of single rows: labels, loads, readings, a log that ends early.


class LabelsExchanged(Disturbance):
    """Two balls or targets are exchanged in one configuration."""

    id = "labels_exchanged"
    kinds = ("label",)
    needs = ("targets",)

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange the labels of two that were seen."""
        number = int(rng.choice(log.of_kind("grid")))
        if log.touched:
            names = sorted(set(log.readings["ball"]))
            first, second = rng.choice(names, 2, replace=False).tolist()
            there = log.configuration == number
            balls = log.readings.loc[there, "ball"]
            log.readings.loc[there, "ball"] = balls.replace({first: second, second: first})
            return [log.label(number)]
        points = log.points
        chosen = rng.choice(len(points), 2, replace=False).tolist()
        one, other = (points[k] for k in chosen)
        seen = log.readings[[*one, *other]].notna().all(axis=1).to_numpy()
        number = int(rng.choice(np.intersect1d(log.of_kind("grid"), np.flatnonzero(seen))))
        values = log.readings.loc[number, [*one, *other]].to_numpy(copy=True)
        log.readings.loc[number, [*other, *one]] = values
        return [log.label(number)]


class PosesExchanged(Disturbance):
    """The labels of two poses are exchanged in one repeat."""

    id = "poses_exchanged"
    kinds = ("label", "outlier")
    needs = ("repeats", "tracker")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange what the instrument read in two configurations."""
        one, other = rng.choice(log.of_kind("grid"), 2, replace=False).tolist()
        columns = [name for point in log.points for name in point]
        columns += [name for name in ("qw", "qx", "qy", "qz") if name in log.readings]
        values = log.readings.loc[[other, one], columns].to_numpy()
        log.readings.loc[[one, other], columns] = values
        return sorted({log.label(one), log.label(other)})


class LoadsExchanged(Disturbance):
    """Two loads are exchanged at one pose, in all repeats."""

    id = "loads_exchanged"
    measured = True
    kinds = ("load",)
    needs = ("loads", "touches")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Write the largest load for none, and none for the largest."""
        rows, grid = log.readings, log.readings["kind"] == "grid"
        label = str(rng.choice(sorted(set(rows.loc[grid, "pose"]))))
        least, most = rows.loc[grid, "load_N"].min(), rows.loc[grid, "load_N"].max()
        there = grid & (rows["pose"] == label)
        log.readings.loc[there, "load_N"] = rows.loc[there, "load_N"].replace(
            {least: most, most: least}
        )
        return [label]


class LoadMisstated(Disturbance):
    """One load is not what the log says: 40 N for 44."""

    id = "load_misstated"
    measured = True
    kinds = ("load",)
    needs = ("loads", "springs")

    part: FinitePositive = Field(0.909, description="stated over true")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """State another load in every row of the largest of the calibration poses."""
        rows = log.readings
        most = float(rows.loc[rows["kind"] == "grid", "load_N"].max())
        stated = float(np.round(self.part * most))
        log.readings.loc[rows["load_N"] == most, "load_N"] = stated
        return [f"{stated:g} N"]


class _ReadingOff(Disturbance):
    """One reading of a pose is far off."""

    #: Kind of the pose.
    of_kind: ClassVar[str]
    kinds = ("outlier",)

    size_mm: FinitePositive = Field(description="by how much")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Move one reading in any direction."""
        number = int(rng.choice(log.of_kind(self.of_kind)))
        shift_mm = np.zeros((len(log.configurations), 3))
        shift_mm[number] = displaced(log.kind, self.size_mm, rng)
        log.move(shift_mm)
        return [log.label(number)]


class HeldOutReadingOff(_ReadingOff):
    """One reading of a held-out pose is far off."""

    id = "held_out_reading_off"
    of_kind = "holdout"

    size_mm: FinitePositive = Field(40.0, description="by how much")


class OneReadingOff(_ReadingOff):
    """One reading of a calibration pose is off."""

    id = "one_reading_off"
    of_kind = "grid"
    usual: ClassVar = {"size_mm": log_between(2.0, 30.0, 2)}

    size_mm: FinitePositive = Field(5.0, description="by how much")


class LogCut(Disturbance):
    """The joint log ends early."""

    id = "log_cut"
    needs = ("touches",)

    part: FinitePositive = Field(0.04, description="what is left of it")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Keep the first rows."""
        log.tables["resolver"] = log.joints.iloc[: max(1, round(self.part * len(log.joints)))]
        return ["resolver"]


# Faults of what a campaign states: units, gravity, masses, lengths, places of targets.

Wrong = Literal["uncertainty_um", "uncertainty_m", "mass_g", "kelvin", "fahrenheit", "gravity_mm"]
#: Rows no longer than this are no links [m].
_LINK_M = 0.1


class Unit(Disturbance):
    """A figure is in another unit than its key says."""

    id = "unit"
    usual: ClassVar = {"of": one_of(*get_args(Wrong))}

    of: Wrong = Field(description="which figure, and the unit that it is in")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Write the figure in that unit."""
        said = log.description
        if self.of.startswith("uncertainty"):
            state_times(log, 1e3 if self.of.endswith("um") else 1e-3)
            return ["instrument.uncertainty_mm"]
        if self.of == "mass_g":
            said["tool"]["mass_kg"] *= 1e3
            return ["tool.mass_kg"]
        if self.of == "gravity_mm":
            said["gravity_m_s2"] = [1e3 * each for each in said["gravity_m_s2"]]
            return ["gravity_m_s2"]
        reference_C = float(said["reference_temperature_C"])
        table = log.joints
        if "temperature_C" not in table:
            table["temperature_C"] = np.full(len(table), reference_C)
        if self.of == "kelvin":
            table["temperature_C"] = table["temperature_C"] + 273.15
        else:
            table["temperature_C"] = (1.8 * table["temperature_C"] + 32.0).round(2)
        return ["temperature_C"]


class UncertaintyOff(Disturbance):
    """The stated uncertainty is off by much more than a factor of three."""

    id = "uncertainty_off"
    needs = ("repeats", "tracker")
    usual: ClassVar = {"factor": off_by(6.0, 20.0)}

    factor: FinitePositive = Field(10.0, description="stated over true")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Multiply every statement."""
        state_times(log, self.factor)
        return ["instrument.uncertainty_mm"]


class Gravity(Disturbance):
    """Gravity points another way than stated."""

    id = "gravity"
    needs = ("masses", "springs")
    usual: ClassVar = {"way": one_of("up", "sideways")}

    way: Literal["up", "sideways"] = Field("up", description="where it is stated to point")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Turn the sign round, or write it under another axis."""
        x, y, z = log.description["gravity_m_s2"]
        log.description["gravity_m_s2"] = [x, y, -z] if self.way == "up" else [z, x, y]
        return ["gravity_m_s2"]


class PayloadOff(Disturbance):
    """The stated mass of the tool is off."""

    id = "payload_off"
    measured = True
    kinds = ("payload",)
    needs = ("masses", "springs")
    usual: ClassVar = {"factor": one_of(0.8, 1.2)}

    factor: FinitePositive = Field(1.2, description="stated over true")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """State another mass."""
        log.description["tool"]["mass_kg"] *= self.factor
        return ["tool"]


class PayloadCentreOff(Disturbance):
    """The stated centre of mass of the tool is off."""

    id = "payload_centre_off"
    measured = True
    kinds = ("payload",)
    needs = ("masses", "springs")

    off_mm: Finite = Field(50.0, description="along any axis of the flange")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """State another place."""
        axis = int(rng.integers(3))
        log.description["tool"]["com_mm"][axis] += self.off_mm * float(rng.choice([-1.0, 1.0]))
        return ["tool"]


class LengthTypo(Disturbance):
    """A length in the description of the arm is a typing error."""

    id = "length_typo"

    off_mm: Finite = Field(27.0, description="by how much")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Name an arm of one's own, with another length of one of its longer rows."""
        arm = log.arm
        # That of the first row along z is the height of the base, and the last is the tool's.
        rows = np.flatnonzero(np.abs(arm.a_m[:-1]) > _LINK_M)
        along_x = len(rows) > 0
        along_z = 1 + np.flatnonzero(np.abs(arm.d_m[1:-1]) > _LINK_M)
        row = int(rng.choice(rows if along_x else along_z))
        off_m = 1e-3 * self.off_mm * (np.arange(arm.n) == row)
        wrong = replace(arm, a_m=arm.a_m + off_m) if along_x else replace(arm, d_m=arm.d_m + off_m)
        describe(log, wrong)
        return [f"delta_{'a' if along_x else 'd'}_{row + 1}"]


class PlacesExchanged(Disturbance):
    """The places of two balls or targets are exchanged in the description."""

    id = "places_exchanged"
    needs = ("targets",)

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange two places."""
        places = log.description["tool"]["balls_mm"]
        first, second = rng.choice(sorted(places), 2, replace=False).tolist()
        places[first], places[second] = places[second], places[first]
        return [f"tool.balls_mm {first}, {second}"]
