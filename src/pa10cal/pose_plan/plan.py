"""Which poses to measure: chosen by what they are expected to say of the model and of effects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.distance import cdist

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.room import Candidates
from pa10cal.arrays import Array, Index
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.raw_rows import position_columns
from pa10cal.errors import CalibrationError, SettingsError
from pa10cal.files.output import whole_files
from pa10cal.numerics.exchange import (
    Combined,
    Criterion,
    ExchangeResult,
    Information,
    covariance_root,
    exchange,
    one_by_one,
)
from pa10cal.observe.instrument import Instrument
from pa10cal.pose_plan.candidates import (
    ExpectedRows,
    draw_candidates,
    expect,
    instrument_named,
    targets_of,
)
from pa10cal.pose_plan.options import KeepOut, KeepOutBox, PlanOptions
from pa10cal.results import plan as records
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import read_yaml

#: Sets drawn at random, to hold the plan against.
_RANDOM_SETS = 20
#: Turns of the exchange through all poses: among many poses there is little left to gain.
_MOST_SWEEPS, _POSE_SWEEPS = 20, 600
#: A parameter is identified where its uncertainty falls below this part of what is possible.
_IDENTIFIED = 0.3


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to measure, in the order in which to drive to them, and what to expect of them."""

    arm: Arm  # the nominal arm
    kind: type[Instrument]  # what measures
    options: PlanOptions  # what was wanted
    q: Array  # (N, n) joint positions [rad, or m of a prismatic joint]
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
    """Choose poses to measure.

    By where arm and instrument may be and what is measured, and how it will be calibrated; None for
    the defaults.

    Raises:
        CalibrationError: for an instrument that does not exist, too few poses for the unknowns, or
            too few poses within all limits.
    """
    options, calibration = options or PlanOptions(), calibration or CalibrationOptions()
    kind = instrument_named(instrument)
    targets_m = np.array(list(targets_of(kind, options).values()))
    candidates = draw_candidates(arm, targets_m, options, least=poses)
    rows = expect(arm, kind, candidates.q, options, calibration)
    a_pose = rows.white.shape[1]
    needed = -(-rows.unknowns // a_pose)
    if poses < needed:
        raise CalibrationError(
            "fewer equations than unknowns",
            where="poses",
            value=f"{poses} poses with {a_pose} equations each, {rows.unknowns} unknowns",
            allowed=f"at least {needed} poses; twice as many show errors of the measurement too",
            remedy="plan more poses",
        )
    found = _choose(rows, poses, options.effects)
    order = short_path(candidates.q[found.chosen])
    return _planned(arm, kind, options, candidates, rows, found.chosen[order], found.values)


def _choose(rows: ExpectedRows, poses: int, effects: float) -> ExchangeResult:
    """Choose poses.

    The criterion is the log determinant of the information about the model's parameters, and that
    about the effects once the model is projected out, each a parameter on average. Effects count by
    their part, 0 to 1.
    """
    k, every = rows.unknowns, rows.white.shape[2]
    criterion: Criterion = Information(np.ascontiguousarray(rows.white[..., :k]))
    if every > k:
        of_effects = effects * k / (every - k)
        of_model = 1.0 - effects - of_effects
        criterion = Combined([criterion, Information(rows.white)], [of_model, of_effects])
    sweeps = int(np.clip(_POSE_SWEEPS // poses, 1, _MOST_SWEEPS))
    return exchange(criterion, one_by_one(criterion, poses), most_sweeps=sweeps)


def _planned(
    arm: Arm,
    kind: type[Instrument],
    options: PlanOptions,
    candidates: Candidates,
    rows: ExpectedRows,
    chosen: Index,
    values: tuple[float, ...],
) -> PosePlan:
    """Return a plan of poses chosen, with all that is expected of them."""
    k = rows.unknowns
    covariance = covariance_of(rows.white[chosen][..., :k])
    part, q = np.sqrt(np.diag(covariance)), candidates.q[chosen]
    rng = np.random.default_rng(options.random_seed)
    count = len(rows.white)
    others = [rng.choice(count, len(chosen), replace=False) for _ in range(_RANDOM_SETS)]
    at_random = [rms_mm(rows.tool, covariance_of(rows.white[o][..., :k])) for o in others]
    target_m = next(iter(targets_of(kind, options).values()))
    T = Chain.of(arm).forward(q)
    p_m, u_mm = T[:, :3, 3] + T[:, :3, :3] @ target_m, _u_mm(rows.tool[chosen], covariance)
    in_files = np.where(arm.prismatic, 1e3 * q, np.degrees(q)).tolist()
    rows_of = zip(in_files, p_m, u_mm, strict=True)
    expected = records.PlanRecord(
        robot=arm.name,
        instrument=kind.kind,
        poses=tuple(
            records.PlannedPose(id=f"P{k}", q=tuple(at), target_mm=1e3 * p, u_tool_mm=float(u))
            for k, (at, p, u) in enumerate(rows_of, start=1)
        ),
        tool=records.ToolExpected(
            plan_mm=rms_mm(rows.tool, covariance), random_mm=float(np.median(at_random))
        ),
        parameters={
            parameter.name: records.ExpectedParameter(std=float(u), unit=parameter.unit)
            for parameter, u in zip(rows.parameters, part * rows.sizes, strict=True)
        },
        not_identified=tuple(
            parameter.name
            for parameter, remaining in zip(rows.parameters, part, strict=True)
            if remaining > _IDENTIFIED
        ),
        springs=rows.springs,
        effects=_effects(rows, chosen),
        criterion=values,
        candidates=len(candidates.q),
        drawn=candidates.drawn,
        removed=candidates.removed,
        travel=path_length(q),
        options=options.model_dump(mode="json"),
    )
    return PosePlan(arm, kind, options, q, p_m, u_mm, expected)


def covariance_of(white: Array) -> Array:
    """Return the covariance (k, k) of unknowns in the sizes expected of them."""
    k = white.shape[2]
    root = covariance_root(np.concatenate([white.reshape(-1, k), np.eye(k)]))
    covariance: Array = root @ root.T
    return covariance


def _u_mm(tool: Array, covariance: Array) -> Array:
    """Return the standard uncertainty of the tool's position in poses, (P,)."""
    variance = np.einsum("pik,pik->p", tool, tool @ covariance)
    return np.asarray(1e3 * np.sqrt(np.maximum(variance, 0.0)))


def rms_mm(tool: Array, covariance: Array) -> float:
    """Return the same, root mean square over the poses."""
    return float(np.sqrt(np.mean(_u_mm(tool, covariance) ** 2)))


def _effects(rows: ExpectedRows, chosen: Index) -> tuple[records.ExpectedEffect, ...]:
    """Return how well each effect would show, alone and among all others."""
    if not rows.effects:
        return ()
    k, white = rows.unknowns, rows.white[chosen]
    among = np.diag(covariance_of(white))
    found = []
    for effect, columns in rows.effects.items():
        own = np.concatenate([white[..., :k], white[..., columns]], axis=2)
        alone = np.diag(covariance_of(own))[k:]
        found.append(
            records.ExpectedEffect(
                id=effect.id,
                of=effect.of,
                u_alone=float(np.sqrt(alone.mean())),
                u_among_all=float(np.sqrt(among[columns].mean())),
            )
        )
    return tuple(found)


# The order in which to drive to poses: near the shortest way.

_MOST_ROUNDS = 50
_SHORTER = 1e-9


def short_path(q: Array) -> Index:
    """Return poses (N, n) in an order in which the joints travel little.

    A move takes as long as the joint that turns furthest. The nearest pose not yet visited comes
    next, from the best of all starts; then stretches are turned round as long as that is shorter
    (2-opt). Whether arm or tool meets something between two poses is not looked at.
    """
    if len(q) < 3:
        return np.arange(len(q), dtype=np.intp)
    away = cdist(q, q, metric="chebyshev")
    starts = [_nearest_next(away, first) for first in range(len(q))]
    order = min(starts, key=lambda each: float(away[each[:-1], each[1:]].sum()))
    for _ in range(_MOST_ROUNDS):
        turned = _turned_round(away, order)
        if turned is None:
            break
        order = turned
    return order


def path_length(q: Array) -> float:
    """Return the sum over moves of the furthest that a joint turns, in the order given."""
    return float(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0).sum())


def _nearest_next(away: Array, first: int) -> Index:
    left = away.copy()
    order = [first]
    for _ in range(len(away) - 1):
        left[:, order[-1]] = np.inf
        order.append(int(np.argmin(left[order[-1]])))
    return np.array(order, dtype=np.intp)


def _turned_round(away: Array, order: Index) -> Index | None:
    """Return the path with the one stretch turned round that makes it shortest; None: none does.

    An end of the path has no neighbour, so that a stretch up to it may be turned for free.
    """
    count = len(order)
    between = np.zeros((count + 1, count + 1))  # the last place is nowhere
    between[:count, :count] = away[np.ix_(order, order)]
    first, last = np.triu_indices(count, k=1)
    before, after = first - 1, np.where(last + 1 < count, last + 1, -1)
    now = between[before, first] + between[last, after]
    then = between[before, last] + between[first, after]
    best = int(np.argmin(then - now))
    if then[best] >= now[best] - _SHORTER:
        return None
    turned = order.copy()
    turned[first[best] : last[best] + 1] = order[first[best] : last[best] + 1][::-1]
    return turned


# Files of a plan: boxes to keep out of, the poses, and what to expect of them.

_PLACE = ("x_mm", "y_mm", "z_mm")


def read_keep_out(path: Path) -> tuple[KeepOutBox, ...]:
    """Read boxes to keep out of: a list of {min_mm, max_mm, name}.

    Raises:
        SettingsError: when the file cannot be read, holds no list, or a box has no volume.
    """
    content = read_yaml(path, SettingsError, what="the boxes to keep out of cannot be read")
    if not isinstance(content, list):
        raise SettingsError(
            "the file holds no list of boxes",
            where=str(path),
            value=content,
            allowed="a list of {min_mm: [x, y, z], max_mm: [x, y, z], name: ...}",
            remedy="begin every box with a hyphen, see docs/plan.md",
        )
    return parse_section(KeepOut, {"boxes": content}, where=str(path)).boxes


def plan_text(plan: PosePlan) -> str:
    """Return the poses as `id,q1_deg,…,x_mm,y_mm,z_mm,u_tool_mm`."""
    lines = [",".join(["id", *position_columns(plan.arm.prismatic), *_PLACE, "u_tool_mm"])]
    for pose in plan.expected.poses:
        words = [f"{value:.3f}" for value in (*pose.q, *pose.target_mm)]
        lines.append(",".join([pose.id, *words, f"{pose.u_tool_mm:.4f}"]))
    return "\n".join(lines) + "\n"
