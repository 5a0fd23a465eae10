"""What real logs do and survive: every row is used or listed with its reason."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest

from spoiling import (
    APPROACH,
    CONFIGURATIONS,
    DWELL,
    TOUCHES,
    compressed,
    delete,
    ingest,
    replace,
    retime,
    row_of,
)


def test_clean_logs_leave_nothing_out(raw_campaign):
    ingested = ingest(raw_campaign)
    assert len(ingested.observations) == CONFIGURATIONS
    assert ingested.quarantined == ()
    assert ingested.notes == ()


# --- survived ----------------------------------------------------------------------------------


def cells(log, *changes):
    """Write texts into fields of a log: row, column, text."""

    def spoil(raw):
        for index, column, text in changes:
            replace(getattr(raw, log), index, column, text)

    return spoil


def touch(words, further, column, text):
    """Change a touch of a configuration: its text, or by a length."""

    def spoil(raw):
        index = row_of(raw.cmm, *words.split()) + further
        value = raw.cmm[index].split(",")[raw.cmm[0].split(",").index(column)]
        new = text if isinstance(text, str) else f"{float(value) + text:.4f}"
        replace(raw.cmm, index, column, new)

    return spoil


def without(words, count=1, further=0):
    """Delete touches of a configuration."""

    def spoil(raw):
        first = row_of(raw.cmm, *words.split()) + further
        del raw.cmm[first : first + count]

    return spoil


def late(words, seconds, first, last):
    """Shift the clock of touches of a configuration."""

    def spoil(raw):
        start = row_of(raw.cmm, *words.split())
        retime(raw.cmm, seconds, start + first, start + last)

    return spoil


def deleted(*rows):
    """Delete all touches with some words."""

    def spoil(raw):
        for words in rows:
            delete(raw.cmm, *words.split())

    return spoil


def content(change):
    """Write the touches as bytes made of their text."""

    def spoil(raw):
        raw.extra["cmm.csv"] = change("\n".join(raw.cmm))

    return spoil


def each_line(change, *logs):
    """Change each line of a log; the header is line 0."""

    def spoil(raw):
        for log in logs:
            lines = getattr(raw, log)
            lines[:] = [change(k, line) for k, line in enumerate(lines)]

    return spoil


def both(*spoils):
    def spoil(raw):
        for one in spoils:
            one(raw)

    return spoil


def repeated_row(raw):
    raw.cmm.insert(30, raw.cmm[20])
    raw.resolver.insert(50, raw.resolver[50])


def rows_out_of_order(raw):
    raw.cmm[10], raw.cmm[200] = raw.cmm[200], raw.cmm[10]
    raw.resolver[3], raw.resolver[4] = raw.resolver[4], raw.resolver[3]


def single_decimal_comma(raw):
    index = row_of(raw.cmm, "P02", "22", "2", "A") + 1
    raw.cmm[index] = raw.cmm[index].replace(".", ",", 2).replace(",", ".", 1)


def windows_line_ends(raw):
    raw.line_end = "\r\n"


def blank_lines(raw):
    raw.cmm.insert(7, "")
    raw.cmm.append("   ")


def pose_only_in_cmm_log(raw):
    first = 1 + 9 * (APPROACH + DWELL)
    del raw.resolver[first : first + APPROACH + DWELL]


def sample_time_twice(raw):
    replace(raw.resolver, 10, "time_s", raw.resolver[9].split(",")[0])


outlier_touch = touch("P01 0 1 B", 2, "y_mm", 0.4)
numbers = both(
    cells("cmm", (33, "x_mm", "nan"), (63, "time_s", "soon")),
    cells("resolver", (12, "q3_deg", "---"), (13, "temperature_C", ""), (14, "tau1_Nm", "inf")),
)
beyond = both(
    touch("P01 22 1 A", 1, "y_mm", "-4e15"),
    touch("P02 22 1 B", 1, "x_mm", "1e160"),
)
words = cells(
    "cmm", (34, "kind", "gird"), (64, "ball", "D"), (93, "repeat", "1.5"), (125, "pose", "")
)
mark = each_line(lambda k, line: line if k else "\ufeff" + line, "cmm", "resolver")
quoted = each_line(lambda _, line: ",".join(f'"{word}"' for word in line.split(",")), "cmm")
label = each_line(lambda _, line: line.replace(",P03,22,2,", ",P01,22,3,"), "cmm")
operator = each_line(lambda k, line: line + (",JH" if k else ",operator"), "cmm")


def apart(reason, touches):
    """A configuration lost: its other touches, and the samples of its dwell."""
    return {reason: touches, "a dwell whose touches are quarantined": DWELL}


OUTLIER = {"suspected outlier": 1}
IDLE = "a dwell in which nothing was touched"
UNKNOWN = {"kind is none of": 1, "ball is none of": 1, "not a whole number": 1, "no label": 1}
MOVING = {"outside any dwell": 2} | apart("ball A .* fewer than four", 13)
#: name: (how the logs are spoilt, configurations left, {reason: rows} quarantined, note)
SURVIVED = {
    "repeated row": (repeated_row, 34, {"repeats an earlier row": 2}, None),
    "rows out of order": (rows_out_of_order, 34, {}, "rows of cmm.csv out of order: "),
    "missing ball": (deleted("P03 22 1 B"), 33, apart("ball B of .* is missing", 10), None),
    "three touches": (without("P02 0 2 C", 2), 33, apart("ball C .* fewer than four", 13), None),
    "coplanar touches": (without("P05 22 2 A"), 33, apart("ball A .* coplanar", 14), None),
    "outlier touch": (outlier_touch, 34, OUTLIER, None),
    "outlier touch far off": (touch("P01 22 1 A", 3, "x_mm", "99999.0"), 34, OUTLIER, None),
    "outlier out of this world": (beyond, 34, {"a coordinate beyond any measuring": 2}, None),
    "negative load": (touch("P02 22 1 A", 2, "load_N", "-22"), 34, {"negative load": 1}, None),
    "outlier pole": (
        touch("P04 0 1 A", 0, "z_mm", 1.0),
        33,
        OUTLIER | apart("ball A .* coplanar", 14),
        None,
    ),
    "outlier of four": (
        both(without("P06 22 1 C", 1, 4), touch("P06 22 1 C", 3, "x_mm", -0.7)),
        33,
        OUTLIER | apart("ball C .* fewer", 13),
        None,
    ),
    "nan and text": (numbers, 34, {"not a finite number": 5}, None),
    "single decimal comma": (single_decimal_comma, 34, {"the number of fields": 1}, None),
    "unknown words": (words, 34, UNKNOWN, None),
    "byte-order mark": (mark, 34, {}, None),
    "windows line ends": (windows_line_ends, 34, {}, None),
    "utf-16": (content(lambda text: f"{text}\n".encode("utf-16")), 34, {}, None),
    "quoted fields": (quoted, 34, {}, None),
    "blank lines": (blank_lines, 34, {}, None),
    "compressed": (compressed, 34, {}, None),
    "cut in a field": (content(lambda text: text.encode()[:-2]), 34, {"cut short": 1}, None),
    "cut between fields": (content(lambda text: text.encode()[:-15]), 34, {"cut short": 1}, None),
    "no final line end": (content(str.encode), 34, {}, None),
    "touches while moving": (late("P03 0 1 A", -3.5, 0, 2), 33, MOVING, None),
    "touch in next dwell": (late("P03 0 1 C", 45.0, 4, 5), 34, {"another dwell": 1}, None),
    "pose only in resolver log": (
        deleted("P04 22 1"),
        33,
        {IDLE: DWELL},
        "dwells without touches: 1",
    ),
    "touch in a dwell of its own": (
        both(deleted("P04 22 1"), late("P03 22 1 C", 45.0, 4, 5)),
        33,
        {"another dwell": 1, "a dwell whose touches are quarantined": DWELL},
        None,
    ),
    "pose only in cmm log": (pose_only_in_cmm_log, 33, {"outside any dwell": TOUCHES}, None),
    "sample time twice": (sample_time_twice, 34, {"another sample has this time": 1}, None),
    "wrong label": (label, 33, apart("joint angles are not those", TOUCHES), None),
    "no holdout": (deleted("holdout"), 32, {IDLE: 2 * DWELL}, "no holdout rows"),
    "no lines": (deleted("line_x", "line_y"), 26, {IDLE: 8 * DWELL}, "no line_x rows"),
    "extra column": (operator, 34, {}, "column operator of cmm.csv is not used"),
}


@pytest.mark.slow_but_one_in(16)
@pytest.mark.parametrize("name", SURVIVED)
def test_survives_with_every_row_used_or_listed(raw_campaign, name):
    spoil, left, expected, note = SURVIVED[name]
    spoil(raw_campaign)
    ingested = ingest(raw_campaign)
    found = Counter(row.reason for row in ingested.quarantined)
    for reason, count in expected.items():
        assert sum(found[text] for text in found if re.search(reason, text)) == count, found
    assert sum(found.values()) == sum(expected.values()), found
    assert len(ingested.observations) == left
    assert note is None or any(note in text for text in ingested.notes)
    rows = len([line for line in raw_campaign.cmm[1:] if line.strip()])
    of_cmm = sum(row.file.startswith("cmm") for row in ingested.quarantined)
    assert rows == ingested.observations.measured.touches.sum() + of_cmm
    samples = len(raw_campaign.resolver) - 1
    moving = APPROACH * (samples // (APPROACH + DWELL))
    of_log = len(ingested.quarantined) - of_cmm
    assert samples == ingested.observations.log.samples.sum() + moving + of_log
    assert len({(row.file, row.line) for row in ingested.quarantined}) == len(ingested.quarantined)


def test_lists_the_physical_lines_and_the_value(raw_campaign):
    replace(raw_campaign.cmm, 40, "y_mm", "12.x")
    raw_campaign.cmm.insert(20, "")  # a blank line counts
    raw_campaign.cmm.append(raw_campaign.cmm[3])
    ingested = ingest(raw_campaign)
    found = [(row.file, row.line, row.value) for row in ingested.quarantined]
    assert found == [("cmm.csv", 42, "y_mm = '12.x'"), ("cmm.csv", len(raw_campaign.cmm), "")]


def test_a_configuration_lost_whole_at_reading_is_not_missing(raw_campaign):
    raw_campaign.description["configurations"] = CONFIGURATIONS
    first = row_of(raw_campaign.cmm, "P03", "22", "1", "A")
    for index in range(first, first + TOUCHES):
        replace(raw_campaign.cmm, index, "z_mm", "-")
    # A configuration with a wrong word in one touch is not counted twice, either.
    replace(raw_campaign.cmm, row_of(raw_campaign.cmm, "P04", "22", "1", "A") + 2, "kind", "gird")
    ingested = ingest(raw_campaign)
    assert len(ingested.observations) == CONFIGURATIONS - 1
    assert ingested.warnings == ()
    delete(raw_campaign.cmm, "P03", "22", "1")
    (warning,) = ingest(raw_campaign).warnings
    assert "has 33 of the 34 configurations" in warning


def test_a_outlier_is_the_very_touch_that_was_moved(raw_campaign):
    index = row_of(raw_campaign.cmm, "P01", "0", "1", "B") + 2
    outlier_touch(raw_campaign)
    ingested = ingest(raw_campaign)
    assert [row.line for row in ingested.quarantined] == [index + 1]


def moved_touches(raw, shift_of):
    """Shift touches, in order of the file, by what a function of ball and line makes of them."""
    names = raw.cmm[0].split(",")
    first = names.index("x_mm")
    for index, line in enumerate(raw.cmm[1:], 1):
        words = line.split(",")
        p_mm = np.array(words[first : first + 3], dtype=float)
        p_mm += shift_of(words[names.index("ball")], index, p_mm)
        words[first : first + 3] = [f"{value:.4f}" for value in p_mm]
        raw.cmm[index] = ",".join(words)


def balls_of(observations):
    return observations.measured.balls.p_instr_m


def test_a_knocked_ball_is_named_with_its_time_and_loses_no_row(raw_campaign):
    clean = balls_of(ingest(raw_campaign).observations)
    across = clean[:, 2] - clean[:, 1]
    across /= np.linalg.norm(across, axis=1)[:, None]
    half = 17  # of 34 configurations
    moved_touches(
        raw_campaign,
        lambda ball, index, _: (
            0.3 * across[(index - 1) // TOUCHES]
            if ball == "B" and (index - 1) // TOUCHES >= half
            else 0.0
        ),
    )
    ingested = ingest(raw_campaign)
    assert ingested.quarantined == ()
    (warning,) = ingested.warnings
    assert re.match(r"ball B moved by 0\.[23]\d\d mm on the tool between pose P", warning)
    assert "as two campaigns" in warning


@pytest.mark.parametrize("off_mm", [0.02, -0.015])
def test_a_wrong_radius_is_told_with_its_size_and_taken_out(raw_campaign, off_mm):
    clean = ingest(raw_campaign).observations
    raw_campaign.description["ball_diameter_mm"] -= 2.0 * off_mm
    ingested = ingest(raw_campaign)
    assert ingested.quarantined == ()
    (warning,) = ingested.warnings
    size = re.match(r"the touches lie (\S+) ± \S+ mm (\w+) the spheres", warning)
    assert float(size[1]) == pytest.approx(abs(off_mm), abs=0.002)
    assert size[2] == ("outside" if off_mm > 0.0 else "inside")
    np.testing.assert_allclose(balls_of(ingested.observations), balls_of(clean), atol=4e-6)
