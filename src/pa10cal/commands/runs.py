"""Commands for whole runs: `run`, `reproduce`, `report`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.errors import CalibrationError, Pa10calError, SettingsError
from pa10cal.files import ARMS
from pa10cal.files.output import remove_results, writing_into
from pa10cal.running import workflow as running
from pa10cal.running.display import RunDisplay
from pa10cal.running.failure import StageError
from pa10cal.running.run_lock import run_lock

if TYPE_CHECKING:
    from pa10cal.options import IngestOptions
    from pa10cal.settings import Settings

#: Campaigns with fewer bytes of raw files are read before the workflow starts: one that is not
#: usable is refused at once.
_SMALL_BYTES = 5_000_000
#: What is made of all other results of a campaign.
_DRAWN = ("figures", "tables", "pictures.json", "report.html")


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
    are up to date are not computed again, those that were removed are. On a terminal the stages are
    shown while they run. If a stage refuses, the report names it, with the results before it; an
    earlier run's results of later stages are removed.

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
    # Everything that a folder can be refused for is checked before anything heavy is imported.
    from pa10cal.planning.campaign import refuse_among_raw_files, refuse_files_of_others

    _refuse_without_group(folders, group)
    folders = tuple(Path(os.path.normpath(folder.absolute())) for folder in folders)
    out, beside_raw_files = _results_folder(folders, out)
    names = _campaign_names(folders, group, arms)
    name = group or names[0]
    for folder in folders:
        refuse_among_raw_files(out / name, folder, "--out", out)
    over: dict[str, object] = {"campaigns": names}
    if group is not None:
        over["groups"] = {group: names}
    where = str(settings or f"{folders[0] / 'campaign.yaml'}: name")
    used = running.settings_of([settings] if settings else [], over, where)
    _read_small_campaigns(folders, used.ingest, arms)
    if given := prior or (Path(used.calibration.prior) if used.calibration.prior else None):
        results = [out / each for each in (name, *names)]
        file = _checked_prior(given, results, folders[0], arms)
        over["calibration"] = {"prior": str(file.absolute())}
    config = {key: json.dumps(value) for key, value in over.items()}
    if beside_raw_files:
        print(f"pa10cal run: results go to {out}, beside the raw files", file=sys.stderr)

    from pa10cal.results.outcomes import ChainRecord

    with run_lock(out, [name]) as work, closing(RunDisplay(lines=False)) as display:
        refuse_files_of_others(out / name)
        raw_dir = work / "raw_dirs" / name
        workflow = running.Workflow(
            file="workflow/run.smk",
            config=config | {"raw_dir": str(raw_dir), "results_dir": str(out)},
            folder=out,
            results=out,
            name=name,
            cores=cores,
            targets=("campaigns",) if group is None else (str(out / group / "report.html"),),
            settings=settings,
        )
        fleet_record = out / name / ChainRecord.FILE
        if fleet_record.exists():  # Snakemake does not know with which settings a fleet made them
            workflow = replace(workflow, more=(*workflow.more, "--forceall"))
        with writing_into(out, "the results", "give another one with --out"):
            links = _link_raw_files(raw_dir, dict(zip(names, folders, strict=True)), arms)
            _forget_incomplete(out / name, folders[0] if group is None else out / name / "ingest")
        try:
            running.run_workflow(workflow, display)
        except StageError as error:
            report = ""
            if _remove_stale(out / name, tuple(links), used):
                described_in = folders[0] if group is None else out / name / "ingest"
                report = _report_so_far(out / name, described_in, used.evaluation.calibration)
            raise StageError(_with_real_paths(str(error), links) + report) from None
        fleet_record.unlink(missing_ok=True)
        if used.calibration.effects != "named":  # of a run with the effects of the verdict
            remove_results(out / name, "baseline")

    from pa10cal.reports.summary import paths, summarise, table

    print(table([summarise(out / name, used.evaluation.calibration)]))
    print(f"\n{paths(out / name)}\nin {display.seconds:.0f} s")


def _refuse_without_group(folders: Sequence[Path], group: str | None) -> None:
    if group is None and len(folders) > 1:
        raise SettingsError(
            "several campaigns without the name of their group",
            where="run",
            value=", ".join(map(str, folders)),
            allowed="one folder, or several of one robot with --group NAME",
            remedy="give --group NAME to calibrate them as one robot, or run them one by one",
        )


def _results_folder(folders: Sequence[Path], out: Path | None) -> tuple[Path, bool]:
    """Return the folder of results, and whether it was put beside the raw files.

    By default it is `results` in the working folder; beside the raw files if that lies among them.
    """
    here = Path.cwd()
    surrounding = [folder for folder in folders if folder.resolve() in (here, *here.parents)]
    beside = out is None and bool(surrounding)
    start = surrounding[0].parent if beside else here
    return Path(os.path.normpath(start / (out or "results"))), beside


def _campaign_names(folders: Sequence[Path], group: str | None, arms: Path | None) -> list[str]:
    """Return the names of the campaigns; their descriptions, arms and group are checked."""
    from pa10cal.campaign import description

    names = []
    for folder in folders:
        campaign = description.read_description(folder)
        arm = description.nominal_arm(campaign, folder, arms)
        file = str(folder / description.DESCRIPTION_FILE)
        description.check_joints(campaign, len(arm.axes_slide), file)
        _refuse_name(campaign.name, file)
        names.append(campaign.name)
    if group is not None:
        description.check_names(group, names, f"--group {group}")
    return names


def _refuse_name(name: str, file: str) -> None:
    """Refuse the name of a campaign that its results cannot have."""
    from pa10cal.commands.data import label_of
    from pa10cal.errors import NAME_RULE, SettingsError, fits_a_folder
    from pa10cal.settings import RESERVED

    if not fits_a_folder(name) or name in RESERVED:
        raise SettingsError(
            "results cannot be called so",
            where=f"{file}: name",
            value=name,
            allowed="no folder of a study" if name in RESERVED else NAME_RULE,
            remedy=f"set name: {label_of(name)}, and call the folder so",
        )


def _read_small_campaigns(
    folders: Sequence[Path], options: IngestOptions, arms: Path | None
) -> None:
    """Read campaigns that are quick to read; one that cannot be used is refused here."""
    from pa10cal.planning.campaign import raw_files

    for folder in folders:
        size = sum(path.stat().st_size for path in raw_files(folder) if path.is_file())
        if size < _SMALL_BYTES:
            from pa10cal.campaign.read import read_campaign

            read_campaign(folder, options, arms=arms)


def _checked_prior(given: Path, results: Sequence[Path], folder: Path, arms: Path | None) -> Path:
    """Return the file of a prior.

    One that is unsound, of another arm than the campaign of a folder, or among the results to be
    made is refused.
    """
    from pa10cal.calibration.general.prior import refuse_as_prior, refuse_unsound
    from pa10cal.campaign.description import nominal_arm, read_description
    from pa10cal.fit.model_reading import load_model, model_file
    from pa10cal.planning.campaign import check_prior

    check_prior(given, results)
    model = load_model(given)
    refuse_unsound(model)
    try:
        refuse_as_prior(model, nominal_arm(read_description(folder), folder, arms))
    except CalibrationError as error:
        raise error.within(str(given)) from None
    return model_file(given)


def _link_raw_files(
    raw_dir: Path, folder_of: Mapping[str, Path], arms: Path | None
) -> dict[Path, Path]:
    """Link campaigns' folders by name, and the folder of arms; return each folder by its link."""
    raw_dir.mkdir(parents=True, exist_ok=True)
    for former in raw_dir.iterdir():  # of an earlier run, perhaps to other folders
        former.unlink()
    links = {raw_dir / name: folder for name, folder in folder_of.items()}
    for link, folder in links.items():
        link.symlink_to(folder, target_is_directory=True)
    if arms is not None:
        (raw_dir / ARMS).symlink_to(arms.absolute(), target_is_directory=True)
    return links


