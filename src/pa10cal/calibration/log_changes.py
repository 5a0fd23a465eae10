"""Changes of how joints were logged: the positions they make, and the finding that reports them.

A controller counts axes; the coupling of the arm makes joint positions of them. A change is linear
in the positions of the axes: a sign, an exchange or shift of columns, or a part of one axis that is
added to another. Axes are numbered from 1, and positions (P, m) are in radians or metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from typing_extensions import override

from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm, neighbouring_axes
from pa10cal.arrays import Array, Index
from pa10cal.calibration.checked_campaign import CheckedCampaign
from pa10cal.calibration.rules import UNKNOWNS
from pa10cal.campaign.conventions import STILL_WRONG
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.numerics.least_squares import may_be_within
from pa10cal.results.calibration import InputFinding

#: The remedy where no change that was tried puts the log right.
CHECK_ALL = "check robot, and order, signs, zeros and units of all joints"


class LogChange(ABC):
    """A change of what the controller is taken to count."""

    kind: ClassVar[str]  # of the finding that reports it
    couples: ClassVar[bool] = False  # whether an axis then moves with another

    @property
    @abstractmethod
    def axes(self) -> tuple[int, ...]:
        """Return the axes concerned, in the order in which they are reported."""

    @abstractmethod
    def apply(self, positions: Array) -> Array:
        """Return positions of axes (P, m) with the change made."""

    @abstractmethod
    def text(self, arm: Arm) -> str:
        """Return what seems wrong."""

    @property
    def as_screw(self) -> CoupledAxes | None:
        """Return the change if it has a pitch that may be fitted; None else."""
        return None

    def joints(self, arm: Arm) -> tuple[int, ...]:
        """Return the joints, from 1, that the axes drive."""
        return tuple(int(arm.coupling.own[axis - 1]) + 1 for axis in self.axes)


@dataclass(frozen=True)
class ReversedSigns(LogChange):
    """Axes that are counted the other way round."""

    kind = "joint_sign"
    reversed_axes: tuple[int, ...]

    @property
    @override
    def axes(self) -> tuple[int, ...]:
        return self.reversed_axes

    @override
    def apply(self, positions: Array) -> Array:
        changed = positions.copy()
        changed[:, [axis - 1 for axis in self.axes]] *= -1.0
        return changed

    @override
    def text(self, arm: Arm) -> str:
        joints = self.joints(arm)
        if len(joints) == 1:
            return f"the sign of joint {joints[0]} is reversed"
        every = len(joints) == len(arm.coupling.own)
        of = "all joints" if every else f"joints {', '.join(map(str, joints))}"
        return f"the signs of {of} are reversed"


@dataclass(frozen=True)
class ReorderedColumns(LogChange):
    """Columns in another order than that of the axes."""

    kind = "joint_order"
    columns: tuple[int, ...]  # (m,) the column in which each axis stands, from 1

    @classmethod
    def exchanged(cls, count: int, one: int, other: int) -> ReorderedColumns:
        """Return the exchange of two of so many axes."""
        columns = {one: other, other: one}
        return cls(tuple(columns.get(axis, axis) for axis in range(1, count + 1)))

    @property
    @override
    def axes(self) -> tuple[int, ...]:
        moved = tuple(column for axis, column in enumerate(self.columns, 1) if column != axis)
        return moved if len(moved) != 2 else (min(moved), max(moved))

    @override
    def apply(self, positions: Array) -> Array:
        return positions[:, [column - 1 for column in self.columns]]

    @override
    def text(self, arm: Arm) -> str:
        joints = self.joints(arm)
        if len(joints) == 2:
            return "joints {} and {} are exchanged".format(*joints)
        return f"the columns are shifted: joint {min(joints)} stands in that of joint {joints[0]}"


@dataclass(frozen=True)
class CoupledAxes(LogChange):
    """An axis that moves with another, besides its own motion."""

    kind = "joint_coupling"
    couples = True
    axis: int
    by: int  # the other
    factor: float  # motion of the first for one of the other [rad/rad, m/rad or rad/m]

    @property
    @override
    def axes(self) -> tuple[int, ...]:
        return self.axis, self.by

    @property
    @override
    def as_screw(self) -> CoupledAxes | None:
        return None if abs(self.factor) in (0.0, 1.0) else self

    @override
    def apply(self, positions: Array) -> Array:
        changed = positions.copy()
        changed[:, self.axis - 1] += self.factor * positions[:, self.by - 1]
        return changed

    @override
    def text(self, arm: Arm) -> str:
        joint, by = self.joints(arm)
        if arm.prismatic[joint - 1] and not arm.prismatic[by - 1]:
            return f"joint {joint} slides as joint {by} turns"
        if joint == by + 1:
            between = neighbouring_axes(arm)[by - 1]
            row = between.row - 1
            along = np.sign(np.cos(arm.alpha_rad[row]) * np.cos(arm.beta_rad[row]))
            if between.parallel and not arm.prismatic[joint - 1] and self.factor == -along:
                return f"joint {joint} is logged to the horizontal, not to the link of joint {by}"
        return f"joint {joint} moves with joint {by}"


@dataclass(frozen=True)
class ChangedLog:
    """A log with changes made one after the other; without any, the log as it is."""

    checked: CheckedCampaign
    changes: tuple[LogChange, ...] = ()

    @property
    def q(self) -> Array:
        """Return the positions of the joints, (P, n)."""
        positions = _with_changes(self.checked.axes, self.changes)
        return self.checked.arm.coupling.to_joints(positions)

    @property
    def nominal_m(self) -> float:
        """Return the misfit of the nominal arm."""
        return self.checked.nominal_misfit_m(self.q)

    @property
    def least_nominal_m(self) -> float:
        """Return a lower bound of the misfit of the nominal arm, without a fit."""
        return self.checked.least_misfit_m(self.q)

    def may_be_below(self, limit_m: float) -> bool:
        """Return whether the misfit of the nominal arm may be within a limit."""
        return may_be_within(self.least_nominal_m, limit_m)

    def with_change(self, change: LogChange) -> ChangedLog:
        """Return the log with one more change."""
        return replace(self, changes=(*self.changes, change))

    @property
    def _signs_and_order(self) -> tuple[LogChange, ...]:
        return tuple(each for each in self.changes if not each.couples)

    @property
    def remedy(self) -> str:
        """Return what to state in campaign.yaml, so that the changes are made when it is read."""
        checked, changes = self.checked, self._signs_and_order
        axes = np.arange(1, len(checked.signs) + 1)
        # Signed permutation (m, m): the row of its entry is the column in which an axis is logged.
        permutation = _with_changes(np.eye(len(axes)), changes)
        order = np.abs(permutation).argmax(axis=0) + 1
        signs = np.array(checked.signs) @ permutation
        offsets_deg = np.array(checked.offsets_deg) @ permutation
        reordered = bool((order != axes).any())
        remedies = []
        if reordered:
            remedies.append(self._set_order(order))
        if (signs != checked.signs).any():
            remedies.append(f"set joint_signs: [{', '.join(str(int(sign)) for sign in signs)}]")
        if (offsets_deg != checked.offsets_deg).any():
            remedies.append(set_offsets(offsets_deg))
        if self.coupled != checked.arm.coupled:
            remedies.append(set_coupling(self.coupled, checked.arm))
        # An axis that runs the other way may be described so, unless anything else is wrong.
        only_signs = changes and changes == self.changes and not reordered
        also = ", or reverse the axis in the arm's description" if only_signs else ""
        return " and ".join(remedies) + also

    def _set_order(self, order: Index) -> str:
        """Return the remedy for axes that stand in the columns `order` (m,), from 1."""
        words, slides = self.checked.words, self.checked.arm.axes_slide
        names = [f"q{column}_{'mm' if slides[column - 1] else 'deg'}" for column in order]
        if words.key(names[0]):
            return words.set_names(names)
        axes = np.arange(1, len(order) + 1)
        moved = axes[order != axes]
        if len(moved) == 2:
            return f"exchange the columns {', '.join(words.joint(int(axis)) for axis in moved)}"
        columns = ", ".join(words.joint(int(column)) for column in order)
        return f"put the columns in the order {columns}"

    @property
    def can_be_stated(self) -> bool:
        """Return whether campaign.yaml can say the changes: each joint turns once with its axis.

        It states the parts that other axes have in a joint's position, and no part of its own axis.
        Couplings made one after the other may change that one: if joint 6 moves with joint 5, and
        then joint 5 with joint 6, part of the motion of an axis comes back to its own joint.
        """
        own = self.checked.arm.coupling.own
        return bool(np.allclose(np.diagonal(self._by_axes[own]), 1.0))

    @property
    def _by_axes(self) -> Array:
        """Return how joints follow from the axes (n, m), once signs and order of these are right.

        Joints follow the axes c of the log by q = C M c, where M makes all changes and C is the
        coupling as stated. With S the changes of signs and order alone, C M S^-1 is the coupling
        of axes s = S c that have these right.
        """
        coupling = self.checked.arm.coupling
        axes = np.eye(len(coupling.own))  # one axis moved in each row: the results are M' and S'
        signs_and_order = _with_changes(axes, self._signs_and_order).T
        all_changes = _with_changes(axes, self.changes).T
        return np.asarray(coupling.matrix @ all_changes @ np.linalg.inv(signs_and_order))

    @property
    def coupled(self) -> tuple[CoupledJoint, ...]:
        """Return how joints move together in the changed log, whatever signs and order are."""
        arm, coupling, matrix = self.checked.arm, self.checked.arm.coupling, self._by_axes
        stated = {(each.joint, each.by): each for each in arm.coupled}
        coupled = []
        for joint, axis in np.argwhere(np.abs(matrix) > UNKNOWNS.no_part).tolist():
            if joint == coupling.own[axis]:
                continue
            by, follows = int(coupling.own[axis]) + 1, joint not in coupling.own
            found = CoupledJoint(joint + 1, by, float(matrix[joint, axis]), follows)
            before = stated.get((found.joint, found.by))
            if before is not None:
                found = replace(found, counted_only=before.counted_only)
            same = before is not None and np.isclose(before.factor, found.factor)
            coupled.append(before if before is not None and same else found)
        return tuple(coupled)

    def finding(self, fits_to: str, now_mm: float, left_mm: float, *, right: bool) -> InputFinding:
        """Return the finding that reports the changes.

        Args:
            fits_to: what is compared, such as "the nominal arm fits to".
            now_mm, left_mm: its misfit as logged, and with the changes.
            right: whether the changes put the log right, so that they are the remedy.
        """
        arm, word = self.checked.arm, self.checked.words.joint
        couples = any(change.couples for change in self.changes)
        text = " and ".join(change.text(arm) for change in self.changes)
        if couples:
            counted = coupling_in_words(replace(arm, coupled=self.coupled))
            text += f" ({counted or 'each by itself'})"
        then = "that is put right" if right else f"so, {STILL_WRONG}"
        joints = [joint for change in self.changes for joint in change.joints(arm)]
        return InputFinding(
            kind=CoupledAxes.kind if couples else self.changes[0].kind,
            where="; ".join(", ".join(map(word, change.axes)) for change in self.changes),
            what=f"{text}: {fits_to} {now_mm:.3g} mm as logged, {left_mm:.3g} mm if {then}",
            remedy=self.remedy if right else CHECK_ALL,
            would_leave_mm=left_mm,
            joint=joints[0] if len(joints) == 1 else None,
        )


def _with_changes(positions: Array, changes: Sequence[LogChange]) -> Array:
    for change in changes:
        positions = change.apply(positions)
    return positions


def set_offsets(offsets_deg: Iterable[float]) -> str:
    """Return the remedy that states the offsets of the joints."""
    return f"set joint_offsets_deg: [{', '.join(f'{each + 0.0:.6g}' for each in offsets_deg)}]"
