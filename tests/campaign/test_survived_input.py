"""What real logs do and survive: every row is used or listed with its reason."""

from __future__ import annotations

import re
from collections import Counter

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
# name: (how the logs are spoilt, configurations left, {reason: rows} quarantined, note)


def repeated_row(raw):
    raw.cmm.insert(30, raw.cmm[20])
    raw.resolver.insert(50, raw.resolver[50])


def rows_out_of_order(raw):
    raw.cmm[10], raw.cmm[200] = raw.cmm[200], raw.cmm[10]
    raw.resolver[3], raw.resolver[4] = raw.resolver[4], raw.resolver[3]


def missing_ball(raw):
    delete(raw.cmm, "P03", "22", "1", "B")


def three_touches(raw):
    first = row_of(raw.cmm, "P02", "0", "2", "C")
    del raw.cmm[first : first + 2]


def coplanar_touches(raw):
    del raw.cmm[row_of(raw.cmm, "P05", "22", "2", "A")]


def outlier_touch(raw):
    index = row_of(raw.cmm, "P01", "0", "1", "B") + 2
    replace(raw.cmm, index, "y_mm", f"{float(raw.cmm[index].split(',')[8]) + 0.4:.4f}")


def outlier_touch_far_off(raw):
    replace(raw.cmm, row_of(raw.cmm, "P01", "22", "1", "A") + 3, "x_mm", "99999.0")


def outlier_out_of_this_world(raw):
    replace(raw.cmm, row_of(raw.cmm, "P01", "22", "1", "A") + 1, "y_mm", "-4e15")
    replace(raw.cmm, row_of(raw.cmm, "P02", "22", "1", "B") + 1, "x_mm", "1e160")


def negative_load(raw):
    replace(raw.cmm, row_of(raw.cmm, "P02", "22", "1", "A") + 2, "load_N", "-22")


def outlier_pole(raw):
    index = row_of(raw.cmm, "P04", "0", "1", "A")
    replace(raw.cmm, index, "z_mm", f"{float(raw.cmm[index].split(',')[9]) + 1.0:.4f}")


def outlier_of_four(raw):
    index = row_of(raw.cmm, "P06", "22", "1", "C") + 4
    del raw.cmm[index]
    replace(raw.cmm, index - 1, "x_mm", f"{float(raw.cmm[index - 1].split(',')[7]) - 0.7:.4f}")


def nan_and_text(raw):
    replace(raw.cmm, 33, "x_mm", "nan")
    replace(raw.cmm, 63, "time_s", "soon")
    replace(raw.resolver, 12, "q3_deg", "---")
    replace(raw.resolver, 13, "temperature_C", "")
    replace(raw.resolver, 14, "tau1_Nm", "inf")


def single_decimal_comma(raw):
    index = row_of(raw.cmm, "P02", "22", "2", "A") + 1
    raw.cmm[index] = raw.cmm[index].replace(".", ",", 2).replace(",", ".", 1)


def unknown_words(raw):
    replace(raw.cmm, 34, "kind", "gird")
    replace(raw.cmm, 64, "ball", "D")
    replace(raw.cmm, 93, "repeat", "1.5")
    replace(raw.cmm, 125, "pose", "")


def byte_order_mark(raw):
    raw.cmm[0] = "\ufeff" + raw.cmm[0]
    raw.resolver[0] = "\ufeff" + raw.resolver[0]


def windows_line_ends(raw):
    raw.line_end = "\r\n"


def utf_16(raw):
    raw.extra["cmm.csv"] = "\n".join([*raw.cmm, ""]).encode("utf-16")


def quoted_fields(raw):
    raw.cmm[:] = [",".join(f'"{word}"' for word in line.split(",")) for line in raw.cmm]


def blank_lines(raw):
    raw.cmm.insert(7, "")
    raw.cmm.append("   ")


def cut_in_a_field(raw):
    raw.extra["cmm.csv"] = "\n".join(raw.cmm).encode()[:-2]


def cut_between_fields(raw):
    raw.extra["cmm.csv"] = "\n".join(raw.cmm).encode()[:-15]


def no_final_line_end(raw):
    raw.extra["cmm.csv"] = "\n".join(raw.cmm).encode()


def touches_while_moving(raw):
    first = row_of(raw.cmm, "P03", "0", "1", "A")
    retime(raw.cmm, -3.5, first, first + 2)


def touch_in_next_dwell(raw):
    first = row_of(raw.cmm, "P03", "0", "1", "C") + 4
    retime(raw.cmm, 45.0, first, first + 1)


def pose_only_in_resolver_log(raw):
    delete(raw.cmm, "P04", "22", "1")