def _forget_incomplete(results: Path, described_in: Path) -> None:
    """Remove the calibration of all loads where one of a load case is missing.

    Which cases there are only the readings say, so that Snakemake knows of the one of all loads
    alone: without it every case is calibrated again.
    """
    from pa10cal.stages.pipeline import CampaignFiles

    files = CampaignFiles(results)
    if not files.poses.is_file():
        return
    whole = [files.calibration(bare=bare) for bare in (False, True)]
    if not any(path.is_file() for path in whole):
        return
    from pa10cal.calibration.load_case import load_cases
    from pa10cal.stages.calibrate import GENERAL
    from pa10cal.stages.inputs import read_measured

    with suppress(Pa10calError):  # what cannot be read the stages make anew, or refuse
        _, _, observations = read_measured(described_in, files.poses)
        cases = list(load_cases(observations.of_kind("grid").states))
        for path in filter(Path.is_file, whole):
            record = json.loads(path.read_text("utf-8"))
            names = [*cases, GENERAL] if record.get("model") == "paper" else cases
            made = set(names).difference(record.get("loads_left_out", ()))
            if not all(path.with_name(f"{name}.json").is_file() for name in made):
                path.unlink()


def _with_real_paths(message: str, links: Mapping[Path, Path]) -> str:
    """Return a message that names folders of raw files in place of the links to them."""
    for link, folder in links.items():
        message = message.replace(str(link), str(folder))
    return message


