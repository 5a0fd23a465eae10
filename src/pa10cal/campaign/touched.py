"""Touches and resolver log joined by time: balls located, joints read in dwells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.campaign.balls import (
    LEAST_TOUCHES,
    LocatedBalls,
    TouchedTool,
    TouchGroups,
    commonest,
    group_touches,
    locate_balls,
)
from pa10cal.campaign.bounds import Bounds
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.labels import EXCHANGED, exchange_text, exchanged, misfit_mm, nominal_places
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import Ingested, Quarantined, quarantined, refuse_too_many
from pa10cal.campaign.rows import Samples, Touches, read_samples, read_touches
from pa10cal.campaign.screens import (
    OFF_MODEL,
    OTHER_COMMAND,
    count_warnings,
    off_command,
    off_model,
    refuse_wrong_angle_unit,
)
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Misfit
from pa10cal.observe.touched import Touched
from pa10cal.options import IngestOptions

#: The touches' scatter may exceed the instrument's statement by this factor without a note.
SCATTER_NOTE = 1.5
#: Part of the touches that may lie outside dwells before the clocks are suspected, and the part
#: of those that may still do so under the offset that is then to blame.
FEW_OUTSIDE = 0.05
OFFSET_LEAVES = 0.2

OUTSIDE = "touched outside any dwell: the arm moved, or the clocks differ"
OTHER_DWELL = "touched in another dwell than the rest of its configuration"
NOT_TOUCHED = "a dwell in which nothing was touched"
LOST = "a dwell whose configuration is quarantined"


def read_touched(
    campaign: CampaignDescription, arm: Arm, folder: Path, settings: IngestOptions
) -> Ingested:
    """Read a campaign of a touch-trigger instrument.

    Args:
        campaign: its description.
        arm: the nominal arm.
        folder: its folder.
        settings: the `ingest` section.

    Returns:
        One entry a configuration, and every row that is quarantined.

    Raises:
        RawDataError: when a file, or too much of it, cannot be used.
    """
    files = [RawFile.of(campaign, folder, key, arm.prismatic) for key in ("cmm", "resolver")]
    cmm, resolver = (file.path for file in files)
    touches, cmm_read = read_touches(
        files[0], campaign.ball_names, Bounds(arm), exclusions_of(campaign, folder)
    )
    samples, resolver_read = read_samples(files[1], Bounds(arm))
    logged = len(np.unique(touches.configurations))
    reads = (cmm_read, resolver_read)
    totals = {read.file: read.total for read in reads}
    listed = [*cmm_read.quarantined, *resolver_read.quarantined]
    refuse_too_many(listed, totals, settings.max_quarantined_fraction)
    _check_angle_unit(campaign, arm, touches, samples, str(resolver))

    dwells = find_dwells(samples, settings.still_speed_deg_s)
    touched = dwells.at(touches.time_s)
    log_s = float(samples.time_s[0]), float(samples.time_s[-1])
    _check_clocks(touches, touched, dwells, log_s, str(cmm), str(resolver))
    touches, dwell, outside = _in_one_dwell(touches, touched, cmm.name)
    listed += outside
    refuse_too_many(listed, totals, settings.max_quarantined_fraction)

    groups = group_touches(touches, len(campaign.ball_names))
    tool = TouchedTool(
        names=campaign.ball_names,
        p_ee_balls_mm=campaign.p_ee_balls_mm,
        radius_mm=0.5 * float(campaign.ball_diameter_mm or np.nan),
        centre_uncertainty_mm=campaign.instrument.uncertainty_mm,
        outlier_sigma=settings.stray_touch_sigma,
    )
    balls = locate_balls(touches.p_instr_mm[groups.row], groups.valid, tool, str(cmm))
    readings = dwell_readings(samples, dwells)
    dwell = dwell[groups.first]
    off = off_command(touches.pose[groups.first], readings.q_rad[dwell], arm.prismatic)
    late = (balls.reason == "") & off
    reason = np.where(late, OTHER_COMMAND, balls.reason)
    T_base_ee = Chain.of(arm).forward(readings.q_rad[dwell])
    held_out = touches.kind[groups.first] == "holdout"
    reason = _off_the_arm(reason, balls, T_base_ee, held_out, tool)
    listed += _unused_touches(touches, groups, balls, reason, cmm.name, settings)
    refuse_too_many(listed, totals, settings.max_quarantined_fraction)

    good = np.flatnonzero(reason == "")
    poses = _assemble(tool, touches, groups, balls, readings, dwell, good)
    idle, idle_notes = _idle_samples(samples, dwells, touched, dwell[good], resolver.name)
    notes = [note for read in reads for note in read.notes] + _scatter_notes(balls) + idle_notes
    warnings = (
        *count_warnings(campaign.configurations, logged, cmm.name),
        *_cut_touches(dwells, touched, cmm.name),
    )
    return Ingested(poses, (*listed, *idle), tuple(notes), warnings)


def _check_angle_unit(
    campaign: CampaignDescription, arm: Arm, touches: Touches, samples: Samples, where: str
) -> None:
    """Compare the joints' motion with that of one ball's touches."""
    one = touches.ball == np.bincount(touches.ball).argmax()
    reach_mm = float(np.linalg.norm(campaign.p_ee_balls_mm, axis=1).max())
    refuse_wrong_angle_unit(
        (samples.time_s, samples.q_deg),
        (touches.time_s[one], touches.p_instr_mm[one]),
        arm,
        reach_mm,
        f"{where}: q1_deg … q{arm.n}_deg",
    )


def _check_clocks(
    touches: Touches,
    touched: Index,
    dwells: Dwells,
    log_s: tuple[float, float],
    where: str,
    where_log: str,
) -> None:
    """Stop when the arm never stood still, or the touches are not in the dwells.

    That is when most touches lie outside the dwells, or when an offset of the clocks would bring in
    nearly all of those that do.
    """
    if not len(dwells):
        raise RawDataError(
            "the arm is never at rest in the log",
            where=where_log,
            allowed="dwells, in which the touches are made",
            remedy="check time_s, or raise ingest.still_speed_deg_s above the joints' noise",
        )
    outside = touched < 0
    if outside.mean() <= FEW_OUTSIDE:
        return
    offset = best_clock_offset(touches.time_s, dwells)
    explained = 1.0 - offset.inside <= OFFSET_LEAVES * outside.mean()
    if not explained:
        _refuse_cut_log(touches, outside, log_s, where_log)
    if 2 * outside.sum() <= len(touched) and not explained:
        return
    raise RawDataError(
        f"{outside.sum()} of {len(touched)} touches lie outside any dwell of the arm",
        where=f"{where}:{touches.line[np.argmax(outside)]}",
        allowed="touches while the arm is at rest, on the clock of the resolver log",
        remedy=f"the clocks seem to differ: adding {offset.seconds:+.1f} s to time_s would bring "
        f"{offset.inside:.0%} of the touches into dwells"
        if explained
        else "check both clocks and ingest.still_speed_deg_s; no constant offset matches",
    )


def _refuse_cut_log(
    touches: Touches, outside: NDArray[np.bool_], log_s: tuple[float, float], where_log: str
) -> None:
    """Stop when touches lie outside dwells because the log does not cover them."""
    beyond = (touches.time_s < log_s[0]) | (touches.time_s > log_s[1])
    if (outside & ~beyond).sum() > FEW_OUTSIDE * len(touches):
        return
    numbers = touches.configurations
    missing, every = len(np.unique(numbers[beyond])), len(np.unique(numbers))
    raise RawDataError(
        "the log does not cover the touches: it seems cut short",
        where=where_log,
        value=f"{missing} of {every} configurations were touched before it begins or after it "
        f"ends; it covers {log_s[0]:g} to {log_s[1]:g} s",
        allowed=f"a log from {touches.time_s[0]:g} to {touches.time_s[-1]:g} s",
        remedy="export the whole log, or leave out the touches that it does not cover",
    )


def _in_one_dwell(
    touches: Touches, touched: Index, file: str
) -> tuple[Touches, Index, tuple[Quarantined, ...]]:
    """Keep the touches of each configuration that were made in one and the same dwell."""
    outside = touched < 0
    rows = quarantined(file, touches.line[outside], OUTSIDE, _seconds(touches.time_s[outside]))
    touches, touched = touches.take(~outside), touched[~outside]
    of_touch = touches.configurations
    other = touched != commonest(of_touch, touched)[of_touch]
    rows += quarantined(file, touches.line[other], OTHER_DWELL, _seconds(touches.time_s[other]))
    return touches.take(~other), touched[~other], rows


def _off_the_arm(
    reason: NDArray[np.object_],
    balls: LocatedBalls,
    T_base_ee: Array,
    held_out: NDArray[np.bool_],
    tool: TouchedTool,
) -> NDArray[np.object_]:
    """Name configurations whose labels are exchanged, and those far off the nominal arm."""
    located = np.isfinite(balls.p_instr_mm).all(axis=(1, 2))
    located &= (balls.used.sum(axis=2) >= LEAST_TOUCHES).all(axis=1)
    rows = np.flatnonzero(located)
    p_m, found = 1e-3 * balls.p_instr_mm[rows], reason.copy()
    modelled = nominal_places(T_base_ee[rows], p_m)
    if modelled is None:
        return found
    misfit = Misfit(1e-3 * misfit_mm(p_m, modelled)[:, None], np.zeros(len(rows)))
    off = off_model(misfit, held_out[rows])[:, 0]
    found[rows[off & (reason[rows] == "")]] = OFF_MODEL
    for row, order in zip(rows, exchanged(p_m, modelled), strict=True):
        if order is not None:
            found[row] = f"{EXCHANGED}: {exchange_text(order, tool.names)}"
    return found


def _unused_touches(
    touches: Touches,
    groups: TouchGroups,
    balls: LocatedBalls,
    reason: NDArray[np.object_],
    file: str,
    settings: IngestOptions,
) -> tuple[Quarantined, ...]:
    """List touches that are outliers, and touches of configurations that cannot be used."""
    off = np.zeros(len(touches), dtype=bool)
    off[groups.row[balls.outlier]] = True
    why = np.where(off, "", reason[groups.of_touch])
    lost = np.flatnonzero(why != "")
    labels = _labels(touches)
    where = np.array([f"pose {label}" for label in labels], dtype=object)
    outlier = f"suspected outlier: more than {settings.stray_touch_sigma:g} sigmas off its ball"
    rows = quarantined(file, touches.line[off], outlier, labels[off])
    for text in np.unique(why[lost].astype(str)):
        these = why == text
        rows += quarantined(file, touches.line[these], str(text), labels[these], where[these])
    return rows


def _assemble(
    tool: TouchedTool,
    touches: Touches,
    groups: TouchGroups,
    balls: LocatedBalls,
    readings: DwellReadings,
    dwell: Index,
    good: Index,
) -> Observations:
    """Fit the end-effector to the balls of the good configurations and gather their readings."""
    first, at = groups.first[good], dwell[good]
    used, time_s = balls.used[good], touches.time_s[groups.row[good]]
    begin = np.where(used, time_s, np.inf).min(axis=(1, 2), initial=np.inf)
    end = np.where(used, time_s, -np.inf).max(axis=(1, 2), initial=-np.inf)
    states = PoseStates(
        q_rad=readings.q_rad[at],
        tau_Nm=readings.tau_Nm[at],
        arrival=readings.arrival[at],
        load_N=touches.load_N[first],
        temperature_C=readings.temperature_C[at],
        time_s=0.5 * (begin + end),
    )
    return Observations(
        pose=touches.pose[first],
        states=states,
        measured=Touched.of_balls(
            tool.names,
            tool.p_ee_balls_mm,
            balls.p_instr_mm[good],
            balls.cov_mm2[good],
            used.sum(axis=2),
        ),
        kind=touches.kind[first],
        repeat=touches.repeat[first],
        readings=np.ones(len(good), dtype=np.int64),
        log=JointLog(readings.q_u_rad[at], readings.tau_u_Nm[at], readings.samples[at]),
    )


def _idle_samples(
    samples: Samples, dwells: Dwells, touched: Index, used: Index, file: str
) -> tuple[tuple[Quarantined, ...], list[str]]:
    """List the samples of dwells that serve no configuration; the arm may have waited there."""
    serves, seen = np.zeros(len(dwells), dtype=bool), np.zeros(len(dwells), dtype=bool)
    serves[used] = True
    seen[touched[touched >= 0]] = True
    standing = dwells.of_sample >= 0
    dwell = np.where(standing, dwells.of_sample, 0)
    lost = standing & seen[dwell] & ~serves[dwell]
    idle = standing & ~seen[dwell]
    rows = quarantined(file, samples.line[idle], NOT_TOUCHED)
    rows += quarantined(file, samples.line[lost], LOST)
    count = int((~seen).sum())
    return rows, [f"dwells without touches: {count}"] if count else []


def _cut_touches(dwells: Dwells, touched: Index, file: str) -> tuple[str, ...]:
    """Say how many configurations are missing where the arm stood in many more than these."""
    without = len(dwells) - len(np.unique(touched[touched >= 0]))
    if 3 * without <= len(dwells):
        return ()
    return (
        f"nothing was touched in {without} of the {len(dwells)} dwells of the log: {file} seems "
        f"cut short, {without} configurations are missing",
    )


def _scatter_notes(balls: LocatedBalls) -> list[str]:
    if not balls.pooled_sigma_mm > SCATTER_NOTE * balls.touch_sigma_mm:
        return []
    return [
        f"touches scatter by {balls.pooled_sigma_mm:.4f} mm where the stated uncertainty "
        f"implies {balls.touch_sigma_mm:.4f} mm"
    ]


def _labels(touches: Touches) -> NDArray[np.object_]:
    parts = (touches.pose, touches.load_N, touches.repeat)
    text = [f"{pose} at {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]
    return np.array(text, dtype=object)


def _seconds(time_s: Array) -> list[str]:
    return [f"time_s = {value:g}" for value in time_s]


# Dwells of the arm in the resolver log: where it stood still, what it read, how it arrived.

#: Speeds are taken over at least this time, so that noise of a fast log is no movement.
SPEED_WINDOW_S = 0.3
#: A standing arm may creep no further between two samples than at the still speed in this time.
CREEP_S = 1.0
#: An interval this many times the usual one is a pause of the log.
PAUSE = 5.0
#: Movements beyond so many noise sigmas, and beyond the still speed in so much time, are real.
REAL_SIGMAS = 10.0
REAL_S = 0.1
#: Steps of the search for a clock offset, and the most there may be.
OFFSET_STEP_S = 0.25
OFFSET_BINS = 2**20


@dataclass(frozen=True)
class Dwells:
    """Stretches of the log in which every joint stood still."""

    start_s: Array  # (D,) time of the first sample
    end_s: Array  # (D,) time of the last sample
    first: Index  # (D,) index of the first sample
    last: Index  # (D,) index of the last sample
    of_sample: Index  # (N,) dwell of every sample, -1 while the arm moved
    real_deg: Array  # (n,) movement of a joint that noise cannot feign

    def __len__(self) -> int:
        return len(self.first)

    def at(self, time_s: Array) -> Index:
        """Return the dwell at each time, -1 where the arm moved or nothing was logged."""
        if not len(self):
            return np.full(len(time_s), -1)
        before = np.searchsorted(self.start_s, time_s, side="right") - 1
        inside = (before >= 0) & (time_s <= self.end_s[before])
        return np.where(inside, before, -1)


@dataclass(frozen=True)
class DwellReadings:
    """What the log contains of each of D dwells of an arm with n joints."""

    samples: NDArray[np.int64]  # (D,) samples in the dwell
    q_rad: Array  # (D, n) mean joint positions
    q_u_rad: Array  # (D, n) standard uncertainty of that mean, from the scatter in the dwell
    tau_Nm: Array  # (D, n) mean torques
    tau_u_Nm: Array  # (D, n) standard uncertainty of that mean
    temperature_C: Array  # (D,) mean temperature
    # (D, n) sign of each joint's last real movement in the logged approach; 0 where it made none
    arrival: Array


@dataclass(frozen=True)
class ClockOffset:
    """What to add to the touches' times to bring them into dwells."""

    seconds: float  # the offset
    inside: float  # part of the touches that would then lie in dwells


