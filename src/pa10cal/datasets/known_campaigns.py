"""Campaigns of real robots: what is known of each, and which are at hand.

The workflow reads them while it plans, before anything is run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pa10cal.errors import RecordError, SettingsError
from pa10cal.input_files import is_file
from pa10cal.yaml_file import read_yaml


@dataclass(frozen=True)
class Known:
    """What is known of a measured campaign before it is worked on."""

    instrument: str  # what measured it, for a reader
    dataset: str | None = None  # the data set that it is imported of; None where none has it
    # what the owner or somebody else reports of these data, with its source; empty where nothing
    # is known
    published: str = ""


_STATED = read_yaml(
    Path(__file__).with_name("measured.yaml"), RecordError, what="it cannot be read"
)
#: Campaigns in the order of the page.
CAMPAIGNS: Mapping[str, Known] = {
    name: Known(**stated) for name, stated in _STATED["campaigns"].items()
}
#: Several campaigns of one robot, fitted as one where all of them are at hand.
GROUPS: Mapping[str, tuple[str, ...]] = {
    name: tuple(members) for name, members in _STATED["groups"].items()
}
#: Models carried to another campaign: source and target.
CARRIED = tuple((source, target) for source, target in _STATED["carried"])


@dataclass(frozen=True)
class AtHand:
    """A measured campaign that is at hand."""

    folder: Path  # its folder of raw files, which an import writes where there is a data set
    # the data set that it is imported of; None where the folder is there already
    dataset: str | None = None
    source: Path | None = None  # the folder of that data set


def at_hand(measured_dir: Path, sources: Mapping[str, str], imported: Path) -> dict[str, AtHand]:
    """Return the campaigns at hand by name, those of the page first and in its order.

    A folder holds campaigns, and data sets in folders of their names, where `sources` does not name
    another folder; from an address a data set is fetched into the folder of its name. `imported`
    gets the campaigns that are imported.

    Raises:
        SettingsError: when a folder that `sources` names is not there.
    """
    folders = {
        dataset: Path(stated).expanduser()
        for dataset, stated in sources.items()
        if stated and "://" not in stated
    }
    for dataset, folder in folders.items():
        if not folder.is_dir():
            raise SettingsError(
                "there is no such folder",
                where=f"dataset_sources: {dataset}",
                value=str(folder),
                allowed="a folder with the files of the data set, or an address",
                remedy="correct the path, or remove it",
            )
    there = {path.parent.name: path.parent for path in measured_dir.glob("*/campaign.yaml")}
    found = {}
    for name, known in CAMPAIGNS.items():
        dataset = known.dataset or ""
        source = folders.get(dataset, measured_dir / dataset)
        if name in there:
            found[name] = AtHand(there[name])
        elif dataset and source.is_dir():
            found[name] = AtHand(imported / name, dataset, source)
    others = sorted(set(there) - set(found))
    return found | {name: AtHand(there[name]) for name in others}


def groups_of(campaigns: Mapping[str, object]) -> dict[str, tuple[str, ...]]:
    """Return the groups of which all campaigns are among some."""
    return {
        name: members
        for name, members in GROUPS.items()
        if name not in campaigns and all(member in campaigns for member in members)
    }


def files_of(hand: AtHand) -> Iterator[Path]:
    """Yield the files that a campaign is read from, those that are there."""
    folder = hand.folder if hand.source is None else hand.source
    yield from sorted(path for path in folder.rglob("*") if is_file(path, folder))
