"""Whether campaigns of a group contradict each other, which one, and by what cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pa10cal.calibration.general.per_campaign import RANGE_CONSTANT, SCALE, TOOL_MASS, by_chance
from pa10cal.calibration.rules import GROUPS
from pa10cal.results import calibration as records
from pa10cal.results.calibration import SEVERAL_CAUSES, InputFinding
from pa10cal.terms.statement_faults import ToolStated

#: Unit in which a parameter is shown, and the factor to it (unit).
_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "1": ("ppm", 1e6)}
#: Larger errors of an instrument would not go unnoticed: they stand for something else.
_MOST = {SCALE: GROUPS.most_scale, RANGE_CONSTANT: GROUPS.most_range_m}


def contradictions(
    group: records.GroupOfCampaigns, zeros: Mapping[str, int]
) -> tuple[InputFinding, ...]:
    """Return which campaign contradicts the others, by which cause and by how much.

    Only the campaign with the largest chi-square is reported: if the arm was changed before one
    campaign, each of the others contradicts the rest too, as that campaign is among it. Causes that
    explain about as much are told together, the likeliest first.

    Args:
        zeros: joints, from 1, by the names of the parameters that are their zeros.
    """
    campaigns = group.campaigns
    found = {name: each for name, each in campaigns.items() if each.contradicts}
    if not found:
        return ()
    first = max(found, key=lambda name: found[name].chi_square)
    alone, likely = found[first], _likely_causes(group, first)
    if likely[0].differs.chi_square < GROUPS.mostly_share * alone.chi_square:
        place = _Place(first, SEVERAL_CAUSES)
        what = f"no single cause explains most of it; nearest is that {likely[0].words}"
        remedy = (
            "calibrate the campaigns apart, and compare them: several parameters were changed, or "
            "the model lacks an effect of what differs between them, such as loads and poses"
        )
    else:
        place = likely[0].place(zeros)
        what, remedy = _by_causes(likely, _Cause(first, alone.worst), alone)
    also = [name for name in found if name != first]
    if len(campaigns) > 2 and also:
        also_in = ", ".join(also)
        what += f"; also against the others, perhaps only because of {first}: {also_in}"
    others = " and ".join(name for name in campaigns if name != first)
    squares = [own.rms_mm**2 for own in campaigns.values()]
    rms_mm = np.sqrt(np.average(squares, weights=[own.poses for own in campaigns.values()]))
    return (
        InputFinding(
            what=f"{first} and {others} contradict each other (chi-square {alone.chi_square:.0f} "
            f"for {alone.dof:.0f} degrees of freedom, {rms_mm:.3g} mm rms): {what}",
            where=place.where,
            remedy=remedy,
            kind=place.kind,
            joint=place.joint,
            between_campaigns=True,
        ),
    )


class _Cause(NamedTuple):
    """What may make a campaign differ: a change of the arm, its instrument, or its tool."""

    campaign: str
    differs: records.Difference  # by how much it differs, and what that explains

    @property
    def words(self) -> str:
        """Return it as a clause with its size and what it explains."""
        name, value = self.differs.name, self.differs.value
        unit, scale = _SHOWN_UNITS.get(self.differs.unit, (self.differs.unit, 1.0))
        size = f"{scale * abs(value):.3g} ± {scale * self.differs.std:.2g} {unit}"
        sign = "-" if value < 0.0 else "+"
        long = "long" if value > 0.0 else "short"
        if name == SCALE:
            clause = f"{self.campaign} reads all lengths {size} too {long} against the others"
        elif name == RANGE_CONSTANT:
            clause = f"{self.campaign} reads all distances from the instrument {size} too {long}"
        elif name == TOOL_MASS:
            more = "more" if value > 0.0 else "less"
            clause = f"the tool of {self.campaign} weighs {size} {more} than stated"
        else:
            clause = f"the arm was changed between them, {name} by {sign}{size} in {self.campaign}"
        explains = f"explains {self.differs.chi_square:.0f} of it"
        if self.differs.left_mm is not None:
            explains += f", leaves {self.differs.left_mm:.3g} mm rms"
        return f"{clause} ({explains})"

    @property
    def remedy(self) -> str:
        """Return what to do if it is that."""
        name, value = self.campaign, self.differs.value
        if self.differs.name == SCALE:
            return (
                "measure one known length with either instrument, to know which scale is wrong; "
                f"the positions of {name} divided by {1.0 + value:.6f} agree with the others "
                "(calibrated apart, one model would have all its lengths wrong by that)"
            )
        if self.differs.name == RANGE_CONSTANT:
            correct = "shorten" if value > 0.0 else "lengthen"
            return (
                f"check the constant of the reflector and the zero of the distance in {name}: "
                f"{correct} its distances by {1e3 * abs(value):.3g} mm, or leave {name} out"
            )
        if self.differs.name == TOOL_MASS:
            return f"weigh the tool of {name}, and correct tool.mass_kg in its campaign.yaml"
        return "calibrate the campaigns before and after the change apart, and compare them"

    def place(self, zeros: Mapping[str, int]) -> _Place:
        """Return where it is and its kind; see `contradictions`."""
        name = self.differs.name
        if name in _MOST:
            return _Place(f"{self.campaign}: the measured positions", name)
        if name == TOOL_MASS:
            # as the same fault in a single campaign
            return _Place(f"{self.campaign}: tool.mass_kg", ToolStated.kind)
        joint = zeros.get(name)
        return _Place(name, "campaigns" if joint is None else "joint_zero", joint)


class _Place(NamedTuple):
    """Where a finding is, and of which kind."""

    where: str
    kind: str
    joint: int | None = None


def _by_causes(
    likely: Sequence[_Cause], arm: _Cause, alone: records.CampaignAlone
) -> tuple[str, str]:
    """Return what likely causes of a campaign's difference are, and what to do about them.

    `arm` is a change of the arm, likely or not.
    """
    what = " or ".join(cause.words for cause in likely)
    if arm not in likely:
        what += f"; less likely {arm.words}"
    remedy = "; or ".join(dict.fromkeys(cause.remedy for cause in likely))
    left = max(alone.chi_square - likely[0].differs.chi_square, 0.0)
    if by_chance(left, max(alone.dof - 1.0, 1.0)) < GROUPS.chance_rate:
        what += "; more than that differs"
        remedy += "; unless the verdict has effects that explain it"
    return what, remedy


def _likely_causes(group: records.GroupOfCampaigns, first: str) -> list[_Cause]:
    """Return what explains that a campaign differs, the likeliest first, with what does as well."""
    # Of two campaigns each differs from the other by the same: the cause may be in either.
    names = tuple(group.campaigns) if len(group.campaigns) == 2 else (first,)
    causes = [_Cause(first, group.campaigns[first].worst)]
    for name in names:
        own = group.campaigns[name].instrument
        causes += [_Cause(name, each) for each in own if abs(each.value) < _MOST[each.name]]
        tool = group.campaigns[name].tool
        causes += [] if tool is None else [_Cause(name, tool)]
    causes.sort(key=lambda cause: -cause.differs.chi_square)
    least = causes[0].differs.chi_square - 2.0 * GROUPS.as_well_nats
    likely = [cause for cause in causes if cause.differs.chi_square >= least]
    # The scale of one of two is against that of the other: both say the same.
    scales = [cause for cause in likely if cause.differs.name == SCALE]
    return [cause for cause in likely if cause not in scales[1:]]
