"""An instrument that gives the distance of one target from a fixed point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.csv_rows import RawRows, numbers
from pa10cal.campaign.length_unit import scale_of_distances
from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.campaign.outliers import Misfit
from pa10cal.campaign.pose_rows import MeasuredColumns, PoseRows
from pa10cal.frame.ranging import range_from_distances

Array = NDArray[np.float64]

DISTANCE = ("d_mm",)
NOT_POSITIVE = "the distance is not above zero"


@dataclass(frozen=True)
class DistanceTracker:
    """A distance meter.

    Attributes:
        uncertainty_mm: standard uncertainty of a distance that states none.
    """

    uncertainty_mm: float

    @property
    def columns(self) -> MeasuredColumns:
        """The distance."""
        return MeasuredColumns(DISTANCE, DISTANCE, may_be_blank=False, checked=_above_zero)

    @property
    def targets(self) -> tuple[tuple[str, ...], ...]:
        """The one distance."""
        return (DISTANCE,)

    @property
    def notes(self) -> tuple[str, ...]:
        """None."""
        return ()

    @property
    def least_rows(self) -> int:
        """Four times those that fix point and target."""
        return 24

    def places_mm(self, rows: PoseRows) -> Array:
        """Return the distance, (N, 1, 1)."""
        return rows.measured[:, None]

    def scale(self, rows: PoseRows, T_base_ee: Array) -> float | None:
        """Return how far the nominal model moves for one measured millimetre."""
        return scale_of_distances(rows.measured[:, 0], T_base_ee)

    def misfit(
        self, rows: PoseRows, T_base_ee: Array, used: NDArray[np.intp], weights: Array
    ) -> Misfit:
        """Return the misfit of the distances."""
        d_m = 1e-3 * rows.measured[:, 0]
        found = range_from_distances(T_base_ee[used], d_m[used], weights=weights)
        off_mm = 1e3 * np.abs(d_m - found.distances(T_base_ee))
        return Misfit(off_mm[:, None], np.zeros(len(rows)))

    def with_seen(self, poses: MeasuredPoses, rows: PoseRows) -> MeasuredPoses:
        """Add the distances and their uncertainties."""
        u_mm = rows.measured_u[:, 0]
        u_mm = np.where(np.isnan(u_mm), self.uncertainty_mm, u_mm)
        return replace(poses, d_mm=rows.measured[:, 0], d_u_mm=u_mm)


def _above_zero(raw: RawRows) -> RawRows:
    _, distance = numbers(raw, DISTANCE)
    keep = distance[:, 0] > 0.0
    return raw.take(keep, NOT_POSITIVE, [f"d_mm = {value:g}" for value in distance[~keep, 0]])
