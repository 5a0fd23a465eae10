"""Commands for fitted models: `predict`, `compensate`, `compare`, `drift`."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from pa10cal.errors import ModelError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pa10cal.arm.controller_poses import Angles
    from pa10cal.arm.description import Arm
    from pa10cal.arrays import Array
    from pa10cal.campaign.pose_lists import JointList, TargetList
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.results.comparison import ComparisonRecord


def model_in_use(path: Path, *, force: bool) -> FittedModel:
    """Read a model, unless its calibration is not to be trusted.

    Raises:
        ModelError: when it cannot be read, or its grade needs `force`.
    """
    from pa10cal.fit.fitted_model import load_model

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
    from pa10cal.results.calibration import UNRESERVED

    return bool(model.grade) and model.grade not in UNRESERVED


class Stated(NamedTuple):
    """What is given of poses besides their joint positions, in their rows or to the command."""

    load_N: Array  # (N,)
    arrival: Array  # (N, n)
    temperature_C: Array  # (N,) nan where none is given
    time_s: Array  # (N,) nan where none is given


def stated(
    asked: JointList | TargetList,
    load_N: float,
    arrival: tuple[float, ...] | None,
    temperature_C: float | None,
    time_s: float | None,
) -> Stated:
    """Return what is given of each pose: by its row, else by the command.

    Raises:
        ModelError: when the command gives another number of directions than one, or one a joint.
    """
    import numpy as np

    sides = arrival or (0.0,)
    n = asked.arrival.shape[1]
    if len(sides) not in (1, n):
        raise ModelError(
            "directions of arrival of another arm",
            where="--arrival",
            value=" ".join(f"{side:g}" for side in sides),
            allowed=f"1 number for all joints, or {n}: one a joint",
            remedy="give -1 or 1 for each joint, 0 where it is not known",
        )

    def or_else(of_row: Array, of_command: ArrayLike | None) -> Array:
        return of_row if of_command is None else np.where(np.isnan(of_row), of_command, of_row)

    return Stated(
        load_N=or_else(asked.load_N, load_N),
        arrival=or_else(asked.arrival, sides),
        temperature_C=or_else(asked.temperature_C, temperature_C),
        time_s=or_else(asked.time_s, time_s),
    )


def not_stated(model: FittedModel, given: Stated) -> Iterator[str]:
    """Yield what is taken where a model depends on a temperature or time that is not given."""
    import numpy as np

    away = model.falls_back
    used = away.model if away is not None and away.within.nowhere else model
    for term in used.model.terms:
        if term.depends_on is None or not (rows := np.isnan(getattr(given, term.depends_on)).sum()):
            continue
        taken = "the base is taken to be where T_instr_base of the model has it"
        if term.depends_on == "temperature_C":
            fitted = used.fitted_to
            if fitted is None or fitted.temperature_C is None:
                continue
            taken = f"the mean of the fit, {fitted.temperature_C:.1f} °C, is taken"
            if fitted.temperature_std_C:
                taken += f"; u_mm holds its {fitted.temperature_std_C:.1f} K of spread"
        yield f"{term.id} needs {term.depends_on}, which {rows} rows do not give: {taken}"


def remarks(
    command: str, path: Path, contradictions: Iterable[str], unused: tuple[str, ...]
) -> str:
    """Print what in a list contradicts itself, and return which of its columns are not read.

    For the end of a line; nothing where all are.
    """
    for each in contradictions:
        print(f"pa10cal {command}: warning: {path}: {each}", file=sys.stderr)
    return f"; not read of {path}: {', '.join(unused)}" if unused else ""


def fallen_back(model: FittedModel) -> str:
    """Return that a model's effects hold nowhere, for the end of a line; else nothing."""
    if model.falls_back is None or not model.falls_back.within.nowhere:
        return ""
    return "; its effects hold nowhere, as held-out poses showed: the calibrated model is used"


