"""Commands for fitted models: `predict`, `compensate`, `compare`, `drift`."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from pa10cal.errors import ModelError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from pa10cal.arm.controller_poses import Angles
    from pa10cal.arm.description import Arm
    from pa10cal.arrays import Array
    from pa10cal.campaign.pose_lists import JointList, TargetList
    from pa10cal.fit.fitted import Compensation, Fitted
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.results.comparison import ComparisonRecord


def read_usable_model(path: Path, *, force: bool) -> FittedModel:
    """Read a model whose calibration may be relied on.

    Raises:
        ModelError: when it cannot be read, or its grade needs `force`.
    """
    from pa10cal.fit.model_reading import load_model

    model = load_model(path)
    if needs_force(model) and not force:
        assert model.fitted_to is not None
        raise ModelError(
            f"a model of grade {model.grade} is not applied",
            where=f"{path}: fitted_to",
            value=model.fitted_to.health,
            allowed="good, few_poses or incomplete",
            remedy="follow the remedy in the line and calibrate again, or insist with --force",
        )
    return model


def needs_force(model: FittedModel) -> bool:
    """Return whether a model's grade is one with which it is used by force alone."""
    from pa10cal.results.calibration import UNRESERVED

    return bool(model.grade) and model.grade not in UNRESERVED


class PoseConditions(NamedTuple):
    """Under which conditions each of N poses of n joints is taken; arguments of a prediction."""

    load_N: Array  # (N,)
    arrival: Array  # (N, n) sign of the last motion of each joint
    temperature_C: Array  # (N,) nan where not stated
    time_s: Array  # (N,) nan where not stated


def conditions_of(
    rows: JointList | TargetList,
    load_N: float,
    arrival: tuple[float, ...] | None,
    temperature_C: float | None,
    time_s: float | None,
) -> PoseConditions:
    """Return the conditions of each pose: those of its row, else those of the command.

    Raises:
        ModelError: when the command gives another number of directions than one, or one a joint.
    """
    import numpy as np

    directions = arrival or (0.0,)
    n = rows.arrival.shape[1]
    if len(directions) not in (1, n):
        raise ModelError(
            "directions of arrival of another arm",
            where="--arrival",
            value=" ".join(f"{direction:g}" for direction in directions),
            allowed=f"1 number for all joints, or {n}: one a joint",
            remedy="give -1 or 1 for each joint, 0 where it is not known",
        )

    def filled(of_rows: Array, of_command: ArrayLike | None) -> Array:
        if of_command is None:
            return of_rows
        return np.where(np.isnan(of_rows), of_command, of_rows)

    return PoseConditions(
        load_N=filled(rows.load_N, load_N),
        arrival=filled(rows.arrival, directions),
        temperature_C=filled(rows.temperature_C, temperature_C),
        time_s=filled(rows.time_s, time_s),
    )


def open_target(model: FittedModel, frame: str) -> Iterator[str]:
    """Yield how well places of targets are known that no geometry shows, of a frame on the tool."""
    import numpy as np

    from pa10cal.fit.fitted import FLANGE, predicting_model
    from pa10cal.observe.instrument import target_coordinates

    used = predicting_model(model)
    fit = used.fitted_to
    if frame == FLANGE or fit is None or not fit.open_targets:
        return
    names = target_coordinates(used.target_names)
    for name in sorted({*fit.open_targets} & {*names}):
        at, u_mm = names.index(name), 0.0
        if used.covariance is not None:
            of_targets = np.diag(used.covariance)[-len(names) :]
            u_mm = 1e3 * float(np.sqrt(of_targets[at]))
        known = f"is known to {u_mm:.2g} mm" if u_mm else "is held where the search started"
        yield (
            f"{name}, {1e3 * used.targets_m[at]:.1f} mm, {known}, which u_mm does not hold: the "
            "geometry of the arm shows targets in the frame of the instrument alone; state "
            "tool.balls_mm"
        )


