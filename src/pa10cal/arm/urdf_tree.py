"""A URDF as a tree of links and joints, and the serial paths through it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import takewhile

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import placed, roll_pitch_yaw
from pa10cal.arm.description import LONGEST_M, MOST_ROWS
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError, remedy_for

#: Types of a joint that moves in a serial arm.
MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as the file has it."""

    name: str
    kind: str  # its type
    # parent and child: the links it joins
    parent: str
    child: str
    follows: str  # the joint it mimics; empty for none
    # its position is `multiplier` times that of the joint it mimics, plus `offset` [rad or m]
    multiplier: float
    offset: float
    # position [m], and roll, pitch and yaw [rad], of its frame in the parent
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]  # direction in which it moves, in its own frame
    # lower and upper [rad or m]; one that is not stated beside the other is 0, nan without either
    limits: tuple[float, float]
    effort: float  # rated torque [N m] or force [N]; nan where it is not stated

    def origin_at(self, position: float) -> Array:
        """Return the pose (4, 4) of its child in its parent at a position [rad or m].

        Of a joint that is none of `MOVING` at any position: that where it does not move.
        """
        T = placed(np.array(self.xyz), np.array(self.rpy))
        if self.kind not in MOVING:
            return T
        along = np.array(self.axis) / max(np.linalg.norm(self.axis), 1e-300) * position
        if self.kind == "prismatic":
            return T @ homogeneous(np.eye(3), along)
        return T @ homogeneous(Rotation.from_rotvec(along).as_matrix(), np.zeros(3))


@dataclass(frozen=True)
class Leader:
    """The joint that another mimics, directly or by way of others, and which itself mimics none."""

    name: str
    # the follower's position is `multiplier` times the leader's, plus `offset` [rad or m]
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfLink:
    """One link as the file has it."""

    name: str
    mass_kg: float  # its mass; 0 where it is not stated
    com_m: tuple[float, ...]  # centre of mass in its own frame


@dataclass(frozen=True)
class SerialPath:
    """What lies between two links of a robot."""

    # base and tip: the links at its ends
    base: str
    tip: str
    # from the base on, fixed ones too; those of a base on a side branch begin at the link by which
    # it is one body with the arm
    joints: tuple[UrdfJoint, ...]
    leaders: Mapping[str, Leader]  # of each joint that mimics another, by the joint's name


def _ends_without(joint: UrdfJoint, path: Sequence[UrdfJoint]) -> str:
    """Return the remedy for a joint of a path: ends between which others move, and it does not."""
    before, beyond = path[: path.index(joint)], path[path.index(joint) + 1 :]
    ends = []
    if any(other.kind in MOVING for other in beyond):
        ends.append(f"a base beyond this joint with --base, such as {joint.child}")
    if any(other.kind in MOVING for other in before):
        ends.append(f"a tip before it with --tip, such as {joint.parent}")
    return f"name {', or '.join(ends) or 'another base or tip'}"


def _refuse_unusable(joint: UrdfJoint, path: Sequence[UrdfJoint], where: str) -> None:
    """Refuse a joint between base and tip by its type or numbers, which off that path do no harm.

    Raises:
        ArmError: naming what cannot be used.
    """
    if joint.kind not in (*MOVING, "fixed"):
        raise ArmError(
            "a joint of this type is not in a serial arm",
            where=where,
            value=joint.kind,
            allowed="revolute, continuous, prismatic, fixed",
            remedy=_ends_without(joint, path),
        )
    if math.hypot(*joint.xyz) > LONGEST_M:
        raise ArmError(
            f"the joint is further than {LONGEST_M:g} m from the one before",
            where=where,
            value=joint.xyz,
            allowed="metres",
            remedy=f"divide by 1000 if these are millimetres; else {_ends_without(joint, path)}",
        )
    if joint.kind == "fixed":
        return
    lower, upper = joint.limits
    if lower >= upper:
        raise ArmError(
            "the limits allow the joint no motion",
            where=where,
            value=joint.limits,
            allowed="the lower limit first, then a higher one",
            remedy="correct the limits",
        )
    if math.hypot(*joint.axis) < 1e-9:
        raise ArmError(
            "the axis has no direction",
            where=where,
            value=joint.axis,
            allowed="not all zero",
            remedy="correct it",
        )


