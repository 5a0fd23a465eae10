"""What people might send to do harm: refused in one line, at once, with nothing read or written."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import socket
from dataclasses import replace
from importlib.resources import files as resources
from pathlib import Path

import pytest
import yaml

from attacks import SECRET
from built_once import built_once
from made_up_results import NAME, small_results
from pa10cal.files.table_cells import from_csv_cell
from pa10cal.results.codec import write
from pa10cal.results.outcomes import PicturesRecord

# The harness itself: what it must notice.


def test_a_command_that_does_no_harm_is_harmless(attack):
    found = attack("effects", robot="pa10_6ce")
    found.harmless()
    assert found.code == 0
    assert "friction" in found.printed
    assert 20 < found.peak_mb < 500


def test_a_file_read_outside_is_noticed(attack):
    found = attack("effects", robot=attack.outside / "secret.yaml")
    assert found.code == 2
    assert found.read_outside == (str(attack.outside / "secret.yaml"),)
    with pytest.raises(AssertionError, match="secret"):
        found.refused("")


def test_a_file_read_through_a_link_is_noticed(attack):
    (attack.inside / "arm.yaml").symlink_to(attack.outside / "secret.yaml")
    assert attack("effects", robot=attack.inside / "arm.yaml").read_outside


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize(
    ("code", "noticed"),
    [
        (f"print('{SECRET}')", SECRET),
        ("while True: pass", "exit code -9"),
        ("b = bytearray(1_200_000_000)", r"1\d\d\d MB"),
        ("b = bytearray(4_000_000_000)", "exit code 1"),
        ("open('not-sent/new', 'w')", "not-sent/new"),
        ("import ctypes; ctypes.string_at(0)", "exit code -11"),
        ("import pyarrow.csv; pyarrow.csv.read_csv('not-sent/secret.csv')", "secret.csv"),
    ],
)
def test_harm_is_noticed(attack, code, noticed):
    with pytest.raises(AssertionError, match=noticed):
        attack("-c", code, seconds=1.0 if "while" in code else 20.0).harmless()


def test_a_file_that_is_written_is_noticed(attack):
    found = attack("-c", "open('sent/a', 'w'); open('not-sent/secret.txt', 'a').write('x')")
    assert [path.rpartition("/")[2] for path in found.written] == ["secret.txt", "a"]


# What stands in a folder that was sent, and leads out of it or is no file.


def _folder_that_leads_out(path, outside):
    """Put a link to a folder outside in place of the one that the file is in."""
    elsewhere = outside / "elsewhere"
    shutil.copytree(path.parent, elsewhere)
    (elsewhere / path.name).write_text(f"{SECRET}\n" * 3)
    kept = path.parent.with_name("kept")
    path.parent.rename(kept)
    path.parent.symlink_to(elsewhere)


def _socket(path):
    with socket.socket(socket.AF_UNIX) as of:
        here = Path.cwd()
        os.chdir(path.parent)  # names of sockets are short
        of.bind(path.name)
        os.chdir(here)


NO_FILES = {
    "pipe": (lambda path, outside: os.mkfifo(path), "it is a pipe"),
    "socket": (lambda path, outside: _socket(path), "it is a socket"),
    "folder": (lambda path, outside: path.mkdir(), "it is a folder"),
}
LEAD_OUT = {
    "link": (lambda path, outside: path.symlink_to(outside / "secret.csv"), "leads out"),
    "way there": (
        lambda path, outside: path.symlink_to(os.path.relpath(outside / "secret.csv", path.parent)),
        "leads out",
    ),
    "device": (lambda path, outside: path.symlink_to("/dev/zero"), "leads out"),
    "way to a device": (lambda path, outside: path.symlink_to("/dev/fd/0"), "leads out"),
}


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Results of a campaign that is too small for a search; to be read only."""
    return built_once(tmp_path_factory, "small", small_results)


