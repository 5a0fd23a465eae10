"""Mistakes that users of robots and trackers make: each is told by cause, place and remedy.

Commands that take a model have theirs in `commands/test_mistakes_with_models.py`.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from built_once import built_once
from made_up_mistakes import (
    FILE,
    JOINTS,
    PLACE,
    QUATERNION,
    TURN,
    Mistake,
    Own,
    calibrate,
    call,
    columns,
    edited,
    exchanged,
    faults,
    own_campaign,
    put,
    scaled,
    with_quaternions,
)

UNIT = np.pi / 180


# Changes of the file that are more than a factor.


def inverted(own: Own) -> None:
    with_quaternions(own)
    own.table[QUATERNION[1:]] *= -1


def scalar_last(own: Own) -> None:
    with_quaternions(own)
    own.table[QUATERNION] = own.table[[*QUATERNION[1:], QUATERNION[0]]].to_numpy()


def shifted(own: Own) -> None:
    names = [*PLACE, *TURN]
    own.table[names] = own.table[names].shift(1)
    own.table = own.table.drop(index=0)


def unknown(own: Own) -> None:
    own.table[PLACE[1]] = own.table[PLACE[1]].map("{:.6f}".format).str.replace(".", ",")
    own.table.loc[::3, PLACE[1]] = "#N/A"


def repeated(own: Own) -> None:
    own.table = pd.concat([own.table, own.table])


def constant(own: Own) -> None:
    own.table[JOINTS[3]] = own.table[JOINTS[3]].iloc[0]


def kilograms(own: Own) -> None:
    own.table = own.table.rename(columns={"Last [N]": "Last [kg]"})
    own.poses["load"] = {"names": "Last [kg]"}
    own.table["Last [kg]"] = 5.0


def mirrored(own: Own) -> None:
    own.table[PLACE[1]] *= -1


def second_names(own: Own) -> None:
    own.above = [own.separator.join(f"Spalte {k}" for k in range(own.table.shape[1]))]


def as_points(own: Own) -> None:
    own.content["instrument"]["kind"] = "points"
    own.poses["targets"] = {"T1": own.poses.pop("position")}
    del own.poses["rotation"]
    own.content["tool"]["balls_mm"] = {"R1": [10.0, 20.0, 150.0]}


def two_files(own: Own) -> None:
    """Joints in one file, readings in another, by row; named the wrong way round."""
    poses, named = own.poses, own.content["files"]
    layout = {key: poses[key] for key in ("separator", "decimal")}
    own.content["columns"] = {
        "joints": layout | {"joints": poses["joints"]},
        "readings": layout | {key: poses[key] for key in ("position", "rotation")},
    }
    own.more = {
        "steuerung.csv": own.text(own.table[JOINTS]).encode(),
        "tracker.csv": own.text(own.table[[*PLACE, *TURN]]).encode(),
    }
    named.clear()
    named |= {"joints": "tracker.csv", "readings": "steuerung.csv"}
    own.content["holdout"] = {"every": 5}


def zones(own: Own) -> None:
    """Clocks an hour apart, and the hour added on the wrong side."""
    two_files(own)
    own.content["files"] = {"joints": "steuerung.csv", "readings": "tracker.csv"}
    clock = own.table["Zeit"]
    other = pd.to_datetime(clock, format="%d.%m.%Y %H:%M:%S") + pd.Timedelta(hours=1)
    late = own.table.assign(Zeit=other.dt.strftime("%d.%m.%Y %H:%M:%S"))
    own.more["steuerung.csv"] = own.text(own.table[["Zeit", *JOINTS]]).encode()
    own.more["tracker.csv"] = own.text(late[["Zeit", *PLACE, *TURN]]).encode()
    for each in own.content["columns"].values():
        each["time"] = {"names": "Zeit", "format": "%d.%m.%Y %H:%M:%S"}
    own.content["join"] = {"clock_offset_s": 3600.0}


def latin(own: Own) -> None:
    """A file of Windows, and names in campaign.yaml as an editor with another encoding has them."""
    own.encoding = "cp1252"
    own.poses["joints"]["names"] = [name.encode().decode("cp1252") for name in JOINTS]


def month_first(own: Own) -> None:
    own.poses["time"]["format"] = "%m.%d.%Y %H:%M:%S"
    own.table["Zeit"] = own.table["Zeit"].str.replace("05.03", "25.03", regex=False)


def written(name: str, text: bytes):
    def change(own: Own) -> None:
        own.more[name] = text

    return change


def empty(own: Own) -> None:
    own.more[FILE] = b""


def plain_header(own: Own) -> None:
    own.header = False


def windows(own: Own) -> None:
    """campaign.yaml in the encoding of Windows."""
    text = own.write().joinpath("campaign.yaml").read_text(encoding="utf-8")
    own.more["campaign.yaml"] = text.encode("cp1252")


def run_of(*words: str, into: str = ""):
    def command(own: Own):
        folder = own.write() / into
        return call("run", folder, "--out", own.folder.parent / "out", *words)

    return command


POSES = r"campaign\.yaml: columns\.poses"

MISTAKES = [
    # Units.
    Mistake(
        "joints in radians under degrees",
        scaled(JOINTS, UNIT),
        "joint angles look like radians",
        r"messung\.csv: `A1 \[°\]` \(`q1`\) … `A6 \[°\]` \(`q6`\)",
        r"set columns\.poses\.joints\.unit: rad",
        ("unit of joints",),
    ),
    Mistake(
        "joints in degrees under radians",
        put("columns.poses.joints.unit", "rad"),
        "joint angles look like degrees",
        r"messung\.csv.*`A\d \[°\]`",
        r"set columns\.poses\.joints\.unit: deg",
        ("unit of joints",),
    ),
    Mistake(
        "metres under millimetres",
        scaled(PLACE, 1e-3),
        "positions look like metres",
        r"messung\.csv: `X \[mm\]` \(`x_mm`\)",
        r"set columns\.poses\.position\.unit: m\b",
        ("unit of lengths",),
    ),
    Mistake(
        "inches under millimetres",
        scaled(PLACE, 1 / 25.4),
        "positions look like inches",
        r"messung\.csv: `X \[mm\]` \(`x_mm`\)",
        r"set columns\.poses\.position\.unit: in\b",
        ("unit of lengths",),
    ),
    Mistake(
        "millimetres under metres",
        put("columns.poses.position.unit", "m"),
        "positions look like millimetres",
        r"messung\.csv.*`[XYZ] \[mm\]`",
        r"set columns\.poses\.position\.unit: mm",
        ("unit of lengths",),
    ),
    Mistake(
        "A, B, C in radians under degrees",
        scaled(TURN, UNIT),
        "angles of the attitudes look like radians",
        r"messung\.csv: `A \[°\]`, `B \[°\]`, `C \[°\]`",
        r"set columns\.poses\.rotation\.unit: rad",
        ("unit of attitudes",),
    ),
    Mistake(
        "a load in kilograms under newtons",
        kilograms,
        "header says kg.*read in N",
        r"messung\.csv: `Last \[kg\]` \(`load_N`\)",
        r"set columns\.poses\.load\.unit: kg",
        ("unit of loads",),
        warned=True,
    ),
    Mistake(
        "temperatures in kelvin",
        lambda own: own.table.__setitem__("Raumtemperatur [°C]", 294.6),
        "looks like kelvin",
        r"messung\.csv: `Raumtemperatur \[°C\]` \(`temperature_C`\)",
        r"set columns\.poses\.temperature\.unit: K",
        ("unit of temperatures",),
    ),
    Mistake(
        "a reference temperature in Fahrenheit",
        put("reference_temperature_C", 70.0),
        "70 deg C is no usual temperature.*Fahrenheit",
        r"campaign\.yaml: reference_temperature_C",
        r"set reference_temperature_C: 21",
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "the mass of the tool in grams",
        put("tool.mass_kg", 1000.0),
        "tool is heavier than the arm can carry",
        r"campaign\.yaml: tool\.mass_kg",
        r"tool\.mass_kg: 1\b.*grams",
        ("mass",),
    ),
    Mistake(
        "an uncertainty in metres",
        put("instrument.uncertainty_mm", 5e-5),
        "scatter|stated uncertainty",
        r"instrument\.uncertainty_mm",
        "looks like metres, multiply it by 1000",
        ("uncertainty", "unit of lengths"),
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "gravity in units of g",
        put("gravity_m_s2", [0.0, 0.0, -1.0]),
        "gravity is in units of g",
        r"campaign\.yaml: gravity_m_s2",
        r"set gravity_m_s2: \[0, 0, -9\.8\d*\]",
        ("gravity",),
    ),
    Mistake(
        "gravity upwards",
        put("gravity_m_s2", [0.0, 0.0, 9.80665]),
        "gravity seems to act along -z",
        r"campaign\.yaml: gravity_m_s2",
        r"set gravity_m_s2: \[0, 0, -9\.8\d*\]",
        ("gravity",),
        command=calibrate,
        warned=True,
    ),
    # Signs, zeros, order, axes and conventions.
    Mistake(
        "the sign of a joint",
        scaled(JOINTS[1:2], -1.0),
        "sign of joint 2 is reversed",
        r"`A2 \[°\]` \(`q2`\)",
        r"set joint_signs: \[1, -1, 1, 1, 1, 1\]",
        ("signs",),
        command=calibrate,
    ),
    Mistake(
        "the zero of a joint",
        lambda own: own.table.__setitem__(JOINTS[2], own.table[JOINTS[2]] + 10.0),
        "zero of joint 3",
        r"`A3 \[°\]` \(`q3`\)",
        r"set joint_offsets_deg: \[0, 0, -10[.\d]*, 0, 0, 0\]",
        ("zeros",),
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "two joints exchanged",
        exchanged(JOINTS[1], JOINTS[2]),
        "joints 2 and 3 are exchanged",
        r"`A2 \[°\]` \(`q2`\), `A3 \[°\]` \(`q3`\)",
        r"set columns\.poses\.joints\.names: \['?A1 \[°\]'?, '?A3 \[°\]'?, '?A2 \[°\]'?, '?A4",
        ("order of joints",),
        command=calibrate,
    ),
    Mistake(
        "a quaternion in the other order",
        scalar_last,
        "order x, y, z, w",
        r"`Q1`, `Q2`, `Q3`, `Q4`",
        r"set columns\.poses\.rotation\.convention: quaternion_xyzw",
        ("convention",),
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "Euler angles in another order",
        put("columns.poses.rotation.convention", "euler_XYZ"),
        "Euler angles Z-Y-X about moving axes",
        r"`A \[°\]`, `B \[°\]`, `C \[°\]`",
        r"set columns\.poses\.rotation\.convention: euler_ZYX",
        ("convention",),
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "inverse attitudes",
        inverted,
        "inverse rotation",
        r"`Q1`, `Q2`, `Q3`, `Q4`",
        r"set columns\.poses\.rotation\.inverse: true",
        ("inverse",),
        command=calibrate,
        warned=True,
    ),
    Mistake(
        "a mirrored axis of the instrument",
        mirrored,
        "instrument's axes are x, -y, z",
        r"messung\.csv: `X \[mm\]` \(`x_mm`\), `Y \[mm\]` \(`y_mm`\)",
        r"turn the sign of `Y \[mm\]`",
        ("axes",),
    ),
    Mistake(
        "two axes of the instrument exchanged",
        exchanged(PLACE[0], PLACE[1]),
        "instrument's axes are y, x, z",
        r"messung\.csv: `X \[mm\]` \(`x_mm`\), `Y \[mm\]` \(`y_mm`\)",
        r"set columns\.poses\.position\.names: \['?Y \[mm\]'?, '?X \[mm\]'?, '?Z \[mm\]'?\]",
        ("axes",),
    ),
    Mistake(
        "readings a row below their joints",
        shifted,
        "readings fit the joints of the row before",
        r"messung\.csv:2",
        "move the readings one row up",
        ("rows",),
    ),
    Mistake(
        "a joint that was not logged",
        constant,
        "same number in all rows",
        r"messung\.csv: `A4 \[°\]` \(`q4`\)",
        "log the joint|export",
        warned=True,
    ),
    Mistake(
        "another robot",
        put("robot", "irb120"),
        "beyond the limits of joint 2 in the description of irb120",
        r"messung\.csv:2: `A\d \[°\]` \(`q\d`\)",
        "check robot in campaign.yaml",
    ),
    # How the file is written.
    Mistake(
        "a decimal comma that is not declared",
        put("columns.poses.decimal", None),
        "a decimal comma",
        r"messung\.csv:2.*`A1 \[°\]`",
        r"set columns\.poses\.decimal: ','",
        ("decimal",),
    ),
    Mistake(
        "another separator",
        put("columns.poses.separator", ","),
        "separated by semicolons",
        r"messung\.csv:1",
        r"set columns\.poses\.separator: ';'",
        ("separator",),
    ),
    Mistake(
        "a header in another encoding",
        latin,
        "cp1252",
        r"messung\.csv:1.*A1 \[Â°\]",
        r"A1 \[°\].*UTF-8",
        ("meant",),
    ),
    Mistake(
        "campaign.yaml in another encoding",
        windows,
        "not UTF-8",
        r"campaign\.yaml.*line 1?\d",
        "save it as UTF-8",
    ),
    Mistake(
        "no header",
        plain_header,
        "missing columns? .*first line holds numbers|no header",
        r"messung\.csv:1",
        r"set columns\.poses\.header: 0",
        ("header",),
    ),
    Mistake(
        "names in the second line",
        second_names,
        "missing columns Zeit",
        r"messung\.csv:1",
        r"set columns\.poses\.header: 2",
        ("header",),
    ),
    Mistake(
        "cells of #N/A",
        unknown,
        r"14 of 40 rows.*not a finite number.*#N/A",
        r"messung\.csv:2.*`Y \[mm\]`",
        r"column `Y \[mm\]`",
        ("quarantine",),
    ),
    Mistake(
        "rows twice",
        repeated,
        "40 of 80 rows.*repeats an earlier row",
        r"messung\.csv:42",
        "remove the rows that stand there twice",
    ),
    Mistake(
        "an empty file",
        empty,
        "the file is empty",
        r"messung\.csv",
        "export it again",
        command=columns,
    ),
    Mistake(
        "day and month exchanged",
        month_first,
        r"40 of 40 rows.*not a finite number.*25\.03\.2026",
        r"messung\.csv:2.*`Zeit`",
        r"set columns\.poses\.time\.format: '%d\.%m\.%Y %H:%M:%S'",
        ("time",),
    ),
    # Which column is what.
    Mistake(
        "a column mapped twice",
        put("columns.poses.position.names", [PLACE[0], PLACE[1], PLACE[1]]),
        "a column is mapped twice",
        rf"{POSES}.*`Y \[mm\]`.*y_mm and z_mm",
        r"columns\.poses\.position",
    ),
    Mistake(
        "a column misspelt",
        put("columns.poses.kind.names", "Sats"),
        "missing column Sats",
        r"messung\.csv:1",
        r"is it 'Satz'\? correct columns\.poses\.kind in campaign\.yaml",
        ("meant",),
    ),
    Mistake(
        "words of held-out rows that are not stated",
        put("columns.poses.kind.words", {"Training": "grid"}),
        "Prüfung.*none of grid, holdout",
        r"messung\.csv.*`Satz`",
        r"add 'Prüfung' to columns\.poses\.kind\.words, as grid or as holdout",
        ("words",),
    ),
    Mistake(
        "too few joints",
        put("columns.poses.joints.names", JOINTS[:5]),
        "5 columns are named",
        rf"{POSES}\.joints\.names",
        "6, one for each joint",
    ),
    Mistake(
        "pose said, and points measured",
        put("columns.poses.rotation", None),
        "no attitude is mapped|nothing is mapped to qw",
        rf"{POSES}",
        r"set columns\.poses\.rotation, or instrument\.kind: points with the position under tar",
        ("kind",),
    ),
    Mistake(
        "a target under another name",
        as_points,
        "tool.balls_mm states R1.*T1|T1.*tool.balls_mm.*R1",
        r"campaign\.yaml: tool\.balls_mm",
        "rename",
        warned=True,
    ),
    Mistake(
        "files of joints and readings exchanged",
        two_files,
        "missing columns? A1",
        r"tracker\.csv:1",
        r"exchange files\.joints and files\.readings",
        ("files",),
    ),
    Mistake(
        "clocks in two time zones, and the hour added",
        zones,
        "cannot be joined by time",
        r"campaign\.yaml: join\.clock_offset_s",
        r"remove join\.clock_offset_s: it is then found, -3600",
        ("clock",),
    ),
    # campaign.yaml.
    Mistake(
        "a key misspelt",
        edited("gravity_m_s2", "gravity_ms2"),
        "unknown key gravity_ms2",
        r"campaign\.yaml",
        "did you mean 'gravity_m_s2'",
        ("meant",),
    ),
    Mistake(
        "a key at the wrong level",
        edited("reference_temperature_C", "uncertainty_mm: 0.05\nreference_temperature_C"),
        "unknown key uncertainty_mm",
        r"campaign\.yaml",
        r"it belongs under instrument: instrument\.uncertainty_mm",
    ),
    Mistake(
        "no as a name",
        edited("name: zelle", "name: no"),
        "YAML reads no, off, false without quotes as false",
        r"campaign\.yaml.*key name",
        'write it in quotes, as "no"',
    ),
    Mistake(
        "nothing behind a key",
        lambda own: put("provenance", "x")(own) or edited("provenance: x", "provenance:")(own),
        "nothing is stated",
        r"campaign\.yaml.*key provenance",
        "a text",
    ),
    Mistake(
        "tabs",
        edited("  poses: messung.csv", "\tposes: messung.csv"),
        "tab",
        r"campaign\.yaml.*line \d+",
        "indent with spaces",
    ),
    Mistake(
        "a key twice",
        edited("name: zelle", "name: zelle\nname: zelle2"),
        "the key name stands there twice",
        r"campaign\.yaml.*line 3",
        "remove one",
    ),
    Mistake(
        "a number that YAML takes for a text",
        edited("uncertainty_mm: 0.05", "uncertainty_mm: 5e-2 mm"),
        "instrument.uncertainty_mm does not fit.*5e-2 mm",
        r"campaign\.yaml",
        r"a number; set instrument\.uncertainty_mm accordingly",
    ),
    Mistake(
        "a number as a label",
        put("exclude", [{"where": 12, "why": "bumped"}]),
        "YAML reads it as a number",
        r"campaign\.yaml.*exclude\.0\.where",
        'in quotes, as "12"',
    ),
    Mistake(
        "an instrument by its usual name",
        put("instrument.kind", "laser_tracker"),
        "instrument.kind does not fit.*laser_tracker",
        r"campaign\.yaml",
        r"one of distance, points, pose, touch_trigger_cmm; set instrument\.kind",
    ),
    Mistake(
        "a key that is missing",
        put("gravity_m_s2", None),
        "missing key gravity_m_s2",
        r"campaign\.yaml",
        r"\[0, 0, -9\.81\] for an upright arm; set gravity_m_s2",
    ),
    Mistake(
        "a path with backslashes",
        put("files.poses", "daten\\messung.csv"),
        r"files\.poses does not fit.*daten",
        r"campaign\.yaml",
        r"the name of a file in the campaign's folder alone, messung\.csv; set files\.poses",
    ),
    # Files and folders that are not there.
    Mistake(
        "a file of another name",
        put("files.poses", "Messung.CSV"),
        "the file is not there.*Messung.CSV",
        r"campaign\.yaml: files\.poses",
        r"did you mean 'messung\.csv'",
        ("meant",),
    ),
    Mistake(
        "an arm that is not described",
        put("robot", "kr10"),
        "unknown robot.*kr10",
        r"campaign\.yaml: robot|robot",
        r"kr10\.yaml|import_arm",
        command=run_of(),
    ),
    Mistake(
        "the folder above",
        lambda own: None,
        "there is no campaign.yaml",
        r"/campaign\.yaml",
        r"did you mean the folder 'zelle' in it\?",
        ("meant",),
        command=run_of(into=".."),
    ),
    Mistake(
        "a folder that is not there",
        lambda own: None,
        "the folder is not there",
        r"zellle",
        "did you mean 'zelle'",
        ("meant",),
        command=run_of(into="../zellle"),
    ),
    Mistake(
        "settings that are not there",
        lambda own: None,
        "the file is not there",
        r"robust\.yaml",
        "check the path",
        command=run_of("--settings", "robust.yaml"),
    ),
    Mistake(
        "a prior that is not there",
        lambda own: None,
        "the file is not there|no model.yaml",
        r"results/march",
        "correct the path",
        command=run_of("--prior", "results/march"),
    ),
]


@pytest.fixture(scope="module", name="right")
def _right(tmp_path_factory) -> Own:
    return built_once(tmp_path_factory, "right_campaign", own_campaign)


@pytest.fixture
def own(right, tmp_path, monkeypatch) -> Own:
    def never(*_):
        raise AssertionError("the workflow was started")

    monkeypatch.setattr("pa10cal.running.workflow.run_workflow", never)
    return right.copy(tmp_path / "zelle")


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_is_told_by_cause_place_and_remedy(own, mistake):
    mistake.spoil(own)
    said = mistake.command(own)
    assert not faults(mistake, said), said.text


def test_the_right_campaign_has_nothing_to_be_told_of(own):
    said = calibrate(own)
    assert said.code == 0
    assert "warning" not in said.err
    assert "suspect_input" not in said.out


def test_a_proposal_for_the_right_campaign_has_its_mapping(own):
    said = columns(own)
    assert said.code == 0
    assert "40 rows can be used, 0 cannot" in said.out
