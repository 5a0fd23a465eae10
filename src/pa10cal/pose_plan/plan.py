"""Which poses to measure: chosen by what they are expected to say of the model and of effects.

Candidates are spread evenly over the joints' ranges, within all limits. Rows are those of the
general calibration at the nominal arm: what a pose says of the parameters and of missing effects
hardly depends on their values, and not at all on what is read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, starmap
from pathlib import Path

import numpy as np
from scipy.spatial.distance import cdist

from pa10cal.arm import room
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.calibration.general.problem import GeneralProblem, general_problem
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.raw_rows import position_columns
from pa10cal.discovery.linear import by_effects
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of, why_unknown
from pa10cal.errors import CalibrationError, SettingsError, remedy_for
from pa10cal.files.output import csv_text, whole_files
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.exchange import (
    Combined,
    Criterion,
    ExchangeResult,
    Information,
    covariance_root,
    exchange,
    greedy_order,
)
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start, Stated, by_end_and_targets, carried_targets
from pa10cal.pose_plan.options import KeepOut, KeepOutBox, PlanOptions
from pa10cal.results import plan as records
from pa10cal.settings_reading import parse_section
from pa10cal.terms.effects.effect import Effect, candidates
from pa10cal.terms.term import TermParameter
from pa10cal.yaml_file import read_yaml

_MM = 1e-3
#: There is something to choose among so many candidates for each pose.
_FOR_EACH = 3
#: The tool stays off the base's axis, and targets off the lines from joint to joint, by these parts
#: of the arm's reach: about how thick arms are.
_COLUMN_SHARE = 0.1
_CLEARANCE_SHARE = 0.05
_TEMPERATURE_C = 20.0
#: Where targets sit by default: so far in front of the flange, and off its axis [m].
_AHEAD_M, _OFF_M = 0.1, 0.06
_SEVERAL = 3
#: Where an instrument is whose place is not given: so many reaches of the arm in front of it.
_STANDS_OFF = 1.5


@dataclass(frozen=True)
class PlanSetup:
    """An arm under an instrument, and the options of a plan."""

    arm: Arm  # the nominal arm
    kind: type[Instrument]  # what measures
    options: PlanOptions  # where arm and instrument may be, and what is measured

    @property
    def joint_ranges(self) -> tuple[Array, Array]:
        """Return the least and largest positions of a plan's axes, (m,) each [rad, m].

        Raises:
            CalibrationError: when ranges are given and are not one a joint, within its limits.
        """
        arm, options = self.arm, self.options
        low, high = arm.axis_limits_rad.T
        if options.joints_deg:
            unit = np.where(arm.axes_slide, _MM, np.radians(1.0))
            given = np.array(options.joints_deg, dtype=float)
            if len(given) != len(unit):
                raise CalibrationError(
                    "not one range a joint",
                    where="joints_deg",
                    value=f"{len(given)} ranges",
                    allowed=f"{len(unit)} ranges, least and largest",
                    remedy="give one range a joint",
                )
            first, last = given.T * unit
            wrong = (first > last) | (first < low - 1e-9) | (last > high + 1e-9)
            if wrong.any():
                joint = int(np.argmax(wrong))
                raise CalibrationError(
                    "the range is none, or leaves the joint's limits",
                    where=f"joints_deg of joint {joint + 1}",
                    value=tuple(given[joint].tolist()),
                    allowed=f"{low[joint] / unit[joint]:.1f} to {high[joint] / unit[joint]:.1f}",
                    remedy="correct the range",
                )
            return first, last
        margin = options.limit_margin * (high - low)
        widest = np.where(arm.axes_slide, np.inf, np.radians(options.largest_angle_deg))
        return np.maximum(low + margin, -widest), np.minimum(high - margin, widest)

    @property
    def constraints(self) -> dict[str, room.Constraint]:
        """Return where arm and tool may be, by the option that says so, the quickest first."""
        options, reach_m = self.options, self.arm.reach_m
        found: dict[str, room.Constraint] = {}
        if options.workspace_mm is not None:
            corners = _MM * np.array(options.workspace_mm)
            found["workspace_mm"] = room.within(room.Box(corners.min(axis=0), corners.max(axis=0)))
        if options.reach_mm is not None:
            found["reach_mm"] = room.reach(_MM * options.reach_mm)
        if options.floor_mm is not None:
            found["floor_mm"] = room.above(_MM * options.floor_mm)
        found["the tool off the base's axis"] = room.off_column(_COLUMN_SHARE * reach_m)
        found["the tool off the links"] = room.off_links(_CLEARANCE_SHARE * reach_m)
        boxes = []
        for number, given in enumerate(options.keep_out, start=1):
            boxes.append(room.Box(_MM * np.array(given.min_mm), _MM * np.array(given.max_mm)))
            found[f"keep-out {number} ({given.name})"] = room.keep_out(boxes[-1])
        if options.instrument_at_mm is not None:
            at = _MM * np.array(options.instrument_at_mm)
            if options.facing_deg is not None:
                most_rad = float(np.radians(options.facing_deg))
                found["facing_deg"] = room.facing(at, np.array([0.0, 0.0, 1.0]), most_rad)
            if boxes:
                found["line of sight"] = room.in_sight(at, boxes)
        return found

    @property
    def targets(self) -> dict[str, Array]:
        """Return the targets on the end, (3,) each [m], by name."""
        kind = self.kind
        given = _MM * np.array(self.options.targets_mm, dtype=float).reshape(-1, 3)
        if not len(given):
            # Off the last joint's axis, unless an orientation shows what that joint does.
            count = _SEVERAL if kind.several_targets or kind.from_touches else 1
            off_m = 0.0 if kind.measures_pose and not kind.from_touches else _OFF_M
            angle = 2.0 * np.pi * np.arange(count) / count
            around = off_m * np.column_stack([np.cos(angle), np.sin(angle)])
            given = np.column_stack([around, np.full(count, _AHEAD_M)])
        return {f"T{number}": place for number, place in enumerate(given, start=1)}

    @property
    def instrument_place_m(self) -> Array:
        """Return where the instrument is, (3,) in the base frame."""
        if self.options.instrument_at_mm is not None:
            return _MM * np.array(self.options.instrument_at_mm)
        return np.array([_STANDS_OFF * self.arm.reach_m, 0.0, 0.0])

    @property
    def payload(self) -> Payload | None:
        """Return what the arm carries; None where the masses of its links are not known."""
        if self.arm.mass_kg is None:
            return None
        mass_kg, com_m = self.options.tool_kg, _MM * np.array(self.options.tool_com_mm)
        gravity = np.array(self.options.gravity_m_s2)
        return Payload(mass_kg or 0.0, com_m, com_m, gravity, known=mass_kg is not None)

    def draw(self, least: int) -> room.Candidates:
        """Draw poses within all constraints: as many as wanted, and some for each that is needed.

        Raises:
            CalibrationError: when too few are left, saying which constraint removed how many.
        """
        options, targets_m = self.options, np.array(list(self.targets.values()))
        wanted = max(options.candidates, _FOR_EACH * least)
        chain, limits = Chain.of(self.arm), (self.joint_ranges, self.constraints)
        found = room.draw_within(chain, targets_m, *limits, wanted, options.random_seed)
        if len(found.q) >= least:
            return found
        removed = {name: number for name, number in found.removed.items() if number}
        worst = max(removed, key=lambda name: removed[name])
        each = "; ".join(f"{name}: {number}" for name, number in removed.items())
        raise CalibrationError(
            "hardly any pose keeps within all limits" if len(found.q) else "no pose is left",
            where="poses drawn within the joint limits",
            value=f"{len(found.q)} of {found.drawn}; removed, one after the other: {each}",
            allowed=f"at least {least}",
            remedy=f"allow more room, first of all for: {worst}",
        )

    def expect(self, q: Array, calibration: CalibrationOptions) -> ExpectedRows:
        """Return the rows of poses at joint positions (N, n) [rad, or m of a prismatic joint]."""
        observations, start = self._foreseen(q)
        posed = general_problem(self.arm, observations, start, self.payload, calibration)
        problem, x = posed.problem, posed.x_start
        every = possible_sizes(problem.model, problem.observations.measured)
        of_model = len(problem.model.parameters)
        sizes = np.concatenate([every[:of_model], every[of_model + problem.places]])
        rows = problem.rows(x).jacobian * sizes
        wanted = self.options.effects > 0.0
        found = _effects(posed, self.payload, self.targets) if wanted else {}
        stops = len(sizes) + np.cumsum([0, *(columns.shape[2] for columns in found.values())])
        root = np.linalg.cholesky(problem.stated_covariance)
        white = np.linalg.solve(root, np.concatenate([rows, *found.values()], axis=2))
        unloaded = np.arange(0, len(white), len(self.options.loads_N))
        return ExpectedRows(
            parameters=problem.parameters,
            sizes=sizes,
            white=white.reshape(len(q), -1, white.shape[2]),
            tool=_tool(posed)[unloaded] * sizes,
            effects=dict(zip(found, starmap(slice, pairwise(stops.tolist())), strict=True)),
            springs=posed.springs,
        )

    def _foreseen(self, q: Array) -> tuple[Observations, Start]:
        """Return every pose under every load, as the instrument would see the nominal arm."""
        kind, options, places = self.kind, self.options, self.targets
        targets_m = np.array(list(places.values()))
        T_instr_base = np.eye(4)
        T_instr_base[:3, 3] = -self.instrument_place_m
        q = np.repeat(q, len(options.loads_N), axis=0)
        count = len(q)
        T_instr_ee = T_instr_base @ Chain.of(self.arm).forward(q)
        attitude_rad = None if options.attitude_mrad is None else 1e-3 * options.attitude_mrad
        stated = Stated(_MM * options.uncertainty_mm, places, attitude_rad)
        measured = kind.foreseen(T_instr_ee, stated)
        states = PoseStates(
            q_rad=q,
            tau_Nm=np.full_like(q, np.nan),
            arrival=np.zeros_like(q),
            load_N=np.resize(options.loads_N, count),
            temperature_C=np.full(count, _TEMPERATURE_C),
            time_s=np.zeros(count),
        )
        label = np.array([f"plan {k}" for k in range(count)])
        own = len(measured.target_parameters)
        tool_m = np.zeros(3) if own or kind.from_touches else targets_m[0]
        start = Start(T_instr_base, tool_m, np.eye(3), targets_m.ravel()[:own])
        return Observations.single(label, states, measured), start


# What poses would say of the model and of missing effects, before they are measured.


@dataclass(frozen=True)
class ExpectedRows:
    """Rows of N poses, those of all loads together."""

    parameters: tuple[TermParameter, ...]  # the k unknowns of the model
    sizes: Array  # (k,) standard deviation thought possible of each
    # (N, b, k + e) rows of unit variance, each unknown in the size possible of it, each parameter
    # of an effect in its plausible one
    white: Array
    # (N, 3, k) derivative of the first target's position by the unknowns in these sizes [m],
    # without load
    tool: Array
    # missing effects that would show, with the columns (from k on) of each
    effects: dict[Effect, slice]
    springs: tuple[int, ...]  # joints to which the model gives a spring


def instrument_named(name: str) -> type[Instrument]:
    """Return the class of an instrument.

    Raises:
        CalibrationError: when there is none of that name.
    """
    known = instruments()
    if name not in known:
        raise CalibrationError(
            "no such instrument",
            where="instrument",
            value=name,
            allowed=", ".join(known),
            remedy=remedy_for(name, known, "choose one of these"),
        )
    return known[name]


def _tool(posed: GeneralProblem) -> Array:
    """Return the derivative of the first target's position by the unknowns, (P, 3, k).

    In the instrument's frame, so that what arm and base share counts once.
    """
    problem, x = posed.problem, posed.x_start
    predicted = problem.model.predict_with_jacobian(
        problem.observations.states, problem.of_model(x)
    )
    T_instr_ee = problem.T_instr_base @ predicted.T_base_ee  # along the axes of the base
    places_m = problem.places_at(x)
    if not len(places_m):
        return predicted.jacobian[:, :3]
    _, arms = carried_targets(T_instr_ee, places_m)
    by_end, by_targets = by_end_and_targets(T_instr_ee, arms)
    by_model = by_end[:, 0] @ predicted.jacobian
    return np.concatenate([by_model, by_targets[:, 0][..., problem.places]], axis=2)


def _effects(
    posed: GeneralProblem, payload: Payload | None, places: dict[str, Array]
) -> dict[Effect, Array]:
    """Return rows (P, b, e) of every effect that these poses can show, in its plausible size.

    Of effects with a shape the mean over their shapes counts. Those of time, of temperature and of
    the direction of arrival depend on how poses are driven, not on which they are.
    """
    problem, x = posed.problem, posed.x_start
    own = problem.places_at(x)
    at = FittedModel(
        problem.model, problem.of_model(x), problem.T_instr_base, targets_m=own, payload=payload
    ).with_bends()
    stated = not len(own) and problem.observations.measured.by_stated_targets.shape[2] > 0
    stated_m = np.array(list(places.values())) if stated else np.zeros((0, 3))
    setup = MeasurementSetup(payload, stated_m, _TEMPERATURE_C)
    poses = complete(problem.observations, at, setup)
    context = replace(context_of(poses, at, setup), torques="none" if payload is None else "masses")
    found = {}
    for effect in candidates(context):
        if effect.generic or effect.goes_with_time:
            continue
        if why_unknown(effect, poses.states, logged=False, weights=payload is not None):
            continue
        shapes = [np.array(start) for start in effect.starts]
        scaled = by_effects(at, poses, [effect] * len(shapes), shapes)
        together = np.concatenate(scaled, axis=2) / np.sqrt(len(shapes))
        if np.any(together):
            found[effect] = together
    return found


# A plan of poses.

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
    """Choose poses to measure.

    By where arm and instrument may be and what is measured, and how it will be calibrated; None for
    the defaults.

    Raises:
        CalibrationError: for an instrument that does not exist, too few poses for the unknowns, or
            too few poses within all limits.
    """
    options, calibration = options or PlanOptions(), calibration or CalibrationOptions()
    setup = PlanSetup(arm, instrument_named(instrument), options)
    candidates = setup.draw(least=poses)
    rows = setup.expect(candidates.q, calibration)
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
    found = _choose(rows, poses, options.effects)
    order = short_path(arm.coupling.to_axes(candidates.q[found.chosen]))
    return _planned(setup, candidates, rows, found.chosen[order], found.values)


def _choose(rows: ExpectedRows, poses: int, effects: float) -> ExchangeResult:
    """Choose poses.

    The criterion is the log determinant of the information about the model's parameters, and that
    about the effects once the model is projected out, each a parameter on average. Effects count by
    their part, 0 to 1.
    """
    k, every = len(rows.parameters), rows.white.shape[2]
    criterion: Criterion = Information(np.ascontiguousarray(rows.white[..., :k]))
    if every > k:
        of_effects = effects * k / (every - k)
        weights = np.array([1.0 - effects - of_effects, of_effects])
        criterion = Combined([criterion, Information(rows.white)], lambda each: weights @ each)
    sweeps = int(np.clip(_POSE_SWEEPS // poses, 1, _MOST_SWEEPS))
    return exchange(criterion, greedy_order(criterion, poses), most_sweeps=sweeps)


def _planned(
    setup: PlanSetup,
    candidates: room.Candidates,
    rows: ExpectedRows,
    chosen: Index,
    values: tuple[float, ...],
) -> PosePlan:
    """Return a plan of poses chosen, with all that is expected of them."""
    arm, options, k = setup.arm, setup.options, len(rows.parameters)
    covariance = covariance_of(rows.white[chosen][..., :k])
    part, q = np.sqrt(np.diag(covariance)), candidates.q[chosen]
    rng = np.random.default_rng(options.random_seed)
    count = len(rows.white)
    others = [rng.choice(count, len(chosen), replace=False) for _ in range(_RANDOM_SETS)]
    at_random = [rms_mm(rows.tool, covariance_of(rows.white[o][..., :k])) for o in others]
    target_m = next(iter(setup.targets.values()))
    T, q = Chain.of(arm).forward(q), arm.coupling.to_axes(q)
    p_m, u_mm = T[:, :3, 3] + T[:, :3, :3] @ target_m, _u_mm(rows.tool[chosen], covariance)
    in_files = np.where(arm.axes_slide, 1e3 * q, np.degrees(q)).tolist()
    rows_of = zip(in_files, p_m, u_mm, strict=True)
    expected = records.PlanRecord(
        robot=arm.name,
        instrument=setup.kind.kind,
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
        effects=_expected_effects(rows, chosen),
        criterion=values,
        candidates=len(candidates.q),
        drawn=candidates.drawn,
        removed=candidates.removed,
        travel=path_length(q),
        options=options.model_dump(mode="json"),
    )
    return PosePlan(arm, setup.kind, options, q, p_m, u_mm, expected)


def covariance_of(white: Array) -> Array:
    """Return the covariance (k, k) of unknowns in the sizes expected of them."""
    k = white.shape[2]
    root = covariance_root(np.concatenate([white.reshape(-1, k), np.eye(k)]))
    return np.asarray(root @ root.T)


def _u_mm(tool: Array, covariance: Array) -> Array:
    """Return the standard uncertainty of the tool's position in poses, (P,)."""
    variance = np.einsum("pik,pik->p", tool, tool @ covariance)
    return np.asarray(1e3 * np.sqrt(np.maximum(variance, 0.0)))


def rms_mm(tool: Array, covariance: Array) -> float:
    """Return the same, root mean square over the poses."""
    return float(np.sqrt(np.mean(_u_mm(tool, covariance) ** 2)))


def _expected_effects(rows: ExpectedRows, chosen: Index) -> tuple[records.ExpectedEffect, ...]:
    """Return how well each effect would show, alone and among all others."""
    if not rows.effects:
        return ()
    k, white = len(rows.parameters), rows.white[chosen]
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
    header = ["id", *position_columns(plan.arm.axes_slide), *_PLACE, "u_tool_mm"]
    rows = []
    for pose in plan.expected.poses:
        words = [f"{value:.3f}" for value in (*pose.q, *pose.target_mm)]
        rows.append([pose.id, *words, f"{pose.u_tool_mm:.4f}"])
    return csv_text(header, rows)
