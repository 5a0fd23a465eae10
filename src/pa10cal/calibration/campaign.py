"""The calibration of a campaign in memory: one load case, by the paper's model or the general."""

from __future__ import annotations

from dataclasses import replace

from pa10cal.arm.description import Arm
from pa10cal.calibration.general.calibrate import find_start, start_of
from pa10cal.calibration.general.case import fitted, general_case
from pa10cal.calibration.load_case import COMBINED, paper_case
from pa10cal.calibration.options import CalibrationOptions, takes_general_model
from pa10cal.calibration.uncertainty import align_nominal
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations, average_repeats, poses_of
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
    if takes_general_model(options.model, from_touches=campaign.from_touches):
        start = find_start(arm, average_repeats(every.of_kind("grid")))
        record, case = general_case(campaign, arm, every, start, load, options, findings, prior)
        model, used = fitted(case), case.problem.observations
        return replace(model, fitted_to=FittedTo.of(used, load, record.health, campaign))
    refuse_prior(prior)
    seed = align_nominal(nominal(arm), poses_of(every, "grid"))
    return paper_case(campaign, arm, every, seed, load, options, findings)[1]


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
        return general_case(campaign, arm, every, start, load, options, findings, prior)[0]
    refuse_prior(prior)
    return paper_case(campaign, arm, every, seed.T_instr_base, load, options, findings)[0]


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
