"""Commands for many campaigns of many arms: `fleet`, `fleet_summary`, `measured`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.running import workflow as running
from pa10cal.running.display import RunDisplay
from pa10cal.running.failure import StageError
from pa10cal.running.run_lock import run_lock

if TYPE_CHECKING:
    from pa10cal.results.outcomes import FleetRecord

#: Names that a message lists; of more only the first are shown.
_MOST_NAMES = 10


def fleet(
    campaigns: str,
    *,
    raw_dir: Path = Path("data/raw"),
    out: Path = Path("results"),
    cores: int = 0,
    settings: Path | None = None,
    profile: str | None = None,
) -> None:
    """Run many campaigns of many arms to models, and summarise them: which arms need attention.

    Results that are up to date are not computed again. A campaign that is refused, or that a fault
    or the machine ends, stops no other: it is in the summary with its reason, and the exit code is
    2. One that the machine ended is begun anew by the next run. `run` makes figures and reports of
    single campaigns, `snakemake` those that are requested.

    Args:
        campaigns: table of campaigns (.csv) with the column campaign and, where known, arm and
            measured (ISO 8601, such as 2026-03-31); or a pattern of folders of --raw-dir, such as
            '*'.
        raw_dir: folder of the campaigns.
        out: gets a folder of every campaign's name, and the folder fleet.
        cores: how many to use; 0 for all.
        settings: settings over the default ones, as config.yaml has them (.yaml).
        profile: slurm, or a folder with a profile of Snakemake, to run on a cluster.

    Examples:
        pa10cal fleet arms.csv --raw-dir measured --out results
        pa10cal fleet '2026-*' --raw-dir measured --out results --cores 8
        pa10cal fleet arms.csv --raw-dir measured --out results --profile slurm
    """
    from pa10cal.fleet.arm_status import forget_ended
    from pa10cal.fleet.campaigns import campaigns_of, from_any_folder
    from pa10cal.results.codec import read
    from pa10cal.results.outcomes import FleetRecord

    raw_dir, out = raw_dir.absolute(), out.absolute()
    campaigns = from_any_folder(campaigns)
    listed = campaigns_of(campaigns, raw_dir)
    names = [campaign.campaign for campaign in listed]
    files, where = [settings] if settings else [], str(settings or "campaigns")
    used = running.settings_of(files, {"campaigns": names}, where)
    over: dict[str, object] = {
        "campaigns": campaigns,
        "raw_dir": str(raw_dir),
        "results_dir": str(out),
    }
    if used.calibration.prior:
        over["calibration"] = {"prior": str(Path(used.calibration.prior).absolute())}
    workflow = running.Workflow(
        file="workflow/run.smk",
        config={key: json.dumps(value) for key, value in over.items()},
        folder=out,
        results=out,
        name="fleet",
        cores=cores,
        targets=("fleet",),
        settings=settings,
        profile=profile,
    )
    with run_lock(out, ["fleet"]), closing(RunDisplay(lines=False)) as display:
        forget_ended(listed, out)
        running.run_workflow(workflow, display)
    record = read(FleetRecord, out / FleetRecord.FILE)
    for line in _attention_lines(record):
        print(line)
    print(f"\n{_counts(record)}")
    print(f"{out / 'fleet/fleet.html'}\nin {display.seconds:.0f} s")
    lost = [each.campaign for each in record.campaigns if each.became.status != "done"]
    if lost:
        total = len(record.campaigns)
        raise StageError(f"{len(lost)} of {total} campaigns gave no model: {_first_of(lost)}")


def _first_of(names: list[str]) -> str:
    """Return names as one line, of many the first ones."""
    return ", ".join([*names[:_MOST_NAMES], *["…"] * (len(names) > _MOST_NAMES)])


def _attention_lines(record: FleetRecord) -> Iterator[str]:
    """Yield a line for each arm that needs attention, and for each other campaign that failed."""
    shown = set()
    for arm in record.arms:
        if arm.attention != "none":
            yield f"{arm.arm}: {arm.attention}: {arm.last}: {arm.why}"
            shown.add(arm.last)
    for campaign in record.campaigns:
        outcome = campaign.became
        if outcome.status != "done" and campaign.campaign not in shown:
            why = ": ".join(filter(None, (outcome.stage, outcome.message)))
            yield f"{campaign.arm}: {outcome.status}: {campaign.campaign}: {why}"


def _counts(record: FleetRecord) -> str:
    """Return how many campaigns of how many arms there are, and how many of each outcome."""
    from pa10cal.reports.formatting import count as number_of

    counts = ", ".join(f"{count} {outcome}" for outcome, count in record.counts.items())
    campaigns = number_of(len(record.campaigns), "campaign")
    return f"{campaigns} of {number_of(len(record.arms), 'arm')}: {counts}"


def fleet_summary(*, campaigns: str, raw_dir: Path, results: Path, out: Path) -> None:
    """Summarise a fleet whose campaigns are done: table, record and page.

    Args:
        campaigns: table of campaigns (.csv), or a pattern of folders of --raw-dir.
        raw_dir: folder of the campaigns.
        results: holds a folder of results for each.
        out: folder for fleet.csv, fleet.json and fleet.html.

    Examples:
        pa10cal fleet_summary --campaigns arms.csv --raw-dir data/raw --results results \\
          --out results/fleet
    """
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.fleet.arm_status import fleet_csv, fleet_record
    from pa10cal.fleet.campaigns import campaigns_of
    from pa10cal.reports.formatting import count as number_of
    from pa10cal.reports.page import fleet_page_text
    from pa10cal.results.codec import write

    record = fleet_record(campaigns_of(campaigns, raw_dir), results)
    outputs = tuple(out / f"fleet.{ending}" for ending in ("csv", "html", "json"))
    with whole_files(*outputs) as (table, page, record_file):
        write_text(table, fleet_csv(record))
        write_text(page, fleet_page_text(record))
        write(record, record_file)
    print(f"fleet: {_counts(record)}")
    if urgent := [arm.arm for arm in record.arms if arm.attention != "none"]:
        needed = "needs" if len(urgent) == 1 else "need"
        print(f"fleet: {number_of(len(urgent), 'arm')} {needed} attention: {_first_of(urgent)}")


def measured(
    *,
    campaign_dir: tuple[Path, ...] = (),
    results: Path,
    out: Path,
    calibration: str = "combined",
) -> None:
    """Carry models between measured campaigns that are done, and write one table of all.

    A campaign that was refused, and a model that cannot be carried over, are in the table with
    their message. Results of campaigns are only read.

    Args:
        campaign_dir: folders of raw files, one a campaign.
        results: holds a folder of results for each, and for each group.
        out: folder for measured.csv, measured.json, and models in other campaigns: transfer.
        calibration: load case that was evaluated.

    Examples:
        pa10cal measured --campaign-dir data/measured/titan-fixed --results results/measured \\
          --out results/measured
    """
    from pa10cal.datasets.known_campaigns import CARRIED
    from pa10cal.datasets.measured import MeasuredResults, markdown, robots_csv
    from pa10cal.errors import OutputError, Pa10calError, SettingsError
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.results.codec import read, write
    from pa10cal.results.outcomes import ChainRecord
    from pa10cal.stages.evaluate import transfer

    if not campaign_dir:
        raise SettingsError(
            "no measured campaign is at hand",
            where="measured_dir",
            allowed="a folder with folders of campaigns, or of data sets that were fetched",
            remedy="fetch one, as by pa10cal fetch titan-robot-accuracy --out "
            "data/measured/titan-robot-accuracy, or name such a folder: --config measured_dir=…",
        )
    folders = {folder.absolute().name: folder for folder in campaign_dir}
    if len(folders) < len(campaign_dir):
        raise SettingsError(
            "two folders of campaigns have one name",
            where="--campaign-dir",
            value=", ".join(map(str, campaign_dir)),
            allowed="a name for each, which is that of its folder of results",
            remedy="rename one, or name it once",
        )
    carried: dict[tuple[str, str], Path | str] = {}  # file of errors, or message of a refusal
    for source, target in CARRIED:
        if not {source, target} <= set(folders):
            continue
        file = out / f"transfer/{source}_in_{target}.json"
        file.unlink(missing_ok=True)
        outcomes = [
            read(ChainRecord, results / name / ChainRecord.FILE) for name in (source, target)
        ]
        if any(outcome.status != "done" for outcome in outcomes):
            continue
        try:
            transfer(
                calibration=results / source / f"calibration/{calibration}.json",
                campaign_dir=folders[target],
                poses=results / target / "ingest/poses.parquet",
                out=file,
                extended=results / source / "discovery/extended.json",
            )
        except OutputError:
            raise
        except Pa10calError as error:
            carried[source, target] = str(error)
        else:
            carried[source, target] = file
    record = MeasuredResults(results, calibration, carried).record(folders)
    with whole_files(out / "measured.csv", out / "measured.json") as (table, record_file):
        write_text(table, robots_csv(record))
        write(record, record_file)
    print(markdown(record))
