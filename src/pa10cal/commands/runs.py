"""Commands for whole runs: `run`, `reproduce`, `report`, `fleet`, `fleet_summary`."""

from __future__ import annotations

import os
from contextlib import closing, suppress
from pathlib import Path

#: Raw files of so few bytes are read before the workflow starts, so that they are refused at once.
_SMALL = 5_000_000


def run(
    folders: tuple[Path, ...],
    *,
    group: str | None = None,
    arms: Path | None = None,
    out: Path | None = None,
    cores: int = 0,
    settings: Path | None = None,
    prior: Path | None = None,
) -> None:
    """Run a folder of raw files to its grade, verdict, model, report, figures and tables.

    Several folders of one robot are calibrated as one, a group, with the same results. Results that
    are up to date are not computed again. On a terminal the stages are shown while they run. If a
    stage refuses, the report names it, with the results before it.

    Args:
        folders: raw files of a campaign, with campaign.yaml; of a group, one folder a campaign.
        group: name of the group that several campaigns of one robot are.
        arms: folder of arm descriptions; without it, `arms` beside the folder of raw files.
        out: gets a folder of the campaign's or group's name; without it `results` here, and beside
            the folder of raw files where here is among them.
        cores: how many to use; 0 for all.
        settings: settings over the default ones, as config.yaml has them (.yaml).
        prior: model.yaml of the same arm to start from, or the results that hold it.

    Examples:
        pa10cal run examples/ur10-pose
        pa10cal run .
        pa10cal run measured/2026-03 --out results/march --cores 1
        pa10cal run measured/2026-03 measured/2026-09 --group cell-7
        pa10cal run mine --settings robust.yaml
        pa10cal run after-the-crash --prior results/march/mine
    """
    import json
    import sys
    from dataclasses import replace
    from typing import Any

    # What a folder can be refused for is checked before anything heavy is imported or started.
    from pa10cal.campaign.description import (
        check_joints,
        check_names,
        nominal_arm,
        read_description,
    )
    from pa10cal.errors import OutputError, Pa10calError, SettingsError
    from pa10cal.files import ARMS
    from pa10cal.files.output import writing_into
    from pa10cal.running.run_lock import run_lock

    if group is None and len(folders) > 1:
        raise SettingsError(
            "several campaigns without the name of their group",
            where="run",
            value=", ".join(map(str, folders)),
            allowed="one folder, or several of one robot with --group NAME",
            remedy="give --group NAME to calibrate them as one robot, or run them one by one",
        )
    names, places = [], [Path(os.path.normpath(folder.absolute())) for folder in folders]
    here = Path.cwd()
    beside = [each.parent for each in places if out is None and _is_in(here, each.resolve())]
    out = Path(os.path.normpath((beside[0] if beside else here) / (out or "results")))
    for folder in places:
        described = read_description(folder)
        arm = nominal_arm(described, folder, arms)
        check_joints(described, len(arm.axes_slide), str(folder / "campaign.yaml"))
        names.append(described.name)
    if group is not None:
        check_names(group, names, f"--group {group}")
    name = group or names[0]
    for folder in places:
        if folder == out / name or _is_in(out, folder):
            raise OutputError(
                "the results would be written among the raw files",
                where="--out",
                value=str(out),
                allowed="a folder that neither is nor lies in the folder of raw files",
                remedy="give another one",
            )

    from pa10cal.planning.campaign import check_prior, raw_files
    from pa10cal.results.fleet import ChainRecord
    from pa10cal.running.workflow import RunDisplay, StageError, Workflow, run_workflow, settings_of

    own = [] if settings is None else [settings]
    over: dict[str, Any] = {"campaigns": names}
    if group is not None:
        over["groups"] = {group: names}
    used = settings_of(own, over, str(settings or f"{places[0] / 'campaign.yaml'}: name"))
    for folder in places:
        if sum(path.stat().st_size for path in raw_files(folder) if path.is_file()) < _SMALL:
            from pa10cal.campaign.read import read_campaign

            read_campaign(folder, used.ingest, arms=arms)
    config = {key: json.dumps(value) for key, value in over.items()}
    if given := prior or (Path(used.calibration.prior) if used.calibration.prior else None):
        from pa10cal.calibration.general.other_campaign import refuse_unsound
        from pa10cal.fit.fitted_model import file_of, load_model

        check_prior(given, [out / each for each in (name, *names)])
        refuse_unsound(load_model(given))
        config["calibration"] = json.dumps({"prior": str(file_of(given).absolute())})
    targets = ("campaigns",) if group is None else (str(out / group / "report.html"),)
    links = dict(zip(names, places, strict=True))
    if beside:
        print(f"pa10cal run: results go to {out}, beside the raw files", file=sys.stderr)
    with run_lock(out, [name]) as work, closing(RunDisplay(lines=False)) as display:
        raw = work / "raw_dirs" / name
        config |= {"raw_dir": str(raw), "results_dir": str(out)}
        workflow = Workflow("workflow/run.smk", config, out, out, name, cores, targets, settings)
        # Of results of a fleet, Snakemake does not know with which settings they were made.
        of_fleet = out / name / ChainRecord.FILE
        if of_fleet.exists():
            workflow = replace(workflow, more=(*workflow.more, "--forceall"))
        with writing_into(out, "the results", "give another one with --out"):
            raw.mkdir(parents=True, exist_ok=True)
            for former in raw.iterdir():  # of another run, perhaps to other folders
                former.unlink()
            for link, folder in links.items():
                (raw / link).symlink_to(folder, target_is_directory=True)
            if arms is not None:
                (raw / ARMS).symlink_to(arms.absolute(), target_is_directory=True)
        try:
            run_workflow(workflow, display)
        except StageError as error:
            from pa10cal.reports.page import write_page
            from pa10cal.reports.results_bundle import MODEL

            told = str(error)
            for link, folder in links.items():
                told = told.replace(str(raw / link), str(folder))
            # Results with a model are those of an earlier run, perhaps of other raw files.
            if not (out / name / MODEL).exists():
                page = out / name / "report.html"
                described_in = out / name / "ingest" if group is not None else places[0]
                with suppress(Pa10calError):  # then there is nothing to tell but what ended the run
                    write_page(out / name, page, described_in, used.evaluation.calibration)
                    told += f"; report so far: {page}"
            raise StageError(told) from None
        of_fleet.unlink(missing_ok=True)

    from pa10cal.reports.summary import paths, summarise, table

    print(table([summarise(out / name, used.evaluation.calibration)]))
    print(f"\n{paths(out / name)}\nin {display.seconds:.0f} s")


