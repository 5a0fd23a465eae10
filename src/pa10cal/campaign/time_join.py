"""Readings joined by time with the log of the joints: the offset of two clocks, and streams.

An instrument reads once while the arm stands, or goes on while it moves (a stream). Of a stream,
readings are averaged while joints and target are both at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.dwells import (
    BRIEF_WINDOW_S,
    DENSE,
    SPEED_WINDOW_S,
    Samples,
    Stations,
    offset_ranges,
    stations_of,
)
from pa10cal.campaign.joint_positions import in_radians
from pa10cal.campaign.nominal_fit import RIGHT_ROWS_M, ReadingsAtStations
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.campaign.sampling import (
    SLOWEST_JOINT,
    SLOWEST_SLIDE,
    SLOWEST_TARGET_MM_S,
    goes_on,
    is_of_motion,
    is_regular,
    refuse_creeping,
    refuse_unlike_durations,
)
from pa10cal.campaign.streams import (
    Clock,
    averaged,
    clock_by_edges,
    clock_of_motion,
    least_readings,
    reading_dwells,
    resolution_s,
    spread_times,
)
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import RawColumns

#: Clock offsets are candidates that bring this part of the readings that the best brings to
#: stations; candidates compared by the nominal arm, at most.
NEARLY, CANDIDATES = 0.85, 12
#: Dwells found over a shorter time are taken where there are so many times as many, or more at all
#: where the dwells found otherwise are short.
MANY_MORE = 1.3
#: Dwells that are found to last less are no poses [s].
SHORT_S = 0.4
#: A part of the stations, or of the target's dwells, that is lost is told beyond this.
LOST = 0.2
#: Stations at which joints and target both were at rest, at least.
LEAST_VISITS = 3
#: Part of the readings, or of the stations of a stream, that are nearly all.
NEARLY_ALL = 0.9


@dataclass(frozen=True)
class JoinedReadings:
    """Readings, each with the station of the joints' log at which it was taken."""

    readings: RawRows  # N readings; of a stream one a station, the mean there
    station: Index  # (N,) station of each; -1 where it was taken at none
    stations: Stations  # where the arm stood
    note: str  # what joins the two logs
    warnings: tuple[str, ...] = ()  # what the user should correct first, one sentence each

    @property
    def nearly_all(self) -> bool:
        """Return whether nearly all readings, or stations of a stream, were joined."""
        joined = self.station >= 0
        visited = len(np.unique(self.station[joined])) / max(len(self.stations), 1)
        return min(float(np.mean(joined)), visited) >= NEARLY_ALL


@dataclass(frozen=True)
class NominalArm:
    """The nominal arm of a campaign, with which its readings are compared."""

    arm: Arm
    campaign: CampaignDescription
    measured: RawColumns  # columns of what was measured

    def ends(self, q_deg: Array) -> Array:
        """Return the nominal end (P, 4, 4) at joint positions (P, n) [deg, mm]."""
        return Chain.of(self.arm).forward(in_radians(q_deg, self.arm.prismatic))

    def at_stations(self, read: RawRows, stations: Stations) -> ReadingsAtStations:
        """Return what was measured, and the nominal end at the stations."""
        measured, instrument = self.measured, self.campaign.instrument.type
        values = read.numbers_of(measured.names)
        usable = np.asarray(measured.may_be_blank | np.isfinite(values).all(axis=1))
        for off in instrument.unusable(measured, values):
            usable &= ~off.rows
        unknown = np.full(values.shape, np.nan)
        seen = instrument.from_raw(measured, values, unknown, self.campaign.stated)
        return ReadingsAtStations(seen, self.ends(stations.q_deg), usable)


def clock_offset(
    stations: Stations, time_s: Array, readings: ReadingsAtStations
) -> tuple[float, float]:
    """Return the offset to add to times of readings for the joints' clock, and its uncertainty.

    Offsets that bring most readings (N,) to stations are compared by the misfit of the nominal arm:
    where all poses take equally long, times agree as well a pose later, but positions do not.
    """
    known_s = time_s[np.isfinite(time_s)]
    if not len(known_s):
        return 0.0, 0.0
    ranges = offset_ranges(stations, known_s, NEARLY)
    tried: list[_Offset] = []
    for low_s, high_s in ranges[:CANDIDATES]:
        offset_s = 0.5 * (low_s + high_s)
        station = stations.at(time_s + offset_s)
        inside = np.flatnonzero(station >= 0)
        residual_m = None
        if len(ranges) > 1:
            residual_m = readings.misfit_m(inside, station[inside], len(inside))
        misfit_m = np.inf if residual_m is None else float(np.nanmedian(residual_m))
        tried.append(_Offset(offset_s, high_s - low_s, len(inside), misfit_m))
        if misfit_m < RIGHT_ROWS_M:
            break  # offsets that bring in fewer readings need not be tried
    best_m = min(each.misfit_m for each in tried)
    near = [each for each in tried if each.misfit_m <= 1.5 * best_m or not np.isfinite(best_m)]
    best = min(near, key=lambda each: (-each.readings, each.misfit_m))
    return float(best.offset_s), float(best.width_s / np.sqrt(12.0))  # uniform over its range


