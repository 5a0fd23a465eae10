"""How many blind trials a study has, for Snakemake to divide into jobs."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from pa10cal.evaluation.options import TrialCounts

_EFFECTS = Path(__file__).parents[1] / "cell" / "effects"


def trial_counts(counts: TrialCounts) -> dict[str, int]:
    """Return the number of trials of each kind.

    Args:
        counts: as in the settings, where kinds that go through effects in turn count their rounds.
    """
    rounds = {"single": named_effects(), "outside": all_effects() - named_effects()}
    return {kind: number * rounds.get(kind, 1) for kind, number in counts}


def all_effects() -> int:
    """Return the number of effects that trials other than wild ones draw."""
    return len(_declared())


def named_effects() -> int:
    """Return the number of those in the vocabulary."""
    return sum(_declared().values())


@cache
def _declared() -> dict[str, bool]:
    """Return the ids of effects, and whether each is in the vocabulary, from the source alone.

    Importing the effects would take half a second of every start of the workflow.
    """
    found: dict[str, bool] = {}
    for path in sorted(_EFFECTS.glob("*.py")):
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
                if isinstance(stated.get("id"), str) and not stated.get("wild", False):
                    found[str(stated["id"])] = stated.get("named", True) is not False
    return found
