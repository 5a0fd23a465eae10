"""Shares of trials with their intervals, and figures to reach."""

from __future__ import annotations

import math

from pydantic import Field

from pa10cal.results.record import Part

#: Where no trial at all may go wrong, so many are needed as for one in a hundred.
_LEAST_ROOM, _ROUNDING = 0.01, 1e-9


class Rate(Part):
    """How many of some trials."""

    count: int = Field(description="how many")
    of: int = Field(description="out of these")
    low: float = Field(description="lower end of the share's 95 % interval (Clopper-Pearson)")
    high: float = Field(description="upper end of it")
    share: float | None = Field(description="the share; null of no trial")


class Bar(Part):
    """A figure to reach, and the one reached."""

    what: str = Field(description="the quantity")
    at_least: bool = Field(description="whether it must be at least `limit`; else at most")
    limit: float = Field(description="the figure to reach")
    reached: float | None = Field(description="the one reached; null where no trial shows it")
    low: float | None = Field(description="lower end of its 95 % interval; null if it is no share")
    high: float | None = Field(description="upper end of it")
    trials: int = Field(description="trials that show it")
    share: bool = Field(description="whether it is a share of trials")
    met: bool | None = Field(description="whether it is reached; null where no trial shows it")

    @property
    def trials_needed(self) -> int:
        """Return the fewest trials that can judge it: one among them may go wrong.

        With fewer, a single trial weighs more than the figure to reach leaves.
        """
        if not self.share:
            return 1
        room = 1.0 - self.limit if self.at_least else self.limit
        return math.ceil(1.0 / max(room, _LEAST_ROOM) - _ROUNDING)

    @property
    def verdict(self) -> str:
        """Return whether it is reached, in a word, or why that is not known."""
        if self.met is None:
            return "no trial"
        inside = self.low is None or self.high is None or self.low <= self.limit <= self.high
        if self.trials < self.trials_needed and inside:
            return f"too few to judge ({self.trials_needed} needed)"
        return "yes" if self.met else "no"