def predict(
    *,
    model: Path,
    joints: Path,
    out: Path,
    frame: str = "flange",
    load_N: float = 0.0,
    arrival: tuple[float, ...] | None = None,
    temperature_C: float | None = None,
    time_s: float | None = None,
    force: bool = False,
) -> None:
    """Predict the poses of a calibrated robot at any joint positions.

    Poses are in the robot's base frame, with the standard uncertainty of each position (u_mm holds
    what the model lacks, u_parameters_mm does not) and whether the pose is near poses of the fit.
    Lost motion counts in both unless the side from which a joint arrives is given.
    docs/using-the-model.md explains the columns.

    Args:
        model: model.yaml of a calibration, or the results that hold it.
        joints: joint positions: id,q1_deg,...[,load_N][,arrival1,...][,temperature_C][,time_s]
            (.csv).
        out: poses to write (.csv).
        frame: flange, tool, or target_<name>.
        load_N: external load [N] of rows that give none.
        arrival: side from which joints arrive, of rows that give none: -1 or 1, the sign of the
            last motion, 0 where it is not known; one for all joints, or one a joint.
        temperature_C: temperature of rows that give none; by default the mean of the fit.
        time_s: time on the campaign's clock, of rows that give none, for a base that moved while
            the campaign lasted; by default the base is where T_instr_base of the model has it.
        force: use a model whose input is suspect, and loads heavier than any that it has seen.

    Examples:
        pa10cal predict --model results/cell-a/model/model.yaml --joints joints.csv --out poses.csv
        pa10cal predict --model model.yaml --joints joints.csv --frame tool --load-N 22 --out p.csv
    """
    import numpy as np

    from pa10cal.campaign.pose_lists import poses_text, read_joints
    from pa10cal.files.output import whole_file
    from pa10cal.fit import contradictions

    fitted = model_in_use(model, force=force)
    asked = read_joints(joints, fitted.arm.axes_slide)
    given = stated(asked, load_N, arrival, temperature_C, time_s)
    away = 0
    blocks = fitted.predict_in_blocks(asked.q, frame=frame, **given._asdict(), extrapolate=force)
    with whole_file(out) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        for rows, found in blocks:
            columns = {
                "u_mm": found.u_mm,
                "inside": found.inside,
                "u_parameters_mm": found.u_parameters_mm,
            }
            if doubtful(fitted):
                columns["forced"] = np.full(len(found), fitted.grade)
            file.write(poses_text(asked.ids[rows], found.T, columns, header=rows.start == 0))
            away += int(np.count_nonzero(~found.inside))
    rest = remarks("predict", joints, contradictions.of_joints(fitted, asked.q), asked.unused)
    print(
        f"{out}: {frame} of {fitted.arm.name} at {len(asked.ids)} joint positions, "
        f"{away} of them away from the poses of the fit{fallen_back(fitted)}{rest}"
    )
    for line in not_stated(fitted, given):
        print(line)


