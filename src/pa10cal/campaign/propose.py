"""A campaign.yaml for a file as it is, by its header, its numbers and the nominal arm."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.campaign.conventions import attitude_scatter, modelled_attitudes
from pa10cal.campaign.csv_rows import Layout, Sniffed
from pa10cal.campaign.description import SCHEMA
from pa10cal.campaign.own_columns import ANGLES, ISO, LENGTHS, RotationColumns
from pa10cal.campaign.raw_file import quaternions
from pa10cal.campaign.rows import in_radians
from pa10cal.errors import RawDataError
from pa10cal.frame.rigid_fit import scale_of_points

#: Conventions that three columns of an attitude may follow, the commonest first.
THREE = ("rpy", "euler_XYZ", "euler_ZYX", "euler_ZYZ", "fixed_zyx", "rotation_vector")
FOUR = ("quaternion_wxyz", "quaternion_xyzw")
#: Attitudes agree with the nominal arm within this; positions of a nominal arm scatter by less.
AGREES_RAD = np.radians(3.0)
#: Formats of dates and times that are tried.
TIMES = (
    *("%Y%m%d%H%M%S", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S"),
    *("%d/%m/%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p", "%H:%M:%S", "%H:%M:%S.%f"),
)
#: A date alone, and a time of day alone, which together are a time.
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?", re.I)
#: Rows that conventions are judged by.
JUDGED = 200
#: What is stated where the file says nothing.
ASSUMED_MM = 0.05


@dataclass(frozen=True)
class Proposal:
    """What campaign.yaml may say of a file."""

    content: dict[str, Any]  # of campaign.yaml
    checks: tuple[str, ...]  # what its reader should check or fill in, one sentence each


def propose(sniffed: Sniffed, file: str, name: str, robot: str, arm: Arm | None) -> Proposal:
    """Propose a campaign.yaml.

    Args:
        sniffed: the file.
        file: its name.
        name: name of the campaign.
        robot: name of the arm's description.
        arm: that arm; None where it is not known, then units and conventions rest on the header
            and on the size of the numbers alone.

    Raises:
        RawDataError: when no joint positions, or nothing that was measured, are recognised.
    """
    roles = roles_of(sniffed.names, None if arm is None else arm.n)
    _refuse_unrecognised(roles, sniffed, file)
    making = _Proposing(sniffed, roles, arm)
    columns = making.columns()
    kind = "pose" if "rotation" in columns else "distance" if "distance" in columns else "points"
    if arm is None:
        making.checks.append(
            "robot: name the arm, and run pa10cal columns again with --robot: units and the "
            "convention of attitudes are then found from its kinematics"
        )
    making.checks.append(
        "provenance and gravity_m_s2: state them; instrument.uncertainty_mm is "
        + ("that of the file" if making.stated_mm is not None else f"{ASSUMED_MM} mm, assumed")
    )
    making.checks.append(
        "tool: state its mass and centre of mass; a mass of 0 is one that is not known"
    )
    content = {
        "schema": SCHEMA,
        "name": name,
        "provenance": f"to be stated; read from {file}",
        "robot": robot,
        "instrument": {"kind": kind, "uncertainty_mm": making.stated_mm or ASSUMED_MM},
        "tool": {"mass_kg": 0.0, "com_mm": [0.0, 0.0, 0.0], "load_point_mm": [0.0, 0.0, 0.0]},
        "gravity_m_s2": [0.0, 0.0, -9.81],
        "reference_temperature_C": making.temperature_C,
        "files": {"poses": file},
        **({} if "kind" in columns else {"holdout": {"every": 5}}),
        "columns": {"poses": columns},
    }
    return Proposal(content, tuple(making.checks))


def follows_contract(sniffed: Sniffed) -> bool:
    """Return whether a file has the contract's own names and layout, and needs no mapping."""
    names = set(sniffed.names)
    labelled = {"time_s", "pose", "load_N", "repeat"} <= names and names & {"q1_deg", "q1_mm"}
    return sniffed.layout == Layout() and bool(labelled)


