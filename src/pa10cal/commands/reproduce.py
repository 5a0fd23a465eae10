"""Command `reproduce`."""

from __future__ import annotations

from pathlib import Path


def reproduce(*, cores: int = 0, settings: Path | None = None, report: bool = True) -> None:
    """Run the whole workflow in this folder, a line a stage, and end with one table.

    The campaigns are those of config.yaml. `make reproduce` calls it.

    Args:
        cores: how many to use; 0 for all.
        settings: settings over those of config.yaml (.yaml).
        report: write the workflow's own report too, with every picture of every campaign, as
            `report.html` among the results.

    Examples:
        pa10cal reproduce
        pa10cal reproduce --cores 1 --settings my_campaigns.yaml
    """
    import sys

    from pa10cal.running.display import RunDisplay
    from pa10cal.running.settings_files import settings_of
    from pa10cal.running.summary import reports, summarise, table
    from pa10cal.running.workflow import Workflow, run_workflow, workflow_folder

    files = [workflow_folder() / "config.yaml", *([] if settings is None else [settings])]
    used = settings_of(files, {}, str(files[-1]))
    results, here = Path(used.results_dir), Path.cwd()
    display = RunDisplay(lines=True)
    print(
        f"{', '.join(used.campaigns)}: raw files in {used.raw_dir}, results in {results}. It takes "
        "some minutes; what is up to date is not made again.",
        file=sys.stderr,
    )
    try:
        quiet = ("--quiet", "all", "--logger", "pa10cal")
        run_workflow(Workflow("Snakefile", {}, here, cores, (), settings, quiet), display)
        if report:
            more = ("--quiet", "all", "--report", str(results / "report.html"))
            run_workflow(Workflow("Snakefile", {}, here, cores, (), settings, more), display)
    finally:
        display.close()
    calibration = used.evaluation.calibration
    print(f"\n{table([summarise(results / name, calibration) for name in used.campaigns])}\n")
    print(f"in all {display.seconds:.0f} s")
    print(reports([results / name for name in used.campaigns]))
    whole = results / "report.html"
    print(f"every picture  {whole}" if report else f"results  {results}")