def _is_in(place: Path, folder: Path) -> bool:
    return folder in (place, *place.parents)


def reproduce(
    *,
    cores: int = 0,
    settings: Path | None = None,
    figures: bool = False,
    profile: str | None = None,
) -> None:
    """Run the whole workflow in this folder, a line a stage, and end with one table.

    The campaigns are those of config.yaml. `make reproduce` and `make figures` call it. Results
    that are up to date are not computed again, so the same command continues a run that was
    interrupted or killed.

    Args:
        cores: how many to use; 0 for all.
        settings: settings over those of config.yaml (.yaml).
        figures: make figures and tables alone, and what they are drawn from; otherwise everything,
            and `report.html` among the results: every campaign's page, and pictures of studies.
        profile: slurm, or a folder with a profile of Snakemake, to run on a cluster.

    Examples:
        pa10cal reproduce
        pa10cal reproduce --cores 1 --settings my_campaigns.yaml
        pa10cal reproduce --profile slurm
    """
    import sys

    from pa10cal.reports.page import write_page
    from pa10cal.reports.summary import reports, summarise, table
    from pa10cal.running.workflow import (
        RunDisplay,
        Workflow,
        run_workflow,
        settings_of,
        workflow_folder,
    )

    files = [workflow_folder() / "config.yaml", *([] if settings is None else [settings])]
    used = settings_of(files, {}, str(files[-1]))
    results, here = Path(used.results_dir), Path.cwd()
    print(
        f"{', '.join(used.campaigns)}: raw files in {used.raw_dir}, results in {results}. It takes "
        "some minutes; what is up to date is not made again.",
        file=sys.stderr,
    )
    targets = ("figures",) if figures else ()
    with closing(RunDisplay(lines=True)) as display:
        page = "report.html"  # the rest is held by the rules
        whole = Workflow(
            "Snakefile", {}, here, here / results, page, cores, targets, settings, profile=profile
        )
        run_workflow(whole, display)
    if figures:
        for name in used.campaigns:
            print(f"{results / name / 'figures'}, {results / name / 'tables'}")
        return
    write_page(results, results / "report.html")
    calibration = used.evaluation.calibration
    print(f"\n{table([summarise(results / name, calibration) for name in used.campaigns])}\n")
    print(f"in all {display.seconds:.0f} s")
    print(reports([results / name for name in used.campaigns]))
    print(f"every picture  {results / 'report.html'}")


