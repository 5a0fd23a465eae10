"""Which campaigns a fleet consists of: those of a table, of a list, or of folders by a pattern."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path

from pa10cal.errors import NAME_RULE, SettingsError, fits_a_folder
from pa10cal.input_files import read_csv, reason

#: A larger file is not a table of campaigns [bytes].
_MOST_BYTES = 4 * 1024**2
#: Columns of the table; the first is required.
_COLUMNS = ("campaign", "arm", "measured")
#: A date, or a part of one, and a time: by ISO 8601.
_ISO_8601 = re.compile(
    r"\d{4}(-\d{2}(-\d{2}([T ]\d{2}:\d{2}(:\d{2}(\.\d+)?)?Z?)?)?)?", flags=re.ASCII
)
#: What local time differs from UTC by, at most.
_FARTHEST_ZONE = timedelta(hours=14)


@dataclass(frozen=True)
class ListedCampaign:
    """One campaign of a fleet."""

    campaign: str  # name of its folder
    arm: str  # name of the arm that was measured; where not stated, the campaign's own name
    measured: str = ""  # date or time by ISO 8601, such as 2026-03-31; empty where not known


def campaigns_of(asked: str, raw_dir: Path) -> tuple[ListedCampaign, ...]:
    """Return the campaigns of a fleet.

    Args:
        asked: a table (.csv) with the column `campaign` and, where known, `arm` and `measured`; or
            a pattern of folders in `raw_dir`, such as `*` or `2026-*`, with the path of `raw_dir`
            or without; or names with commas, which like those of a table need not be there.
        raw_dir: folder of the campaigns.

    Raises:
        SettingsError: when there are none, the table cannot be read, has unknown columns or a row
            of another length than its header, `measured` is no date by ISO 8601, stands for some
            campaigns of an arm alone or does not say which came first, or a name is not fit for a
            folder or stands twice.
    """
    if _is_table(asked):
        return _checked(_of_table(Path(asked)), asked)
    if "," in asked:
        names = [name.strip() for name in asked.split(",")]
        return _checked([(asked, ListedCampaign(name, name)) for name in names], asked)
    within, pattern = os.path.split(asked.rstrip("/"))
    if within and Path(within).resolve() != raw_dir.resolve():
        raise SettingsError(
            "no pattern of campaigns",
            where="campaigns",
            value=asked,
            allowed=f"a table (.csv), or names of folders of {raw_dir} with *, such as 2026-*",
            remedy="correct it, or set raw_dir to the folder that holds those of the campaigns",
        )
    folders = sorted(path.parent.name for path in raw_dir.glob("*/campaign.yaml"))
    visible = [name for name in folders if not name.startswith(".")]
    names = [name for name in visible if fnmatchcase(name, pattern)]
    return _checked([(f"{raw_dir}/{name}", ListedCampaign(name, name)) for name in names], asked)


def from_any_folder(asked: str) -> str:
    """Return what asks for campaigns, see `campaigns_of`, with a path that begins at the root."""
    is_path = _is_table(asked) or ("/" in asked and "," not in asked)
    return str(Path(asked).absolute()) if is_path else asked


def _is_table(asked: str) -> bool:
    return asked.lower().endswith(".csv")


def in_order(listed: Iterable[ListedCampaign]) -> dict[str, list[ListedCampaign]]:
    """Return the campaigns of each arm in the order in which they were measured."""
    by_arm: dict[str, list[ListedCampaign]] = {}
    for campaign in listed:
        by_arm.setdefault(campaign.arm, []).append(campaign)
    return {arm: sorted(campaigns, key=_sortable_time) for arm, campaigns in by_arm.items()}


def _sortable_time(campaign: ListedCampaign) -> str:
    """Return when a campaign was measured as a text.

    Where no text begins with another, their order is that of time.
    """
    return campaign.measured.replace(" ", "T").removesuffix("Z")


def _table(path: Path) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the header of a table, and its other rows with the place that messages name."""
    try:
        read = read_csv(path, _MOST_BYTES)
        lines = [(line, [cell.strip() for cell in row]) for line, row in read]
    except (OSError, ValueError) as error:
        raise SettingsError(
            "the table of campaigns cannot be read",
            where=str(path),
            value=reason(error),
            allowed="UTF-8 text, columns divided by commas",
            remedy="check the path and the file",
        ) from None
    first, header = lines[0] if lines else (1, [])
    first_line = f"{path}, line {first}"
    if "campaign" not in header or len(set(header)) < len(header):
        raise SettingsError(
            "the table of campaigns has no column campaign, or a column twice",
            where=first_line,
            value=", ".join(header),
            allowed=f"the column {_COLUMNS[0]} and, where known, {' and '.join(_COLUMNS[1:])}, "
            "divided by commas",
            remedy="name the columns there",
        )
    if unknown := [name for name in header if name not in _COLUMNS]:
        raise SettingsError(
            "the table of campaigns has a column of an unknown name",
            where=first_line,
            value=", ".join(unknown),
            allowed=", ".join(_COLUMNS),
            remedy="correct the name, or remove the column",
        )
    return header, [(f"{path}, row {number}", row) for number, row in lines[1:]]


