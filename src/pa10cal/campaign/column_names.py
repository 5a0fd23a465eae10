"""What the name of a column says: its unit, its words, and the factor of an uncertainty.

Words are English, German, French and Spanish; `words.yaml` has them all.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from pa10cal.errors import RawDataError
from pa10cal.yaml_file import read_yaml

#: Words of units and of names, by their meaning; see the file.
WORDS = read_yaml(Path(__file__).with_name("words.yaml"), RawDataError, what="it cannot be read")
#: Words of names by what they say of a column, in small letters without accents.
VOCABULARY = {
    kind: frozenset(words.split()) for kind, words in (WORDS["words"] | WORDS["single"]).items()
}
#: Longer names have no unit, and longer words are no dates: regular expressions would take long.
MOST_LETTERS = 200

_SPELLED: dict[str, str] = {
    spelled: unit for unit, words in WORDS["units"].items() for spelled in words.split()
}
_SAID_BY_UNIT = {
    unit: kind for kind, units in WORDS["said by units"].items() for unit in units.split()
}
_BRACKETED = re.compile(r"^(?P<bare>.*?)\s*[\[({<]\s*(?P<unit>[^\[\](){}<>]{1,14}?)\s*[\])}>]\s*$")
_APART = re.compile(r"^(?P<bare>.+?)(?:\s+in\s+|[\s_/,;:-]+)(?P<unit>[^\s_/,;:-]{1,12})$")
_SIGN = re.compile(r"^(?P<bare>.*?)\s*(?P<unit>°[CF]?)$")
#: A unit over one of time, as in deg/s and [m/s²]; of Time/s and J1/s the first is no unit.
_RATE = re.compile(r"(?P<unit>[^\W\d_]+|°)\s*/\s*(?:s|sec|min)\W*[2²]?\W*$", re.IGNORECASE)
#: A letter that stands alone at the end without brackets, which may be a unit, as in x_c.
_LONE_LETTER = re.compile(r"[\s_/,;:-][A-Za-z]$")
_GREEK = {
    **{"α": "alpha", "β": "beta", "γ": "gamma", "θ": "theta", "φ": "phi", "ϕ": "phi"},
    **{"ψ": "psi", "σ": "sigma", "ω": "omega", "τ": "tau"},
    **dict.fromkeys("δ∆", "delta "),  # a word of its own: ΔX is a difference of x
}
#: Kinds of words that a number may follow without a sign, as in tau1.
_NUMBERED_KINDS = ("torque", "no position", "deviation")
#: The same of words of two letters and more, as in rot1: R1 is a reflector.
_TURNED_KINDS = (
    *("rotation", "vector", "quaternion", "rotation vector", "translation", "orientation"),
)
#: Vectors of a camera's pose, in one word or two: rvec, r_vec, rotation vector; tvecs.
_VECTOR = re.compile(
    r"(?<![a-z\d])([rt])(?:ot(?:ation)?|rans(?:lation)?)?[\s_.-]*vec(?:tor)?s?(?![a-z])"
)
#: Other words before the seconds of a stamp.
_OF_STAMPS = ("header", "tv")
#: Encodings that are mistaken for each other.
_ENCODINGS = ("utf-8", "cp1252", "cp850", "mac_roman")
_LEVELS: dict[str, float] = WORDS["coverage"]
_LEVEL = "|".join(map(re.escape, sorted(_LEVELS, key=len, reverse=True)))
#: The factor of an uncertainty in a name, the surest first: k = 3; 2 sigma; U95, 95 %; expanded.
_COVERAGE = (
    re.compile(r"\bk\s*=\s*(?P<factor>\d+(?:[.,]\d+)?)"),
    re.compile(r"(?<![\d.,])(?P<factor>[1-4])\s*-?sigma(?=[xyz]?\b)"),
    re.compile(rf"\bu\W*(?:0\.)?(?P<level>{_LEVEL})(?=[xyz]?\b)\W*|\b(?P<percent>{_LEVEL})\s*%"),
    re.compile(r"\b(?:expanded|erweiterte|elargie|expandida)\b"),
)


# Units.


def canonical_unit(text: str) -> str:
    """Return the unit as campaign.yaml writes it for a unit as files write it; empty for none."""
    bare = plain(text).replace(" ", "")
    return _SPELLED.get(bare, "")


def unit_alone(field: str) -> str:
    """Return a unit that stands alone in a field, without its brackets."""
    return field.strip(" \t[](){}<>/")


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit; empty where there is none."""
    if len(name) > MOST_LETTERS or _is_rate(name):
        return name.strip(), ""
    for like in (_BRACKETED, _SIGN, _APART):
        found = like.match(name.strip())
        if found is not None and (unit := canonical_unit(found["unit"])):
            if like is _APART and unit == "min" and not has_part_of(found["bare"], "time"):
                break  # the least of x
            return found["bare"].strip(" _/,;:-"), unit
    return name.strip(), ""


def unit_of(name: str) -> str:
    """Return the unit that stands in a name; empty where there is none."""
    return split_unit(name)[1]


def _is_rate(name: str) -> bool:
    """Return whether the unit of a name is one over time."""
    found = _RATE.search(name[:MOST_LETTERS])
    return found is not None and bool(canonical_unit(found["unit"]))


