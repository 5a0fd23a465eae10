"""The kinds of fault of a log: words that verdicts, records and terms share."""

from __future__ import annotations

from typing import Literal

#: What is wrong in a log; `docs/results.md` lists the word, `docs/discovery.md` says what it means.
FaultKind = Literal[
    "label",
    "load",
    "direction",
    "joint_zero",
    "joint_sign",
    "payload",
    "step_in_time",
    "outlier",
]