def assumptions(model: FittedModel, conditions: PoseConditions) -> Iterator[str]:
    """Yield what is assumed where rows do not state a condition, or no effect depends on it."""
    import numpy as np

    from pa10cal.fit.fitted import predicting_model

    used = predicting_model(model)
    depends_on = {term.depends_on for term in used.model.terms}
    if np.isfinite(conditions.time_s).any() and "time_s" not in depends_on:
        yield "time_s is not used: no effect of the model depends on time"
    if np.isfinite(conditions.temperature_C).any() and "temperature_C" not in depends_on:
        yield _unused_temperatures(used, conditions.temperature_C)
    for term in used.model.terms:
        if term.depends_on is None:
            continue
        missing = np.isnan(getattr(conditions, term.depends_on)).sum()
        if not missing:
            continue
        assumed = "the arm is taken to be warm"
        if term.of == "base":
            assumed = "the base is taken to be where T_instr_base of the model has it"
        if term.depends_on == "temperature_C":
            fit = used.fitted_to
            if fit is None or fit.temperature_C is None:
                continue
            assumed = f"the mean of the fit, {fit.temperature_C:.1f} °C, is taken"
            if fit.temperature_std_C:
                assumed += f"; u_mm holds its {fit.temperature_std_C:.1f} K of spread"
        yield f"{term.id} needs {term.depends_on}, which {missing} rows do not give: {assumed}"


def _unused_temperatures(model: Fitted, temperature_C: Array) -> str:
    """Return what becomes of temperatures (N,) [°C] on which no effect of a model depends."""
    import numpy as np

    from pa10cal.rules import LACK

    line = "temperature_C moves no pose: no effect of the model depends on temperature"
    fit = model.fitted_to
    if fit is None or fit.temperature_C is None:
        return f"{line}, and that of the fit is not known"
    away_K = np.abs(temperature_C - fit.temperature_C)
    unlike = away_K > LACK.usual_temperatures * (fit.temperature_std_C or 0.0)
    if not unlike.any():
        return line
    return (
        f"{line}; {np.count_nonzero(unlike)} rows are up to {np.nanmax(away_K):.1f} K from the mean"
        f" of the fit, {fit.temperature_C:.1f} °C: u_mm holds a growth of links by "
        f"{1e6 * LACK.growth_per_K:.0f} ppm/K"
    )


def warn_of(command: str, path: Path, contradictions: Iterable[str]) -> None:
    """Print a warning for each contradiction in a list of poses."""
    for contradiction in contradictions:
        print(f"pa10cal {command}: warning: {path}: {contradiction}", file=sys.stderr)


def notes_on(model: FittedModel) -> str:
    """Return, for the end of a line, what is used where effects hold nowhere; empty if they do."""
    if model.falls_back is None or not model.falls_back.within.nowhere:
        return ""
    used = "the calibrated model is used"
    if model.falls_back.model.model.terms_of("field"):
        used += ", with what has no name predicted beside it"
    return f"; its effects hold nowhere, as held-out poses showed: {used}"


def unused_columns(path: Path, rows: JointList | TargetList) -> str:
    """Return, for the end of a line, the columns of a list that are not read; empty for none."""
    if not rows.unused:
        return ""
    from pa10cal.campaign.raw_rows import load_hint

    return f"; not read of {path}: {', '.join(rows.unused)}{load_hint(rows.unused)}"


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
    from pa10cal.fit import misread_lists

    fitted = read_usable_model(model, force=force)
    listed = read_joints(joints, fitted.arm.axes_slide)
    conditions = conditions_of(listed, load_N, arrival, temperature_C, time_s)
    outside_count = 0
    blocks = fitted.predict_in_blocks(
        listed.q, frame=frame, **conditions._asdict(), extrapolate=force
    )
    with whole_file(out) as path, path.open("w", encoding="utf-8", newline="\n") as file:
        for rows, predicted in blocks:
            columns = {
                "u_mm": predicted.u_mm,
                "inside": predicted.inside,
                "u_parameters_mm": predicted.u_parameters_mm,
            }
            if needs_force(fitted):
                columns["forced"] = np.full(len(predicted), fitted.grade)
            first = rows.start == 0
            file.write(poses_text(listed.ids[rows], predicted.T, columns, header=first))
            outside_count += int(np.count_nonzero(~predicted.inside))
    warn_of("predict", joints, misread_lists.of_joints(fitted, listed.q))
    print(
        f"{out}: {frame} of {fitted.arm.name} at {len(listed.ids)} joint positions, "
        f"{outside_count} of them away from the poses of the fit"
        f"{notes_on(fitted)}{unused_columns(joints, listed)}"
    )
    for line in (*open_target(fitted, frame), *assumptions(fitted, conditions)):
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

    from pa10cal.arm.controller_poses import controller_pose
    from pa10cal.campaign.pose_lists import read_targets
    from pa10cal.fit import misread_lists

    convention: Angles = angles or "quaternion"
    if write == "joints" and (angles or tcp or controller):
        raise ModelError(
            "for poses of a controller, and joint positions are written",
            where="--angles" if angles else "--tcp" if tcp else "--controller",
            value=angles or tcp or controller,
            allowed="--write cartesian",
            remedy="add --write cartesian, or leave the option out",
        )
    fitted = read_usable_model(model, force=force)
    arm = fitted.arm
    controller_arm = _controller_arm(arm, controller, needed=write == "cartesian")
    listed = read_targets(targets, arm.axes_slide)
    conditions = conditions_of(listed, load_N, arrival, temperature_C, time_s)

    def compensated(T: Array, **options: Any) -> Compensation:
        under = {**conditions._asdict(), **options}
        return fitted.compensate(T, frame=frame, seed=listed.q, extrapolate=force, **under)

    found = compensated(
        listed.T,
        T_flange_tcp=controller_pose(tcp, convention) if tcp else None,
        controller=controller_arm,
    )
    poses_to_send = found.cartesian(convention) if write == "cartesian" else {}
    _write_commands(out, listed.ids, fitted, found, poses_to_send)

    warnings = list(misread_lists.of_targets(fitted, listed.T, listed.q, frame))
    if not warnings:
        warnings = list(misread_lists.of_answers(listed.T, found, compensated))
    warn_of("compensate", targets, warnings)
    words, counts = np.unique(found.status, return_counts=True)
    outcome = ", ".join(f"{count} {word}" for word, count in zip(words, counts, strict=True))
    other_branch = int(np.count_nonzero(found.branch == "other"))
    if other_branch:
        outcome += f"; {other_branch} on another branch, far from the row before or the seed"
    outcome += notes_on(fitted) + unused_columns(targets, listed)
    print(f"{out}: {len(found)} targets of the {frame} of {arm.name}: {outcome}")
    for line in (*open_target(fitted, frame), *assumptions(fitted, conditions)):
        print(line)
    if write == "cartesian":
        tcp_text = _tcp_text(found.T_flange_tcp, convention)
        model_text = _controller_model(arm, controller_arm)
        print(f"send_… are for a controller with {model_text} and this TCP: {tcp_text}")


