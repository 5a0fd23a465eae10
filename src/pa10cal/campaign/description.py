"""campaign.yaml, typed: one measurement campaign, or a group of campaigns of one robot."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import AfterValidator, Field, FiniteFloat, StringConstraints

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.campaign.bounds import refuse_impossible_gravity, refuse_impossible_temperature
from pa10cal.campaign.own_columns import OwnColumns
from pa10cal.campaign.raw_rows import Exclusions
from pa10cal.errors import RawDataError, remedy_for
from pa10cal.files.arms import load_arm
from pa10cal.files.controller import StatedController, controller_of
from pa10cal.files.coupling import StatedCoupling, coupled_joints
from pa10cal.input_files import is_file, open_file, reason
from pa10cal.observe.instrument import Instrument as MeasuredBy
from pa10cal.observe.kinds import InstrumentKind, instruments
from pa10cal.observe.quantities import StatedByCampaign
from pa10cal.options import Section
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import read_yaml

SCHEMA = "pa10cal-campaign/1"
GROUP_SCHEMA = "pa10cal-group/1"
DESCRIPTION_FILE = "campaign.yaml"

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
#: Places on the apparatus: no tool is larger [mm].
#: A place on a tool: those of cranes are tens of metres long.
PlaceMm = Annotated[FiniteFloat, Field(ge=-1e5, le=1e5)]
Place = tuple[PlaceMm, PlaceMm, PlaceMm]
Text = Annotated[str, StringConstraints(min_length=1, max_length=20_000)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]
#: Length of a tool on which no place is stated.
UNSTATED_TOOL_M = 0.1
BallName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9]+$")]


def _file_name(name: str) -> str:
    """Refuse a path, and an empty name."""
    last = re.split(r"[/\\]", name)[-1]
    if not name or last != name:
        raise ValueError(f"the name of a file in the campaign's folder alone, {last or 'a.csv'}")
    return name


FileName = Annotated[str, AfterValidator(_file_name)]


class InstrumentDescription(Section):
    """What measured the end-effector."""

    kind: InstrumentKind
    uncertainty_mm: FiniteFloat = Field(
        gt=1e-9, le=1e3, description="standard uncertainty of one measured centre, per axis"
    )

    @property
    def type(self) -> type[MeasuredBy]:
        """Return the class of the instrument."""
        return instruments()[self.kind]


class Tool(Section):
    """The apparatus at the flange, in the end-effector frame."""

    mass_kg: Annotated[FiniteFloat, Field(ge=0)]
    massless: bool = Field(
        default=False,
        description="whether a mass of 0 is that of the apparatus; else it is unknown",
    )
    com_mm: Place
    load_point_mm: Place
    balls_mm: dict[BallName, Place] = Field(
        default_factory=dict,
        description="centres of the tooling balls, or of other targets, by name",
    )

    @property
    def com_u_m(self) -> float | None:
        """Return the uncertainty of the centre of mass where it is not stated; None where it is.

        Not stated is 0, 0, 0, as in a proposed description, where no tool has its centre. It lies
        somewhere along the tool, whose length is the distance of the furthest place stated on it.
        """
        if self.mass_kg == 0.0 or any(self.com_mm):
            return None
        places_mm = np.array([self.load_point_mm, *self.balls_mm.values()])
        return 1e-3 * float(np.linalg.norm(places_mm, axis=1).max()) or UNSTATED_TOOL_M


class Files(Section):
    """Names of the raw files inside the campaign's folder."""

    cmm: FileName | None = None
    resolver: FileName | None = None
    poses: FileName | None = None
    joints: FileName | None = None
    readings: FileName | None = None


class Join(Section):
    """How a log of joints and a log of readings belong together."""

    by: Literal["row", "label", "time"] | None = Field(
        default=None, description="none: by labels where both have them, else by time, else by row"
    )
    clock_offset_s: FiniteFloat | None = Field(
        default=None,
        description="what to add to the time of a reading for that of the joints; none: found",
    )


class Holdout(Section):
    """Which poses are held out when the rows themselves do not state it."""

    last_fraction: Annotated[float, Field(gt=0, lt=1)] | None = None
    every: Annotated[int, Field(ge=2)] | None = None

    def count_of(self, poses: int) -> int:
        """Return the number of poses that it holds out."""
        return poses // self.every if self.every else round((self.last_fraction or 0.0) * poses)


