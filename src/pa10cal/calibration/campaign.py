"""The calibration of a campaign in memory: one load case, by the paper's model or the general."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import fitted_model
from pa10cal.calibration.general.calibrate import find_start, start_of
from pa10cal.calibration.general.case import GeneralCase, fitted, work_out_general
from pa10cal.calibration.general.records import general_record
from pa10cal.calibration.load_case import COMBINED, LoadCase, rows_of_load, work_out
from pa10cal.calibration.options import CalibrationOptions, takes_general_model
from pa10cal.calibration.records import fitted_to, paper_record
from pa10cal.calibration.uncertainty import align_nominal, suspected_held_out
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations, average_repeats, poses_of
from pa10cal.observe.order import with_arrivals
from pa10cal.observe.quantities import Start
from pa10cal.results.calibration import BaseFrameRecord, CalibrationRecord
from pa10cal.results.health import InputFinding
from pa10cal.terms.joint_spring import nominal


def calibrated(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    load: str = COMBINED,
    options: CalibrationOptions | None = None,
    findings: tuple[InputFinding, ...] = (),
    prior: FittedModel | None = None,
) -> FittedModel:
    """Calibrate the arm of a campaign, its base, tool and targets found from the nominal arm.

    Args:
        campaign: description of the campaign.
        arm: the nominal arm.
        every: single readings of all kinds.
        load: `combined`, or a load such as `44N`.
        options: how to calibrate; None for the defaults, without trying random inner poses.
        findings: what checks of the input found.
        prior: fitted model of the arm to start from; None for none.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, or the arm as
            described does not fit the readings at all.
    """
    options = options or CalibrationOptions(inner_subsets=0)
    payload = campaign.payload(arm)
    if takes_general_model(options.model, from_touches=campaign.from_touches):
        start = find_start(arm, average_repeats(every.of_kind("grid")))
        case = general_case(campaign, arm, every, start, load, options, findings, prior)
        model, used, health = fitted(case.full), case.full.problem.observations, case.health
    else:
        refuse_prior(prior)
        seed = align_nominal(nominal(arm), poses_of(every, "grid"))
        papers = paper_case(campaign, arm, every, seed, load, options, findings)
        model, health = fitted_model(papers.cubic, payload), papers.health
        used = papers.cubic.level.observations
    return replace(model, fitted_to=fitted_to(used, load, health, campaign))


def calibration_record(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    seed: BaseFrameRecord,
    load: str,
    options: CalibrationOptions,
    *,
    general: bool,
    findings: tuple[InputFinding, ...] = (),
    prior: FittedModel | None = None,
) -> CalibrationRecord:
    """Calibrate a load case, and return its record.

    Args:
        campaign: description of the campaign.
        arm: the nominal arm.
        every: single readings of all kinds.
        seed: about where base, tool and targets are.
        load: `combined`, `general`, or a load such as `44N`.
        options: how to calibrate.
        general: whether with all that can be identified, or with the paper's unknowns.
        findings: what checks of the input found.
        prior: fitted model of the arm to start from; None for none.

    Raises:
        CalibrationError: see `paper_case` and `general_case`.
    """
    if general:
        start = start_of(seed, every.measured)
        case = general_case(campaign, arm, every, start, load, options, findings, prior)
        return general_record(case, campaign, options)
    refuse_prior(prior)
    papers = paper_case(campaign, arm, every, seed.T_instr_base, load, options, findings)
    return paper_record(papers, campaign, campaign.payload(arm), options)


def refuse_prior(prior: FittedModel | None) -> None:
    """Refuse a prior where the paper's model is fitted, which starts from none.

    Raises:
        CalibrationError: where one is given.
    """
    if prior is not None:
        raise CalibrationError(
            "the paper's model does not start from a prior",
            where="calibration.prior",
            value=prior.arm.name,
            allowed="a prior with the general model",
            remedy="set calibration.model to general, or omit the prior",
        )


def paper_case(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    T_instr_base_seed: Array,
    load: str,
    options: CalibrationOptions,
    findings: tuple[InputFinding, ...] = (),
) -> LoadCase:
    """Compute a load case on two levels, with the paper's unknowns.

    Args:
        campaign: description of the campaign.
        arm: the nominal arm.
        every: single readings of all kinds.
        T_instr_base_seed: (4, 4) about where the base is.
        load: `combined`, or a load such as `44N`.
        options: how to calibrate.
        findings: what checks of the input found.

    Raises:
        CalibrationError: when the instrument measures no poses, or there are too few of them.
    """
    if not every.measured.measures_pose:
        raise CalibrationError(
            "the paper's model needs positions and attitudes of one campaign",
            where="calibration.model",
            value=options.model,
            allowed=f"auto or general for {campaign.instrument_kinds}",
            remedy="set calibration.model to auto",
        )
    held_out = poses_of(every, "holdout")
    return work_out(
        arm,
        poses_of(every, "grid", average=False),
        held_out if len(held_out) else None,
        T_instr_base_seed,
        load,
        options,
        stated=poses_of(every, "grid", average=False, covariance="instrument"),
        findings=findings,
        suspects=partial(suspected_held_out, every),
    )


def general_case(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    start: Start,
    load: str,
    options: CalibrationOptions,
    findings: tuple[InputFinding, ...] = (),
    prior: FittedModel | None = None,
) -> GeneralCase:
    """Compute a load case with every parameter that arm and instrument can identify.

    Args:
        campaign: description of the campaign.
        arm: the nominal arm.
        every: single readings of all kinds.
        start: about where frames and targets are.
        load: `combined` or `general` for all loads together, or a load such as `44N`.
        options: how to calibrate.
        findings: what checks of the input found.
        prior: fitted model of the arm to start from; None for none.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, or the arm as
            described does not fit the readings at all.
    """
    if prior is not None:  # effects of it may need to know from where a joint arrived
        every, _ = with_arrivals(every)
    single = every.of_kind("grid")
    grid, held_out = average_repeats(single), average_repeats(every.of_kind("holdout"))
    case = COMBINED if load == "general" else load
    return work_out_general(
        arm,
        grid,
        held_out if len(held_out) else None,
        rows_of_load(grid.states.load_N, case),
        start,
        load,
        campaign.payload(arm),
        options,
        readings=single.take(rows_of_load(single.states.load_N, case)),
        findings=findings,
        suspects=partial(suspected_held_out, every),
        prior=prior,
    )
