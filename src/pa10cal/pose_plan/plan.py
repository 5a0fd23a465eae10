"""A plan of poses: chosen by D-optimal exchange, put in an order of short moves, and predicted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arm import workspace
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.joint_positions import position_columns
from pa10cal.errors import CalibrationError
from pa10cal.files.output import whole_files
from pa10cal.files.table_cells import csv_text
from pa10cal.numerics.pose_sets import (
    Combined,
    Criterion,
    ExchangeResult,
    Information,
    exchange,
    greedy_order,
    path_length,
    short_path,
)
from pa10cal.observe.instrument import Instrument
from pa10cal.pose_plan.expected import (
    ExpectedRows,
    covariance_of,
    expected_rows,
    target_rms_u_mm,
    target_u_mm,
)
from pa10cal.pose_plan.options import PlanOptions
from pa10cal.pose_plan.setup import PlanSetup, instrument_named
from pa10cal.results import plan as records

#: Random sets of candidates that the plan is compared with.
_RANDOM_SETS = 20
#: Sweeps of the exchange over the chosen poses: this number over theirs, and at most so many.
_POSE_SWEEPS, _MOST_SWEEPS = 600, 20
#: A parameter is identified where its standard deviation falls below this part of its prior one.
_IDENTIFIED = 0.3
_POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to measure, in the order in which to drive to them, and what to expect of them."""

    arm: Arm  # the nominal arm
    kind: type[Instrument]  # what measures
    options: PlanOptions  # what was wanted
    q: Array  # (N, n) positions to command [rad, or m of a prismatic joint]
    p_base_target_m: Array  # (N, 3) where the first target comes, by the nominal arm
    u_tool_mm: Array  # (N,) expected standard uncertainty of that position after the calibration
    expected: records.PlanRecord  # what to expect of the poses together, as plan.json holds it

    def __len__(self) -> int:
        return len(self.q)

    def save(self, path: str | Path) -> None:
        """Write the poses as a CSV file, and what to expect of them as a JSON file beside it.

        Raises:
            OutputError: when they cannot be written there.
        """
        path = Path(path)
        expected = self.expected.model_dump_json(indent=1) + "\n"
        with whole_files(path, path.with_suffix(".json")) as (poses, beside):
            poses.write_text(plan_text(self), encoding="utf-8", newline="\n")
            beside.write_text(expected, encoding="utf-8", newline="\n")


