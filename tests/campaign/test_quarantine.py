"""The quarantine table and the limit of what may be quarantined."""

from __future__ import annotations

import pytest

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import Quarantined, quarantine_csv, quarantined
from pa10cal.errors import RawDataError


def test_the_table_has_a_header_even_when_empty():
    assert quarantine_csv(()) == "file,line,reason,value\n"


def test_values_with_commas_and_quotes_survive():
    rows = quarantined("cmm.csv", [7], "not a finite number", ["x_mm = '1,5'"])
    assert quarantine_csv(rows).splitlines()[1] == "cmm.csv,7,not a finite number,\"x_mm = '1,5'\""


def rows(count, reason="bad"):
    return [Quarantined("cmm.csv", line, reason) for line in range(2, count + 2)]


def test_the_limit_itself_is_allowed():
    refuse_too_many(rows(20), {"cmm.csv": 100, "resolver.csv": 50}, 0.2)


def test_beyond_the_limit_the_commonest_reason_and_its_first_line_are_named():
    listed = [Quarantined("cmm.csv", 90, "rare"), *rows(20)]
    with pytest.raises(RawDataError, match=r"cmm.csv:2: 21 of 100 rows .*20 of them because: bad"):
        refuse_too_many(listed, {"cmm.csv": 100}, 0.2)


def test_all_rows_quarantined_is_too_many_whatever_the_limit():
    with pytest.raises(RawDataError, match="3 of 3 rows"):
        refuse_too_many(rows(3), {"cmm.csv": 3}, 1.0)