def _refuse_unrecognised(roles: Roles, sniffed: Sniffed, file: str) -> None:
    measured = bool(roles.positions) or "distance" in roles.single
    if roles.joints and measured:
        return
    raise RawDataError(
        "no joint positions were recognised"
        if not roles.joints
        else "no position and no distance was recognised",
        where=file,
        value=", ".join(sniffed.names),
        allowed="a column for each joint of the arm, such as q1, J1 or joint_1, and columns such "
        "as x, y, z",
        remedy="write columns.poses in campaign.yaml by hand, see docs/raw-data.md; column names "
        "may also be numbers",
    )


@dataclass
class _Proposing:
    """Decides, column by column, and keeps what its reader should check."""

    sniffed: Sniffed
    roles: Roles
    arm: Arm | None
    checks: list[str] = field(default_factory=list)
    stated_mm: float | None = None
    temperature_C: float = 20.0

    def columns(self) -> dict[str, Any]:
        """Return `columns.poses`."""
        layout, roles = self.sniffed.layout, self.roles
        word = {"\t": "tab", None: "blanks"}.get(layout.separator, layout.separator)
        found: dict[str, Any] = {"separator": word} if word != "," else {}
        found |= {"decimal": layout.decimal} if layout.decimal != "." else {}
        found |= {"header": layout.header} if layout.header != 1 else {}
        found |= self._time()
        for key in ("pose", "repeat"):
            found |= {key: roles.single[key]} if key in roles.single else {}
        found |= self._labels()
        angle, q_rad = self._joints()
        found["joints"] = {"names": list(roles.joints), **angle}
        if roles.torques:
            found["torques"] = {"names": list(roles.torques)}
        T_base_ee = None if self.arm is None else Chain.of(self.arm).forward(q_rad)
        found |= self._measured(T_base_ee)
        if "temperature" in roles.single:
            found["temperature"] = self._temperature(roles.single["temperature"])
        return found

    def _temperature(self, name: str) -> dict[str, str]:
        """Return the column of temperatures, and note a reference temperature."""
        values = self.sniffed.column(name)
        if not np.isfinite(values).any():
            return {"names": name}
        middle = float(np.nanmedian(values))
        unit = "K" if 220.0 < middle < 330.0 else "F" if 45.0 < middle < 110.0 else "C"
        of = {"K": middle - 273.15, "F": (middle - 32.0) / 1.8, "C": middle}
        self.temperature_C = round(of[unit], 1)
        return {"names": name, **({} if unit == "C" else {"unit": unit})}

    def _labels(self) -> dict[str, Any]:
        """Return which rows are held out, and their loads, where the file says so."""
        found: dict[str, Any] = {}
        single = self.roles.single
        if "kind" in single and {"grid", "holdout"} >= set(self.sniffed.words(single["kind"])):
            found["kind"] = {"names": single["kind"]}
        if "load" in single and np.isfinite(self.sniffed.column(single["load"])).all():
            found["load"] = {"names": single["load"]}
        return found

    def _time(self) -> dict[str, Any]:
        """Return the column of times, unless all rows have one and the same."""
        name = self.roles.single.get("time")
        if name is None:
            return {}
        words, numbers = self.sniffed.words(name), self.sniffed.column(name)
        names: str | list[str] = name
        if (pair := self._day_and_clock()) is not None:
            names, words = list(pair), self._joined(pair)
            numbers = np.full(len(words), np.nan)
        if len(set(words)) <= 1 or len(set(words)) < 0.01 * len(words):
            self.checks.append(
                f"time: {name} is the same in all rows, so rows are numbered instead"
            )
            return {}
        some = pd.Series(words[:JUDGED])
        digits = some.str.fullmatch(r"\d{14}").mean() > 0.9
        if np.isfinite(numbers).mean() > 0.9 and not digits:
            unit = unit_of(name)
            largest = float(np.nanmax(np.abs(numbers)))
            unit = unit if unit in ("s", "ms", "us") else "ms" if largest > 1e11 else "s"
            return {"time": {"names": name, **({} if unit == "s" else {"unit": unit})}}
        tried = {form: pd.to_datetime(some, format=form, errors="coerce") for form in TIMES}
        tried[ISO] = pd.to_datetime(some, format="ISO8601", errors="coerce", utc=True)
        read = {form: float(moments.notna().mean()) for form, moments in tried.items()}
        best = max(read, key=lambda form: read[form])
        if read[best] < 0.9:
            self.checks.append(f"time: the format of {name} was not recognised ({words[0]!r})")
            return {}
        return {"time": {"names": names, "format": best}}

    def _day_and_clock(self) -> tuple[str, str] | None:
        """Return a column of dates and one of times of day, where the file has them apart."""
        first = {name: self.sniffed.words(name)[0] for name in self.roles.times}
        days = [name for name, word in first.items() if _DAY.fullmatch(word)]
        clocks = [name for name, word in first.items() if _CLOCK.fullmatch(word)]
        return (days[0], clocks[0]) if days and clocks else None

    def _joined(self, names: Sequence[str]) -> list[str]:
        """Return rows of several columns as they are read: with a blank between."""
        return [" ".join(row) for row in zip(*map(self.sniffed.words, names), strict=True)]

    def _joints(self) -> tuple[dict[str, str], Array]:
        """Return the unit of joint positions, and these in radians (metres) of an arm."""
        names, logged = self.roles.joints, self.sniffed.columns(self.roles.joints)
        units = {unit_of(name) for name in names}
        if units <= {"rad", "radians"}:
            unit = "rad"
        elif units & {"deg", "degrees", "degree"}:
            unit = "deg"
        else:
            unit = "rad" if np.nanmax(np.abs(logged)) < 2.0 * np.pi + 0.1 else "deg"
            self.checks.append(f"joints.unit: {unit}, by the size of the numbers")
        found = {"unit": unit}
        slides = np.zeros(len(names), bool) if self.arm is None else self.arm.prismatic
        factor = np.full(len(names), ANGLES[unit])
        if slides.any():
            strokes = {unit_of(names[k]) for k in np.flatnonzero(slides)}
            large = bool(np.nanmax(np.abs(logged[:, slides])) > 5.0)
            stated = [each for each in LENGTHS if each in strokes]
            found["stroke_unit"] = stated[0] if stated else "mm" if large else "m"
            factor[slides] = LENGTHS[found["stroke_unit"]]
        return found, in_radians(logged * factor, slides)

    def _measured(self, T_base_ee: Array | None) -> dict[str, Any]:
        """Return the columns of what was measured."""
        single, positions = self.roles.single, self.roles.positions
        if not positions:
            name = single["distance"]
            unit = self._length(np.array([name]), self.sniffed.columns([name]), None)
            return {"distance": {"names": name, "unit": unit, **self._u([name], unit)}}
        still = standing({place: self.sniffed.columns(positions[place]) for place in positions})
        if still:
            self.checks.append(f"targets base1 …: {', '.join(still)} stand still, so on the base")
        positions = {place: positions[place] for place in positions if place not in still}
        place, names = next(iter(positions.items()))
        if self.roles.attitude is None and len(positions) > 1:
            return {"targets": self._targets(positions, T_base_ee) | self._base(still, T_base_ee)}
        p = self.sniffed.columns(names)
        unit = self._length(np.array(names), p, T_base_ee)
        if len(positions) > 1:
            self.checks.append(f"position: {', '.join(names)} taken, of {len(positions)} triples")
        position = {"names": list(names), "unit": unit, **self._u(names, unit)}
        if self.roles.attitude is None:
            return {"targets": {_label(place, 1): position} | self._base(still, T_base_ee)}
        turned = self._attitude(T_base_ee, 1e-3 * LENGTHS[unit] * p)
        base = {"targets": self._base(still, T_base_ee)} if still else {}
        return {"position": position, "rotation": turned, **base}

    def _base(self, still: Sequence[str], T_base_ee: Array | None) -> dict[str, Any]:
        found = self._targets({place: self.roles.positions[place] for place in still}, T_base_ee)
        return {f"base{k}": each for k, each in enumerate(found.values(), start=1)}

    def _targets(
        self, positions: Mapping[str, Sequence[str]], T_base_ee: Array | None
    ) -> dict[str, Any]:
        found = {}
        for k, (place, names) in enumerate(positions.items(), start=1):
            unit = self._length(np.array(names), self.sniffed.columns(names), T_base_ee)
            found[_label(place, k)] = {"names": list(names), "unit": unit, **self._u(names, unit)}
        return found

    def _length(self, names: NDArray[np.str_], p: Array, T_base_ee: Array | None) -> str:
        """Return the unit of lengths: of the names, by the arm, or by their size."""
        stated = {unit_of(str(name)) for name in names} & set(LENGTHS)
        if stated:
            return str(next(iter(stated)))
        seen = np.isfinite(p).all(axis=1)
        if T_base_ee is not None and p.shape[1] == 3:
            finite = seen & np.isfinite(T_base_ee).all(axis=(1, 2))
            scale = scale_of_points(p[finite], T_base_ee[finite])
            near = {unit: abs(np.log(scale / (1e-3 * mm))) for unit, mm in LENGTHS.items() if scale}
            best = min(near, key=lambda unit: near[unit], default=None)
            if best is not None and near[best] < np.log(1.5):
                return best
        far = np.abs(p[seen]).max(initial=0.0)  # of what stands still, too
        unit = "mm" if max(np.ptp(p[seen], axis=0).max(initial=0.0), 0.2 * far) > 20.0 else "m"
        self.checks.append(f"unit of {names[0]} …: {unit}, by the size of the numbers")
        return unit

    def _u(self, names: Sequence[str], unit: str) -> dict[str, Any]:
        """Return the columns of the uncertainties of lengths, and note their size."""
        uncertain = [self.roles.uncertain.get(name) for name in names]
        known = [name for name in uncertain if name is not None]
        if len(known) < len(names):
            return {}
        u_mm = LENGTHS[unit] * self.sniffed.columns(known)
        if np.isfinite(u_mm).any():
            self.stated_mm = float(f"{np.sqrt(np.nanmean(u_mm**2)):.2g}")
        return {"u": known}

    def _attitude(self, T_base_ee: Array | None, p_m: Array) -> dict[str, Any]:
        """Return the convention of an attitude: by the arm, else by the names."""
        assert self.roles.attitude is not None
        names, convention = self.roles.attitude
        values = self.sniffed.columns(names)
        largest = float(np.nanmax(np.abs(values)))
        stated = {unit_of(name) for name in names}
        units = ["rad"] if stated <= {"rad", "radians"} else ["deg"] if largest > 7.0 else []
        units = units or ["deg" if stated & {"deg", "degrees"} else "rad"]
        given = {"names": list(names)}
        turned = [self.roles.uncertain.get(name) for name in names]
        u = {"u": turned} if all(name is not None for name in turned) else {}
        angles = {"unit": units[0]} if len(names) == 3 else {}
        best: tuple[float, dict[str, Any]] | None = None
        if T_base_ee is not None:
            best = self._best(T_base_ee, p_m, values, given, angles)
        if best is None:
            self.checks.append(
                f"rotation.convention: {convention}, by the names alone; check it in the manual of "
                "the software that wrote the file"
            )
            return given | {"convention": convention} | angles | u
        scatter, chosen = best
        if scatter > AGREES_RAD:
            self.checks.append(
                f"rotation.convention: none agrees with the nominal arm; the nearest is "
                f"{np.degrees(scatter):.1f} deg off: check it, the joints' order and signs"
            )
        return chosen | u

    def _best(
        self,
        T_base_ee: Array,
        p_m: Array,
        values: Array,
        given: dict[str, Any],
        angles: dict[str, str],
    ) -> tuple[float, dict[str, Any]] | None:
        """Return the convention nearest to the nominal arm, and how far it is off [rad]."""
        good = np.isfinite(values).all(axis=1) & np.isfinite(p_m).all(axis=1)
        good &= np.isfinite(T_base_ee).all(axis=(1, 2))
        rows = np.flatnonzero(good)
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), JUDGED)).astype(int)]
        R_ee = modelled_attitudes(T_base_ee[rows], p_m[rows])
        if R_ee is None:
            return None
        words = {3: THREE, 4: FOUR, 9: ("matrix",)}[values.shape[1]]
        tried: list[tuple[float, dict[str, Any]]] = []
        for inverse in (False, True):
            for word in words:
                chosen = given | {"convention": word} | angles
                chosen |= {"inverse": True} if inverse else {}
                turned = quaternions(values[rows], RotationColumns.model_validate(chosen))
                R = Rotation.from_quat(turned, scalar_first=True).as_matrix()
                tried.append((attitude_scatter(R_ee, R), chosen))
        # The first of equals: the plainest.
        return min(tried, key=lambda each: round(each[0], 3), default=None)


