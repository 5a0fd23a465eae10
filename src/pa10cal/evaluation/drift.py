"""The parameters of one arm over campaigns, and what moved from each to the next."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from pa10cal.errors import ModelError
from pa10cal.evaluation.two_models import refuse_other_layout
from pa10cal.evaluation.what_moved import what_moved
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results import comparison as results
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import COMPARED
from pa10cal.terms.term import Term


def drift(models: Sequence[FittedModel], names: Sequence[str]) -> results.DriftRecord:
    """Return the parameters of an arm over two campaigns or more, in order of time.

    Raises:
        ModelError: when there are fewer than two, the arms differ in layout, or a covariance is not
            known.
    """
    _refuse_models(models, names)
    steps = []
    for (first, before), (second, after) in pairwise(zip(models, names, strict=True)):
        refuse_other_layout(first.arm, second.arm, (before, after))
        moved = what_moved(first, second)
        assert moved is not None
        steps.append(results.DriftStep(first=before, second=after, what_moved=moved))
    changes = [
        f"{step.first} to {step.second}: {step.what_moved.line}"
        for step in steps
        if step.what_moved.verdict != "unchanged"
    ]
    return results.DriftRecord(
        robot=models[0].arm.name,
        campaigns=tuple(names),
        parameters=_parameter_rows(models, names),
        steps=tuple(steps),
        line="; ".join(changes) or f"unchanged over {len(models)} campaigns",
    )


def _refuse_models(models: Sequence[FittedModel], names: Sequence[str]) -> None:
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


def _parameter_rows(models: Sequence[FittedModel], names: Sequence[str]) -> results.DriftRows:
    """Return the parameters of links, springs and effects of all models, with 95 % intervals.

    Without those that no pose determines: they have no uncertainty (0, or nan).
    """
    rows = [
        {
            "campaign": name,
            "term": term.id,
            "of": term.of,
            "parameter": parameter.name,
            "unit": parameter.unit,
            "value": value,
            "std": std,
            "low": value - HALF_WIDTH_95 * std,
            "high": value + HALF_WIDTH_95 * std,
        }
        for model, name in zip(models, names, strict=True)
        for term, parameter, value, std in model.every_reported()
        if std > 0.0 and len(term.parameters) <= COMPARED.most_parameters and _belongs_to_arm(term)
    ]
    return results.DriftRows.model_validate(rows)


def _belongs_to_arm(term: Term) -> bool:
    """Return whether a term is of links, springs or effects: not of a base, tool or weight."""
    return {"base", "tool", "weight"}.isdisjoint(term.roles)
