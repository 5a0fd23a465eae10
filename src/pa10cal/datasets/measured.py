"""Campaigns of real robots: what is known of each, and which are at hand.

Nothing here comes from a run. The workflow reads this while it plans, so it needs no other library.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Known:
    """What is known of a measured campaign before it is worked on."""

    dataset: str | None  # the data set that it is imported of; None where none has it
    instrument: str  # what measured it, for a reader
    # what the owner or somebody else reports of these data, with its source; empty where nothing
    # is known
    published: str = ""


_TITAN, _IIWA7, _MOTOMAN = "titan-robot-accuracy", "iiwa7-robot-calibration", "welding-motoman"
_JUSTIN, _UR10 = "dlr-elastic-calibration", "ipa-robot-accuracy"
_OWNERS_TITAN = (
    "the owner's own compensated model: {} mm rms over all points (columns xn1 … zn3 of {})"
)
_OPTICAL = "optical tracker, poses; torques logged"
_ANOTHERS_SPRINGS = (
    "an independent fit: springs of `iiwa7-free` carried here {} mm rms, {} without springs"
)
_GRAVITY = (
    "the owners: an error with the form of gravity in joints 2 and 3; their model lowers the "
    "largest error by more than half (arXiv 2510.19962)"
)
_LADDER = (
    "the owners, mean in sample over both arms: frames alone 21.3 mm, geometry 10.5, joint "
    "elasticity 5.64, lateral elasticity too 3.12 (Tenhumberg and Bäuml, ieeexplore 9555793)"
)

#: Campaigns in the order of the page.
CAMPAIGNS: Mapping[str, Known] = {
    "titan-fixed": Known(
        _TITAN, "three points, instrument not stated", _OWNERS_TITAN.format(0.172, "robodata.csv")
    ),
    "titan-rail": Known(
        _TITAN,
        "three points, instrument not stated",
        _OWNERS_TITAN.format("0.17 to 0.18", "robodata2.csv"),
    ),
    "ma2010-0516": Known(_MOTOMAN, "OptiTrack, poses", _GRAVITY),
    "ma2010-0801": Known(_MOTOMAN, "OptiTrack, poses", _GRAVITY),
    "iiwa7-free": Known(
        _IIWA7, _OPTICAL, "an independent fit: geometry and springs 0.296 mm rms held out"
    ),
    "iiwa7-0kg": Known(_IIWA7, _OPTICAL, _ANOTHERS_SPRINGS.format(0.44, 1.39)),
    "iiwa7-1250g": Known(_IIWA7, _OPTICAL, _ANOTHERS_SPRINGS.format("0.50", 1.58)),
    "iiwa7-2500g": Known(_IIWA7, _OPTICAL, _ANOTHERS_SPRINGS.format(0.57, 1.77)),
    "justin-left": Known(_JUSTIN, "Vicon, one marker", _LADDER),
    "justin-left-tau": Known(None, "Vicon, one marker; torques of assumed masses", _LADDER),
    "justin-right": Known(_JUSTIN, "Vicon, one marker", _LADDER),
    "irb120": Known(
        "faro-irb120",
        "laser tracker, three reflectors, three on the base",
        "an independent fit of poses made of the reflectors by hand: 0.59 mm rms held out, 0.48 "
        "with effects; reflectors agree to 0.006 mm",
    ),
    "ur10-a": Known(
        _UR10,
        "laser tracker, poses",
        "an independent fit: geometry 0.430 mm rms held out, springs 0.411, errors of the sensors "
        "0.088",
    ),
    "ur10-c": Known(
        _UR10,
        "laser tracker, poses",
        "an independent fit: geometry 0.485 mm rms held out, springs 0.483, errors of the sensors "
        "0.078",
    ),
}
#: Several campaigns of one robot, fitted as one where all of them are at hand.
GROUPS: Mapping[str, tuple[str, ...]] = {
    "ma2010": ("ma2010-0516", "ma2010-0801"),
    "iiwa7": ("iiwa7-free", "iiwa7-0kg", "iiwa7-1250g", "iiwa7-2500g"),
    "ur10": ("ur10-a", "ur10-c"),
}
#: Models carried to another campaign: source and target.
CARRIED = (
    *(("iiwa7-free", f"iiwa7-{payload}") for payload in ("0kg", "1250g", "2500g")),
    ("ur10-a", "ur10-c"),
    ("ur10-c", "ur10-a"),
)


@dataclass(frozen=True)
class AtHand:
    """A measured campaign that is at hand."""

    folder: Path  # its folder of raw files, which an import writes where there is a data set
    # the data set that it is imported of; None where the folder is there already
    dataset: str | None = None
    source: Path | None = None  # the folder of that data set


def at_hand(measured_dir: Path, sources: Mapping[str, str], imported: Path) -> dict[str, AtHand]:
    """Return the campaigns at hand by name, those of the page first and in its order.

    Args:
        measured_dir: holds folders of campaigns, and data sets in folders of their names.
        sources: folders of data sets by name, where they lie elsewhere; addresses do not count.
        imported: gets the campaigns that are imported.
    """
    there = {path.parent.name: path.parent for path in measured_dir.glob("*/campaign.yaml")}
    found = {}
    for name, known in CAMPAIGNS.items():
        source = _source(known.dataset, measured_dir, sources)
        if name in there:
            found[name] = AtHand(there[name])
        elif source is not None:
            found[name] = AtHand(imported / name, known.dataset, source)
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
    yield from sorted(path for path in folder.rglob("*") if path.is_file())


def _source(dataset: str | None, measured_dir: Path, sources: Mapping[str, str]) -> Path | None:
    """Return the folder of a data set, where there is one."""
    if dataset is None:
        return None
    named = sources.get(dataset, "")
    places = (Path(named),) if named else (measured_dir / dataset,)
    return next((place for place in places if place.is_dir()), None)