def compensate(
    *,
    model: Path,
    targets: Path,
    out: Path,
    frame: str = "flange",
    load_N: float = 0.0,
    arrival: tuple[float, ...] | None = None,
    temperature_C: float | None = None,
    time_s: float | None = None,
    write: Literal["joints", "cartesian"] = "joints",
    angles: Literal["ABC", "quaternion", "rpy", "rotation_vector"] | None = None,
    tcp: tuple[float, ...] | None = None,
    controller: str | None = None,
    force: bool = False,
) -> None:
    """Compute the joint positions to command so that a calibrated robot reaches its targets.

    Every target has a row, in order, with a status: ok, outside_limits, unreachable or
    near_singular. Of several branches the nearest to the row's seed is taken, without a seed the
    nearest to the row before. With --write cartesian each row also has the pose to send to a
    controller that takes no joint positions. docs/using-the-model.md explains the columns.

    Args:
        model: model.yaml of a calibration, or the results that hold it.
        targets: poses in the robot's base frame: id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,load_N][,q1_deg,
            ...][,arrival1,...][,temperature_C][,time_s] (.csv).
        out: joint positions to write (.csv).
        frame: flange, tool, or target_<name>.
        load_N: external load [N] of rows that give none.
        arrival: side from which joints arrive, of rows that give none: -1 or 1, the sign of the
            last motion, 0 where it is not known; one for all joints, or one a joint.
        temperature_C: temperature of rows that give none; by default the mean of the fit.
        time_s: time on the campaign's clock, of rows that give none, for a base that moved while
            the campaign lasted; by default the base is where T_instr_base of the model has it.
        write: joints, or cartesian: beside them the poses to send, in the robot's base frame.
        angles: how the controller writes orientations: ABC (KUKA, deg), quaternion (the default),
            rpy (deg), or rotation_vector (rad).
        tcp: TCP that the controller holds: x y z in mm and the orientation in these angles; by
            default the frame as the model has it in the flange, which is printed.
        controller: arm that the controller computes with: a name, or the file of a description
            (.yaml); by default what campaign.yaml states, else the nominal arm.
        force: use a model whose input is suspect, and loads heavier than any that it has seen.

    Examples:
        pa10cal compensate --model model.yaml --targets targets.csv --out commands.csv
        pa10cal compensate --model model.yaml --targets t.csv --out c.csv --frame tool \\
          --write cartesian --angles ABC
        pa10cal compensate --model model.yaml --targets t.csv --frame tool --load-N 22 --out c.csv
    """
    import numpy as np

    from pa10cal.arm.controller_poses import controller_columns, controller_pose
    from pa10cal.campaign.pose_lists import commands_text, read_targets
    from pa10cal.files.arms import arm_asked
    from pa10cal.files.controller import refuse_another_robot
    from pa10cal.files.output import whole_file
    from pa10cal.fit import contradictions
    from pa10cal.fit.fitted import unknown_controller
    from pa10cal.fit.loads import blocks

    form: Angles = angles or "quaternion"
    if write == "joints" and (angles or tcp or controller):
        raise ModelError(
            "for poses of a controller, and joint positions are written",
            where="--angles" if angles else "--tcp" if tcp else "--controller",
            value=angles or tcp or controller,
            allowed="--write cartesian",
            remedy="add --write cartesian, or leave the option out",
        )
    fitted = model_in_use(model, force=force)
    arm = fitted.arm
    computes = arm.controller_arm if controller is None else arm_asked(controller, Path())
    if write == "cartesian" and computes is None:
        raise unknown_controller()
    if controller is not None and computes is not None:
        refuse_another_robot(arm, computes, "--controller")
    asked = read_targets(targets, arm.axes_slide)
    given = stated(asked, load_N, arrival, temperature_C, time_s)
    found = fitted.compensate(
        asked.T,
        frame=frame,
        seed=asked.q,
        **given._asdict(),
        extrapolate=force,
        T_flange_tcp=controller_pose(tcp, form) if tcp else None,
        controller=computes,
    )
    columns = {
        "status": found.status,
        "error_mm": found.error_mm,
        "u_mm": found.u_mm,
        "u_parameters_mm": found.u_parameters_mm,
        "error_deg": found.error_deg,
        "inside": found.inside,
        "branch": found.branch,
    }
    if write == "cartesian":
        columns |= found.cartesian(form)
    if doubtful(fitted):
        columns["forced"] = np.full(len(found), fitted.grade)
    with whole_file(out) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        for rows in blocks(len(found)):
            of_rows = {name: values[rows] for name, values in columns.items()}
            first = not len(rows) or rows[0] == 0
            answers = asked.ids[rows], found.q[rows], arm.axes_slide, of_rows
            file.write(commands_text(*answers, header=first))
    said = [*contradictions.of_targets(fitted, asked.T, asked.q, frame)]
    said = said or [*contradictions.of_answers(fitted, asked.T, found, frame, given.load_N)]
    rest = remarks("compensate", targets, said, asked.unused)
    words, counts = np.unique(found.status, return_counts=True)
    outcome = ", ".join(f"{count} {word}" for word, count in zip(words, counts, strict=True))
    swung = int(np.count_nonzero(found.branch == "other"))
    outcome += f"; {swung} on another branch than the nearest" if swung else ""
    outcome += fallen_back(fitted)
    print(f"{out}: {len(found)} targets of the {frame} of {arm.name}: {outcome}{rest}")
    for line in not_stated(fitted, given):
        print(line)
    if write == "cartesian":
        held = controller_columns(found.T_flange_tcp[None], form)
        # Nine decimals, so that rounding is no number that somebody types into a controller.
        shown = ", ".join(f"{name} {round(float(v[0]), 9) + 0.0:.6g}" for name, v in held.items())
        of = _computed_with(arm, computes)
        print(f"send_… are for a controller with {of} and this TCP: {shown}")


def _computed_with(arm: Arm, computes: Arm | None) -> str:
    """Return what poses to send are relative to, in words."""
    if computes is not None and computes is not arm:
        return f"the model of {computes.name}"
    if arm.controller is None:
        return "the nominal model (its own compensation must be off, or stated in campaign.yaml)"
    if arm.controller.compensation:
        return f"the model of {arm.name}, its compensation on,"
    return "the nominal model, its compensation off,"


#: Parameters shown: those that differ by most of their uncertainty, from so many of it on.
_SHOWN, _WORTH_SHOWING = 5, 3.0


