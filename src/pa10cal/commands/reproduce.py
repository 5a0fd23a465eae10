"""Command `reproduce`."""

from __future__ import annotations

from pathlib import Path


def reproduce(
    *,
    cores: int = 0,
    settings: Path | None = None,
    figures: bool = False,
    profile: str | None = None,
) -> None:
    """Run the whole workflow in this folder, a line a stage, and end with one table.

    The campaigns are those of config.yaml. `make reproduce` and `make figures` call it. What is up
    to date is not made again, so the same command goes on where a run was interrupted or killed.

    Args:
        cores: how many to use; 0 for all.
        settings: settings over those of config.yaml (.yaml).
        figures: make figures and tables alone, and what they are drawn from; otherwise everything,
            and the workflow's own report with every picture, as `report.html` among the results.
        profile: slurm, or a folder with a profile of Snakemake, to run on a cluster.

    Examples:
        pa10cal reproduce
        pa10cal reproduce --cores 1 --settings my_campaigns.yaml
        pa10cal reproduce --profile slurm
    """
    import sys
    from dataclasses import replace

    from pa10cal.running.display import RunDisplay, reports, summarise, table
    from pa10cal.running.workflow import Workflow, run_workflow, settings_of, workflow_folder

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
        targets = ("figures",) if figures else ()
        whole = Workflow(
            "Snakefile", {}, here, here / results, cores, targets, settings, quiet, profile
        )
        run_workflow(whole, display)
        if not figures:
            more = ("--quiet", "all", "--report", str(results / "report.html"))
            run_workflow(replace(whole, more=more, profile=None), display)
    finally:
        display.close()
    if figures:
        for name in used.campaigns:
            print(f"{results / name / 'figures'}, {results / name / 'tables'}")
        return
    calibration = used.evaluation.calibration
    print(f"\n{table([summarise(results / name, calibration) for name in used.campaigns])}\n")
    print(f"in all {display.seconds:.0f} s")
    print(reports([results / name for name in used.campaigns]))
    print(f"every picture  {results / 'report.html'}")