def _of_table(path: Path) -> list[tuple[str, ListedCampaign]]:
    """Return the campaigns of a table, each with the place that messages name."""
    header, rows = _table(path)
    listed = []
    for where, row in rows:
        if len(row) != len(header):
            raise SettingsError(
                "a row of the table of campaigns has too many cells or too few",
                where=where,
                value=", ".join(row),
                allowed=f"a cell for each of {', '.join(header)}, which may be empty",
                remedy="complete the row, or remove what is too much",
            )
        cells = dict(zip(header, row, strict=True))
        name, measured = cells["campaign"], cells.get("measured", "")
        if measured and _begin(measured) is None:
            raise SettingsError(
                "no date of a campaign",
                where=where,
                value=measured,
                allowed="a date or time by ISO 8601 with hyphens, such as 2026-03-31 or "
                "2026-03-31T14:05; UTC as 2026-03-31T12:05Z, no other zone",
                remedy="write it like these",
            )
        listed.append((where, ListedCampaign(name, cells.get("arm") or name, measured)))
    by_arm: dict[str, list[tuple[str, ListedCampaign]]] = {}
    for where, campaign in listed:
        by_arm.setdefault(campaign.arm, []).append((where, campaign))
    for campaigns_of_arm in by_arm.values():
        _refuse_some_dates(campaigns_of_arm)
        _refuse_dates_without_order(campaigns_of_arm)
    return listed


def _begin(measured: str) -> datetime | None:
    """Return when a date or time by ISO 8601, or the first part of one, begins; None for none.

    It is in the zone of the text, UTC where that ends with Z, else the local one.
    """
    if not _ISO_8601.fullmatch(measured):
        return None
    text = measured.removesuffix("Z")
    try:
        return datetime.fromisoformat(text if len(text) > 7 else text + "0000-01-01"[len(text) :])
    except ValueError:
        return None


def _refuse_some_dates(campaigns_of_arm: list[tuple[str, ListedCampaign]]) -> None:
    """Refuse an arm that has a date for some of its campaigns, and none for others."""
    dated = any(campaign.measured for _, campaign in campaigns_of_arm)
    for where, campaign in campaigns_of_arm:
        if dated and not campaign.measured:
            raise SettingsError(
                "some campaigns of an arm have a date, and others none",
                where=where,
                value=campaign.campaign,
                allowed="the column measured for all campaigns of an arm, or for none",
                remedy="complete the dates: which campaign comes before which depends on them",
            )


def _refuse_dates_without_order(campaigns_of_arm: list[tuple[str, ListedCampaign]]) -> None:
    """Refuse an arm if the dates of two of its campaigns do not say which came first."""
    dated = [(where, campaign) for where, campaign in campaigns_of_arm if campaign.measured]
    in_turn = sorted(dated, key=lambda placed: _sortable_time(placed[1]))
    for (_, before), (where, after) in pairwise(in_turn):
        # What begins with the text of a date follows it at once, as text is sorted.
        overlap = _sortable_time(after).startswith(_sortable_time(before))
        if overlap or _zones_may_exchange(before.measured, after.measured):
            raise SettingsError(
                "the dates of two campaigns of an arm do not say which came first",
                where=where,
                value=after.measured,
                allowed=f"a date before or after that of {before.campaign}, {before.measured}",
                remedy="add the day or the time of day to both, in the same time zone",
            )


def _zones_may_exchange(before: str, after: str) -> bool:
    """Return whether one of two dates is in UTC, and the other in a zone where it may be first."""
    begins = _begin(before), _begin(after)
    if begins[0] is None or begins[1] is None or before.endswith("Z") == after.endswith("Z"):
        return False
    return begins[1] - begins[0] <= _FARTHEST_ZONE


def _checked(listed: list[tuple[str, ListedCampaign]], asked: str) -> tuple[ListedCampaign, ...]:
    """Return the campaigns; refuse an empty list, names unfit for folders, and names twice."""
    if not listed:
        raise SettingsError(
            "there are no campaigns",
            where="campaigns",
            value=asked,
            allowed="at least one campaign",
            remedy="list some in the table, or correct the pattern or raw_dir",
        )
    places: dict[str, str] = {}
    for where, campaign in listed:
        name = campaign.campaign
        if not fits_a_folder(name):
            raise SettingsError(
                "no name of a campaign",
                where=where,
                value=name,
                allowed=NAME_RULE,
                remedy="correct it; a folder of another name has to be renamed",
            )
        if name in places:
            raise SettingsError(
                "a campaign stands twice",
                where=where,
                value=name,
                allowed="each campaign once"
                + (f"; it stands in {places[name]} too" if places[name] != where else ""),
                remedy="remove one of the two",
            )
        places[name] = where
    return tuple(campaign for _, campaign in listed)
