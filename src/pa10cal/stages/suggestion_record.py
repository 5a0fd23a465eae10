"""Configurations to measure next, as records and as a table that a robot programme can read."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from pa10cal.discovery.blocked_cv.fill import FillingPose
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


def filling_records(poses: Sequence[FillingPose]) -> list[dict[str, Any]]:
    """Return one record a configuration that shows joint angles not seen so far."""
    return [
        {
            "q_deg": np.degrees(pose.q_rad).tolist(),
            "q_rad": pose.q_rad.tolist(),
            "load_N": pose.load_N,
            "for": [f"angle of joint {joint} not seen" for joint in pose.joints],
        }
        for pose in poses
    ]


def filling_table(poses: Sequence[FillingPose], joints: int) -> str:
    """Return these configurations as the text of a CSV file; only the header where there are none.

    Args:
        poses: the configurations.
        joints: n, joints of the arm.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["order", *(f"q{j}_deg" for j in range(1, joints + 1)), "load_N", "for"])
    for order, record in enumerate(filling_records(poses), start=1):
        angles = (f"{angle:.4f}" for angle in record["q_deg"])
        rows.writerow([order, *angles, f"{record['load_N']:g}", "; ".join(record["for"])])
    return text.getvalue()
