"""How many examples properties are tried with: fewer where slow tests are left out."""

from __future__ import annotations

from hypothesis import settings

#: The profile of hypothesis that is used then, and its examples where a test states no number.
FEW, OF_FEW = "few_examples", 30
_USUAL, _LEAST = 100, 5


def use_few() -> None:
    """From here on try a share of the examples."""
    settings.register_profile(FEW, settings.default, max_examples=OF_FEW)
    settings.load_profile(FEW)


def examples(number: int) -> settings:
    """Return settings of so many examples, or of a share of them, and without a time limit."""
    if settings.get_current_profile_name() == FEW:
        number = max(number * OF_FEW // _USUAL, min(number, _LEAST))
    return settings(max_examples=number, deadline=None)
