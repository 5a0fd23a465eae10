"""The search for missing effects: which scorer judges a campaign, and its verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pa10cal.discovery.blocked_cv.survey import enough
from pa10cal.discovery.noise import LEAST_DIFFERENCES, LEAST_REPEATED, repeated
from pa10cal.discovery.preparation import MeasurementSetup, prepared

if TYPE_CHECKING:
    from pa10cal.discovery.verdict import Verdict
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.observe.observations import Observations


def discover(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
) -> Verdict[object]:
    """Find which effects are missing from a calibrated model.

    Held-out poses serve nothing but the gap.

    Args:
        every: single readings of a campaign, of all kinds, with the instrument's covariance.
        model: the calibrated model.
        setup: what is known of the campaign besides its readings, and the options of the search.

    Raises:
        DiscoveryError: when there are too few poses, or too little is repeated.
        CalibrationError: when a joint with a spring has no torque.
    """
    campaign = prepared(every, model, setup)
    if judged_by_blocks(campaign.readings):
        from pa10cal.discovery.blocked_cv.discover import discover_by_blocks

        return discover_by_blocks(campaign, setup.options.error_rate)
    from pa10cal.discovery.evidence.discover import discover_by_repeats

    return discover_by_repeats(campaign, setup.options.error_rate)


def judged_by_blocks(readings: Observations) -> bool:
    """Return whether effects are judged by blocks of poses held out, and not by repeats.

    Args:
        readings: single readings of the poses fitted.
    """
    repeats = repeated(readings)
    return enough(len(readings)) and repeats < max(
        LEAST_DIFFERENCES, LEAST_REPEATED * len(readings)
    )