class _Offset(NamedTuple):
    """A possible offset of the clocks."""

    offset_s: float  # middle of its range
    width_s: float  # width of the range of offsets that bring the same readings to stations
    readings: int  # number of readings at stations
    misfit_m: float  # median misfit of the nominal arm there; inf where it is not known


@dataclass(frozen=True)
class _Stream:
    """Readings that go on while the arm moves, and the log of its joints, in order of time."""

    read: RawRows  # N rows in which the target was seen, with a time
    time_s: Array  # (N,) their times; rows under one time stamp are spread
    p_mm: Array  # (N, 3) places of the target that was seen most, or (N, 1) its distances
    unseen: int  # number of rows without the target in sight
    samples: Samples  # of the joints' log; samples under one time stamp are spread
    rounded_s: float  # resolution of the coarser of both clocks

    @classmethod
    def of(cls, read: RawRows, samples: Samples, measured: RawColumns) -> _Stream:
        """Return the stream of two logs; rows without the target in sight are not quarantined."""
        unseen = {row for row in read.quarantined if row.value.endswith("= ''")}
        quarantined = tuple(row for row in read.quarantined if row not in unseen)
        read = replace(read.at(np.argsort(read["time_s"], kind="stable")), quarantined=quarantined)
        read = read.at(np.flatnonzero(np.isfinite(read["time_s"])))
        return cls(
            read,
            spread_times(read["time_s"]),
            _seen_most(read, measured),
            len(unseen),
            replace(samples, time_s=spread_times(samples.time_s)),
            max(map(resolution_s, (read["time_s"], samples.time_s))),
        )

    @property
    def sampled_s(self) -> tuple[float, float]:
        """Return the median interval of the readings, and that of the joints' log."""
        readings_s, joints_s = self.time_s, self.samples.time_s
        return float(np.median(np.diff(readings_s))), float(np.median(np.diff(joints_s)))

    @property
    def rows(self) -> int:
        """Return the number of rows, those without the target in sight included."""
        return len(self.read) + self.unseen


class _AtRest(NamedTuple):
    """When target and arm stood still, each by the clock of its log."""

    target: Stations  # dwells of the readings
    arm: Stations
    window_s: float  # over which speeds were averaged

    @property
    def last_s(self) -> tuple[float, float]:
        """Return the median time that a dwell of the target and a station of the arm last."""
        target_s, arm_s = (float(np.median(each.end_s - each.start_s)) for each in self[:2])
        return target_s, arm_s