def _label(place: str, k: int) -> str:
    """Return a name for a target, of what stands before its x, y, z."""
    label = "".join(letter for letter in place if letter.isascii() and letter.isalnum())
    return label if label not in ("", "u") else f"T{k}"


def label_of(path: Path) -> str:
    """Return a name for a campaign, of that of a file or folder."""
    stem = path.name.partition(".")[0]
    letters = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in stem)
    return letters.strip("-_") or "mine"


# What the columns of an unknown file may be, by their names.

#: Targets that move by less than this part of what others do stand still.
_STILL = 0.02
#: Words of columns that hold what was commanded, and of uncertainties.
_COMMANDED = re.compile(r"goal|target|command|cmd|nominal|nom\b|setpoint|desired|soll|ref", re.I)
_UNCERTAIN = re.compile(r"std|sigma|uncert|unc\b|stdev|(^|_)u_|(^|[ _])s[xyz]", re.I)
_UNIT = re.compile(
    r"[\[(/ _.-]*[\[(/_ ](rad|radians|deg|degrees|degree|mm|cm|um|m|in|nm|n\.m|n|c|k|f|s|ms|us)"
    r"[\])]?$",
    re.I,
)
_TORQUE = re.compile(r"tau|torque|effort|moment|drehmoment", re.I)
_JOINT = re.compile(r"joint|axis|achse|gelenk", re.I)
_NUMBERED = re.compile(r"(?:^|[^a-z])(q|j|a|axis|joint|theta|th|jnt|achse|pos)[ _.-]?(\d)\b", re.I)
#: Endings of the columns of an attitude, and the convention that the names alone suggest.
_ATTITUDES = (
    (("qw", "qx", "qy", "qz"), "quaternion_wxyz"),
    (("q0", "q1", "q2", "q3"), "quaternion_wxyz"),
    (("qx", "qy", "qz", "qw"), "quaternion_xyzw"),
    (("roll", "pitch", "yaw"), "rpy"),
    (("rx", "ry", "rz"), "rpy"),
    (("rotx", "roty", "rotz"), "rpy"),
    (("w", "p", "r"), "rpy"),
    (("a", "b", "c"), "euler_ZYX"),
    (("o", "a", "t"), "euler_ZYZ"),
    (tuple(f"r{i}{j}" for i in "123" for j in "123"), "matrix"),
    (tuple(f"r{i}{j}" for i in "012" for j in "012"), "matrix"),
)
#: What stands before x, y, z without anything between.
_RUN_ON = ("p", "t", "pos", "tcp", "trans")
_SINGLE = {
    "temperature": re.compile(r"temp", re.I),
    "time": re.compile(r"time|stamp|date|zeit|datum|^t$", re.I),
    "load": re.compile(r"load|payload|last\b", re.I),
    "pose": re.compile(r"^(pose|label|point|name|id|punkt)$", re.I),
    "repeat": re.compile(r"^(repeat|run|cycle)$", re.I),
    "kind": re.compile(r"^(kind|set|split)$", re.I),
    "distance": re.compile(r"dist|range", re.I),
}


