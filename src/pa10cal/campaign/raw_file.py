"""A raw file under the contract's own names, or read as it is by `columns` of campaign.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.campaign.bounds import rule_of
from pa10cal.campaign.csv_rows import CONTRACT, Layout, column_names, read_rows
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription, check_joints
from pa10cal.campaign.own_columns import FileColumns, Polar, RotationColumns, TargetOfRow, Time
from pa10cal.campaign.raw_rows import (
    ANGLES,
    ANGLES_OF_POLAR,
    CONTRACT_COLUMNS,
    LENGTHS,
    QUATERNION,
    TEXT,
    ColumnMap,
    OwnColumn,
    RawRows,
    position_columns,
    same_commands,
)
from pa10cal.campaign.sniffing import ISO, moments_of
from pa10cal.errors import RawDataError

#: Least standard uncertainty of a component of a quaternion that follows from stated ones.
LEAST_U = 1e-9
#: What a file with names of its own need not have: rows are numbered, loads are 0, and equal joint
#: positions are repeats of one pose.
FILLED = {
    "poses": ("time_s", "load_N", "pose", "repeat"),
    "cmm": ("load_N", "repeat", "touch"),
}


@dataclass(frozen=True)
class RawFile:
    """A raw file of a campaign."""

    path: Path  # where it is
    key: str  # what campaign.yaml calls it: poses, cmm, resolver, joints or readings
    prismatic: NDArray[np.bool_]  # (n,) which joints of the arm slide
    columns: FileColumns | None = None  # what its columns are; None where it follows the contract
    signs: tuple[int, ...] | None = None  # `joint_signs` of campaign.yaml
    offsets_deg: tuple[float, ...] | None = None  # `joint_offsets_deg`

    @classmethod
    def of(
        cls, campaign: CampaignDescription, folder: Path, key: str, prismatic: NDArray[np.bool_]
    ) -> RawFile:
        """Return a file that campaign.yaml names."""
        columns = None if campaign.columns is None else getattr(campaign.columns, key)
        check_joints(campaign, len(prismatic), str(folder / DESCRIPTION_FILE))
        path = folder / str(getattr(campaign.files, key))
        signs, offsets_deg = campaign.joint_signs, campaign.joint_offsets_deg
        return cls(path, key, prismatic, columns, signs, offsets_deg)

    @property
    def in_degrees(self) -> Sequence[str]:
        """Return the columns of angles of orientations that are said to be in degrees."""
        turned = None if self.columns is None else self.columns.rotation
        angles = turned is not None and len(turned.names) == 3 and turned.unit == "deg"
        return turned.names if turned is not None and angles else ()

    @property
    def names(self) -> list[str]:
        """Return the columns of the contract that the file has, or stands for."""
        if self.columns is not None:
            return list(self.words.sources)
        return column_names(self.path, within=self.path.parent)

    @cached_property
    def words(self) -> ColumnMap:
        """Return what the columns of the file are; empty without `columns`.

        Lists of names that are too long or too short, and columns mapped to two quantities, are
        refused.
        """
        columns, where = self.columns, f"columns.{self.key}"
        if columns is None:
            return CONTRACT_COLUMNS
        at, joints = f"{self.path.parent / DESCRIPTION_FILE}: {where}", len(self.prismatic)
        of_arm = (joints, "one for each joint of the arm")
        expected = {"joints": of_arm, "torques": of_arm}
        if columns.rotation is not None:
            word = columns.rotation.convention
            expected["rotation"] = COLUMNS.get(word, 3), f"as {word} has"
        for key, (count, why) in expected.items():
            for part in ("names", "u"):
                names = getattr(getattr(columns, key), part, None)
                if names is not None and len(names) != count:
                    place = f"{at}.{key}.{part}"
                    raise RawDataError(
                        f"{len(names)} columns are named",
                        where=place,
                        value=", ".join(names),
                        allowed=f"{count}, {why}",
                        remedy="name as many, in order",
                    )
        sources = dict(columns.sources(self.prismatic, where))
        uses: dict[str, dict[str, str]] = {}
        polar = {f"{before}{axis}_mm" for before, *_ in columns.polar_places() for axis in "xyz"}
        for ours, source in sources.items():
            if not ours.startswith("u_"):  # one uncertainty may be that of several
                for name in source.names:
                    of = "rotation" if ours in QUATERNION else ours
                    of = ours[-4:] if columns.target and source.key.endswith(".position") else of
                    of = source.key if ours in polar else of
                    uses.setdefault(name, {})[of] = source.key
        for name, keys in uses.items():
            if len(keys) > 1:
                right = " and ".join(f"{key}.names" for key in dict.fromkeys(keys.values()))
                value = f"`{name}` for {' and '.join(sorted(keys))}"
                raise RawDataError(
                    "a column is mapped twice",
                    where=at,
                    value=value,
                    allowed="every column of the file for one quantity",
                    remedy=f"name the right column for each in {right}; pa10cal columns "
                    f"{self.path.name} proposes them",
                )
        return ColumnMap(sources, where)

    @property
    def own_names(self) -> list[str]:
        """Return the file's own names of the columns that are mapped."""
        target = None if self.columns is None else self.columns.target
        return list(dict.fromkeys((*self.words.own_names, *(target.names if target else ()))))

    @property
    def header(self) -> list[str]:
        """Return the names of all columns of the file."""
        return column_names(self.path, self._layout, self.path.parent)

    @property
    def _layout(self) -> Layout:
        columns = self.columns
        if columns is None:
            return CONTRACT
        # The table of a known format has its names in its first line.
        made = {"header": 1, "first_row": 0} if columns.format is not None else {}
        return columns.model_copy(update=made)

    def read(
        self, required: Sequence[str], optional: Sequence[str] = (), together: Sequence[str] = ()
    ) -> RawRows:
        """Read columns of the contract; see `read_rows`. All required must be mapped.

        Joints have the signs and offsets that campaign.yaml states.
        """
        if self.columns is None:
            # Poses without times are numbered.
            timed = self.key != "poses" or "time_s" in self.names
            there = [name for name in required if name != "time_s" or timed]
            raw = read_rows(self.path, there, optional, together, within=self.path.parent)
        else:
            filled = FILLED.get(self.key, ())
            needed = [*required, *(together if set(together) & set(self.words.sources) else ())]
            missing = [name for name in needed if name not in self.words and name not in filled]
            if missing:
                raise self._unmapped(missing)
            wanted = {name for name in (*needed, *optional) if name in self.words}
            raw = self._translated(self.columns, wanted)
        made = {"load_N": np.zeros(len(raw)), "repeat": np.ones(len(raw))}
        labels = {"pose", "repeat"} if self.key == "poses" else set()  # made of what is read
        for name in set(FILLED.get(self.key, ())) & set(required) - set(raw.columns) - labels:
            raw.columns[name] = made.get(name, np.arange(float(len(raw))))
        if self.signs is None and self.offsets_deg is None:
            return raw
        columns, own = dict(raw.columns), dict(raw.own.sources)
        for k, slides in enumerate(self.prismatic):
            sign = 1 if self.signs is None else self.signs[k]
            offset = 0.0 if self.offsets_deg is None else self.offsets_deg[k]
            unit = "mm" if slides else "deg"
            for name, added in ((f"q{k + 1}_{unit}", offset), (f"tau{k + 1}_Nm", 0.0)):
                if name not in columns:
                    continue
                columns[name] = sign * raw.columns[name] + added
                was = own.get(name, OwnColumn((name,), unit if name[0] == "q" else "Nm"))
                own[name] = replace(was, factor=sign * was.factor, offset=sign * was.offset + added)
        return replace(raw, columns=columns, own=ColumnMap(own))

    def _translated(self, columns: FileColumns, wanted: set[str]) -> RawRows:
        """Return rows under the contract's names, in its units."""
        layout, within = self._layout, self.path.parent
        raw = read_rows(self.path, self.own_names, layout=layout, words=self.words, within=within)
        raw = replace(raw, unused=())
        of_row = poses = np.zeros(0, dtype=str)
        if columns.target is not None and columns.position is not None:
            raw, of_row, poses = targets_of_rows(raw, columns.target)
            raw = raw.finite(columns.position.names, may_be_blank=True)
        turned = columns.rotation if wanted & set(QUATERNION) else None
        if turned is not None:
            raw = raw.finite(turned.names)
            off = no_rotation(raw.numbers_of(turned.names), turned)
            raw = raw.take(~off, f"{', '.join(turned.names[:2])} …: no rotation")
            raw = raw if turned.u is None else raw.finite(turned.u, may_be_blank=True)
        made: dict[str, NDArray[Any]] = {}
        non_numeric: dict[str, dict[int, str]] = {}
        for before, place, polar in columns.polar_places():
            ours = [f"{before}{axis}_mm" for axis in "xyz"]
            xyz_mm = polar_to_xyz(raw.numbers_of(place.names), polar, place.unit)
            made |= zip(ours, xyz_mm.T, strict=True)
            known = (raw.non_numeric[own].items() for own in place.names)
            no_numbers = dict(chain.from_iterable(known))
            non_numeric |= dict.fromkeys(ours, no_numbers)
        made = {name: values for name, values in made.items() if name in wanted}
        wanted = wanted - set(made)
        for name in sorted(wanted - {*QUATERNION, *(f"u_{part}" for part in QUATERNION)}):
            source = self.words.sources[name]
            if name in TEXT:
                made[name] = raw.text_of(source.name).astype(object)
            elif name == "time_s" and columns.time and columns.time.format:
                seconds, text = _clock(raw, columns.time, from_first=self.key == "poses")
                made[name], unread = seconds, np.flatnonzero(np.isnan(seconds))
                non_numeric[name] = {int(raw.line[k]): text[k] for k in unread}
            else:
                values = source.factor * raw.columns[source.name] + source.offset
                # An uncertainty of 0 states nothing.
                unstated = name.startswith("u_") & (values == 0.0)
                made[name] = np.where(unstated, np.nan, values)
                non_numeric[name] = raw.non_numeric[source.name]
        if columns.kind is not None and "kind" in made:
            words = columns.kind.words
            made["kind"] = np.array([words.get(word, word) for word in made["kind"]], dtype=object)
        if turned is not None:
            values = raw.numbers_of(turned.names)
            made |= zip(QUATERNION, quaternions(values, turned).T, strict=True)
            if turned.u is not None:
                u = raw.numbers_of(turned.u)
                u = quaternion_uncertainty(values, np.where(u > 0.0, u, np.nan), turned)
                u = np.maximum(u, LEAST_U)
                made |= {f"u_{name}": u[:, k] for k, name in enumerate(QUATERNION)}
        translated = replace(raw, columns=made, non_numeric=non_numeric, own=self.words)
        if columns.target is None:
            return translated
        if columns.pose == columns.target.names and "pose" in made:
            translated = translated.with_columns({"pose": poses.astype(object)})
        return one_row_a_pose(translated, of_row, position_columns(self.prismatic))

    def _unmapped(self, missing: Sequence[str]) -> RawDataError:
        key = rule_of(missing[0]).key
        other = {"rotation": ", or instrument.kind: points with the position under targets"}
        if self.key == "poses":
            other["kind"] = "; or state holdout"
        return RawDataError(
            f"nothing is mapped to {', '.join(missing)}",
            where=f"{self.path.parent / DESCRIPTION_FILE}: columns.{self.key}",
            value=", ".join(self.words.sources),
            allowed=f"the columns of {self.path.name} that hold it",
            remedy=f"set columns.{self.key}.{key}{other.get(key, '')}",
        )


