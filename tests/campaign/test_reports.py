"""Reports of SpatialAnalyzer, PolyWorks and FARO CAM2, read as proposed."""

from __future__ import annotations

import re

import numpy as np
import pytest

from made_up_reports import REPORTS
from made_up_sightings import is_read, rows_of, sighted
from pa10cal.campaign.formats import BY_NAME
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.sniffing import sniff
from pa10cal.errors import Pa10calError

pytestmark = pytest.mark.usefixtures("tried")


def points(raw):
    """Return numbers from 1 and positions in mm, shuffled."""
    order = np.random.default_rng(3).permutation(len(raw.q)).tolist()
    return [(k + 1, tuple(1e3 * raw.T_instr_target[k, :3, 3])) for k in order]


@pytest.fixture
def written(tmp_path, columns):
    """Write a report and a list of joints under the same labels, and propose a campaign.yaml."""

    def run(raw, report):
        (tmp_path / "report.txt").write_bytes(report.encode())
        labels, names = [f"P{k + 1}" for k in range(len(raw.q))], "Point;A1;A2;A3;A4;A5;A6"
        joints = rows_of(labels, np.degrees(raw.q), names=names, sep=";", decimals=9)
        (tmp_path / "joints.csv").write_text(joints)
        return columns("joints.csv", "report.txt")

    return run


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("name", REPORTS)
def test_points_of_a_report_are_joined_with_joints_by_their_names(tmp_path, written, name):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    code, out, said = written(raw, REPORTS[name](points(raw)))
    assert code == 0, said
    assert out.startswith(f"# report.txt: {BY_NAME[name.split()[0]].title}")
    assert "joined by label" in out
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    assert len(found.observations) == len(raw.q)
    assert is_read(found, raw.q, raw.T_instr_target)


def test_objects_without_a_place_are_counted(tmp_path, written):
    raw = sighted(tmp_path, "pose")
    told = "2 objects without a measured x, y and z are not read"
    assert told in written(raw, REPORTS["polyworks"](points(raw)))[1].splitlines()[0]
    assert told in written(raw, REPORTS["faro"](points(raw)))[1].splitlines()[0]


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("name", ["spatialanalyzer", "polyworks", "faro"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_report_that_was_cut_short_is_told(tmp_path, written, name, axis):
    """In the middle of a number of the 30th of 40 points."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    places = points(raw)
    whole = REPORTS[name](places)
    at = whole.index(f"{places[29][1][axis]:.6f}")
    code, _, said = written(raw, whole[: at + 3])
    assert code == 0, said
    found = read_campaign(tmp_path)
    assert len(found.observations) == 29
    assert [row.reason for row in found.quarantined] == ["the last line is cut short"]


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("polyworks", "Units\tMillimeters", "Units\tCubits", r"txt:3: the unit of lengths is not"),
        ("polyworks", "Units\tMillimeters", "Units", r"txt:3: the unit of lengths is not known"),
        ("polyworks", "\tMeas\t", "\tReal\t", "no position and no distance|no rows of numbers"),
        ("faro", "Center.y", "Middle", "no point with a measured x, y and z"),
        ("faro", "mm", "ell", "the unit of lengths is not known"),
    ],
)
def test_a_report_of_another_version_is_refused(tmp_path, written, name, old, new, told):
    raw = sighted(tmp_path, "pose")
    report = REPORTS[name](points(raw))
    assert old in report
    code, out, said = written(raw, report.replace(old, new))
    assert code == 2 or "it is refused" in out
    assert re.search(told, said + out)


def test_features_in_two_units_are_refused(tmp_path):
    raw = sighted(tmp_path, "pose")
    report = REPORTS["faro"](points(raw))
    at = report.rindex("Center.y")
    path = tmp_path / "report.txt"
    path.write_bytes((report[:at] + report[at:].replace("mm", "in", 1)).encode())
    with pytest.raises(Pa10calError, match=r"report\.txt:\d+: P\d+ is in another unit"):
        sniff(path)
