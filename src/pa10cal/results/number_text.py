"""Numbers in sentences: values with their 95 % intervals, probabilities and durations.

`reports.formatting` has the numbers of tables and figures.
"""

from __future__ import annotations

import math

#: From a standard uncertainty to half of a 95 % interval.
HALF_WIDTH_95 = 1.96
#: Probability from which a name is all but certain, and that the smallest set of names holds.
SURE = 0.95
#: Seconds of a minute and of an hour.
_MINUTE_S, HOUR_S = 60.0, 3600.0
#: Shorter durations are given in minutes [h].
_LEAST_HOURS = 2.0


def plain_number(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number rounded to so many significant digits, without an exponent.

    Zeros after the decimal point are left out.

    Args:
        sign: `+` where a plus sign is to be shown.
    """
    if not value or not math.isfinite(value):
        return f"{value + 0.0:{sign}g}"  # without the sign of a negative zero
    last_power = math.floor(math.log10(abs(value))) + 1 - digits
    text = f"{round(value, -last_power):{sign}.{max(-last_power, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def with_half_width_95(value: float, std: float, sign: str = "") -> str:
    """Return a value and half its 95 % interval, to the first digit of that: `13.0 ± 0.4`.

    To the second where the first is 1, which rounding would change by up to a third: `0.15 ± 0.14`.
    Where the half width is zero or not finite, it is shown as it is, and the value to three digits.

    Args:
        std: its standard uncertainty.
        sign: `+` where a plus sign is to be shown.
    """
    half = HALF_WIDTH_95 * std
    if not half > 0.0 or not math.isfinite(half):
        return f"{plain_number(value, sign=sign)} ± {half:g}"
    to_one, to_two = float(f"{half:.0e}"), f"{half:.1e}"
    last_power = math.floor(math.log10(to_one)) - (1 if to_two.startswith("1") else 0)
    decimals = max(-last_power, 0)
    shown = round(value, -last_power) + 0.0  # without the sign of a negative zero
    shown_half = round(half, -last_power)
    return f"{shown:{sign}.{decimals}f} ± {shown_half:.{decimals}f}"


def shown_probability(value: float) -> str:
    """Return a probability with two decimals: one that is not yet sure is not rounded to it."""
    rounded = f"{value:.2f}"
    return f"{SURE - 0.01:.2f}" if value < SURE <= float(rounded) else rounded


def duration_text(time_s: float) -> str:
    """Return a duration [s] with two significant digits: `30 s`, `90 min`, from 2 h on `2.5 h`."""
    if time_s < _MINUTE_S:
        return f"{plain_number(time_s, 2)} s"
    minutes = plain_number(time_s / _MINUTE_S, 2)
    if float(minutes) < _LEAST_HOURS * HOUR_S / _MINUTE_S:
        return f"{minutes} min"
    return f"{plain_number(time_s / HOUR_S, 2)} h"
