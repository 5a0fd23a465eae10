"""Command `chain`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from pa10cal.evaluation.options import ChainOptions

#: What a run writes under the results of a campaign.
_WRITTEN = ("ingest", "seed", "baseline", "calibration", "discovery", "evaluation", "model")


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
    from pa10cal.reports.summary import summarise
    from pa10cal.results.codec import write
    from pa10cal.results.fleet import ChainRecord

    name, record = results.name if len(campaign_dir) > 1 else campaign_dir[0].name, ChainRecord.FILE
    told: dict[str, Any]
    _remove(results, record, *_WRITTEN)
    for stage, written, run in _steps(campaign_dir, results, dataset, source, settings):
        try:
            run()
        except (OutputError, OSError, MemoryError):  # of the machine, not of the campaign
            raise
        except Pa10calError as error:
            _remove(results, *written)
            told = {"status": "refused", "stage": stage, "message": str(error)}
            break
        except Exception as error:  # a fault of one campaign is not to end the others
            _remove(results, *written)
            traceback.print_exc()
            message = f"internal fault: {type(error).__name__}: {error}"
            told = {"status": "fault", "stage": stage, "message": message}
            break
    else:
        told = dict(summarise(results, settings.evaluation.calibration).became)
    found = ChainRecord(**told | {"campaign": name})
    write(found, results / record)
    if found.message is not None:
        print(f"pa10cal chain: {name}: {found.stage}: {found.message}", file=sys.stderr)


def _steps(
    folders: tuple[Path, ...],
    results: Path,
    dataset: str,
    source: Path | None,
    settings: ChainOptions,
) -> Iterator[tuple[str, set[str], Callable[[], None]]]:
    """Yield the name of every step, the folders of the results that are its own, and its work."""
    from pa10cal.commands.data import import_data
    from pa10cal.stages.pipeline import stages

    if dataset and source:
        raw = folders[0]
        work = partial(
            import_data, dataset, source, out=raw.parent, only=(raw.name,), settings=settings.ingest
        )
        yield "import", set(), work
    for stage in stages(folders, results, settings):
        written = {path.relative_to(results).parts[0] for path in stage.writes.values()}
        yield stage.name, written, stage.run


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