def compare(first: Path, second: Path, *, out: Path | None = None) -> None:
    """Compare two models of one arm: what differs, and whether that is significant.

    Models are compared by their flange poses, over the joint angles that both have seen, after base
    and tool are aligned. docs/using-the-model.md explains the figures.

    Args:
        first: model.yaml of a calibration, or the results that hold it.
        second: model.yaml of another.
        out: every parameter and figure, to write (.json).

    Examples:
        pa10cal compare results/june/model/model.yaml results/july/model/model.yaml
        pa10cal compare june.yaml july.yaml --out compare.json
    """
    from pa10cal.evaluation.two_models import compare_models
    from pa10cal.fit.fitted_model import load_model
    from pa10cal.results.codec import write

    models = load_model(first), load_model(second)
    found = compare_models(*models, names=(str(first), str(second)))
    if out is not None:
        write(found, out)
    print("\n".join(_lines(found)))


def _lines(found: ComparisonRecord) -> Iterator[str]:
    """Yield what a reader is shown: models, frames, parameters that differ most, the sentence."""
    for number, model in enumerate((found.first, found.second), start=1):
        of = f"{model.calibration} of {model.campaign}" if model.campaign else "not known"
        yield f"{number}  {model.name}: {model.robot}, fit {of}, grade {model.grade or 'not known'}"
        if model.only_here:
            yield f"   only here: {', '.join(model.only_here)}"
    if found.described_otherwise:
        yield f"described otherwise: {', '.join(found.described_otherwise)}"
    if found.frames:
        yield ""
        over = f"over {found.postures} postures"
        yield f"{over:<24}{'rms mm':>9}{'peak mm':>9}{'rms deg':>10}"
        for name, each in found.frames.items():
            yield _row(f"{name}, as predicted", each.rms_mm, each.peak_mm, each.orientation_deg)
            yield _row("  base and tool explain", each.base_and_tool_mm)
            yield _row(
                "  remains", each.remaining_rms_mm, each.remaining_peak_mm, each.remaining_deg
            )
            if each.expected_mm is not None:
                yield _row("  expected to remain", each.expected_mm, None, each.expected_deg)
    rows = found.parameters
    most = sorted(
        (-abs(over_u), k) for k, over_u in enumerate(rows.over_u) if abs(over_u) >= _WORTH_SHOWING
    )
    if most:
        yield ""
        yield "parameters that differ most, in standard uncertainties of the difference"
        for _, k in most[:_SHOWN]:
            name = f"{rows.parameter[k]} ({rows.term[k]} of {rows.of[k]})"
            values = f"{rows.first[k]:.6g} and {rows.second[k]:.6g} {rows.unit[k]}"
            yield f"  {name:<44} {rows.over_u[k]:+8.1f}  {values}"
    yield ""
    yield found.line
    if found.what_moved is not None:
        yield f"between both campaigns: {found.what_moved.line}"
        if found.what_moved.verdict != "unchanged":
            yield (
                "if the robot was hit or mended in between, the first model as a prior needs fewer "
                "poses of the second campaign: pa10cal run CAMPAIGN --prior "
                f"{found.first.name}"
            )


def _row(title: str, rms: float, peak: float | None = None, deg: float | None = None) -> str:
    peak_shown = "" if peak is None else f"{peak:.3f}"
    deg_shown = "" if deg is None else f"{deg:.4f}"
    return f"{title:<24}{rms:>9.3f}{peak_shown:>9}{deg_shown:>10}".rstrip()


def drift(models: tuple[Path, ...], *, out: Path, figures: Path | None = None) -> None:
    """Show the parameters of one arm over its campaigns, and what moved between them.

    Args:
        models: model.yaml of every campaign, or the results that hold it, in order of time.
        out: every parameter with its interval, and what moved from each campaign to the next, to
            write (.json).
        figures: folder for a figure of the same name.

    Examples:
        pa10cal drift results/june results/july results/august --out drift.json --figures figures
    """
    from pa10cal.evaluation.two_models import drift as over_campaigns
    from pa10cal.fit.fitted_model import load_model
    from pa10cal.results.codec import write

    found = [load_model(path) for path in models]
    names = [
        model.fitted_to.campaign if model.fitted_to else str(path)
        for path, model in zip(models, found, strict=True)
    ]
    if len(set(names)) < len(names):
        names = [str(path) for path in models]
    record = over_campaigns(found, names)
    write(record, out)
    if figures is not None:
        from pa10cal.evaluation.options import FigureOptions
        from pa10cal.figures.draw import write_drift

        write_drift(record, figures, out.stem, FigureOptions().png_dpi)
    for step in record.steps:
        print(f"{step.first} to {step.second}: {step.what_moved.line}")