def _is_fixed(joint: UrdfJoint) -> bool:
    return joint.kind == "fixed"


@dataclass(frozen=True)
class UrdfTree:
    """Links and joints of one robot."""

    where: str  # the file
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]  # all joints, each below another or below the root
    root: str  # the link that no joint carries
    turned: frozenset[str] = frozenset()  # joints that carried the root before `seen_from`

    def seen_from(self, base: str | None, tip: str | None) -> UrdfTree:
        """Return the same robot with the base as its root, where the tip is not beyond the base.

        So a camera on the head sees a hand, and a sensor on the flange what stands in the cell. A
        joint that carried the base then carries the link that it stood on, by way of a further link
        at its origin: it turns by the same angle about the opposite axis.

        Args:
            base, tip: links; a name that is none, or not given, changes nothing.
        """
        known = {link.name for link in self.links}
        if base not in known or tip not in known or tip == base:
            return self
        carriers = self.above(base)
        body = [base, *(j.parent for j in takewhile(_is_fixed, reversed(carriers)))]
        if {tip, *(joint.parent for joint in self.above(tip))} & set(body):
            return self
        turned, beside = [], []
        for joint in carriers:
            T = np.linalg.inv(joint.origin_at(0.0))
            back = replace(joint, parent=joint.child, child=joint.parent)
            if not _is_fixed(joint):
                seat = f"{joint.parent} of {joint.name}"
                against = tuple(-along for along in joint.axis)
                turned.append(
                    replace(back, child=seat, xyz=(0.0,) * 3, rpy=(0.0,) * 3, axis=against)
                )
                beside.append(UrdfLink(seat, 0.0, (0.0,) * 3))
                back = replace(back, name=seat, kind="fixed", parent=seat, follows="")
            rpy = roll_pitch_yaw(np.asarray(T[:3, :3]))
            turned.append(replace(back, xyz=tuple(T[:3, 3].tolist()), rpy=tuple(rpy.tolist())))
        others = [joint for joint in self.joints if joint not in carriers]
        names = frozenset(joint.name for joint in carriers if not _is_fixed(joint))
        links = (*self.links, *beside)
        return UrdfTree(self.where, links, (*turned, *others), base, names)

    def path(self, base: str | None, tip: str | None) -> SerialPath:
        """Return the path between two links.

        Args:
            base: link to start from; None for the root.
            tip: link to end at; None where there is but one.

        Raises:
            ArmError: for unknown links, several tips, or joints that no chain can follow.
        """
        base = self.root if base is None else self._known(base, "--base")
        # The base may be a side branch: it is one body with all links towards the root that only
        # fixed joints lie between.
        fixed = takewhile(_is_fixed, reversed(self.above(base)))
        base_body = [base, *(joint.parent for joint in fixed)]
        base_body_top = base_body[-1]
        tip = self._only_tip(base_body_top) if tip is None else self._known(tip, "--tip")
        from_tip = takewhile(lambda joint: joint.child not in base_body, reversed(self.above(tip)))
        joints = tuple(from_tip)[::-1]
        begins_at = joints[0].parent if joints else tip
        if begins_at not in base_body:
            beyond = ", ".join(self._beyond(base_body_top)) or "none"
            raise ArmError(
                "the tip is not beyond the base",
                where=self.where,
                value=tip,
                allowed=f"a link beyond {base}: {beyond}",
                remedy="name another base or tip",
            )
        self._refuse_unless_serial(joints, f"{base} to {tip}")
        return SerialPath(base, tip, joints, self._leaders(joints))

    def _leaders(self, path: Sequence[UrdfJoint]) -> dict[str, Leader]:
        """Return the leader of each joint of a path that mimics another, by the joint's name.

        Raises:
            ArmError: when one of them mimics a joint that is not on the path, or itself.
        """
        on_path = {joint.name: joint for joint in path if joint.kind in MOVING}
        leaders = {}
        for joint in on_path.values():
            leader, seen = joint, {joint.name}
            multiplier, offset = 1.0, 0.0
            while leader.follows:
                # q = m (m' q' + o') + o = (m m') q' + (o + m o'), where q' is of the next leader.
                offset = offset + multiplier * leader.offset
                multiplier = multiplier * leader.multiplier
                cause, followed = None, leader.follows
                if leader.follows in seen:
                    cause, followed = "in a circle", joint.follows
                elif leader.follows not in on_path:
                    cause = f"{leader.follows} does not move between base and tip"
                elif multiplier == 0.0:
                    cause = "multiplier 0"
                if cause is not None:
                    raise ArmError(
                        f"the joint follows joint {followed} (mimic)",
                        where=f"{self.where}: joint {joint.name}",
                        value=cause,
                        allowed="a joint that moves between base and tip, which it follows by more "
                        "than nothing",
                        remedy=_ends_without(joint, path),
                    )
                leader = on_path[leader.follows]
                seen.add(leader.name)
            if leader is not joint:
                leaders[joint.name] = Leader(leader.name, multiplier, offset)
        return leaders

    def above(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints that carry a link, from the root on."""
        to_root: list[UrdfJoint] = []
        while link in self._carriers:
            to_root.append(self._carriers[link])
            link = to_root[-1].parent
        return tuple(reversed(to_root))

    def below(self, link: str) -> Iterator[UrdfJoint]:
        """Yield the joints beyond a link, each after the one that carries it."""
        links = [link]
        while links:
            for joint in self.carried_by(links.pop()):
                yield joint
                links.append(joint.child)

    def carried_by(self, link: str) -> Sequence[UrdfJoint]:
        """Return the joints that a link carries, in the order of the file."""
        return self._carried.get(link, ())

    def _refuse_unless_serial(self, joints: Sequence[UrdfJoint], ends: str) -> None:
        """Refuse a path, called by its ends, that has too few or too many joints or other types."""
        for joint in joints:
            _refuse_unusable(joint, joints, f"{self.where}: joint {joint.name}")
        moving = sum(joint.kind in MOVING for joint in joints)
        if not moving:
            raise ArmError(
                "no joint moves between base and tip",
                where=self.where,
                value=ends,
                allowed="at least one joint of type revolute, continuous, prismatic",
                remedy="name another base or tip",
            )
        if moving > MOST_ROWS:
            raise ArmError(
                "too many joints move between base and tip",
                where=self.where,
                value=moving,
                allowed=f"at most {MOST_ROWS}",
                remedy="name another base or tip",
            )

    @cached_property
    def _carriers(self) -> Mapping[str, UrdfJoint]:
        """Return the joint that carries each link but the root."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def _carried(self) -> Mapping[str, list[UrdfJoint]]:
        """Return the joints that each link carries; links without any are not among the keys."""
        carried: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints:
            carried.setdefault(joint.parent, []).append(joint)
        return carried

    def _known(self, name: str, option: str) -> str:
        """Return the name of a link if there is such a link; else refuse it."""
        names = [link.name for link in self.links]
        if name not in names:
            remedy = remedy_for(name, names, f"name one of these links for {option}")
            raise ArmError(
                f"{option} names no link",
                where=self.where,
                value=name,
                allowed=", ".join(names),
                remedy=remedy,
            )
        return name

    def _beyond(self, base: str) -> list[str]:
        """Return the links beyond a link, in the order of the file."""
        beyond = {joint.child for joint in self.below(base)}
        return [link.name for link in self.links if link.name in beyond]

    def _only_tip(self, base: str) -> str:
        """Return the one last link beyond a base that moves against it; the base where none does.

        Raises:
            ArmError: when there are several.
        """
        # Floating and planar joints move too: the path to such a tip is refused, not the tip.
        moves = {base: False}
        for joint in self.below(base):
            moves[joint.child] = moves[joint.parent] or joint.kind != "fixed"
        beyond = (link.name for link in self.links if moves.get(link.name))
        tips = [link for link in beyond if link not in self._carried]
        if len(tips) > 1:
            raise ArmError(
                "the robot branches, and no tip is named",
                where=self.where,
                value=f"{len(tips)} tips",
                allowed=", ".join(tips),
                remedy="name the end of the arm with --tip",
            )
        return tips[0] if tips else base
