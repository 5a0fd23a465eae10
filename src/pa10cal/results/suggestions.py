"""Configurations to measure next, as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from pa10cal.results.discovery import SuggestedPose


def suggestion_table(suggestions: Sequence[SuggestedPose], joints: int, *, with_sides: bool) -> str:
    """Return the configurations to measure as the text of a CSV file that a robot can read.

    Only the header where there are none.

    Args:
        suggestions: the configurations.
        joints: n, joints of the arm.
        with_sides: whether they say from which side each joint should arrive.
    """
    numbers = range(1, joints + 1)
    sides = [*(f"arrive{j}_from" for j in numbers), "separation_nats"] if with_sides else []
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["order", *(f"q{j}_deg" for j in numbers), "load_N", *sides, "for"])
    for order, pose in enumerate(suggestions, start=1):
        cells = [order, *(f"{angle:.4f}" for angle in pose.q_deg), f"{pose.load_N:g}"]
        if with_sides and pose.arrive_from is not None:
            cells += [f"{side:+.0f}" for side in pose.arrive_from]
            cells += [f"{pose.separation_nats:.2f}"]
        rows.writerow([*cells, "; ".join(pose.for_)])
    return text.getvalue()
