"""The one error a user sees: what is wrong, where, the value, what is allowed, what to do."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterable
from typing import Self

#: A longer part of a message is shortened in its middle: a file may hold anything.
_LONGEST = 2000

#: What a terminal obeys, what changes the order in which text is read or breaks its line, and what
#: is no character; tabs and ends of lines are not among them.
_UNSEEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff"
    r"\ud800-\udfff\U000e0000-\U000e007f]"
)


def visible(text: str) -> str:
    r"""Return a text with control characters and marks of direction by their numbers: `\x1b`."""
    return _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """Return a text as `visible` on one line, as in a message or a comment."""
    return visible(re.sub(r"\s*[\r\n]+\s*", " ", text))


class Pa10calError(Exception):
    """A refusal with everything the reader needs to mend its cause.

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
            _short(one_line(each)) for each in (where, what, allowed, remedy)
        )
        super().__init__(f"{where}: {what}{got}; allowed: {allowed}; {remedy}")

    def within(self, place: str) -> Self:
        """Return this refusal, and where it belongs in what was being done."""
        return type(self)(
            self.what,
            where=f"{place}: {self.where}",
            value=self.value,
            allowed=self.allowed,
            remedy=self.remedy,
        )


def _short(text: str) -> str:
    """Return a text, of one that is too long for a message both ends."""
    half = _LONGEST // 2
    return text if len(text) <= _LONGEST else f"{text[:half]} … {text[-half:]}"


def no_memory(error: MemoryError) -> str:
    """Return what is said where memory does not suffice, and what to do about it."""
    needed = f" ({_short(str(error))})" if str(error) else ""
    return (
        f"not enough memory{needed}; close other programs, use fewer cores (--cores 1) or less "
        "data, or a machine with more memory"
    )


def last_message(printed: str) -> tuple[str, str] | None:
    """Return the last message in what a command printed: who says it, and what; warnings are none.

    Args:
        printed: lines such as `pa10cal ingest: …`.
    """
    told = [line for line in printed.splitlines() if line.startswith("pa10cal")]
    told = [line for line in told if ": warning: " not in line]
    if not told:
        return None
    words, _, message = told[-1].partition(": ")
    return words, message


class SettingsError(Pa10calError):
    """The configuration cannot be used."""


class RawDataError(Pa10calError):
    """A raw file cannot be used."""


class ArmError(Pa10calError):
    """An arm description cannot be used."""


class CalibrationError(Pa10calError):
    """The data do not allow this calibration."""


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


# The word that was probably meant, where one of those known is near enough to say so.

#: Part of the letters in common from which a known word counts as meant.
LIKENESS = 0.65
_LONGEST_WORD = 200


def remedy_for(word: str, known: Iterable[str], otherwise: str) -> str:
    """Return a remedy for an unknown word: the nearest known one, or else what to do instead.

    Capitals do not count. One of the words that a known name is made of is near it too.

    Args:
        word: what was written.
        known: what could have been meant.
        otherwise: the remedy where none of them is near.
    """
    names = [name for name in known if len(name) <= _LONGEST_WORD]
    if len(word) > _LONGEST_WORD:  # nobody meant it, and to compare takes long
        return otherwise
    small = {name.casefold(): name for name in reversed(names)}
    found = difflib.get_close_matches(word.casefold(), small, n=1, cutoff=LIKENESS)
    near = [small[each] for each in found]
    near = near or [name for name in names if word in name.split("_")]
    return f"did you mean {near[0]!r}?" if near else otherwise


# Names that become folders and files: of campaigns, groups and robots.

#: As long as the shortest limit of a usual file system leaves room for an ending.
LONGEST = 100


def fits_a_folder(name: str) -> bool:
    """Return whether a name may become a file or folder, and leads nowhere else.

    It may if it is made of letters, digits, '-', '_' and '.', does not begin with '.' or '-', and
    is not longer than 100 letters.
    """
    whole = all(letter.isalnum() or letter in "-_." for letter in name)
    return 0 < len(name) <= LONGEST and whole and name[0] not in ".-"


#: The same in words.
ALLOWED = (
    f"a name of at most {LONGEST} letters, digits, '-', '_' and '.', not beginning with '.' or '-'"
)


# Packages that only some commands need, and the extra of pyproject.toml that brings each.

#: The extra that brings a package, by the name of its module.
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
    """Return what to do where one of `EXTRAS` is missing."""
    return f"pip install '.[{EXTRAS[module]}]' in the folder that pa10cal was installed from"


def missing_package(error: Exception) -> MissingPackageError | None:
    """Return the refusal that an error stands for, where it is one of `EXTRAS` that is missing."""
    module = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and module in EXTRAS:
        return MissingPackageError(module)
    return None