def find_dwells(samples: Samples, still_speed_deg_s: float) -> Dwells:
    """Find where all joints were slower than the still speed.

    Args:
        samples: the log, in order of time.
        still_speed_deg_s: `ingest.still_speed_deg_s`.

    Returns:
        Dwells of at least two samples, in order of time.
    """
    time_s, q_deg = samples.time_s, samples.q_deg
    steps_s = np.diff(time_s)
    travel = np.abs(np.diff(q_deg, axis=0))
    slow = _slow_intervals(time_s, q_deg, still_speed_deg_s)
    noise = _noise(travel[slow])
    real = np.maximum(REAL_SIGMAS * noise, REAL_S * still_speed_deg_s)
    if len(steps_s):
        pause = steps_s > PAUSE * np.median(steps_s)
        slow &= ~pause | (travel <= real).all(axis=1)
    edges = np.diff(np.concatenate([[False], slow, [False]]).astype(int))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    of_sample = np.full(len(time_s), -1)
    inside = np.zeros(len(time_s) + 1, dtype=int)
    inside[first] += 1
    inside[last + 1] -= 1
    standing = np.cumsum(inside[:-1]) > 0
    of_sample[standing] = np.searchsorted(first, np.flatnonzero(standing), side="right") - 1
    return Dwells(time_s[first], time_s[last], first, last, of_sample, real)