class Exclusion(Section):
    """Rows that are not to be used, and why."""

    where: Text = Field(
        description="a label, P012; one reading of it, pose P012, 0 N, repeat 3; line 17, or "
        "lines 17 to 20, of the file of readings"
    )
    why: Text = Field(description="what the report says of them")


class Masses(Section):
    """What is known of the weight of an arm whose parts are not described."""

    total_kg: Annotated[FiniteFloat, Field(gt=0, le=20_000)] = Field(
        description="mass of the whole arm, as a catalogue states it"
    )


#: Joint positions are read back from the joints, or are those that were commanded.
JointPositions = Literal["logged", "commanded"]


class CampaignDescription(Section):
    """One measurement campaign.

    Every key is one of the raw-data contract; `read_description` checks what each instrument needs.
    """

    name: Name
    provenance: Text
    robot: Name
    instrument: InstrumentDescription
    tool: Tool
    gravity_m_s2: Vector = Field(
        description="gravity in the frame of the robot's base, [0, 0, -9.81] for an upright arm"
    )
    reference_temperature_C: FiniteFloat
    files: Files
    ball_diameter_mm: Annotated[FiniteFloat, Field(gt=0.1, le=1e3)] | None = None
    holdout: Holdout | None = None
    configurations: Annotated[int, Field(ge=1)] | None = None
    columns: OwnColumns | None = None
    join: Join | None = None
    joints: JointPositions = "logged"
    joint_signs: tuple[Literal[-1, 1], ...] | None = Field(
        default=None, description="one a joint: what each logged position is multiplied by"
    )
    joint_offsets_deg: tuple[FiniteFloat, ...] | None = Field(
        default=None,
        description="one a joint, added after that: mastering offsets (mm of one that slides)",
    )
    coupling: tuple[StatedCoupling, ...] | None = Field(
        default=None,
        description="joints that move with an axis of another; in place of the arm's own",
    )
    controller: StatedController | None = None
    repeat_tolerance_deg: Annotated[FiniteFloat, Field(gt=0, le=1)] = Field(
        default=0.01,
        description="joint positions within it are one place (mm of a joint that slides)",
    )
    exclude: tuple[Exclusion, ...] = ()
    masses: Masses | None = None
    time_recorded: bool = Field(
        default=True,
        description="whether time_s is the time of the readings; else the rows give an order alone",
    )

    @property
    def campaigns(self) -> tuple[CampaignDescription, ...]:
        """Return the campaigns of a group; none of a campaign."""
        return ()

    @property
    def from_touches(self) -> bool:
        """Whether balls are touched, as in the paper, whose model is for one campaign."""
        return self.instrument.type.from_touches

    @property
    def instrument_kinds(self) -> str:
        """Return the kind of its instrument; of a group, all kinds."""
        return self.instrument.kind

    @property
    def ball_names(self) -> tuple[str, ...]:
        """Names of the tooling balls, sorted."""
        return tuple(sorted(self.tool.balls_mm))

    @property
    def stated(self) -> StatedByCampaign:
        """Uncertainty and targets of its instrument, as stated."""
        targets_m = {name: 1e-3 * np.array(place) for name, place in self.tool.balls_mm.items()}
        return StatedByCampaign(
            1e-3 * self.instrument.uncertainty_mm,
            targets_m,
            inverse_poses=self.columns is not None and self.columns.inverse_poses,
        )

    @property
    def p_ee_balls_mm(self) -> Array:
        """Ball centres (B, 3) in the end-effector frame, in the order of `ball_names`."""
        centres = [self.tool.balls_mm[name] for name in self.ball_names]
        return np.array(centres, dtype=float).reshape(-1, 3)

    def payload(self, arm: Arm) -> Payload | None:
        """Return the payload; None where gravity or the masses of the arm's links are not known."""
        if arm.mass_kg is None or not any(self.gravity_m_s2):
            return None
        return Payload(
            mass_kg=self.tool.mass_kg,
            com_m=1e-3 * np.array(self.tool.com_mm),
            load_point_m=1e-3 * np.array(self.tool.load_point_mm),
            gravity_m_s2=np.array(self.gravity_m_s2),
            known=self.tool.mass_kg > 0.0 or self.tool.massless,
            com_u_m=self.tool.com_u_m,
        )


