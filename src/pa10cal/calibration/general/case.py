"""Everything that is computed with the general model for one load case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general.apart import Apart, apart
from pa10cal.calibration.general.calibrate import GeneralCalibration, at_rest, calibrate_general
from pa10cal.calibration.general.fit import Fit, fit
from pa10cal.calibration.general.prior import Moved, Prior, Release, prior_of
from pa10cal.calibration.general.problem import check_enough, choose_unknowns, start_of_tool
from pa10cal.calibration.grade import Errors, FitSummary
from pa10cal.calibration.health import health, held_out_errors
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import (
    Suspects,
    scatter_of_repeats,
    summarise,
    summarise_by_load,
)
from pa10cal.errors import CalibrationError
from pa10cal.fit.angles_seen import span_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import Direction, not_identifiable, unidentified_directions
from pa10cal.fit.loads import with_torques
from pa10cal.fit.moved import MODEL_ERROR, STIFFNESS, Found, hypotheses, sought
from pa10cal.fit.problem import Disagreement, Expected, Problem
from pa10cal.fit.robust_weights import suspect_beyond
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations, Start
from pa10cal.results.calibration import SuspectedOutlier
from pa10cal.results.evaluation import Accuracy
from pa10cal.results.health import Health, InputFinding
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import about_moved_base, motion_of_base
from pa10cal.terms.term import Offsets
from pa10cal.terms.weights import Weights

# Calibration that starts from a fitted model of the arm: after a crash, a new tool, a new cell.
#
# Base, tool and targets are free. Links, springs and effects are expected where the model has
# them, within its covariance. That holds noise alone, so the readings decide how far it is
# trusted: what moved, such as the zero of one joint, is found anew while the rest stays; where
# everything departs by more than noise, as under a model that lacks an effect, all is trusted
# less.

#: Searches for what moved, each about the fit with what the one before found.
_MOST_ROUNDS = 4


def calibrate_from(
    prior: Prior,
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None = None,
    options: CalibrationOptions | None = None,
) -> GeneralCalibration:
    """Calibrate an arm of which a fitted model is known.

    Args:
        prior: what is known.
        arm: the nominal arm.
        observations: P poses to fit.
        start: about where base, tool and targets are.
        payload: what the arm carries; None where it is not known.
        options: how to calibrate; None for the defaults.

    Raises:
        CalibrationError: when there are too few poses to find base and tool.
    """
    options = options or CalibrationOptions()
    chain, terms = prior.model.model.chain, prior.terms
    unknowns = choose_unknowns(
        arm, options.tolerances, observations.measured, start.T_instr_base, start.targets_m
    )
    (links,) = (term for term in terms if isinstance(term, Offsets))
    unknowns = replace(unknowns, links=links)
    model = Model(chain, (*terms, *unknowns.frames, unknowns.base))
    states, source = with_torques(
        Model(chain, terms), prior.expected.mean, observations.states, payload
    )
    posed = observations.with_states(states).turned(start.R_ee_target)
    problem = Problem(model, unknowns.places, start.targets_m, start.T_instr_base, posed)
    frames = [start_of_tool(name, start) for name in unknowns.frame_names]
    x = np.concatenate([prior.expected.mean, frames, np.zeros(len(unknowns.base.parameters))])
    check_enough(problem, known=len(prior.expected.mean))

    expected = prior.expected
    possible = hypotheses(arm, terms, expected.mean, expected.covariance)
    released: list[Found] = []
    found = _fitted(problem, problem.start(x), expected, options, None)
    for _ in range(_MOST_ROUNDS):
        k = len(expected.mean)
        covariance = found.covariance[:k, :k] / found.widening**2
        disagreement = Disagreement.of_fit(expected, found.x[:k], covariance)
        more = sought(disagreement, possible, released)
        if not more:
            break
        released += more
        for each in more:
            expected = expected.widened(each.directions)
        found = _fitted(problem, found.x, expected, options, None)
    if source == "masses":
        problem, found = at_rest(
            problem,
            found,
            observations.states,
            payload,
            lambda problem, before: _fitted(problem, before.x, expected, options, before.scatter),
        )
    return GeneralCalibration(
        arm=arm,
        start=start,
        unknowns=unknowns,
        settled=(),
        springs=tuple(term.joint for term in terms if isinstance(term, JointSpring)),
        torques_from=source,
        payload=payload,
        problem=problem,
        fit=found,
        moved=_moved(prior, problem, found, released),
    )


def _fitted(
    problem: Problem,
    x: Array,
    expected: Expected,
    options: CalibrationOptions,
    scatter: dict[str, float] | None,
) -> Fit:
    return fit(
        problem,
        x,
        robust=options.general.robust,
        max_iterations=options.max_iterations,
        scatter_start=scatter,
        expected=expected,
    )


def _moved(prior: Prior, problem: Problem, found: Fit, released: Sequence[Found]) -> Moved:
    """Return what was found anew, and by how much it differs from the prior."""
    mean, before = prior.expected.mean, np.diag(prior.expected.covariance)
    after = np.diag(found.covariance)
    releases, factor = [], 1.0
    for each in released:
        if each.what.kind == MODEL_ERROR:
            factor += each.size**2
            continue
        by = std = None
        unit = ""
        if len(each.what.columns) == 1:
            (k,) = each.what.columns
            by, unit = float(found.x[k] - mean[k]), problem.parameters[k].unit
            std = float(np.sqrt(before[k] + after[k]))
            if each.what.kind == STIFFNESS:
                by, std, unit = by / mean[k], std / mean[k], "1"
        releases.append(Release(each.what.kind, each.what.of, by, std, unit, each.gain))
    fitted_to = prior.model.fitted_to
    return Moved(None if fitted_to is None else fitted_to.campaign, tuple(releases), factor)


# Poses that a fit doubts, each with why; they stay in it, with less weight.

#: A pose with less weight than this is listed in any case.
_LITTLE_WEIGHT = 0.5


def suspected_outliers(problem: Problem, fit: Fit) -> tuple[SuspectedOutlier, ...]:
    """List the poses a fit doubts, the worst first."""
    limit = suspect_beyond(problem.components_seen)
    rows = np.flatnonzero((fit.distance > limit) | (fit.weights < _LITTLE_WEIGHT))
    rows = rows[np.argsort(-fit.distance[rows])]
    sizes = {
        kind: np.sqrt(
            fit.scatter[kind] ** 2
            + np.diagonal(problem.stated_covariance, axis1=1, axis2=2)[:, columns].mean(axis=1)
        )
        for kind, columns in problem.measured.component_kinds
    }
    return tuple(
        SuspectedOutlier(
            row=int(row),
            pose=str(problem.observations.pose[row]),
            load_N=float(problem.observations.states.load_N[row]),
            distance=float(fit.distance[row]),
            weight=float(fit.weights[row]),
            why=_why(problem, fit, sizes, int(row)),
        )
        for row in rows
    )


def _why(problem: Problem, fit: Fit, sizes: dict[str, Array], row: int) -> str:
    """Describe the kind of component that deviates most."""
    found = []
    for kind, columns in problem.measured.component_kinds:
        off = float(np.linalg.norm(fit.residual[row, columns]))
        text = (
            f"{np.degrees(off):.3f} deg" if kind.startswith("attitude") else f"{1e3 * off:.3f} mm"
        )
        times = off / float(sizes[kind][row])
        found.append((times, f"{kind} off by {text}, {times:.0f} times the scatter of one axis"))
    return max(found)[1]


#: Standard uncertainty of a windup, in its size, below which poses show it.
_SHOWN = 0.5
#: Part of the spread of the places seen that no calibrated arm is off by.
_NO_FIT = 0.05


@dataclass(frozen=True)
class GeneralCase:
    """One load case, computed with the general model."""

    load: str  # `combined`, `general`, or a load such as `44N`
    full: GeneralCalibration  # links, springs, frames
    # the same without springs; `full` itself where it has none, and `nominal` where it started
    # from a prior
    geometry: GeneralCalibration
    nominal: GeneralCalibration  # frames and targets alone
    grid: Observations  # poses of every load, with torques
    residuals: Deviations  # of the full model on `grid`
    # before and after: nominal and full model on `grid`, for every load
    before: dict[float, Accuracy]
    after: dict[float, Accuracy]
    geometry_after: dict[float, Accuracy]  # geometry alone on `grid`, for every load
    # unidentified_directions and not_identifiable: what the poses do not identify
    unidentified_directions: tuple[Direction, ...]
    not_identifiable: frozenset[str]
    suspected_outliers: tuple[SuspectedOutlier, ...]  # poses far outside the scatter of the others
    health: Health  # whether it is good
    apart: Apart | None  # of a group, what each campaign says alone; None of a single campaign


def work_out_general(
    arm: Arm,
    grid: Observations,
    held_out: Observations | None,
    rows: NDArray[np.bool_],
    start: Start,
    load: str,
    payload: Payload | None,
    options: CalibrationOptions,
    *,
    readings: Observations | None = None,
    findings: tuple[InputFinding, ...] = (),
    suspects: Suspects | None = None,
    prior: FittedModel | None = None,
) -> GeneralCase:
    """Compute one load case.

    Args:
        arm: the nominal arm.
        grid: grid poses of every load.
        held_out: poses held out, only judged; None where there are none.
        rows: (P,) those of the grid poses to fit.
        start: about where frames and targets are.
        load: name of the load case.
        payload: what the arm carries, None where it is not known.
        options: how to calibrate.
        readings: single readings behind the poses to fit, whose repeats show the noise; None for
            none.
        findings: what checks of the input found.
        suspects: says which of the held-out poses have a suspected reading; None for none.
        prior: fitted model of the arm to start from; None for none.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, the arm as described
            does not fit the readings at all, or the prior is of another arm.
    """
    used, rigid = grid.take(rows), options.with_springs(())
    nominal = calibrate_general(arm, used, start, payload, rigid, links=False).without_rows()
    if prior is None:
        full = calibrate_general(arm, used, start, payload, options)
    else:
        expected = prior_of(prior, arm, payload)
        full = calibrate_from(expected, arm, used, start, payload, options)
    geometry = full if prior is None else nominal
    if full.springs and prior is None:
        geometry = calibrate_general(arm, used, start, payload, rigid).without_rows()
    calibrated, load_N = fitted(full), grid.states.load_N

    def weighed(poses: Observations) -> Observations:
        states, _ = with_torques(calibrated.model, calibrated.x, poses.states, payload)
        return poses.with_states(states)

    grid = weighed(grid)
    found = calibrated.deviations(grid)
    _refuse_another_arm(full, summarise(found.take(rows)).rms_mm, used.measured.spread_mm)
    off = None
    if held_out is not None and len(held_out):
        held_out = weighed(held_out)
        elsewhere = replace(full.problem, observations=held_out.turned(start.R_ee_target))
        position = _position(elsewhere, elsewhere.rows(full.fit.x).jacobian)
        off = held_out_errors(
            calibrated.deviations(held_out),
            used,
            held_out,
            position,
            full.fit.covariance,
            None if suspects is None else suspects(calibrated),
        )
    parameters = full.problem.parameters
    names = {parameter.name for parameter in parameters}
    openly = not_identifiable(full.fit.identifiability, parameters) & names - _sags(full)
    doubts, known = suspected_outliers(full.problem, full.fit), weights_known(arm)
    trusted = np.setdiff1d(np.flatnonzero(rows), np.flatnonzero(rows)[[d.row for d in doubts]])
    alone = apart(full.problem, full.fit)
    if alone is not None:
        findings = (*findings, *alone.contradictions)
    errors = Errors(
        train_rms_mm=summarise(found.take(trusted)).rms_mm,
        held_out=off,
        noise_mm=_noise_mm(full),
        spread_mm=used.measured.spread_mm,
        suspected_outliers=len(doubts),
        repeats=() if readings is None else scatter_of_repeats(readings, calibrated),
        from_touches=used.measured.from_touches,
        findings=findings,
        without_springs_mm=summarise(fitted(geometry).deviations(grid).take(trusted)).rms_mm
        if geometry is not full
        else None,
        weights=known.origin if known.assumed and full.springs else "",
    )
    return GeneralCase(
        load=load,
        full=full,
        geometry=geometry,
        nominal=nominal,
        grid=grid,
        residuals=found,
        before=summarise_by_load(fitted(nominal).deviations(grid), load_N),
        after=summarise_by_load(found, load_N),
        geometry_after=summarise_by_load(fitted(geometry).deviations(grid), load_N),
        unidentified_directions=unidentified_directions(full.fit.identifiability, parameters),
        not_identifiable=openly,
        suspected_outliers=doubts,
        health=health(_fit_summary(full, openly), errors),
        apart=alone,
    )


def _refuse_another_arm(general: GeneralCalibration, left_mm: float, spread_mm: float) -> None:
    """Refuse readings that are not of the arm described."""
    rank = general.fit.identifiability.rank
    if rank and left_mm < _NO_FIT * spread_mm:
        return
    raise CalibrationError(
        "the arm as described does not fit the readings",
        where=general.arm.name,
        value=f"{left_mm:.1f} mm rms remain; the measured positions spread by {spread_mm:.0f} mm",
        allowed=f"errors below {100 * _NO_FIT:.0f} % of that spread",
        remedy="check robot, order, signs and zeros of the joints, and units",
    )


def fitted(general: GeneralCalibration) -> FittedModel:
    """Return a calibrated model with its base motions taken into the base frame."""
    problem, x = general.problem, general.fit.x
    model = Model(problem.model.chain, problem.model.terms[:-1])
    of_model = problem.of_model(x)
    count = len(model.parameters)
    small = base_motion(problem.model, of_model[count:])
    return FittedModel(
        model=model,
        x=about_moved_base(model.terms, of_model[:count], small),
        T_instr_base=problem.T_instr_base @ motion_of_base(small),
        R_ee_target=general.start.R_ee_target,
        targets_m=problem.places_at(x),
        target_names=problem.measured.target_names,
        covariance=_covariance(general, count),
        payload=general.payload,
        seen=span_seen(problem.observations.states.q_rad),
    )


def _covariance(general: GeneralCalibration, count: int) -> Array:
    """Return the covariance (k + 6, k + 6) of a model's k parameters and the base's motions."""
    base = general.unknowns.base.coordinates
    of_base = count + np.array([BASE.index(name) for name in base], dtype=np.intp)
    rows = np.concatenate([np.arange(count), of_base])
    covariance = np.zeros((count + 6, count + 6))
    used = len(rows)
    covariance[np.ix_(rows, rows)] = general.fit.covariance[:used, :used]
    return covariance


def base_motion(model: Model, x_base: Array) -> Array:
    """Return the six small motions (6,) of the base, zero for those that are no unknowns."""
    values = dict(zip(model.terms[-1].coordinates, x_base, strict=True))
    return np.array([values.get(name, 0.0) for name in BASE])


def _fit_summary(general: GeneralCalibration, openly: frozenset[str]) -> FitSummary:
    fit, parameters = general.fit, general.problem.parameters
    root = np.sqrt(fit.weights)[:, None, None]
    return FitSummary(
        converged=fit.converged,
        reason=fit.reason,
        iterations=fit.iterations,
        at_bound=tuple(
            parameter.name for parameter, held in zip(parameters, fit.at_bound, strict=True) if held
        ),
        pose=general.problem.observations.pose,
        parameters=parameters,
        covariance=fit.covariance,
        identifiability=fit.identifiability,
        white=(root * fit.whitener) @ fit.jacobian,
        position=_position(general.problem, fit.jacobian),
        not_identifiable=openly,
        x=fit.x,
        hidden=_assumed_weights(general),
    )


def _sags(general: GeneralCalibration) -> frozenset[str]:
    """Return the springs under weights that nobody stated whose sag poses show all the same.

    What poses leave open of those weights goes with the springs by a little, and these with them.
    """
    if not weights_known(general.arm).assumed:
        return frozenset()
    std = np.sqrt(np.maximum(np.diag(general.fit.covariance), 0.0))
    return frozenset(
        parameter.name
        for parameter, value, sigma in zip(
            general.problem.parameters, general.fit.x, std, strict=True
        )
        if parameter.name.startswith("windup") and sigma < _SHOWN * value
    )


def _assumed_weights(general: GeneralCalibration) -> frozenset[str]:
    """Return the weights that nobody stated: what poses leave open of them is no lack of poses."""
    if not weights_known(general.arm).assumed:
        return frozenset()
    weights = (term for term in general.problem.model.terms if isinstance(term, Weights))
    return frozenset(parameter.name for term in weights for parameter in term.parameters)


def _position(problem: Problem, jacobian: Array) -> Array:
    """Return the derivative of the predicted position, of one target where there are several."""
    columns = problem.measured.position_columns
    share: Array = jacobian[:, columns] / np.sqrt(_targets_seen(problem))[:, None, None]
    return share


def _noise_mm(general: GeneralCalibration) -> float:
    """Return what the stated noise explains of the root mean square error."""
    problem = general.problem
    columns = problem.measured.position_columns
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)[:, columns]
    seen = problem.components_seen[:, columns]
    per_pose = np.where(seen, variances, 0.0).sum(axis=1) / _targets_seen(problem)
    return float(1e3 * np.sqrt(per_pose.mean()))


def _targets_seen(problem: Problem) -> Array:
    """Return how many targets were seen in each pose, (P,)."""
    columns = problem.measured.position_columns
    targets: Array = np.maximum(1.0, problem.components_seen[:, columns].sum(axis=1) // 3)
    return targets
