"""The list of stages from raw files to a model, and the files that each reads and writes.

A stage is a command with its options. Snakemake's rules run it as a process of its own, by its
command line; `chain`, fleets and trials call its function with the same options.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from pa10cal.command_settings import ChainOptions
from pa10cal.options import Section

#: Load case of all loads together.
_COMBINED = "combined"
#: Folder among the results of a group: readings and base frames of its members.
MEMBERS = "members"
#: Commands in the module `stages.readings`; each of the others has a module of its name.
_READINGS = ("ingest", "join", "seed")


@dataclass(frozen=True)
class Stage:
    """One stage of a campaign: a command, its options, and what lies on disk before and after."""

    name: str  # of the rule; unique but for the stages of a group's members
    options: Mapping[str, Any]  # keyword arguments of the command
    writes: Mapping[str, Path]  # its results, by what they are
    reads: Mapping[str, Path] = field(default_factory=dict)  # results of earlier stages

    @property
    def command(self) -> str:
        """Return the name of its command."""
        return "calibrate" if self.name == "baseline" else self.name

    @property
    def module(self) -> str:
        """Return the name of the module in the package `stages` that holds its command."""
        return "readings" if self.command in _READINGS else self.command

    def run(self) -> None:
        """Run it in this process.

        Raises:
            Pa10calError: what its command raises.
        """
        getattr(import_module(f"pa10cal.stages.{self.module}"), self.command)(**self.options)

    @property
    def words(self) -> str:
        """Return the command line that runs it, without the name of the program."""
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


def lost_results(stages: Iterable[Stage]) -> set[Path]:
    """Return the results of every stage that lacks one of them, or reads one of such a stage.

    What is there of these was made of other input than the results before it.
    """
    lost: set[Path] = set()
    for stage in stages:
        written = set(stage.writes.values())
        if lost.intersection(stage.reads.values()) or not all(path.exists() for path in written):
            lost |= written
    return lost


class CampaignFiles:
    """Paths of the results of a campaign."""

    def __init__(self, results: Path) -> None:
        """Take the folder of the results."""
        self.results = results
        self.poses = results / "ingest/poses.parquet"  # the table of poses
        self.quarantine = results / "ingest/quarantine.csv"  # rows that are not used
        self.base_frame = results / "seed/base_frame.json"
        self.verdict = results / "discovery/verdict.json"
        self.extended = results / "discovery/extended.json"  # the model with the effects found
        self.table = {"poses": self.poses, "quarantine": self.quarantine}

    def campaign(self, raw: Path) -> dict[str, Any]:
        """Return the options by which commands read the campaign, of a folder of raw files."""
        return {"campaign_dir": raw, "poses": self.poses}

    def calibration(self, load: str = _COMBINED, *, bare: bool = False) -> Path:
        """Return the calibration of a load case; `bare`: the one without the verdict's effects."""
        return self.results / ("baseline" if bare else "calibration") / f"{load}.json"


def stages(
    folders: tuple[Path, ...],
    results: Path,
    settings: ChainOptions = ChainOptions(),
    load: str | None = None,
) -> Iterator[Stage]:
    """Yield every stage of a campaign, or of a group, in order.

    A group reads the raw files of its members anew: results that the members have of their own are
    not changed. Where the calibration is to hold the effects of the verdict, the campaign is
    calibrated twice: first without them (`baseline`), which is what effects are searched with.

    Args:
        folders: folder of raw files of the campaign; of a group those of its members.
        results: folder of the results.
        settings: sections of the stages.
        load: the only load case to calibrate; None for all.
    """
    files = CampaignFiles(results)
    if len(folders) > 1:
        raw = files.poses.parent
        yield from _joined(folders, files, settings)
    else:
        raw = folders[0]
        yield _ingested(raw, files, settings)
    yield _located(raw, files, settings)
    calibrated_twice = settings.calibration.effects == "named"
    yield _calibrated(raw, files, settings, load, bare=calibrated_twice)
    yield _searched(raw, files, settings, baseline=calibrated_twice)
    if calibrated_twice:
        yield _calibrated(raw, files, settings, load)
    case = files.calibration(settings.evaluation.calibration)
    models = files.campaign(raw) | {"calibration": case, "extended": files.extended}
    reads = {"poses": files.poses, "calibration": files.calibration(), "extended": files.extended}
    held_out = results / "evaluation/holdout.json"
    iso9283 = held_out.with_name("iso9283.json")
    writes = {"held_out": held_out, "iso9283": iso9283}
    yield Stage("evaluate", models | {"out": held_out, "iso9283": iso9283}, writes, reads)
    folder = results / "model"
    names = {"model": "model.yaml", "urdf": "robot.urdf", "dh": "dh.csv"}
    exported = {option: folder / name for option, name in names.items()}
    writes = exported | {"covariance": folder / "model.covariance.npz"}
    yield Stage("export", models | exported | {"force": True}, writes, reads)