def apart_by_letters(names: Sequence[str]) -> tuple[str, ...]:
    """Return names in which a letter that tells columns apart is read as no unit.

    tcp_C beside tcp_A and tcp_B becomes tcp_C_; of the letters of two others at least none is one.
    """
    others: dict[str, int] = {}
    for name in names:
        if name[-1:].isalpha() and not name[-2:-1].isalnum() and not canonical_unit(name[-1]):
            others[name[:-1]] = others.get(name[:-1], 0) + 1
    marked = [
        f"{name}_" if others.get(name[:-1], 0) >= 2 and canonical_unit(name[-1]) else name
        for name in names
    ]
    return tuple(m if m not in names else name for m, name in zip(marked, names, strict=True))


# Words.


def plain(text: str) -> str:
    """Return a text in lower case without accents; Greek letters and micro signs are spelled."""
    spelled = "".join(_GREEK.get(letter, letter) for letter in text.lower())
    spelled = spelled.replace("μ", "u").replace("µ", "u").replace("ß", "ss")
    apart = unicodedata.normalize("NFKD", spelled)
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


@lru_cache(maxsize=4096)
def words_of_name(name: str) -> tuple[str, ...]:
    """Return the words of a name without its unit, parted at signs and camel case."""
    if len(name) > MOST_LETTERS:
        return ()
    bare = re.sub(r"(?<=[a-zäöüéèí])(?=[A-Z])", " ", split_unit(name)[0])
    return tuple(re.findall(r"[a-z]+\d*|\d+", _VECTOR.sub(r"\1vec", plain(bare))))


def has_word(words: Sequence[str], *kinds: str) -> bool:
    """Return whether one of the words is of one of these kinds of `WORDS`."""
    bare = [word.rstrip("0123456789") for word in words]
    turned = [*words, *(word for word in bare if len(word) > 1)]
    return any(
        not VOCABULARY[kind].isdisjoint(
            bare if kind in _NUMBERED_KINDS else turned if kind in _TURNED_KINDS else words
        )
        for kind in kinds
    )


def has_part_of(name: str, kind: str) -> bool:
    """Return whether a word of a name is one of a kind, or has a longer one of it as a part."""
    words = words_of_name(name)
    parts = [word for word in VOCABULARY[kind] if len(word) > 3]
    return has_word(words, kind) or any(part in word for word in words for part in parts)


def is_of(name: str, *kinds: str) -> bool:
    """Return whether a word of a name is of one of these kinds, or its unit says so."""
    return has_word(words_of_name(name), *kinds) or said_by_unit(name) in kinds


def said_by_unit(name: str) -> str:
    """Return what the unit of a column says of it, as a kind of words; empty for nothing.

    J1 [Nm] is a torque, and x [m/s] no position. A letter without brackets may be no unit.
    """
    if _is_rate(name):
        return "no position"
    return "" if _LONE_LETTER.search(name) else _SAID_BY_UNIT.get(unit_of(name), "")


def parts_of_stamps(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the stamps in two columns, seconds and the part of a second, as ROS has them.

    Their names differ only by a last word, such as secs and nsecs, sec and nanosec.
    """
    by_unit: dict[str, dict[str, str]] = {}
    for name in names:
        bare = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name[:MOST_LETTERS]).rstrip(")]} ")
        found = re.fullmatch(r"(?P<rest>.*?)[\W_]*(?P<unit>[a-z]+)", plain(bare))
        rest = () if found is None else words_of_name(found["rest"])
        if found is not None and (not rest or has_word(rest, "time") or rest[-1] in _OF_STAMPS):
            by_unit.setdefault(canonical_unit(found["unit"]), {})[found["rest"]] = name
    return [
        (seconds, by_unit[part][rest])
        for rest, seconds in by_unit.get("s", {}).items()
        for part in ("ns", "us", "ms")
        if rest in by_unit.get(part, {})
    ]


def mistaken_encoding(name: str, names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return which of `names` is a name read in a wrong encoding, if any.

    With it come the encoding that was taken to read `name`, and the right one.
    """
    for taken in _ENCODINGS:
        for right in _ENCODINGS:
            try:
                other = name.encode(taken).decode(right)
            except UnicodeError:
                continue
            if other != name and other in names:
                return other, taken, right
    return None


# Uncertainties.


def stated_coverage(name: str) -> float | None:
    """Return the coverage factor that the name of an uncertainty states; None if it does not.

    It is that of its level of confidence, or 2 of one that is called expanded, where it has no k.
    """
    text = _for_coverage(name)
    for pattern in _COVERAGE:
        if (found := pattern.search(text)) is None:
            continue
        stated = found.groupdict()
        if stated.get("factor"):
            factor = float(stated["factor"].replace(",", "."))
            if factor > 0.0:
                return factor
        elif level := stated.get("level") or stated.get("percent"):
            return _LEVELS[level]
        else:
            return _LEVELS["95"]
    return None


def coverage_of(name: str) -> float:
    """Return the coverage factor of a column of uncertainties; 1 for standard uncertainties."""
    return stated_coverage(name) or 1.0


def without_coverage(name: str) -> str:
    """Return the name of an uncertainty with `u` in place of what states its coverage."""
    text = _for_coverage(split_unit(name)[0])
    for pattern in _COVERAGE:
        text = pattern.sub(" u ", text)
    return text


def _for_coverage(name: str) -> str:
    return plain(name[:MOST_LETTERS]).replace("_", " ")