def _ingest(attack):
    folder = attack.inside / "made-up"
    return attack(
        "ingest",
        campaign_dir=folder,
        out=attack.inside / "p.parquet",
        quarantine=attack.inside / "q.csv",
    )


def _copied_urdf(attack):
    return attack("-c", COPY.format(attack.inside))


#: As a group does it.
COPY = """
import sys
from pathlib import Path
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import copy_description
try:
    copy_description("mine", Path("{0}/made-up"), Path("{0}/made-up"))
except Pa10calError as error:
    print("pa10cal -c:", error, file=sys.stderr)
    sys.exit(2)
"""


def _predict(attack):
    joints = attack.inside / "joints.csv"
    return attack(
        "predict", model=attack.inside / NAME, joints=joints, out=attack.inside / "out.csv"
    )


def _report(attack):
    return attack("report", attack.inside / NAME, out=attack.inside / "report.html")


def _overview(attack):
    return attack("report", attack.inside, out=attack.inside / "report.html")


def _figures(attack):
    return attack("figures", results=attack.inside / NAME, out_dir=attack.inside)


def _import(attack):
    return attack("import", "ipa-robot-accuracy", attack.inside / "ipa", out=attack.inside / "raw")


#: What is read of a folder that was sent: where it stands, and what reads it.
READ = {
    "a raw file": ("made-up/cmm.csv", _ingest),
    "the other raw file": ("made-up/resolver.csv", _ingest),
    "a description": ("made-up/campaign.yaml", _ingest),
    "an arm": ("made-up/pa10_6ce.yaml", _ingest),
    "an arm beside": ("arms/pa10_6ce.yaml", _ingest),
    "a URDF": ("made-up/mine.urdf", _copied_urdf),
    "a model": (f"{NAME}/model/model.yaml", _predict),
    "a covariance": (f"{NAME}/model/model.covariance.npz", _predict),
    "a calibration": (f"{NAME}/calibration/combined.json", _report),
    "a verdict": (f"{NAME}/discovery/verdict.json", _report),
    "pictures": (f"{NAME}/pictures.json", _report),
    "a table of poses": (f"{NAME}/ingest/poses.parquet", _report),
    "a quarantine": (f"{NAME}/ingest/quarantine.csv", _report),
    "a figure": (f"{NAME}/figures/drawn.svg", _report),
    "scores": (f"{NAME}/scores.json", _figures),
    "a study": ("study/pictures.json", _overview),
    "a table of a study": ("study/tables/drawn.csv", _overview),
    "a data set": ("ipa/Series_A/measurements_grid.csv", _import),
}
CAPTIONS = {"drawn": {"title": "A", "text": "B", "section": "measured"}}


@pytest.fixture
def sent(attack, small, raw_campaign):
    """A campaign, results and a data set, as they might be sent."""
    replace(raw_campaign, folder=attack.inside / "made-up").write()
    shutil.copytree(small, attack.inside / NAME)
    study = attack.inside / "study"
    for folder, campaign in ((attack.inside / NAME, NAME), (study, None)):
        pictures = PicturesRecord(
            campaign=campaign, drawn=("drawn",), omitted={}, captions=CAPTIONS
        )
        write(pictures, folder / "pictures.json")
        for file in ("figures/drawn.svg", "tables/drawn.csv"):
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text("a,b\n1,2\n")
    (attack.inside / "other/report.html").parent.mkdir()
    (attack.inside / "other/report.html").touch()
    (attack.inside / "arms").mkdir()
    joints = ",".join(f"q{k}_deg" for k in range(1, 7))
    (attack.inside / "joints.csv").write_text(f"id,{joints}\na,0,-90,90,0,10,0\n")
    arm = resources("pa10cal.files").joinpath("arms/pa10_6ce.yaml").read_text("utf-8")
    urdf = "urdf: {file: mine.urdf, base: a, tip: b}\n"
    (attack.inside / "made-up/mine.yaml").write_text(arm.replace("pa10_6ce", "mine", 1) + urdf)
    for file in ("Series_A/measurements_grid.csv", "Series_C/measurements_random_poses.csv"):
        (attack.inside / "ipa" / file).parent.mkdir(parents=True)
        (attack.inside / "ipa" / file).touch()
    return attack


