"""How much of the error beyond noise the effects found explain, and formulas proposed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.record import EffectName, Key, Part, optional

# Formulas proposed for what has no name.


class ProposedEvidence(Part):
    """How blocks of poses are predicted that were left out of the fit.

    Squared errors are weighed: where repeats are the judge, a row of noise alone leaves 1.
    """

    blocks: int  # blocks of poses, each left out in turn
    rows: int  # weighed components of all of them
    squared_error_without: float  # their squared error with nothing instead
    squared_error_with: float  # their squared error with the formula
    # their squared error with what it does as well as; null where that is noise
    squared_error_held: float | None
    gain_std: float  # standard error of `gain`


class ProposedFormula(Part):
    """A short formula that does as well as something without a name; no effect is named by it."""

    formula: str  # the form, in words a reader can type
    of: str  # where it sits
    form: str  # which of the forms tried, as `harmonic` or `torque_cubed`
    # what fixes the form besides its parameters: orders, thresholds, axes from 0
    numbers: tuple[float, ...]
    # lowest and highest order, in cycles a turn, that does as well
    orders: tuple[int, int] | None = optional()
    parameters: Mapping[Annotated[str, Key("parameter")], EffectParameter]  # its parameters
    gain: float  # part of the squared error of blocks of poses left out that it takes away
    # maps and smooth unknown functions in whose place it was tried; none where it leaves no more
    # than noise
    does_as_well_as: tuple[EffectName, ...]
    others: tuple[str, ...]  # other formulas, none of them shorter, that do as well
    evidence: ProposedEvidence  # what decided


class ExplainedEffect(Part):
    """What one effect takes away of the error."""

    ids: tuple[str, ...]  # id of the effect, then of its alternatives at the same place
    of: str  # where it sits: `joint 2`, `forearm`, `base`, ...
    # alternatives at other places; not given where there is none
    elsewhere: tuple[EffectName, ...] = Field(default=(), exclude_if=lambda value: not value)
    # `assumed` where its size is known relative to weights that nobody stated
    weights: Literal["assumed"] | None = optional()
    # of what is predicted without a name: part of its variance that goes with each joint, by number
    joints: Mapping[Annotated[str, Key("joint")], float] | None = optional()
    # that it is there, among all that was tried in its place; not given of what has no name
    probability: float | None = optional()
    # of its alternatives: the other `ids`, then those elsewhere
    others_probability: tuple[float, ...] = Field(default=(), exclude_if=lambda value: not value)
    share: float  # part of the variance of the error beyond noise that it takes away, 0 to 1
    before_mm: float  # root mean square error without it alone, all else fitted again [mm]
    after_mm: float  # root mean square error with all effects [mm]


class Explained(Part):
    """How much of the error beyond noise is explained, and by what."""

    # part of the variance of the position error beyond noise that the model loses by the effects, 0
    # to 1
    share: float
    # what each effect takes away, the largest share first; shares sum to `share`
    of: tuple[ExplainedEffect, ...]
    without_a_name: float  # part that remains, 1 less `share`
    # poses that it is counted over: held out, where any were
    over: Literal["held-out poses", "fitted poses"]
    before_mm: float  # root mean square error of the model without them [mm]
    after_mm: float  # root mean square error of the model with all of them [mm]
    noise_mm: float  # root mean square error that noise alone would leave [mm]
