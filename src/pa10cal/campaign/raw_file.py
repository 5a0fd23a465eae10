"""A raw file, read under the contract's names or, by `columns` of campaign.yaml, under its own.

Then orientations and polar readings in a user's own convention, as quaternions and places; and rows
of one target each, merged to configurations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.bounds import rule_of
from pa10cal.campaign.column_map import (
    ANGLES,
    CONTRACT_COLUMNS,
    FACTORS,
    LENGTHS,
    QUATERNION,
    ColumnMap,
    OwnColumn,
)
from pa10cal.campaign.csv_rows import CONTRACT, Layout, column_names, read_rows
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription, check_joints
from pa10cal.campaign.joint_positions import position_columns, same_commands
from pa10cal.campaign.own_columns import (
    FileColumns,
    Inverse,
    Polar,
    RotationColumns,
    TargetOfRow,
    Time,
)
from pa10cal.campaign.raw_rows import TEXT, InFile, RawRows
from pa10cal.campaign.sniffing import ISO, seconds_of
from pa10cal.errors import RawDataError

#: Least standard uncertainty of a component of a quaternion computed from stated ones.
LEAST_U = 1e-9
#: Columns that a file with its own names need not have: rows are numbered, loads are 0, and equal
#: joint positions are repeats of one pose.
FILLED = {"poses": ("time_s", "load_N", "pose", "repeat"), "cmm": ("load_N", "repeat", "touch")}
#: Files of which many rows may share a stamp.
LOGS = ("joints", "readings")


@dataclass(frozen=True)
class RawFile:
    """A raw file of a campaign."""

    path: Path
    key: str  # its key in campaign.yaml: poses, cmm, resolver, joints or readings
    prismatic: Mask  # (n,) which joints of the arm slide
    columns: FileColumns | None = None  # stated columns; None where it follows the contract
    signs: tuple[int, ...] | None = None  # `joint_signs` of campaign.yaml
    offsets_deg: tuple[float, ...] | None = None  # `joint_offsets_deg`

    @classmethod
    def of(cls, campaign: CampaignDescription, folder: Path, key: str, prismatic: Mask) -> RawFile:
        """Return a file that campaign.yaml names."""
        columns = None if campaign.columns is None else getattr(campaign.columns, key)
        check_joints(campaign, len(prismatic), str(folder / DESCRIPTION_FILE))
        path = folder / str(getattr(campaign.files, key))
        signs, offsets_deg = campaign.joint_signs, campaign.joint_offsets_deg
        return cls(path, key, prismatic, columns, signs, offsets_deg)

    @property
    def in_degrees(self) -> Sequence[str]:
        """Return the columns of angles of orientations that are stated to be in degrees."""
        rotation = None if self.columns is None else self.columns.rotation
        if rotation is None or len(rotation.names) != 3 or rotation.unit != "deg":
            return ()
        return rotation.names

    @property
    def inverse(self) -> Inverse:
        """Return what is stated to be inverse of the measured poses."""
        rotation = None if self.columns is None else self.columns.rotation
        return False if rotation is None else rotation.inverse

    @property
    def names(self) -> list[str]:
        """Return the columns of the contract that the file has, or that are mapped."""
        if self.columns is not None:
            return list(self.words.sources)
        return column_names(self.path, within=self.path.parent)

    @cached_property
    def words(self) -> ColumnMap:
        """Return the sources of the contract's columns; empty without `columns`.

        Raises:
            RawDataError: when a list of names is too long or too short, or a column is mapped to
                two quantities.
        """
        columns, section = self.columns, f"columns.{self.key}"
        if columns is None:
            return CONTRACT_COLUMNS
        where = f"{self.path.parent / DESCRIPTION_FILE}: {section}"
        self._refuse_wrong_count(columns, where)
        sources = dict(columns.sources(self.prismatic, section))
        self._refuse_mapped_twice(columns, sources, where)
        return ColumnMap(sources, section)

    def _refuse_wrong_count(self, columns: FileColumns, where: str) -> None:
        """Refuse lists of names that are too long or too short."""
        of_arm = (len(self.prismatic), "one for each joint of the arm")
        expected = {"joints": of_arm, "torques": of_arm}
        if columns.rotation is not None:
            word = columns.rotation.convention
            expected["rotation"] = COLUMNS.get(word, 3), f"as {word} has"
        for key, (count, why) in expected.items():
            for part in ("names", "u"):
                names = getattr(getattr(columns, key), part, None)
                if names is not None and len(names) != count:
                    raise RawDataError(
                        f"{len(names)} columns are named",
                        where=f"{where}.{key}.{part}",
                        value=", ".join(names),
                        allowed=f"{count}, {why}",
                        remedy="name as many, in order",
                    )

    def _refuse_mapped_twice(
        self, columns: FileColumns, sources: Mapping[str, OwnColumn], where: str
    ) -> None:
        """Refuse columns of the file that are mapped to two quantities."""
        keys_of: dict[str, dict[str, str]] = {}  # by column of the file, then by quantity
        polar = {f"{before}{axis}_mm" for before, *_ in columns.polar_places() for axis in "xyz"}
        for ours, source in sources.items():
            if ours.startswith("u_"):  # one uncertainty may be that of several
                continue
            quantity = "rotation" if ours in QUATERNION else ours
            if columns.target and source.key.endswith(".position"):
                quantity = ours[-4:]  # x_mm, whatever the target
            if ours in polar:
                quantity = source.key
            for name in source.names:
                keys_of.setdefault(name, {})[quantity] = source.key
        for name, keys in keys_of.items():
            if len(keys) > 1:
                right = " and ".join(f"{key}.names" for key in dict.fromkeys(keys.values()))
                raise RawDataError(
                    "a column is mapped twice",
                    where=where,
                    value=f"`{name}` for {' and '.join(sorted(keys))}",
                    allowed="every column of the file for one quantity",
                    remedy=f"name the right column for each in {right}; pa10cal columns "
                    f"{self.path.name} proposes them",
                )

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
        if columns.format is None:
            return columns
        return columns.model_copy(update={"header": 1, "first_row": 0})

    def read(
        self,
        required: Sequence[str],
        optional: Sequence[str] = (),
        together: Sequence[str] = (),
        *,
        repeats: bool = False,
    ) -> RawRows:
        """Read columns of the contract; see `read_rows`. All required columns must be mapped.

        Joints get the signs and offsets that campaign.yaml states. Columns of `FILLED` that are
        missing are filled.
        """
        if self.columns is None:
            # Poses without times are numbered.
            timed = self.key != "poses" or "time_s" in self.names
            needed = [name for name in required if name != "time_s" or timed]
            within = self.path.parent
            stamps = ("time_s",) if self.key in LOGS else ()
            raw = read_rows(
                self.path,
                needed,
                optional,
                together,
                repeats=repeats,
                stamps=stamps,
                within=within,
            )
        else:
            filled = FILLED.get(self.key, ())
            needed = [*required, *(together if set(together) & set(self.words.sources) else ())]
            missing = [name for name in needed if name not in self.words and name not in filled]
            if missing:
                raise self._unmapped(missing)
            wanted = {name for name in (*needed, *optional) if name in self.words}
            raw = self._translated(self.columns, wanted, repeats=repeats)
        fill = {"load_N": np.zeros(len(raw)), "repeat": np.ones(len(raw))}
        made_later = {"pose", "repeat"} if self.key == "poses" else set()  # see `with_labels`
        for name in set(FILLED.get(self.key, ())) & set(required) - set(raw.columns) - made_later:
            raw.columns[name] = fill.get(name, np.arange(float(len(raw))))
        if self.signs is None and self.offsets_deg is None:
            return raw
        return self._with_signs_and_offsets(raw)

    def _with_signs_and_offsets(self, raw: RawRows) -> RawRows:
        """Return rows whose joints and torques have the signs and offsets of campaign.yaml."""
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
                factor, offset = sign * was.factor, sign * was.offset + added
                own[name] = replace(was, factor=factor, offset=offset, zero=added)
        return replace(raw, columns=columns, own=ColumnMap(own))

    def _translated(self, columns: FileColumns, wanted: set[str], *, repeats: bool) -> RawRows:
        """Return rows under the contract's names, in its units."""
        raw = every = self._mapped_rows(columns, repeats=repeats)
        rotation = columns.rotation if wanted & set(QUATERNION) else None
        if rotation is not None:
            raw = _rows_with_rotation(raw, rotation)
        of_targets: _RowsOfTargets | None = None
        if columns.target is not None and columns.position is not None:
            raw = raw.finite(columns.position.names, may_be_blank=True)
            of_targets = _RowsOfTargets.of(raw, columns.target)
            raw = of_targets.raw
        made = _polar_columns(raw, columns, wanted)
        if rotation is not None:
            made.values.update(_quaternion_columns(raw, rotation))
        for name in sorted(wanted - {*made.values, *(f"u_{part}" for part in QUATERNION)}):
            made.values[name], texts = self._translated_column(raw, columns, name)
            if texts is not None:
                made.non_numeric[name] = texts
        if rotation is not None and rotation.inverse == "pose":
            made.values.update(_places_of_inverse_poses(made.values))
        if columns.kind is not None and "kind" in made.values:
            words, kinds = columns.kind.words, made.values["kind"]
            made.values["kind"] = np.array([words.get(kind, kind) for kind in kinds], dtype=object)
        translated = replace(raw, columns=made.values, non_numeric=made.non_numeric, own=self.words)
        if of_targets is None:
            return translated
        return self._one_row_a_pose(translated, of_targets, columns, every)

    def _mapped_rows(self, columns: FileColumns, *, repeats: bool) -> RawRows:
        """Return the rows of the columns that are mapped, under their own names."""
        raw = read_rows(
            self.path,
            self.own_names,
            layout=self._layout,
            words=self.words,
            repeats=repeats,
            stamps=columns.time.names if columns.time and self.key in LOGS else (),
            within=self.path.parent,
            label=columns.pose[0] if columns.pose else "",
        )
        return replace(raw, unused=())

    def _translated_column(
        self, raw: RawRows, columns: FileColumns, name: str
    ) -> tuple[NDArray[Any], dict[int, str] | None]:
        """Return a column of the contract, and by line the fields of numbers that are none.

        None for such fields where it is text.
        """
        source, time = self.words.sources[name], columns.time
        if name in TEXT:
            return raw.text_of(source.name).astype(object), None
        if name == "time_s" and time and time.format:
            seconds, text = _clock(raw, time, from_first=self.key == "poses")
            unread = np.flatnonzero(np.isnan(seconds))
            return seconds, {int(raw.line[k]): text[k] for k in unread}
        if name == "time_s" and time and len(time.names) > 1:
            parts = zip(time.names, time.unit, strict=True)
            seconds = np.sum([FACTORS[unit] * raw.columns[own] for own, unit in parts], 0)
            return seconds, _texts_of(raw, time.names)
        own_values = raw.numbers_of(source.names) @ np.array(source.weights)
        values = source.factor * own_values + source.offset
        # An uncertainty of 0 states nothing.
        unstated = name.startswith("u_") & (values == 0.0)
        return np.where(unstated, np.nan, values), _texts_of(raw, source.names)

    def _one_row_a_pose(
        self, raw: RawRows, of_targets: _RowsOfTargets, columns: FileColumns, every: RawRows
    ) -> RawRows:
        """Return one row for each configuration, by what all rows of the file state."""
        target = columns.target
        assert target is not None
        stated = [name for name in ("pose", "kind", "load_N", "repeat") if name in raw.columns]
        keys = {name: every[self.words.sources[name].name] for name in stated}
        if columns.pose == target.names and "pose" in keys:  # one column names pose and target
            raw = raw.with_columns({"pose": of_targets.label.astype(object)})
            fields = every.text_of(target.names[0]).tolist()
            keys["pose"] = np.array([target.of(field)[0] for field in fields], dtype=object)
        by_line = pd.DataFrame(keys, index=every.line)
        return _one_row_a_pose(raw, of_targets.target, position_columns(self.prismatic), by_line)

    def _unmapped(self, missing: Sequence[str]) -> RawDataError:
        key = rule_of(missing[0]).key
        other = {
            "rotation": ", or instrument.kind: points with the position under targets",
            "kind": "; or state holdout",
        }
        return RawDataError(
            f"nothing is mapped to {', '.join(missing)}",
            where=f"{self.path.parent / DESCRIPTION_FILE}: columns.{self.key}",
            value=", ".join(self.words.sources),
            allowed=f"the columns of {self.path.name} that hold it",
            remedy=f"set columns.{self.key}.{key}{other.get(key, '')}",
        )


