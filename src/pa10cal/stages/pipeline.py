"""The stages from raw files to a model: one list, which whoever judges a campaign walks.

A stage is a command with its options. Snakemake's rules run it as a process of its own, with the
words of its command line; `chain`, fleets and trials call its function with the same options.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from pa10cal.evaluation.options import ChainOptions
from pa10cal.options import Section

#: Load case of all loads together.
_COMBINED = "combined"
#: Among the results of a group: what it reads of its members.
MEMBERS = "members"
#: Commands that stand in one module, `stages.readings`; the others have modules of their name.
_READINGS = ("ingest", "join", "seed")


@dataclass(frozen=True)
class Stage:
    """One stage of a campaign: a command, its options, and what lies on disk before and after."""

    name: str  # of the rule; no two stages share one, but those of a group's members
    options: Mapping[str, Any]  # those of the command
    writes: Mapping[str, Path]  # its own results
    reads: Mapping[str, Path] = field(default_factory=dict)  # results of earlier stages

    @property
    def command(self) -> str:
        """Return the command that it is."""
        return "calibrate" if self.name == "baseline" else self.name

    @property
    def module(self) -> str:
        """Return the module of the package `stages` in which its command stands."""
        return "readings" if self.command in _READINGS else self.command

    def run(self) -> None:
        """Run it in this process.

        Raises:
            Pa10calError: what its command raises.
        """
        getattr(import_module(f"pa10cal.stages.{self.module}"), self.command)(**self.options)

    @property
    def words(self) -> str:
        """Return the words of the command line that runs it, after the name of the program."""
        words = [self.command]
        for name, value in self.options.items():
            option = "--" + name.replace("_", "-")
            if isinstance(value, Section):
                words += [option, value.model_dump_json()]
            elif isinstance(value, tuple):
                words += [option, *map(str, value)]
            elif value is True:
                words.append(option)
            elif value is not None:
                words += [option, str(value)]
        return shlex.join(words)


class CampaignFiles:
    """Where the results of a campaign lie."""

    def __init__(self, results: Path) -> None:
        """Take the folder of all of them."""
        self.results = results
        self.poses = results / "ingest/poses.parquet"  # the table of poses
        self.quarantine = results / "ingest/quarantine.csv"  # rows that are not used
        self.base_frame = results / "seed/base_frame.json"
        self.verdict = results / "discovery/verdict.json"
        self.extended = results / "discovery/extended.json"  # the model with the effects found

    def calibration(self, load: str = _COMBINED, *, bare: bool = False) -> Path:
        """Return a load case; `bare`: without effects that are those of the verdict."""
        return self.results / ("baseline" if bare else "calibration") / f"{load}.json"


def stages(
    folders: tuple[Path, ...],
    results: Path,
    settings: ChainOptions = ChainOptions(),
    load: str | None = None,
) -> Iterator[Stage]:
    """Yield every stage of a campaign, or of a group, in order.

    A group reads the raw files of its members itself: results that they have are not changed. With
    the effects of the verdict a campaign is calibrated twice: what is searched is the first,
    `baseline`, without them.

    Args:
        folders: raw files of the campaign; of a group those of its members.
        results: folder of the results.
        settings: sections of the stages.
        load: one load case alone; None for all.
    """
    at, raw = CampaignFiles(results), folders[0]
    table = {"poses": at.poses, "quarantine": at.quarantine}
    if len(folders) > 1:
        own = [CampaignFiles(results / MEMBERS / folder.name) for folder in folders]
        for folder, each in zip(folders, own, strict=True):
            yield from islice(stages((folder,), each.results, settings), 2)
        raw = at.poses.parent
        joined: dict[str, Any] = {
            "name": results.name,
            "campaign_dir": folders,
            "poses": tuple(each.poses for each in own),
            "base_frame": tuple(each.base_frame for each in own),
            "out_dir": raw,
        }
        yield Stage("join", joined, writes=table | {"campaign": raw / "campaign.yaml"})
    else:
        read: dict[str, Any] = {"campaign_dir": raw, "out": at.poses, "quarantine": at.quarantine}
        yield Stage("ingest", read | {"settings": settings.ingest}, writes=table)
    campaign: dict[str, Any] = {"campaign_dir": raw, "poses": at.poses}
    yield Stage(
        "seed",
        campaign | {"out": at.base_frame, "settings": settings.base_frame},
        reads={"poses": at.poses},
        writes={"base_frame": at.base_frame},
    )
    named = settings.calibration.effects == "named"
    if named:
        yield _calibrated(campaign, at, settings, load, bare=True)
    else:
        yield _calibrated(campaign, at, settings, load)
    case = settings.evaluation.calibration
    found = {
        "verdict": at.verdict,
        "analysis": at.verdict.with_name("analysis.json"),
        "extended": at.extended,
        "suggested": at.verdict.with_name("suggested_poses.csv"),
    }
    searched = {"calibration": at.calibration(case, bare=named), "settings": settings.discovery}
    yield Stage(
        "discover",
        campaign | searched | found,
        reads={"poses": at.poses, "calibration": at.calibration(bare=named)},
        writes=found | {"covariance": at.extended.with_name("extended.covariance.npz")},
    )
    if named:
        yield _calibrated(campaign, at, settings, load)
    reads = {"poses": at.poses, "calibration": at.calibration(), "extended": at.extended}
    models = campaign | {"calibration": at.calibration(case), "extended": at.extended}
    held_out = results / "evaluation/holdout.json"
    iso9283 = held_out.with_name("iso9283.json")
    yield Stage(
        "evaluate",
        models | {"out": held_out, "iso9283": iso9283},
        reads=reads,
        writes={"held_out": held_out, "iso9283": iso9283},
    )
    files = {"model": "model.yaml", "urdf": "robot.urdf", "dh": "dh.csv"}
    exported = {name: results / "model" / file for name, file in files.items()}
    yield Stage(
        "export",
        models | exported | {"force": True},
        reads=reads,
        writes=exported | {"covariance": results / "model/model.covariance.npz"},
    )


def _calibrated(
    campaign: Mapping[str, Path],
    at: CampaignFiles,
    settings: ChainOptions,
    load: str | None,
    *,
    bare: bool = False,
) -> Stage:
    """Return the stage that calibrates; `bare`: without effects that are those of the verdict."""
    options, reads = settings.calibration, {"poses": at.poses, "base_frame": at.base_frame}
    effects: dict[str, Any] = {}
    if bare:
        options = options.model_copy(update={"effects": ()})
    elif options.effects:
        effects["discovery"] = settings.discovery
        if options.effects == "named":
            effects["named"] = reads["named"] = at.extended
    out = at.calibration(load or _COMBINED, bare=bare)
    return Stage(
        "baseline" if bare else "calibrate",
        {
            **campaign,
            "base_frame": at.base_frame,
            "out": out if load else out.parent,
            "load": load,
            "settings": options,
            **effects,
        },
        reads=reads,
        writes={"calibration": out},
    )
