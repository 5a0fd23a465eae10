"""Mistakes that users of robots and trackers make: each is told by cause, place and remedy.

Of files and their columns, of campaign.yaml, and of names of files and folders that are not there;
of models in `commands/test_mistakes_with_models.py`.
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
    Own,
    calibrate,
    call,
    columns,
    edited,
    exchanged,
    put,
    scaled,
    told,
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

MISTAKES = told(
    "files",
    {
        # Units.
        "joints in radians under degrees": scaled(JOINTS, UNIT),
        "joints in degrees under radians": put("columns.poses.joints.unit", "rad"),
        "metres under millimetres": scaled(PLACE, 1e-3),
        "inches under millimetres": scaled(PLACE, 1 / 25.4),
        "millimetres under metres": put("columns.poses.position.unit", "m"),
        "A, B, C in radians under degrees": scaled(TURN, UNIT),
        "a load in kilograms under newtons": kilograms,
        "temperatures in kelvin": lambda own: own.table.__setitem__("Raumtemperatur [°C]", 294.6),
        "a reference temperature in Fahrenheit": (put("reference_temperature_C", 70.0), calibrate),
        "the mass of the tool in grams": put("tool.mass_kg", 1000.0),
        "an uncertainty in metres": (put("instrument.uncertainty_mm", 5e-5), calibrate),
        "gravity in units of g": put("gravity_m_s2", [0.0, 0.0, -1.0]),
        "gravity upwards": (put("gravity_m_s2", [0.0, 0.0, 9.80665]), calibrate),
        # Signs, zeros, order, axes and conventions.
        "the sign of a joint": (scaled(JOINTS[1:2], -1.0), calibrate),
        "the zero of a joint": (
            lambda own: own.table.__setitem__(JOINTS[2], own.table[JOINTS[2]] + 10.0),
            calibrate,
        ),
        "two joints exchanged": (exchanged(JOINTS[1], JOINTS[2]), calibrate),
        "a quaternion in the other order": (scalar_last, calibrate),
        "Euler angles in another order": (
            put("columns.poses.rotation.convention", "euler_XYZ"),
            calibrate,
        ),
        "inverse orientations": (inverted, calibrate),
        "a mirrored axis of the instrument": mirrored,
        "two axes of the instrument exchanged": exchanged(PLACE[0], PLACE[1]),
        "readings a row below their joints": shifted,
        "a joint that was not logged": constant,
        "another robot": put("robot", "irb120"),
        # How the file is written.
        "a decimal comma that is not declared": put("columns.poses.decimal", None),
        "another separator": put("columns.poses.separator", ","),
        "a header in another encoding": latin,
        "campaign.yaml in another encoding": windows,
        "no header": plain_header,
        "names in the second line": second_names,
        "cells of #N/A": unknown,
        "rows twice": repeated,
        "an empty file": (empty, columns),
        "day and month exchanged": month_first,
        # Which column is what.
        "a column mapped twice": put(
            "columns.poses.position.names", [PLACE[0], PLACE[1], PLACE[1]]
        ),
        "a column misspelt": put("columns.poses.kind.names", "Sats"),
        "words of held-out rows that are not stated": put(
            "columns.poses.kind.words", {"Training": "grid"}
        ),
        "too few joints": put("columns.poses.joints.names", JOINTS[:5]),
        "pose said, and points measured": put("columns.poses.rotation", None),
        "a target under another name": as_points,
        "files of joints and readings exchanged": two_files,
        "clocks in two time zones, and the hour added": zones,
    },
)


# Mistakes in campaign.yaml, and names of files and folders that are not there.


def run_of(*words: str, into: str = ""):
    def command(own: Own):
        folder = own.write() / into
        return call("run", folder, "--out", own.folder.parent / "out", *words)

    return command


MISTAKES += told(
    "description",
    {
        "a key misspelt": edited("gravity_m_s2", "gravity_ms2"),
        "a key at the wrong level": edited(
            "reference_temperature_C", "uncertainty_mm: 0.05\nreference_temperature_C"
        ),
        "no as a name": edited("name: zelle", "name: no"),
        "nothing behind a key": lambda own: (
            put("provenance", "x")(own) or edited("provenance: x", "provenance:")(own)
        ),
        "tabs": edited("  poses: messung.csv", "\tposes: messung.csv"),
        "a key twice": edited("name: zelle", "name: zelle\nname: zelle2"),
        "a number that YAML takes for a text": edited(
            "uncertainty_mm: 0.05", "uncertainty_mm: 5e-2 mm"
        ),
        "a number as a label": put("exclude", [{"where": 12, "why": "bumped"}]),
        "an instrument by its usual name": put("instrument.kind", "laser_tracker"),
        "a key that is missing": put("gravity_m_s2", None),
        "a path with backslashes": put("files.poses", "daten\\messung.csv"),
        # Files and folders that are not there.
        "a file of another name": put("files.poses", "Messung.CSV"),
        "an arm that is not described": (put("robot", "kr10"), run_of()),
        "the folder above": (lambda own: None, run_of(into="..")),
        "a folder that is not there": (lambda own: None, run_of(into="../zellle")),
        "settings that are not there": (lambda own: None, run_of("--settings", "robust.yaml")),
        "a prior that is not there": (lambda own: None, run_of("--prior", "results/march")),
    },
)


@pytest.mark.slow_but_one_in(9)
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