def plan_poses(
    arm: Arm,
    instrument: str,
    poses: int,
    options: PlanOptions | None = None,
    calibration: CalibrationOptions | None = None,
) -> PosePlan:
    """Choose poses to measure with the instrument of this name.

    Args:
        poses: how many.
        options: where arm and instrument may be, and what is measured; None for the defaults.
        calibration: how the poses will be calibrated with; None for the defaults.

    Raises:
        CalibrationError: for an instrument that does not exist, too few poses for the unknowns, or
            too few poses within all limits.
        SettingsError: for `facing_deg` without `instrument_at_mm`.
    """
    options, calibration = options or PlanOptions(), calibration or CalibrationOptions()
    setup = PlanSetup(arm, instrument_named(instrument), options)
    candidates = setup.draw(least=poses)
    rows = expected_rows(setup, candidates.q, calibration)
    a_pose, unknowns = rows.white.shape[1], len(rows.parameters)
    needed = -(-unknowns // a_pose)
    if poses < needed:
        raise CalibrationError(
            "fewer equations than unknowns",
            where="poses",
            value=f"{poses} poses with {a_pose} equations each, {unknowns} unknowns",
            allowed=f"at least {needed} poses; twice as many show errors of the measurement too",
            remedy="plan more poses",
        )
    exchanged = _choose(rows, poses, options.effects)
    order = short_path(arm.coupling.to_axes(candidates.q[exchanged.chosen]))
    return _planned(setup, candidates, rows, exchanged.chosen[order], exchanged.values)


def _choose(rows: ExpectedRows, poses: int, effects_share: float) -> ExchangeResult:
    """Choose poses by exchange.

    With M and A the information matrices of the k parameters alone and together with e parameters
    of effects, the criterion is (1 - w) log det M + w (k / e) (log det A - log det M), w the share
    of effects: the second difference is the information about effects with the model eliminated.
    """
    k, count = len(rows.parameters), rows.white.shape[2]
    criterion: Criterion = Information(np.ascontiguousarray(rows.of_model))
    if count > k:
        effects_weight = effects_share * k / (count - k)
        weights = np.array([1.0 - effects_share - effects_weight, effects_weight])
        criterion = Combined([criterion, Information(rows.white)], lambda values: weights @ values)
    sweeps = int(np.clip(_POSE_SWEEPS // poses, 1, _MOST_SWEEPS))
    return exchange(criterion, greedy_order(criterion, poses), most_sweeps=sweeps)


def _planned(
    setup: PlanSetup,
    candidates: workspace.Candidates,
    rows: ExpectedRows,
    chosen: Index,
    criterion: tuple[float, ...],
) -> PosePlan:
    """Return the plan of the chosen candidates, with all that is expected of them."""
    arm, options = setup.arm, setup.options
    covariance = covariance_of(rows.of_model[chosen])
    std = np.sqrt(np.diag(covariance))  # in units of the prior standard deviations
    rng = np.random.default_rng(options.random_seed)
    random_sets = [
        rng.choice(len(rows.white), len(chosen), replace=False) for _ in range(_RANDOM_SETS)
    ]
    random_mm = [
        target_rms_u_mm(rows.target_jacobian, covariance_of(rows.of_model[some]))
        for some in random_sets
    ]
    T = Chain.of(arm).forward(candidates.q[chosen])
    q = arm.coupling.to_axes(candidates.q[chosen])
    p_m = T[:, :3, 3] + T[:, :3, :3] @ next(iter(setup.targets.values()))
    u_mm = target_u_mm(rows.target_jacobian[chosen], covariance)
    in_files = np.where(arm.axes_slide, 1e3 * q, np.degrees(q)).tolist()
    expected = records.PlanRecord(
        robot=arm.name,
        instrument=setup.kind.kind,
        poses=tuple(
            records.PlannedPose(
                id=f"P{number}", q=tuple(position), target_mm=1e3 * p, u_tool_mm=float(u)
            )
            for number, (position, p, u) in enumerate(zip(in_files, p_m, u_mm, strict=True), 1)
        ),
        tool=records.ToolExpected(
            plan_mm=target_rms_u_mm(rows.target_jacobian, covariance),
            random_mm=float(np.median(random_mm)),
        ),
        parameters={
            parameter.name: records.ExpectedParameter(std=float(u), unit=parameter.unit)
            for parameter, u in zip(rows.parameters, std * rows.sizes, strict=True)
        },
        not_identified=tuple(
            parameter.name
            for parameter, remaining in zip(rows.parameters, std, strict=True)
            if remaining > _IDENTIFIED
        ),
        springs=rows.springs,
        effects=_expected_effects(rows, chosen),
        criterion=criterion,
        candidates=len(candidates.q),
        drawn=candidates.drawn,
        removed=candidates.removed,
        travel=path_length(q),
        options=options.model_dump(mode="json"),
    )
    return PosePlan(arm, setup.kind, options, q, p_m, u_mm, expected)


def _expected_effects(rows: ExpectedRows, chosen: Index) -> tuple[records.ExpectedEffect, ...]:
    """Return the expected uncertainty of each effect: alone beside the model, and among all."""
    if not rows.effects:
        return ()
    k, white = len(rows.parameters), rows.white[chosen]
    variance_among_all = np.diag(covariance_of(white))
    expected = []
    for effect, columns in rows.effects.items():
        beside_model = np.concatenate([white[..., :k], white[..., columns]], axis=2)
        variance_alone = np.diag(covariance_of(beside_model))[k:]
        expected.append(
            records.ExpectedEffect(
                id=effect.id,
                of=effect.of,
                u_alone=float(np.sqrt(variance_alone.mean())),
                u_among_all=float(np.sqrt(variance_among_all[columns].mean())),
            )
        )
    return tuple(expected)


def plan_text(plan: PosePlan) -> str:
    """Return the poses as CSV: `id,q1_deg,…,x_mm,y_mm,z_mm,u_tool_mm`."""
    header = ["id", *position_columns(plan.arm.axes_slide), *_POSITION_COLUMNS, "u_tool_mm"]
    rows = []
    for pose in plan.expected.poses:
        cells = [f"{value:.3f}" for value in (*pose.q, *pose.target_mm)]
        rows.append([pose.id, *cells, f"{pose.u_tool_mm:.4f}"])
    return csv_text(header, rows)
