"""The fitted model that commands apply, and what the user insists on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import load_model
from pa10cal.results.health import UNRESERVED


def model_in_use(path: Path, *, force: bool) -> FittedModel:
    """Read a model, unless its calibration is not to be trusted.

    Raises:
        ModelError: when it cannot be read, or its grade needs `force`.
    """
    model = load_model(path)
    if doubtful(model) and not force:
        assert model.fitted_to is not None
        raise ModelError(
            f"a model of grade {model.grade} is not applied",
            where=f"{path}: fitted_to",
            value=model.fitted_to.health,
            allowed="good, few_poses or incomplete",
            remedy="follow the remedy in the line and calibrate again, or insist with --force",
        )
    return model


def doubtful(model: FittedModel) -> bool:
    """Return whether a model's grade is one that needs `force`."""
    return bool(model.grade) and model.grade not in UNRESERVED


def loads_of(given_N: Array, load_N: float) -> Array:
    """Return the loads of rows, that of the command where a row gives none (nan)."""
    return np.where(np.isnan(given_N), load_N, given_N)


def not_read(path: Path, columns: tuple[str, ...]) -> str:
    """Return which columns of a list are not read, for the end of a line; nothing where all are."""
    return f"; not read of {path}: {', '.join(columns)}" if columns else ""