def report(
    results: Path, *, out: Path, campaign_dir: Path | None = None, calibration: str = "combined"
) -> None:
    """Write the report of a campaign: one page that needs no network.

    The page names missing results, with the reason. For a folder of all results it links to the
    page of every campaign, and shows the pictures of studies.

    Args:
        results: results of a campaign, RESULTS_DIR/CAMPAIGN; or RESULTS_DIR.
        out: page to write (.html).
        campaign_dir: folder of raw files, for what campaign.yaml says of the instrument.
        calibration: load case that was evaluated.

    Examples:
        pa10cal report results/cell-a --out report.html
    """
    from pa10cal.reports.page import write_page

    name, size = write_page(results, out, campaign_dir, calibration)
    print(f"{name}: report {out}, {size / 1e6:.1f} MB")


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

    from pa10cal.fleet.arm_status import forget_ended
    from pa10cal.fleet.campaigns import campaigns_of
    from pa10cal.results.codec import read
    from pa10cal.results.fleet import FleetRecord
    from pa10cal.running.run_lock import run_lock
    from pa10cal.running.workflow import (
        RunDisplay,
        StageError,
        Workflow,
        run_workflow,
        settings_of,
    )

    raw_dir, out = raw_dir.absolute(), out.absolute()
    asked = str(Path(campaigns).absolute()) if campaigns.endswith(".csv") else campaigns
    listed = campaigns_of(asked, raw_dir)
    names = [each.campaign for each in listed]
    own = [] if settings is None else [settings]
    used = settings_of(own, {"campaigns": names}, f"{settings or 'campaigns'}")
    texts = {"campaigns": asked, "raw_dir": str(raw_dir), "results_dir": str(out)}
    config = {name: json.dumps(text) for name, text in texts.items()}
    if used.calibration.prior:
        config["calibration"] = json.dumps({"prior": str(Path(used.calibration.prior).absolute())})
    targets = ("fleet",)
    workflow = Workflow(
        "workflow/run.smk", config, out, out, "fleet", cores, targets, settings, profile=profile
    )
    with run_lock(out, ["fleet"]), closing(RunDisplay(lines=False)) as display:
        forget_ended(listed, out)
        run_workflow(workflow, display)
    found = read(FleetRecord, out / FleetRecord.FILE)
    last = set()
    for each in found.arms:
        if each.attention != "none":
            print(f"{each.arm}: {each.attention}: {each.last}: {each.why}")
            last.add(each.last)
    lost = [each for each in found.campaigns if each.became.status != "done"]
    for of in lost:  # of earlier campaigns of arms too
        if of.campaign not in last:
            why = ": ".join(filter(None, (of.became.stage, of.became.message)))
            print(f"{of.arm}: {of.became.status}: {of.campaign}: {why}")
    words = ", ".join(f"{count} {word}" for word, count in found.counts.items())
    print(f"\n{len(found.campaigns)} campaigns of {len(found.arms)} arms: {words}")
    print(f"{out / 'fleet/fleet.html'}\nin {display.seconds:.0f} s")
    if lost:
        named = ", ".join(each.campaign for each in lost[:10]) + ", …" * (len(lost) > 10)
        raise StageError(f"{len(lost)} of {len(found.campaigns)} campaigns gave no model: {named}")


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
    from pa10cal.reports.page import fleet_page_text
    from pa10cal.results.codec import write

    found = fleet_record(campaigns_of(campaigns, raw_dir), results)
    outputs = tuple(out / f"fleet.{ending}" for ending in ("csv", "html", "json"))
    with whole_files(*outputs) as (table, page, record):
        write_text(table, fleet_csv(found))
        write_text(page, fleet_page_text(found))
        write(found, record)
    words = ", ".join(f"{count} {word}" for word, count in found.counts.items())
    first = [each for each in found.arms if each.attention != "none"]
    print(f"fleet: {len(found.campaigns)} campaigns of {len(found.arms)} arms: {words}")
    print(f"fleet: {len(first)} arms need attention: {', '.join(e.arm for e in first[:10])}")
