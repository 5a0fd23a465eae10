"""A fitted model written as plain data, and as `model.yaml` with its covariance beside it.

`model_reading` reads both back.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pa10cal.files.output import whole_files
from pa10cal.fit.covariance_file import covariance_path, write_covariance
from pa10cal.fit.fitted import FLANGE, Fitted
from pa10cal.fit.forward import T_flange_frame
from pa10cal.fit.plain_arm import arm_to_plain, payload_to_plain, plain_value
from pa10cal.terms.field import Field
from pa10cal.terms.plain import term_to_plain
from pa10cal.terms.term import Term

#: Name and version of the format.
SCHEMA = "pa10cal-model/2"
#: Most characters of a line of YAML (format).
_LINE_WIDTH = 120


def save_model(model: Fitted, path: Path, **about: Any) -> None:
    """Write a fitted model, and its covariance beside it, whole or not at all.

    Args:
        path: `….yaml`; the covariance is written to `….covariance.npz`.
        about: further keys for people, such as warnings; they are not read back.

    Raises:
        OutputError: when it cannot be written there.
    """
    content = model_to_plain(model, **about)
    beside = [] if model.covariance is None else [covariance_path(path)]
    content["covariance"] = beside[0].name if beside else None
    text = yaml.dump(
        content, Dumper=_YamlWriter, sort_keys=False, allow_unicode=True, width=_LINE_WIDTH
    )
    with whole_files(*beside, path) as (*written_beside, written):
        for covariance in written_beside:
            write_covariance(model, covariance)
        written.write_text(text, encoding="utf-8", newline="\n")


def model_to_plain(model: Fitted, **about: Any) -> dict[str, Any]:
    """Return a fitted model as numbers, texts, lists and mappings, without its covariance.

    Args:
        about: see `save_model`.
    """
    return {
        "schema": SCHEMA,
        "robot": model.arm.name,
        "grade": model.grade or None,
        "fitted_to": None if model.fitted_to is None else model.fitted_to.model_dump(mode="json"),
        **about,
        "arm": arm_to_plain(model.arm, model.model.chain.bends),
        **_terms_to_plain(model),
        "payload": None if model.payload is None else payload_to_plain(model.payload),
        **_frames_to_plain(model),
        **_validity_to_plain(model),
        "covariance": None,  # the name of its file, in a file of its own
    }


def _terms_to_plain(model: Fitted) -> dict[str, Any]:
    """Return the keys of the terms; a field, a displacement without a name, has one of its own."""
    entries = [_term_to_plain(model, term) for term in model.model.terms]
    is_field = [term.id == Field.id for term in model.model.terms]
    of_field = (entry for entry, field in zip(entries, is_field, strict=True) if field)
    return {
        "terms": [entry for entry, field in zip(entries, is_field, strict=True) if not field],
        "field": next(of_field, None),
    }


def _frames_to_plain(model: Fitted) -> dict[str, Any]:
    """Return the keys of base, tool and targets."""
    tool: dict[str, Any] = {"R_ee_target": model.R_ee_target.tolist()}
    if model.R_first_target_of:
        tool["R_first_target_of"] = {
            campaign: R.tolist() for campaign, R in model.R_first_target_of.items()
        }
    if not np.array_equal(model.T_end_shown, np.eye(4)):
        tool["T_end_shown"] = model.T_end_shown.tolist()
    targets_m = model.targets_m.reshape(-1, 3).tolist()
    return {
        "T_instr_base": model.T_instr_base.tolist(),
        "tool": tool,
        "targets_m": dict(zip(model.target_names, targets_m, strict=True)),
        "targets_off_m": model.targets_off_m.tolist(),
        # For people and other programs; they follow from the entries above.
        "T_flange": {
            name: T_flange_frame(model, name).tolist() for name in model.frames if name != FLANGE
        },
    }


def _validity_to_plain(model: Fitted) -> dict[str, Any]:
    """Return the keys that say where the model holds, how well, and what else may be predicted."""
    lacks, falls_back, other = model.discrepancy, model.falls_back, model.otherwise
    plain: dict[str, Any] = {
        "seen": None if model.seen is None else model.seen.to_plain(),
        "discrepancy": None
        if lacks is None
        else {field.name: plain_value(getattr(lacks, field.name)) for field in fields(lacks)},
        "falls_back": None
        if falls_back is None
        else {"within": falls_back.within.to_plain(), "model": model_to_plain(falls_back.model)},
    }
    if other is not None:
        plain["otherwise"] = {
            "probability": other.probability,
            "model": model_to_plain(other.model),
        }
    return plain


def _term_to_plain(model: Fitted, term: Term) -> dict[str, Any]:
    """Return a term with its formula, its reported parameters, and its fitted ones as `x`."""
    report, std = model.reported(term)
    return {
        **term_to_plain(term),
        "formula": term.formula,
        "parameters": {
            parameter.name: {
                "value": float(value),
                "std": float(sigma) if np.isfinite(sigma) else None,
                "unit": parameter.unit,
            }
            for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
        },
        "x": model.values_of(term).tolist(),
    }


class _YamlWriter(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes lists of numbers on one line, and repeated objects in full."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return that no object is written as a reference to another."""
        del data
        return True


def _represent_list(writer: Any, entries: list[Any]) -> Any:
    """Return a list as YAML, on one line if it holds no lists or mappings."""
    flat = all(not isinstance(entry, list | dict) for entry in entries)
    return writer.represent_sequence("tag:yaml.org,2002:seq", entries, flow_style=flat)


_YamlWriter.add_representer(list, _represent_list)
