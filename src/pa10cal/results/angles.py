"""Which joint positions a fit has seen, and where its effects hold."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pa10cal.results.arrays import Shape
from pa10cal.results.record import Part


class AnglesSeen(Part):
    """Values of a joint that the fit has seen."""

    turns: bool = Field(description="whether the joint turns; else it slides")
    stretches: Annotated[NDArray[np.float64], Shape("stretches", 2)] = Field(
        description="intervals seen [rad; m of a sliding joint]"
    )


class FallsBack(Part):
    """Where the effects found do not hold: there the extended model is the calibrated one."""

    within: tuple[AnglesSeen, ...] = Field(
        description="values of each joint in which the effects hold; no stretches: nowhere"
    )
    why: str = Field(description="what held-out poses show, one sentence")
