"""Rows that are not used, how many may be, and readings of the same joint positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.campaign.joint_positions import labels, same_commands
from pa10cal.campaign.raw_rows import Quarantined, RawRows, quarantine_csv, quarantined
from pa10cal.campaign.screens import refuse_too_many
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


def test_a_row_is_quarantined_for_the_first_of_its_columns_that_holds_no_number():
    numbers = {"a": np.array([1.0, np.nan, 3.0]), "b": np.array([1.0, np.nan, np.nan])}
    texts = {"b": {3: "1,5", 4: "x"}}
    raw = RawRows("log.csv", numbers, np.arange(2, 5), {}, (), (), texts)
    names = ["not there", "a", "b"]
    assert [row.value for row in raw.finite(names).quarantined] == ["a = ''", "b = 'x'"]
    values = [row.value for row in raw.finite(names, may_be_blank=True).quarantined]
    assert values == ["b = '1,5' (a decimal comma)", "b = 'x'"]


def test_labels_sort_as_text_in_order_of_their_numbers():
    found = labels(np.arange(100_001))
    assert found == sorted(found)
    assert found[::100_000] == ["P000001", "P100001"]


@examples(50)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=30))
def test_commands_are_numbered_as_they_first_appear(which):
    commands = np.random.default_rng(7).uniform(-3, 3, (6, 6))
    order = list(dict.fromkeys(which))
    expected = [order.index(k) for k in which]
    assert same_commands(commands[which], 0.01).tolist() == expected


@pytest.mark.parametrize("apart_deg", [0.009, 0.011])
def test_what_is_read_back_may_scatter_by_a_hundredth_of_a_degree(apart_deg):
    q = np.array([[0.5, 1.0], [0.5 + apart_deg, 1.0], [0.5, 30.0]])
    assert same_commands(q, 0.01).tolist() == ([0, 0, 1] if apart_deg < 0.01 else [0, 1, 2])


def test_poses_along_a_slow_sweep_are_not_one_place():
    q = np.column_stack([np.arange(50) * 0.008, np.zeros(50)])
    assert same_commands(q, 0.01).tolist() == list(range(50))