def read_description(folder: Path) -> CampaignDescription:
    """Read and check the description in a campaign's folder.

    Raises:
        RawDataError: when the file is missing or unreadable, names another schema, states gravity
            or a temperature in another unit, lacks what its instrument needs, or names a raw file
            that is not there.
        SettingsError: when a key is unknown (naming the nearest right one) or does not fit.
    """
    path = folder / DESCRIPTION_FILE
    if not folder.is_dir():
        remedy = remedy_for(folder.name, names_in(folder.parent), "check the path")
        raise RawDataError(
            "the folder is not there",
            where=str(folder),
            allowed="a folder of raw files with campaign.yaml, see docs/raw-data.md",
            remedy=remedy,
        )
    if not os.path.lexists(path):
        inside = [name for name in names_in(folder) if is_file(folder / name / path.name)]
        remedy = "give such a folder; pa10cal columns FILE proposes a campaign.yaml for a file"
        raise RawDataError(
            "there is no campaign.yaml",
            where=str(path),
            allowed="a folder of raw files with campaign.yaml, see docs/raw-data.md",
            remedy=f"did you mean the folder {inside[0]!r} in it?" if inside else remedy,
        )
    what = "the campaign's description cannot be read"
    content = read_yaml(path, RawDataError, what=what, within=folder)
    if not isinstance(content, dict):
        raise RawDataError(
            "the campaign's description holds no keys",
            where=str(path),
            value=content,
            allowed="keys and values, beginning with schema",
            remedy="write the description as docs/raw-data.md specifies",
        )
    schema = content.pop("schema", None)
    if schema == GROUP_SCHEMA:
        return group_of_content(content, str(path))
    if schema != SCHEMA:
        raise RawDataError(
            "the campaign follows another schema",
            where=f"{path}: schema",
            value=schema,
            allowed=SCHEMA,
            remedy=f"convert the campaign and state schema: {SCHEMA}",
        )
    campaign = parse_section(CampaignDescription, content, where=str(path))
    refuse_impossible_gravity(campaign.gravity_m_s2, str(path))
    refuse_impossible_temperature(campaign.reference_temperature_C, str(path))
    _check_instrument(campaign, folder)
    stated = {} if campaign.holdout is None else campaign.holdout.model_dump(exclude_none=True)
    if campaign.holdout is not None and len(stated) != 1:
        raise RawDataError(
            "the held-out poses are not stated in one way",
            where=f"{path}: holdout",
            value=stated,
            allowed="last_fraction or every, one of them",
            remedy="keep one of the two keys",
        )
    return campaign


def check_joints(campaign: CampaignDescription, joints: int, where: str) -> None:
    """Refuse signs or offsets that are not one for each joint of the arm."""
    for key in ("joint_signs", "joint_offsets_deg"):
        stated = getattr(campaign, key)
        if stated is not None and len(stated) != joints:
            raise RawDataError(
                f"{len(stated)} numbers are stated",
                where=f"{where}: {key}",
                value=", ".join(f"{number:g}" for number in stated),
                allowed=f"{joints}, one for each joint of {campaign.robot}, in order",
                remedy="state as many",
            )


def nominal_arm(campaign: CampaignDescription, folder: Path, arms: Path | None = None) -> Arm:
    """Return the arm of a campaign, joints coupled and controller as campaign.yaml states them.

    Raises:
        ArmError: when there is no arm of that name, its file cannot be used, or what is stated
            couples no joints of it.
        RawDataError: when gravity is stated in a base that joints of the arm carry.
        SettingsError: when a key of its file is unknown, missing or of the wrong kind.
    """
    where = str(folder / DESCRIPTION_FILE)
    arm = load_arm(campaign.robot, folder, arms)
    if arm.base_moves and any(campaign.gravity_m_s2):
        raise RawDataError(
            f"joints of {arm.name} carry its base, and gravity turns with it",
            where=f"{where}: gravity_m_s2",
            value=list(campaign.gravity_m_s2),
            allowed="[0, 0, 0] for an arm with base_moves: true (docs/arms.md)",
            remedy="set gravity_m_s2: [0, 0, 0]",
        )
    computes = controller_of(campaign.controller, arm, folder, arms, where=f"{where}: controller")
    arm = replace(arm, controller=computes)
    if campaign.coupling is None:
        return arm
    return replace(arm, coupled=coupled_joints(campaign.coupling, arm.prismatic, where))


def exclusions_of(campaign: CampaignDescription, folder: Path) -> Exclusions:
    """Return the rows that a campaign excludes, before any row is read."""
    stated = [(rows.where, rows.why) for rows in campaign.exclude]
    return Exclusions(stated, f"{folder / DESCRIPTION_FILE}: exclude")


