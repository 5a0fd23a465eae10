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
        std: its standard uncertainty.
        sign: `+` where a plus sign is to be shown.
    """
    half = HALF_WIDTH_95 * std
    if not half > 0.0 or not math.isfinite(half):
        return f"{plain_number(value, sign=sign)} ± {half:g}"
    last_power = math.floor(math.log10(float(f"{half:.0e}")))
    decimals = max(-last_power, 0)
    rounded, half = (round(each, -last_power) for each in (value, half))
    return f"{rounded:{sign}.{decimals}f} ± {half:.{decimals}f}"


def shown_probability(value: float) -> str:
    """Return a probability with two decimals: one that is not yet sure is not rounded to it."""
    rounded = f"{value:.2f}"
    return f"{SURE - 0.01:.2f}" if value < SURE <= float(rounded) else rounded


def duration_text(time_s: float, hours_from_s: float = 2.0 * HOUR_S) -> str:
    """Return a duration in minutes or in hours, with two significant digits: `12 min`, `2.5 h`.

    Args:
        time_s: the duration [s].
        hours_from_s: shortest duration that is given in hours [s].
    """
    if time_s < hours_from_s:
        return f"{plain_number(time_s / _MINUTE_S, 2)} min"
    return f"{plain_number(time_s / HOUR_S, 2)} h"