def dwell_readings(samples: Samples, dwells: Dwells) -> DwellReadings:
    """Average the samples of every dwell and find how each joint arrived.

    The direction of arrival is that of the last movement larger than noise: the sign of the dwell's
    position minus that of the latest sample of the approach that differs from it by more than
    `Dwells.real_deg`. The approach is what was logged since the dwell before.
    """
    standing = dwells.of_sample >= 0
    dwell = dwells.of_sample[standing]
    count = np.bincount(dwell, minlength=len(dwells))
    q_deg, q_u_deg = _mean(samples.q_deg[standing], dwell, count)
    tau_Nm, tau_u_Nm = _mean(samples.tau_Nm[standing], dwell, count)
    temperature_C, _ = _mean(samples.temperature_C[standing, None], dwell, count)
    return DwellReadings(
        samples=count,
        q_rad=np.radians(q_deg),
        q_u_rad=np.radians(q_u_deg),
        tau_Nm=tau_Nm,
        tau_u_Nm=tau_u_Nm,
        temperature_C=temperature_C[:, 0],
        arrival=_arrival(samples.q_deg, dwells, q_deg),
    )


def best_clock_offset(time_s: Array, dwells: Dwells) -> ClockOffset:
    """Find the offset of the touches' clock that brings most touches into dwells.

    Args:
        time_s: (N,) times of touches, N >= 1.
        dwells: dwells on the other clock, at least one.

    Returns:
        The offset that brings in the most touches; where a range of them does, its middle, and of
        several ranges that nearest to zero.
    """
    begin_dwells, begin_touches = dwells.start_s[0], time_s.min()
    span = max(dwells.end_s[-1] - begin_dwells, float(np.ptp(time_s)))
    step = max(OFFSET_STEP_S, span / OFFSET_BINS)
    bins = int(span / step) + 2
    edges = np.zeros(bins + 1)
    np.add.at(edges, ((dwells.start_s - begin_dwells) / step).round().astype(int), 1.0)
    np.add.at(edges, ((dwells.end_s - begin_dwells) / step).round().astype(int), -1.0)
    standing = np.cumsum(edges[:-1])
    touches = np.bincount(((time_s - begin_touches) / step).round().astype(int), minlength=bins)
    score = _correlation(standing, touches.astype(float))
    seconds = begin_dwells - begin_touches + (np.arange(len(score)) + 1 - bins) * step
    best = np.flatnonzero(score >= score.max() - 0.5)
    ranges = np.split(best, np.flatnonzero(np.diff(best) > 1) + 1)
    middles = np.array([np.median(seconds[found]) for found in ranges])
    offset = float(middles[np.argmin(np.abs(middles))])
    inside = float(np.mean(dwells.at(time_s + offset) >= 0))
    return ClockOffset(offset, inside)


