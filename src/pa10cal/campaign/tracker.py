"""What the reading of a campaign needs to know of an instrument that touches nothing."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.campaign.outliers import Misfit
from pa10cal.campaign.pose_rows import MeasuredColumns, PoseRows

Array = NDArray[np.float64]


class Tracker(Protocol):
    """An instrument that gives one row a configuration."""

    @property
    def columns(self) -> MeasuredColumns:
        """The columns that it measures."""

    @property
    def targets(self) -> tuple[tuple[str, ...], ...]:
        """The columns that place each of its B targets: three coordinates, or one distance."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader should know of its columns, one clause each."""

    @property
    def least_rows(self) -> int:
        """Rows from which one of them can be told to be astray."""

    def places_mm(self, rows: PoseRows) -> Array:
        """Return where every target was seen, (N, B, 3), or how far, (N, B, 1); nan where not."""

    def scale(self, rows: PoseRows, T_base_ee: Array) -> float | None:
        """Return how far the nominal model moves for one measured millimetre; see `length_unit`."""

    def misfit(
        self, rows: PoseRows, T_base_ee: Array, used: NDArray[np.intp], weights: Array
    ) -> Misfit:
        """Fit the nominal model to some rows, and return how far every row is from it.

        Args:
            rows: N rows.
            T_base_ee: (N, 4, 4) nominal end-effector [m].
            used: rows to fit.
            weights: weight of the squared residuals of each.

        Raises:
            CalibrationError: when these rows do not tell a frame.
        """

    def with_seen(self, poses: MeasuredPoses, rows: PoseRows) -> MeasuredPoses:
        """Add what was seen to configurations that hold all but that."""
