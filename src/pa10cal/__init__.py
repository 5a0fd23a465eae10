"""Geometric and flexibility calibration of serial robot arms, from raw logs to figures.

    import pa10cal

    campaign = pa10cal.read_campaign("data/raw/cell-a")
    model = pa10cal.calibrate(campaign)
    verdict = pa10cal.discover(campaign, model)
    verdict.model.save("model.yaml")

Names are imported when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pa10cal.campaign.read import Campaign as Campaign
    from pa10cal.discovery.verdict import Verdict as Verdict
    from pa10cal.errors import Pa10calError as Pa10calError
    from pa10cal.files.arms import load_arm as load_arm
    from pa10cal.fit.fitted import Compensation as Compensation
    from pa10cal.fit.fitted import Prediction as Prediction
    from pa10cal.fit.fitted_model import FittedModel as FittedModel
    from pa10cal.fit.model_reading import load_model as load_model
    from pa10cal.interface import calibrate as calibrate
    from pa10cal.interface import compare as compare
    from pa10cal.interface import discover as discover
    from pa10cal.interface import plan as plan
    from pa10cal.interface import read_campaign as read_campaign
    from pa10cal.interface import read_group as read_group
    from pa10cal.interface import report as report
    from pa10cal.pose_plan.options import PlanOptions as PlanOptions
    from pa10cal.pose_plan.plan import PosePlan as PosePlan

__version__ = "0.2.0"

#: Public names, in the order in which they are used, and the modules they stand in.
_HOMES = {
    "plan": "pa10cal.interface",
    "read_campaign": "pa10cal.interface",
    "read_group": "pa10cal.interface",
    "load_arm": "pa10cal.files.arms",
    "calibrate": "pa10cal.interface",
    "discover": "pa10cal.interface",
    "load_model": "pa10cal.fit.model_reading",
    "compare": "pa10cal.interface",
    "report": "pa10cal.interface",
    "PlanOptions": "pa10cal.pose_plan.options",
    "PosePlan": "pa10cal.pose_plan.plan",
    "Campaign": "pa10cal.campaign.read",
    "FittedModel": "pa10cal.fit.fitted_model",
    "Prediction": "pa10cal.fit.fitted",
    "Compensation": "pa10cal.fit.fitted",
    "Verdict": "pa10cal.discovery.verdict",
    "Pa10calError": "pa10cal.errors",
}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'pa10cal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
