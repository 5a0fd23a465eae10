"""Command `chain`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pa10cal.evaluation.options import ChainOptions

#: Stages, as messages call them, and what each writes under the results of the campaign.
STAGES = {
    "import": (),
    "join": ("ingest",),
    "ingest": ("ingest",),
    "seed": ("seed",),
    "calibrate": ("baseline", "calibration"),
    "discover": ("discovery",),
    "evaluate": ("evaluation",),
    "export": ("model",),
}


def chain(
    *,
    campaign_dir: tuple[Path, ...],
    results: Path,
    dataset: str = "",
    source: Path | None = None,
    settings: ChainOptions = ChainOptions(),
) -> None:
    """Take a campaign, or a group of several, from raw files to its model in one process.

    Writes the same files as the single stages, as one of many: a campaign that is refused, or that
    a fault of the program ends, stops no other. `chain.json` says so, and what earlier runs left of
    the stages that did not come about is removed.

    Args:
        campaign_dir: folder of raw files; of a group several, whose results lie beside --results.
        results: folder of the campaign's results.
        dataset: public data set that the folder of raw files is imported of first.
        source: folder of that data set.
        settings: sections ingest, base_frame, calibration, evaluation and discovery.

    Examples:
        pa10cal chain --campaign-dir data/raw/mine --results results/mine
        pa10cal chain --campaign-dir data/raw/may data/raw/june --results results/both
    """
    import sys
    import traceback

    from pa10cal.errors import OutputError, Pa10calError
    from pa10cal.fleet.campaigns import became, ended
    from pa10cal.results.codec import write
    from pa10cal.results.fleet import ChainRecord

    name, record = results.name if len(campaign_dir) > 1 else campaign_dir[0].name, ChainRecord.FILE
    _remove(results, record, *dict.fromkeys(part for parts in STAGES.values() for part in parts))
    bring = _imported(dataset, source, campaign_dir[0], settings) if dataset and source else ()
    for stage, run in (*bring, *_stages(campaign_dir, results, settings)):
        try:
            run()
        except (OutputError, OSError, MemoryError):  # of the machine, not of the campaign
            raise
        except Pa10calError as error:
            _remove(results, *STAGES[stage])
            found = ended(name, "refused", stage, str(error))
            break
        except Exception as error:  # a fault of one campaign is not to end the others
            _remove(results, *STAGES[stage])
            traceback.print_exc()
            told = f"internal fault: {type(error).__name__}: {error}"
            found = ended(name, "fault", stage, told)
            break
    else:
        found = became(results, name, settings.evaluation.calibration)
    write(found, results / record)
    if found.message is not None:
        print(f"pa10cal chain: {name}: {found.stage}: {found.message}", file=sys.stderr)


_Stage = tuple[str, Callable[[], None]]


def _imported(dataset: str, source: Path, raw: Path, settings: ChainOptions) -> Iterator[_Stage]:
    """Yield the import of a campaign from a public data set."""
    from pa10cal.commands.data import import_data

    yield (
        "import",
        lambda: import_data(
            dataset, source, out=raw.parent, only=(raw.name,), settings=settings.ingest
        ),
    )


def _joined(folders: tuple[Path, ...], results: Path) -> Iterator[_Stage]:
    """Yield the join of campaigns to a group; their own results lie beside those of the group."""
    from pa10cal.commands.readings import join

    own = [results.parent / folder.name for folder in folders]
    yield (
        "join",
        lambda: join(
            name=results.name,
            campaign_dir=folders,
            poses=tuple(each / "ingest/poses.parquet" for each in own),
            base_frame=tuple(each / "seed/base_frame.json" for each in own),
            out_dir=results / "ingest",
        ),
    )


def _stages(folders: tuple[Path, ...], results: Path, settings: ChainOptions) -> Iterator[_Stage]:
    """Yield every stage by name: the functions of the single commands, one after the other."""
    from pa10cal.commands.calibrate import calibrate
    from pa10cal.commands.discover import discover
    from pa10cal.commands.evaluate import evaluate
    from pa10cal.commands.export import export
    from pa10cal.commands.readings import ingest, seed

    poses, base_frame = results / "ingest/poses.parquet", results / "seed/base_frame.json"
    verdicts, model = results / "discovery", results / "model"
    calibrated = results / "calibration"
    load = f"{settings.evaluation.calibration}.json"
    named = settings.calibration.effects == "named"
    searched = results / "baseline" if named else calibrated

    def calibrate_into(folder: Path, by_verdict: Path | None = None) -> None:
        bare = {"effects": ()} if named and by_verdict is None else {}
        calibrate(
            campaign_dir=raw,
            poses=poses,
            base_frame=base_frame,
            out=folder,
            named=by_verdict,
            settings=settings.calibration.model_copy(update=bare),
            discovery=settings.discovery,
        )

    if len(folders) > 1:
        raw = results / "ingest"
        yield from _joined(folders, results)
    else:
        (raw,) = folders
        yield (
            "ingest",
            lambda: ingest(
                campaign_dir=raw,
                out=poses,
                quarantine=results / "ingest/quarantine.csv",
                settings=settings.ingest,
            ),
        )
    yield (
        "seed",
        lambda: seed(campaign_dir=raw, poses=poses, out=base_frame, settings=settings.base_frame),
    )
    yield "calibrate", lambda: calibrate_into(searched)
    yield (
        "discover",
        lambda: discover(
            campaign_dir=raw,
            poses=poses,
            calibration=searched / load,
            verdict=verdicts / "verdict.json",
            analysis=verdicts / "analysis.json",
            extended=verdicts / "extended.json",
            suggested=verdicts / "suggested_poses.csv",
            settings=settings.discovery,
        ),
    )
    if named:
        yield "calibrate", lambda: calibrate_into(calibrated, verdicts / "extended.json")
    yield (
        "evaluate",
        lambda: evaluate(
            campaign_dir=raw,
            poses=poses,
            calibration=calibrated / load,
            extended=verdicts / "extended.json",
            out=results / "evaluation/holdout.json",
            iso9283=results / "evaluation/iso9283.json",
        ),
    )
    yield (
        "export",
        lambda: export(
            campaign_dir=raw,
            poses=poses,
            calibration=calibrated / load,
            extended=verdicts / "extended.json",
            model=model / "model.yaml",
            urdf=model / "robot.urdf",
            dh=model / "dh.csv",
            force=True,
        ),
    )


def _remove(results: Path, *names: str) -> None:
    """Remove what lies under these names, if anything does.

    Raises:
        OutputError: when it cannot be removed.
    """
    import shutil

    from pa10cal.files.output import writing_into

    with writing_into(results, "the results", "give another folder, or let it be written to"):
        for name in names:
            path = results / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
