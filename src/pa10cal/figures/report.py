"""What the report says of pictures: titles and captions, read only when the report is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pa10cal.figures.registry import entries

_ORIGIN = {
    "campaign": "The campaigns shipped with this project are synthetic data. The provenance of the "
    "data is stated with the picture."
}


class Captions:
    """Captions of the pictures of a folder.

    A rule's parameter that the template of captions reads. It looks the same whatever the captions
    say, so that changing one draws nothing anew.
    """

    def __init__(self, folder: str, name: str) -> None:
        """Take a folder of `registry.FOLDERS`, and the wildcard with the campaign or study."""
        self._folder, self._name = folder, name

    def __repr__(self) -> str:
        return f"captions of {self._folder}"

    def of(self, wildcards: Any) -> str:
        """Return the caption of the picture `wildcards.picture` in reStructuredText."""
        name = str(getattr(wildcards, self._name, ""))
        return caption(self._folder, wildcards.picture, name)


def caption(folder: str, picture: str, name: str) -> str:
    """Return a caption; the name is that of the campaign or study."""
    text = entries(folder)[picture].picture.caption.strip().replace("{name}", name)
    return f"{text}\n{_ORIGIN.get(folder, 'All of this is synthetic data.')}"


def titles(folder: str) -> Callable[[Any], dict[str, str]]:
    """Return the function that labels `wildcards.picture` in the report with its title."""
    return lambda wildcards: {"picture": entries(folder)[wildcards.picture].picture.title}
