"""A fleet of which ten campaigns are broken, each in another way: the others are done all the same.

`python -m benchmarks.broken_fleet` runs two hundred, prints the line of each broken one, and ends
with 1 where a good one was not done, or a broken one has no reason.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "examples/irb120-points"
_SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    '<row r="1"><c r="A1"><v>1</v></c></row>'
    '<row r="1048576"><c r="XFD1048576"><v>2</v></c></row></sheetData></worksheet>'
)
_WORKBOOK = {
    "[Content_Types].xml": (
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="xml" ContentType="application/xml"/>'
        '<Override PartName="/xl/workbook.xml" ContentType="application/vnd.openxmlformats-'
        'officedocument.spreadsheetml.sheet.main+xml"/></Types>'
    ),
    "_rels/.rels": (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        '<Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/'
        'relationships/officeDocument" Target="xl/workbook.xml"/></Relationships>'
    ),
    "xl/workbook.xml": (
        '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" '
        'xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships">'
        '<sheets><sheet name="a" sheetId="1" r:id="rId1"/></sheets></workbook>'
    ),
    "xl/_rels/workbook.xml.rels": (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        '<Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/'
        'relationships/worksheet" Target="worksheets/sheet1.xml"/></Relationships>'
    ),
}


def workbook(path: Path, sheet: str = _SHEET) -> None:
    """Write a workbook of one sheet, by default with a cell in its last row and column."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, text in (_WORKBOOK | {"xl/worksheets/sheet1.xml": sheet}).items():
            packed.writestr(name, text)


def _describe(folder: Path, old: str, new: str) -> None:
    path = folder / "campaign.yaml"
    text = path.read_text(encoding="utf-8")
    if old not in text:
        raise ValueError(f"{path} has no {old!r}")
    path.write_text(text.replace(old, new), encoding="utf-8")


def _far_cell(folder: Path) -> None:
    workbook(folder / "poses.xlsx")
    _describe(folder, "poses.csv", "poses.xlsx")


def _bad_workbook(folder: Path) -> None:
    (folder / "poses.xlsx").write_bytes(b"PK\x03\x04" + b"no workbook" * 99)
    _describe(folder, "poses.csv", "poses.xlsx")


def _memory(folder: Path) -> None:
    with (folder / "poses.csv").open("ab") as file:
        file.write(b"9" * 200_000_000)


def _link(folder: Path) -> None:
    (folder / "poses.csv").unlink()
    (folder / "poses.csv").symlink_to("/etc/passwd")


def _cut(folder: Path) -> None:
    content = (folder / "poses.csv").read_bytes()
    (folder / "poses.csv").write_bytes(content[: len(content) // 20])


def _folder(folder: Path) -> None:
    (folder / "poses.csv").unlink()
    (folder / "poses.csv").mkdir()


def _unreadable(folder: Path) -> None:
    """Make a file that nobody reads, whoever one is."""
    (folder / "poses.csv").unlink()
    os.mkfifo(folder / "poses.csv")


def _no_yaml(folder: Path) -> None:
    (folder / "campaign.yaml").write_text("name: [", encoding="utf-8")


#: Ways in which a campaign is broken, and what its line must say.
BROKEN: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "a far cell": (_far_cell, "a cell stands far"),
    "memory": (_memory, "too long|memory"),
    "a name": (
        lambda folder: _describe(folder, f"name: {folder.name}", "name: no"),
        "YAML reads no",
    ),
    "a link": (_link, "leads out"),
    "an empty file": (lambda folder: (folder / "poses.csv").write_bytes(b""), "empty"),
    "a cut file": (_cut, "poses|rows|configurations"),
    "a folder": (_folder, "it is a folder"),
    "a pipe": (_unreadable, "it is a pipe"),
    "no YAML": (_no_yaml, "campaign.yaml"),
    "no workbook": (_bad_workbook, "workbook"),
}


@dataclass(frozen=True)
class Found:
    """What became of a fleet with broken campaigns."""

    code: int
    done: int
    lines: Mapping[str, str]  # reason of each broken one
    wrong: Mapping[str, str]  # broken ones without the right reason, good ones that are not done
    seconds: float


def broken_fleet(place: Path, count: int, cores: int = 2) -> Found:
    """Run a fleet of so many campaigns, the broken ones of them among the others."""
    names = [f"c{k:04d}" for k in range(count)]
    step = max(count // len(BROKEN), 1)
    ways = dict(zip(names[::step], BROKEN, strict=False))
    for name in names:
        folder = place / "raw" / name
        shutil.copytree(EXAMPLE, folder)
        _describe(folder, f"name: {EXAMPLE.name}", f"name: {name}")
        if name in ways:
            BROKEN[ways[name]][0](folder)
    words = [sys.executable, "-m", "pa10cal", "fleet", "c*", "--raw-dir", str(place / "raw")]
    began = time.monotonic()
    ended = subprocess.run(
        [*words, "--out", str(place / "out"), "--cores", str(cores)],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.monotonic() - began
    table = place / "out/fleet/fleet.csv"
    if not table.is_file():
        return Found(ended.returncode, 0, {}, {"fleet": ended.stdout + ended.stderr}, seconds)
    with table.open(encoding="utf-8") as file:
        rows = {row["campaign"]: row for row in csv.DictReader(file)}
    lines, wrong = {}, {}
    for name in names:
        row = rows.get(name, {"status": "absent", "why": ""})
        if name not in ways:
            if row["status"] != "done":
                wrong[name] = f"{row['status']}: {row['why']}"
            continue
        way, said = ways[name], f"{row['status']}: {row['why']}"
        lines[way] = said
        printed = f"{name}: {row['why']}" in ended.stdout
        if row["status"] == "done" or not re.search(BROKEN[way][1], said) or not printed:
            wrong[way] = said
    done = sum(row["status"] == "done" for row in rows.values())
    return Found(ended.returncode, done, lines, wrong, seconds)


def main() -> int:
    """Run the fleet and print what became of it."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--campaigns", type=int, default=200)
    asked.add_argument("--cores", type=int, default=2)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = broken_fleet(Path(folder), given.campaigns, given.cores)
    for way, line in found.lines.items():
        print(f"{way:14} {line}")
    for name, line in found.wrong.items():
        print(f"WRONG {name}: {line}")
    print(
        f"{found.done} of {given.campaigns} done, {len(found.lines)} lines of broken ones, "
        f"exit code {found.code}, {found.seconds:.0f} s"
    )
    return int(bool(found.wrong) or found.done != given.campaigns - len(found.lines))


if __name__ == "__main__":
    sys.exit(main())
