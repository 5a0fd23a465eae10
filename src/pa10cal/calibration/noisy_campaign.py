"""The campaign of a group that is noisier than it states, where the others are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.rules import GRADES
from pa10cal.fit.position_errors import position_noise_mm
from pa10cal.observe.observations import Observations


@dataclass(frozen=True)
class NoisyCampaign:
    """The campaign of a group whose error exceeds its noise by more than the others' does."""

    name: str
    error_mm: float  # rms error of its poses
    noise_mm: float  # the same that its stated noise makes
    others_mm: float  # rms error of the poses of the other campaigns
    others_noise_mm: float  # the same that their stated noise makes

    def __str__(self) -> str:
        return (
            f"{self.name} alone is noisier than stated: {self.error_mm:.3f} mm rms beside a noise "
            f"of {self.noise_mm:.3f} mm, the others {self.others_mm:.3f} mm beside "
            f"{self.others_noise_mm:.3f} mm; check there the resolution of the joints' log, the "
            "instrument, and how tool and targets are fixed"
        )


def noisy_campaign(poses: Observations, error_mm: Array, covariance: Array) -> NoisyCampaign | None:
    """Return the campaign of a group that alone is noisier than stated; None for none.

    Args:
        poses: P poses, of a group or not.
        error_mm: (P,) their position errors.
        covariance: (P, b, b) of their readings, as stated.
    """
    excess: dict[str, tuple[float, NoisyCampaign]] = {}
    campaign = np.asarray(poses.states.campaign)
    for number, (name, _) in enumerate(poses.measured.campaigns):
        own: Mask = campaign == number
        if not 0 < own.sum() < len(own):
            continue
        (error, noise, u), (others, others_noise, u_others) = (
            _mean_squares(poses.take(rows), error_mm[rows], covariance[rows])
            for rows in (own, ~own)
        )
        # what it would be if it exceeded its noise by as much as the others do theirs
        expected = noise + max(others - others_noise, 0.0)
        more = error - expected
        surely = more > GRADES.chance_errors * np.hypot(u, u_others)
        if surely and error > GRADES.over_noise**2 * expected:
            roots = np.sqrt([error, noise, others, others_noise]).tolist()
            excess[name] = more, NoisyCampaign(name, *roots)
    return max(excess.values(), key=lambda found: found[0])[1] if excess else None


def _mean_squares(
    poses: Observations, error_mm: Array, covariance: Array
) -> tuple[float, float, float]:
    """Return mean squared errors [mm²]: as found, of noise, and the uncertainty of the first.

    Errors of all targets in a pose may be one error of the arm: they count as one position.
    """
    found = float(np.mean(error_mm**2))
    seen = poses.measured.components_seen[:, poses.measured.position_columns].sum(axis=1)
    count = float(np.minimum(seen, 3).sum())
    noise_mm = position_noise_mm(poses.measured, covariance)
    return found, noise_mm**2, found * float(np.sqrt(2.0 / max(count, 1.0)))
