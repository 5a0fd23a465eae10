"""Ways to spoil the lines of a raw log, and to ingest what is left."""

from __future__ import annotations

from pa10cal.campaign.read import read_campaign

CONFIGURATIONS = 34
TOUCHES = 15  # a configuration
APPROACH, DWELL = 6, 10


def ingest(raw):
    return read_campaign(raw.write())


def row_of(lines, *words):
    """Return the index of the first line with these words in neighbouring fields."""
    return next(k for k, line in enumerate(lines) if f",{','.join(words)}," in line)


def replace(lines, index, column, text):
    words = lines[index].split(",")
    words[lines[0].split(",").index(column)] = text
    lines[index] = ",".join(words)


def delete(lines, *words):
    lines[1:] = [line for line in lines[1:] if f",{','.join(words)}," not in line]


def with_columns(lines, columns):
    """Append columns of one value each."""
    values = ",".join(str(value) for value in columns.values())
    lines[:] = [",".join([lines[0], *columns]), *(f"{line},{values}" for line in lines[1:])]


def retime(lines, seconds, first=1, last=None):
    for index in range(first, len(lines) if last is None else last):
        time_s = float(lines[index].split(",")[0])
        replace(lines, index, "time_s", f"{time_s + seconds:.2f}")


def compressed(raw):
    raw.description["files"] = {"cmm": "cmm.csv.gz", "resolver": "resolver.csv.gz"}
