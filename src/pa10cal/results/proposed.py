"""Formulas proposed for what has no name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.accuracy import EffectParameter
from pa10cal.results.effect_name import EffectName
from pa10cal.results.record import Key, Part, optional


class ProposedEvidence(Part):
    """How blocks of poses are predicted that were left out of the fit.

    Squared errors are weighed: where repeats are the judge, a row of noise alone leaves 1.
    """

    blocks: int = Field(description="blocks of poses, each left out in turn")
    rows: int = Field(description="weighed components of all of them")
    squared_error_without: float = Field(description="their squared error with nothing instead")
    squared_error_with: float = Field(description="their squared error with the formula")
    squared_error_held: float | None = Field(
        description="their squared error with what it does as well as; null where that is noise"
    )
    gain_std: float = Field(description="standard error of `gain`")


class ProposedFormula(Part):
    """A short formula that does as well as something without a name; no effect is named by it."""

    formula: str = Field(description="the form, in words a reader can type")
    of: str = Field(description="where it sits")
    form: str = Field(description="which of the forms tried, as `harmonic` or `torque_cubed`")
    numbers: tuple[float, ...] = Field(
        description="what fixes the form besides its parameters: orders, thresholds, axes from 0"
    )
    orders: tuple[int, int] | None = optional(
        "lowest and highest order, in cycles a turn, that does as well"
    )
    parameters: Mapping[Annotated[str, Key("parameter")], EffectParameter] = Field(
        description="its parameters"
    )
    gain: float = Field(
        description="part of the squared error of blocks of poses left out that it takes away"
    )
    does_as_well_as: tuple[EffectName, ...] = Field(
        description="maps and smooth unknown functions in whose place it was tried; none where it "
        "leaves no more than noise"
    )
    others: tuple[str, ...] = Field(
        description="other formulas, none of them shorter, that do as well"
    )
    evidence: ProposedEvidence = Field(description="what decided")
