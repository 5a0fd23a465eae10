"""Models judged on held-out poses: their names, looks, and the poses they extrapolate to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.figures.style import MODELS
from pa10cal.results.evaluation import HeldOutRows, HoldoutRecord

#: Told apart by more than their colours.
_LINES = {"geometry": "--", "cubic": "-."}
#: Wide below the others and a larger mark, so that what coincides with it is seen beside it.
_WIDE, _LARGE = {"linear": 2.2}, {"geometry": 6.0}
MARKERS = {
    "uncalibrated": "^",
    "geometry": "D",
    "linear": "s",
    "cubic": "o",
    "calibrated": "o",
    "extended": "v",
}
_NAMES = {
    "uncalibrated": "nominal, frames fitted",
    "geometry": "geometry",
    "calibrated": "calibrated",
    "linear": "geometry and springs",
    "extended": "with discovered effects",
}


@dataclass(frozen=True)
class Judged:
    """One model on held-out poses that belong together."""

    name: str  # in the record
    title: str  # as readers see it
    where: str  # `all`, or for a model that has learnt from angles `inside` those or `extrapolated`
    error_mm: Array  # (P,) position error
    angle_deg: Array | None  # (P,) orientation error, None where no attitude was seen

    @property
    def rms_mm(self) -> float:
        """Return the root mean square position error."""
        return float(np.sqrt(np.mean(self.error_mm**2)))

    @property
    def look(self) -> dict[str, Any]:
        """Return how it is drawn; what is extrapolated is dotted and hollow."""
        beyond = self.where == "extrapolated"
        return {
            "color": MODELS[self.name],
            "linestyle": ":" if beyond else _LINES.get(self.name, "-"),
            "linewidth": _WIDE.get(self.name, 1.0),
            "marker": MARKERS[self.name],
            "markersize": _LARGE.get(self.name, 4.0),
            "markerfacecolor": "white" if beyond else MODELS[self.name],
        }


def judged(held_out: HoldoutRecord) -> list[Judged]:
    """Return every model, one that has learnt from angles in two parts where it leaves them."""
    return [
        Judged(
            name,
            f"{title(name, held_out)}{part}",
            where,
            model.rows.error_mm[rows],
            None if model.rows.rotation_deg is None else _lengths(model.rows.rotation_deg[rows]),
        )
        for name, model in held_out.models.items()
        for where, part, rows in _parts(model.rows)
        if rows.any()
    ]


def title(name: str, held_out: HoldoutRecord) -> str:
    """Return a model's name; without springs there is one calibrated model."""
    if name == "linear" and "geometry" not in held_out.models:
        return _NAMES["calibrated"]
    return _NAMES.get(name, name)


def _parts(rows: HeldOutRows) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    if rows.extrapolated is None:
        yield "all", "", np.ones(len(rows), dtype=bool)
        return
    yield "inside", ", angles seen", ~rows.extrapolated
    yield "extrapolated", ", extrapolated", rows.extrapolated


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))
