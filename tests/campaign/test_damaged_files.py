"""Known files that were cut, of another version, or in two units: refused, or what is left right.

Nothing is lost silently: what is read is right, and what is not is counted.
"""

from __future__ import annotations

import gzip
import re
from dataclasses import replace

import numpy as np
import pytest

from made_up_known_files import KNOWN, judged
from made_up_sightings import sighted
from pa10cal.campaign.formats import FORMATS


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    return sighted(tmp_path_factory.mktemp("raw"), "pose", noise_mm=0.02)


def some(names, every: int):
    """Return parameters: each so many-th, the others among the slow ones."""
    return [
        pytest.param(name, marks=[pytest.mark.slow] * (k % every > 0))
        for k, name in enumerate(names)
    ]


def of_format(name):
    """Return the file of a format, or skip where the package that reads it is not there."""
    if KNOWN[name].package:
        pytest.importorskip(KNOWN[name].package)
    return KNOWN[name]


def test_there_is_a_file_of_every_known_format():
    assert {name.split()[0] for name in KNOWN} == {each.name for each in FORMATS}


READABLE = [name for name in KNOWN if name != "yaskawa"]


@pytest.mark.slow_but_one_in(18)
@pytest.mark.parametrize("name", some(READABLE, 9))
def test_a_whole_file_is_read(tmp_path, raw, name):
    assert judged(tmp_path, raw, name, of_format(name).write(raw)) == "40 read"


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("share", some([0.63, 0.03, 0.94], 3))
def test_a_file_that_was_cut_is_refused_or_told(tmp_path, raw, name, share):
    """Within a line of text."""
    whole = of_format(name).write(raw)
    said = judged(tmp_path, raw, name, whole[: int(share * len(whole))].rstrip(b"\r\n")[:-1])
    ended = name.startswith("vicon") and share > 0.9  # in a section that is not read
    assert ended or re.match(r"refused|.*the last line is cut short", said), said


#: What of another version stands in the file in place of something: what is said then.
VERSIONS = {
    "motive": (b"Length Units,Meters", b"Length Units,Ells", r"take\.csv:1.*unit of lengths"),
    "vicon": (b",,deg,deg,deg,mm,mm,mm\n", b"", r"take\.csv:5: .*lacks the line of units"),
    "qualisys": (b"BODY_NAMES", b"BODIES", r"take\.tsv:\d+: the rows do not have the columns"),
    "blocks": (b"Y=", b"V=", "no position and no distance"),
    "spatialanalyzer": (
        b"Collection,  Group,",
        b"Collection  Group",
        "points.txt: there is no whole row",
    ),
    "polyworks": (b"\tMeas\t", b"\tReal\t", "no position and no distance"),
    "faro": (b"Center.y", b"Middle", "no point with a measured x, y and z"),
    "kuka": (b"E6AXIS", b"E7AXIS", "no joint positions"),
    "fanuc_ls": (b"GP1", b"GP2", "no joint positions"),
    "fanuc_posreg": (b"$POSREG", b"$PREG", "no rows of numbers"),
    "abb": (b"jointtarget", b"poseframe", "no joint positions"),
    "yaskawa": (b"PULSE", b"ANGLE", "points of the type ANGLE"),
    "mat": (b"\x00\x01IM", b"\x00\x02IM", r"a\.mat: the MATLAB file cannot be read .*v7\.3"),
    "npz": (b"PK\x03\x04", b"PK\x03\x03", r"a\.npz.*(cannot be read|it begins with PK)"),
    "npz alone": (b"NUMPY\x01", b"NUMPY\x09", r"a\.npy: .*only support format version"),
    "parquet": (b"PAR1", b"PAR2", r"a\.parquet:1: .*it begins with PAR2"),
    "json": (b'"xyz"', b'"abc"', "40 read"),
    "c3d": (b"\x03\x54", b"\x03\x60", r"a\.c3d: .*cannot be read .*processor type"),
    "bag": (b"#ROSBAG V2.0", b"#ROSBAG V1.2", r"a\.bag:1: .*it begins with #ROSBAG V1\.2"),
    "db3": (b"messages", b"messagez", r"a\.db3: the bag cannot be read .*missing tables"),
    "mcap": (b"MCAP0", b"MCAP1", r"a\.mcap:1: .*it begins with MCAP1"),
    "rtde": (b"actual_q_", b"q_actual_", "40 read"),
    "matrix": (b"m15", b"other", "40 read"),
    "points": (b"P1, ", b"a, b, c, d\nP1, ", "no position and no distance"),
    "polar": (b"V [deg]", b"elevation", r"40 read|refused"),
}


