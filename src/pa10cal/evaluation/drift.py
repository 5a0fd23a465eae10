"""One arm over campaigns: its parameters with intervals, and what moved from each to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pa10cal.errors import ModelError
from pa10cal.evaluation.two_models import compare_models
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results.drift import DriftRecord, DriftRows, DriftStep
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.weights import Weights

#: Terms of more parameters are curves, which a figure of their own shows.
_MOST = 24
_HALF_95 = 1.96


def drift(models: Sequence[FittedModel], names: Sequence[str]) -> DriftRecord:
    """Return the parameters of an arm over campaigns.

    Args:
        models: of two campaigns or more, in order of time, with covariances.
        names: of the campaigns.

    Raises:
        ModelError: when there are fewer than two, the arms differ in layout, or a covariance is not
            known.
    """
    _refuse(models, names)
    steps = []
    for k in range(1, len(models)):
        found = compare_models(models[k - 1], models[k], (names[k - 1], names[k]))
        assert found.what_moved is not None
        steps.append(DriftStep(first=names[k - 1], second=names[k], what_moved=found.what_moved))
    told = [
        f"{step.first} to {step.second}: {step.what_moved.line}"
        for step in steps
        if step.what_moved.verdict != "unchanged"
    ]
    return DriftRecord(
        robot=models[0].arm.name,
        campaigns=tuple(names),
        parameters=_rows(models, names),
        steps=tuple(steps),
        line="; ".join(told) or f"unchanged over {len(models)} campaigns",
    )


def _refuse(models: Sequence[FittedModel], names: Sequence[str]) -> None:
    if len(models) < 2:
        raise ModelError(
            "drift over a single model",
            where="models",
            value=len(models),
            allowed="two models or more, in order of time",
            remedy="give the models of further campaigns",
        )
    for model, name in zip(models, names, strict=True):
        if model.covariance is None:
            raise ModelError(
                "the covariance of a model is not known",
                where=name,
                allowed="models with the file of their covariance beside them",
                remedy="copy model.covariance.npz together with model.yaml, or export it again",
            )
    if len(set(names)) < len(names):
        raise ModelError(
            "two models of the same name",
            where="models",
            value=list(names),
            allowed="a name for each",
            remedy="give each campaign once",
        )


def _rows(models: Sequence[FittedModel], names: Sequence[str]) -> DriftRows:
    """Return links, springs and effects of all models, with 95 % intervals."""
    rows: list[tuple[str, str, str, str, str]] = []
    numbers: list[tuple[float, float]] = []
    for model, name in zip(models, names, strict=True):
        for term in model.model.terms:
            frame = isinstance(term, Offsets) and term.of != "links"
            if frame or isinstance(term, Weights) or len(term.parameters) > _MOST:
                continue
            report, std = model.reported(term)
            for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True):
                if sigma > 0.0:
                    rows.append((name, term.id, term.of, parameter.name, parameter.unit))
                    numbers.append((float(value), float(sigma)))
    campaign, term_id, of, parameter_name, unit = np.array(rows, dtype=str).reshape(-1, 5).T
    value, sigma = np.array(numbers).reshape(-1, 2).T
    return DriftRows(
        campaign=campaign,
        term=term_id,
        of=of,
        parameter=parameter_name,
        unit=unit,
        value=value,
        std=sigma,
        low=value - _HALF_95 * sigma,
        high=value + _HALF_95 * sigma,
    )
