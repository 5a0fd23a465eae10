"""Fitted models read from `model.yaml`, from plain data, and from the record of a calibration.

`model_writing` writes the file and the plain data.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pa10cal.arm.chain import BASE, Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import ModelError, Pa10calError
from pa10cal.fit.covariance_file import checked_covariance, covariance_beside
from pa10cal.fit.fitted import FallBack, FittedTo, Otherwise
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_writing import SCHEMA
from pa10cal.fit.plain_arm import (
    arm_from_plain,
    finite,
    payload_from_plain,
    pose_from_plain,
    rotation_from_plain,
)
from pa10cal.fit.validity import AngleCoverage, Discrepancy
from pa10cal.observe.instrument import target_coordinates
from pa10cal.results.calibration import CalibrationRecord, Covariance
from pa10cal.terms.model import Model
from pa10cal.terms.plain import refuse_of_another_arm, term_from_plain
from pa10cal.terms.term import Term
from pa10cal.yaml_file import read_yaml


def load_model(path: str | Path) -> FittedModel:
    """Read a fitted model; without the file of its covariance it predicts without uncertainty.

    Args:
        path: model.yaml, the folder `model` that contains it, or the folder of the results.

    Raises:
        ModelError: when the file, or that of its covariance, cannot be read, is of another schema,
            or lacks a key.
        TermError: when it has a term that is not known.
    """
    given = Path(path)
    file = model_file(given)
    content = read_yaml(
        file,
        ModelError,
        what="the model cannot be read",
        allowed="a model.yaml that this package wrote",
        remedy="correct the path, or write the model again",
        within=None if file == given else given,
    )
    return model_from_plain(content, where=str(file), covariance=covariance_beside(file))


def model_file(path: Path) -> Path:
    """Return the file of a model: the path itself, or model.yaml in a folder `model` or results."""
    if not path.is_dir():
        return path
    in_folder, in_results = path / "model.yaml", path / "model" / "model.yaml"
    if not os.path.lexists(in_folder) and os.path.lexists(in_results):
        return in_results
    return in_folder


def models_of(record: CalibrationRecord, where: str) -> dict[str, FittedModel]:
    """Return the fitted models of a calibration by the names under which they are evaluated.

    Args:
        record: the content of `calibration/<load>.json`; its last model is the calibration itself.
        where: the file that it was read from, for messages.

    Raises:
        ModelError: when a model cannot be built from its record.
        TermError: when it has a term that is not known.
    """
    models = {}
    for name, fit in record.fits_by_model.items():
        of_model = f"{where}: fitted_model of {name}"
        model = model_from_plain(fit.fitted_model, where=of_model)
        covariance = _covariance_of_fit(model, fit.covariance)
        if covariance is not None:
            covariance = checked_covariance(covariance, len(covariance), of_model)
        models[name] = replace(model, covariance=covariance)
    return models


def _covariance_of_fit(model: FittedModel, recorded: Covariance) -> Array | None:
    """Return the covariance of a model's parameters, base and targets from that of its fit.

    The record has that of the fitted parameters, with or without base and targets, or of those
    reported; None where its parameters are others.
    """
    fitted = tuple(parameter.name for parameter in model.model.parameters)
    report, k = model.model.report(model.x), len(fitted)
    names = (
        *fitted,
        *(motion.replace(".", "_") for motion in BASE),
        *target_coordinates(model.target_names),
    )
    covariance = np.zeros((len(names), len(names)))
    if recorded.names[:k] == fitted:
        known = [row for row, name in enumerate(names) if name in recorded.names]
        rows = [recorded.names.index(names[row]) for row in known]
        covariance[np.ix_(known, known)] = recorded.matrix[np.ix_(rows, rows)]
    elif recorded.names == tuple(parameter.name for parameter in report.parameters):
        fitted_by_reported = np.linalg.pinv(report.jacobian)
        covariance[:k, :k] = fitted_by_reported @ recorded.matrix @ fitted_by_reported.T
    else:
        return None
    return covariance


def model_from_plain(
    content: object, *, where: str, covariance: Array | None = None
) -> FittedModel:
    """Return the model that `model_to_plain` described.

    Args:
        where: the file, and the key in it, that holds the model, for messages.
        covariance: of its parameters, the base and the targets, or None; see `Fitted`. One of an
            older file, without the targets, says nothing of how uncertain these are.

    Raises:
        ModelError: naming the schema, or the key that is missing or cannot be used.
        TermError: when it has a term that is not known.
    """
    schema = content.get("schema") if isinstance(content, Mapping) else None
    if not isinstance(content, Mapping) or schema != SCHEMA:
        raise ModelError(
            "not a model of this version",
            where=f"{where}: schema",
            value=schema,
            allowed=SCHEMA,
            remedy="export the model again",
        )
    with _unfit_content_refused(where):
        # Older files have none of the keys that are looked up by `get`.
        field = content.get("field")
        terms_plain = [*content["terms"], *([] if field is None else [field])]
        if covariance is not None:
            size = sum(len(term["x"]) for term in terms_plain) + len(BASE)
            covariance = checked_covariance(covariance, size, where, 3 * len(content["targets_m"]))
        terms = [
            _term_from_plain(entry, f"{where}: terms[{k}]") for k, entry in enumerate(terms_plain)
        ]
        arm = arm_from_plain(content["arm"])
        chain = Chain.of(arm, bends=tuple(content["arm"]["bends"]))
        model = Model(chain, tuple(each.term for each in terms))
        refuse_of_another_arm(model.terms, chain, where)
        tool, targets = content["tool"], content["targets_m"]
        fitted, payload, seen = content["fitted_to"], content["payload"], content["seen"]
        lacks = content.get("discrepancy")
        return FittedModel(
            model=model,
            x=np.concatenate([np.zeros(0), *(each.x for each in terms)]),
            T_instr_base=pose_from_plain(content["T_instr_base"], "T_instr_base"),
            R_ee_target=rotation_from_plain(tool["R_ee_target"], "R_ee_target"),
            R_first_target_of={
                campaign: rotation_from_plain(R, f"R_first_target_of.{campaign}")
                for campaign, R in tool.get("R_first_target_of", {}).items()
            },
            targets_m=np.concatenate(
                [np.zeros(0), *(finite(p, name, 3) for name, p in targets.items())]
            ),
            target_names=tuple(targets),
            targets_off_m=finite(content["targets_off_m"], "targets_off_m"),
            T_end_shown=pose_from_plain(tool.get("T_end_shown", np.eye(4).tolist()), "T_end_shown"),
            covariance=covariance,
            payload=None if payload is None else payload_from_plain(payload),
            fitted_to=None if fitted is None else FittedTo.model_validate(fitted),
            seen=None if seen is None else AngleCoverage.from_plain(seen, arm.n),
            discrepancy=None if lacks is None else Discrepancy.from_plain(lacks, arm.n),
            falls_back=_fall_back_from_plain(content.get("falls_back"), arm, where),
            otherwise=_otherwise_from_plain(content.get("otherwise"), arm, where),
        )


@contextmanager
def _unfit_content_refused(where: str) -> Iterator[None]:
    """Refuse content of which a model cannot be built, for a key or a value.

    Raises:
        ModelError: for what constructors and look-ups in the block raise.
    """
    try:
        yield
    except Pa10calError:
        raise
    except KeyError as error:
        raise ModelError(
            f"key {error.args[0]} is missing",
            where=where,
            allowed=f"every key of {SCHEMA}",
            remedy="export the model again",
        ) from None
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise ModelError(
            "the model cannot be built from the file",
            where=where,
            value=str(error),
            allowed=f"values as {SCHEMA} has them",
            remedy="export the model again",
        ) from None


@dataclass(frozen=True, eq=False)
class _FittedTerm:
    """A term with its fitted parameters."""

    term: Term
    x: Array  # (c,) values of its parameters


def _term_from_plain(content: Mapping[str, Any], where: str) -> _FittedTerm:
    """Return a term and its parameters.

    Raises:
        ModelError: when it was fitted by another formula than this version computes, or has not the
            term's number of parameters.
        TermError: when the term is not known.
    """
    term = term_from_plain(content, where=where)
    if content.get("formula", term.formula) != term.formula:
        raise ModelError(
            "a term by another formula than this version computes",
            where=f"{where}: formula",
            value=content["formula"],
            allowed=term.formula,
            remedy="calibrate the campaign again; a lost motion b of a model of before counted "
            "the other way",
        )
    x = np.array(content["x"], dtype=float)
    if x.shape != (len(term.parameters),) or not np.isfinite(x).all():
        raise ModelError(
            "values that do not fit the term's parameters",
            where=f"{where}: x",
            value=content["x"],
            allowed=f"{len(term.parameters)} finite numbers",
            remedy="write the model again",
        )
    return _FittedTerm(term, x)


def _fall_back_from_plain(content: Any, arm: Arm, where: str) -> FallBack | None:
    """Return what a model of an arm falls back to; None where there is nothing."""
    if content is None:
        return None
    within = AngleCoverage.from_plain(content["within"], arm.n)
    return FallBack(within, _model_of_same_arm(content["model"], arm, f"{where}: falls_back.model"))


def _otherwise_from_plain(content: Any, arm: Arm, where: str) -> Otherwise | None:
    """Return the model under another explanation, and its probability; None where there is none."""
    if content is None:
        return None
    probability = float(content["probability"])
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"otherwise.probability is {probability}, and not from 0 to 1")
    return Otherwise(
        _model_of_same_arm(content["model"], arm, f"{where}: otherwise.model"), probability
    )


def _model_of_same_arm(content: Any, arm: Arm, where: str) -> FittedModel:
    """Return a model within another one; refuse one of an arm with another number of joints."""
    model = model_from_plain(content, where=where)
    if model.arm.n != arm.n:
        raise ValueError(f"{where} is of {model.arm.n} joints, and the model of {arm.n}")
    return model