def words_of(campaign: CampaignDescription, prismatic: Mask) -> ColumnMap:
    """Return the column map of all files of a campaign, by its description alone."""
    words = CONTRACT_COLUMNS
    for key in sorted(campaign.columns.model_fields_set if campaign.columns else ()):
        words |= RawFile.of(campaign, Path(), key, prismatic).words
    return words


def _rows_with_rotation(raw: RawRows, rotation: RotationColumns) -> RawRows:
    """Quarantine rows whose columns of an orientation hold no numbers, or a matrix that is none."""
    raw = raw.finite(rotation.names)
    off = no_rotation(raw.numbers_of(rotation.names), rotation)
    raw = raw.take(~off, f"{', '.join(rotation.names[:2])} …: no rotation")
    return raw if rotation.u is None else raw.finite(rotation.u, may_be_blank=True)


class _Columns(NamedTuple):
    """Columns of the contract."""

    values: dict[str, NDArray[Any]]
    non_numeric: dict[str, dict[int, str]]  # fields that are no number, by line


def _polar_columns(raw: RawRows, columns: FileColumns, wanted: set[str]) -> _Columns:
    """Return the places of readings that are stated as two angles and a distance."""
    made = _Columns({}, {})
    for before, place, polar in columns.polar_places():
        ours = [f"{before}{axis}_mm" for axis in "xyz"]
        xyz_mm = polar_to_xyz(raw.numbers_of(place.names), polar, place.unit)
        made.values.update((k, mm) for k, mm in zip(ours, xyz_mm.T, strict=True) if k in wanted)
        # A field that is no number is one of all three coordinates.
        made.non_numeric.update(dict.fromkeys(ours, _texts_of(raw, place.names)))
    return made


