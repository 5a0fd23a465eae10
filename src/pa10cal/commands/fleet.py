"""Command `fleet`."""

from __future__ import annotations

from pathlib import Path


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

    What is up to date is not made again. A campaign that is refused stops no other: it is in the
    summary with its message. Figures and reports of single campaigns are made by `run`, or by
    `snakemake` for those that are asked for.

    Args:
        campaigns: table of campaigns (.csv) with the column campaign and, where known, arm and
            measured; or a pattern of folders of --raw-dir, such as '*'.
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
    import json

    from pa10cal.fleet.campaigns import campaigns_of
    from pa10cal.results.codec import read
    from pa10cal.results.fleet import FleetRecord
    from pa10cal.running.alone import alone
    from pa10cal.running.display import RunDisplay
    from pa10cal.running.workflow import Workflow, run_workflow, settings_of

    raw_dir, out = raw_dir.absolute(), out.absolute()
    asked = str(Path(campaigns).absolute()) if campaigns.endswith(".csv") else campaigns
    names = [each.campaign for each in campaigns_of(asked, raw_dir)]
    own = [] if settings is None else [settings]
    settings_of(own, {"campaigns": names}, f"{settings or 'campaigns'}")
    texts = {"campaigns": asked, "raw_dir": str(raw_dir), "results_dir": str(out)}
    config = {name: json.dumps(text) for name, text in texts.items()}
    display = RunDisplay(lines=False)
    quiet = ("--quiet", "all", "--logger", "pa10cal")
    targets = ("fleet",)
    workflow = Workflow(
        "workflow/run.smk", config, out, out, cores, targets, settings, quiet, profile
    )
    with alone(out):
        try:
            run_workflow(workflow, display)
        finally:
            display.close()
    found = read(FleetRecord, out / FleetRecord.FILE)
    for each in found.arms:
        if each.attention != "none":
            print(f"{each.arm}: {each.attention}: {each.last}: {each.why}")
    words = ", ".join(f"{count} {word}" for word, count in found.counts.items())
    print(f"\n{len(found.campaigns)} campaigns of {len(found.arms)} arms: {words}")
    print(f"{out / 'fleet/fleet.html'}\nin {display.seconds:.0f} s")
