"""Freezing results and comparing a run with them, on made-up folders."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from benchmarks.goldens.__main__ import HERE, main
from benchmarks.goldens.compare import Intended, compare, read_intended
from benchmarks.goldens.digest import digest_folder, read_record, write_record

from pa10cal.errors import RecordError

VERDICT = {
    "campaign": "made-up",
    "verdict": "named",
    "seconds": 1.25,
    "effects": [
        {"id": "tool_sag", "of": "tool", "size": 1.5, "alternatives": []},
        {"id": "friction_torque", "of": "joint 2", "size": 4.25, "alternatives": None},
    ],
    "residuals_m": [[1e-5 * k, -2e-5 * k] for k in range(1, 40)],
    "poses": list(range(20)),
    "delta_a_1": 1e-4,
    "delta_a_2": float("nan"),
}


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "before"
    (made / "verdict").mkdir(parents=True)
    (made / "verdict/complete.json").write_text(json.dumps(VERDICT))
    lines = [{"trial": k, "verdict": "none" if k % 3 else "named"} for k in range(5)]
    (made / "truths.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (made / "table.csv").write_text("name,value\na,1.5\nb,\n")
    (made / "empty.csv").write_text("file,line\n")
    table = pd.DataFrame({"pose": ["P1", "P2"], "q1_rad": [0.1, 0.2], "p": [np.ones(3)] * 2})
    table.to_parquet(made / "poses.parquet")
    return made


def differences(before, after, intended=(), **options):
    result = compare(digest_folder(before), digest_folder(after), list(intended), **options)
    return [f"{path}: {line}" for path, lines in result.differences.items() for line in lines]


def changed(folder, **changes):
    after = folder.with_name("after")
    if not after.exists():
        shutil.copytree(folder, after)
    path = after / "verdict/complete.json"
    path.write_text(json.dumps(VERDICT | changes))
    return after


def test_a_record_is_small_repeatable_and_equal_to_itself(folder, tmp_path):
    for name in ("one", "two"):
        write_record(digest_folder(folder), tmp_path / f"{name}.json.gz")
    assert (tmp_path / "one.json.gz").read_bytes() == (tmp_path / "two.json.gz").read_bytes()
    assert read_record(tmp_path / "one.json.gz") == digest_folder(folder)
    assert differences(folder, folder) == []


def effects(**last):
    return [VERDICT["effects"][0], VERDICT["effects"][1] | last]


def residuals(factor, row=30):
    rows = [list(pair) for pair in VERDICT["residuals_m"]]
    rows[row][1] *= factor
    return rows


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"verdict": "none"}, "verdict: 'none', was 'named'"),
        ({"effects": effects(id="tool_mass")}, r"effects\[\].id: 'tool_mass', was 'friction_to"),
        ({"effects": effects(size=4.25 * (1 + 3e-9))}, r"effects\[\].size: .* was 1.5, 4.25"),
        ({"effects": effects()[:1]}, r"effects\[\].id: 1 values, were 2"),
        ({"residuals_m": residuals(1 + 1e-6)}, r"residuals_m\[\]\[\]: 78 values differ"),
        ({"residuals_m": VERDICT["residuals_m"][::-1]}, r"residuals_m\[\]\[\]: 78 values differ"),
        ({"poses": [1, 0, *range(2, 20)]}, r"poses\[\]: 20 values differ"),
        ({"delta_a_2": 0.0}, "delta_a_#: values are missing at other positions"),
        ({"delta_a_1": True}, "delta_a_#: "),
    ],
)
def test_a_change_shows(folder, changes, line):
    found = differences(folder, changed(folder, **changes))
    assert found
    assert any(re.search("complete.json: " + line, each) for each in found)


@pytest.mark.parametrize(
    "changes",
    [
        {"effects": effects(size=4.25 * (1 + 2e-10))},
        {"residuals_m": residuals(1 + 1e-10)},
        {"a_new_key": 3},
    ],
)
def test_rounding_and_added_keys_are_no_difference(folder, changes):
    assert differences(folder, changed(folder, **changes)) == []


def test_tables_are_compared_cell_by_cell(folder):
    after = changed(folder)
    (after / "table.csv").write_text("name,value\na,\nb,1.5\n")
    pd.DataFrame({"pose": ["P1", "P2"], "q1_rad": [0.1, 0.2001]}).to_parquet(
        after / "poses.parquet"
    )
    (after / "truths.jsonl").unlink()
    (after / "more.csv").write_text("a\n1\n")
    assert differences(folder, after) == [
        "poses.parquet: p[]: key is missing",
        "poses.parquet: q1_rad: 0.1, 0.2001, was 0.1, 0.2 (5.0e-04 of its size)",
        "table.csv: value: values are missing at other positions",
        "truths.jsonl: file is missing",
    ]
    assert len(differences(folder, after, partial=True)) == 3


def row(what, old, new="", files=""):
    old = re.escape(old) if what == "rename value" else old
    return Intended(what, re.compile(files), re.compile(old), new, "a reason")


def test_intended_differences_are_taken_into_account_and_counted(folder):
    after = changed(folder, verdict="judged", seconds=9.0, delta_a_1=1.01e-4)
    path = after / "verdict/complete.json"
    path.write_text(path.read_text().replace('"of"', '"acts_on"'))
    path.rename(after / "verdict/general.json")
    intended = [
        row("rename file", "complete", "general"),
        row("rename value", "named", "judged"),
        row("rename key", r"\bof$", "acts_on"),
        row("ignore", "^seconds$"),
        row("within", "^delta_a", "0.02"),
    ]
    assert differences(folder, after, intended) == []
    assert all(each.used for each in intended)
    # The names of before are still allowed, so that a change may come in steps.
    assert differences(folder, folder, intended) == []
    # A row holds only for the files it names.
    for each in intended[1:]:
        each.files = re.compile("other")
    assert len(differences(folder, after, intended)) == 4


def test_what_is_ignored_is_there_all_the_same(folder):
    after = changed(folder)
    path = after / "verdict/complete.json"
    seconds = [row("ignore", "^(seconds|effects)")]
    path.write_text(json.dumps(VERDICT | {"seconds": 9.0, "effects": []}))
    assert differences(folder, after, seconds) == []  # an empty list has none of its keys
    path.write_text(json.dumps({key: VERDICT[key] for key in VERDICT if key != "seconds"}))
    assert differences(folder, after, seconds) == ["verdict/complete.json: seconds: key is missing"]
    assert differences(folder, after, [row("gone", "^seconds$")]) == []
    path.unlink()
    assert differences(folder, after, seconds) == ["verdict/complete.json: file is missing"]
    assert differences(folder, after, [row("gone", "^file$")]) == []


def test_the_command_freezes_compares_and_refuses(folder, tmp_path, capsys):
    records = ["--records", str(tmp_path / "records")]
    assert main(["freeze", f"default={folder}", *records]) == 0
    assert main(["compare", f"default={folder}", *records]) == 0
    after = changed(folder, verdict="none")
    assert main(["compare", f"default={after}", *records]) == 1
    assert "default: verdict/complete.json: verdict: 'none', was 'named'" in capsys.readouterr().out
    assert main(["compare", f"default={after}", "--only", "csv", *records]) == 0
    assert main(["compare", f"x={after}", "--against", str(folder), *records]) == 1
    assert main(["compare", f"ur10={after}", *records]) == 2
    assert main(["compare", f"default={tmp_path / 'nowhere'}", *records]) == 2
    (tmp_path / "records/default.json.gz").write_bytes(b"spoiled")
    assert main(["compare", f"default={folder}", *records]) == 2


@pytest.mark.parametrize(
    "line",
    [
        "| ignore | | x | |",
        "| forget | | x | | a reason |",
        "| ignore | | x | | |",
        "| ignore | | ( | | a reason |",
        "| within | | x | often | a reason |",
    ],
)
def test_a_wrong_row_of_intended_differences_is_refused(tmp_path, line):
    path = tmp_path / "differences.md"
    path.write_text(
        "| what | files | old | new | reason |\n| --- | --- | --- | --- | --- |\n" + line
    )
    with pytest.raises(RecordError, match="line 3"):
        read_intended(path)


def test_the_shipped_records_and_differences_can_be_read():
    assert read_intended(HERE / "differences.md")
    records = sorted(Path(HERE).glob("*.json.gz"))
    assert records
    assert sum(path.stat().st_size for path in records) < 350_000
    for path in records:
        assert read_record(path)