def _controller_arm(arm: Arm, controller: str | None, *, needed: bool) -> Arm | None:
    """Return the arm that the controller computes with: the one named, else what the model states.

    None if neither is known; that is refused where it is needed.
    """
    from pa10cal.arm.chain import refuse_another_robot
    from pa10cal.files.arms import arm_asked
    from pa10cal.fit.fitted import unknown_controller

    if controller is not None:
        named = arm_asked(controller, Path())
        refuse_another_robot(arm, named, "--controller")
        return named
    if needed and arm.controller_arm is None:
        raise unknown_controller()
    return arm.controller_arm


def _write_commands(
    out: Path,
    ids: NDArray[np.str_],
    fitted: FittedModel,
    found: Compensation,
    poses_to_send: Mapping[str, NDArray[Any]],
) -> None:
    """Write a row for each target: name (N,), joint positions, status, and the pose to send."""
    import numpy as np

    from pa10cal.campaign.pose_lists import commands_text
    from pa10cal.files.output import whole_file
    from pa10cal.fit.loads import blocks

    columns = {
        "status": found.status,
        "error_mm": found.error_mm,
        "u_mm": found.u_mm,
        "u_parameters_mm": found.u_parameters_mm,
        "error_deg": found.error_deg,
        "inside": found.inside,
        "branch": found.branch,
        **poses_to_send,
    }
    if needs_force(fitted):
        columns["forced"] = np.full(len(found), fitted.grade)
    slide = fitted.arm.axes_slide
    with whole_file(out) as path, path.open("w", encoding="utf-8", newline="\n") as file:
        for rows in blocks(len(found)):
            of_rows = {name: values[rows] for name, values in columns.items()}
            first = not len(rows) or rows[0] == 0
            file.write(commands_text(ids[rows], found.q[rows], slide, of_rows, header=first))


def _tcp_text(T_flange_tcp: Array, convention: Angles) -> str:
    """Return a TCP (4, 4) in the flange as a controller states it."""
    from pa10cal.arm.controller_poses import controller_columns

    columns = controller_columns(T_flange_tcp[None], convention)
    # Rounding errors such as -1e-17 become 0: they are no numbers to type into a controller.
    numbers = {name: round(float(values[0]), 9) + 0.0 for name, values in columns.items()}
    return ", ".join(f"{name} {number:.6g}" for name, number in numbers.items())


def _controller_model(arm: Arm, controller_arm: Arm | None) -> str:
    """Return in words the model with which the controller computes."""
    if controller_arm is not None and controller_arm is not arm:
        return f"the model of {controller_arm.name}"
    if arm.controller is None:
        return "the nominal model (its own compensation must be off, or stated in campaign.yaml)"
    if arm.controller.compensation:
        return f"the model of {arm.name}, its compensation on,"
    return "the nominal model, its compensation off,"


