"""Configurations to measure next, as records and as a table that a robot programme can read."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from pa10cal.discovery.suggest import Separation, Suggestion


def suggestion_records(suggestions: Sequence[Suggestion]) -> list[dict[str, Any]]:
    """Return one record a configuration, the most telling first.

    `arrive_from` is, joint by joint, the side from which to approach: -1 from smaller angles, +1
    from larger ones. `separation_nats` counts all configurations up to this one.
    """
    return [
        {
            "q_deg": np.degrees(suggestion.q_rad).tolist(),
            "q_rad": suggestion.q_rad.tolist(),
            "load_N": suggestion.load_N,
            "arrive_from": (-suggestion.arrival).tolist(),
            "separation_nats": suggestion.separation_nats,
            "for": list(suggestion.for_effects),
        }
        for suggestion in suggestions
    ]


def separation_records(separations: Sequence[Separation]) -> list[dict[str, Any]]:
    """Return one record a pair that the data so far cannot tell apart."""
    return [
        {
            "pair": separation.label,
            "before_nats": separation.before_nats,
            "after_nats": separation.after_nats,
            "possible_nats": separation.possible_nats,
            "can_be_split": separation.can_be_split,
        }
        for separation in separations
    ]


def suggestion_table(suggestions: Sequence[Suggestion], joints: int) -> str:
    """Return the configurations as the text of a CSV file; only the header where there are none.

    Args:
        suggestions: the configurations.
        joints: n, joints of the arm.
    """
    numbers = range(1, joints + 1)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    angles, sides = [f"q{j}_deg" for j in numbers], [f"arrive{j}_from" for j in numbers]
    rows.writerow(["order", *angles, "load_N", *sides, "separation_nats", "for"])
    for order, record in enumerate(suggestion_records(suggestions), start=1):
        rows.writerow(
            [
                order,
                *(f"{angle:.4f}" for angle in record["q_deg"]),
                f"{record['load_N']:g}",
                *(f"{side:+.0f}" for side in record["arrive_from"]),
                f"{record['separation_nats']:.2f}",
                "; ".join(record["for"]),
            ]
        )
    return text.getvalue()
