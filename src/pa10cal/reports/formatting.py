"""How numbers, parameters, effects and verdicts are written: on the page, in tables, in figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import NamedTuple

from pa10cal.results.discovery import Gap
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.number_text import HALF_WIDTH_95, plain_number
from pa10cal.results.record import EffectName
from pa10cal.terms.joint_spring import reported_name

# Numbers with units and intervals.

#: Smallest power of ten of a value that is written without an exponent.
_LEAST_POWER = -2
NOT_KNOWN = "–"
#: The unit in which values of a unit are shown, and the factor to it.
_SHOWN = {
    "m": ("mm", 1e3),
    "rad": ("mrad", 1e3),
    "m/rad": ("mm/turn", 2e3 * math.pi),
    "m/h": ("mm/h", 1e3),
    "N m/rad": ("kN m/rad", 1e-3),
    "N m/rad^3": ("MN m/rad³", 1e-6),
}
#: Larger angles are phases, and are shown in radians.
_PHASE_RAD = 0.1


def shown_in(unit: str, value: float = 0.0) -> tuple[str, float]:
    """Return the unit in which a value is shown, and the factor to it.

    Args:
        value: in that unit; without one an angle counts as small.
    """
    if unit == "rad" and abs(value) > _PHASE_RAD:
        return unit, 1.0
    return _SHOWN.get(unit, (unit, 1.0))


def mm(value: float | None) -> str:
    """Return a length in millimetres, three decimals."""
    return NOT_KNOWN if value is None else f"{value:.3f}"


def with_half_width(value: float, half: float) -> str:
    """Return a value and the half-width of its interval, rounded to two digits: `0.55 ± 0.12`.

    Both have the same decimals. A value far from one has an exponent: `(3.94 ± 0.17)e-4`.
    """
    if not (half > 0.0 and math.isfinite(half) and math.isfinite(value)):
        return f"{value:.5g} ± {half:.2g}"
    power, decimals = _power_and_decimals(value, half)
    scale = 10.0**power
    text = f"{value / scale:.{decimals}f} ± {float(f'{half:.1e}') / scale:.{decimals}f}"
    return f"({text})e{power}" if power else text


def _power_and_decimals(value: float, half: float) -> tuple[int, int]:
    """Return the exponent, 0 for none, and the decimals by which a half-width has two digits."""
    half = float(f"{half:.1e}")  # 0.0996 has the digits of 0.10
    last_power = math.floor(math.log10(half)) - 1  # power of ten of the last digit shown
    power = math.floor(math.log10(max(abs(value), half)))
    if power >= _LEAST_POWER and last_power <= 0:
        return 0, -last_power
    return power, max(power - last_power, 0)


def as_precisely(value: float, like: float, std: float) -> str:
    """Return a value with exponent and decimals of another beside its 95 % interval.

    Args:
        like, std: the other value and its standard uncertainty, which is positive.
    """
    power, decimals = _power_and_decimals(like, HALF_WIDTH_95 * std)
    text = f"{value / 10.0**power:.{decimals}f}"
    return f"{text}e{power}" if power else text


def with_interval(value: float, std: float | None) -> str:
    """Return a value and the half-width of its 95 % interval; the value alone without one."""
    if std is None or not std > 0.0:
        return f"{value:.4g}"
    return with_half_width(value, HALF_WIDTH_95 * std)


#: A stiffness that is less certain than this part of it has an interval of unequal halves.
_UNEQUAL = 0.1


def parameter_with_interval(name: str, value: float, std: float | None) -> str:
    """Return the value of a parameter with its 95 % interval, of a stiffness by its compliance.

    What is fitted is how far a joint yields, whose interval is symmetric: that of the stiffness is
    not, and has no upper end where the joint may as well be rigid.
    """
    relative_half = HALF_WIDTH_95 * (std or 0.0) / abs(value) if value else 0.0
    stiffness = name == "K" or name.startswith("K_lin")
    if not stiffness or not _UNEQUAL <= relative_half < math.inf:
        return with_interval(value, std)
    least = plain_number(value / (1.0 + relative_half), 2)
    if relative_half >= 1.0:
        return f"above {least}"
    return f"{plain_number(value)}, {least} to {plain_number(value / (1.0 - relative_half), 2)}"


def sized(name: str, parameter: EffectParameter) -> str:
    """Return a parameter of an effect with its 95 % interval and unit."""
    unit, scale = shown_in(parameter.unit, parameter.value)
    value, std = scale * parameter.value, scale * parameter.std
    text = parameter_with_interval(name, value, std)
    if unit == "1":
        return unbroken(text)
    # The unit belongs to the value and to its interval; an exponent has brackets of its own.
    has_interval = std > 0.0 and not text.startswith(("(", "above"))
    return unbroken(f"({text}) {unit}" if has_interval else f"{text} {unit}")


def floor_is(gap: Gap) -> str:
    """Return in words what the noise floor of a gap was estimated from."""
    return "unidirectional repeatability" if gap.noise_floor_from is None else "noise"


def unbroken(text: str) -> str:
    """Return a text with spaces at which no line is broken."""
    return text.replace(" ", "\u00a0")


def named(effect: EffectName) -> str:
    """Return an effect as readers see it: `friction torque at joint 2`."""
    of = effect.of.replace("_", " ")
    place = f"at {of}" if of.startswith("joint") else f"of the {of}"
    return f"{effect.id.replace('_', ' ')} {place}"


def listed(names: Iterable[str], nothing: str = "none") -> str:
    """Return texts as a list within a sentence: `a, b and c`."""
    *first, last = list(names) or [nothing]
    return f"{', '.join(first)} and {last}" if first else last


def sentence(text: str) -> str:
    """Return a text that begins with a capital and ends with a full stop or a question mark.

    A name of a column or file with which it begins stays as it is.
    """
    text = text.strip().removesuffix(".")
    if not text:
        return ""
    first = text.split(maxsplit=1)[0]
    begun = text if "_" in first else f"{text[0].upper()}{text[1:]}"
    return begun if begun.endswith("?") else f"{begun}."


#: The end of a sentence; not that of an initial, of `Fig.` in `Fig. 4`, or of a name of a file.
_SENTENCE_END = re.compile(r"(?<=[a-z\d)\]][a-z\d)\]][.;])\s+(?=[A-Z])")


def first_sentences(text: str, most: int) -> str:
    """Return the first sentence of a text, and those after it that fit into so many letters."""
    first, *others = _SENTENCE_END.split(text)
    for other in others:
        if len(first) + 1 + len(other) > most:
            break
        first = f"{first} {other}"
    return first


def count(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun."""
    return f"{number} {one if number == 1 else many or one + 's'}"