def _texts_of(raw: RawRows, names: Sequence[str]) -> dict[int, str]:
    """Return the fields of several columns that are no number, by line."""
    return {line: text for name in names for line, text in raw.non_numeric[name].items()}


def _quaternion_columns(raw: RawRows, rotation: RotationColumns) -> dict[str, Array]:
    """Return the contract's columns of an orientation and of its uncertainty, if that is stated."""
    values = raw.numbers_of(rotation.names)
    made: dict[str, Array] = dict(zip(QUATERNION, quaternions(values, rotation).T, strict=True))
    if rotation.u is not None:
        u = raw.numbers_of(rotation.u)
        u = quaternion_uncertainty(values, np.where(u > 0.0, u, np.nan), rotation)
        made |= {f"u_{name}": np.maximum(u[:, k], LEAST_U) for k, name in enumerate(QUATERNION)}
    return made


def _places_of_inverse_poses(made: Mapping[str, NDArray[Any]]) -> dict[str, Array]:
    """Return x, y, z of poses -R p, of places p measured in the target's frame.

    R is the orientation of the target, as the columns of the contract hold it. Uncertainties stay
    those of p, along the target's axes: `Pose.from_raw` turns them.
    """
    names = [f"{axis}_mm" for axis in "xyz"]
    wxyz, p_mm = (np.column_stack([made[name] for name in of]) for of in (QUATERNION, names))
    length = np.linalg.norm(wxyz, axis=1, keepdims=True)
    some = np.isfinite(wxyz).all(axis=1) & (length[:, 0] > 0.0)
    R = np.full((len(wxyz), 3, 3), np.nan)
    R[some] = Rotation.from_quat(wxyz[some], scalar_first=True).as_matrix()
    return dict(zip(names, -(R @ p_mm[:, :, None])[:, :, 0].T, strict=True))


