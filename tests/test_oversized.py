"""Content that would take hours or all memory to read: refused in seconds, with a true reason."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path

import pytest
import yaml

from built_once import built_once
from made_up_results import small_results

MB = 1_000_000
#: The most text that is read.
MOST = 310 * MB


def filled(block: bytes, size: int, before: bytes = b"", after: bytes = b""):
    """Yield blocks of a file of about a size."""
    many = block * max(1, (4 * MB) // len(block))
    return chain([before], repeat(many, size // len(many)), [after])


def written(path: Path, blocks) -> Path:
    with path.open("wb") as file:
        for block in blocks:
            file.write(block)
    return path


# Text: raw files of campaigns, exports to be recognised, lists of joints.

CMM = b"time_s,kind,pose,load_N,repeat,ball,touch,x_mm,y_mm,z_mm\n"
ROW = b"1,grid,P01,0,1,A,1,%d,2,3\n"
#: Long files of short lines have too many of them, others too many that cannot be read.
UNREADABLE = r"too many lines|\d{6} rows or numbers of the first \d{5,6} rows cannot be read"
#: What the file of touches holds: of any size, and the message.
TEXTS = {
    "line ends": (lambda size: filled(b"\n", size), "too many lines"),
    "carriage returns": (lambda size: filled(b"\r", size), "too many lines"),
    "blank lines": (lambda size: filled(b"  \n", size, CMM), "too many lines"),
    "short lines": (lambda size: filled(b"a\n", size, CMM), "too many lines"),
    "lines of commas": (
        lambda size: filled(b",,,,,,,,,\n", size, CMM),
        UNREADABLE,
    ),
    "the same row": (
        lambda size: filled(ROW % 1, size, CMM),
        UNREADABLE,
    ),
    "rows of words": (
        lambda size: filled(b"a,grid,P01,b,c,A,d,e,f,g\n", size, CMM),
        UNREADABLE,
    ),
    "one line": (lambda size: filled(b"a", size), "cmm.csv:1: a line is too long"),
    "one line of numbers": (lambda size: filled(b"1,", size), "cmm.csv:1: a line is too long"),
    "one row": (lambda size: filled(b"1,", size, CMM + ROW % 1), "cmm.csv:3: a line is too long"),
    "one row at the end": (
        lambda size: chain([CMM], (ROW % k for k in range(99_999)), filled(b"a", size)),
        r"cmm.csv:\d+: a line is too long",
    ),
    "a million columns": (
        lambda size: filled(b"a,", 4 * MB, b"", b"b\n1\n"),
        "cmm.csv:1: a line is too long",
    ),
    "many columns": (
        lambda size: filled(b"1,2,\n", size, b",".join(b"c%d" % k for k in range(2500)) + b"\n"),
        "too many columns: 2500|too many lines",
    ),
    "zeros": (lambda size: filled(b"\0", size), "no text|a line is too long"),
    "zeros below": (lambda size: filled(b"\0", size, CMM), "a line is too long|UTF-8"),
    "zeros in lines": (lambda size: filled(b"\0\n", size, CMM), "too many lines"),
    "a quote": (lambda size: filled(b"a", size, CMM + b'"'), "cmm.csv:2: a line is too long"),
    "a quote in every line": (
        lambda size: filled(b'"a,1\n', size, CMM),
        UNREADABLE,
    ),
    "many quotes": (lambda size: filled(b'"', size, CMM), "cmm.csv:2: a line is too long"),
    "a long label": (
        lambda size: chain(
            [CMM + b"1,grid," + b"P" * 500_000 + b",0,1,A,1,1,2,3\n"],
            (ROW % k for k in range(1000)),
        ),
        "a label under pose has 500000 letters",
    ),
    "more than is read": (
        lambda size: filled(ROW % 1, MOST + 5 * MB, CMM),
        "larger than is read|too many lines",
    ),
    "random": (lambda size: filled(bytes(range(256)), size), "not UTF-8"),
    "UTF-16": (
        lambda size: filled("a".encode("utf-16-le"), size, b"\xff\xfe"),
        "a line is too long",
    ),
    "UTF-16 lines": (
        lambda size: filled("\n".encode("utf-16-le"), size, b"\xff\xfe"),
        "too many lines",
    ),
    "UTF-32": (
        lambda size: filled("\U0001f600".encode("utf-32-le"), size, b"\xff\xfe\0\0"),
        "a line is too long",
    ),
    "letters beyond": (lambda size: filled("\U0001f600".encode(), size), "a line is too long"),
}
#: Those that take seconds, since half a million rows are read first.
LONG = ("the same row", "rows of words", "a quote in every line", "lines of commas")


def _some(kinds, *quick):
    """Return kinds, those that are not among the quick ones as slow tests."""
    return [k if k in quick else pytest.param(k, marks=pytest.mark.slow) for k in kinds]


def _cases(kinds, size, large=MOST):
    """Return kinds at a size, and as a slow test at another one."""
    usual = [pytest.param(k, size, marks=[pytest.mark.slow] * (k in LONG)) for k in kinds]
    return usual + [pytest.param(k, large, marks=pytest.mark.slow) for k in kinds]


@pytest.fixture
def touched(attack, raw_campaign):
    replace(raw_campaign, folder=attack.inside / "made-up").write()
    return attack


def ingest(attack):
    out = {"out": attack.inside / "p.parquet", "quarantine": attack.inside / "q.csv"}
    return attack("ingest", campaign_dir=attack.inside / "made-up", **out)


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize(("kind", "size"), _cases(TEXTS, 24 * MB))
def test_text_without_end_is_refused(touched, kind, size):
    content, message = TEXTS[kind]
    written(touched.inside / "made-up/cmm.csv", content(size))
    ingest(touched).refused(message)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("size", [pytest.param(MOST, marks=pytest.mark.slow)])
def test_an_export_without_end_is_refused_or_looked_at(attack, kind, size):
    """Rows are looked at as far as is needed."""
    written(attack.inside / "export.csv", TEXTS[kind][0](size))
    attack("columns", attack.inside / "export.csv").harmless()


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("size", [pytest.param(24 * MB, marks=pytest.mark.slow)])
def test_two_logs_without_end_are_refused(attack, kind, size):
    for name in ("joints.csv", "readings.csv"):
        written(attack.inside / name, TEXTS[kind][0](size))
    attack("columns", attack.inside / "joints.csv", attack.inside / "readings.csv").harmless()


@pytest.mark.parametrize(
    ("kind", "size"), _cases(["line ends", "one line", "zeros", "the same row"], 24 * MB, 10**9)
)
def test_what_is_packed_is_unpacked_no_further_than_is_read(touched, kind, size):
    path = touched.inside / "made-up/cmm.csv"
    with gzip.open(path, "wb", compresslevel=1) as packed:
        for block in TEXTS[kind][0](size):
            packed.write(block)
    ingest(touched).refused(f"too long|larger than is read|no text|{UNREADABLE}")


# YAML: descriptions of campaigns and arms, models, settings.

DIGITS = 500_000
YAMLS = {
    "digits": lambda: "a: " + "9" * DIGITS,
    "hexadecimal digits": lambda: "a: 0x" + "f" * DIGITS,
    "sexagesimals": lambda: "a: 1" + ":1" * DIGITS,
    "sexagesimals with decimals": lambda: "a: 1" + ":1" * DIGITS + ".5",
    "sexagesimals by a tag": lambda: "a: !!int '1" + ":1" * DIGITS + "'",
    "decimals": lambda: "a: 0." + "1" * DIGITS,
    "a power": lambda: "a: 1e" + "9" * DIGITS,
    "decimals of seconds": lambda: "a: 2001-01-01T00:00:00." + "1" * DIGITS,
    "digits as a key": lambda: "? " + "9" * DIGITS + "\n: 1",
    "no number": lambda: "a: " + "1_" * DIGITS + "x",
    "keys of one place": lambda: "".join(f"{k * (2**61 - 1)}: 1\n" for k in range(100_000)),
    "anchors": lambda: "[" + ",".join(f"&a{k} 1" for k in range(DIGITS)) + "]",
    "aliases": lambda: "a: &a 1\nb: [" + "*a," * DIGITS + "]",
    "laughs": lambda: (
        "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 20))
    ),
    "merges": lambda: (
        "a0: &a0 {x: 1}\n"
        + "".join(f"a{k}: &a{k} {{<<: *a{k - 1}, k{k}: 1}}\n" for k in range(1, 5000))
    ),
    "merges at once": lambda: "a: &a {x: 1}\nb: {<<: [" + "*a," * DIGITS + "]}",
    "brackets": lambda: "[" * DIGITS,
    "braces": lambda: "{a: " * DIGITS,
    "dashes": lambda: "- " * DIGITS,
    "questions": lambda: "? " * DIGITS,
    "steps": lambda: "".join(" " * k + "a:\n" for k in range(3000)),
    "values": lambda: "- a\n" * DIGITS,
    "mappings": lambda: "- {a: 1}\n" * DIGITS,
    "many values": lambda: "- [1, a, 2001-01-01, 1.5]\n" * 39_000,
    "keys": lambda: "".join(f"k{k}: 1\n" for k in range(DIGITS)),
    "members of a set": lambda: "!!set {" + ",".join(f"k{k}" for k in range(DIGITS)) + "}",
    "an ordered mapping": lambda: "!!omap [" + ",".join(f"k{k}: 1" for k in range(DIGITS)) + "]",
    "documents": lambda: "---\n" * DIGITS,
    "binary": lambda: "a: !!binary " + "A" * DIGITS,
    "no binary": lambda: "a: !!binary " + "=" * DIGITS,
    "a tag": lambda: "a: !" + "x" * DIGITS + " 1",
    "an anchor": lambda: "a: &" + "x" * DIGITS + " 1",
    "a key": lambda: "? " + "x" * DIGITS + "\n: 1",
    "a text": lambda: "a: '" + "x" * 40 * MB + "'",
    "a text of lines": lambda: "a: '" + "x\n" * 20 * MB + "'",
    "line ends": lambda: "\n" * 60 * MB,
    "comments": lambda: "#\n" * 30 * MB,
    "more than is read": lambda: "#\n" * 40 * MB,
}


#: One of each bound.
QUICK = ("digits", "sexagesimals", "brackets", "laughs", "keys", "values", "documents", "no number")


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("kind", _some(YAMLS, *QUICK))
def test_yaml_without_end_is_refused(attack, kind):
    path = attack.inside / "arm.yaml"
    path.write_text(YAMLS[kind](), encoding="utf-8")
    attack("effects", robot=path).refused("arm.yaml")


#: What the values of a description are, each of the type that YAML has for them.
VALUES = {
    "excluded rows": ("exclude", [1] * 150_000),
    "excluded rows of keys": ("exclude", [{}] * 150_000),
    "unknown keys": ("tool", {f"k{k}": 1 for k in range(9_000)}),
    "balls": ("tool", {"mass_kg": 1, "balls_mm": {f"B{k}": 1 for k in range(9_000)}}),
    "a long key": ("x" * 100_000, 1),
    "a number beyond": ("joint_offsets_deg", [10**60] * 100_000),
    "a name of columns": ("columns", {"poses": {"joints": {"names": ["x" * MB] * 20}}}),
    "names of columns": ("columns", {"poses": {"joints": {"names": ["x"] * 150_000}}}),
    "a format of times": ("columns", {"poses": {"time": {"names": "t", "format": "%f" * 100_000}}}),
    "words of kinds": (
        "columns",
        {"poses": {"kind": {"names": "a", "words": {str(k): "x" for k in range(9_000)}}}},
    ),
    "a line of names": ("columns", {"cmm": {"header": 10**15}}),
    "a pattern of rows": ("exclude", [{"where": "pose " + "1" * MB, "why": "x"}]),
    "lines excluded": ("exclude", [{"where": "lines 1 to 999999999999999", "why": "x"}]),
    "a name": ("name", "x" * MB),
    "a robot": ("robot", "x" * MB),
    "a file": ("files", {"cmm": "x" * MB, "resolver": "y"}),
    "an instrument": ("instrument", {"kind": "x" * MB, "uncertainty_mm": 1}),
}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("kind", _some(VALUES, "a long key", "a name", "unknown keys"))
def test_a_description_of_many_values_is_refused(touched, kind):
    path = touched.inside / "made-up/campaign.yaml"
    key, value = VALUES[kind]
    text = path.read_text("utf-8")
    content = yaml.safe_load(text) | {key: value}
    path.write_text(json.dumps(content), encoding="utf-8")  # YAML too, and quicker written
    found = ingest(touched)
    found.refused("campaign.yaml")
    assert len(found.said) < 20_000


# URDFs.

LINK = '<link name="l{0}"/>'
JOINT = '<joint name="j{0}" type="{1}"><parent link="l{2}"/><child link="l{0}"/></joint>'


def urdf(count, above=lambda k: k - 1, kind="fixed"):
    links = "".join(LINK.format(k) for k in range(count))
    joints = "".join(JOINT.format(k, kind, above(k)) for k in range(1, count))
    return f'<robot name="r">{links}{joints}</robot>'


def element(inside):
    return f'<robot name="r">{LINK.format(0)}{LINK.format(1)}{inside}</robot>'


URDFS = {
    "joints": (lambda: urdf(20_000), "too many links .*20000"),
    "joints in a row": (lambda: urdf(5_000, kind="revolute"), "too many joints move .*4999"),
    "fixed joints in a row": (lambda: urdf(5_000), "no joint moves"),
    "branches": (lambda: urdf(5_000, lambda k: 0, "revolute"), "the robot branches.*4999 tips"),
    "branches of branches": (
        lambda: urdf(5_000, lambda k: k // 2, "continuous"),
        "the robot branches",
    ),
    "a circle": (lambda: urdf(5_000, lambda k: k + 1 if k < 4_999 else 1), "joints form a loop"),
    "joints of one link": (
        lambda: urdf(5_000).replace('child link="l', 'child link="l1" name="'),
        "two joints",
    ),
    "links of one name": (
        lambda: urdf(5_000).replace('<link name="l', '<link name="" x="'),
        "two links have one name",
    ),
    "joints of no link": (
        lambda: urdf(5_000).replace('parent link="l', 'parent link="m'),
        "names a link",
    ),
    "depth": (lambda: "<robot>" + "<a>" * 500_000, "nested deeper than 100"),
    "depth and back": (
        lambda: "<robot>" + "<a>" * 500_000 + "</a>" * 500_000 + "</robot>",
        "nested deeper",
    ),
    "elements": (lambda: element("<a/>" * 1_000_000), "more than 100000 elements"),
    "elements in elements": (
        lambda: element("<a>" + "<b/>" * 1_000_000 + "</a>"),
        "more than 100000",
    ),
    "laughs": (
        lambda: (
            '<!DOCTYPE r [<!ENTITY a0 "ha">'
            + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 20))
            + "]><robot>&a19;</robot>"
        ),
        "entities",
    ),
    "one entity often": (
        lambda: f'<!DOCTYPE r [<!ENTITY a "{"x" * 100_000}">]><robot>{"&a;" * 100_000}</robot>',
        "entities",
    ),
    "an entity of a file": (
        lambda: (
            '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;">&a;</robot>'
        ),
        "entities",
    ),
    "an entity of parameters": (
        lambda: '<!DOCTYPE r [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]><robot/>',
        "entities",
    ),
    "a definition outside": (
        lambda: '<!DOCTYPE r SYSTEM "/etc/passwd"><robot/>',
        "no root|single tree",
    ),
    "a long attribute": (lambda: element(f'<a b="{"x" * 15 * MB}"/>'), "single tree"),
    "attributes": (
        lambda: element("<a " + " ".join(f'a{k}=""' for k in range(500_000)) + "/>"),
        "single tree",
    ),
    "a long name": (lambda: element(f'<link name="{"x" * 15 * MB}"/>'), "single tree"),
    "a long tag": (lambda: element(f"<{'x' * 15 * MB}/>"), "single tree"),
    "a long text": (lambda: element("x" * 15 * MB), "single tree"),
    "a long comment": (lambda: element(f"<!--{'x' * 15 * MB}-->"), "single tree"),
    "comments": (lambda: element("<!---->" * 2_000_000), "single tree"),
    "instructions": (lambda: element("<?a?>" * 2_000_000), "single tree"),
    "a long number": (
        lambda: urdf(2, kind="revolute").replace(
            "<parent", f'<origin xyz="{"1" * 10 * MB} 0 0"/><parent'
        ),
        "xyz cannot be read",
    ),
    "many numbers": (
        lambda: urdf(2, kind="revolute").replace(
            "<parent", f'<origin xyz="{"1 " * 5 * MB}"/><parent'
        ),
        "xyz cannot be read",
    ),
    "a long type": (lambda: urdf(2, kind="x" * 10 * MB), "unknown type"),
    "blanks": (lambda: element(" " * 15 * MB), "single tree"),
    "more than is read": (lambda: element(" " * 20 * MB), "16.8 MB are read"),
    "no end": (lambda: "<robot", "not XML"),
    "zeros": (lambda: "\0" * 10 * MB, "not XML"),
}


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize(
    "kind", _some(URDFS, "joints", "a circle", "depth", "laughs", "a long number")
)
def test_a_urdf_without_end_is_refused(attack, kind):
    text, message = URDFS[kind]
    (attack.inside / "robot.urdf").write_text(text(), encoding="utf-8")
    found = attack("import_arm", attack.inside / "robot.urdf", out=attack.inside / "arm.yaml")
    found.refused(message, "robot.urdf")
    assert found.seconds < 5.0
    assert len(found.said) < 20_000


# Results that are read back.


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Results of a campaign that is too small for a search; to be read only."""
    return built_once(tmp_path_factory, "small", small_results)


