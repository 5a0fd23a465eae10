"""How many blind trials a study has, for Snakemake to divide into jobs."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from pa10cal.evaluation.options import (
    DriveCounts,
    SortedCounts,
    TrialCounts,
    UnstatedCounts,
    WildCounts,
)

_CELL = Path(__file__).parents[1] / "cell"


def trial_counts(
    counts: TrialCounts | WildCounts | DriveCounts | UnstatedCounts | SortedCounts,
) -> dict[str, int]:
    """Return the number of trials of each kind.

    Args:
        counts: as in the settings, where kinds that go through effects or disturbances in turn
            count their rounds.
    """
    return {kind: number * _rounds().get(kind, 1) for kind, number in counts}


def all_effects() -> int:
    """Return the number of effects that trials other than wild ones draw."""
    return sum(not stated.get("wild", False) for stated in _declared("effects"))


def named_effects() -> int:
    """Return the number of those in the vocabulary."""
    return sum(stated.get("named", True) is not False for stated in _declared("effects"))


def _rounds() -> dict[str, int]:
    """Return what kinds of trials go through in turn, and how many there are."""
    stressors = sum(stated.get("stressor", False) for stated in _declared("disturbances"))
    return {
        "single": named_effects(),
        "outside": all_effects() - named_effects(),
        "effect": named_effects(),
        "beyond": len(_declared("effects")) - named_effects(),
        "stressed": stressors,
        "fault": len(_declared("disturbances")) - stressors,
    }


@cache
def _declared(folder: str) -> tuple[dict[str, bool], ...]:
    """Return what the classes of a folder that trials draw state of themselves, by the source.

    Importing them would take half a second of every start of the workflow.
    """
    found = []
    for path in sorted((_CELL / folder).glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                stated = {
                    name.id: entry.value.value
                    for entry in node.body
                    if isinstance(entry, ast.Assign | ast.AnnAssign)
                    and isinstance(entry.value, ast.Constant)
                    for name in ast.walk(entry)
                    if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
                }
                if isinstance(stated.get("id"), str) and stated.get("drawn") is not False:
                    found.append({name: value is True for name, value in stated.items()})
    return tuple(found)