# Parameters in figures and tables: kind, joint, symbol and unit.

_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


class ParameterKind(NamedTuple):
    """Parameters of one kind, one for each joint."""

    symbol: str  # as the paper writes it; of a spring the name in results
    unit: str  # in which they are shown
    scale: float  # factor from the unit of results to the unit shown
    digits: str  # format of a value in the unit shown


#: Kinds of parameters, by the beginning of their names in results.
KINDS = {
    "delta_a": ParameterKind("δa", "mm", 1e3, ".3f"),
    "delta_alpha": ParameterKind("δα", "mrad", 1e3, ".3f"),
    "delta_d": ParameterKind("δd", "mm", 1e3, ".3f"),
    "delta_beta": ParameterKind("δβ", "mrad", 1e3, ".3f"),
    "delta_theta": ParameterKind("δθ", "mrad", 1e3, ".3f"),
    "K_lin": ParameterKind("K_lin", "kN m/rad", 1e-3, ".2f"),
    "K_cub": ParameterKind("K_cub", "MN m/rad³", 1e-6, ".1f"),
}
#: Parameters of the base frame: the instrument's origin in it, and the rotation of its axes.
_FRAME = {f"base_p_cmm_{axis}": f"p_{axis}" for axis in "xyz"}
_FRAME |= {f"gamma_{axis}": f"γ_{axis}" for axis in "xyz"}


def display_name(name: str) -> str:
    """Return a parameter's name as readers see it: `δa₂`, `K_lin_2`, `tool x`."""
    name = reported_name(name)
    key, _, joint = name.rpartition("_")
    if key in KINDS and joint.isdigit():
        symbol = KINDS[key].symbol
        return name if symbol == key else symbol + joint.translate(_SUBSCRIPTS)
    return _FRAME.get(name, name.replace("_", " "))


def display_solved(name: str) -> str:
    """Return the name of a parameter whose own value is shown, in the form in which it is solved.

    As `display_name` has it, but for springs: `windup 2`, how far it yields at a reference torque,
    where that has `K_lin_2`.
    """
    return display_name(name) if reported_name(name) == name else name.replace("_", " ")


def written_load(load: str) -> str:
    """Return a load such as `22N`, as results name it, as readers see it: `22 N`."""
    return f"{load.removesuffix('N')} N"
