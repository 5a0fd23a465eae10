"""Command `effects`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.terms.effects.effect import Effect

#: Of more parameters only the first and the last are listed.
_MOST_NAMES = 4


def effects(*, robot: str = "pa10_6ce") -> None:
    """List the effects that discovery can name at an arm, each with its formula.

    Args:
        robot: name of an arm description.

    Examples:
        pa10cal effects
        pa10cal effects --robot iiwa14
    """
    from pa10cal.files.arms import load_arm
    from pa10cal.terms.effects.family import vocabulary_of

    print("| effect | meaning | sits at | formula | parameters | expected size |")
    print("| --- | --- | --- | --- | --- | --- |")
    for places in vocabulary_of(load_arm(robot)):
        print(f"| {' | '.join(_cells(places))} |")


def _cells(places: tuple[Effect, ...]) -> tuple[str, ...]:
    """Return what the table says of an effect, by the first of its places."""
    first = places[0]
    meaning = (type(first).__doc__ or "").splitlines()[0].removesuffix(".")
    reported = first.report(first.starts[0]).parameters
    signed = first.linear if first.positive else 0
    shown = [
        f"{each.name}{' > 0' if k < signed else ''} [{each.unit}]"
        for k, each in enumerate(reported)
    ]
    if len(shown) > _MOST_NAMES:
        shown[1:-1] = ["…"]
    size = first.parameters[0]
    return (
        f"`{first.id}`",
        meaning,
        ", ".join(each.of for each in places).replace(", joint ", ", "),
        f"`{first.formula}`",
        ", ".join(shown),
        f"{size.plausible:.2g} {size.unit}".removesuffix(" 1"),
    )
