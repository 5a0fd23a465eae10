"""A fitted model as users have it: it predicts and compensates, and is saved and loaded."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from pa10cal.arm.chain import BASE, Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError, Pa10calError
from pa10cal.files.output import whole_files
from pa10cal.fit.compensation import compensate, numbers
from pa10cal.fit.covariance_file import (
    checked_covariance,
    covariance_beside,
    covariance_path,
    write_covariance,
)
from pa10cal.fit.fitted import (
    FLANGE,
    Compensation,
    FallBack,
    Fitted,
    FittedTo,
    Otherwise,
    Prediction,
)
from pa10cal.fit.forward import Forward, T_flange_frame, predicted, states_at
from pa10cal.fit.loads import BLOCK
from pa10cal.fit.plain_arm import (
    arm_from_plain,
    arm_to_plain,
    finite,
    plain_value,
    pose_from_plain,
    rotation_from_plain,
)
from pa10cal.fit.validity import AngleCoverage, Discrepancy
from pa10cal.results.calibration import CalibrationRecord, Covariance
from pa10cal.terms.field import Field
from pa10cal.terms.model import Model
from pa10cal.terms.plain import refuse_of_another_arm, term_from_plain, term_to_plain
from pa10cal.terms.term import Term
from pa10cal.yaml_file import read_yaml

SCHEMA = "pa10cal-model/2"


@dataclass(frozen=True, eq=False, repr=False)
class FittedModel(Fitted):
    """A chain with terms and the values of their parameters: all that predictions need."""

    def save(self, path: str | Path) -> None:
        """Write the model as `model.yaml`, its covariance beside it, whole or not at all.

        Raises:
            OutputError: when it cannot be written there.
        """
        save_model(self, Path(path))

    def predict(
        self,
        q: ArrayLike,
        *,
        frame: str = FLANGE,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Prediction:
        """Predict where a frame of the robot is.

        Torques are those of the weights described. What an instrument reads falsely, and what a
        torque log shows falsely, moves no robot and plays no part.

        Args:
            q: (N, m) or (m,) joint positions, as the controller counts them [rad; m if prismatic].
            frame: `flange`, the last frame of the nominal arm; `tool`, the target of a pose
                instrument, else the first target with the flange's orientation; `target_<name>`. Of
                a group also `tool@<campaign>` and `target_<name>@<campaign>`.
            load_N: external load, one for all poses or (N,).
            arrival: direction in which each joint arrives, -1 or 1, one for all or (N, m); 0 where
                it is not known, whose lost motion is then part of `u_mm`.
            temperature_C: temperature, one or (N,); None or nan where it is not known: the mean of
                the fit is taken, and the spread of its temperatures is then part of `u_mm`.
            time_s: time on the campaign's clock, one or (N,), for a base that moves with time; None
                or nan where none is meant: the base is then where `T_instr_base` has it.
            extrapolate: predict also for loads heavier than any that the fit has seen.

        Raises:
            ModelError: when q is of another arm, the frame is unknown, a load is heavier than those
                of the fit, or the model has springs and the masses that load them are not known.
        """
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, self._joints_at(q), *of_pose, extrapolate=extrapolate)
        return predicted(self, given, frame)

    def predict_in_blocks(
        self,
        q: ArrayLike,
        *,
        frame: str = FLANGE,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
        rows: int = BLOCK,
    ) -> Iterator[tuple[slice, Prediction]]:
        """Yield predictions of so many rows at a time, and which; see `predict`.

        A prediction takes some kilobytes a pose; these take what a block does, however many poses.

        Raises:
            ModelError: see `predict`, before anything is predicted.
        """
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, self._joints_at(q), *of_pose, extrapolate=extrapolate)
        for first in range(0, len(given.q_rad), rows):
            part = slice(first, first + rows)
            here = given.take(np.arange(len(given.q_rad))[part])
            yield part, predicted(self, here, frame)

    def compensate(
        self,
        T: ArrayLike,
        *,
        frame: str = FLANGE,
        seed: ArrayLike | None = None,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
        T_flange_tcp: ArrayLike | None = None,
        controller: Arm | None = None,
    ) -> Compensation:
        """Find the joint positions to command so that a frame of the robot comes to poses.

        `T_send`, and `cartesian(angles)` of what is returned, have the poses to send to a
        controller that takes no joint positions.

        Args:
            T: (N, 4, 4) or (4, 4) poses wanted of the frame, in the robot's base frame [m].
            seed: (N, m) or (m,) joint positions; of all branches the nearest within the joint
                limits is taken (of those found, where they have no closed form). A row of nan, and
                every row but the first where (m,) is given, has the nearest to the row before;
                without any the first row has the nearest to the middle of the angles that the fit
                has seen.
            frame, load_N, arrival, temperature_C, time_s, extrapolate: see `predict`.
            T_flange_tcp: (4, 4) TCP that the controller holds, in its flange [m]; None for the
                frame as the model has it (none for the flange).
            controller: arm that the controller computes with, as `load_arm` gives it; None for what
                the campaign states, else the nominal arm.

        Raises:
            ModelError: when a pose is none, a seed of another arm, or see `predict`.
            ArmError: when the controller computes with another robot.
        """
        wanted = numbers(T, "T")
        wanted = wanted[None] if wanted.ndim == 2 else wanted
        nowhere = np.zeros((len(wanted), self.arm.n))
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, nowhere, *of_pose, extrapolate=extrapolate)
        return compensate(self, wanted, frame, given, seed, T_flange_tcp, controller)

    def jacobian(self, q: ArrayLike, *, frame: str = FLANGE, load_N: ArrayLike = 0.0) -> Array:
        """Return how a frame moves with the joints, (N, 6, m), at positions as for `predict`.

        Velocity of its origin [m] over angular velocity [rad], along base axes, a unit of each
        joint. Exact: springs and effects, which change with angles and weights, are in it.
        """
        forward, given = Forward.of(self, frame), states_at(self, self._joints_at(q), load_N)
        by_joints = forward.by_joints(forward.states(given), terms=True)[1]
        return self.arm.coupling.by_axes(by_joints)

    def states(self, q: ArrayLike, load_N: ArrayLike = 0.0) -> PoseStates:
        """Return the states in which poses are predicted, with what their weights do.

        Raises:
            ModelError: see `predict`.
        """
        return Forward.of(self).states(states_at(self, self._joints_at(q), load_N))

    def T_flange_frame(self, frame: str) -> Array:
        """Return where a frame is in the flange, unloaded, (4, 4) [m].

        Raises:
            ModelError: when the frame is unknown.
        """
        return T_flange_frame(self, frame)

    def _joints_at(self, q: ArrayLike) -> Array:
        """Return joint positions (N, n) from those that the controller counts; refuse others."""
        positions = np.atleast_2d(np.asarray(q, dtype=float))
        n = len(self.arm.axes_slide)
        if positions.ndim != 2 or positions.shape[1] != n or not np.isfinite(positions).all():
            raise ModelError(
                f"joint positions of {positions.shape[-1]} joints"
                if positions.shape[-1] != n
                else "joint positions that are no finite numbers",
                where="q",
                value=positions.shape,
                allowed=f"(N, {n}) for {self.arm.name}",
                remedy="give one column a joint, in radians (metres for a joint that slides)",
            )
        return self.arm.coupling.to_joints(positions)


def load_model(path: str | Path) -> FittedModel:
    """Read a fitted model; without the file of its covariance it predicts without uncertainty.

    Args:
        path: model.yaml, the folder `model` that contains it, or the folder of the results.

    Raises:
        ModelError: when the file, or that of its covariance, cannot be read, is of another schema,
            or lacks a key.
        TermError: when it has a term that is not known.
    """
    given, path = Path(path), file_of(Path(path))
    content = read_yaml(
        path,
        ModelError,
        what="the model cannot be read",
        allowed="a model.yaml that this package wrote",
        remedy="correct the path, or write the model again",
        within=None if path == given else given,
    )
    covariance = covariance_beside(path)
    return model_from_plain(content, where=str(path), covariance=covariance)


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
        place = f"{where}: fitted_model of {name}"
        model = model_from_plain(fit.fitted_model, where=place)
        covariance = _covariance_of_fit(model, fit.covariance)
        if covariance is not None:
            checked = checked_covariance(covariance, len(covariance), place)
            model = replace(model, covariance=checked)
        models[name] = model
    return models


def _covariance_of_fit(model: Fitted, recorded: Covariance) -> Array | None:
    """Return the covariance (k + 6, k + 6) of a model's parameters and base from that of its fit.

    The record has that of the fitted parameters, with or without the base, or of those reported;
    None where its parameters are others.
    """
    names, matrix = recorded.names, recorded.matrix
    fitted = tuple(parameter.name for parameter in model.model.parameters)
    report, k = model.model.report(model.x), len(fitted)
    covariance = np.zeros((k + 6, k + 6))
    if names[:k] == fitted:
        base = [name.replace(".", "_") for name in BASE]
        recorded_at = [names.index(name) for name in (*fitted, *base) if name in names]
        at = [*range(k), *(k + base.index(name) for name in names if name in base)]
        covariance[np.ix_(at, at)] = matrix[np.ix_(recorded_at, recorded_at)]
    elif names == tuple(parameter.name for parameter in report.parameters):
        by_reported = np.linalg.pinv(report.jacobian)
        covariance[:k, :k] = by_reported @ matrix @ by_reported.T
    else:
        return None
    return covariance


def save_model(model: Fitted, path: Path, **about: Any) -> None:
    """Write a fitted model, and its covariance beside it, whole or not at all.

    Args:
        path: `….yaml`; the covariance is written to `….covariance.npz`.
        about: further keys for people, such as warnings; they are not read back.

    Raises:
        OutputError: when it cannot be written there.
    """
    content = model_to_plain(model, **about)
    beside = () if model.covariance is None else (covariance_path(path),)
    for covariance in beside:
        content["covariance"] = covariance.name
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    with whole_files(*beside, path) as (*covariances, place):
        for covariance in covariances:
            write_covariance(model, covariance)
        place.write_text(text, encoding="utf-8", newline="\n")


def file_of(path: Path) -> Path:
    """Return the file of a model: the path itself, or model.yaml in a folder `model` or results."""
    if not path.is_dir():
        return path
    in_folder, in_results = path / "model.yaml", path / "model" / "model.yaml"
    if not os.path.lexists(in_folder) and os.path.lexists(in_results):
        return in_results
    return in_folder


def model_to_plain(model: Fitted, **about: Any) -> dict[str, Any]:
    """Return a fitted model as numbers, texts, lists and mappings; see `model_from_plain`."""
    fitted, lacks, falls_back = model.fitted_to, model.discrepancy, model.falls_back
    other = model.otherwise
    terms = [(term.id == Field.id, _term_to_plain(model, term)) for term in model.model.terms]
    tool: dict[str, Any] = {"R_ee_target": model.R_ee_target.tolist()}
    if model.R_first_target_of:
        tool["R_first_target_of"] = {
            name: R.tolist() for name, R in model.R_first_target_of.items()
        }
    return {
        "schema": SCHEMA,
        "robot": model.arm.name,
        "grade": model.grade or None,
        "fitted_to": None if fitted is None else fitted.model_dump(mode="json"),
        **about,
        "arm": arm_to_plain(model.arm, model.model.chain.bends),
        "terms": [plain for is_field, plain in terms if not is_field],
        # A displacement without a name: the last term of a model that has one.
        "field": next((plain for is_field, plain in terms if is_field), None),
        "payload": None if model.payload is None else _payload_to_plain(model.payload),
        "T_instr_base": model.T_instr_base.tolist(),
        "tool": tool,
        "targets_m": {
            name: place.tolist()
            for name, place in zip(model.target_names, model.targets_m.reshape(-1, 3), strict=True)
        },
        "targets_off_m": model.targets_off_m.tolist(),
        # For people and other programs; they follow from the entries above.
        "T_flange": {
            name: T_flange_frame(model, name).tolist() for name in model.frames if name != FLANGE
        },
        "seen": None if model.seen is None else model.seen.to_plain(),
        "discrepancy": None
        if lacks is None
        else {field.name: plain_value(getattr(lacks, field.name)) for field in fields(lacks)},
        "falls_back": None
        if falls_back is None
        else {
            "within": falls_back.within.to_plain(),
            "model": model_to_plain(falls_back.model),
        },
        **({} if other is None else {"otherwise": _otherwise_to_plain(other)}),
        "covariance": None,
    }


def _otherwise_to_plain(other: Otherwise) -> dict[str, Any]:
    return {"probability": other.probability, "model": model_to_plain(other.model)}


def _otherwise_from_plain(content: Any, arm: Arm, where: str) -> Otherwise | None:
    """Return the model under another explanation, and its probability, in the file of a model."""
    if content is None:
        return None
    probability = float(content["probability"])
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"otherwise.probability is {probability}, and not from 0 to 1")
    return Otherwise(_of_same_arm(content["model"], arm, f"{where}: otherwise.model"), probability)


def _fall_back_from_plain(content: Any, arm: Arm, where: str) -> FallBack | None:
    """Return what a model falls back to, in the file of the model."""
    if content is None:
        return None
    within = AngleCoverage.from_plain(content["within"], arm.n)
    return FallBack(within, _of_same_arm(content["model"], arm, f"{where}: falls_back.model"))


def _of_same_arm(content: Any, arm: Arm, where: str) -> FittedModel:
    """Return a model within another one; refuse one of an arm with another number of joints."""
    model = model_from_plain(content, where=where)
    if model.arm.n != arm.n:
        raise ValueError(f"{where} is of {model.arm.n} joints, and the model of {arm.n}")
    return model


def model_from_plain(
    content: object, *, where: str, covariance: Array | None = None
) -> FittedModel:
    """Return the model that `model_to_plain` described.

    Args:
        covariance: (k, k) of the parameters, or None.

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
    try:
        # Older files have none of the keys that are asked for by `get`.
        field = content.get("field")
        entries = [*content["terms"], *([] if field is None else [field])]
        if covariance is not None:
            size = sum(len(term["x"]) for term in entries) + len(BASE)
            covariance = checked_covariance(covariance, size, where)
        pairs = [_term_from_plain(entry, f"{where}: terms[{k}]") for k, entry in enumerate(entries)]
        terms = tuple(term for term, _ in pairs)
        arm = arm_from_plain(content["arm"])
        chain = Chain.of(arm, bends=tuple(content["arm"]["bends"]))
        refuse_of_another_arm(terms, chain, where)
        targets = content["targets_m"]
        fitted, payload, seen = content["fitted_to"], content["payload"], content["seen"]
        lacks = content.get("discrepancy")
        return FittedModel(
            model=Model(chain, terms),
            x=np.concatenate([np.zeros(0), *(x for _, x in pairs)]),
            T_instr_base=pose_from_plain(content["T_instr_base"], "T_instr_base"),
            R_ee_target=rotation_from_plain(content["tool"]["R_ee_target"], "R_ee_target"),
            R_first_target_of={
                name: rotation_from_plain(R, f"R_first_target_of.{name}")
                for name, R in content["tool"].get("R_first_target_of", {}).items()
            },
            targets_m=np.concatenate(
                [np.zeros(0), *(finite(p, name, 3) for name, p in targets.items())]
            ),
            target_names=tuple(targets),
            targets_off_m=finite(content["targets_off_m"], "targets_off_m"),
            covariance=covariance,
            payload=None if payload is None else _payload_from_plain(payload),
            fitted_to=None if fitted is None else FittedTo.model_validate(fitted),
            seen=None if seen is None else AngleCoverage.from_plain(seen, arm.n),
            discrepancy=None if lacks is None else Discrepancy.from_plain(lacks, arm.n),
            falls_back=_fall_back_from_plain(content.get("falls_back"), arm, where),
            otherwise=_otherwise_from_plain(content.get("otherwise"), arm, where),
        )
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


