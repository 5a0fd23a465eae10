"""Set-up of a plan: an arm, an instrument, and the room within which poses may be measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arm import workspace
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError, SettingsError, remedy_for
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.pose_plan.options import KeepOut, KeepOutBox, PlanOptions
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import read_yaml

#: Metres in a millimetre.
MM = 1e-3
#: Stated joint ranges may exceed the arm's limits by rounding [rad, m].
_ROUNDING = 1e-9
#: Candidates to draw for each pose of a plan, at least.
_CANDIDATES_A_POSE = 3
#: Least distances of the tool from the base's axis and of targets from the lines from joint to
#: joint, in the arm's reach without axes that carry it as a rail does: about how thick arms are.
_COLUMN_SHARE = 0.1
_CLEARANCE_SHARE = 0.05
_OFF_LINKS = "the tool off the links"
#: Where targets sit by default: in front of the flange, and off its axis [m].
_AHEAD_M, _OFF_M = 0.1, 0.06
#: Default number of targets of an instrument that sees several.
_SEVERAL = 3
#: Default distance of the instrument in front of the base, in the arm's reach.
_STANDS_OFF = 1.5


@dataclass(frozen=True)
class PlanSetup:
    """An arm, the instrument that measures it, and the options of a plan."""

    arm: Arm  # the nominal arm
    kind: type[Instrument]  # class of the instrument
    options: PlanOptions  # where arm and instrument may be, and what is measured

    @property
    def joint_ranges(self) -> tuple[Array, Array]:
        """Return the lowest and highest positions of the axes, (m,) each [rad, m].

        Raises:
            CalibrationError: when `joints_deg` has not one range a joint, within its limits, or
                `largest_angle_deg` leaves a joint no angle.
        """
        if self.options.joints_deg:
            return self._stated_ranges()
        low, high = self.arm.axis_limits_rad.T
        margin = self.options.limit_margin * (high - low)
        low, high = low + margin, high - margin
        largest_rad = np.radians(self.options.largest_angle_deg)
        largest = np.where(self.arm.axes_slide, np.inf, largest_rad)
        beyond = (low > largest) | (high < -largest)
        if beyond.any():
            joint = int(np.argmax(beyond))
            nearest_deg = np.degrees(min(abs(low[joint]), abs(high[joint])))
            raise CalibrationError(
                "the joint's limits leave it no angle",
                where=f"largest_angle_deg of joint {joint + 1}",
                value=self.options.largest_angle_deg,
                allowed=f"{nearest_deg:.1f} or more",
                remedy="raise it, or state joints_deg",
            )
        return np.maximum(low, -largest), np.minimum(high, largest)

    def _stated_ranges(self) -> tuple[Array, Array]:
        """Return the ranges that `joints_deg` states; see `joint_ranges`."""
        low, high = self.arm.axis_limits_rad.T
        unit = np.where(self.arm.axes_slide, MM, np.radians(1.0))
        stated = np.array(self.options.joints_deg, dtype=float)
        if len(stated) != len(unit):
            raise CalibrationError(
                "not one range a joint",
                where="joints_deg",
                value=f"{len(stated)} ranges",
                allowed=f"{len(unit)} ranges, least and largest",
                remedy="give one range a joint",
            )
        lowest, highest = stated.T * unit
        wrong = (lowest > highest) | (lowest < low - _ROUNDING) | (highest > high + _ROUNDING)
        if wrong.any():
            joint = int(np.argmax(wrong))
            raise CalibrationError(
                "the range is none, or leaves the joint's limits",
                where=f"joints_deg of joint {joint + 1}",
                value=tuple(stated[joint].tolist()),
                allowed=f"{low[joint] / unit[joint]:.1f} to {high[joint] / unit[joint]:.1f}",
                remedy="correct the range",
            )
        return lowest, highest

    @property
    def constraints(self) -> dict[str, workspace.Constraint]:
        """Return the constraints on poses, the quickest first, by what users know them by.

        Raises:
            SettingsError: when `facing_deg` is stated without `instrument_at_mm`.
        """
        options, carried = self.options, _rails(self.arm)
        if options.facing_deg is not None and options.instrument_at_mm is None:
            raise SettingsError(
                "nothing is stated to face",
                where="facing_deg",
                value=options.facing_deg,
                allowed="an angle together with instrument_at_mm, where the instrument is",
                remedy="state instrument_at_mm too",
            )
        strokes_m = np.abs(self.arm.joint_ranges_rad[:carried]).max(axis=1, initial=0.0)
        reach_m = self.arm.reach_m - float(strokes_m.sum())
        constraints: dict[str, workspace.Constraint] = {}
        if options.workspace_mm is not None:
            corners_m = MM * np.array(options.workspace_mm)
            box = workspace.Box(corners_m.min(axis=0), corners_m.max(axis=0))
            constraints["workspace_mm"] = workspace.within(box)
        if options.reach_mm is not None:
            constraints["reach_mm"] = workspace.reach(MM * options.reach_mm)
        if options.floor_mm is not None:
            constraints["floor_mm"] = workspace.above(MM * options.floor_mm)
        if not carried:
            column_m = _COLUMN_SHARE * reach_m
            constraints["the tool off the base's axis"] = workspace.off_column(column_m)
        constraints[_OFF_LINKS] = workspace.off_links(_CLEARANCE_SHARE * reach_m)
        boxes = []
        for number, stated in enumerate(options.keep_out, start=1):
            box = workspace.Box(MM * np.array(stated.min_mm), MM * np.array(stated.max_mm))
            constraints[f"keep-out {number} ({stated.name})"] = workspace.keep_out(box)
            boxes.append(box)
        if options.instrument_at_mm is not None:
            place_m = self.instrument_place_m
            if options.facing_deg is not None:
                most_rad = float(np.radians(options.facing_deg))
                z_axis = np.array([0.0, 0.0, 1.0])
                constraints["facing_deg"] = workspace.facing(place_m, z_axis, most_rad)
            if boxes:
                constraints["line of sight"] = workspace.in_sight(place_m, boxes)
        return constraints

    @property
    def targets(self) -> dict[str, Array]:
        """Return the targets by name: their places on the end-effector, (3,) each [m]."""
        kind = self.kind
        places_m = MM * np.array(self.options.targets_mm, dtype=float).reshape(-1, 3)
        if not len(places_m):
            count = _SEVERAL if kind.several_targets or kind.from_touches else 1
            # A target on the last joint's axis would not show that joint's error; an orientation
            # does.
            off_m = 0.0 if kind.measures_pose and not kind.from_touches else _OFF_M
            angle = 2.0 * np.pi * np.arange(count) / count
            around_m = off_m * np.column_stack([np.cos(angle), np.sin(angle)])
            places_m = np.column_stack([around_m, np.full(count, _AHEAD_M)])
        return {f"T{number}": place_m for number, place_m in enumerate(places_m, start=1)}

    @property
    def instrument_place_m(self) -> Array:
        """Return where the instrument is, (3,) in the base frame."""
        if self.options.instrument_at_mm is not None:
            return MM * np.array(self.options.instrument_at_mm)
        return np.array([_STANDS_OFF * self.arm.reach_m, 0.0, 0.0])

    @property
    def payload(self) -> Payload | None:
        """Return what the arm carries; None where the masses of its links are not known."""
        if self.arm.mass_kg is None:
            return None
        mass_kg, com_m = self.options.tool_kg, MM * np.array(self.options.tool_com_mm)
        gravity = np.array(self.options.gravity_m_s2)
        return Payload(mass_kg or 0.0, com_m, com_m, gravity, known=mass_kg is not None)

    def draw(self, least: int) -> workspace.Candidates:
        """Draw candidates within all constraints for a plan of at least so many poses.

        Raises:
            CalibrationError: when fewer than these remain, with the number that each constraint
                removed.
        """
        drawn = workspace.draw_within(
            Chain.of(self.arm),
            np.array(list(self.targets.values())),
            self.joint_ranges,
            self.constraints,
            wanted=max(self.options.candidates, _CANDIDATES_A_POSE * least),
            random_seed=self.options.random_seed,
        )
        if len(drawn.q) >= least:
            return drawn
        removed = {name: count for name, count in drawn.removed.items() if count}
        worst = max(removed, key=lambda name: removed[name])
        counts = "; ".join(f"{name}: {count}" for name, count in removed.items())
        further = "; or state targets further from the flange: --options with targets_mm"
        raise CalibrationError(
            "hardly any pose keeps within all limits" if len(drawn.q) else "no pose is left",
            where="poses drawn within the joint limits",
            value=f"{len(drawn.q)} of {drawn.drawn}; removed, one after the other: {counts}",
            allowed=f"at least {least}",
            remedy=f"allow more room, first of all for: {worst}{further * (worst == _OFF_LINKS)}",
        )


def _rails(arm: Arm) -> int:
    """Return how many joints slide before the first that turns: they carry the whole arm."""
    return int(np.argmin(np.append(arm.prismatic, False)))


def instrument_named(name: str) -> type[Instrument]:
    """Return the class of an instrument by its name.

    Raises:
        CalibrationError: when there is no such instrument.
    """
    known = instruments()
    if name not in known:
        raise CalibrationError(
            "no such instrument",
            where="instrument",
            value=name,
            allowed=", ".join(known),
            remedy=remedy_for(name, known, "choose one of these"),
        )
    return known[name]


def read_keep_out(path: Path) -> tuple[KeepOutBox, ...]:
    """Read a file of boxes to keep out of: a list of {min_mm, max_mm, name}.

    Raises:
        SettingsError: when the file cannot be read, holds no list, or a box has no volume.
    """
    content = read_yaml(path, SettingsError, what="the boxes to keep out of cannot be read")
    if not isinstance(content, list):
        raise SettingsError(
            "the file holds no list of boxes",
            where=str(path),
            value=content,
            allowed="a list of {min_mm: [x, y, z], max_mm: [x, y, z], name: ...}",
            remedy="begin every box with a hyphen, see docs/plan.md",
        )
    return parse_section(KeepOut, {"boxes": content}, where=str(path)).boxes