def _slow_but(few, every):
    """Mark all but a few cases as slow."""
    return [each if each in few else pytest.param(each, marks=pytest.mark.slow) for each in every]


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("spoilt", _slow_but(("pipe", "link"), NO_FILES | LEAD_OUT))
@pytest.mark.parametrize("what", READ)
def test_what_is_no_file_of_the_folder_is_not_read(sent, what, spoilt):
    file, command = READ[what]
    path, (spoil, words) = sent.inside / file, (NO_FILES | LEAD_OUT)[spoilt]
    path.unlink(missing_ok=True)
    spoil(path, sent.outside)
    command(sent).refused(words, path.name)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("what", [what for what, (file, _) in READ.items() if file.count("/") > 1])
def test_a_link_in_the_middle_is_not_followed(sent, what):
    file, command = READ[what]
    _folder_that_leads_out(sent.inside / file, sent.outside)
    command(sent).refused("leads out")


def test_a_log_outside_is_not_told(sent):
    """What a stage printed stands in the report; a log that cannot be read is none."""
    log = sent.inside / NAME / "logs/iso9283.log"
    log.parent.mkdir(exist_ok=True)
    (sent.outside / "secret.log").write_text(f"pa10cal evaluate: {SECRET}\n")
    for name in ("ingest", "base_frame", "calibrate", "discover", "evaluate", "export"):
        (log.parent / f"{name}.log").unlink(missing_ok=True)
        (log.parent / f"{name}.log").symlink_to(sent.outside / "secret.log")
    found = _report(sent)
    found.harmless()
    assert SECRET not in (sent.inside / "report.html").read_text("utf-8")


# Names that a file gives.

NAMED = {
    "absolute": "{0}/secret.csv",
    "above": "../../not-sent/secret.csv",
    "above from below": "a/../../../not-sent/secret.csv",
    "device": "/dev/zero",
    "standard input": "/dev/stdin",
    "memory": "/proc/self/mem",
    "zero byte": "a\0b",
    "line break": "a\nb.csv",
    "5000 letters": "x" * 5000,
    "5000 folders": "x/" * 5000 + "y",
    "nothing": "",
    "dot": ".",
    "dotdot": "..",
    "home": "~/secret.csv",
    "variable": "$HOME/secret.csv",
    "address": "file:///etc/passwd",
    "pattern": "*",
    "terminal": "\x1b[2Jx.csv",
}


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("name", NAMED)
def test_no_raw_file_elsewhere_is_read(sent, name):
    path = sent.inside / "made-up/campaign.yaml"
    content = yaml.safe_load(path.read_text("utf-8"))
    content["files"]["cmm"] = NAMED[name].format(sent.outside)
    path.write_text(yaml.safe_dump(content))
    _ingest(sent).refused("files.cmm")


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("name", NAMED)
def test_no_urdf_elsewhere_is_read(sent, name):
    path = sent.inside / "made-up/mine.yaml"
    content = yaml.safe_load(path.read_text("utf-8"))
    content["urdf"]["file"] = NAMED[name].format(sent.outside)
    path.write_text(yaml.safe_dump(content))
    _copied_urdf(sent).refused("urdf.file|mine.yaml")


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    "name", _slow_but(("above results", "line break"), [*NAMED, "above results"])
)
def test_no_picture_elsewhere_is_shown(sent, name):
    (sent.outside / "secret.svg").write_text(SECRET)
    called = (NAMED | {"above results": "../../../not-sent/secret"})[name].format(sent.outside)
    for place in (NAME, "study"):
        path = sent.inside / place / "pictures.json"
        content = json.loads(path.read_text("utf-8"))
        path.write_text(json.dumps(content | {"captions": {called: CAPTIONS["drawn"]}}))
    for command in (_report, _overview):
        found = command(sent)
        found.harmless()
        assert (found.code == 2) == (name == "above results")
        page = sent.inside / "report.html"
        assert found.code == 2 or SECRET not in page.read_text("utf-8")


