"""Command `chain`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.evaluation.options import ChainOptions

if TYPE_CHECKING:
    from pa10cal.stages.pipeline import Stage

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
    from pa10cal.fleet.campaigns import became, ended
    from pa10cal.results.codec import write
    from pa10cal.results.fleet import ChainRecord
    from pa10cal.stages.pipeline import stages

    name, record = results.name if len(campaign_dir) > 1 else campaign_dir[0].name, ChainRecord.FILE
    _remove(results, record, *_WRITTEN)
    bring = _imported(dataset, source, campaign_dir[0], settings) if dataset and source else ()
    for stage in (*bring, *stages(campaign_dir, results, settings)):
        try:
            stage.run()
        except (OutputError, OSError, MemoryError):  # of the machine, not of the campaign
            raise
        except Pa10calError as error:
            _remove(results, *stage.writes)
            found = ended(name, "refused", stage.name, str(error))
            break
        except Exception as error:  # a fault of one campaign is not to end the others
            _remove(results, *stage.writes)
            traceback.print_exc()
            told = f"internal fault: {type(error).__name__}: {error}"
            found = ended(name, "fault", stage.name, told)
            break
    else:
        found = became(results, name, settings.evaluation.calibration)
    write(found, results / record)
    if found.message is not None:
        print(f"pa10cal chain: {name}: {found.stage}: {found.message}", file=sys.stderr)


def _imported(dataset: str, source: Path, raw: Path, settings: ChainOptions) -> Iterator[Stage]:
    """Yield the import of a campaign from a public data set."""
    from pa10cal.commands.data import import_data
    from pa10cal.stages.pipeline import Stage

    def bring() -> None:
        import_data(dataset, source, out=raw.parent, only=(raw.name,), settings=settings.ingest)

    yield Stage("import", (), bring)


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
