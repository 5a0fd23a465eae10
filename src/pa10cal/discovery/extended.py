"""The calibrated model with the effects that were found missing."""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel


@dataclass(frozen=True, eq=False)
class Extended:
    """The model with the effects that were missing."""

    model: FittedModel
    # joint angles that its maps have learnt from; None where it has learnt nothing that stops
    # there
    seen: AnglesSeen | None = None
    # whether directions of arrival are those of the order of poses
    arrival_from_order: bool = False
    # times at which the verdict has it that instrument or base moved at once [s], the most certain
    # first
    steps_s: tuple[float, ...] = ()
