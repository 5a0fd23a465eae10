"""Refusals that a user sees, and what their words need: visible text, near words, names, extras.

A refusal says what is wrong, where, the value, what is allowed, and what to do.
"""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterable
from typing import Self

#: Longer parts of a message are shortened in their middle [letters]: a file may hold anything.
_LONGEST_MESSAGE = 2000

#: Control characters, marks that change the direction of text or break its line, and code points
#: that are no characters; without tabs and ends of lines.
_UNSEEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff"
    r"\ud800-\udfff\U000e0000-\U000e007f]"
)


def visible(text: str) -> str:
    r"""Return a text with control characters and marks of direction by their numbers: `\x1b`."""
    return _UNSEEN.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """Return a text on one line, with what `visible` shows, for a message or a comment."""
    return visible(re.sub(r"\s*[\r\n]+\s*", " ", text))


class Pa10calError(Exception):
    """A refusal, with everything that a reader needs to remove its cause.

    Attributes:
        what: what is wrong, one clause.
        where: file and line, or configuration key, or parameter name.
        value: the offending value, where there is one.
        allowed: what would have been accepted.
        remedy: what to do about it.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str,
        allowed: str,
        remedy: str,
        value: object | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.value = value
        self.allowed = allowed
        self.remedy = remedy
        got = "" if value is None else f" (got {_short(visible(repr(value)))})"
        where, what, allowed, remedy = (
            _short(one_line(part)) for part in (where, what, allowed, remedy)
        )
        super().__init__(f"{where}: {what}{got}; allowed: {allowed}; {remedy}")

    def within(self, place: str) -> Self:
        """Return this refusal with a place in front of where it is."""
        return type(self)(
            self.what,
            where=f"{place}: {self.where}",
            value=self.value,
            allowed=self.allowed,
            remedy=self.remedy,
        )


def _short(text: str) -> str:
    """Return a text, or if it is too long for a message its beginning and end."""
    half = _LONGEST_MESSAGE // 2
    return text if len(text) <= _LONGEST_MESSAGE else f"{text[:half]} … {text[-half:]}"


def no_memory(error: MemoryError) -> str:
    """Return the message for memory that does not suffice, with what to do about it."""
    needed = f" ({_short(str(error))})" if str(error) else ""
    return (
        f"not enough memory{needed}; close other programs, use fewer cores (--cores 1) or less "
        "data, or a machine with more memory"
    )


def last_message(printed: str) -> tuple[str, str] | None:
    """Return the last message in what a command printed, but no warning: command and message.

    Args:
        printed: lines such as `pa10cal ingest: …`.
    """
    for line in reversed(printed.splitlines()):
        if line.startswith("pa10cal") and ": warning: " not in line:
            command, _, message = line.partition(": ")
            return command, message
    return None


class SettingsError(Pa10calError):
    """The configuration cannot be used."""


class RawDataError(Pa10calError):
    """A raw file cannot be used."""


class ArmError(Pa10calError):
    """An arm description cannot be used."""


class CalibrationError(Pa10calError):
    """The data do not allow this calibration."""


class TooFewPosesError(CalibrationError):
    """There are fewer poses than this calibration needs; a fit of more poses may be possible."""


class TermError(Pa10calError):
    """A term of a model cannot be made of what a file says of it."""


class ModelError(Pa10calError):
    """A fitted model cannot be read, or cannot predict what is requested."""


class SimulationError(Pa10calError):
    """The virtual cell cannot make this campaign."""


class OutputError(Pa10calError):
    """A result cannot be written where it was requested."""


class RecordError(Pa10calError):
    """A result of an earlier stage cannot be used."""


class DiscoveryError(Pa10calError):
    """The data do not allow a search for missing effects."""


class CurveError(Pa10calError):
    """A curve cannot be made into links, or no roll keeps their joints within limits."""


# The word that was probably meant, if one of those known is near enough.

#: Ratio of letters in common from which a known word counts as meant (`difflib`).
_LIKENESS = 0.65
#: Longer words are not compared [letters]: nobody meant them, and it takes long.
_LONGEST_WORD = 200


def remedy_for(word: str, known: Iterable[str], otherwise: str) -> str:
    """Return a remedy for an unknown word: the nearest known one, or else what to do instead.

    Capitals do not count. A part of a known name, as `_` divides it, is near to it too.

    Args:
        word: what was written.
        known: what could have been meant.
        otherwise: the remedy where none of them is near.
    """
    if len(word) > _LONGEST_WORD:
        return otherwise
    names = [name for name in known if len(name) <= _LONGEST_WORD]
    by_folded = {name.casefold(): name for name in reversed(names)}
    close = difflib.get_close_matches(word.casefold(), by_folded, n=1, cutoff=_LIKENESS)
    near = [by_folded[folded] for folded in close]
    near = near or [name for name in names if word in name.split("_")]
    return f"did you mean {near[0]!r}?" if near else otherwise


# Names that become folders and files: of campaigns, groups and robots.

#: Longest name [letters]; with it the shortest limit of a usual file system has room for an ending.
LONGEST_NAME = 100


def fits_a_folder(name: str) -> bool:
    """Return whether a name may become a file or folder, as `NAME_RULE` describes."""
    allowed = all(letter.isalnum() or letter in "-_." for letter in name)
    return 0 < len(name) <= LONGEST_NAME and allowed and name[0] not in ".-"


#: Names of files and folders, in words.
NAME_RULE = (
    f"a name of at most {LONGEST_NAME} letters, digits, '-', '_' and '.', not beginning with '.' "
    "or '-'"
)


# Packages that only some commands need.

#: The extra of pyproject.toml that brings a package, by the name of its module.
EXTRAS = {
    "matplotlib": "figures",
    "jinja2": "report",
    "plotly": "report",
    "snakemake": "workflow",
    "snakemake_executor_plugin_slurm": "slurm",
    "pinocchio": "urdf",
    "python_calamine": "workbooks",
    "ezc3d": "c3d",
    "rosbags": "bags",
    "robot_descriptions": "arms",
    "xacrodoc": "arms",
}


class MissingPackageError(Pa10calError):
    """A command needs a package that comes with an extra, and it is not installed."""

    def __init__(self, module: str) -> None:
        super().__init__(
            f"the package {module} is not installed",
            where="the Python environment",
            value=sys.prefix,
            allowed=f"pa10cal installed with its extra `{EXTRAS[module]}`",
            remedy=how_to_install(module),
        )


def how_to_install(module: str) -> str:
    """Return how to install one of `EXTRAS`."""
    return f"pip install '.[{EXTRAS[module]}]' in the folder that pa10cal was installed from"


def missing_package(error: Exception) -> MissingPackageError | None:
    """Return the refusal for an error that says that one of `EXTRAS` is missing; else None."""
    module = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and module in EXTRAS:
        return MissingPackageError(module)
    return None
