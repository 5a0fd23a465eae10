"""An instrument that gives positions of one or more targets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.csv_rows import RawRows
from pa10cal.campaign.length_unit import scale_of_points
from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.campaign.outliers import Misfit
from pa10cal.campaign.pose_rows import MeasuredColumns, PoseRows
from pa10cal.frame.hand_eye import hand_eye_from_points

Array = NDArray[np.float64]

AXES = "xyz"
NONE_SEEN = "no target was seen"
#: The name of a target may be any word but the `u` of an uncertainty.
_COORDINATE = re.compile(r"(?!u_)([A-Za-z0-9]+)_[xyz]_mm")


@dataclass(frozen=True)
class PointTracker:
    """A tracker of positions.

    Attributes:
        names: (B,) names of its targets.
        stated_mm: stated places of targets in the end-effector frame, by name.
        uncertainty_mm: standard uncertainty of a coordinate that states none.
    """

    names: tuple[str, ...]
    stated_mm: dict[str, tuple[float, float, float]]
    uncertainty_mm: float

    @property
    def columns(self) -> MeasuredColumns:
        """Three coordinates a target, blank where it was not seen."""
        names = tuple(name for target in self.targets for name in target)
        return MeasuredColumns(names, names, may_be_blank=True, checked=self._with_targets)

    @property
    def targets(self) -> tuple[tuple[str, ...], ...]:
        """The coordinates of every target."""
        return tuple(tuple(f"{name}_{axis}_mm" for axis in AXES) for name in self.names)

    @property
    def notes(self) -> tuple[str, ...]:
        """Say where stated places and columns are not of the same targets."""
        unstated = sorted(set(self.names) - set(self.stated_mm))
        absent = sorted(set(self.stated_mm) - set(self.names))
        notes = []
        if absent:
            notes.append(f"no columns of {', '.join(absent)}, which tool.balls_mm places")
        if unstated and self.stated_mm:
            notes.append(
                f"tool.balls_mm does not place {', '.join(unstated)}: all targets count as unplaced"
            )
        return tuple(notes)

    @property
    def least_rows(self) -> int:
        """Four times those that fix base and one target."""
        return 12

    def places_mm(self, rows: PoseRows) -> Array:
        """Return the targets' positions, (N, B, 3), nan where not seen."""
        return rows.measured.reshape(len(rows), len(self.names), 3)

    def scale(self, rows: PoseRows, T_base_ee: Array) -> float | None:
        """Return how far the model moves for a measured millimetre of the target seen most."""
        places = self.places_mm(rows)
        seen = np.isfinite(places[..., 0])
        best = int(seen.sum(axis=0).argmax())
        return scale_of_points(places[seen[:, best], best], T_base_ee[seen[:, best]])

    def misfit(
        self, rows: PoseRows, T_base_ee: Array, used: NDArray[np.intp], weights: Array
    ) -> Misfit:
        """Return the misfit of the positions."""
        p_instr_m = 1e-3 * self.places_mm(rows)
        found = hand_eye_from_points(T_base_ee[used], p_instr_m[used], weights=weights)
        off_m = p_instr_m - found.targets(T_base_ee)[..., :3, 3]
        return Misfit(1e3 * np.linalg.norm(off_m, axis=2), np.zeros(len(rows)))

    def with_seen(self, poses: MeasuredPoses, rows: PoseRows) -> MeasuredPoses:
        """Add the targets' positions and their covariances."""
        p_mm = self.places_mm(rows)
        u_mm = rows.measured_u.reshape(p_mm.shape)
        u_mm = np.where(np.isnan(u_mm), self.uncertainty_mm, u_mm)
        u_mm[np.isnan(p_mm)] = np.nan
        return replace(
            poses,
            ball_names=self.names,
            p_instr_balls_mm=p_mm,
            cov_balls_mm2=u_mm[..., None] ** 2 * np.eye(3),
            ball_touches=np.zeros(p_mm.shape[:2], dtype=np.int64),
        )

    def _with_targets(self, raw: RawRows) -> RawRows:
        """Leave out rows in which a target has some of its coordinates only, or none was seen."""
        columns = [raw.columns[name] == "" for name in self.columns.names]
        shape = (len(raw.line), len(self.names), 3)
        blanks = np.stack(columns, axis=1).reshape(shape).sum(axis=2)
        torn = (blanks > 0) & (blanks < 3)
        lost = np.asarray(torn.any(axis=1), dtype=bool)
        values = [", ".join(self.targets[b]) for b in torn[lost].argmax(axis=1)]
        raw = raw.take(~lost, "a target with some of its coordinates only", values)
        unseen = np.asarray((blanks[~lost] == 3).all(axis=1), dtype=bool)
        return raw.take(~unseen, NONE_SEEN, [""] * int(unseen.sum()))


def target_names(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the targets that a file has columns of, in the order of the columns.

    A file without any is taken to lack those of the target `T1`.
    """
    found = (_COORDINATE.fullmatch(name) for name in columns)
    return tuple(dict.fromkeys(match.group(1) for match in found if match)) or ("T1",)
