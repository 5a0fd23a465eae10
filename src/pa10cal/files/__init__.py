"""Files that are written whole or not at all, and descriptions of arms."""

from __future__ import annotations

import os
from pathlib import Path

#: A folder of this name beside campaigns holds descriptions of arms, each once for all of them.
ARMS = "arms"


def own_description(name: str, folder: Path, arms: Path | None = None) -> Path | None:
    """Return the description of an arm that is not a shipped one; None where there is none.

    It is looked for in the campaign's folder, then in the folder of arms: the one given, else
    `arms` beside the campaign's folder, or beside the folder that this is a link to. The path may
    still be none of a file that can be read.
    """
    paths = [place / f"{name}.yaml" for place in arm_places(folder, arms)]
    return next((path for path in paths if os.path.lexists(path)), None)


def arm_places(folder: Path, arms: Path | None = None) -> tuple[Path, ...]:
    """Return the folders in which descriptions are looked for, in order."""
    beside = (folder.absolute().parent / ARMS, folder.resolve().parent / ARMS)
    return (folder, *(dict.fromkeys(beside) if arms is None else (arms,)))
