"""The package from Python: read a campaign, calibrate the arm, find what the model lacks.

Each function takes what the one before returns, and works in memory; nothing is written but by
`FittedModel.save` and `report`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import Campaign
from pa10cal.campaign.read import read_campaign as read_raw
from pa10cal.files.arms import arm_asked
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_reading import load_model
from pa10cal.options import BaseFrameOptions, DiscoveryOptions, IngestOptions

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm
    from pa10cal.discovery.verdict import Verdict
    from pa10cal.pose_plan.options import PlanOptions
    from pa10cal.pose_plan.plan import PosePlan
    from pa10cal.results.comparison import ComparisonRecord


def read_campaign(
    folder: Path | str, options: IngestOptions | None = None, *, arms: Path | str | None = None
) -> Campaign:
    """Read a measurement campaign: its raw files to single readings, held-out poses marked.

    Zeros that logged torques show beside the weights are taken out of them.

    Args:
        folder: the campaign's folder, with `campaign.yaml` and the raw files that it names.
        options: how to ingest; None for the defaults.
        arms: folder of arm descriptions; None for `arms` beside the campaign's folder.

    Raises:
        RawDataError: when the description or a file, or too much of it, cannot be used, when there
            is no `grid` row, or when the arm has prismatic joints and its log gives degrees.
        SettingsError: when a key of the description does not fit.
    """
    return _without_torque_errors(_as_ingested(folder, options, arms))


def read_group(
    folders: Sequence[Path | str],
    name: str = "group",
    options: IngestOptions | None = None,
    *,
    arms: Path | str | None = None,
) -> Campaign:
    """Read several measurement campaigns of one robot as one.

    Link departures, springs and effects are shared. Base, tool or targets, and noise are each
    campaign's own: their parameters bear its name, as `tool_x@ur10-c`. Labels of poses do too.
    Zeros that logged torques show beside the weights are taken out of them.

    Args:
        folders: the campaigns' folders; the first gives the frame of the base and the orientation
            of the target.
        name: of the group.
        options: how to ingest; None for the defaults.
        arms: folder of arm descriptions; None for `arms` beside each campaign's folder.

    Raises:
        RawDataError: when one cannot be used (see `read_campaign`), they are fewer than two or of
            several robots, or names are not apart.
        CalibrationError: when the poses of one do not determine its base and targets.
    """
    from pa10cal.calibration.campaign import located_base
    from pa10cal.calibration.general.calibrate import start_of
    from pa10cal.campaign.description import describe_group, nominal_arm
    from pa10cal.campaign.table import arm_of
    from pa10cal.observe.joined import GroupCampaign, join

    read = [_as_ingested(folder, options, arms) for folder in folders]
    description = describe_group(name, [(each.description, each.arm) for each in read])
    members = []
    for each in read:
        measured = each.description, each.arm, each.observations
        seed = located_base(*measured, BaseFrameOptions(), str(each.folder))
        start = start_of(seed, each.observations.measured)
        members.append(GroupCampaign(each.name, each.observations, start))
    together, folder = join(members), read[0].folder
    nominal = nominal_arm(description, folder, None if arms is None else Path(arms))
    quarantined = (
        replace(row, file=f"{each.name}/{row.file}") for each in read for row in each.quarantined
    )
    found = Campaign(
        folder,
        description,
        arm_of(description, folder, together, nominal),
        together,
        tuple(quarantined),
        tuple(f"{each.name}: {note}" for each in read for note in each.notes),
        tuple(f"{each.name}: {warning}" for each in read for warning in each.warnings),
    )
    return _without_torque_errors(found)


def _as_ingested(
    folder: Path | str, options: IngestOptions | None, arms: Path | str | None
) -> Campaign:
    """Return a campaign with its readings as `pa10cal ingest` leaves them."""
    from pa10cal.campaign.table import as_in_table

    found = read_raw(folder, options, arms=arms)
    every = as_in_table(found.observations, found.arm.prismatic, found.description)
    return replace(found, observations=every)


def _without_torque_errors(found: Campaign) -> Campaign:
    """Return a campaign with its torques as every stage after `ingest` takes them."""
    from pa10cal.fit.logged_torques import without_torque_errors

    return replace(found, observations=without_torque_errors(found.observations, found.arm))


def calibrate(
    campaign: Campaign,
    options: CalibrationOptions | None = None,
    *,
    load: str = "combined",
    prior: FittedModel | Path | str | None = None,
    force: bool = False,
    base_frame: BaseFrameOptions | None = None,
) -> FittedModel:
    """Calibrate the arm of a campaign.

    Touched balls are calibrated with the paper's model on two levels, other instruments with the
    general model, unless `options.model` states another.

    Args:
        campaign: from `read_campaign`.
        options: how to calibrate; None for the defaults. Effects that they list are fitted with the
            default options of the search.
        load: `combined` for all loads together, or a load such as `44N`.
        prior: a fitted model of the same arm to start from, or its file, as after a crash or with a
            new tool: base, tool and targets are found anew, the rest is expected where the model
            has it; None for that of `options.prior`, if there is one.
        force: whether a prior is taken whatever its grade.
        base_frame: what straight-line moves must satisfy; None for the defaults.

    Returns:
        The calibrated model; `grade` rates it in a word, `fitted_to.health` states the reason and
        the remedy, in one sentence.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, the arm as described
            does not fit the readings at all, the prior is of another arm, of these readings,
            without covariance or of an unsound calibration, or `options.effects` is `named`: list
            the effects.
        DiscoveryError: when there are too few poses, or too few repeats, to fit effects.
        ModelError: when the file of the prior cannot be read.
    """
    from pa10cal.calibration.campaign import calibrated_record
    from pa10cal.calibration.input_checks import check_input, explained
    from pa10cal.calibration.load_case import LoadCase
    from pa10cal.discovery.given_record import effects_listed, record_with_effects
    from pa10cal.errors import CalibrationError, DiscoveryError
    from pa10cal.fit.model_reading import models_of

    options = options or CalibrationOptions()
    effects = effects_listed(options)
    prior = prior or options.prior
    model = load_model(prior) if isinstance(prior, str | Path) else prior
    if model is not None:
        from pa10cal.calibration.general.prior import refuse_unsound

        refuse_unsound(model, force=force)
    measured = campaign.description, campaign.arm, campaign.observations
    findings = check_input(*measured, options)
    case = LoadCase(*measured, load, options, findings, model)
    try:
        record = calibrated_record(case, base_frame)
        record = record_with_effects(effects, record, case, DiscoveryOptions())
    except (CalibrationError, DiscoveryError) as error:
        raise explained(error, findings) from None
    *_, calibrated = models_of(record, campaign.name).values()  # the last is the calibration itself
    return calibrated


def discover(
    campaign: Campaign,
    model: FittedModel,
    options: DiscoveryOptions | None = None,
    calibration: CalibrationOptions | None = None,
) -> Verdict:
    """Find which effects a calibrated model lacks, and close the gap.

    Args:
        campaign: from `read_campaign`; its held-out poses serve nothing but the gap.
        model: from `calibrate`.
        options: how to search; None for the defaults.
        calibration: the options given to `calibrate`; None for the defaults. Only the uncertainty
            of the places of touched balls counts (`apparatus_uncertainty_mm`).

    Returns:
        The verdict: `verdict.verdict` in a word, `verdict.effects`, `verdict.model` with the
        effects in it, `verdict.holdout` and `verdict.train` for the gap. With too few poses or
        repeats the word is `not_sought`, `verdict.why` and `verdict.remedy` say what is lacking,
        and `verdict.model` is the calibrated model.

    Raises:
        CalibrationError: when the model is of another arm or of other targets than the campaign, or
            a joint with a spring has no torque.
    """
    from pa10cal.calibration.general.prior import refuse_another_arm
    from pa10cal.discovery.discover import discover as search
    from pa10cal.discovery.preparation import setup_of

    refuse_another_arm(model, campaign.arm, "model", "it")
    _refuse_other_targets(model, campaign)
    setup = setup_of(
        campaign.description,
        campaign.arm,
        calibration or CalibrationOptions(),
        options or DiscoveryOptions(),
    )
    return search(campaign.observations, model, setup, campaign.wrong_rows)


def _refuse_other_targets(model: FittedModel, campaign: Campaign) -> None:
    """Refuse a model that has other targets than those that a campaign measured."""
    from pa10cal.errors import CalibrationError

    coordinates = len(campaign.observations.measured.target_parameters)
    if len(model.targets_m) != coordinates:
        raise CalibrationError(
            "it has other targets than the campaign",
            where="model",
            value=f"{len(model.targets_m)} coordinates of targets",
            allowed=f"a model calibrated with {campaign.name}, which has {coordinates}",
            remedy="calibrate with this campaign",
        )


def compare(
    first: FittedModel, second: FittedModel, names: tuple[str, str] = ("first", "second")
) -> ComparisonRecord:
    """Compare two models of the same arm: what differs, and whether that is significant.

    Args:
        first, second: from `calibrate`, `discover` or `load_model`.
        names: what they are called in the record.

    Returns:
        The comparison: `line` states in a sentence whether they agree within their uncertainty,
        `parameters` lists every parameter of both, `frames["flange"]` how far apart they put the
        flange over the joint angles that both have seen.

    Raises:
        ModelError: when the arms differ in layout, or a model with springs does not know the
            weights that load them.
    """
    from pa10cal.evaluation.two_models import compare_models

    return compare_models(first, second, names)


def plan(
    robot: Arm | str, instrument: str, poses: int, options: PlanOptions | None = None
) -> PosePlan:
    """Choose which poses to measure, before any is measured.

    Args:
        robot: the nominal arm; the name of a shipped one, or of one in robot_descriptions; or the
            file of its description (.yaml).
        instrument: what will measure: `pose`, `points`, `distance` or `touch_trigger_cmm`.
        poses: how many.
        options: where arm and instrument may be, what is measured; None for the defaults.

    Returns:
        The poses in the order in which to drive to them, and what to expect of them; `save` writes
        them as CSV, with a JSON file beside.

    Raises:
        ArmError: for a robot that does not exist, or whose file cannot be used.
        CalibrationError: for an instrument that does not exist, fewer poses than the unknowns of
            the model need, or too few poses within all limits.
    """
    from pa10cal.pose_plan.plan import plan_poses

    arm = arm_asked(robot) if isinstance(robot, str) else robot
    return plan_poses(arm, instrument, poses, options)


def report(results: Path | str, out: Path | str, campaign_dir: Path | str | None = None) -> None:
    """Write the report of a campaign: one page that needs no network.

    Of a folder that holds results of several campaigns, with a page each, it is their overview.

    Args:
        results: results of a campaign, as `pa10cal run` leaves them, or the folder of all.
        out: page to write (.html).
        campaign_dir: folder of raw files, for what campaign.yaml says of the instrument.

    Raises:
        RecordError: when there are no results of a campaign, or they cannot be read.
        RawDataError: when `campaign_dir` is not the folder of a campaign.
        OutputError: when the page cannot be written.
    """
    from pa10cal.reports.page import write_page

    write_page(Path(results), Path(out), None if campaign_dir is None else Path(campaign_dir))