@dataclass(frozen=True)
class TimeJoin:
    """Joins readings with the joints' log by time."""

    joints: Path  # file of the joints
    readings: Path  # file of the readings
    samples: Samples  # of the joints' log
    nominal: NominalArm
    still_speed_deg_s: float  # a slower joint is at rest
    stated_offset_s: float | None  # to add to times of readings; None where it is to be found

    def join(self, read: RawRows) -> JoinedReadings:
        """Return the readings with their stations; those of a stream are averaged there."""
        time_s, p_mm = read["time_s"], _seen_most(read, self.nominal.measured)
        self._refuse_creeping(time_s, p_mm)
        if goes_on(time_s, p_mm):
            return self._stream(read)
        refuse_unlike_durations((self.joints, self.readings), self.samples.time_s, time_s)
        return self._single_readings(read)

    def _refuse_creeping(self, time_s: Array, p_mm: Array) -> None:
        """Refuse times of either log by which joints, or the target at p_mm (N, m), creep."""
        samples = self.samples
        slowest = np.where(self.nominal.arm.prismatic, SLOWEST_SLIDE, SLOWEST_JOINT)
        refuse_creeping(self.joints, "joints", samples.time_s, samples.q_deg, slowest)
        of_target = np.full(p_mm.shape[1], SLOWEST_TARGET_MM_S)
        refuse_creeping(self.readings, "readings", time_s, p_mm, of_target)

    def at_rest_of(self, read: RawRows) -> tuple[Array, RawRows, Stations]:
        """Return middle times and means of a stream's dwells, or single readings; and stations.

        Raises:
            RawDataError: when target or arm never stands still.
        """
        if not goes_on(read["time_s"], _seen_most(read, self.nominal.measured)):
            stations = stations_of(self.samples, len(read), self.still_speed_deg_s)
            return read["time_s"], read, stations
        stream = _Stream.of(read, self.samples, self.nominal.measured)
        at_rest = self._at_rest(stream)
        dwells = at_rest.target
        means = averaged(stream.read, dwells.of_sample)
        return 0.5 * (dwells.start_s + dwells.end_s), means, at_rest.arm

    def offset_after_less_before(self, read: RawRows, split_s: float, offset_s: float) -> float:
        """Return how far the offset of the clocks changes at a time of the readings, by the motion.

        It is 0 where the motion does not show it; `offset_s` is the offset, approximately.
        """
        if not goes_on(read["time_s"], _seen_most(read, self.nominal.measured)):
            return 0.0
        stream = _Stream.of(read, self.samples, self.nominal.measured)
        at_rest = self._at_rest(stream)
        offsets_s = []
        for part in (stream.time_s < split_s, stream.time_s >= split_s):
            of_part = replace(stream, time_s=stream.time_s[part], p_mm=stream.p_mm[part])
            target = replace(at_rest.target, of_sample=at_rest.target.of_sample[part])
            clock = self._by_motion(of_part, at_rest._replace(target=target), offset_s)
            if clock is None:
                return 0.0
            offsets_s.append(float(clock.joints_s(np.array([split_s]))[0]))
        return offsets_s[1] - offsets_s[0]

    def _single_readings(self, read: RawRows) -> JoinedReadings:
        """Join readings that were each taken while the arm stood."""
        count, time_s = len(read), read["time_s"]
        stations = stations_of(self.samples, count, self.still_speed_deg_s)
        at_stations = self.nominal.at_stations(read, stations)
        offset_s, u_s = self._offset(stations, time_s, at_stations)
        station = stations.at(time_s + offset_s)
        inside = int((station >= 0).sum())
        if 2 * inside <= count:
            known_s = np.sort(time_s[np.isfinite(time_s)])
            if is_regular(known_s) and is_of_motion(self.samples.time_s, self.samples.q_deg):
                raise self._too_slow(stations, known_s)
            raise self._apart(inside, stations, time_s, at_stations)
        plus_minus = "" if self.stated_offset_s is not None else f" ± {2.0 * u_s:.2g} s"
        note = (
            f"{self._joined_by_time} {offset_s:+.2f} s{plus_minus}; {inside} of {count} readings "
            f"lie in {len(stations)} steady phases"
        )
        return JoinedReadings(read, station, stations, note)

    def _stream(self, read: RawRows) -> JoinedReadings:
        """Join readings that go on while the arm moves: their mean while it and target stood."""
        stream = _Stream.of(read, self.samples, self.nominal.measured)
        at_rest = self._at_rest(stream)
        clock = self._clock(stream, at_rest)
        station = at_rest.arm.at(clock.joints_s(stream.time_s))
        steady = self._target_rests(stream, at_rest) & (station >= 0)
        visited, number = np.unique(station[steady], return_inverse=True)
        enough = np.bincount(number, minlength=len(visited)) >= least_readings(stream.time_s)
        group = np.full(len(station), -1)
        group[steady] = np.where(enough[number], (np.cumsum(enough) - 1)[number], -1)
        used, visit_count = int((group >= 0).sum()), int(enough.sum())
        if visit_count < LEAST_VISITS:
            raise self._hardly_still(visit_count, at_rest, stream)
        unseen = f" or without the target in sight ({stream.unseen})" if stream.unseen else ""
        note = (
            f"{self._joined_by_time} {clock.words}; {used} of {stream.rows} readings lie in "
            f"{visit_count} of {len(at_rest.arm)} steady phases and are averaged there, "
            f"{stream.rows - used} are set aside, taken in motion{unseen}"
        )
        warnings = (
            *_lost_stations(stream, clock, at_rest.arm, visited[enough]),
            *_lost_dwells(at_rest.target, group >= 0, self.joints.name),
        )
        readings = averaged(stream.read, group)
        return JoinedReadings(readings, visited[enough], at_rest.arm, note, warnings)

    def _target_rests(self, stream: _Stream, at_rest: _AtRest) -> Mask:
        """Return whether a target rests at each reading (N,); of several any that is seen there."""
        rests = np.zeros(len(stream.time_s), dtype=bool)
        for names in self.nominal.measured.targets:
            p_mm = stream.read.numbers_of(names)
            rests |= reading_dwells(stream.time_s, p_mm, at_rest.window_s).of_sample >= 0
        return rests

    @property
    def _joined_by_time(self) -> str:
        """Return the beginning of a note, which the offset of the clocks follows."""
        files = f"{self.joints.name} and {self.readings.name}"
        return f"{files} joined by time: the joints' clock is that of the readings"

    def _offset(
        self, stations: Stations, time_s: Array, readings: ReadingsAtStations
    ) -> tuple[float, float]:
        """Return the offset of the clocks as stated, of uncertainty 0, else see `clock_offset`."""
        if self.stated_offset_s is not None:
            return self.stated_offset_s, 0.0
        return clock_offset(stations, time_s, readings)

    def _at_rest(self, stream: _Stream) -> _AtRest:
        """Return where target and arm stood; brief dwells where those are more.

        Raises:
            RawDataError: when one of them never stands still.
        """
        samples = stream.samples

        def over(window_s: float) -> _AtRest:
            dwells = reading_dwells(stream.time_s, stream.p_mm, window_s)
            arm = stations_of(samples, len(dwells), self.still_speed_deg_s, window_s)
            return _AtRest(dwells, arm, window_s)

        def count(at_rest: _AtRest) -> int:
            arm_count = len(at_rest.arm) if len(at_rest.arm) < len(samples) else 0
            return min(len(at_rest.target), arm_count)

        at_rest, briefly = over(SPEED_WINDOW_S), over(BRIEF_WINDOW_S)
        lasts_s = [each.end_s - each.start_s for each in at_rest[:2] if len(each)]
        short = any(np.median(durations_s) < 2.0 * SPEED_WINDOW_S for durations_s in lasts_s)
        if count(briefly) > count(at_rest) * (1.0 if short else MANY_MORE):
            at_rest = briefly
        if len(at_rest.target) < 2:
            raise _no_dwell(self.readings, stream.rows, "the target never stands still")
        if _of_motion(samples, at_rest) and len(at_rest.arm) == len(samples):
            what = "the arm is never at rest in the log of its joints"
            raise _no_dwell(self.joints, len(samples), what)
        return at_rest

    def _clock(self, stream: _Stream, at_rest: _AtRest) -> Clock:
        """Return the clock: as stated, else by dwells, refined by their edges or the motion.

        Raises:
            RawDataError: when target and arm do not stand still at the same times.
        """
        dwells, stations = at_rest.target, at_rest.arm
        middle_s = 0.5 * (dwells.start_s + dwells.end_s)
        means = averaged(stream.read, dwells.of_sample)
        at_stations = self.nominal.at_stations(means, stations)
        offset_s, u_s = self._offset(stations, middle_s, at_stations)
        station = stations.at(middle_s + offset_s)
        inside = int((station >= 0).sum())
        if 2 * inside <= len(dwells):
            if min(at_rest.last_s) < SHORT_S or 2 * len(stations) < len(dwells):
                raise self._hardly_still(inside, at_rest, stream)
            raise self._apart(inside, stations, middle_s, at_stations, "dwells of the target")
        clock = Clock(offset_s, u_s, float(stream.time_s[0]), float(stream.time_s[-1]))
        if self.stated_offset_s is not None:
            return clock
        if _of_motion(stream.samples, at_rest):
            offset_s, u_s = clock_by_edges(dwells, stations, station, stream.sampled_s)
            clock = self._by_motion(stream, at_rest, offset_s) or replace(
                clock, offset_s=offset_s, u_s=u_s
            )
        return replace(clock, u_s=float(np.hypot(clock.u_s, stream.rounded_s / np.sqrt(12.0))))

    def _by_motion(self, stream: _Stream, at_rest: _AtRest, offset_s: float) -> Clock | None:
        """Return the clock by the motion between dwells; None where distances or few show it."""
        if stream.p_mm.shape[1] != 3:
            return None
        return clock_of_motion(
            stream.samples,
            at_rest.arm,
            stream.time_s,
            1e-3 * stream.p_mm,
            at_rest.target.of_sample,
            offset_s,
            self.nominal.ends,
        )

    def _hardly_still(self, both: int, at_rest: _AtRest, stream: _Stream) -> RawDataError:
        """Return the refusal of a stream in which target and arm rest `both` times together."""
        what = (
            f"the arm hardly stands still: {len(at_rest.arm)} steady phases of the joints, "
            f"{len(at_rest.target)} of the target, {both} of them at one time"
        )
        return _no_dwell(self.readings, stream.rows, what)

    def _too_slow(self, stations: Stations, time_s: Array) -> RawDataError:
        """Return the refusal of readings at regular times of which few lie where the arm stood."""
        apart_s = float(np.median(np.diff(time_s)))
        lasts_s = float(np.median(stations.end_s - stations.start_s))
        return RawDataError(
            "the readings seem to go on while the arm moves, with too few where it stands",
            where=str(self.readings),
            value=f"readings {apart_s:.2g} s apart, and stands of {lasts_s:.2g} s",
            allowed="two readings and more at each stand, or one that is taken while the arm "
            "stands still",
            remedy="let the arm stand longer, or read more often; check that both logs are of the "
            "same run, and the units of their times",
        )

    def _apart(
        self,
        inside: int,
        stations: Stations,
        time_s: Array,
        readings: ReadingsAtStations,
        of: str = "readings",
    ) -> RawDataError:
        """Return the refusal of readings, or dwells `of` the target, of which few lie at stations.

        Args:
            inside: how many lie at stations.
            stations: where the arm stood.
            time_s: (N,) times of the readings or dwells.
            readings: their mean readings.
            of: what they are.
        """
        stated_s = self.stated_offset_s
        offset = "the best offset of the clocks" if stated_s is None else f"{stated_s:+g} s"
        where = str(self.readings)
        remedy = (
            "check that both logs are of the same run, and the units and formats of "
            "columns.joints.time and columns.readings.time"
        )
        if stated_s is not None:
            other_s, _ = clock_offset(stations, time_s, readings)
            if 2 * (stations.at(time_s + other_s) >= 0).sum() > len(time_s):
                where = f"{self.readings.parent / DESCRIPTION_FILE}: join.clock_offset_s"
                remedy = f"remove join.clock_offset_s: it is then found, {other_s:+.2f} s"
        return RawDataError(
            "the two logs cannot be joined by time",
            where=where,
            value=f"{inside} of {len(time_s)} {of} lie where the arm stood, at {offset}",
            allowed="readings taken while the arm stands still",
            remedy=remedy,
        )


