"""What the measurement itself scatters by: from poses that are all but the same, else as stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import ndtri

from pa10cal.discovery.evidence.judge import mean_length
from pa10cal.discovery.evidence.repeatability import LEAST_DIFFERENCES
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Poses closer than this in every joint count as the same [rad; m of a sliding joint].
NEARLY_SAME = 2e-3
_MEDIAN_TO_SIGMA = 1.0 / float(ndtri(0.75))


@dataclass(frozen=True)
class Noise:
    """Noise of single readings.

    Attributes:
        cov_ee: (P, 6, 6) covariance: position [m] and attitude [rad], along the instrument's axes.
        pairs: pairs of nearly equal poses behind it; 0 where it is what the instrument states.
    """

    cov_ee: Array
    pairs: int

    @property
    def floor_mm(self) -> float:
        """Return the mean position error that this noise alone leaves."""
        mean = self.cov_ee[:, :3, :3].mean(axis=0, keepdims=True)
        return float(1e3 * mean_length(mean)[0])


def noise_of(poses: Observations[Pose], residual: Array) -> Noise:
    """Find the noise of readings.

    What two nearly equal poses differ by, less what a model says of the difference, is noise; a
    wrong model says nearly the same of both. Each pose is in one pair at most; the median decides.

    Args:
        poses: P poses.
        residual: (P, 6) what a model leaves of them.
    """
    first, second = nearly_same(poses)
    if len(first) < LEAST_DIFFERENCES:
        return Noise(poses.measured.cov, 0)
    difference = np.abs(residual[first] - residual[second]) / np.sqrt(2.0)
    sizes = [_MEDIAN_TO_SIGMA * np.median(difference[:, k : k + 3]) for k in (0, 3)]
    one = np.diag(np.repeat(np.square(sizes), 3))
    return Noise(np.tile(one, (len(poses), 1, 1)), len(first))


def nearly_same(poses: Observations[Pose]) -> tuple[Index, Index]:
    """Return the poses of pairs that are nearly the same, the nearest first, each pose once."""
    states = poses.states
    keys = np.column_stack([states.q_rad, states.load_N])
    tree = cKDTree(keys)
    pairs = tree.query_pairs(NEARLY_SAME, p=np.inf, output_type="ndarray")
    apart = np.abs(keys[pairs[:, 0]] - keys[pairs[:, 1]]).max(axis=1, initial=0.0)
    taken = np.zeros(len(poses), dtype=bool)
    chosen = []
    for k in np.argsort(apart, kind="stable"):
        if not taken[pairs[k]].any():
            taken[pairs[k]] = True
            chosen.append(k)
    found = pairs[np.array(chosen, dtype=np.intp)]
    return found[:, 0], found[:, 1]