def names_in(folder: Path) -> list[str]:
    """Return the names of the files and folders in a folder; none where it cannot be read."""
    try:
        return sorted(path.name for path in folder.iterdir())
    except OSError:
        return []


def _check_instrument(campaign: CampaignDescription, folder: Path) -> None:
    """Refuse a campaign that lacks what its kind of instrument needs."""
    path, kind = folder / DESCRIPTION_FILE, campaign.instrument.kind
    touched = campaign.instrument.type.from_touches
    if touched:
        key = "ball_diameter_mm"
        if campaign.ball_diameter_mm is None:
            allowed = "the diameter of the tooling balls"
            raise _wrong_key("the key is missing", path, key, allowed)
        offsets = campaign.p_ee_balls_mm - campaign.p_ee_balls_mm.mean(axis=0, keepdims=True)
        if len(offsets) < 3 or np.linalg.matrix_rank(offsets, tol=1.0) < 2:
            key, stated = "tool.balls_mm", dict(campaign.tool.balls_mm)
            allowed = "at least three balls that are not collinear"
            raise _wrong_key("the key cannot be used", path, key, allowed, stated)
    two_logs = campaign.files.joints is not None or campaign.files.readings is not None
    needed = ("joints", "readings") if two_logs else ("poses",)
    if touched:
        needed = ("cmm", "resolver")
    for key in needed:
        name, where = getattr(campaign.files, key), f"{path}: files.{key}"
        if name is None:
            allowed = f"a file name, as the kind is {kind}"
            raise _wrong_key("the key is missing", path, f"files.{key}", allowed)
        try:
            open_file(folder / name, folder).close()
        except FileNotFoundError:
            raise RawDataError(
                "the file is not there",
                where=where,
                value=name,
                allowed="a file inside the campaign's folder",
                remedy=remedy_for(name, names_in(folder), f"put it there, or correct files.{key}"),
            ) from None
        except OSError as error:
            raise RawDataError(
                f"the file cannot be read: {reason(error)}",
                where=where,
                value=name,
                allowed="a file inside the campaign's folder, no link out of it",
                remedy="put the file itself there",
            ) from None
    mapped = set() if campaign.columns is None else campaign.columns.model_fields_set
    for key in sorted(mapped - set(needed)):
        allowed = " and ".join(f"columns.{other}" for other in needed)
        allowed = f"{allowed}, as the kind is {kind}"
        raise _wrong_key("the key cannot be used", path, f"columns.{key}", allowed, key)


def _wrong_key(
    what: str, path: Path, key: str, allowed: str, value: object | None = None
) -> RawDataError:
    return RawDataError(
        what, where=f"{path}: {key}", value=value, allowed=allowed, remedy=f"set {key} accordingly"
    )


#: Fields in which the nominal arms of a group must agree, and by how much they may differ.
_GEOMETRY = (
    *("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad", "hayati", "prismatic"),
    *("T_base_row1", "T_row_n_ee"),
)
_SAME_GEOMETRY = 1e-12


class GroupDescription(CampaignDescription):
    """Several campaigns of one robot; all other keys are those of the first campaign."""

    members: tuple[CampaignDescription, ...]  # the campaigns

    @property
    def campaigns(self) -> tuple[CampaignDescription, ...]:
        """Return the campaigns."""
        return self.members

    @property
    def from_touches(self) -> bool:
        """Return False: a group takes the general model, whatever the instruments."""
        return False

    @property
    def instrument_kinds(self) -> str:
        """Return the kinds of the instruments, each once."""
        return " and ".join(dict.fromkeys(member.instrument.kind for member in self.members))

    def payload(self, arm: Arm) -> Payload | None:
        """Return the payload, with that of each campaign where they differ."""
        payloads = [member.payload(arm) for member in self.members]
        known = tuple(payload for payload in payloads if payload is not None)
        if not known:
            return None

        def same(payload: Payload) -> bool:
            return all(
                np.array_equal(getattr(known[0], field.name), getattr(payload, field.name))
                for field in fields(payload)
            )

        return known[0] if all(map(same, known)) else replace(known[0], of_campaigns=known)


