"""What real logs do and cannot be left out: one message that says what to do."""

from __future__ import annotations

import re

import pytest

from pa10cal.errors import Pa10calError
from spoiling import compressed, delete, ingest, replace, retime


def each_row(log, change):
    """Change the words of each row of a log; the number of the row is given too."""

    def spoil(raw):
        lines = getattr(raw, log)
        for index in range(1, len(lines)):
            lines[index] = ",".join(change(index, lines[index].split(",")))

    return spoil


def scaled(log, first, last, factor, form):
    return each_row(
        log,
        lambda _, words: [
            form.format(factor * float(word)) if first <= k < last else word
            for k, word in enumerate(words)
        ],
    )


def decimal_commas(raw):
    raw.cmm[1:] = [line.replace(".", ",") for line in raw.cmm[1:]]


def semicolons(raw):
    raw.resolver[:] = [line.replace(",", ";").replace(".", ",") for line in raw.resolver]


def renamed(log, old, new):
    def spoil(raw):
        lines = getattr(raw, log)
        lines[0] = lines[0].replace(old, new)

    return spoil


def content(text):
    def spoil(raw):
        raw.extra["cmm.csv"] = text

    return spoil


def header_only(raw):
    del raw.resolver[1:]


def cut_gzip(raw):
    compressed(raw)
    raw.write()
    raw.extra["cmm.csv.gz"] = (raw.folder / "cmm.csv.gz").read_bytes()[:-300]


def too_many_bad(raw):
    for index in range(1, len(raw.cmm), 4):
        replace(raw.cmm, index, "z_mm", "?")


def wrong_diameter(raw):
    raw.description["ball_diameter_mm"] = 31.4


def other_tool(raw):
    raw.description["tool"]["balls_mm"]["B"] = [-50, 95, 310]


never_still = each_row("resolver", lambda k, words: [words[0], f"{0.3 * k:.3f}", *words[2:]])
fewer_columns = each_row("cmm", lambda _, words: words[:-1])
SLOW = r"joints move too little.*unit of these columns, and of the measured"
REFUSED = {
    "decimal commas": (decimal_commas, r"cmm.csv:2: 510 of 510 rows .*decimal commas"),
    "semicolons": (semicolons, r"resolver.csv:1: .*semicolons.*commas between fields"),
    "missing column": (
        renamed("cmm", "load_N", "Load"),
        r"cmm.csv:1: missing column load_N.*'Load'",
    ),
    "column twice": (
        renamed("resolver", "q2_deg", "q1_deg"),
        r"resolver.csv:1: column q1_deg occurs twice",
    ),
    "clock offset": (
        lambda raw: retime(raw.resolver, 1234.5),
        r"outside any dwell.*adding \+123[34]\.\d s .*100%",
    ),
    "clock epoch": (
        lambda raw: retime(raw.cmm, 1.2e9),
        r"outside any dwell.*adding -120000000\d\.\d s",
    ),
    "clock drift": (
        scaled("cmm", 0, 1, 1.4, "{:.2f}"),
        r"outside any dwell.*no constant offset",
    ),
    "radians": (
        scaled("resolver", 1, 7, 1 / 57.29578, "{:.7f}"),
        r"resolver.csv: q1_deg … q6_deg: .*look like radians.*to degrees",
    ),
    "never still": (never_still, r"never at rest.*still_speed_deg_s"),
    "empty file": (content(b""), r"cmm.csv:1: the file is empty"),
    "header only": (header_only, r"resolver.csv:1: there is no row"),
    "cut gzip": (cut_gzip, r"cmm.csv.gz: the compressed file is damaged or cut short"),
    "binary": (content(bytes(range(256)) * 40), r"cmm.csv:1: the file is not UTF-8 text"),
    "too many bad rows": (too_many_bad, r"cmm.csv:2: z_mm: 128 of 510 rows .*not a finite number"),
    "wrong diameter": (wrong_diameter, r"spheres of the stated diameter.*ball_diameter_mm"),
    "metres": (scaled("cmm", 7, 10, 1e-3, "{:.7f}"), r"lie in one plane.*unit of x_mm"),
    "micrometres": (scaled("cmm", 7, 10, 1e3, "{:.1f}"), SLOW),
    "other tool": (other_tool, r"ball . is .* mm off.*tool.balls_mm"),
    "no grid": (lambda raw: delete(raw.cmm, "grid"), r"no usable grid row"),
    "fewer columns": (fewer_columns, r"cmm.csv:2: .*another number of fields.*9 for 10"),
}


@pytest.mark.slow_but_one_in(2)
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
