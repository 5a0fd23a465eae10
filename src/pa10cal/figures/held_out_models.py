"""Models judged on held-out poses: their names, looks, and the poses they extrapolate to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.figures.records import HeldOut, HeldOutModel, HeldOutRow
from pa10cal.figures.style import MODELS

Array = NDArray[np.float64]

#: Told apart by more than their colours.
_LINES = {"geometry": "--", "cubic": "-."}
#: Wide below the others and a larger mark, so that what coincides with it is seen beside it.
_WIDE, _LARGE = {"linear": 2.2}, {"geometry": 6.0}
_MARKERS = {"uncalibrated": "^", "geometry": "D", "linear": "s", "cubic": "o", "extended": "v"}
_NAMES = {
    "uncalibrated": "nominal, frames fitted",
    "geometry": "geometry",
    "linear": "geometry and springs",
    "extended": "with what was discovered",
}


@dataclass(frozen=True)
class Judged:
    """One model on held-out poses that belong together.

    Attributes:
        name: in the record.
        title: as readers see it.
        where: `all`, or for a model that has learnt from angles `inside` those or `extrapolated`.
        error_mm: (P,) position error.
        angle_deg: (P,) orientation error, None where no attitude was seen.
    """

    name: str
    title: str
    where: str
    error_mm: Array
    angle_deg: Array | None

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
            "marker": _MARKERS[self.name],
            "markersize": _LARGE.get(self.name, 4.0),
            "markerfacecolor": "white" if beyond else MODELS[self.name],
        }


def judged(held_out: HeldOut) -> list[Judged]:
    """Return every model, one that has learnt from angles in two parts where it leaves them."""
    return [
        Judged(name, f"{title(name, held_out)}{said}", where, _errors(rows), _angles(rows))
        for name, model in held_out.models.items()
        for where, said, rows in _parts(model)
        if rows
    ]


def title(name: str, held_out: HeldOut) -> str:
    """Return a model's name; without springs the calibrated one is geometry alone."""
    if name == "linear" and "geometry" not in held_out.models:
        return _NAMES["geometry"]
    return _NAMES.get(name, name)


def _parts(model: HeldOutModel) -> Iterator[tuple[str, str, list[HeldOutRow]]]:
    if any(row.extrapolated is None for row in model.rows):
        yield "all", "", list(model.rows)
        return
    yield "inside", ", angles seen", [row for row in model.rows if not row.extrapolated]
    yield "extrapolated", ", extrapolated", [row for row in model.rows if row.extrapolated]


def _errors(rows: list[HeldOutRow]) -> Array:
    stated = [row.error_mm for row in rows]
    length = np.linalg.norm([row.position_mm for row in rows], axis=1)
    return np.array([far if own is None else own for own, far in zip(stated, length, strict=True)])


def _angles(rows: list[HeldOutRow]) -> Array | None:
    turned = [row.rotation_deg for row in rows if row.rotation_deg is not None]
    if len(turned) < len(rows):
        return None
    return np.asarray(np.linalg.norm(turned, axis=1))