def _clock(raw: RawRows, time: Time, *, from_first: bool) -> tuple[Array, list[str]]:
    """Return the times of rows as seconds since 1970, or since the earliest row, and as text."""
    parts = [raw.text_of(name) for name in time.names]
    text = [" ".join(words) for words in zip(*parts, strict=True)]
    seconds = seconds_of(text, time.format or ISO)
    if from_first and not np.isnan(seconds).all():
        seconds -= np.nanmin(seconds)
    return seconds, text


# Orientations and polar readings in a user's own convention, as quaternions and places.

#: Number of columns by convention; three for all others.
COLUMNS = {"quaternion_wxyz": 4, "quaternion_xyzw": 4, "matrix": 9}
#: Largest element of R R' - I of a matrix R that is taken for a rotation.
NOT_ORTHONORMAL = 0.02
#: Step of the central differences of a quaternion by the numbers that state it.
_STEP = 1e-6


def quaternions(values: Array, columns: RotationColumns) -> Array:
    """Return quaternions (N, 4), scalar first, of the numbers (N, k) in the columns.

    Stated quaternions keep their length, so that those not of unit length can be refused later.
    """
    word = columns.convention
    if word.startswith("quaternion"):
        wxyz = values if word.endswith("wxyz") else values[:, [3, 0, 1, 2]]
        return np.where([True, *3 * [not columns.inverse]], wxyz, -wxyz)  # conjugate if inverse
    degrees = values * ANGLES[columns.unit]
    if word == "matrix":
        rotation = Rotation.from_matrix(values.reshape(-1, 3, 3))
    elif word == "rotation_vector":
        rotation = Rotation.from_rotvec(degrees, degrees=True)
    else:
        # As in SciPy capitals are rotations about moving axes, small letters about fixed ones.
        sequence = "xyz" if word == "rpy" else word.rpartition("_")[2]
        rotation = Rotation.from_euler(sequence, degrees, degrees=True)
    rotation = rotation.inv() if columns.inverse else rotation
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def no_rotation(values: Array, columns: RotationColumns) -> Mask:
    """Return the rows (N,) whose stated matrix is no rotation."""
    if columns.convention != "matrix":
        return np.zeros(len(values), dtype=bool)
    R = values.reshape(-1, 3, 3)
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray((off > NOT_ORTHONORMAL) | (np.linalg.det(R) < 0.0))


