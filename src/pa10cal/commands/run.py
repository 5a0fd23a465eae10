"""Command `run`."""

from __future__ import annotations

from pathlib import Path


def run(
    folder: Path,
    *,
    out: Path = Path("results"),
    cores: int = 0,
    settings: Path | None = None,
    prior: Path | None = None,
) -> None:
    """Run a folder of raw files to its grade, verdict, model, report, figures and tables.

    What is up to date is not made again. On a terminal the stages are shown while they run. Where a
    stage refuses, the report says so, with what there is before it.

    Args:
        folder: raw files of a campaign, with campaign.yaml.
        out: gets a folder of the campaign's name.
        cores: how many to use; 0 for all.
        settings: settings over the default ones, as config.yaml has them (.yaml).
        prior: model.yaml of the same arm to start from, or the results that hold it.

    Examples:
        pa10cal run examples/ur10-pose
        pa10cal run measured/2026-03 --out results/march --cores 1
        pa10cal run mine --settings robust.yaml
        pa10cal run after-the-crash --prior results/march/mine
    """
    from pa10cal.calibration.general.prior import refuse_unsound
    from pa10cal.campaign.description import read_description
    from pa10cal.commands.report import write_what_there_is
    from pa10cal.errors import OutputError
    from pa10cal.files.output import writing_into
    from pa10cal.fit.model_file import file_of, load_model
    from pa10cal.running.alone import WORK_FOLDER, alone
    from pa10cal.running.display import RunDisplay, paths, summarise, table
    from pa10cal.running.workflow import StageError, Workflow, run_workflow, settings_of

    folder, out = folder.absolute(), out.absolute()
    name = read_description(folder).name
    own = [] if settings is None else [settings]
    used = settings_of(own, {"campaigns": [name]}, f"{settings or folder / 'campaign.yaml'}: name")
    raw = out / WORK_FOLDER / "raw"
    link = raw / name
    if folder == out / name or folder in (out, *out.parents):
        raise OutputError(
            "the results would be written among the raw files",
            where="--out",
            value=str(out),
            allowed="a folder that neither is nor lies in the folder of raw files",
            remedy="give another one",
        )
    display = RunDisplay(lines=False)
    config = {"campaigns": f'["{name}"]', "raw_dir": str(raw), "results_dir": str(out)}
    if prior is not None:
        refuse_unsound(load_model(prior))
        config["calibration"] = f'{{"prior": "{file_of(prior).absolute()}"}}'
    quiet = ("--quiet", "all", "--logger", "pa10cal")
    targets = ("campaigns",)
    workflow = Workflow("workflow/run.smk", config, out, out, cores, targets, settings, quiet)
    with alone(out):
        with writing_into(out, "the results", "give another one with --out"):
            raw.mkdir(parents=True, exist_ok=True)
            if link.is_symlink():
                link.unlink()
            link.symlink_to(folder, target_is_directory=True)
        try:
            run_workflow(workflow, display)
        except StageError as error:
            told = str(error).replace(str(link), str(folder))
            ended = write_what_there_is(out / name, folder, used.evaluation.calibration)
            told = told if ended is None else f"{told}; report so far: {ended}"
            raise StageError(told) from None
        finally:
            display.close()
    print(table([summarise(out / name, used.evaluation.calibration)]))
    print(f"\n{paths(out / name)}\nin {display.seconds:.0f} s")