def describe_group(
    name: str, members: Sequence[tuple[CampaignDescription, Arm]]
) -> GroupDescription:
    """Describe a group of campaigns, each with its nominal arm.

    Raises:
        RawDataError: when there are fewer than two, one is there twice or has the group's name, or
            they are not of one robot.
    """
    described = [description for description, _ in members]
    names = [description.name for description in described]
    check_names(name, names, f"group {name}")
    for (other, arm), of in zip(members[1:], names[1:], strict=True):
        one, two = described[0].robot, other.robot
        differ = _difference(members[0][1], arm) if one == two else f"robot: {one} and {two}"
        if differ is not None:
            raise RawDataError(
                "the campaigns of a group are not of one robot",
                where=f"group {name}: {names[0]} and {of}",
                value=differ,
                allowed="campaigns of one robot, described by the same nominal rows",
                remedy="take the other campaign out of the group, or describe the robot alike in "
                "both",
            )
    stated = [each.controller for each in described]
    if any(each != stated[0] for each in stated):
        raise RawDataError(
            "the campaigns of a group state different controllers",
            where=f"group {name}: controller",
            value=[None if each is None else each.model_dump(exclude_none=True) for each in stated],
            allowed="the same in all of them",
            remedy="state in all what the robot will be commanded with",
        )
    return _described(name, described)


def check_names(name: str, names: Sequence[str], where: str) -> None:
    """Refuse a group of fewer than two campaigns, or with a name that occurs twice."""
    twice = sorted({other for other in names if list(names).count(other) > 1})
    if len(names) < 2:
        what, value = "a group has fewer than two campaigns", ", ".join(names) or "none"
    elif twice:
        what, value = "a campaign stands in a group twice", twice[0]
    elif name in names:
        what, value = "a group is called like one of its campaigns", name
    else:
        return
    raise RawDataError(
        what,
        where=where,
        value=value,
        allowed="two or more campaigns, each once, and a name of the group's own",
        remedy="correct the list of campaigns, or rename the group",
    )


def group_of_content(content: Mapping[str, Any], where: str) -> GroupDescription:
    """Return the group that the content of its campaign.yaml describes; see `group_text`.

    Raises:
        RawDataError: when it lacks its campaigns.
        SettingsError: when a key of one of them does not fit.
    """
    name, listed = content.get("name"), content.get("campaigns")
    if not isinstance(name, str) or not isinstance(listed, list):
        raise RawDataError(
            "the group lacks its name or its campaigns",
            where=where,
            value=sorted(content),
            allowed="name and campaigns, as pa10cal join writes them",
            remedy="run pa10cal join again",
        )
    described = []
    for number, campaign in enumerate(listed):
        if isinstance(campaign, dict):
            campaign = {key: value for key, value in campaign.items() if key != "schema"}
        place = f"{where}: campaigns[{number}]"
        described.append(parse_section(CampaignDescription, campaign, where=place))
    check_names(name, [description.name for description in described], where)
    return _described(name, described)


def group_text(group: CampaignDescription) -> str:
    """Return the campaign.yaml of a group: the descriptions of its campaigns."""
    content: dict[str, Any] = {"schema": GROUP_SCHEMA, "name": group.name, "robot": group.robot}
    content["instrument"] = {"kind": group.instrument.kind}
    content["campaigns"] = [
        {"schema": SCHEMA, **campaign.model_dump(mode="json", exclude_none=True)}
        for campaign in group.campaigns
    ]
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _described(name: str, members: Sequence[CampaignDescription]) -> GroupDescription:
    first = {key: getattr(members[0], key) for key in CampaignDescription.model_fields}
    commanded = all(member.joints == "commanded" for member in members)
    return GroupDescription(
        **first
        | {
            "name": name,
            "provenance": "; ".join(dict.fromkeys(member.provenance for member in members)),
            "members": tuple(members),
            "joints": "commanded" if commanded else "logged",
            "holdout": None,
            "columns": None,
        }
    )


def _difference(first: Arm, other: Arm) -> str | None:
    """Return in words where two descriptions of an arm differ; None where they agree."""
    if (first.n, first.convention) != (other.n, other.convention):
        return f"{first.n} {first.convention} rows and {other.n} {other.convention} rows"
    for name in _GEOMETRY:
        one, two = (np.asarray(getattr(arm, name), dtype=float) for arm in (first, other))
        if one.shape != two.shape:
            return name
        off = np.abs(one - two)
        if off.max(initial=0.0) > _SAME_GEOMETRY:
            at = np.unravel_index(int(np.argmax(off)), off.shape)
            return f"{name}, row {int(at[0]) + 1}: {one[at]:.9g} and {two[at]:.9g}"
    return None
