"""A URDF as a tree of links and joints, and the serial path through it."""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.errors import ArmError
from pa10cal.near_miss import remedy_for

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as the file has it."""

    name: str
    kind: str  # its type
    # parent and child: the links it joins
    parent: str
    child: str
    follows: str  # the joint it mimics, or an empty text
    # xyz and rpy: place [m] and turns about fixed axes [rad] of its frame in the parent
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]  # direction in which it moves, in its own frame
    limits: tuple[float, float]  # lower and upper [rad or m]; nan where they are not stated
    effort: float  # rated torque [N m] or force [N]; nan where it is not stated


@dataclass(frozen=True)
class UrdfLink:
    """One link as the file has it."""

    name: str
    mass_kg: float  # its mass; 0 where it is not stated
    com_m: tuple[float, ...]  # centre of mass in its own frame


@dataclass(frozen=True)
class UrdfTree:
    """Links and joints of one robot."""

    where: str  # the file
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]  # all joints, each below another or below the root
    root: str  # the link that no joint carries

    def path(self, base: str | None, tip: str | None) -> tuple[str, str, tuple[UrdfJoint, ...]]:
        """Return base and tip and the joints between them, fixed ones too.

        Args:
            base: link to start from; None for the root.
            tip: link to end at; None where there is but one.

        Raises:
            ArmError: for unknown links, several tips, or joints that no chain can follow.
        """
        base = self.root if base is None else self._known(base, "--base")
        carriers = {joint.child: joint for joint in self.joints}
        # What a fixed joint carries moves with what it is fixed to: the base may be a side branch.
        with_base = [base]
        while with_base[-1] in carriers and carriers[with_base[-1]].kind == "fixed":
            with_base.append(carriers[with_base[-1]].parent)
        tip = self._only_tip(with_base[-1]) if tip is None else self._known(tip, "--tip")
        joints: list[UrdfJoint] = []
        link = tip
        while link not in with_base:
            if link not in carriers:
                beyond = self._beyond(with_base[-1])
                raise ArmError(
                    "the tip is not beyond the base",
                    where=self.where,
                    value=tip,
                    allowed=f"a link beyond {base}: {', '.join(beyond) or 'none'}",
                    remedy="name another base or tip",
                )
            joints.append(carriers[link])
            link = carriers[link].parent
        joints.reverse()
        self._check(joints, base, tip)
        return base, tip, tuple(joints)

    def _known(self, name: str, option: str) -> str:
        names = [link.name for link in self.links]
        if name not in names:
            raise ArmError(
                f"{option} names no link",
                where=self.where,
                value=name,
                allowed=", ".join(names),
                remedy=remedy_for(name, names, f"name one of these links for {option}"),
            )
        return name

    def _beyond(self, base: str) -> list[str]:
        """Return the links beyond a link, in the order of the file."""
        found, open_ = [], [base]
        while open_:
            link = open_.pop()
            children = [joint.child for joint in self.joints if joint.parent == link]
            found += children
            open_ += children
        return [link.name for link in self.links if link.name in found]

    def _only_tip(self, base: str) -> str:
        beyond = self._beyond(base)
        parents = {joint.parent for joint in self.joints}
        moving = {
            link
            for joint in self.joints
            if joint.kind != "fixed" and joint.child in beyond
            for link in (joint.child, *self._beyond(joint.child))
        }
        tips = [link for link in beyond if link not in parents and link in moving]
        if len(tips) > 1:
            raise ArmError(
                "the robot branches, and no tip is named",
                where=self.where,
                value=f"{len(tips)} tips",
                allowed=", ".join(tips),
                remedy="name the end of the arm with --tip",
            )
        return tips[0] if tips else base

    def _check(self, joints: list[UrdfJoint], base: str, tip: str) -> None:
        """Refuse a path without a moving joint, or with one that does not move by itself."""
        if not any(joint.kind in MOVING for joint in joints):
            raise ArmError(
                "no joint moves between base and tip",
                where=self.where,
                value=f"{base} to {tip}",
                allowed="at least one joint of type " + ", ".join(MOVING),
                remedy="name another base or tip",
            )
        for joint in joints:
            if joint.kind not in (*MOVING, "fixed"):
                raise ArmError(
                    "a joint of this type is not in a serial arm",
                    where=f"{self.where}: joint {joint.name}",
                    value=joint.kind,
                    allowed=", ".join((*MOVING, "fixed")),
                    remedy="name a base beyond this joint with --base",
                )
            if joint.follows:
                raise ArmError(
                    f"the joint follows joint {joint.follows} (mimic)",
                    where=f"{self.where}: joint {joint.name}",
                    allowed="independent joints",
                    remedy="name a base beyond this joint, or a tip before it",
                )
