"""Several campaigns' folders to the readings of one robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pa10cal.campaign.group import MemberRead, describe_group, start_by_nominal
from pa10cal.campaign.options import IngestOptions
from pa10cal.campaign.read import Campaign, read_campaign
from pa10cal.campaign.weighed_arm import arm_of
from pa10cal.observe.group import Member, join


def read_group(
    folders: Sequence[Path | str], name: str = "group", options: IngestOptions | None = None
) -> Campaign:
    """Read several measurement campaigns of one robot as one.

    Link departures, springs and effects are shared. Base, tool or targets, and noise are each
    campaign's own: their parameters bear its name, as `tool_x@ur10-c`. Labels of poses do too.

    Args:
        folders: the campaigns' folders; the first gives the frame of the base and the attitude of
            the target.
        name: of the group.
        options: how to ingest; None for the defaults.

    Raises:
        RawDataError: when one cannot be used (see `read_campaign`), they are fewer than two or of
            several robots, or names are not apart.
        CalibrationError: when the poses of one do not determine its base and targets.
    """
    read = [read_campaign(folder, options) for folder in folders]
    members = [MemberRead(each.description, each.arm, each.observations) for each in read]
    description = describe_group(name, members)
    placed = [
        Member(each.name, each.observations, start_by_nominal(member))
        for each, member in zip(read, members, strict=True)
    ]
    together = join(placed)
    quarantined = (
        replace(row, file=f"{each.name}/{row.file}") for each in read for row in each.quarantined
    )
    return Campaign(
        read[0].folder,
        description,
        arm_of(description, read[0].folder, together),
        together,
        tuple(quarantined),
        tuple(f"{each.name}: {note}" for each in read for note in each.notes),
        tuple(f"{each.name}: {warning}" for each in read for warning in each.warnings),
    )