def _correlation(standing: Array, touches: Array) -> Array:
    """Return the touches in dwells at every lag from 1 - len to len - 1."""
    size = next_fast_len(len(standing) + len(touches) - 1, real=True)
    product = rfft(standing, size) * rfft(touches[::-1], size)
    return np.asarray(irfft(product, size)[: len(standing) + len(touches) - 1])


def _slow_intervals(time_s: Array, q_deg: Array, still_speed_deg_s: float) -> NDArray[np.bool_]:
    """Return (N-1,) whether the arm stood still between neighbouring samples."""
    count = len(time_s)
    here = np.arange(count - 1)
    there = np.searchsorted(time_s, time_s[:-1] + SPEED_WINDOW_S)
    there = np.clip(there, here + 1, count - 1)
    allowed = still_speed_deg_s * np.minimum(time_s[there] - time_s[here], CREEP_S)
    moves = np.abs(q_deg[there] - q_deg[here]).max(axis=1, initial=0.0) > allowed
    edges = np.zeros(count, dtype=int)
    np.add.at(edges, here[moves], 1)
    np.add.at(edges, there[moves], -1)
    return np.asarray(np.cumsum(edges)[:-1] == 0)


def _noise(travel: Array) -> Array:
    """Return (n,) the deviation of one reading, from differences of neighbours at rest."""
    if not len(travel):
        return np.zeros(travel.shape[1])
    return np.asarray(1.4826 * np.median(travel, axis=0) / np.sqrt(2.0))


def _mean(values: Array, dwell: Index, count: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the mean over each dwell and its standard uncertainty, (D, m) each."""
    mean = np.zeros((len(count), values.shape[1]))
    np.add.at(mean, dwell, values)
    mean /= count[:, None]
    square = np.zeros_like(mean)
    np.add.at(square, dwell, (values - mean[dwell]) ** 2)
    return mean, np.sqrt(square / (count * (count - 1))[:, None])


def _arrival(q_deg: Array, dwells: Dwells, mean_deg: Array) -> Array:
    moving = np.flatnonzero(dwells.of_sample < 0)
    following = np.searchsorted(dwells.first, moving)
    moving, following = moving[following < len(dwells)], following[following < len(dwells)]
    way = mean_deg[following] - q_deg[moving]
    rows, joints = np.nonzero(np.abs(way) > dwells.real_deg)
    latest = np.full(mean_deg.shape, -1)
    np.maximum.at(latest, (following[rows], joints), rows)
    signs = np.sign(way)
    found = np.take_along_axis(signs, np.maximum(latest, 0), axis=0) if len(way) else latest
    return np.where(latest >= 0, found, 0.0)
