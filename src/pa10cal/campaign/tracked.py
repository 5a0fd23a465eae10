"""Rows of an instrument that touches nothing to measured configurations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.campaign.csv_rows import column_names
from pa10cal.campaign.description import Campaign
from pa10cal.campaign.distance_tracker import DistanceTracker
from pa10cal.campaign.grouping import configurations
from pa10cal.campaign.length_unit import refuse_wrong_length_unit
from pa10cal.campaign.measured import Ingested, MeasuredPoses
from pa10cal.campaign.options import IngestOptions
from pa10cal.campaign.outliers import (
    OFF_MODEL,
    OFF_REPEATS,
    OUT_OF_REACH,
    Mask,
    Misfit,
    off_model,
    off_repeats,
    out_of_reach,
    robust_misfit,
)
from pa10cal.campaign.plausibility import (
    OTHER_COMMAND,
    may_be_radians,
    off_command,
    refuse_wrong_angle_unit,
)
from pa10cal.campaign.point_tracker import PointTracker, target_names
from pa10cal.campaign.pose_rows import PoseRows, position_columns, read_pose_rows
from pa10cal.campaign.pose_tracker import PoseTracker
from pa10cal.campaign.quarantine import LeftOut, left_out, refuse_too_many
from pa10cal.campaign.tracker import Tracker
from pa10cal.errors import RawDataError

Array = NDArray[np.float64]

NO_TORQUES = "no torques logged: springs cannot be identified"
THOSE_OF_MASSES = "no torques logged: those of the described masses are used"
#: The nominal model fitted in another unit of joint positions must be this much nearer to count,
#: and as logged be further off than this.
BETTER = 5.0
BAD_MM = 2.0
#: Logged positions of sliding joints that never exceed the longest stroke in metres may be metres.
LONGEST_STROKE_M = 10.0
#: Median misfits of the nominal model, fitted, that are worth a warning.
WARN_MM = 50.0
WARN_DEG = 10.0


def poses_from_tracker(
    campaign: Campaign, arm: Arm, folder: Path, settings: IngestOptions
) -> Ingested:
    """Read a campaign of an instrument that gives poses, positions of targets, or distances.

    Args:
        campaign: its description.
        arm: the nominal arm.
        folder: its folder.
        settings: the `ingest` section.

    Returns:
        One entry a row: no approach (arrivals are 0) and no dwell; what was not logged is nan.

    Raises:
        RawDataError: when the file, or too much of it, cannot be used.
    """
    path = folder / str(campaign.files.poses)
    tracker = _tracker(campaign, path)
    rows, read = read_pose_rows(
        path, arm.prismatic, tracker.columns, kind_stated=campaign.holdout is None
    )
    totals, most = {read.file: read.total}, settings.max_quarantined_fraction
    listed = list(read.left_out)
    _, first = np.unique(configurations(rows), return_index=True)
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    listed += left_out(read.file, rows.line[again], "this configuration was read before")
    refuse_too_many(listed, totals, most)
    screened = _Screen(tracker, arm, path).of(rows.take(~again))
    listed += screened.left_out
    rows, q_rad = screened.rows, in_radians(screened.rows.q, arm)
    off = off_command(rows.pose, q_rad, arm.prismatic)
    listed += left_out(read.file, rows.line[off], OTHER_COMMAND, rows.pose[off])
    refuse_too_many(listed, totals, most)
    rows, q_rad = rows.take(~off), q_rad[~off]
    poses = tracker.with_seen(_unseen(rows, q_rad, arm), rows)
    notes = [*read.notes, *tracker.notes]
    if np.isnan(poses.tau_Nm).all():
        notes.append(NO_TORQUES if arm.mass_kg is None else THOSE_OF_MASSES)
    return Ingested(poses, tuple(listed), tuple(notes), screened.warnings)


def in_radians(q: Array, arm: Arm) -> Array:
    """Return logged joint positions (N, n) in radians; in metres of joints that slide."""
    return np.asarray(np.where(arm.prismatic, 1e-3 * q, np.radians(q)))


def _tracker(campaign: Campaign, path: Path) -> Tracker:
    kind, uncertainty_mm = campaign.instrument.kind, campaign.instrument.uncertainty_mm
    if kind == "points":
        names = target_names(column_names(path))
        return PointTracker(names, campaign.tool.balls_mm, uncertainty_mm)
    return DistanceTracker(uncertainty_mm) if kind == "distance" else PoseTracker(uncertainty_mm)


@dataclass(frozen=True)
class _Screened:
    """Rows that can be of their configuration, those left out, and what the reader is warned of."""

    rows: PoseRows
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Screen:
    """Refuses wrong units, and leaves out single readings that cannot be of their pose."""

    tracker: Tracker
    arm: Arm
    path: Path

    def of(self, rows: PoseRows) -> _Screened:
        """Screen rows."""
        far = self._each(rows, lambda p, _: out_of_reach(p, self.arm))
        rows, listed = self._without(rows, far, OUT_OF_REACH)
        self._refuse_units(rows)
        other = self._each(rows, lambda p, seen: off_repeats(p, rows.pose[seen], rows.load_N[seen]))
        rows, off = self._without(rows, other, OFF_REPEATS)
        listed += off
        misfit = self._misfit(rows, rows.q)
        if misfit is None:
            return _Screened(rows, listed, ())
        warnings = _poor_fit(misfit)
        rows, off = self._without(rows, off_model(misfit), OFF_MODEL)
        return _Screened(rows, listed + off, warnings)

    def _each(self, rows: PoseRows, judge: Callable[[Array, Mask], Mask]) -> Mask:
        """Judge the targets one by one, by where each was seen: (N, B)."""
        places = self.tracker.places_mm(rows)
        judged = np.zeros(places.shape[:2], dtype=bool)
        for b in range(places.shape[1]):
            seen = np.isfinite(places[:, b, 0])
            judged[seen, b] = judge(places[seen, b], seen)
        return judged

    def _without(
        self, rows: PoseRows, off: Mask, reason: str
    ) -> tuple[PoseRows, tuple[LeftOut, ...]]:
        """Leave out rows with a target (N, B) that is off, naming the first of them."""
        lost = np.flatnonzero(off.any(axis=1))
        places = self.tracker.places_mm(rows)
        values = []
        for row, b in zip(lost, off[lost].argmax(axis=1), strict=True):
            numbers = ", ".join(f"{value:g}" for value in places[row, b])
            values.append(f"{', '.join(self.tracker.targets[b])} = {numbers}")
        listed = left_out(self.path.name, rows.line[lost], reason, values)
        kept = np.setdiff1d(np.arange(len(rows)), lost)
        return rows.take(kept), listed

    def _refuse_units(self, rows: PoseRows) -> None:
        places = self.tracker.places_mm(rows)
        seen = np.isfinite(places[..., 0])
        best = int(seen.sum(axis=0).argmax())
        of_best = rows.take(seen[:, best])
        refuse_wrong_angle_unit(
            (rows.time_s, rows.q),
            (of_best.time_s, places[seen[:, best], best]),
            self.arm,
            0.0,
            self._where_joints,
        )
        self._refuse_better_unit(rows)
        what = "distances" if places.shape[2] == 1 else "positions"
        where = f"{self.path}: {', '.join(self.tracker.targets[best])}"
        T_base_ee = Chain.of(self.arm).forward(in_radians(rows.q, self.arm))
        refuse_wrong_length_unit(self.tracker.scale(rows, T_base_ee), what, where)

    def _refuse_better_unit(self, rows: PoseRows) -> None:
        """Stop when angles taken for radians, or strokes for metres, explain what was seen."""
        slides = self.arm.prismatic
        tried = []
        if may_be_radians(rows.q, self.arm):
            tried.append(("angles", "radians", "degrees", np.where(slides, 1.0, np.degrees(1.0))))
        if slides.any() and np.abs(rows.q[:, slides]).max() <= LONGEST_STROKE_M:
            tried.append(("strokes", "metres", "millimetres", np.where(slides, 1e3, 1.0)))
        if not tried:
            return
        logged = self._misfit(rows, rows.q)
        if logged is None or np.median(logged.size_mm) <= BAD_MM:
            return
        for what, unit, right, factor in tried:
            misfit = self._misfit(rows, rows.q * factor)
            if misfit is None or BETTER * np.median(misfit.size_mm) > np.median(logged.size_mm):
                continue
            raise RawDataError(
                f"the joint {what} look like {unit}",
                where=self._where_joints,
                value=f"a median misfit of the nominal model of {np.median(logged.size_mm):.0f} mm,"
                f" and of {np.median(misfit.size_mm):.0f} mm with {unit}",
                allowed=f"joint {what} in {right}",
                remedy=f"convert the columns to {right}",
            )

    def _misfit(self, rows: PoseRows, q: Array) -> Misfit | None:
        if len(rows) < self.tracker.least_rows:
            return None
        T_base_ee = Chain.of(self.arm).forward(in_radians(q, self.arm))
        return robust_misfit(
            lambda used, weights: self.tracker.misfit(rows, T_base_ee, used, weights), len(rows)
        )

    @property
    def _where_joints(self) -> str:
        names = position_columns(self.arm.prismatic)
        return f"{self.path}: {names[0]} … {names[-1]}"


def _poor_fit(misfit: Misfit) -> tuple[str, ...]:
    """Say where the nominal model, however placed, is far from most of what was seen."""
    length_mm, turn_deg = np.nanmedian(misfit.length_mm), np.median(misfit.turn_deg)
    off = [f"{length_mm:.0f} mm"] if length_mm > WARN_MM else []
    off += [f"{turn_deg:.0f} deg"] if turn_deg > WARN_DEG else []
    if not off:
        return ()
    return (
        f"the nominal model, base and target fitted, is {' and '.join(off)} off in the median: "
        "check robot, and order, signs and zeros of the joints and of the quaternion",
    )


def _unseen(rows: PoseRows, q_rad: Array, arm: Arm) -> MeasuredPoses:
    """Return the configurations without what was seen."""
    count = len(rows)
    return MeasuredPoses(
        kind=rows.kind,
        pose=rows.pose,
        load_N=rows.load_N,
        repeat=rows.repeat,
        time_s=rows.time_s,
        slides=arm.prismatic,
        q_rad=q_rad,
        q_u_rad=in_radians(rows.q_u, arm),
        tau_Nm=rows.tau_Nm,
        tau_u_Nm=rows.tau_u_Nm,
        arrival=np.zeros_like(q_rad),
        temperature_C=rows.temperature_C,
        dwell_samples=np.zeros(count, dtype=np.int64),
        ball_names=(),
        p_instr_balls_mm=np.zeros((count, 0, 3)),
        cov_balls_mm2=np.zeros((count, 0, 3, 3)),
        ball_touches=np.zeros((count, 0), dtype=np.int64),
    )
