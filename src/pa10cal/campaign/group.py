"""Groups: several campaigns of one robot, described and read as one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import yaml

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.campaign.description import GROUP_SCHEMA, SCHEMA, CampaignDescription
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.quantities import Start
from pa10cal.settings_reading import parse_section

#: What makes an arm another one, and by how much it may differ.
_GEOMETRY = (
    "theta_rad",
    "d_m",
    "a_m",
    "alpha_rad",
    "beta_rad",
    "hayati",
    "prismatic",
    "T_base_row1",
    "T_row_n_ee",
)
_SAME_GEOMETRY = 1e-12


class GroupDescription(CampaignDescription):
    """Several campaigns of one robot; what stands beside them is that of the first."""

    members: tuple[CampaignDescription, ...]  # the campaigns

    @property
    def campaigns(self) -> tuple[CampaignDescription, ...]:
        """Return the campaigns."""
        return self.members

    @property
    def from_touches(self) -> bool:
        """Return that a group takes the general model, whatever measured."""
        return False

    @property
    def instrument_kinds(self) -> str:
        """Return the words of the instruments, each once."""
        return " and ".join(dict.fromkeys(member.instrument.kind for member in self.members))

    def payload(self, arm: Arm) -> Payload | None:
        """Return what the arm carries, of each campaign where they differ."""
        each = [member.payload(arm) for member in self.members]
        known = tuple(payload for payload in each if payload is not None)
        if not known:
            return None
        differ = any(not _same(known[0], payload) for payload in known[1:])
        return replace(known[0], of_campaigns=known) if differ else known[0]


@dataclass(frozen=True)
class MemberRead:
    """A campaign of a group, as it was read."""

    description: CampaignDescription
    arm: Arm  # the nominal arm that it names
    observations: Observations  # single readings of all kinds


def describe_group(name: str, members: Sequence[MemberRead]) -> GroupDescription:
    """Describe a group of campaigns.

    Raises:
        RawDataError: when there are fewer than two, one is there twice or has the group's name, or
            they are not of one robot.
    """
    names = [member.description.name for member in members]
    check_names(name, names, f"group {name}")
    for member, of in zip(members[1:], names[1:], strict=True):
        _refuse_another_robot(members[0], member, f"group {name}: {names[0]} and {of}")
    return _described(name, [member.description for member in members])


def check_names(name: str, names: Sequence[str], where: str) -> None:
    """Refuse a group that is none.

    Raises:
        RawDataError: when it has fewer than two campaigns, or names that are not apart.
    """
    twice = sorted({each for each in names if list(names).count(each) > 1})
    if len(names) < 2:
        what, value = "a group has fewer than two campaigns", ", ".join(names) or "none"
    elif twice:
        what, value = "a campaign stands in a group twice", twice[0]
    elif name in names:
        what, value = "a group is called like one of its campaigns", name
    else:
        return
    raise RawDataError(
        what,
        where=where,
        value=value,
        allowed="two or more campaigns, each once, and a name of the group's own",
        remedy="correct the list of campaigns, or rename the group",
    )


def group_of_content(content: Mapping[str, Any], where: str) -> GroupDescription:
    """Return the group that the content of its campaign.yaml describes; see `group_text`.

    Raises:
        RawDataError: when it lacks its campaigns.
        SettingsError: when a key of one of them does not fit.
    """
    name, listed = content.get("name"), content.get("campaigns")
    if not isinstance(name, str) or not isinstance(listed, list):
        raise RawDataError(
            "the group lacks its name or its campaigns",
            where=where,
            value=sorted(content),
            allowed="name and campaigns, as pa10cal join writes them",
            remedy="run pa10cal join again",
        )
    described = []
    for number, each in enumerate(listed):
        keys = {key: value for key, value in dict(each).items() if key != "schema"}
        described.append(
            parse_section(CampaignDescription, keys, where=f"{where}: campaigns[{number}]")
        )
    check_names(name, [each.name for each in described], where)
    return _described(name, described)


def group_text(group: CampaignDescription) -> str:
    """Return the campaign.yaml of a group: the descriptions of its campaigns."""
    campaigns = [
        {"schema": SCHEMA, **each.model_dump(mode="json", exclude_none=True)}
        for each in group.campaigns
    ]
    content: dict[str, Any] = {"schema": GROUP_SCHEMA, "name": group.name, "robot": group.robot}
    content["instrument"] = {"kind": group.instrument.kind}
    content["campaigns"] = campaigns
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def start_by_nominal(member: MemberRead) -> Start:
    """Find about where base and targets of a campaign are, by its nominal arm."""
    grid = average_repeats(member.observations.of_kind("grid"))
    unloaded = grid.take(grid.states.load_N == grid.states.load_N.min())
    return unloaded.measured.find_start(Chain.of(member.arm).forward(unloaded.states.q_rad))


def _described(name: str, members: Sequence[CampaignDescription]) -> GroupDescription:
    first = {key: getattr(members[0], key) for key in CampaignDescription.model_fields}
    provenance = "; ".join(dict.fromkeys(member.provenance for member in members))
    commanded = all(member.joints == "commanded" for member in members)
    own = {"name": name, "provenance": provenance, "members": tuple(members)}
    own["joints"] = "commanded" if commanded else "logged"
    return GroupDescription(**first | {"holdout": None, "columns": None} | own)


def _refuse_another_robot(first: MemberRead, other: MemberRead, where: str) -> None:
    """Refuse campaigns of two robots, or of one described by two nominal tables."""
    names = first.description.robot, other.description.robot
    differ = None if names[0] == names[1] else f"robot: {names[0]} and {names[1]}"
    if differ is None:
        differ = _difference(first.arm, other.arm)
    if differ is None:
        return
    raise RawDataError(
        "the campaigns of a group are not of one robot",
        where=where,
        value=differ,
        allowed="campaigns of one robot, described by the same nominal rows",
        remedy="take the other campaign out of the group, or describe the robot alike in both",
    )


def _difference(first: Arm, other: Arm) -> str | None:
    """Say in which row two descriptions of an arm differ; None where they do not."""
    if (first.n, first.convention) != (other.n, other.convention):
        return f"{first.n} {first.convention} rows and {other.n} {other.convention} rows"
    for name in _GEOMETRY:
        one, two = (np.asarray(getattr(arm, name), dtype=float) for arm in (first, other))
        if one.shape != two.shape:
            return name
        off = np.abs(one - two)
        if off.max(initial=0.0) > _SAME_GEOMETRY:
            at = np.unravel_index(int(np.argmax(off)), off.shape)
            return f"{name}, row {int(at[0]) + 1}: {one[at]:.9g} and {two[at]:.9g}"
    return None


def _same(first: Payload, other: Payload) -> bool:
    return all(
        np.array_equal(getattr(first, field.name), getattr(other, field.name))
        for field in fields(Payload)
        if field.name != "of_campaigns"
    )
