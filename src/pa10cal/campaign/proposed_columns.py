"""The columns of one file as campaign.yaml should state them: units, conventions, labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.column_map import (
    ANGLES,
    COUNTS,
    FORCES,
    JOINT_ANGLES,
    LENGTHS,
    TEMPERATURES,
    TIMES,
    TORQUES,
)
from pa10cal.campaign.column_names import WORDS, coverage_of, plain, unit_of
from pa10cal.campaign.conventions import (
    FOUR,
    THREE,
    attitude_misfit,
    modelled_attitudes,
    read_polar,
)
from pa10cal.campaign.csv_rows import same_name
from pa10cal.campaign.file_roles import orientation_not_read
from pa10cal.campaign.inverse_poses import way_of_inverse_poses
from pa10cal.campaign.joint_positions import (
    CountScale,
    in_radians,
    looks_like_counts,
    scale_of_counts,
)
from pa10cal.campaign.numbered_columns import beyond
from pa10cal.campaign.own_columns import RotationColumns
from pa10cal.campaign.raw_file import quaternions
from pa10cal.campaign.recognise import Roles, from_horizon, standing
from pa10cal.campaign.row_targets import (
    target_column,
    target_columns_not_used,
    target_names,
)
from pa10cal.campaign.screens import not_detected
from pa10cal.campaign.sniffing import JUDGED, Sniffed, time_columns
from pa10cal.errors import RawDataError
from pa10cal.frame.target_problem import scale_of_points

#: Orientations agree with the nominal arm if half of them are off by less than this angle.
AGREES_RAD = np.radians(3.0)
#: Above this none is nearer than another, as of orientations drawn at random: names decide.
_ALL_ALIKE_RAD = np.radians(90.0)
#: Larger positions are no radians.
_TURN_RAD = 2.0 * np.pi + 0.1
#: Polar readings agree with the nominal arm below this rms misfit; rows of one pose are nearer.
AGREES_M = 0.03
#: Labels that several rows have, at least, and the part of them whose rows are apart, where these
#: number rows.
_LEAST_REPEATED, _NEARLY_ALL = 5, 0.9


@dataclass
class ProposedColumns:
    """Decides on `columns` of one file, by quantity, and notes what the user should check.

    Units are those stated in or below the names of the columns, else found by the nominal arm, else
    by the size of the numbers.
    """

    sniffed: Sniffed
    roles: Roles
    arm: Arm | None
    checks: list[str] = field(default_factory=list)
    whole_labels: bool = False  # whether another log has the labels of this one as they are
    stated_mm: float | None = None  # rms standard uncertainty that the file states
    signs: tuple[int, ...] = ()  # of the joints, for `joint_signs`; empty where none is reversed
    temperature_C: float = 20.0  # for `reference_temperature_C`
    T_base_ee: Array | None = None  # (N, 4, 4) nominal end in each row, if the file has joints

    def joints(self) -> dict[str, Any]:
        """Return the layout of the file, its labels, joints, torques and temperature."""
        names = self.roles.joints
        logged = self.sniffed.columns(names)
        slides = np.zeros(len(names), bool) if self.arm is None else self.arm.axes_slide
        columns = self._labels()
        self.checks += _notes_on_joints(self.sniffed, names)
        unit = self._unit_of_angles(logged, slides)
        columns["joints"] = {"names": list(names), "unit": unit}
        factor = np.full(len(names), JOINT_ANGLES.get(unit, 1.0))
        if unit == COUNTS:
            scale = self._scale_of_counts(logged, slides)
            columns["joints"] |= {"counts_per_turn": scale.per_turn, "zero_count": scale.zero}
            logged[:, ~slides] = scale.degrees(logged)[:, ~slides]
        if slides.any():
            size = "mm" if np.nanmax(np.abs(logged[:, slides])) > 5.0 else "m"
            strokes = [name for name, slide in zip(names, slides, strict=True) if slide]
            stroke_unit = self._stated(strokes, LENGTHS) or size
            columns["joints"]["stroke_unit"] = stroke_unit
            factor[slides] = LENGTHS[stroke_unit]
        columns |= self._torques()
        if self.arm is not None:
            q = self.arm.coupling.to_joints(in_radians(logged * factor, slides))
            self.T_base_ee = Chain.of(self.arm).forward(q)
        return columns | self._temperatures()

    def _unit_of_angles(self, logged: Array, slides: Mask) -> str:
        """Return the unit of the joints (N, n) that turn: of angles, or counts of encoders."""
        names = zip(self.roles.joints, slides, strict=True)
        turns = [name for name, slide in names if not slide]
        if unit := self._stated(turns, {**JOINT_ANGLES, COUNTS: 1.0}):
            return unit
        if turns and looks_like_counts(logged[:, ~slides]):
            return COUNTS
        # Joints turn by little more than one turn either way, and by two turns at the most.
        largest = np.nanmax(np.abs(logged[:, ~slides]), initial=0.0)
        unit = "rad" if largest < 2.0 * np.pi + 0.1 else "deg" if largest < 760.0 else "mrad"
        self.checks.append(f"joints.unit: {unit}, by the size of the numbers")
        return unit

    def _torques(self) -> dict[str, Any]:
        """Return the columns of torques, if there are any."""
        names = self.roles.torques
        if not names:
            return {}
        unit = self._stated(names, TORQUES)
        if unit is None:
            self.checks.append(
                f"torques.unit: Nm, assumed; if {names[0]} … are currents of the motors, "
                "remove torques"
            )
        return {"torques": {"names": list(names)} | _unless(unit or "Nm", "Nm")}

    def _scale_of_counts(self, logged: Array, slides: Mask) -> CountScale:
        """Return how counts (N, n) are read, and note it for a check."""
        places = list(self.roles.positions.values())
        p_m = None
        if places and self.arm is not None and not slides.any():
            p = self.sniffed.columns(places[0])
            p_m = 1e-3 * LENGTHS[self._stated(places[0], LENGTHS) or _unit_by_size(p)] * p
        scale = scale_of_counts(logged, self.arm, p_m)
        by = "the nominal arm agrees so" if np.isfinite(scale.misfit_m) else "by the numbers alone"
        self.checks.append(
            f"joints.counts_per_turn: {scale.per_turn:.10g} counts of the encoder a turn of the "
            f"joint, {scale.zero:g} at its zero, {by}"
        )
        if -1 in scale.signs:
            self.signs = scale.signs
            self.checks.append("joint_signs: the nominal arm agrees with these directions")
        return scale

    def readings(self, T_base_ee: Array | None) -> dict[str, Any]:
        """Return what was measured and the temperature; without joints, layout and labels too.

        The nominal end in each row is T_base_ee (N, 4, 4); None where it is not known.
        """
        labels = {} if self.roles.joints else self._labels()
        return labels | self._measured(T_base_ee) | self._temperatures()

    def _stated(self, names: Sequence[str], known: Mapping[str, float]) -> str | None:
        """Return the unit that columns state in or below their names; None for none."""
        titles = list(map(self.sniffed.titled, names))
        units = list(dict.fromkeys(unit for unit in map(unit_of, titles) if unit in known))
        if len(units) > 1:
            raise RawDataError(
                "columns of one quantity are in different units",
                where=self.sniffed.file,
                value=", ".join(titles),
                allowed=f"one unit of {', '.join(known)} for all of them",
                remedy=f"export them all in {units[0]}, or convert those in {units[1]} and name "
                "them so",
            )
        return next(iter(units), None)

    def _temperatures(self) -> dict[str, Any]:
        """Return the column of temperature, and set the reference temperature."""
        name = self.roles.single.get("temperature")
        if name is None:
            return {}
        values, column = self.sniffed.column(name), {"names": name}
        if np.isfinite(values).any():
            middle = float(np.nanmedian(values))
            by_size = "K" if 220.0 < middle < 330.0 else "F" if 45.0 < middle < 110.0 else "C"
            unit = self._stated([name], TEMPERATURES) or by_size
            in_C = {"K": middle - 273.15, "F": (middle - 32.0) / 1.8, "C": middle}
            self.temperature_C = round(in_C[unit], 1)
            column |= _unless(unit, "C")
        return {"temperature": column}

    def _labels(self) -> dict[str, Any]:
        """Return layout, time, pose, repeat, kind and load, where every row states them."""
        single, sniffed = self.roles.single, self.sniffed
        columns: dict[str, Any] = sniffed.layout.model_dump(exclude_defaults=True)
        columns |= self._time()
        labels = sniffed.words(single["pose"]) if "pose" in single else [""]
        if all(labels) and len(set(labels)) > 1:  # one word in all rows is no label
            numbers = sniffed.column(single["pose"])
            # Numbers with decimals are no labels, such as actual_TCP_pose_0.
            if np.mean(np.isfinite(numbers) & (numbers != np.round(numbers))) < 0.5:
                columns["pose"] = single["pose"]
        if "repeat" in single and np.isfinite(sniffed.column(single["repeat"])).all():
            columns["repeat"] = single["repeat"]
        if "kind" in single:
            known = {word: kind for kind, text in WORDS["kinds"].items() for word in text.split()}
            stands = {word: known.get(plain(word)) for word in set(sniffed.words(single["kind"]))}
            if all(stands.values()):
                own = {word: kind for word, kind in sorted(stands.items()) if word != kind}
                columns["kind"] = {"names": single["kind"], **({"words": own} if own else {})}
        if "load" in single and np.isfinite(sniffed.column(single["load"])).all():
            unit = self._stated([single["load"]], FORCES) or "N"
            columns["load"] = {"names": single["load"]} | _unless(unit, "N")
        return columns

    def _time(self) -> dict[str, Any]:
        """Return the column of time, or those of date and time of day, if the times differ."""
        name = self.roles.single.get("time")
        if name is None:
            return {}
        columns, check = time_columns(
            self.sniffed, name, self.roles.times, self._stated([name], TIMES)
        )
        self.checks += [check] if check else []
        return columns

    def names_of_time(self) -> tuple[str, ...]:
        """Return the columns that are read as the time."""
        names = self._time().get("time", {}).get("names", ())
        return (names,) if isinstance(names, str) else tuple(names)

    def _measured(self, T_base_ee: Array | None) -> dict[str, Any]:
        """Return the columns of what was measured, and note an orientation that is not read."""
        if unread := orientation_not_read(self.sniffed, self.roles):
            read = self.roles.attitude
            taken = "" if read is None else f"{', '.join(read[0])} taken; "
            seem = "seems" if len(unread) == 1 else "seem"
            what = "an" if read is None else "another"
            self.checks.append(
                f"rotation: {taken}{', '.join(unread)} {seem} to hold {what} orientation, which is "
                "not read: if it is that of the target, name its columns, a number in each, under "
                "rotation"
            )
        single, every = self.roles.single, self.roles.positions
        if not every:
            name = single["distance"]
            return {"distance": self._place([name], None) | {"names": name}}
        still = standing({place: self.sniffed.columns(every[place]) for place in every})
        if still:
            self.checks.append(f"targets base1 …: {', '.join(still)} stand still, so on the base")
        positions = {place: names for place, names in every.items() if place not in still}
        place, names = next(iter(positions.items()))
        attitude = self.roles.attitude
        if attitude is None and len(positions) > 1:
            called = target_names(list(positions))
            targets = {
                called[place]: self._place(names, T_base_ee) for place, names in positions.items()
            }
        else:
            position = self._place(names, T_base_ee)
            if attitude is None and names != self.roles.polar:
                p_m = 1e-3 * LENGTHS[position["unit"]] * self.sniffed.columns(names)
                of_row = target_column(
                    self.sniffed, self.roles, p_m, T_base_ee, whole_labels=self.whole_labels
                )
                if of_row is not None and not still:
                    return {"position": position} | self._of_row(of_row)
                if of_row is None:
                    self.checks += target_columns_not_used(self.sniffed, self.roles)
            if len(positions) > 1:
                self.checks.append(
                    f"position: {', '.join(names)} taken, of {len(positions)} triples"
                )
            targets = {target_names([place])[place]: position} if attitude is None else {}
        columns: dict[str, Any] = {}
        if attitude is not None:
            p_m = 1e-3 * LENGTHS[position["unit"]] * self.sniffed.columns(names)
            columns = {"position": position, "rotation": self._attitude(*attitude, T_base_ee, p_m)}
        base = [self._place(every[place], T_base_ee) for place in still]
        targets |= {f"base{k}": place for k, place in enumerate(base, start=1)}
        return columns | ({"targets": targets} if targets else {})

    def places_m(self, T_base_ee: Array) -> dict[tuple[str, ...], Array]:
        """Return the places (N, 3) [m] that move, by their columns; with an orientation its own.

        The nominal end in each row is T_base_ee (N, 4, 4). None are returned of polar readings.
        """
        if self.roles.polar is not None:
            return {}
        quiet = replace(self, checks=[])
        every = list(self.roles.positions.values())[: None if self.roles.attitude is None else 1]
        still = standing({str(k): self.sniffed.columns(names) for k, names in enumerate(every)})
        moving = [names for k, names in enumerate(every) if str(k) not in still]
        units = [quiet._place(names, T_base_ee)["unit"] for names in moving]
        return {
            names: 1e-3 * LENGTHS[unit] * self.sniffed.columns(names)
            for names, unit in zip(moving, units, strict=True)
        }

    def without_numbers_of_rows(
        self, columns: Mapping[str, Any], T_base_ee: Array | None
    ) -> dict[str, Any]:
        """Return `pose` as None, and note it, where it numbers rows and starts again.

        Then the rows of one number have other joints: at their nominal ends (N, 4, 4) they are
        apart.
        """
        name = columns.get("pose")
        if name is None or T_base_ee is None or "target" in columns:
            return {}
        known = np.isfinite(T_base_ee).all(axis=(1, 2))
        place = pd.DataFrame(T_base_ee[known, :3, 3], columns=list("xyz"))
        labels = np.array(self.sniffed.words(name))[known]
        groups = place.groupby(labels)
        apart_m = (groups.max() - groups.min()).max(axis=1)[groups.size() > 1]
        if len(apart_m) < _LEAST_REPEATED or float(np.mean(apart_m > AGREES_M)) < _NEARLY_ALL:
            return {}
        self.checks.append(
            f"pose: {self.sniffed.titled(name)} starts again, and rows of one number have other "
            "joints: it numbers rows, and is not read"
        )
        return {"pose": None}

    def _of_row(self, target: dict[str, Any]) -> dict[str, Any]:
        """Return `target` (and `pose`) for rows of one target each, and note it."""
        listed = ", ".join((target.get("words") or target["endings"]).values())
        name = target["names"]
        self.checks.append(
            f"target: every row is of one target, by {self.sniffed.titled(name)}: {listed}"
        )
        columns: dict[str, Any] = {"target": target}
        if "endings" in target:
            columns["pose"] = name
        elif self.roles.single.get("pose") == name:
            columns["pose"] = None  # it names targets, not poses
        return columns

    def _place(self, names: Sequence[str], T_base_ee: Array | None) -> dict[str, Any]:
        """Return columns of lengths with unit and uncertainties, and set `stated_mm`.

        The unit is stated in the names, else found by the arm, else by the size of the numbers.
        """
        if names == self.roles.polar:
            return self._polar(names, T_base_ee)
        unit = self._stated(names, LENGTHS) or self._unit_of_lengths(names, T_base_ee)
        columns: dict[str, Any] = {"names": list(names), "unit": unit}
        stated, deviations = self.roles.deviations or ((), ())
        if names == stated:
            columns["deviation"] = list(deviations)
            deviation_unit = self._stated(deviations, LENGTHS)
            if deviation_unit not in (None, unit):
                columns["deviation_unit"] = deviation_unit
        u = [self.roles.uncertain[name] for name in names if name in self.roles.uncertain]
        if len(u) < len(names):
            return columns
        titles = list(map(self.sniffed.titled, u))
        coverage = coverage_of(titles[0])
        u_unit = next((own for own in map(unit_of, titles) if own in LENGTHS), unit)
        u_mm = LENGTHS[u_unit] / coverage * self.sniffed.columns(u)
        if np.isfinite(u_mm).any():
            self.stated_mm = float(f"{np.sqrt(np.nanmean(u_mm**2)):.2g}")
        columns["u"] = u
        if u_unit != unit:
            columns["u_unit"] = u_unit
        if coverage != 1.0:
            columns["coverage"] = coverage
            self.checks.append(f"coverage: {titles[0]} … are divided by {coverage:g}, as they say")
        if len(u) > len(set(u)):
            self.checks.append(f"u: {titles[0]} is taken for each of x, y and z")
        return columns

    def _polar(self, names: Sequence[str], T_base_ee: Array | None) -> dict[str, Any]:
        """Return columns of polar readings, which count as the arm or else their names say."""
        unit = self._stated(names[2:], LENGTHS)
        angle = self._stated(names[:2], ANGLES)
        found = read_polar(
            self.sniffed.columns(names),
            [angle] if angle else list(ANGLES),
            unit,
            T_base_ee,
            by_horizon=from_horizon(names[1]),
        )
        if found.median_m is None:
            self.checks.append("polar: how the angles count is by the names alone; check it")
        elif found.median_m > AGREES_M:
            self.checks.append(
                f"polar: no way of counting the angles agrees with the nominal arm; the nearest is "
                f"{1e3 * found.median_m:.0f} mm off: check units, the joints' order and signs"
            )
        return {"names": list(names), "unit": found.length, "polar": found.polar.model_dump()}

    def _unit_of_lengths(self, names: Sequence[str], T_base_ee: Array | None) -> str:
        p = self.sniffed.columns(names)
        seen = np.isfinite(p).all(axis=1)
        if T_base_ee is not None and p.shape[1] == 3:
            finite = seen & np.isfinite(T_base_ee).all(axis=(1, 2))
            scale = scale_of_points(p[finite], T_base_ee[finite])
            near = {unit: abs(np.log(scale / (1e-3 * mm))) for unit, mm in LENGTHS.items() if scale}
            best = min(near, key=lambda unit: near[unit], default=None)
            if best is not None and near[best] < np.log(1.5):
                return best
        unit = _unit_by_size(p)
        self.checks.append(f"unit of {names[0]} …: {unit}, by the size of the numbers")
        return unit

    def _attitude(
        self, names: Sequence[str], convention: str, T_base_ee: Array | None, p_m: Array
    ) -> dict[str, Any]:
        """Return the columns of an orientation, in the convention by the arm, else by the names."""
        values = self.sniffed.columns(names)
        size = "deg" if float(np.nanmax(np.abs(values))) > 7.0 else "rad"
        unit = self._stated(names, ANGLES) or size
        given: dict[str, Any] = {"names": list(names)}
        angles = {"unit": unit} if len(names) == 3 else {}
        uncertain = [self.roles.uncertain.get(name) for name in names]
        u = {"u": uncertain} if all(name is not None for name in uncertain) else {}
        R_ee = None
        if T_base_ee is not None:
            known = np.column_stack([values, p_m, T_base_ee.reshape(-1, 16)])
            some = np.flatnonzero(np.isfinite(known).all(axis=1) & ~not_detected(p_m))
            some = some[np.linspace(0, len(some) - 1, min(len(some), JUDGED)).astype(int)]
            # Lengths may have another scale, as of a tag taken for another size.
            scale = scale_of_points(p_m[some], T_base_ee[some]) or 1.0
            R_ee = modelled_attitudes(T_base_ee[some], scale * p_m[some])
        if T_base_ee is None or R_ee is None:
            self.checks.append(
                f"rotation.convention: {convention}, by the names alone; check it in the manual of "
                "the software that wrote the file"
            )
            return given | {"convention": convention} | angles | u
        words = {3: THREE, 4: FOUR, 9: ("matrix",)}[len(names)]
        ways = [given | {"convention": word} | angles for word in words]
        tried = []  # misfit to the nominal arm, and the way of reading
        for way in (*ways, *(way | {"inverse": True} for way in ways)):
            quaternion = quaternions(values[some], RotationColumns.model_validate(way))
            R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
            tried.append((attitude_misfit(R_ee, R), way))
        # Of equal misfits the first, which is the commonest convention.
        misfit, chosen = min(tried, key=lambda way: round(way[0].mean_rad, 3))
        off_rad = misfit.median_rad
        if off_rad > AGREES_RAD:
            inverse = [way | {"inverse": "pose"} for way in ways]
            of_pose = way_of_inverse_poses(T_base_ee[some], p_m[some], values[some], inverse)
            if of_pose is not None:
                self.checks.append("rotation.inverse: pose: position too; only so the arm agrees")
                return {**of_pose, **u}
            if off_rad > _ALL_ALIKE_RAD:
                chosen = given | {"convention": convention} | angles
            self.checks.append(
                f"rotation.convention: none agrees with the nominal arm; the nearest is "
                f"{np.degrees(off_rad):.1f} deg off: check it, the joints' order and signs"
            )
        return chosen | u


def _unless(unit: str, usual: str) -> dict[str, str]:
    """Return the key `unit`, unless the unit is the default."""
    return {} if unit == usual else {"unit": unit}


def _unit_by_size(p: Array) -> str:
    """Return the unit of positions (N, k) of a target by their size: metres or millimetres."""
    seen = np.isfinite(p).all(axis=1)
    far = np.abs(p[seen]).max(initial=0.0)  # for a target at rest, too
    extent = np.ptp(p[seen], axis=0).max() if seen.any() else 0.0
    return "mm" if max(extent, 0.2 * far) > 20.0 else "m"


def _notes_on_joints(sniffed: Sniffed, joints: Sequence[str]) -> list[str]:
    """Return what the user should check of the columns chosen for joints."""
    every = sniffed.titles or sniffed.names
    titled = [every[sniffed.names.index(name)] for name in joints]
    first = titled[0].partition(" (")[0]
    same = [k for k in range(1, len(every)) if same_name(first, k) in every]
    found = []
    if more := beyond(every, titled):
        found.append(
            f"joints: the arm has {len(joints)}, so {', '.join(more)} is not read: a gripper, or "
            "an outer axis? if it is an axis of the arm, name another arm"
        )
    largest = np.nanmax(np.abs(sniffed.columns(joints)), initial=0.0)
    if all(name.endswith(".pos") for name in titled) and _TURN_RAD < largest <= 100.0:
        found.append(
            f"joints: {titled[0]} … lie within -100 to 100: LeRobot writes percents of each "
            "joint's range so, which are no angles; log degrees (use_degrees)"
        )
    if len(same) > 1:
        found.append(
            f"joints: {titled[0]} is there {len(same)} times, of several arms perhaps; "
            f"{titled[0]} to {titled[-1]} is read: name others where the arm is another one"
        )
    return found
