"""Effects as each campaign of a group alone has them, for `discovery/verdict.json`."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from pa10cal.discovery.blocked_cv.alone import ByCampaign, Pair, by_campaign
from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
from pa10cal.discovery.verdict import Verdict
from pa10cal.results.group import CampaignsAgree, EffectByCampaign, JointErrorAlone, ParameterAlone


def by_campaign_part(found: Verdict[object]) -> tuple[EffectByCampaign, ...] | None:
    """Return every effect of a verdict as each campaign of a group has it; None without any."""
    if not isinstance(found, VerdictByBlocks):
        return None
    return tuple(map(_part, by_campaign(found.survey, found.extended))) or None


def _part(each: ByCampaign) -> EffectByCampaign:
    return EffectByCampaign(
        id=each.effect.id,
        of=each.effect.of,
        parameters=None
        if each.curves
        else {
            name: {
                parameter.name: ParameterAlone(value=float(value), std=float(std))
                for parameter, value, std in zip(
                    report.parameters,
                    report.values,
                    np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T)),
                    strict=True,
                )
            }
            for name, (report, covariance) in each.reports.items()
        },
        errors={
            name: JointErrorAlone(error_mrad=1e3 * curve.error_rad, visited=curve.visited)
            for name, curve in each.curves.items()
        }
        or None,
        agreement=tuple(map(_agreement, each.pairs)),
    )


def _agreement(pair: Pair) -> CampaignsAgree:
    known = bool(np.isfinite(pair.correlation))
    found = asdict(pair) if known else dict.fromkeys(asdict(pair))
    return CampaignsAgree(
        first=pair.first,
        second=pair.second,
        correlation=found["correlation"],
        correlation95=found["correlation95"],
        slope=found["slope"],
        slope95=found["slope95"],
        first_rms_mrad=1e3 * pair.rms_rad[0] if known else None,
        second_rms_mrad=1e3 * pair.rms_rad[1] if known else None,
        difference_rms_mrad=1e3 * pair.difference_rad if known else None,
        share_of_turn=pair.share,
    )
