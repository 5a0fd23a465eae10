"""What is said of campaigns, held against what is known of them.

`python -m benchmarks.statements FOLDER … [--only NAME …] [--logs FOLDER]` takes folders of raw
campaigns (measured ones are not in this repository: `docs/datasets.md`), runs those of
`statements.csv` that are there, and holds what is printed against a row each: words that have to
stand there, and words that must not. A row is right where both hold, wrong where a wrong word
stands there, and vague where the right word is missing.
"""

from __future__ import annotations

import argparse
import csv
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

_TABLE = Path(__file__).with_suffix(".csv")
_PROGRAM = (sys.executable, "-m", "pa10cal")


def rows() -> list[dict[str, str]]:
    """Return the statements: campaign, data, right and wrong words, why."""
    with _TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def printed(raw: Path) -> str:
    """Return what is printed of a campaign from its raw files to its model."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / raw.name
        shutil.copytree(raw, folder)
        text = ""
        if not (folder / "campaign.yaml").exists():
            arm = next(folder.glob("*.yaml")).stem
            logs = sorted(str(each) for each in folder.glob("*.csv"))
            asked = [*_PROGRAM, "columns", *logs, "--robot", arm]
            proposed = subprocess.run(asked, capture_output=True, text=True, check=False)
            (folder / "campaign.yaml").write_text(proposed.stdout, encoding="utf-8")
            text = proposed.stderr
        results = str(Path(place) / "results")
        asked = [*_PROGRAM, "chain", "--campaign-dir", str(folder), "--results", results]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        return text + done.stdout + done.stderr


def judged(row: Mapping[str, str], text: str) -> str:
    """Return whether a statement is right, vague or wrong."""
    if row["wrong"] and re.search(row["wrong"], text):
        return "wrong"
    return "right" if re.search(row["right"], text) else "vague"


def main() -> None:
    """Run the campaigns that are there, print every row that is not right, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", nargs="+", default=None)
    parser.add_argument("--logs", type=Path, help="where texts are kept, and taken from if there")
    asked = parser.parse_args()
    texts: dict[str, str] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for row in rows():
        name = row["campaign"]
        places = (folder / name for folder in asked.folders)
        raw = next((place for place in places if place.is_dir()), None)
        if raw is None or (asked.only and name not in asked.only):
            continue
        if name not in texts:
            kept = None if asked.logs is None else asked.logs / f"{name}.log"
            if kept is not None and kept.exists():
                texts[name] = kept.read_text(encoding="utf-8")
            else:
                texts[name] = printed(raw)
                if kept is not None:
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    kept.write_text(texts[name], encoding="utf-8")
        found = judged(row, texts[name])
        counts[row["data"], found] += 1
        if found != "right":
            print(f"{found}: {name}: {row['right']!r}, not {row['wrong']!r}: {row['why']}")
    for (data, found), count in sorted(counts.items()):
        print(f"{data} {found}: {count}")


if __name__ == "__main__":
    main()
