"""Noise of single readings, as every search for effects has it.

It is found from repeats (`repeats`), or from poses that are nearly the same (`near_poses`), or is
what the instrument states; to the last the noise of logged torques is added.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import torque_noise
from pa10cal.observe.observations import Observations


@dataclass(frozen=True)
class Noise:
    """Noise of single readings."""

    # (P, b, b) covariance of each reading's components: of a pose position [m] and small rotation
    # [rad], along the instrument's axes
    cov: Array
    differences: int  # pairs of readings behind it; 0 where it is what the instrument states
    pairs_are: str = ""  # what these pairs are, in words
    components_compared: int = 0  # of all pairs of repeats: those that both readings have
    # (n,) standard deviation of each joint's position; empty where not attributed to sources
    joint_rad: Array = field(default_factory=lambda: np.zeros(0))
    instrument: float = 1.0  # factor on the instrument's stated standard uncertainty
    # (n,) standard deviation of a reading's torques; nan where none is logged, zero where none
    # scatters, as in a log that was calculated
    torque_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # share of the variance of logged torques about those of the weights that is noise; the rest is
    # of forces that nobody stated
    torque_share: float = 1.0

    @property
    def origin(self) -> str:
        """Return where the noise is from, in words."""
        if self.differences:
            return f"{self.differences} {self.pairs_are}"
        scatter = " and the scatter of logged torques" * bool(np.any(self.torque_Nm > 0.0))
        return f"the instrument's stated uncertainty{scatter}: repeats do not show the noise"


def with_torque_noise(
    noise: Noise, residual: Array, at: FittedModel, poses: Observations, payload: Payload | None
) -> Noise:
    """Return stated noise plus what the noise of logged torques adds to it through the springs.

    Noise found from pairs of readings includes it already.

    Args:
        residual: (P, b) predicted less measured components, the springs carrying the logged
            torques.
        poses: P complete poses.
        payload: None where the masses are not known.
    """
    if noise.differences:
        return noise
    found = torque_noise(at, poses, payload, residual, noise.cov)
    if found is None:
        return noise
    cov = noise.cov + found.cov
    return replace(noise, cov=cov, torque_Nm=found.torque_Nm, torque_share=found.share)