def pose_only_in_cmm_log(raw):
    first = 1 + 9 * (APPROACH + DWELL)
    del raw.resolver[first : first + APPROACH + DWELL]


def sample_time_twice(raw):
    replace(raw.resolver, 10, "time_s", raw.resolver[9].split(",")[0])


def wrong_label(raw):
    for index, line in enumerate(raw.cmm):
        raw.cmm[index] = line.replace(",P03,22,2,", ",P01,22,3,")


def no_holdout(raw):
    delete(raw.cmm, "holdout")


def no_lines(raw):
    delete(raw.cmm, "line_x")
    delete(raw.cmm, "line_y")


def extra_column(raw):
    raw.cmm[:] = [line + (",operator" if k == 0 else ",JH") for k, line in enumerate(raw.cmm)]


def apart(reason, touches):
    """A configuration lost: its other touches, and the samples of its dwell."""
    return {reason: touches, "a dwell whose configuration is quarantined": DWELL}


OUTLIER = {"suspected outlier": 1}
SURVIVED = {
    "repeated row": (repeated_row, 34, {"repeats an earlier row": 2}, None),
    "rows out of order": (rows_out_of_order, 34, {}, "rows of cmm.csv out of order: "),
    "missing ball": (missing_ball, 33, apart("ball B of .* is missing", 10), None),
    "three touches": (three_touches, 33, apart("ball C .* fewer than four", 13), None),
    "coplanar touches": (coplanar_touches, 33, apart("ball A .* coplanar", 14), None),
    "outlier touch": (outlier_touch, 34, OUTLIER, None),
    "outlier touch far off": (outlier_touch_far_off, 34, OUTLIER, None),
    "outlier out of this world": (
        outlier_out_of_this_world,
        34,
        {"a coordinate beyond any measuring volume": 2},
        None,
    ),
    "negative load": (negative_load, 34, {"negative load": 1}, None),
    "outlier pole": (
        outlier_pole,
        33,
        OUTLIER | apart("ball A .* coplanar", 14),
        None,
    ),
    "outlier of four": (
        outlier_of_four,
        33,
        OUTLIER | apart("ball C .* fewer", 13),
        None,
    ),
    "nan and text": (nan_and_text, 34, {"not a finite number": 5}, None),
    "single decimal comma": (single_decimal_comma, 34, {"the number of fields": 1}, None),
    "unknown words": (
        unknown_words,
        34,
        {"kind is none of": 1, "ball is none of": 1, "not a whole number": 1, "no label": 1},
        None,
    ),
    "byte-order mark": (byte_order_mark, 34, {}, None),
    "windows line ends": (windows_line_ends, 34, {}, None),
    "utf-16": (utf_16, 34, {}, None),
    "quoted fields": (quoted_fields, 34, {}, None),
    "blank lines": (blank_lines, 34, {}, None),
    "compressed": (compressed, 34, {}, None),
    "cut in a field": (cut_in_a_field, 34, {"cut short": 1}, None),
    "cut between fields": (cut_between_fields, 34, {"cut short": 1}, None),
    "no final line end": (no_final_line_end, 34, {}, None),
    "touches while moving": (
        touches_while_moving,
        33,
        {"outside any dwell": 2} | apart("ball A .* fewer than four", 13),
        None,
    ),
    "touch in next dwell": (touch_in_next_dwell, 34, {"another dwell": 1}, None),
    "pose only in resolver log": (
        pose_only_in_resolver_log,
        33,
        {"a dwell in which nothing was touched": DWELL},
        "dwells without touches: 1",
    ),
    "pose only in cmm log": (pose_only_in_cmm_log, 33, {"outside any dwell": TOUCHES}, None),
    "sample time twice": (sample_time_twice, 34, {"another sample has this time": 1}, None),
    "wrong label": (wrong_label, 33, apart("joint angles are not those", TOUCHES), None),
    "no holdout": (
        no_holdout,
        32,
        {"a dwell in which nothing was touched": 2 * DWELL},
        "no holdout rows",
    ),
    "no lines": (
        no_lines,
        26,
        {"a dwell in which nothing was touched": 8 * DWELL},
        "no line_x rows",
    ),
    "extra column": (extra_column, 34, {}, "column operator of cmm.csv is not used"),
}


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


def test_a_outlier_is_the_very_touch_that_was_moved(raw_campaign):
    index = row_of(raw_campaign.cmm, "P01", "0", "1", "B") + 2
    outlier_touch(raw_campaign)
    ingested = ingest(raw_campaign)
    assert [row.line for row in ingested.quarantined] == [index + 1]