def _seen_most(read: RawRows, measured: RawColumns) -> Array:
    """Return places (N, 3), or distances (N, 1), of the target that was seen most [mm]."""
    places = [read.numbers_of(names) for names in measured.targets]
    return max(places, key=lambda p_mm: int(np.isfinite(p_mm).all(axis=1).sum()))


def _lost_stations(stream: _Stream, clock: Clock, stations: Stations, used: Index) -> list[str]:
    """Return a warning where many stations between the first and the last reading are lost."""
    first_s, last_s = clock.joints_s(stream.time_s[[0, -1]])
    read = np.flatnonzero((stations.start_s < last_s) & (stations.end_s > first_s))
    lost = np.setdiff1d(read, used)
    if len(lost) <= LOST * len(read):
        return []
    stand_s = float(np.median(stations.end_s[lost] - stations.start_s[lost]))
    return [
        f"{len(lost)} of the {len(read)} times at which the arm stood are lost: "
        f"fewer than {least_readings(stream.time_s)} readings of a target at rest lie there; "
        f"the arm stands for {stand_s:.1f} s there, and readings are "
        f"{stream.sampled_s[0]:.2g} s apart: let the arm stand longer, and check that the "
        "target is in sight and that neither clock was set in between"
    ]


def _lost_dwells(dwells: Stations, used: Mask, joints: str) -> list[str]:
    """Return a warning where no reading (N,) is `used` of many dwells of the target."""
    lost = np.setdiff1d(np.arange(len(dwells)), dwells.of_sample[used])
    if len(lost) <= LOST * len(dwells):
        return []
    return [
        f"{len(lost)} of the {len(dwells)} times at which the target was at rest are lost: "
        f"{joints} shows no stand of the arm then; check that it is of the whole run, and that "
        "neither clock was set in between"
    ]


def _of_motion(samples: Samples, at_rest: _AtRest) -> bool:
    """Return whether the joints' log is one of motion, not a list of poses."""
    return len(samples) >= DENSE * len(at_rest.target)


def _no_dwell(path: Path, rows: int, what: str) -> RawDataError:
    return RawDataError(
        what,
        where=str(path),
        value=f"{rows} rows",
        allowed="a log in which the arm stands at every pose for half a second and more",
        remedy="let the arm stand still at every pose while it is measured, and check the "
        "units of the time and of the positions",
    )