def quaternion_uncertainty(values: Array, u: Array, columns: RotationColumns) -> Array:
    """Return the standard uncertainties (N, 4) of the quaternions' components.

    The numbers (N, k) have independent standard uncertainties u (N, k) in the same unit.
    """
    square = np.zeros((len(values), 4))
    for k in range(values.shape[1]):
        step = np.zeros(values.shape[1])
        step[k] = _STEP
        ahead, behind = quaternions(values + step, columns), quaternions(values - step, columns)
        # A quaternion and its negative are one rotation.
        sign = np.where(np.sum(ahead * behind, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        square += ((ahead - sign * behind) / (2.0 * _STEP) * u[:, [k]]) ** 2
    return np.sqrt(square)


def polar_to_xyz(values: Array, polar: Polar, unit: str) -> Array:
    """Return places (N, 3) [mm], x along a horizontal angle of 0, z up.

    The values (N, 3) are horizontal angle, vertical angle, and distance in a unit of lengths.
    """
    horizontal, vertical = np.radians(ANGLES[polar.unit]) * values[:, :2].T
    azimuth = -horizontal if polar.horizontal == "clockwise" else horizontal
    zenith = 0.5 * np.pi - vertical if polar.vertical == "horizon" else vertical
    flat = values[:, 2] * np.sin(zenith)
    return LENGTHS[unit] * np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), values[:, 2] * np.cos(zenith)]
    )


# Rows of one target each.

#: Why a row without a known target is quarantined.
UNKNOWN = "the row names no target that is stated"
#: Joint positions within this are of one pose [deg, mm].
_SAME = 0.01