# What a spreadsheet, a robot or a terminal takes for something else.

IDS = ["a,90.0", "=cmd|' /C calc'!A0", " =1+1", "-A1", "a;=1", "a\x1b[2J\x9b\u202e", 'a"b']


def test_an_id_is_one_cell_and_runs_nothing(sent):
    joints = sent.inside / "joints.csv"
    header, row = joints.read_text("utf-8").splitlines()
    quoted = (f'"{each.replace(chr(34), 2 * chr(34))}"{row[1:]}' for each in IDS)
    joints.write_text("\n".join((header, *quoted, "")), "utf-8")
    found = _predict(sent)
    found.harmless()
    assert found.code == 0
    _, *rows = csv.reader(io.StringIO((sent.inside / "out.csv").read_text("utf-8"), newline=""))
    assert [from_csv_cell(id) for id, *_ in rows] == [each.strip() for each in IDS]
    assert {len(each) for each in rows} == {11}
    assert not [id for id, *_ in rows if id[0] in "=+-@"]


# What a user names may lie anywhere, and may be a link; but it has to be a file.

GIVEN = {
    "joints": lambda attack, path: attack(
        "predict", model=attack.inside / NAME, joints=path, out=attack.inside / "x.csv"
    ),
    "a model": lambda attack, path: attack(
        "predict", model=path, joints=attack.inside / "joints.csv", out=attack.inside / "x.csv"
    ),
    "settings": lambda attack, path: attack(
        "simulate", name="a", settings=path, out=attack.inside / "x", truth=attack.inside / "t.json"
    ),
    "an arm": lambda attack, path: attack("effects", robot=path),
    "an export": lambda attack, path: attack("columns", path),
    "a URDF": lambda attack, path: attack("import_arm", path, out=attack.inside / "x.yaml"),
    "a fleet": lambda attack, path: attack("fleet", path, out=attack.inside / "x"),
    "points": lambda attack, path: attack(
        "curve", points=path, out_dir=attack.inside / "x", settings={"links": 3}
    ),
    "a calibration": lambda attack, path: attack(
        "export", calibration=path, model=attack.inside / "x.yaml", urdf=attack.inside / "x.urdf"
    ),
    "a table of poses": lambda attack, path: attack(
        "seed", campaign_dir=attack.inside / "made-up", poses=path, out=attack.inside / "x.json"
    ),
}
ENDINGS = {"a fleet": ".csv", "an arm": ".yaml"}


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("kind", _slow_but(("pipe",), [*NO_FILES, "device", "standard input"]))
@pytest.mark.parametrize("what", GIVEN)
def test_what_is_given_and_is_no_file_is_refused_at_once(sent, what, kind):
    path = sent.inside / f"given{ENDINGS.get(what, '')}"
    if kind in NO_FILES:
        spoil, words = NO_FILES[kind]
        spoil(path, sent.outside)
    else:
        path.symlink_to("/dev/zero" if kind == "device" else "/dev/stdin")
        words = "it is a device"
    GIVEN[what](sent, path).refused(words if (what, kind) != ("a model", "folder") else "not there")


def test_what_is_given_may_be_a_link_to_a_file_anywhere(sent):
    elsewhere = sent.inside.parent / "elsewhere"
    shutil.copytree(sent.inside / NAME / "model", elsewhere)
    shutil.move(sent.inside / "joints.csv", elsewhere)
    for name in ("model.yaml", "model.covariance.npz", "joints.csv"):
        (sent.inside / name).symlink_to(elsewhere / name)
    out = sent.inside / "out.csv"
    model, joints = sent.inside / "model.yaml", sent.inside / "joints.csv"
    found = sent("predict", model=model, joints=joints, out=out, force=True)
    found.harmless()
    assert found.code == 0
    assert "nan" not in out.read_text("utf-8")