def _term_to_plain(model: Fitted, term: Term) -> dict[str, Any]:
    """Return a term with its form, its reported parameters, and its fitted parameters as `x`."""
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


def _term_from_plain(content: Mapping[str, Any], where: str) -> tuple[Term, Array]:
    """Return a term and its parameters; refuse another formula than this version computes."""
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
    return term, x


def _payload_to_plain(payload: Payload) -> dict[str, Any]:
    plain = {f.name: plain_value(getattr(payload, f.name)) for f in fields(Payload)}
    plain.pop("of_campaigns")
    if payload.of_campaigns:
        plain["of_campaigns"] = [_payload_to_plain(each) for each in payload.of_campaigns]
    return plain


def _payload_from_plain(plain: Mapping[str, Any]) -> Payload:
    return Payload(
        mass_kg=float(finite(plain["mass_kg"], "mass_kg")),
        com_m=finite(plain["com_m"], "com_m").reshape(3),
        load_point_m=finite(plain["load_point_m"], "load_point_m").reshape(3),
        gravity_m_s2=finite(plain["gravity_m_s2"], "gravity_m_s2").reshape(3),
        known=bool(plain.get("known", True)),
        com_u_m=None if plain.get("com_u_m") is None else float(plain["com_u_m"]),
        of_campaigns=tuple(_payload_from_plain(each) for each in plain.get("of_campaigns", ())),
    )


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes lists of numbers on one line, and no references."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write repeated objects in full."""
        del data
        return True


def _list(dumper: Any, data: list[Any]) -> Any:
    """Write a list on one line if it holds no lists or mappings."""
    flat = all(not isinstance(entry, list | dict) for entry in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flat)


_Dumper.add_representer(list, _list)
