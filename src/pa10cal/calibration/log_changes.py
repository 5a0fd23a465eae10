"""Changes of how joints were logged: the positions they make, and the finding that reports them.

A controller counts axes; the coupling of the arm makes joint positions of them. A change is linear
in the positions of the axes: a sign, an exchange or shift of columns, or a part of one axis that is
added to another. Axes are numbered from 1, and positions (P, m) are in radians or metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm, neighbouring_axes
from pa10cal.arrays import Array
from pa10cal.calibration.checked_campaign import CheckedCampaign
from pa10cal.calibration.rules import UNKNOWNS
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.conventions import STILL_WRONG
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.numerics.least_squares import may_be_within
from pa10cal.results.calibration import InputFinding

#: The remedy where no change that was tried puts the log right.
CHECK_ALL = "check robot, and order, signs, zeros and units of all joints"


@dataclass(frozen=True)
class LogChange:
    """A change of what the controller is taken to count."""

    kind: Literal["joint_sign", "joint_order", "joint_coupling"]  # that of the finding
    # axes of another sign; columns in which axes stand, the lowest axis first, of another order; or
    # an axis, and that with which it moves
    axes: tuple[int, ...]
    factor: float = 0.0  # motion of the first for one of the second [rad/rad, m/rad or rad/m]

    def apply(self, positions: Array) -> Array:
        """Return positions of axes (P, m) with the change made."""
        changed, columns = positions.copy(), [axis - 1 for axis in self.axes]
        if self.kind == "joint_sign":
            changed[:, columns] *= -1.0
        elif self.kind == "joint_order":
            changed[:, sorted(columns)] = positions[:, columns]
        else:
            changed[:, columns[0]] += self.factor * positions[:, columns[1]]
        return changed

    def text(self, arm: Arm) -> str:
        """Return what seems wrong."""
        first, *others = joints = self.joints(arm)
        if self.kind == "joint_sign":
            which = f"sign of joint {first} is"
            if others:
                every = len(joints) == len(arm.coupling.own)
                of = "all joints" if every else f"joints {', '.join(map(str, joints))}"
                which = f"signs of {of} are"
            return f"the {which} reversed"
        if self.kind == "joint_order":
            if len(joints) == 2:
                return "joints {} and {} are exchanged".format(*sorted(joints))
            return f"the columns are shifted: joint {min(joints)} stands in that of joint {first}"
        by = others[0]
        if arm.prismatic[first - 1] and not arm.prismatic[by - 1]:
            return f"joint {first} slides as joint {by} turns"
        if first == by + 1:
            between = neighbouring_axes(arm)[by - 1]
            row = between.row - 1
            along = np.sign(np.cos(arm.alpha_rad[row]) * np.cos(arm.beta_rad[row]))
            if between.parallel and not arm.prismatic[first - 1] and self.factor == -along:
                return f"joint {first} is logged to the horizontal, not to the link of joint {by}"
        return f"joint {first} moves with joint {by}"

    def joints(self, arm: Arm) -> tuple[int, ...]:
        """Return the joints, from 1, that the axes drive."""
        return tuple(int(arm.coupling.own[axis - 1]) + 1 for axis in self.axes)

    def where(self, words: ColumnMap) -> str:
        """Return the names of the columns concerned."""
        exchange = self.kind == "joint_order" and len(self.axes) == 2
        axes = sorted(self.axes) if exchange else self.axes
        return ", ".join(map(words.joint, axes))


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
        return tuple(each for each in self.changes if each.kind != "joint_coupling")

    @property
    def remedy(self) -> str:
        """Return what to state in campaign.yaml, so that the changes are made when it is read."""
        checked, words, changes = self.checked, self.checked.words, self._signs_and_order
        slides = checked.arm.axes_slide
        axes = np.arange(1, len(slides) + 1)
        # Signed permutation (m, m): the row of its entry is the column in which an axis is logged.
        permutation = _with_changes(np.eye(len(axes)), changes)
        order = np.abs(permutation).argmax(axis=0) + 1
        signs = np.array(checked.signs) @ permutation
        offsets_deg = np.array(checked.offsets_deg) @ permutation
        remedies = []
        reordered = order != axes
        if reordered.any():
            names = [f"q{k}_{'mm' if slides[k - 1] else 'deg'}" for k in order]
            columns = ", ".join(words.joint(int(k)) for k in order)
            by_hand = f"put the columns in the order {columns}"
            if reordered.sum() == 2:
                both = ", ".join(words.joint(int(k)) for k in axes[reordered])
                by_hand = f"exchange the columns {both}"
            remedies.append(words.set_names(names) if words.key(names[0]) else by_hand)
        if (signs != checked.signs).any():
            remedies.append(f"set joint_signs: [{', '.join(str(int(sign)) for sign in signs)}]")
        if (offsets_deg != checked.offsets_deg).any():
            remedies.append(set_offsets(offsets_deg))
        if self.coupled != checked.arm.coupled:
            remedies.append(set_coupling(self.coupled, checked.arm))
        # An axis that runs the other way may be described so, unless anything else is wrong.
        only_signs = changes and changes == self.changes and not reordered.any()
        also = ", or reverse the axis in the arm's description" if only_signs else ""
        return " and ".join(remedies) + also

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
        arm = self.checked.arm
        couples = any(change.kind == "joint_coupling" for change in self.changes)
        text = " and ".join(change.text(arm) for change in self.changes)
        if couples:
            counted = coupling_in_words(replace(arm, coupled=self.coupled))
            text += f" ({counted or 'each by itself'})"
        then = "that is put right" if right else f"so, {STILL_WRONG}"
        joints = [joint for change in self.changes for joint in change.joints(arm)]
        return InputFinding(
            kind="joint_coupling" if couples else self.changes[0].kind,
            where="; ".join(change.where(self.checked.words) for change in self.changes),
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