MANY = 1_000_000
RECORDS = {
    "numbers for names": lambda of: of | {"null_directions": [0] * MANY},
    "parts without keys": lambda of: of | {"null_directions": [{}] * MANY, "covariance": {}},
    "keys without parts": lambda of: of | {"parameters": {str(k): 0 for k in range(MANY)}},
    "parts of keys": lambda of: of | {"parameters": {str(k): {} for k in range(MANY)}},
    "rows without keys": lambda of: of | {"residuals": [{}] * MANY},
    "a long label": lambda of: (
        of
        | {"residuals": [of["residuals"][0] | {"pose": "x" * MANY}] + of["residuals"][:1] * 100_000}
    ),
    "a long text for numbers": lambda of: (
        of | {"covariance": of["covariance"] | {"matrix": ["x" * MANY] + ["a"] * 100_000}}
    ),
    "a long text in depth": lambda of: (
        of | {"covariance": of["covariance"] | {"matrix": [["x" * MANY]] + [["a"]] * 100_000}}
    ),
    "rows of two lengths": lambda of: (
        of | {"covariance": of["covariance"] | {"matrix": [[0]] * MANY + [[0, 1]]}}
    ),
    "numbers beyond": lambda of: (
        of | {"covariance": of["covariance"] | {"matrix": [[10**300] * 10] * 10}}
    ),
    "another kind": lambda of: of | {"schema": ["x"] * MANY},
}
JSONS = {
    "digits": lambda: b'{"schema": ' + b"9" * 500_000 + b"}",
    "decimals": lambda: b'{"schema": 0.' + b"9" * 5_000_000 + b"}",
    "a power": lambda: b'{"schema": 1e' + b"9" * 5_000_000 + b"}",
    "depth": lambda: b"[" * 10_000_000,
    "depth of keys": lambda: b'{"a":' * 10_000_000,
    "empty lists": lambda: b"[" + b"[]," * 30_000_000 + b"[]]",
    "zeros": lambda: b"[" + b"0," * 60_000_000 + b"0]",
    "empty mappings": lambda: b"[" + b"{}," * 30_000_000 + b"{}]",
    "one key": lambda: b"{" + b'"a":0,' * 20_000_000 + b'"a":0}',
    "a text": lambda: b'{"schema": "' + b"x" * 120_000_000 + b'"}',
    "a text of letters beyond": lambda: (
        b'{"schema": "' + "\U0001f600".encode() * 30_000_000 + b'"}'
    ),
    "escapes": lambda: b'{"schema": "' + b"\\u0041" * 20_000_000 + b'"}',
    "blanks": lambda: b" " * 120_000_000,
    "line ends": lambda: b"\n" * 120_000_000,
    "more than is read": lambda: b" " * 130_000_000,
    "zero bytes": lambda: b"\0" * 120_000_000,
}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("kind", _some(RECORDS | JSONS, "numbers for names", "a long label"))
def test_a_record_without_end_is_refused(attack, small, kind):
    path = attack.inside / "combined.json"
    if kind in RECORDS:
        right = json.loads((small / "calibration/combined.json").read_text("utf-8"))
        path.write_text(json.dumps(RECORDS[kind](right)))
    else:
        path.write_bytes(JSONS[kind]())
    out = {"model": attack.inside / "model.yaml", "urdf": attack.inside / "x.urdf"}
    found = attack("export", calibration=path, **out)
    found.refused("combined.json")
    assert len(found.said) < 20_000


@pytest.mark.parametrize("kind", _some(["digits", "depth", "line ends", "zero bytes"], "line ends"))
def test_records_on_lines_without_end_are_refused(attack, kind):
    path = attack.inside / "trials.jsonl"
    path.write_bytes(JSONS[kind]()[: 8 * MB])
    out = {"scores": attack.inside / "scores.json", "trials": attack.inside / "t.csv"}
    attack("score_trials", verdicts=path, truths=path, **out).refused("trials.jsonl")
