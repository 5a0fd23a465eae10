"""The stages from raw files to a model: one list, which whoever judges a campaign walks.

Every stage is the function of the command of its name. What it reads and writes lies under one
folder of results, at the places that the rules of the workflow give it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pa10cal.evaluation.options import ChainOptions

#: Load case of all loads together.
_COMBINED = "combined"


@dataclass(frozen=True)
class Stage:
    """One stage of a campaign."""

    name: str  # as the command and messages have it
    writes: tuple[str, ...]  # folders under the results that are its own
    run: Callable[[], None]


@dataclass(frozen=True)
class Places:
    """Where the results of a campaign lie."""

    results: Path  # the folder of all of them

    @property
    def poses(self) -> Path:
        """Return the table of poses."""
        return self.results / "ingest/poses.parquet"

    @property
    def quarantine(self) -> Path:
        """Return the list of rows that are not used."""
        return self.results / "ingest/quarantine.csv"

    @property
    def base_frame(self) -> Path:
        """Return the base frame."""
        return self.results / "seed/base_frame.json"

    @property
    def verdict(self) -> Path:
        """Return the verdict."""
        return self.results / "discovery/verdict.json"

    @property
    def extended(self) -> Path:
        """Return the model with the effects found."""
        return self.results / "discovery/extended.json"

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

    Args:
        folders: raw files of the campaign; of a group those of its members, whose own results lie
            beside those of the group.
        results: folder of the results.
        settings: sections of the stages.
        load: one load case alone; None for all.
    """
    from pa10cal.stages.calibrate import calibrate
    from pa10cal.stages.discover import discover
    from pa10cal.stages.evaluate import evaluate
    from pa10cal.stages.export import export
    from pa10cal.stages.readings import ingest, seed

    at, verdicts, model = Places(results), results / "discovery", results / "model"
    case = settings.evaluation.calibration
    named = settings.calibration.effects == "named"
    group = len(folders) > 1
    raw = results / "ingest" if group else folders[0]

    def calibrate_into(folder: Path, by_verdict: Path | None = None) -> None:
        bare = {"effects": ()} if named and by_verdict is None else {}
        calibrate(
            campaign_dir=raw,
            poses=at.poses,
            base_frame=at.base_frame,
            out=folder / f"{load}.json" if load else folder,
            load=load,
            named=by_verdict,
            settings=settings.calibration.model_copy(update=bare),
            discovery=settings.discovery,
        )

    def ingest_it() -> None:
        ingest(campaign_dir=raw, out=at.poses, quarantine=at.quarantine, settings=settings.ingest)

    def seed_it() -> None:
        seed(campaign_dir=raw, poses=at.poses, out=at.base_frame, settings=settings.base_frame)

    def discover_it() -> None:
        discover(
            campaign_dir=raw,
            poses=at.poses,
            calibration=at.calibration(case, bare=named),
            verdict=at.verdict,
            analysis=verdicts / "analysis.json",
            extended=at.extended,
            suggested=verdicts / "suggested_poses.csv",
            settings=settings.discovery,
        )

    def evaluate_it() -> None:
        evaluate(
            campaign_dir=raw,
            poses=at.poses,
            calibration=at.calibration(case),
            extended=at.extended,
            out=results / "evaluation/holdout.json",
            iso9283=results / "evaluation/iso9283.json",
        )

    def export_it() -> None:
        export(
            campaign_dir=raw,
            poses=at.poses,
            calibration=at.calibration(case),
            extended=at.extended,
            model=model / "model.yaml",
            urdf=model / "robot.urdf",
            dh=model / "dh.csv",
            force=True,
        )

    if group:
        yield Stage("join", ("ingest",), lambda: _join(folders, results))
    else:
        yield Stage("ingest", ("ingest",), ingest_it)
    yield Stage("seed", ("seed",), seed_it)
    searched = at.calibration(bare=named).parent
    yield Stage("calibrate", (searched.name,), lambda: calibrate_into(searched))
    yield Stage("discover", ("discovery",), discover_it)
    if named:
        own = at.calibration().parent
        yield Stage("calibrate", (own.name,), lambda: calibrate_into(own, at.extended))
    yield Stage("evaluate", ("evaluation",), evaluate_it)
    yield Stage("export", ("model",), export_it)


def _join(folders: tuple[Path, ...], results: Path) -> None:
    """Join campaigns to a group; their own results lie beside those of the group."""
    from pa10cal.stages.readings import join

    own = [Places(results.parent / folder.name) for folder in folders]
    join(
        name=results.name,
        campaign_dir=folders,
        poses=tuple(each.poses for each in own),
        base_frame=tuple(each.base_frame for each in own),
        out_dir=results / "ingest",
    )
