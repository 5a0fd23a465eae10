"""Mistakes that users of robots and trackers make: each is told by cause, place and remedy.

Of files and their columns here; of what campaign.yaml says, and of files that are not there, in
`test_mistakes_of_the_description.py`; of models in `commands/test_mistakes_with_models.py`.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from made_up_mistakes import (
    FILE,
    JOINTS,
    PLACE,
    QUATERNION,
    TURN,
    Mistake,
    Own,
    calibrate,
    columns,
    exchanged,
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
    steps_s = np.random.default_rng(1).uniform(20, 90, len(own.table)).cumsum()
    at = pd.Timestamp("2026-03-05 09:30") + pd.to_timedelta(steps_s, unit="s")
    own.table["Zeit"] = at.strftime("%d.%m.%Y %H:%M:%S")
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
        "angles of the orientations look like radians",
        r"messung\.csv: `A \[°\]`, `B \[°\]`, `C \[°\]`",
        r"set columns\.poses\.rotation\.unit: rad",
        ("unit of orientations",),
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
        "inverse orientations",
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
        r"messung\.csv:2: `A \[°\]` \(`qw … qz`\)|messung\.csv:2: `A \[°\]`",
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
        "10 of 40 rows.*none of line_x, line_y, grid, holdout.*Prüfung",
        r"messung\.csv:32: `Satz` \(`kind`\)",
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
        "no orientation is mapped|nothing is mapped to qw",
        rf"{POSES}",
        r"set columns\.poses\.rotation, or instrument\.kind: points with the position under tar",
        ("kind",),
    ),
    Mistake(
        "a target under another name",
        as_points,
        "tool.balls_mm states R1, and the columns are of T1",
        r"campaign\.yaml: tool\.balls_mm",
        "rename them in tool.balls_mm",
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
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_is_told_by_cause_place_and_remedy(own, mistake):
    mistake.judge(own)


def test_the_right_campaign_has_nothing_to_be_told_of(own):
    said = calibrate(own)
    assert said.code == 0
    assert "warning" not in said.err
    assert "suspect_input" not in said.out


def test_a_proposal_for_the_right_campaign_has_its_mapping(own):
    said = columns(own)
    assert said.code == 0
    assert "40 rows can be used, 0 cannot" in said.out
