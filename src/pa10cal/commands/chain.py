"""Command `chain`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pa10cal.evaluation.options import ChainOptions

#: What a run writes under the results of a campaign; `members` is a group's.
_WRITTEN = (
    *("members", "ingest", "seed", "baseline"),
    *("calibration", "discovery", "evaluation", "model"),
)


def chain(
    *,
    campaign_dir: tuple[Path, ...],
    results: Path,
    dataset: str = "",
    source: Path | None = None,
    settings: ChainOptions = ChainOptions(),
) -> None:
    """Take a campaign from raw files to its model, or a group of campaigns, in one go.

    Writes the same files as the single stages, as one of many: a campaign that is refused, or that
    a fault of the program ends, stops no other. `chain.json` states its outcome, and files that
    earlier runs wrote for stages that did not run are removed.

    Args:
        campaign_dir: folder of raw files; of a group several.
        results: folder of the campaign's results.
        dataset: public data set that the one folder of raw files is imported of first.
        source: folder of that data set; goes with --dataset.
        settings: sections ingest, base_frame, calibration, evaluation and discovery.

    Examples:
        pa10cal chain --campaign-dir data/raw/mine --results results/mine
        pa10cal chain --campaign-dir data/raw/may data/raw/june --results results/both
    """
    import sys
    import traceback

    from pa10cal.commands.data import import_data
    from pa10cal.errors import OutputError, Pa10calError, SettingsError
    from pa10cal.planning.campaign import check_prior
    from pa10cal.reports.summary import summarise
    from pa10cal.results.codec import write
    from pa10cal.results.fleet import ChainRecord
    from pa10cal.stages.pipeline import stages

    if bool(dataset) != bool(source) or (dataset and len(campaign_dir) > 1):
        raise SettingsError(
            "a data set is imported of its folder, for one campaign",
            where="--dataset",
            value=dataset or None,
            allowed="--dataset with --source and one folder of raw files, or neither of them",
            remedy="give both; for a group run pa10cal import first",
        )
    raw, file = campaign_dir[0], ChainRecord.FILE
    name = results.name if len(campaign_dir) > 1 else raw.name
    if settings.calibration.prior is not None:  # before results that hold it are removed
        members = campaign_dir if len(campaign_dir) > 1 else ()
        own = [results, *(results.parent / folder.name for folder in members)]
        check_prior(settings.calibration.prior, own)
    _remove(results, file, *_WRITTEN)
    stage, written = "import", set[str]()
    outcome: dict[str, Any] = {}
    try:
        if source is not None:
            import_data(dataset, source, out=raw.parent, only=(raw.name,), settings=settings.ingest)
        for each in stages(campaign_dir, results, settings):
            stage = each.name
            written = {path.relative_to(results).parts[0] for path in each.writes.values()}
            each.run()
    except (OutputError, OSError, MemoryError):  # of the machine, not of the campaign
        raise
    except Pa10calError as error:
        outcome = {"status": "refused", "stage": stage, "message": str(error)}
    except Exception as error:  # a fault of one campaign is not to end the others
        traceback.print_exc()
        message = f"internal fault: {type(error).__name__}: {error}"
        outcome = {"status": "fault", "stage": stage, "message": message}
    if outcome:
        _remove(results, *written)
        print(f"pa10cal chain: {name}: {stage}: {outcome['message']}", file=sys.stderr)
    else:
        outcome = dict(summarise(results, settings.evaluation.calibration).outcome)
    write(ChainRecord(**outcome | {"campaign": name}), results / file)


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
