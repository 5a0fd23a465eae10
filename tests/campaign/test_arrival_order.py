"""Directions of arrival that the order of poses gives."""

import numpy as np
import pandas as pd

from pa10cal.campaign.arrival_order import with_arrivals


def table(q1, q2, **columns):
    count = len(q1)
    return pd.DataFrame(
        {"time_s": np.arange(float(count)), "q1_rad": q1, "q2_m": q2}
        | {"s1": np.zeros(count, np.int8), "s2": np.zeros(count, np.int8)}
        | columns
    )


def test_a_joint_arrives_from_where_it_stood_before():
    found, from_order = with_arrivals(table([0.0, 0.5, 0.3, 0.7], [0.1, 0.0, 0.2, 0.1]))
    assert from_order
    assert found["s1"].tolist() == [0, 1, -1, 1]
    assert found["s2"].tolist() == [0, -1, 1, -1]
    assert found["s1"].dtype == np.int8


def test_one_that_stays_keeps_its_last_direction():
    found, _ = with_arrivals(table([0.0, 0.5, 0.50001, 0.5, 0.2], [0.0] * 5))
    assert found["s1"].tolist() == [0, 1, 1, 1, -1]
    assert found["s2"].tolist() == [0] * 5


def test_time_decides_whatever_the_order_of_rows():
    rows = table([0.0, 0.5, 0.3, 0.7], [0.0] * 4).iloc[[2, 0, 3, 1]]
    found, _ = with_arrivals(rows)
    assert found.sort_values("time_s")["s1"].tolist() == [0, 1, -1, 1]
    assert found.index.tolist() == rows.index.tolist()


def test_what_was_logged_is_left_alone():
    logged = table([0.0, 0.5, 0.3], [0.0] * 3, s1=np.array([0, -1, 0], np.int8))
    found, from_order = with_arrivals(logged)
    assert not from_order
    assert found is logged


def test_a_table_without_rows_stays_as_it_is():
    assert with_arrivals(table([], []))[1] is False
