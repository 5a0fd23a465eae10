"""Digests of result files: every value of a file in a few numbers a key.

A file is flattened to keys (a column, or `effects[].parameters.tau_c.value`): indices of lists and
digits in names are collapsed, so one key holds a group of values of one kind. A group keeps its
texts and its few numbers; of many numbers it keeps the sum, the sum of absolute values and a sum
with a weight for each position. It shows a change by 1e-9 of the size of the group, two values that
changed places, and every change of a text or an integer.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pa10cal.errors import RecordError

#: Endings of the files that are frozen.
ENDINGS = (".json", ".jsonl", ".csv", ".parquet")

#: A group of at most so many numbers is kept as it is.
KEPT_NUMBERS = 3
#: A group of at most so many texts, all short, is kept as it is.
KEPT_TEXTS, SHORT = 200, 60

#: One file: key -> group. One study: path relative to its results folder -> file.
Group = dict[str, Any]
FileDigest = dict[str, Group]
StudyDigest = dict[str, FileDigest]


def digest_folder(folder: Path, only: re.Pattern[str] | None = None) -> StudyDigest:
    """Return the digests of the result files below `folder`, by their relative paths.

    Data sets that were only fetched, below `datasets/`, are no results.

    Raises:
        RecordError: the folder is missing or holds no result file, or a file cannot be read.
    """
    paths = sorted(p for p in folder.rglob("*") if p.suffix in ENDINGS and p.is_file())
    named = [(path.relative_to(folder).as_posix(), path) for path in paths]
    named = [(name, path) for name, path in named if not name.startswith("datasets/")]
    if not named:
        raise RecordError(
            "no result file",
            where=str(folder),
            allowed=", ".join(ENDINGS),
            remedy="give the folder that a run wrote its results into",
        )
    return {name: digest_file(path) for name, path in named if not only or only.search(name)}


def digest_file(path: Path) -> FileDigest:
    """Return the groups of one file.

    Raises:
        RecordError: the file cannot be read.
    """
    try:
        values = _values(path)
    except (ValueError, OSError) as error:
        raise RecordError(
            f"it cannot be read: {error}",
            where=str(path),
            allowed=f"a file in the format {path.suffix[1:]}",
            remedy="run the study again",
        ) from error
    groups: dict[str, list[Any]] = {}
    table = path.suffix in (".csv", ".parquet")
    for key, value in values:
        groups.setdefault(key if table else re.sub(r"\d+", "#", key), []).append(value)
    return {key: _group(group) for key, group in sorted(groups.items())}


def _values(path: Path) -> list[tuple[str, Any]]:
    """Every value of a file with its key."""
    if path.suffix == ".json":
        return list(_flat(json.loads(path.read_text(encoding="utf-8")), ""))
    if path.suffix == ".jsonl":
        lines = path.read_text(encoding="utf-8").splitlines()
        return [pair for line in lines for pair in _flat(json.loads(line), "")]
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
        return [
            (column, _number(cell))
            for row in rows
            for column, cell in zip(header, row, strict=True)
        ] or [(column, None) for column in header]
    import pandas as pd

    table = pd.read_parquet(path)
    return [
        pair
        for column in table.columns
        for value in table[column].tolist()
        for pair in _flat(value.tolist() if isinstance(value, np.ndarray) else value, str(column))
    ]


def _flat(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value:
        for inner in value:
            yield from _flat(inner, f"{key}[]")
    elif isinstance(value, dict | list):
        yield key, "empty"
    else:
        yield key, value


def _number(cell: str) -> float | str | None:
    if not cell:
        return None
    try:
        return float(cell)
    except ValueError:
        return cell


def _group(values: list[Any]) -> Group:
    """Digest the values of one key; positions are those among all values of the key."""
    numbers: list[tuple[int, float]] = []
    texts: list[tuple[int, str]] = []
    for place, value in enumerate(values):
        if isinstance(value, int | float) and not isinstance(value, bool):
            if math.isfinite(value):
                numbers.append((place, float(value)))
                continue
            value = None if math.isnan(value) else value
        texts.append((place, "none" if value is None else str(value)))
    group: Group = {"n": len(values)}
    if numbers:
        group |= _of_numbers(numbers)
    if texts:
        group |= _of_texts(texts, places=bool(numbers))
    return group


def _of_numbers(numbers: list[tuple[int, float]]) -> Group:
    if len(numbers) <= KEPT_NUMBERS:
        return {"x": [_rounded(value) for _, value in numbers]}
    places, values = (np.array(column, dtype=float) for column in zip(*numbers, strict=True))
    weights = np.modf((places + 1.0) * 0.6180339887498949)[0]
    sums = (math.fsum(values), math.fsum(np.abs(values)), math.fsum(weights * values))
    group: Group = {"s": [_rounded(value) for value in sums]}
    if np.array_equal(values, np.rint(values)):
        group["i"] = _hash(" ".join(f"{value:.0f}" for value in values + 0.0))
    return group


def _of_texts(texts: list[tuple[int, str]], *, places: bool) -> Group:
    group: Group = {}
    if places:
        group["p"] = _hash(" ".join(str(place) for place, _ in texts))
    short = all(len(text) <= SHORT for _, text in texts)
    if len({text for _, text in texts}) == 1 and short:
        return group | {"t": [texts[0][1]]}
    if len(texts) <= KEPT_TEXTS and short:
        return group | {"t": [text for _, text in texts]}
    return group | {"h": _hash("\n".join(text for _, text in texts))}


def _rounded(value: float) -> float:
    return float(f"{value:.11g}")


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def write_record(digest: StudyDigest, path: Path) -> None:
    """Write the frozen record of one study; the same digest gives the same bytes."""
    text = json.dumps(digest, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    beside = path.with_name(path.name + ".part")
    beside.write_bytes(gzip.compress(text.encode(), compresslevel=9, mtime=0))
    beside.replace(path)


def read_record(path: Path) -> StudyDigest:
    """Read the frozen record of one study.

    Raises:
        RecordError: there is none, or it is spoiled.
    """
    try:
        record: StudyDigest = json.loads(gzip.decompress(path.read_bytes()))
    except FileNotFoundError:
        known = ", ".join(p.name.split(".")[0] for p in sorted(path.parent.glob("*.json.gz")))
        raise RecordError(
            "this study is not frozen",
            where=path.name,
            allowed=known or "no study yet",
            remedy="freeze it: python -m benchmarks.goldens freeze STUDY=RESULTS_DIR",
        ) from None
    except (OSError, ValueError, EOFError) as error:
        raise RecordError(
            f"not a frozen record: {error}",
            where=str(path),
            allowed="what `freeze` wrote",
            remedy="restore the file, or freeze the study again",
        ) from error
    return record
