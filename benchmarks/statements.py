"""What is said of campaigns, held against what is known of them.

`python -m benchmarks.statements [FOLDER …] [--only NAME …] [--logs FOLDER]` takes folders of raw
campaigns, without one `benchmarks/inputs`: small files as people have them, each with a README of
its cause and of what is wanted. Measured campaigns are not in this repository (`docs/datasets.md`).
It runs those of `statements.csv` that are there, and holds what is printed against a row each:
words that have to stand there, and words that must not. A row is right where both hold, wrong
where a wrong word stands there or the program fails, and vague where the right word is missing. The
table has a line a row, the counts are by kind of data.
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
from collections.abc import Mapping, Sequence
from pathlib import Path

_TABLE = Path(__file__).with_suffix(".csv")
_INPUTS = Path(__file__).with_name("inputs")
_PROGRAM = (sys.executable, "-m", "pa10cal")
#: What lies beside the logs of a campaign.
_NO_LOGS = (".yaml", ".urdf", "")


def rows() -> list[dict[str, str]]:
    """Return the statements: campaign, data, logs that are given, right and wrong words, why."""
    with _TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def printed(raw: Path, logs: Sequence[str] = (), results: Path | None = None) -> str:
    """Return what is printed of a campaign from its raw files to its model.

    Logs that are not named are all that lie there; without any, the arm of a URDF is imported.
    Results are kept where a folder is given for them.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / raw.name
        shutil.copytree(raw, folder)
        every = sorted(each.name for each in folder.iterdir() if each.suffix not in _NO_LOGS)
        text = ""
        if not every:
            (urdf,) = folder.glob("*.urdf")
            return _told("import_arm", str(urdf), "--out", str(folder / "arm.yaml"))
        if not (folder / "campaign.yaml").exists():
            arm = next(folder.glob("*.yaml")).stem
            given = [str(folder / name) for name in logs or every]
            text = _told("columns", *given, "--robot", arm)
            (folder / "campaign.yaml").write_text(text, encoding="utf-8")
        kept = str(results or Path(place) / "results")
        return text + _told("chain", "--campaign-dir", str(folder), "--results", kept)


def _told(*words: str) -> str:
    """Return what a command prints, and what it says where it refuses."""
    done = subprocess.run([*_PROGRAM, *words], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def judged(row: Mapping[str, str], text: str) -> str:
    """Return whether a statement is right, vague or wrong."""
    if "internal fault" in text or (row["wrong"] and re.search(row["wrong"], text)):
        return "wrong"
    return "right" if re.search(row["right"], text) else "vague"


def main() -> None:
    """Run the campaigns that are there, and print a line a row and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, default=[_INPUTS])
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
        run = "-".join([name, *row["logs"].split()])
        if run not in texts:
            kept = None if asked.logs is None else asked.logs / f"{run}.log"
            if kept is not None and kept.exists():
                texts[run] = kept.read_text(encoding="utf-8")
            else:
                texts[run] = printed(raw, row["logs"].split())
                if kept is not None:
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    kept.write_text(texts[run], encoding="utf-8")
        found = judged(row, texts[run])
        counts[row["data"], found] += 1
        print(f"{found:5}  {run}: {row['why']}", flush=True)
        if found != "right":
            print(f"       {row['right']!r}, not {row['wrong']!r}")
    for (data, found), count in sorted(counts.items()):
        print(f"{data} {found}: {count}")


if __name__ == "__main__":
    main()
