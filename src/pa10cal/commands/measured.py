"""Command `measured`: models carried between measured campaigns, and one table of all."""

from __future__ import annotations

from pathlib import Path


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
    from pa10cal.datasets.measured import CARRIED, markdown, measured_record, robots_csv
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
    folders = {folder.name: folder for folder in campaign_dir}
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
    record = measured_record(folders, results, calibration, carried)
    with whole_files(out / "measured.csv", out / "measured.json") as (table, record_file):
        write_text(table, robots_csv(record))
        write(record, record_file)
    print(markdown(record))