def _joined(
    folders: tuple[Path, ...], files: CampaignFiles, settings: ChainOptions
) -> Iterator[Stage]:
    """Yield the stages that read and locate the members of a group, and the one that joins them."""
    names = [folder.name for folder in folders]
    if len(set(names)) < len(names):  # such as 2026-03/cell and 2026-09/cell
        names = [f"{number}-{name}" for number, name in enumerate(names, start=1)]
    members = [CampaignFiles(files.results / MEMBERS / name) for name in names]
    for folder, member in zip(folders, members, strict=True):
        yield _ingested(folder, member, settings)
        yield _located(folder, member, settings)
    out_dir = files.poses.parent
    options: dict[str, Any] = {
        "name": files.results.name,
        "campaign_dir": folders,
        "poses": tuple(member.poses for member in members),
        "base_frame": tuple(member.base_frame for member in members),
        "out_dir": out_dir,
    }
    writes = files.table | {"campaign": out_dir / "campaign.yaml"}
    read = (path for member in members for path in (member.poses, member.base_frame))
    reads = {str(path.relative_to(files.results)): path for path in read}
    yield Stage("join", options, writes, reads)


def _ingested(raw: Path, files: CampaignFiles, settings: ChainOptions) -> Stage:
    options = {"campaign_dir": raw, "out": files.poses, "quarantine": files.quarantine}
    return Stage("ingest", options | {"settings": settings.ingest}, files.table)


def _located(raw: Path, files: CampaignFiles, settings: ChainOptions) -> Stage:
    options = files.campaign(raw) | {"out": files.base_frame, "settings": settings.base_frame}
    return Stage("seed", options, {"base_frame": files.base_frame}, {"poses": files.poses})


def _calibrated(
    raw: Path, files: CampaignFiles, settings: ChainOptions, load: str | None, *, bare: bool = False
) -> Stage:
    """Return the stage that calibrates; `bare`: without the effects of the verdict."""
    section, reads = settings.calibration, {"poses": files.poses, "base_frame": files.base_frame}
    effects: dict[str, Any] = {}
    if bare:
        section = section.model_copy(update={"effects": ()})
    elif section.effects:
        effects["discovery"] = settings.discovery
        if section.effects == "named":
            effects["named"] = reads["named"] = files.extended
    out = files.calibration(load or _COMBINED, bare=bare)
    options = files.campaign(raw) | {
        "base_frame": files.base_frame,
        "out": out if load else out.parent,
        "load": load,
        "settings": section,
    }
    name = "baseline" if bare else "calibrate"
    return Stage(name, options | effects, {"calibration": out}, reads)


def _searched(raw: Path, files: CampaignFiles, settings: ChainOptions, *, baseline: bool) -> Stage:
    """Return the stage that searches for missing effects; `baseline`: with that calibration."""
    case = files.calibration(settings.evaluation.calibration, bare=baseline)
    writes = {
        "verdict": files.verdict,
        "analysis": files.verdict.with_name("analysis.json"),
        "extended": files.extended,
        "suggested": files.verdict.with_name("suggested_poses.csv"),
    }
    options = files.campaign(raw) | {"calibration": case, "settings": settings.discovery} | writes
    reads = {"poses": files.poses, "calibration": files.calibration(bare=baseline)}
    covariance = files.extended.with_name("extended.covariance.npz")
    return Stage("discover", options, writes | {"covariance": covariance}, reads)
