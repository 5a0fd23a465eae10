"""What a fitted model predicts, and what it was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array

if TYPE_CHECKING:
    from pa10cal.fit.angles_seen import AnglesSeen
    from pa10cal.fit.fitted_model import FittedModel


@dataclass(frozen=True)
class Suspicion:
    """Something in the input that is probably wrong, as the calibration found it."""

    kind: str  # a word of the table in `docs/raw-data.md`
    where: str  # column, joint, parameter, pose or file
    what: str  # what it is, one clause
    remedy: str  # what to do about it
    # root mean square position error if it were put right; None if not tried
    would_leave_mm: float | None = None


@dataclass(frozen=True)
class FittedTo:
    """What a model was fitted to."""

    campaign: str  # name of the campaign, or of the group of campaigns
    provenance: str  # where its data come from, in the campaign's own words
    calibration: str  # load case: `combined`, `general`, or a load such as `44N`
    instrument: str  # kind of the instrument
    poses: int  # poses fitted
    temperature_C: float  # their mean temperature; nan where it was not logged
    time_s: tuple[float, float]  # (2,) first and last of their times
    # how good the calibration is: `good`, `few_poses`, `incomplete`, `suspect_input` or
    # `not_converged`; empty where that is not known
    grade: str = ""
    health: str = ""  # the reason, and what to do, in one sentence
    suspicions: tuple[Suspicion, ...] = ()  # what is probably wrong in the input
    # external loads of the poses, each once; empty where that is not known
    loads_N: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where a fitted model puts a frame of the robot in N poses."""

    T: Array  # (N, 4, 4) the frame in the robot's base frame [m]
    # (N,) standard uncertainty of its position, from the noise of the measurement, the base being
    # where the fit puts it; nan where the model's covariance is not known
    u_mm: Array
    inside: NDArray[np.bool_]  # (N,) whether all joint angles were seen by the fit

    def __len__(self) -> int:
        return len(self.T)

    def _repr_html_(self) -> str:
        """Return the places as a notebook shows them."""
        places = dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * self.T[:, :3, 3].T, strict=True))
        return _table({**places, "u_mm": self.u_mm, "inside": self.inside})

    def with_others(self, rows: NDArray[np.bool_], T: Array) -> Prediction:
        """Return the prediction with other frames T (N, 4, 4) in some of the poses (N,).

        How far they are from those that stood there becomes part of the uncertainty.
        """
        moved_mm = 1e3 * np.linalg.norm(T[:, :3, 3] - self.T[:, :3, 3], axis=1)
        return Prediction(
            np.where(rows[:, None, None], T, self.T),
            np.where(rows, np.hypot(self.u_mm, moved_mm), self.u_mm),
            self.inside & ~rows,
        )


@dataclass(frozen=True, eq=False)
class FallBack:
    """What a model falls back to outside the joint positions in which its effects hold."""

    within: AnglesSeen  # joint positions in which they hold
    # the model without them, of the same arm and measured by the same instrument
    model: FittedModel


#: What became of a target: its pose is reached; by joint positions beyond their limits; not at all;
#: or where some direction takes large motions of the joints.
Status = Literal["ok", "outside_limits", "unreachable", "near_singular"]


@dataclass(frozen=True, eq=False)
class Compensation:
    """Joint positions that bring a frame of the robot to N poses, by its model."""

    # (N, n) joint positions to command [rad, m]; of an unreachable pose those that come nearest
    q: Array
    status: NDArray[np.str_]  # (N,) one of `Status`
    error_mm: Array  # (N,) distance of the model's position there from the one wanted
    error_deg: Array  # (N,) angle between the model's attitude there and the one wanted
    u_mm: Array  # (N,) standard uncertainty of the position, as of a prediction
    inside: NDArray[np.bool_]  # (N,) whether all joint angles were seen by the fit

    def __len__(self) -> int:
        return len(self.q)

    def _repr_html_(self) -> str:
        """Return the joint positions [rad, m] as a notebook shows them."""
        joints = {f"q{joint}": values for joint, values in enumerate(self.q.T, start=1)}
        shown = {"status": self.status, "error_mm": self.error_mm, "u_mm": self.u_mm}
        return _table({**joints, **shown, "inside": self.inside})


def _table(columns: dict[str, NDArray[Any]]) -> str:
    import pandas as pd  # late: a prediction needs none

    html: str = pd.DataFrame(columns).to_html(max_rows=20)
    return html
