"""The calibration of a campaign in memory: one load case, by the paper's model or the general."""

from __future__ import annotations

from pa10cal.arm.description import Arm
from pa10cal.calibration.general.calibrate import start_of
from pa10cal.calibration.general.case import general_case
from pa10cal.calibration.health import OF_JOINTS
from pa10cal.calibration.input_checks import check_input, explained
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions, takes_general_model
from pa10cal.calibration.paper import paper_case
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.seed import locate_base
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import BaseFrameRecord, CalibrationRecord


def located_base(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    options: BaseFrameOptions,
    where: str,
) -> BaseFrameRecord:
    """Find base frame and targets of a campaign, as `locate_base` does.

    Raises:
        CalibrationError: as there. Straight moves that seem to go another way are refused with what
            is wrong in the log of the joints, such as a reversed sign, if the checks find that.
    """
    try:
        return locate_base(every, arm, options, where, campaign.name, campaign.provenance)
    except CalibrationError as error:
        findings = check_input(campaign, arm, every, CalibrationOptions())
        of_joints = [each for each in findings if each.kind in (*OF_JOINTS, "joint_zero")]
        raise explained(error, of_joints) from None


def calibrated_record(
    case: LoadCase, base_frame: BaseFrameOptions | None = None
) -> CalibrationRecord:
    """Locate base and targets of a campaign, and calibrate a load case, as the stages do.

    Args:
        base_frame: what straight moves must satisfy; None for the defaults.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, or the arm as
            described does not fit the readings at all.
    """
    campaign = case.campaign
    general = takes_general_model(
        case.options.model, robot=case.arm.name, from_touches=campaign.from_touches
    )
    about = base_frame or BaseFrameOptions(), campaign.name, campaign.name, campaign.provenance
    seed = locate_base(case.every, case.arm, *about)
    return calibration_record(case, seed, general=general)


def calibration_record(
    case: LoadCase, seed: BaseFrameRecord, *, general: bool
) -> CalibrationRecord:
    """Calibrate a load case, and return its record.

    Args:
        general: whether with all that can be identified, or with the paper's unknowns.

    Raises:
        CalibrationError: see `paper_case` and `general_case`.
    """
    if general:
        return general_case(case, start_of(seed, case.every.measured))[0]
    refuse_prior(case.prior)
    return paper_case(case, seed.T_instr_base)[0]


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
