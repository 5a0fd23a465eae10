"""Numbers as messages write them: without exponents, rounded as their uncertainty says."""

from __future__ import annotations

import math

from pa10cal.results.record import HALF_WIDTH_95


def plain_number(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number of so many significant digits at most, without an exponent.

    Args:
        sign: `+` where a plus sign is to be shown.
    """
    if not value or not math.isfinite(value):
        return f"{value:{sign}g}"
    last_power = math.floor(math.log10(abs(value))) + 1 - digits
    text = f"{round(value, -last_power):{sign}.{max(-last_power, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def with_half_width_95(value: float, std: float, sign: str = "") -> str:
    """Return a value and half its 95 % interval, to the first digit of that: `13.0 ± 0.4`.

    Args:
        sign: `+` where a plus sign is to be shown.
    """
    half = HALF_WIDTH_95 * std
    if not half > 0.0 or not math.isfinite(half):
        return f"{plain_number(value, sign=sign)} ± {half:g}"
    last_power = math.floor(math.log10(float(f"{half:.0e}")))
    decimals = max(-last_power, 0)
    rounded, half = (round(each, -last_power) for each in (value, half))
    return f"{rounded:{sign}.{decimals}f} ± {half:.{decimals}f}"
