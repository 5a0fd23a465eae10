"""Command `chain`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pa10cal.fleet.options import ChainOptions

#: Stages, as messages call them, and what each writes under the results of the campaign.
STAGES = {
    "ingest": ("ingest",),
    "seed": ("seed",),
    "calibrate": ("baseline", "calibration"),
    "discover": ("discovery",),
    "evaluate": ("evaluation",),
    "export": ("model",),
}


def chain(
    *,
    campaign_dir: Path,
    results: Path,
    settings: ChainOptions = ChainOptions(),
) -> None:
    """Take a campaign from raw files to its model in one process, as one of many.

    Writes the same files as the single stages. A campaign that is refused, or that a fault of the
    program ends, stops no other: `chain.json` says so, and what earlier runs left of the stages
    that did not come about is removed.

    Args:
        campaign_dir: folder of raw files.
        results: folder of the campaign's results.
        settings: sections ingest, base_frame, calibration, evaluation and discovery.

    Examples:
        pa10cal chain --campaign-dir data/raw/mine --results results/mine
    """
    import sys
    import traceback

    from pa10cal.errors import OutputError, Pa10calError
    from pa10cal.fleet.became import became, ended
    from pa10cal.results.codec import write
    from pa10cal.results.fleet import ChainRecord

    name, record = campaign_dir.name, ChainRecord.FILE
    _remove(results, record, *(part for parts in STAGES.values() for part in parts))
    for stage, run in _stages(campaign_dir, results, settings):
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


def _stages(
    raw: Path, results: Path, settings: ChainOptions
) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield every stage by name: the functions of the single commands, one after the other."""
    from pa10cal.commands.calibrate import calibrate
    from pa10cal.commands.discover import discover
    from pa10cal.commands.evaluate import evaluate
    from pa10cal.commands.export import export
    from pa10cal.commands.ingest import ingest
    from pa10cal.commands.seed import seed

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
        )

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
