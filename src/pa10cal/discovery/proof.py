"""The statistics that decide about an effect, and what they say of causes that were not tried."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import override

from pa10cal.arrays import Array
from pa10cal.discovery.rules import JUDGING, PROBABILITIES
from pa10cal.results import discovery
from pa10cal.results.arrays import Numbers
from pa10cal.results.record import Part


def needed_nats(effect_count: int, error_rate: float) -> float:
    """Return the gain in log evidence that a name needs where so many effects are sought.

    If none of them is present, the probability that any reaches it is at most the error rate.
    """
    return float(np.log(max(effect_count, 1) / error_rate))


def most_influential_pose(
    labels: NDArray[np.str_], evidence_without: Array, evidence: float, needed: float
) -> str | None:
    """Return the pose on which alone the evidence of a name rests; None for none.

    Args:
        labels: (P,) poses.
        evidence_without: (P,) evidence that remains without each pose, in any unit.
        evidence: that of all poses, in the same unit.
        needed: what a name needs, in that unit too.
    """
    pose = int(evidence_without.argmin())
    rests_on_it = evidence_without[pose] < min(needed, JUDGING.carried_share * evidence)
    return str(labels[pose]) if rests_on_it else None


@dataclass(frozen=True)
class UnknownCause:
    """Model of the probability that the cause of an effect found is one that was not tried.

    The squared error that remains beyond noise has an unknown cause. An effect that removes little
    compared with it may be a part of it; and the larger it is, the more often it looks like an
    effect elsewhere. The odds of the effect are
    odds * (removed / remaining)^power / (remaining / noise)^fall.

    What remains counts as at least `left_of_noise` of the noise and, over noise, as at most
    `most_left_of_noise`; the probability is at least `unknown` (rules, PROBABILITIES). Without
    noise remaining / noise is 1.
    """

    without_mm: float  # root mean square error without the effect [mm]
    with_mm: float  # and with it [mm]
    _: KW_ONLY
    odds: float  # odds of an effect that removes as much as remains
    power: float
    fall: float = 0.0
    # removed over remaining squares of all whitened readings, orientations included; the larger of
    # this ratio and that of positions counts
    ratio_of_readings: float = 0.0

    def probability(self, noise_rms_mm: float) -> float:
        """Return that probability, by the root mean square error that noise alone leaves [mm]."""
        noise, squares_with = noise_rms_mm**2, self.with_mm**2
        of_positions = removed_over_remaining(self.without_mm**2, squares_with, noise)
        ratio, over_noise = max(of_positions, self.ratio_of_readings), 1.0
        if noise > 0.0:
            over_noise = min(_beyond(squares_with, noise) / noise, PROBABILITIES.most_left_of_noise)
        odds = self.odds * ratio**self.power / over_noise**self.fall
        return float(max(1.0 / (1.0 + odds), PROBABILITIES.unknown))


def removed_over_remaining(squares_without: float, squares_with: float, noise: float) -> float:
    """Return the squares that an effect removes over those that remain beyond noise.

    It is 0 where nothing is removed, even if nothing remains.

    Args:
        squares_without: sum or mean of squared errors without the effect.
        squares_with: the same with it.
        noise: the same of noise alone.
    """
    removed, remaining = max(squares_without - squares_with, 0.0), _beyond(squares_with, noise)
    if removed == 0.0:
        return 0.0
    return removed / remaining if remaining > 0.0 else np.inf


def _beyond(squares: float, noise: float) -> float:
    """Return squares less those of noise, but at least a small part of the latter."""
    return max(squares - noise, PROBABILITIES.left_of_noise * noise)


class Proof(Part):
    """The statistics that decided about an effect."""

    # the pose without which less than half of the evidence remains, and too little for a name, as
    # if a gross error caused it; None where there is no such pose
    influential_pose: str | None = Field(default=None, exclude=True)
    # source of the weights under which a joint gives way; None for all other effects
    weights: Literal["assumed", "total", "logged"] | None = Field(default=None, exclude=True)

    @property
    def explains(self) -> float | None:
        """Part of the squared error of held-out poses that the effect explains, where known."""
        return None

    @property
    def unknown_cause(self) -> UnknownCause | None:
        """Model of the probability of an unknown cause; None where errors give none."""
        return None

    @property
    @abstractmethod
    def evidence(self) -> discovery.Evidence:
        """The statistics as written to the record."""


class ComplianceProof(discovery.EvidenceOfSag, Proof):
    """The statistics that decided about the spring of a joint."""

    # (P,) errors of the poses held out, or else fitted, with the joint rigid
    without_each_mm: Numbers = Field(exclude=True)
    # and with all joints rigid that were found compliant
    all_rigid_each_mm: Numbers = Field(exclude=True)

    @property
    @override
    def unknown_cause(self) -> UnknownCause:
        rigid_mm, compliant_mm = self.held_out_rigid_mm, self.held_out_gives_way_mm
        if rigid_mm is None or compliant_mm is None:
            rigid_mm, compliant_mm = self.rigid_mm, self.gives_way_mm
        odds, power = PROBABILITIES.known_sag
        return UnknownCause(rigid_mm, compliant_mm, odds=odds, power=power)

    @property
    @override
    def evidence(self) -> discovery.EvidenceOfSag:
        return self