def test_there_is_another_version_of_every_known_format():
    assert {name.split()[0] for name in VERSIONS} == {each.name for each in FORMATS}


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize("name", VERSIONS)
def test_a_file_of_another_version_is_refused_or_read(tmp_path, raw, name):
    old, new, told = VERSIONS[name]
    whole = of_format(name).write(raw)
    assert old in whole
    said = judged(tmp_path, raw, name, whole.replace(old, new))
    assert re.search(told, said), said


@pytest.mark.parametrize(
    ("name", "file", "how", "told"),
    [
        ("json", "a.json.gz", gzip.compress, "gzip, of a file that is no text"),
        ("mat", "a.mat.gz", gzip.compress, "gzip, of a file that is no text"),
        ("npz", "a.zip", bytes, "got 'zip'"),
        ("kuka", "points.dat.zst", lambda text: b"\x28\xb5\x2f\xfd" + bytes(99) + text, "zstd"),
    ],
)
def test_a_file_that_is_packed_is_to_be_unpacked(tmp_path, raw, name, file, how, told):
    said = judged(tmp_path, raw, name, how(KNOWN[name].write(raw)), file)
    assert re.search(rf"{file}: the file is packed .*{told}.*; unpack it", said), said


#: Columns of one quantity in two units, by the header.
TWO_UNITS = {
    "vicon": (
        b",,deg,deg,deg,mm,mm,mm",
        b",,deg,deg,deg,mm,mm,m",
        r"take\.csv: columns of .*Flange z \[m\]",
    ),
    "polar": (b"V [deg]", b"V [gon]", r"readings\.csv: columns of .*V \[gon\]"),
    "matrix": (b"J6 [deg]", b"J6 [rad]", r"readings\.csv: columns of .*J6 \[rad\]"),
    "polyworks": (b"Units\tMillimeters", b"Units\tCubits", r"report\.txt:3: the unit of lengths"),
}


@pytest.mark.parametrize("name", TWO_UNITS)
def test_columns_of_one_quantity_in_two_units_are_refused(tmp_path, raw, name):
    old, new, told = TWO_UNITS[name]
    whole = KNOWN[name].write(raw)
    assert old in whole
    said = judged(tmp_path, raw, name, whole.replace(old, new))
    assert re.search(told, said), said


@pytest.mark.slow_but_one_in(8)
@pytest.mark.parametrize("name", some(READABLE, 7))
@pytest.mark.parametrize("first", [20, 36])
def test_rows_in_another_unit_are_refused_or_counted(tmp_path, raw, name, first):
    """From a row on: joints in radians where they were in degrees, or places in metres."""
    T, q = raw.T_instr_target.copy(), raw.q.copy()
    T[first:, :3, 3] *= 1e-3
    q[first:] *= np.pi / 180.0
    joints = KNOWN[name].beside in ("tracker", "stamped")
    other = replace(raw, q=q) if joints else replace(raw, T_instr_target=T)
    said = judged(tmp_path, raw, name, of_format(name).write(other))
    if first == 36:
        assert re.match("36 read; 4 far from where|refused: .*points.txt|refused: .*npy", said), (
            said
        )
    elif joints:
        assert re.search(r":\d+: .*in 20 of 40 rows the joint angles look like radians", said), said
    else:
        assert said.startswith("refused: "), said
