"""Whether a log holds as many configurations as its campaign states."""

from __future__ import annotations


def count_warnings(stated: int | None, logged: int, file: str) -> tuple[str, ...]:
    """Say how many configurations a log lacks of those stated, or has beyond them.

    Args:
        stated: configurations measured, as campaign.yaml states; None where it does not.
        logged: configurations in the file, whether they can be used or not.
        file: its name.
    """
    if stated is None or logged == stated:
        return ()
    if logged < stated:
        return (
            f"{file} has {logged} of the {stated} configurations that campaign.yaml states: "
            f"{stated - logged} are missing, and the log seems cut short",
        )
    return (
        f"{file} has {logged} configurations, and campaign.yaml states {stated}: correct that "
        "number, or remove rows of another campaign",
    )
