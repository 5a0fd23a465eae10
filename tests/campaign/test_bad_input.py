"""What real logs do: each is survived with every row accounted for, or refused with one message."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from pa10cal.campaign.description import read_campaign
from pa10cal.campaign.ingest import ingest_campaign
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from pa10cal.settings import IngestSettings

CONFIGURATIONS = 34
TOUCHES = 15  # a configuration
APPROACH, DWELL = 6, 10


def ingest(raw):
    folder = raw.write()
    campaign = read_campaign(folder)
    return ingest_campaign(campaign, load_arm(campaign.robot), folder, IngestSettings())


def row_of(lines, *words):
    """Return the index of the first line with these words in neighbouring fields."""
    return next(k for k, line in enumerate(lines) if f",{','.join(words)}," in line)


def replace(lines, index, column, text):
    words = lines[index].split(",")
    words[lines[0].split(",").index(column)] = text
    lines[index] = ",".join(words)


def delete(lines, *words):
    lines[1:] = [line for line in lines[1:] if f",{','.join(words)}," not in line]


def retime(lines, seconds, first=1, last=None):
    for index in range(first, len(lines) if last is None else last):
        time_s = float(lines[index].split(",")[0])
        replace(lines, index, "time_s", f"{time_s + seconds:.2f}")


def test_clean_logs_leave_nothing_out(raw_campaign):
    ingested = ingest(raw_campaign)
    assert len(ingested.poses) == CONFIGURATIONS
    assert ingested.left_out == ()
    assert ingested.notes == ()


# --- survived ----------------------------------------------------------------------------------
# name: (how the logs are spoilt, configurations left, {reason: rows} left out, note)


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


def stray_touch(raw):
    index = row_of(raw.cmm, "P01", "0", "1", "B") + 2
    replace(raw.cmm, index, "y_mm", f"{float(raw.cmm[index].split(',')[8]) + 0.4:.4f}")


def stray_touch_far_off(raw):
    replace(raw.cmm, row_of(raw.cmm, "P01", "22", "1", "A") + 3, "x_mm", "99999.0")


def stray_out_of_this_world(raw):
    replace(raw.cmm, row_of(raw.cmm, "P01", "22", "1", "A") + 1, "y_mm", "-4e15")


def stray_pole(raw):
    index = row_of(raw.cmm, "P04", "0", "1", "A")
    replace(raw.cmm, index, "z_mm", f"{float(raw.cmm[index].split(',')[9]) + 1.0:.4f}")


def stray_of_four(raw):
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


def quoted_fields(raw):
    raw.cmm[:] = [",".join(f'"{word}"' for word in line.split(",")) for line in raw.cmm]


def blank_lines(raw):
    raw.cmm.insert(7, "")
    raw.cmm.append("   ")


def compressed(raw):
    raw.description["files"] = {"cmm": "cmm.csv.gz", "resolver": "resolver.csv.gz"}


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
    return {reason: touches, "a dwell whose configuration is left out": DWELL}


SURVIVED = {
    "repeated row": (repeated_row, 34, {"repeats an earlier row": 2}, None),
    "rows out of order": (rows_out_of_order, 34, {}, "rows of cmm.csv out of order: "),
    "missing ball": (missing_ball, 33, apart("ball B of .* is missing", 10), None),
    "three touches": (three_touches, 33, apart("ball C .* fewer than four", 13), None),
    "coplanar touches": (coplanar_touches, 33, apart("ball A .* coplanar", 14), None),
    "stray touch": (stray_touch, 34, {"stray": 1}, None),
    "stray touch far off": (stray_touch_far_off, 34, {"stray": 1}, None),
    "stray out of this world": (stray_out_of_this_world, 34, {"stray": 1}, None),
    "stray pole": (stray_pole, 33, {"stray": 1} | apart("ball A .* coplanar", 14), None),
    "stray of four": (stray_of_four, 33, {"stray": 1} | apart("ball C .* fewer", 13), None),
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
    found = Counter(row.reason for row in ingested.left_out)
    for reason, count in expected.items():
        assert sum(found[text] for text in found if re.search(reason, text)) == count, found
    assert sum(found.values()) == sum(expected.values()), found
    assert len(ingested.poses) == left
    assert note is None or any(note in text for text in ingested.notes)
    rows = len([line for line in raw_campaign.cmm[1:] if line.strip()])
    of_cmm = sum(row.file.startswith("cmm") for row in ingested.left_out)
    assert rows == ingested.poses.ball_touches.sum() + of_cmm
    samples = len(raw_campaign.resolver) - 1
    moving = APPROACH * (samples // (APPROACH + DWELL))
    of_log = len(ingested.left_out) - of_cmm
    assert samples == ingested.poses.dwell_samples.sum() + moving + of_log
    assert len({(row.file, row.line) for row in ingested.left_out}) == len(ingested.left_out)


def test_lists_the_physical_lines_and_the_value(raw_campaign):
    replace(raw_campaign.cmm, 40, "y_mm", "12.x")
    raw_campaign.cmm.insert(20, "")  # a blank line counts
    raw_campaign.cmm.append(raw_campaign.cmm[3])
    ingested = ingest(raw_campaign)
    found = [(row.file, row.line, row.value) for row in ingested.left_out]
    assert found == [("cmm.csv", 42, "y_mm = '12.x'"), ("cmm.csv", len(raw_campaign.cmm), "")]


def test_a_stray_is_the_very_touch_that_was_moved(raw_campaign):
    index = row_of(raw_campaign.cmm, "P01", "0", "1", "B") + 2
    stray_touch(raw_campaign)
    ingested = ingest(raw_campaign)
    assert [row.line for row in ingested.left_out] == [index + 1]


# --- refused -----------------------------------------------------------------------------------


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
        replace(raw.resolver, index, "q1_deg", f"{0.5 * index:.3f}")


def empty_cmm(raw):
    raw.extra["cmm.csv"] = b""


def header_only(raw):
    del raw.resolver[1:]


def cut_gzip(raw):
    compressed(raw)
    raw.write()
    raw.extra["cmm.csv.gz"] = (raw.folder / "cmm.csv.gz").read_bytes()[:-300]


def utf16(raw):
    raw.extra["cmm.csv"] = "\n".join(raw.cmm).encode("utf-16")


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
    "column twice": (column_twice, r"resolver.csv:1: column q1_deg is there twice"),
    "clock offset": (clock_offset, r"outside any dwell.*adding \+123[34]\.\d s .*100%"),
    "clock epoch": (clock_epoch, r"outside any dwell.*adding -120000000\d\.\d s"),
    "clock drift": (clock_drift, r"outside any dwell.*no constant offset"),
    "radians": (radians, r"resolver.csv: q1_deg … q6_deg: .*look like radians.*to degrees"),
    "never still": (never_still, r"stands still nowhere.*still_speed_deg_s"),
    "empty file": (empty_cmm, r"cmm.csv:1: the file is empty"),
    "header only": (header_only, r"resolver.csv:1: there is no row"),
    "cut gzip": (cut_gzip, r"cmm.csv.gz: the compressed file is damaged or cut short"),
    "utf-16": (utf16, r"cmm.csv:1: the file is no UTF-8 text"),
    "too many bad rows": (too_many_bad, r"cmm.csv:2: 128 of 510 rows .*not a finite number"),
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
