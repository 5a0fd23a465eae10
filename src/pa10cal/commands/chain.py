"""Command `chain`: a campaign from raw files to its model, and an outcome whatever ends it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.command_settings import ChainOptions
from pa10cal.errors import OutputError, Pa10calError, SettingsError, no_memory
from pa10cal.files.output import MAKE_ROOM, no_room, remove_results
from pa10cal.running.run_lock import RUN, run_lock

if TYPE_CHECKING:
    from pa10cal.running.child import Send


def chain(
    *,
    campaign_dir: tuple[Path, ...],
    results: Path,
    dataset: str = "",
    source: Path | None = None,
    settings: ChainOptions = ChainOptions(),
) -> None:
    """Take a campaign from raw files to its model, or a group of campaigns, in one go.

    Writes the same files as the single stages. The stages run in a child, so that `chain.json`
    states the outcome whatever ends them; the folders that earlier runs made are removed first, but
    nothing where there is no campaign, or where they hold files that no run made. The exit code is
    2 where the campaign is refused, or a fault of the program or the machine ends it; only a full
    disk and an interrupt leave no `chain.json`.

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
    from pa10cal.planning.campaign import check_prior, refuse_among_raw_files, refuse_removed

    if bool(dataset) != bool(source) or (dataset and len(campaign_dir) > 1):
        raise SettingsError(
            "a data set is imported of its folder, for one campaign",
            where="--dataset",
            value=dataset or None,
            allowed="--dataset with --source and one folder of raw files, or neither of them",
            remedy="give both; for a group run pa10cal import first",
        )
    campaign_dir, results = tuple(map(_by_its_name, campaign_dir)), _by_its_name(results)
    for folder in campaign_dir:
        refuse_among_raw_files(results.resolve(), folder.resolve(), "--results", results)
    if source is not None:
        refuse_removed(results.resolve(), source.resolve(), "--results", results)
    if source is None and RUN not in os.environ:  # of a lost one a fleet needs the outcome
        for folder in campaign_dir:
            _refuse_no_campaign(folder)
    members = campaign_dir if len(campaign_dir) > 1 else ()
    name = results.name if members else campaign_dir[0].name
    if settings.calibration.prior is not None:  # before results that hold it are removed
        own = [results, *(results.parent / folder.name for folder in members)]
        check_prior(settings.calibration.prior, own)
    with _locked(results):
        _make_anew(campaign_dir, results, name, dataset, source, settings)


def _refuse_no_campaign(folder: Path) -> None:
    """Refuse a folder that is not there, or that has no description, before anything is removed."""
    if not os.path.lexists(folder / "campaign.yaml"):
        from pa10cal.campaign.description import read_description

        read_description(folder)


@contextmanager
def _locked(results: Path) -> Iterator[None]:
    """Lock a folder of results, where that is possible: it may be a volume in a folder of root."""
    parent = results.absolute().parent
    there = next(folder for folder in (parent, *parent.parents) if folder.exists())
    if not os.access(there, os.W_OK):
        yield
        return
    with run_lock(parent, [results.name]):
        yield


def _make_anew(
    campaign_dir: tuple[Path, ...],
    results: Path,
    name: str,
    dataset: str,
    source: Path | None,
    settings: ChainOptions,
) -> None:
    """Remove what earlier runs made, run the stages in a child, and write the outcome.

    Raises:
        OutputError: when results cannot be written, or a file that no run made is in their place.
        StageError: when a stage did not come to its end.
    """
    from functools import partial

    from pa10cal.planning.campaign import RESULT_FILES, refuse_files_of_others
    from pa10cal.results.outcomes import ChainRecord
    from pa10cal.running.child import in_child

    refuse_files_of_others(results)
    remove_results(results, ChainRecord.FILE, *RESULT_FILES)
    child = in_child(partial(_run_stages, campaign_dir, results, name, dataset, source, settings))
    outcome = dict(child.sent)
    stage, folders = outcome.pop("stage", "import"), outcome.pop("folders", ())
    if full := outcome.pop("no_room", None):
        raise OutputError(
            "the results cannot be written",
            where=str(results),
            value=full,
            allowed="a folder with room in it",
            remedy=MAKE_ROOM,
        )
    if child.code != 0:
        outcome = {"status": "ended", "message": child.why}
    elif outcome.get("status") == "done":
        return
    remove_results(results, *folders)  # of the stage that did not come to its end
    # Late: where all went well, only the child needs to import what writes records.
    from pa10cal.results.codec import write
    from pa10cal.running.failure import StageError

    record = ChainRecord(**outcome | {"campaign": name, "stage": stage})
    write(record, results / ChainRecord.FILE)
    raise StageError(f"{name}: {stage}: {record.message}")


def _by_its_name(folder: Path) -> Path:
    """Return a path that ends in the name of its folder, which `.` and `x/..` do not."""
    return folder if folder.name not in ("", "..") else folder.resolve()


def _run_stages(
    folders: tuple[Path, ...],
    results: Path,
    name: str,
    dataset: str,
    source: Path | None,
    settings: ChainOptions,
    send: Send,
) -> None:
    """Run the stages of a campaign; send which stage is at work, and at last the outcome.

    The outcome is status and message of the record, or `no_room`, why nothing can be written.
    """
    import traceback

    from pa10cal.commands.data import import_data
    from pa10cal.reports.summary import summarise
    from pa10cal.results.codec import write
    from pa10cal.results.outcomes import ChainRecord
    from pa10cal.stages.pipeline import stages

    outcome: dict[str, Any] = {"status": "done"}
    try:
        if source is not None:
            raw = folders[0]
            import_data(dataset, source, out=raw.parent, only=(raw.name,), settings=settings.ingest)
        for stage in stages(folders, results, settings):
            written = {path.relative_to(results).parts[0] for path in stage.writes.values()}
            send({"stage": stage.name, "folders": sorted(written)})
            stage.run()
        record = summarise(results, settings.evaluation.calibration).outcome
        write(record.model_copy(update={"campaign": name}), results / ChainRecord.FILE)
    except (OutputError, OSError, MemoryError) as error:
        # A full disk says nothing about this campaign, and would end all others likewise.
        outcome = {"no_room": str(error)} if no_room(error) else _ended(error)
    except Pa10calError as error:
        outcome = {"status": "refused", "message": str(error)}
    except Exception as error:  # a fault in one campaign does not end the others
        traceback.print_exc()
        message = f"internal fault: {type(error).__name__}: {error}"
        outcome = {"status": "fault", "message": message}
    send(outcome)


def _ended(error: Exception) -> dict[str, Any]:
    """Return the outcome of a campaign that the machine ended, which the next run begins anew."""
    message = f"{type(error).__name__}: {error}"
    if isinstance(error, MemoryError):
        message = no_memory(error)
    elif isinstance(error, OutputError):
        message = str(error)
    return {"status": "ended", "message": message}