def _remove_stale(results: Path, folders: tuple[Path, ...], used: Settings) -> bool:
    """Remove what an earlier run made after the stage that refused; return whether one refused.

    It would look like results of this run.
    """
    from pa10cal.command_settings import ChainOptions
    from pa10cal.results.outcomes import ChainRecord
    from pa10cal.stages.pipeline import lost_results, stages

    sections = {name: getattr(used, name) for name in ChainOptions.model_fields}
    lost = lost_results(stages(folders, results, ChainOptions(**sections)))
    made = {path.relative_to(results).parts[0] for path in lost}
    refused = bool(lost) or not all((results / name).exists() for name in _DRAWN)
    if refused:
        remove_results(results, *made, *_DRAWN, ChainRecord.FILE)
    return refused


def _report_so_far(results: Path, described_in: Path, load_case: str) -> str:
    """Write the report of a run that a stage ended, and return the words that name it, if any."""
    from pa10cal.reports.page import write_page

    page = results / "report.html"
    with suppress(Pa10calError):  # no result to report
        write_page(results, page, described_in, load_case)
        return f"; report so far: {page}"
    return ""


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
    from pa10cal.reports.page import write_page
    from pa10cal.reports.summary import reports, summarise, table

    files = [running.workflow_folder() / "config.yaml", *([settings] if settings else [])]
    used = running.settings_of(files, {}, str(files[-1]))
    results, here = Path(used.results_dir), Path.cwd()
    print(
        f"{', '.join(used.campaigns)}: raw files in {used.raw_dir}, results in {results}. It takes "
        "some minutes; what is up to date is not made again.",
        file=sys.stderr,
    )
    workflow = running.Workflow(
        file="Snakefile",
        config={},
        folder=here,
        results=here / results,
        name="report.html",  # all else is made, and locked, by the rules
        cores=cores,
        targets=("figures",) if figures else (),
        settings=settings,
        profile=profile,
    )
    with closing(RunDisplay(lines=True)) as display:
        running.run_workflow(workflow, display)
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
    from pa10cal.errors import OutputError
    from pa10cal.reports.page import write_page

    if out.suffix.lower() not in (".html", ".htm"):  # a slip, which would replace a result
        raise OutputError(
            "the report is a page",
            where="--out",
            value=str(out),
            allowed="the path of an HTML file",
            remedy=f"give {out.with_suffix('.html')}" if out.name else "give report.html",
        )
    name, size = write_page(results, out, campaign_dir, calibration)
    print(f"{name}: report {out}, {size / 1e6:.1f} MB")
