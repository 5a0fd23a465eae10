"""What real logs do and cannot be left out: one message that says what to do."""

from __future__ import annotations

import re

import pytest

from pa10cal.errors import Pa10calError
from spoiling import compressed, delete, ingest, replace, retime


def decimal_commas(raw):
    raw.cmm[1:] = [line.replace(".", ",") for line in raw.cmm[1:]]


def semicolons(raw):
    raw.resolver[:] = [line.replace(",", ";").replace(".", ",") for line in raw.resolver]


def missing_column(raw):
    raw.cmm[0] = raw.cmm[0].replace("load_N", "Load")


def column_twice(raw):
    raw.resolver[0] = raw.resolver[0].replace("q2_deg", "q1_deg")


def clock_offset(raw):
    retime(raw.resolver, 1234.5)


def clock_epoch(raw):
    retime(raw.cmm, 1.2e9)


def clock_drift(raw):
    for index in range(1, len(raw.cmm)):
        time_s = float(raw.cmm[index].split(",")[0])
        replace(raw.cmm, index, "time_s", f"{1.4 * time_s:.2f}")


def radians(raw):
    for index in range(1, len(raw.resolver)):
        words = raw.resolver[index].split(",")
        words[1:7] = [f"{float(word) / 57.29578:.7f}" for word in words[1:7]]
        raw.resolver[index] = ",".join(words)


def never_still(raw):
    for index in range(1, len(raw.resolver)):
        replace(raw.resolver, index, "q1_deg", f"{0.3 * index:.3f}")


def empty_cmm(raw):
    raw.extra["cmm.csv"] = b""


def header_only(raw):
    del raw.resolver[1:]


def cut_gzip(raw):
    compressed(raw)
    raw.write()
    raw.extra["cmm.csv.gz"] = (raw.folder / "cmm.csv.gz").read_bytes()[:-300]


def binary(raw):
    raw.extra["cmm.csv"] = bytes(range(256)) * 40


def too_many_bad(raw):
    for index in range(1, len(raw.cmm), 4):
        replace(raw.cmm, index, "z_mm", "?")


def wrong_diameter(raw):
    raw.description["ball_diameter_mm"] = 31.4


def metres(raw):
    for index in range(1, len(raw.cmm)):
        words = raw.cmm[index].split(",")
        words[7:] = [f"{float(word) / 1000:.7f}" for word in words[7:]]
        raw.cmm[index] = ",".join(words)


def micrometres(raw):
    for index in range(1, len(raw.cmm)):
        words = raw.cmm[index].split(",")
        words[7:] = [f"{1000 * float(word):.1f}" for word in words[7:]]
        raw.cmm[index] = ",".join(words)


def other_tool(raw):
    raw.description["tool"]["balls_mm"]["B"] = [-50, 95, 310]


def no_grid(raw):
    delete(raw.cmm, "grid")


def fewer_columns(raw):
    raw.cmm[1:] = [line.rsplit(",", 1)[0] for line in raw.cmm[1:]]


REFUSED = {
    "decimal commas": (decimal_commas, r"cmm.csv:2: 510 of 510 rows .*decimal commas"),
    "semicolons": (semicolons, r"resolver.csv:1: .*semicolons.*commas between fields"),
    "missing column": (missing_column, r"cmm.csv:1: missing column load_N.*'Load'"),
    "column twice": (column_twice, r"resolver.csv:1: column q1_deg occurs twice"),
    "clock offset": (clock_offset, r"outside any dwell.*adding \+123[34]\.\d s .*100%"),
    "clock epoch": (clock_epoch, r"outside any dwell.*adding -120000000\d\.\d s"),
    "clock drift": (clock_drift, r"outside any dwell.*no constant offset"),
    "radians": (radians, r"resolver.csv: q1_deg … q6_deg: .*look like radians.*to degrees"),
    "never still": (never_still, r"never at rest.*still_speed_deg_s"),
    "empty file": (empty_cmm, r"cmm.csv:1: the file is empty"),
    "header only": (header_only, r"resolver.csv:1: there is no row"),
    "cut gzip": (cut_gzip, r"cmm.csv.gz: the compressed file is damaged or cut short"),
    "binary": (binary, r"cmm.csv:1: the file is not UTF-8 text"),
    "too many bad rows": (too_many_bad, r"cmm.csv:2: z_mm: 128 of 510 rows .*not a finite number"),
    "wrong diameter": (wrong_diameter, r"spheres of the stated diameter.*ball_diameter_mm"),
    "metres": (metres, r"lie in one plane.*unit of x_mm"),
    "micrometres": (
        micrometres,
        r"joints move too little.*unit of these columns, and of the measured",
    ),
    "other tool": (other_tool, r"ball . is .* mm off.*tool.balls_mm"),
    "no grid": (no_grid, r"no usable grid row"),
    "fewer columns": (fewer_columns, r"cmm.csv:2: .*another number of fields.*9 for 10"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refuses_with_one_message(raw_campaign, name):
    spoil, message = REFUSED[name]
    spoil(raw_campaign)
    with pytest.raises(Pa10calError) as refusal:
        ingest(raw_campaign)
    text = str(refusal.value)
    assert re.search(message, text), text
    assert "\n" not in text
    assert "allowed:" in text
