"""How an unknown file is written: names and rows that are not written alike."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from made_up_sightings import sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.recognise import roles_of
from pa10cal.campaign.sniffing import sniff, time_format

NAMES = [*(f"Joint {k}" for k in range(1, 7)), "Pos X", "Pos Y", "Pos Z"]


@pytest.fixture
def rows(tmp_path):
    """Return rows of joint positions and places, and the campaign they are of."""
    raw = sighted(tmp_path / "made", "points", targets=1)
    table = np.column_stack([np.degrees(raw.q), 1e3 * raw.T_instr_target[:, :3, 3]])
    return raw, [[f"{value:.6f}" for value in row] for row in table]


@pytest.fixture
def read(tmp_path, proposed):
    """Write lines, propose a campaign.yaml for them, and read the campaign so."""

    def run(lines):
        (tmp_path / "export.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return proposed("export.txt"), read_campaign(tmp_path)

    return run


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize(
    ("above", "between", "end"),
    [
        (",".join([*NAMES, "Remark"]), ",", ","),  # the last column is named, and empty
        (";".join([*NAMES, "Remark"]), ";", ";"),
        ("\t".join([*NAMES, "Remark"]), "\t", "\t"),
        (",".join([*NAMES, "Remark"]), ",", ""),  # and has no field at all
        (",".join([*NAMES, "a", "b", "c"]), ",", ""),
        (" ".join(NAMES), " ", ""),  # names with blanks between blanks
        ("  ".join(NAMES), "  ", ""),
        (" ".join(f"{name} [deg]" if "J" in name else f"{name} [mm]" for name in NAMES), " ", ""),
        ("\t".join(NAMES), "  ", ""),
        (", ".join(NAMES), " ", ""),
        (",".join(NAMES), ",", ","),  # a separator ends each row
    ],
)
@pytest.mark.usefixtures("tried")
def test_names_that_are_not_written_as_the_rows_are_read(rows, read, above, between, end):
    raw, fields = rows
    text, found = read([above, *(between.join(row) + end for row in fields)])
    assert "# read so: 40 rows can be used, 0 cannot" in text
    np.testing.assert_allclose(found.observations.states.q_rad, raw.q, atol=2e-8)
    columns = yaml.safe_load(text)["columns"]["poses"]
    if columns.get("header", 1) == 0:
        assert columns["joints"]["names"] == [str(k) for k in range(1, 7)]
        assert "1 (Joint 1" in text


@pytest.mark.parametrize(
    ("how", "stated"),
    [
        ("'%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S"),
        ("'%Y-%m-%d %H:%M:%S", "iso"),
        ('"\'%d.%m.%Y %H:%M:%S"', "%d.%m.%Y %H:%M:%S"),
    ],
)
def test_an_apostrophe_marks_text_and_is_no_part_of_it(rows, read, how, stated):
    raw, fields = rows
    at = np.datetime64("2026-03-04T10:00:00") + 37 * np.arange(40).astype("timedelta64[s]")
    dates = [moment.item().strftime(how) for moment in at]
    lines = [",".join([date, *row]) for date, row in zip(dates, fields, strict=True)]
    text, found = read([",".join(["Time", *NAMES]), *lines])
    assert yaml.safe_load(text)["columns"]["poses"]["time"]["format"] == stated
    np.testing.assert_allclose(found.observations.states.time_s, 37.0 * np.arange(40))
    np.testing.assert_allclose(found.observations.states.q_rad, raw.q, atol=2e-8)


@pytest.mark.parametrize(
    "above",
    [
        "measured on 4 March 2026",
        "1 2 3 4 5 6 7 8 9",
        "a,b",
        "; ; ; ; ; ; ; ;",
        "'",
    ],
)
def test_a_line_that_holds_no_names_gives_none(tmp_path, rows, above):
    path = tmp_path / "export.txt"
    path.write_text("\n".join([above, *(" ".join(row) for row in rows[1])]), encoding="utf-8")
    sniffed = sniff(path)
    assert sniffed.titles == ()
    assert sniffed.names == tuple(str(k) for k in range(1, 10))


@pytest.mark.parametrize(
    ("word", "form", "other"),
    [
        ("04/04/2024 10:00:00", "%m/%d/%Y %H:%M:%S", ("%d/%m/%Y %H:%M:%S",)),
        ("13/04/2024 10:00:00", "%d/%m/%Y %H:%M:%S", ()),
        ("2024-04-04 10:00:00", "iso", ()),
    ],
)
def test_of_a_date_whose_day_may_be_a_month_both_are_told(word, form, other):
    assert time_format([word, word.replace("10:00", "10:10")]) == (form, other)


@pytest.mark.parametrize("way", [(",", "."), (";", ","), ("\t", ".")])
@pytest.mark.parametrize("moment", [False, True])
def test_a_file_of_times_and_distances_has_two_columns(tmp_path, way, moment):
    """The natural file of an instrument that measures distances."""
    separator, decimal = way
    path = tmp_path / "tracker.csv"
    lines = [f"Time{separator}Distance [mm]"]
    for k in range(20):
        time = f"2026-03-02T08:00:{k:02d}" if moment else f"{0.3 + k:.3f}"
        lines.append(f"{time}{separator}{2544.6199 + 7.3 * k:.4f}".replace(".", decimal))
    path.write_text("\n".join(lines) + "\n")
    found = sniff(path)
    assert found.names == ("Time", "Distance [mm]")
    assert (found.layout.sign, found.layout.decimal) == way
    np.testing.assert_allclose(found.column("Distance [mm]"), 2544.6199 + 7.3 * np.arange(20))


@pytest.mark.parametrize("name", ["d_mm", "Distance [mm]", "Abstand (mm)"])
def test_distances_are_recognised_by_their_name(name):
    assert roles_of(["time_s", name], None).single["distance"] == name