#: Most parameters that are shown, and the least difference [standard uncertainties] of one.
_MOST_SHOWN, _LEAST_SHOWN = 5, 3.0


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
    from pa10cal.fit.model_reading import load_model
    from pa10cal.results.codec import write

    models = load_model(first), load_model(second)
    comparison = compare_models(*models, names=(str(first), str(second)))
    if out is not None:
        write(comparison, out)
    print("\n".join(_comparison_lines(comparison)))


def _comparison_lines(comparison: ComparisonRecord) -> Iterator[str]:
    """Yield what a reader is shown: models, frames, parameters that differ most, the sentence."""
    for number, model in enumerate((comparison.first, comparison.second), start=1):
        fit = f"{model.calibration} of {model.campaign}" if model.campaign else "not known"
        grade = model.grade or "not known"
        yield f"{number}  {model.name}: {model.robot}, fit {fit}, grade {grade}"
        if model.only_here:
            yield f"   only here: {', '.join(model.only_here)}"
    if comparison.described_otherwise:
        yield f"described otherwise: {', '.join(comparison.described_otherwise)}"
    if comparison.frames:
        yield ""
        over = f"over {comparison.postures} postures"
        yield f"{over:<24}{'rms mm':>9}{'peak mm':>9}{'rms deg':>10}"
        for name, frame in comparison.frames.items():
            yield _row(f"{name}, as predicted", frame.rms_mm, frame.peak_mm, frame.orientation_deg)
            yield _row("  base and tool explain", frame.base_and_tool_mm)
            yield _row(
                "  remains", frame.remaining_rms_mm, frame.remaining_peak_mm, frame.remaining_deg
            )
            if frame.expected_mm is not None:
                yield _row("  expected to remain", frame.expected_mm, None, frame.expected_deg)
    rows = comparison.parameters
    differing = [k for k, over_u in enumerate(rows.over_u) if abs(over_u) >= _LEAST_SHOWN]
    differing.sort(key=lambda k: -abs(rows.over_u[k]))
    if differing:
        yield ""
        yield "parameters that differ most, in standard uncertainties of the difference"
        for k in differing[:_MOST_SHOWN]:
            name = f"{rows.parameter[k]} ({rows.term[k]} of {rows.of[k]})"
            values = f"{rows.first[k]:.6g} and {rows.second[k]:.6g} {rows.unit[k]}"
            yield f"  {name:<44} {rows.over_u[k]:+8.1f}  {values}"
    yield ""
    yield comparison.line
    if comparison.what_moved is not None:
        yield f"between both campaigns: {comparison.what_moved.line}"
        if comparison.what_moved.verdict not in ("unchanged", "not_comparable"):
            yield (
                "if the robot was hit or mended in between, the first model as a prior needs fewer "
                "poses of the second campaign: pa10cal run CAMPAIGN --prior "
                f"{comparison.first.name}"
            )


def _row(title: str, rms: float, peak: float | None = None, deg: float | None = None) -> str:
    peak_shown = "" if peak is None else f"{peak:.3f}"
    deg_shown = "" if deg is None else f"{deg:.4f}"
    return f"{title:<24}{rms:>9.3f}{peak_shown:>9}{deg_shown:>10}".rstrip()


def drift(models: tuple[Path, ...], *, out: Path, figures: Path | None = None) -> None:
    """Show the parameters of one arm over its campaigns, and what moved between them.

    Args:
        models: model.yaml of every campaign, or the results that hold it, in order of time.
        out: every parameter that poses determine with its interval, but for curves of more than 24
            parameters, and what moved from each campaign to the next and from the first to the
            last, to write (.json).
        figures: folder for a figure of the same name.

    Examples:
        pa10cal drift results/june results/july results/august --out drift.json --figures figures
    """
    from pa10cal.evaluation.what_moved import drift as drift_of
    from pa10cal.fit.model_reading import load_model
    from pa10cal.results.codec import write

    fitted = [load_model(path) for path in models]
    names = [
        model.fitted_to.campaign if model.fitted_to else str(path)
        for path, model in zip(models, fitted, strict=True)
    ]
    if len(set(names)) < len(names):
        names = [str(path) for path in models]
    record = drift_of(fitted, names)
    write(record, out)
    if figures is not None:
        from pa10cal.command_settings import FigureOptions
        from pa10cal.figures.draw import write_drift

        write_drift(record, figures, out.stem, FigureOptions().png_dpi)
    for step in (*record.steps, *([record.overall] if record.overall else [])):
        print(f"{step.first} to {step.second}: {step.what_moved.line}")
