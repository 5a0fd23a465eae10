"""A chain of links on two-axis joints, posed along curves, measured in the cell and calibrated.

Each arm is measured as any other: a campaign of a tracker, with the postures given.

The two-level model, the paper's, departs by the rows of the chain and has no motions of the tool;
its inner level has the poses of the settings, and once more all of them. The general
model has whatever arm and instrument can identify. What an individual hides is looked at
only after it was calibrated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.calibration.accuracy import align_nominal, deviations
from pa10cal.calibration.calibrate import Calibration, calibrate
from pa10cal.calibration.general.calibrate import (
    GeneralCalibration,
    calibrate_general,
)
from pa10cal.calibration.general.case import fitted
from pa10cal.calibration.general.start import find_start
from pa10cal.calibration.load_case import model_deviations
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import ErrorSources
from pa10cal.cell.individual import draw_individual, robot_from_departures
from pa10cal.cell.options import TrackerOptions
from pa10cal.cell.robot import Robot
from pa10cal.curve.chain_arm import chain_arm
from pa10cal.curve.options import CurveStudyOptions
from pa10cal.curve.postures import Postures, draw_postures
from pa10cal.fit.identifiability import Identifiability, unidentified_directions
from pa10cal.observe.averages import measured_as_poses
from pa10cal.results import studies as results
from pa10cal.results.accuracy import Distances
from pa10cal.studies.simulated import measured, observations_of
from pa10cal.terms.baseline import baseline, nominal

Array = NDArray[np.float64]

#: The mean error after calibration is to be within so many times that of the noise alone.
BAR = 1.5


@dataclass(frozen=True)
class Departing:
    """One arm, and how it departs from its description.

    Attributes:
        key: `rows` or `any_way`.
        said: in words.
        robot: the arm as it is, its target on the flange.
        truth: of the parameters of the rows, by name; none where it departs in any way.
    """

    key: str
    said: str
    robot: Robot
    truth: dict[str, float]


def draw_departing(
    arm: Arm, plan: TrackerOptions, options: CalibrationOptions, rng: np.random.Generator
) -> tuple[Departing, Departing]:
    """Draw one individual that departs by the rows of the chain, and one that departs in any way.

    Both stand in the same place and have the target where it is stated, on the flange.

    Args:
        arm: its description.
        plan: spreads of the one that departs in any way.
        options: tolerances, the spreads of the other.
        rng: draws them.
    """
    rows = baseline(arm, (), options.tolerances).parameters
    truth = {each.name: float(rng.normal(0.0, each.scale)) for each in rows}
    free = replace(draw_individual(arm, plan, rng), T_ee_target=np.eye(4))
    by_rows = robot_from_departures(arm, truth, plan=plan, T_instr_base=free.T_instr_base)
    return (
        Departing("rows", "departs by the parameters of its rows", by_rows, truth),
        Departing("any_way", "departs in any way, axes and flange in six directions", free, {}),
    )


def chain_study(
    options: CurveStudyOptions, calibration: CalibrationOptions
) -> results.CurveCalibrationRecord:
    """Simulate and calibrate arms that depart by their rows, and as many that depart in any way.

    Args:
        options: the chain, its postures and the noise.
        calibration: how to calibrate.

    Raises:
        CurveError: when hardly any shape can be taken.
    """
    limit_rad = float(np.radians(options.limit_deg))
    arm = chain_arm(f"chain_{options.links}", options.links, options.link_m, limit_rad)
    plan = TrackerOptions(
        poses=options.postures,
        holdout_share=options.holdout_share,
        position_mm=options.position_mm,
        attitude_rad=options.attitude_rad,
    )
    # The mean length of a vector of three coordinates with this noise.
    floor_mm = float(options.position_mm * np.sqrt(8.0 / np.pi))
    shapes: list[Postures] = []
    individuals: list[results.Individual] = []
    streams = np.random.default_rng(options.random_seed).spawn(options.individuals)
    for number, stream in enumerate(streams, start=1):
        postures = draw_postures(options.links, options.link_m, limit_rad, options.postures, stream)
        shapes.append(postures)
        noise_seed = int(stream.integers(2**32))
        individuals += [
            _individual(number, each, plan, calibration, postures.q_rad, noise_seed)
            for each in draw_departing(arm, plan, calibration, stream)
        ]
    return results.CurveCalibrationRecord(
        provenance="synthetic: virtual cell, no hidden effect",
        settings=options.model_dump(mode="json"),
        joints=arm.n,
        shapes_refused=sum(postures.refused for postures in shapes),
        noise_floor_mm=floor_mm,
        bar=BAR,
        summaries=_summaries(individuals, floor_mm),
        individuals=tuple(individuals),
        postures_of_first=results.Postures(shape=shapes[0].shape, p_m=shapes[0].p_m),
    )


def _individual(
    number: int,
    departing: Departing,
    plan: TrackerOptions,
    options: CalibrationOptions,
    postures: Array,
    random_seed: int,
) -> results.Individual:
    """Measure one arm in postures (P, 2 n) and calibrate it with both models."""
    robot = departing.robot
    arm = robot.arm
    made = measured(robot, plan, random_seed, postures)
    poses = measured_as_poses(observations_of(made))
    grid = made.truth.schedule.kind == "grid"
    exact = poses.with_measured(T_instr_target=robot.T_instr_target(made.truth.rest.T_base_ee))

    two_levels = {
        model: calibrate(
            baseline(arm, (), options.tolerances),
            poses.take(grid),
            options.model_copy(update={"inner_poses": inside}),
            ErrorSources(),
        )
        for model, inside in (("two_level", options.inner_poses), ("two_level_all", "all"))
    }
    start = find_start(arm, poses.take(grid))
    general = calibrate_general(arm, poses.take(grid), start, None, options.with_springs(()))

    rigid = nominal(arm)
    T_aligned = align_nominal(rigid, poses.take(grid))
    T_nominal = rigid.predict(poses.states, np.zeros(0))
    found_mm, true_mm = (
        {
            "nominal": deviations(T_nominal, T_aligned, against).distance_mm,
            **{
                model: model_deviations(found, against).distance_mm
                for model, found in two_levels.items()
            },
            "general": fitted(general).deviations(against).distance_mm,
        }
        for against in (poses, exact)
    )
    return results.Individual(
        number=number,
        departs=departing.key,
        said=departing.said,
        errors={
            model: results.ErrorsOfModel(
                fitted=_distances(found_mm[model][grid]),
                held_out=_distances(found_mm[model][~grid]),
                held_out_true=_distances(true_mm[model][~grid]),
            )
            for model in found_mm
        },
        models={
            **{model: _two_levels(found, departing.truth) for model, found in two_levels.items()},
            "general": _general(general),
        },
        poses=results.ErrorsByPose(
            pose=made.truth.schedule.pose,
            held_out=~grid,
            **{f"{model}_mm": each for model, each in found_mm.items()},
        ),
    )


def _summaries(
    individuals: Sequence[results.Individual], floor_mm: float
) -> tuple[results.CurveStudySummary, ...]:
    """Return what became of all arms that depart in the same way, model by model."""
    found = []
    for departs in dict.fromkeys(each.departs for each in individuals):
        alike = [each for each in individuals if each.departs == departs]
        for model in alike[0].models:
            fits = [each.models[model] for each in alike]
            scores = [score for fit in fits for score in fit.scores.values()]
            errors = [each.errors[model] for each in alike]
            found.append(
                results.CurveStudySummary(
                    departs=departs,
                    said=alike[0].said,
                    model=model,
                    individuals=len(alike),
                    converged=sum(fit.converged for fit in fits),
                    unknowns=fits[0].unknowns,
                    rank=min(fit.rank for fit in fits),
                    null_directions=fits[0].null_directions,
                    rms_score=float(np.sqrt(np.mean(np.square(scores)))) if scores else None,
                    fitted=_over_floor([each.fitted for each in errors], floor_mm),
                    held_out=_over_floor([each.held_out for each in errors], floor_mm),
                    held_out_true=_over_floor([each.held_out_true for each in errors], floor_mm),
                )
            )
    return tuple(found)


def _over_floor(errors: Sequence[Distances], floor_mm: float) -> results.OverFloor:
    times = np.array([each.mean_mm for each in errors]) / floor_mm
    return results.OverFloor(
        mean=float(times.mean()),
        largest=float(times.max()),
        within_bar=int((times <= BAR).sum()),
    )


def _distances(distance_mm: Array) -> Distances:
    """Return mean, peak and root mean square of position errors (P,)."""
    return Distances(
        mean_mm=float(distance_mm.mean()),
        peak_mm=float(distance_mm.max()),
        rms_mm=float(np.sqrt(np.mean(distance_mm**2))),
    )


def _two_levels(found: Calibration, truth: Mapping[str, float]) -> results.IndividualFit:
    """Return rank, null directions and, where there is a truth, scores of the parameters."""
    names = [parameter.name for parameter in found.level.model.parameters]
    std = np.sqrt(np.diag(found.covariances.parameters))
    return results.IndividualFit(
        converged=found.converged,
        starts=len(found.starts),
        starts_agreeing=found.starts_agreeing,
        **_rank(found.identifiability),
        null_directions=tuple(each.weights for each in found.unidentified_directions),
        redundant={},
        scores={
            name: float((value - truth[name]) / sigma)
            for name, value, sigma in zip(names, found.solution.x, std, strict=True)
            if name in truth and name not in found.not_identifiable
        },
    )


def _general(found: GeneralCalibration) -> results.IndividualFit:
    identifiability = found.fit.identifiability
    unidentified = unidentified_directions(identifiability, found.problem.parameters)
    return results.IndividualFit(
        converged=found.fit.converged,
        **_rank(identifiability),
        null_directions=tuple(each.weights for each in unidentified),
        redundant={each.name: each.replaced_by for each in found.unknowns.redundant},
        scores={},
    )


def _rank(found: Identifiability) -> dict[str, Any]:
    return {
        "unknowns": len(found.singular_values),
        "rank": found.rank,
        "condition": found.condition,
    }
