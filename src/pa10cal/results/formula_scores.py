"""What proposed formulas come to over many trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.record import Key, Part
from pa10cal.results.trial_bars import Bar, Rate

_NONE = Rate(count=0, of=0, low=0.0, high=1.0, share=None)


class FormulaScores(Part):
    """Formulas proposed in blind trials, against what was hidden."""

    right: Rate = Field(
        _NONE,
        description="of trials that hide what no name covers, those whose proposal is that "
        "formula: form, order and place",
    )
    right_of_nameless: Rate = Field(
        _NONE, description="of these, those in which something without a name was found"
    )
    wrong: Rate = Field(_NONE, description="of the same trials, those with another formula")
    elsewhere: Rate = Field(
        _NONE,
        description="of trials that hide nothing, or what has a name, those with a formula that is "
        "not hidden",
    )
    by_id: Mapping[Annotated[str, Key("id")], Rate] = Field(
        {}, description="`right` by what is hidden"
    )
    bars: tuple[Bar, ...] = Field((), description="figures to reach, and those reached")
