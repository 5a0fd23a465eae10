"""Errors as the named effects join the model one by one, as JSON."""

from __future__ import annotations

from typing import Any

from pa10cal.discovery.naming import Named


def naming_record(steps: tuple[Named, ...]) -> list[dict[str, Any]]:
    """Return the errors of each step; the effects are all those in the model by then."""
    return [
        {
            "effects": [{"id": effect.id, "of": effect.of} for effect in step.effects],
            "train": step.train.model_dump(),
            "holdout": None if step.holdout is None else step.holdout.model_dump(),
        }
        for step in steps
    ]