def words_of(campaign: CampaignDescription, prismatic: NDArray[np.bool_]) -> ColumnMap:
    """Return what the columns of a campaign's files are, by its description alone."""
    words = CONTRACT_COLUMNS
    for key in sorted(campaign.columns.model_fields_set if campaign.columns else ()):
        words |= RawFile.of(campaign, Path(), key, prismatic).words
    return words


def polar_to_xyz(values: Array, polar: Polar, unit: str) -> Array:
    """Return places (N, 3) in mm, x along a horizontal angle of 0, z up.

    The values (N, 3) are horizontal angle, vertical angle, and distance in a unit of lengths.
    """
    horizontal, down = np.radians(ANGLES_OF_POLAR[polar.unit]) * values[:, :2].T
    turned = -horizontal if polar.horizontal == "clockwise" else horizontal
    down = 0.5 * np.pi - down if polar.vertical == "horizon" else down
    flat = values[:, 2] * np.sin(down)
    return LENGTHS[unit] * np.column_stack(
        [flat * np.cos(turned), flat * np.sin(turned), values[:, 2] * np.cos(down)]
    )


def _clock(raw: RawRows, time: Time, *, from_first: bool) -> tuple[Array, list[str]]:
    """Return seconds since 1970, or since the first row, of dates and times, and these."""
    parts = [raw.text_of(name) for name in time.names]
    text = [" ".join(words) for words in zip(*parts, strict=True)]
    since = (moments_of(text, time.format or ISO) - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    seconds: Array = np.array(since, dtype=np.float64)
    if from_first and not np.isnan(seconds).all():
        seconds -= np.nanmin(seconds)
    return seconds, text


# Rows of one target each: which one a row is of, and rows of one pose made one.

UNKNOWN = "the row names no target that is stated"
#: Rows of one pose whose joints differ by less were taken in it [deg, mm].
_SAME = 0.01


def targets_of_rows(
    raw: RawRows, stated: TargetOfRow
) -> tuple[RawRows, NDArray[np.str_], NDArray[np.str_]]:
    """Return the rows with a known target, its name in each, and what the label is without it."""
    fields = [str(word) for word in raw.text_of(stated.names[0])]
    split = [stated.of(field) for field in fields]
    keep = np.array([target != "" for _, target in split], dtype=bool)
    values = [f"{stated.names[0]} = {fields[k]!r}" for k in np.flatnonzero(~keep)]
    split = [each for each in split if each[1] != ""]
    poses, targets = (np.array([each[k] for each in split], dtype=str) for k in (0, 1))
    return raw.take(keep, UNKNOWN, values), targets, poses


def one_row_a_pose(raw: RawRows, targets: NDArray[np.str_], q: Sequence[str]) -> RawRows:
    """Return rows with what was measured of the other targets blank, those of one pose as one.

    Rows (N,) are of these targets. They are of one pose if its label and all else that they state
    of it is the same, and the joints `q` agree. A target that occurs again is of the next repeat.
    """
    columns, non_numeric = dict(raw.columns), dict(raw.non_numeric)
    for name in columns:
        target = name.removeprefix("u_").rpartition("_")[0].rpartition("_")[0]
        if name.endswith(("_x_mm", "_y_mm", "_z_mm")) and target:
            other = targets != target
            columns[name] = np.where(other, np.nan, columns[name])
            lines = set(raw.line[~other].tolist())
            known = non_numeric.get(name, {}).items()
            non_numeric[name] = {line: text for line, text in known if line in lines}
    raw = replace(raw, columns=columns, non_numeric=non_numeric)
    stated = [name for name in ("pose", "kind", "load_N", "repeat") if name in columns]
    there = [name for name in q if name in columns]
    if "pose" not in stated and not there:
        return raw
    keys = pd.DataFrame({name: columns[name] for name in stated}, index=range(len(raw)))
    if there:
        keys["joints"] = same_commands(np.nan_to_num(raw.numbers_of(there)), _SAME)
    again = _groups(keys.assign(target=targets)).cumcount()
    group = _groups(keys.assign(again=again)).ngroup().to_numpy()
    first = np.unique(group, return_index=True)[1]
    if len(first) == len(raw):
        return raw
    numbers = [n for n in columns if np.issubdtype(columns[n].dtype, np.floating)]
    means = pd.DataFrame({name: columns[name] for name in numbers}).groupby(group).mean()
    # What stands where a number should is that of the whole row.
    line_of = dict(zip(raw.line.tolist(), raw.line[first][group].tolist(), strict=True))
    moved = {
        name: {line_of[line]: text for line, text in texts.items()}
        for name, texts in non_numeric.items()
    }
    merged = replace(raw, non_numeric=moved).at(first)
    note = f"{raw.file}: {len(raw)} rows of one target each are {len(first)} configurations"
    return replace(
        merged.with_columns({name: means[name].to_numpy() for name in numbers if name != "time_s"}),
        notes=(*raw.notes, note),
    )


def _groups(keys: pd.DataFrame) -> Any:
    """Return rows grouped by all their keys."""
    return keys.groupby(list(keys), sort=False, dropna=False)


# Orientations in a user's own convention to quaternions, with their uncertainties.

#: How many columns a convention takes; three where it is not here.
COLUMNS = {"quaternion_wxyz": 4, "quaternion_xyzw": 4, "matrix": 9}
#: A matrix may differ from a rotation by so much in an element of its product with its transpose.
NOT_ORTHONORMAL = 0.02
#: Step of each number for the derivative of the quaternion by it, of numbers of order one.
_STEP = 1e-6


def quaternions(values: Array, columns: RotationColumns) -> Array:
    """Return quaternions (N, 4), scalar first, of the numbers (N, k) that the columns hold.

    Quaternions keep their length, so that what reads them can tell those that are none.
    """
    word = columns.convention
    if word.startswith("quaternion"):
        found = values if word.endswith("wxyz") else values[:, [3, 0, 1, 2]]
        return np.where([True, *3 * [not columns.inverse]], found, -found)
    degrees = values * ANGLES[columns.unit]
    if word == "matrix":
        rotation = Rotation.from_matrix(values.reshape(-1, 3, 3))
    elif word == "rotation_vector":
        rotation = Rotation.from_rotvec(degrees, degrees=True)
    else:
        # Capitals turn along, as SciPy has it too.
        sequence = "xyz" if word == "rpy" else word.rpartition("_")[2]
        rotation = Rotation.from_euler(sequence, degrees, degrees=True)
    rotation = rotation.inv() if columns.inverse else rotation
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def no_rotation(values: Array, columns: RotationColumns) -> NDArray[np.bool_]:
    """Return the rows (N,) of a matrix that is no rotation."""
    if columns.convention != "matrix":
        return np.zeros(len(values), dtype=bool)
    R = values.reshape(-1, 3, 3)
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray((off > NOT_ORTHONORMAL) | (np.linalg.det(R) < 0.0))


def quaternion_uncertainty(values: Array, u: Array, columns: RotationColumns) -> Array:
    """Return the standard uncertainties (N, 4) of the quaternions' components.

    The numbers (N, k) err independently, by u (N, k) in the same unit.
    """
    square = np.zeros((len(values), 4))
    for k in range(values.shape[1]):
        step = np.zeros(values.shape[1])
        step[k] = _STEP
        ahead, behind = quaternions(values + step, columns), quaternions(values - step, columns)
        # A quaternion and its negative are one rotation.
        same = np.where(np.sum(ahead * behind, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        square += ((ahead - same * behind) / (2.0 * _STEP) * u[:, [k]]) ** 2
    return np.sqrt(square)