@dataclass(frozen=True)
class Roles:
    """Names of columns by what they may be."""

    joints: tuple[str, ...]  # in order; empty where none were recognised
    torques: tuple[str, ...]  # likewise
    # triples by what stands before x, y, z, those of commands last
    positions: dict[str, tuple[str, ...]]
    # columns, and the convention that the names suggest; None where there is none
    attitude: tuple[tuple[str, ...], str] | None
    uncertain: dict[str, str]  # uncertainties by the column that they are of
    single: dict[str, str]  # further columns, by the key of `columns`
    times: tuple[str, ...] = ()  # every column that may hold a date or a time of day


def roles_of(names: Sequence[str], joints: int | None) -> Roles:
    """Return what columns may be.

    Args:
        names: of all columns.
        joints: how many joints the arm has; None where that is not known.
    """
    certain = [name for name in names if not _UNCERTAIN.search(name)]
    turns = _joints([name for name in certain if not _TORQUE.search(name)], joints)
    torques = _joints([name for name in certain if _TORQUE.search(name)], joints)
    rest = [name for name in certain if name not in {*turns, *torques}]
    attitude = _attitude(rest)
    rest = [name for name in rest if attitude is None or name not in attitude[0]]
    positions = dict(_positions(rest))
    taken = {name for triple in positions.values() for name in triple}
    single = {}
    for key, like in _SINGLE.items():
        found = next((name for name in rest if like.search(name) and name not in taken), None)
        if found is not None:
            single[key] = found
            taken.add(found)
    times = tuple(
        name
        for name in rest
        if _SINGLE["time"].search(name) and name not in taken - {single.get("time")}
    )
    return Roles(turns, torques, positions, attitude, _uncertain(names), single, times)


