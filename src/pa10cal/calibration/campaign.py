"""The calibration of a campaign in memory: one load case, by the paper's model or the general."""

from __future__ import annotations

from pa10cal.arm.description import Arm
from pa10cal.calibration.general.calibrate import start_of
from pa10cal.calibration.general.case import general_case
from pa10cal.calibration.load_case import COMBINED, LoadCase
from pa10cal.calibration.options import CalibrationOptions, takes_general_model
from pa10cal.calibration.paper import paper_case
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.seed import locate_base
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import BaseFrameRecord, CalibrationRecord
from pa10cal.results.health import InputFinding


def calibrated_record(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    load: str = COMBINED,
    options: CalibrationOptions | None = None,
    findings: tuple[InputFinding, ...] = (),
    prior: FittedModel | None = None,
    base_frame: BaseFrameOptions | None = None,
) -> CalibrationRecord:
    """Locate base and targets of a campaign, and calibrate a load case, as the stages do.

    Args:
        base_frame: what straight moves must satisfy; None for the defaults.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, or the arm as
            described does not fit the readings at all.
    """
    options = options or CalibrationOptions()
    general = takes_general_model(options.model, from_touches=campaign.from_touches)
    lines, name = base_frame or BaseFrameOptions(), campaign.name
    seed = locate_base(every, arm, lines, name, name, campaign.provenance)
    return calibration_record(
        LoadCase(campaign, arm, every, load, options, findings, prior), seed, general=general
    )


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
