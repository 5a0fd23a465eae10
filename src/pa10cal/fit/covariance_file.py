"""The covariance of a fitted model as a file beside the model's own."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted_model import FittedModel


def covariance_path(path: Path) -> Path:
    """Return the path of the covariance of the model in a file."""
    return path.with_name(f"{path.stem}.covariance.npz")


def write_covariance(model: FittedModel, path: Path) -> None:
    """Write the covariance of a model's parameters, with their names (.npz)."""
    names = [*(parameter.name for parameter in model.model.parameters), *BASE]
    covariance = np.zeros((0, 0)) if model.covariance is None else model.covariance
    with path.open("wb") as file:
        np.savez_compressed(file, names=np.array(names), covariance=covariance)


def covariance_beside(path: Path) -> Array | None:
    """Return the covariance in the file beside a model's own; None where there is none.

    Raises:
        ModelError: when there is one that cannot be read.
    """
    beside = covariance_path(path)
    if not beside.is_file():
        return None
    try:
        with np.load(beside) as stored:
            covariance: Array = stored["covariance"]
    except (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile):
        raise ModelError(
            "the covariance of the model cannot be read",
            where=str(beside),
            allowed="the file that this package wrote beside the model",
            remedy="write the model again, or remove the file to go without uncertainties",
        ) from None
    return covariance if len(covariance) else None