@dataclass(frozen=True)
class _RowsOfTargets:
    """N rows of one target each."""

    raw: RawRows
    target: NDArray[np.str_]  # (N,) name of the target of each
    label: NDArray[np.str_]  # (N,) label of the pose, without the target

    @classmethod
    def of(cls, raw: RawRows, stated: TargetOfRow) -> _RowsOfTargets:
        """Return the rows whose target is known; the others are quarantined."""
        fields = [str(word) for word in raw.text_of(stated.names[0])]
        label, target = np.array([stated.of(field) for field in fields], str).reshape(-1, 2).T
        known = target != ""
        values = [f"{stated.names[0]} = {fields[k]!r}" for k in np.flatnonzero(~known)]
        return cls(raw.take(known, UNKNOWN, values), target[known], label[known])


def _one_row_a_pose(
    raw: RawRows, targets: NDArray[np.str_], q: Sequence[str], every: pd.DataFrame
) -> RawRows:
    """Return one row for each configuration of rows that are of one target each.

    Columns of targets other than that of the row are blanked, then rows of one configuration are
    averaged. They agree in pose, kind, load and repeat as stated, and in their joints. A target
    that occurs again belongs to the next repeat.

    Args:
        raw: N rows.
        targets: (N,) target of each.
        q: columns of the joints.
        every: pose, kind, load and repeat as stated of all rows of the file, by their lines.
    """
    columns, non_numeric = dict(raw.columns), dict(raw.non_numeric)
    for name in columns:
        target = name.removeprefix("u_").rpartition("_")[0].rpartition("_")[0]
        if name.endswith(("_x_mm", "_y_mm", "_z_mm")) and target:
            other = targets != target
            columns[name] = np.where(other, np.nan, columns[name])
            lines = set(raw.line[~other].tolist())
            texts = non_numeric.get(name, {}).items()
            non_numeric[name] = {line: text for line, text in texts if line in lines}
    raw = replace(raw, columns=columns, non_numeric=non_numeric)
    stated = [name for name in every if name in columns]
    joints = [name for name in q if name in columns]
    if "pose" not in stated and not joints:
        return raw
    keys = pd.DataFrame({name: columns[name] for name in stated}, index=range(len(raw)))
    if joints:
        keys["joints"] = same_commands(np.nan_to_num(raw.numbers_of(joints)), _SAME)
    again = _grouped(keys.assign(target=targets)).cumcount()
    group = _grouped(keys.assign(again=again)).ngroup().to_numpy()
    first = np.unique(group, return_index=True)[1]
    raw = replace(raw, in_file=_poses_in_file(group, raw.line, every))
    if len(first) == len(raw):
        return raw
    numbers = [n for n in columns if np.issubdtype(columns[n].dtype, np.floating)]
    means = pd.DataFrame({name: columns[name] for name in numbers}).groupby(group).mean()
    # A field that is no number is reported at the first line of its configuration.
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


def _poses_in_file(group: Index, line: NDArray[np.int64], every: pd.DataFrame) -> InFile:
    """Return where the configurations of rows that can be used stand among all poses of the file.

    A pose of which no row can be used counts as one.

    Args:
        group: (N,) configuration of each row that can be used, in order of appearance.
        line: (N,) its line.
        every: what is stated of the pose of all rows of the file, by their lines.
    """
    kept = np.isin(every.index, line)
    key = _grouped(every).ngroup().to_numpy() if len(every.columns) else np.zeros(len(every), int)
    lost = ~np.isin(key, key[kept])
    pose = np.full(len(every), -1)
    pose[kept] = group
    pose[lost] = len(group) + key[lost]
    first = pd.Series(pose)[pose >= 0].drop_duplicates().index
    labels = every["pose"].to_numpy() if "pose" in every else np.full(len(every), "", dtype=object)
    poses = InFile.of_all(len(first))
    number = np.flatnonzero(np.isin(pose[first], group))[group]  # see `RawRows.at` of each row
    return replace(poses, number=number, labels=labels[first])


def _grouped(keys: pd.DataFrame) -> Any:
    """Return rows grouped by all their keys."""
    return keys.groupby(list(keys), sort=False, dropna=False)