def unit_of(name: str) -> str | None:
    """Return the unit that stands in a name, in lower case; None where there is none."""
    found = _UNIT.search(name)
    return found[1].lower() if found else None


def _bare(name: str) -> str:
    return _UNIT.sub("", name.strip()).strip()


def _joints(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return columns of joints: numbered ones from 1 (or 0), or such as are called joints."""
    numbered: dict[str, dict[int, str]] = {}
    for name in names:
        if (found := _NUMBERED.search(_bare(name))) is not None:
            stem = _bare(name)[: found.start(2)].lower()
            numbered.setdefault(stem, {})[int(found[2])] = name
    best: tuple[str, ...] = ()
    for listed in numbered.values():
        start = 0 if 0 in listed else 1
        found_ones: list[str] = []
        while start + len(found_ones) in listed:
            found_ones.append(listed[start + len(found_ones)])
        best = max(best, tuple(found_ones), key=lambda each: (_fits(each, joints), len(each)))
    called = tuple(name for name in names if _JOINT.search(name))
    best = max(best, called, key=lambda each: (_fits(each, joints), len(each)))
    return best if len(best) >= 2 and (joints is None or len(best) == joints) else ()


def _fits(names: Sequence[str], joints: int | None) -> bool:
    return joints is None or len(names) == joints


def _attitude(names: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return the columns of an attitude, measured rather than commanded."""
    for commanded in (False, True):
        some = [name for name in names if bool(_COMMANDED.search(name)) == commanded]
        for endings, convention in _ATTITUDES:
            for stem in _stems(some, endings[0]):
                found = [_ending(some, stem, ending) for ending in endings]
                if all(each is not None for each in found):
                    order = sorted((str(each) for each in found), key=names.index)
                    if convention.startswith("quaternion"):
                        first = "w" if order[0] == found[endings.index(_scalar(endings))] else "x"
                        convention = "quaternion_wxyz" if first == "w" else "quaternion_xyzw"
                        return tuple(order), convention
                    return tuple(str(each) for each in found), convention
    return None


def _scalar(endings: Sequence[str]) -> str:
    return "qw" if "qw" in endings else "q0"


def _stems(names: Sequence[str], ending: str) -> Iterator[str]:
    """Yield what stands before an ending; a single letter stands apart, but in `px` or `tx`."""
    for name in names:
        bare = _bare(name).lower()
        before = bare.removesuffix(ending)
        apart = not before[-1:].isalnum() or before in _RUN_ON
        if before != bare and (len(ending) > 1 or apart):
            yield before


def _ending(names: Sequence[str], stem: str, ending: str) -> str | None:
    return next((name for name in names if _bare(name).lower() == stem + ending), None)


def _positions(names: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield triples of coordinates by what stands before x, y, z; commanded ones last."""
    for commanded in (False, True):
        some = [name for name in names if bool(_COMMANDED.search(name)) == commanded]
        for stem in dict.fromkeys(_stems(some, "x")):
            found = [_ending(some, stem, f"{axis}") for axis in "xyz"]
            if all(each is not None for each in found):
                triple = tuple(str(each) for each in found)
                yield triple[0][: len(stem)], triple


def _uncertain(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of uncertainties by the one that each is of."""
    plain = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in names}
    found = {}
    for name in names:
        if _UNCERTAIN.search(name):
            without = re.sub(r"std(ev)?|sigma|uncert(ainty)?|unc|(?:^|_)u_", "", name, flags=re.I)
            of = plain.get(re.sub(r"[^a-z0-9]", "", without.lower()))
            if of is not None and of != name:
                found[of] = name
    return found


def standing(positions: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return which of several positions (N, 3) hardly move, by what stands before their x, y, z."""
    spread = {
        place: float(np.max(np.nanmax(p, axis=0) - np.nanmin(p, axis=0)))
        for place, p in positions.items()
        if np.isfinite(p).any(axis=0).all()
    }
    most = max(spread.values(), default=0.0)
    return [place for place, size in spread.items() if size < _STILL * most]
