"""Individuals of a chain of links, measured in the virtual cell and calibrated with both models.

The two-level model, the paper's, departs by the rows of the chain and has no motions of the tool;
its inner level has the poses that the settings ask for, and once more all of them. The general
model has whatever arm and instrument can tell. What an individual hides is looked at
only after it was calibrated.
"""

from __future__ import annotations

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
from pa10cal.calibration.identifiability import Identifiability, unidentified_directions
from pa10cal.calibration.load_case import model_deviations
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import ErrorSources
from pa10cal.cell.individual import draw_individual, robot_from_departures
from pa10cal.cell.options import TrackerOptions
from pa10cal.cell.robot import Robot
from pa10cal.observe.averages import measured_as_poses
from pa10cal.stages.simulated_observations import measured, observations_of
from pa10cal.terms.baseline import baseline, nominal
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

#: The mean error after calibration is to be within so many times that of the noise alone.
BAR = 1.5


@dataclass(frozen=True)
class Departing:
    """An individual, and how it departs from its description.

    Attributes:
        key: `rows` or `any_way`.
        said: in words.
        individual: the arm as it is, its target on the flange.
        truth: of the parameters of the rows, by name; none where it departs in any way.
    """

    key: str
    said: str
    individual: Robot
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


def calibrated_record(
    departing: Departing,
    plan: TrackerOptions,
    options: CalibrationOptions,
    postures: Array,
    random_seed: int,
) -> dict[str, Any]:
    """Measure an individual in postures (P, 2 n), calibrate it with both models, and tell.

    Args:
        departing: the individual.
        plan: noise, and the share held out.
        options: how to calibrate.
        postures: commanded joint positions [rad].
        random_seed: of the noise.
    """
    individual = departing.individual
    arm = individual.arm
    made = measured(individual, plan, random_seed, postures)
    poses = measured_as_poses(observations_of(made))
    grid = made.truth.schedule.kind == "grid"
    exact = poses.with_measured(T_instr_target=individual.T_instr_target(made.truth.rest.T_base_ee))

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
    return {
        "departs": departing.key,
        "said": departing.said,
        "errors": {
            model: {
                "fitted": summary(found_mm[model][grid]),
                "held_out": summary(found_mm[model][~grid]),
                "held_out_true": summary(true_mm[model][~grid]),
            }
            for model in found_mm
        },
        "models": {
            **{
                model: _two_level_record(found, departing.truth)
                for model, found in two_levels.items()
            },
            "general": _general_record(general),
        },
        "poses": {
            "pose": made.truth.schedule.pose.tolist(),
            "held_out": (~grid).tolist(),
            **{f"{model}_mm": each.tolist() for model, each in found_mm.items()},
        },
    }


def summaries(records: list[dict[str, Any]], floor_mm: float) -> list[dict[str, Any]]:
    """Return what became of all individuals that depart alike, model by model.

    Args:
        records: of single individuals.
        floor_mm: mean error that the stated noise alone leaves.
    """
    found = []
    for departs in dict.fromkeys(record["departs"] for record in records):
        alike = [record for record in records if record["departs"] == departs]
        for model in alike[0]["models"]:
            fits = [record["models"][model] for record in alike]
            scores = [score for fit in fits for score in fit["scores"].values()]
            found.append(
                {
                    "departs": departs,
                    "said": alike[0]["said"],
                    "model": model,
                    "individuals": len(alike),
                    "converged": sum(fit["converged"] for fit in fits),
                    "unknowns": fits[0]["unknowns"],
                    "rank": min(fit["rank"] for fit in fits),
                    "null_directions": fits[0]["null_directions"],
                    "rms_score": float(np.sqrt(np.mean(np.square(scores)))) if scores else None,
                    **{
                        of: _over_floor(
                            [record["errors"][model][of]["mean_mm"] for record in alike], floor_mm
                        )
                        for of in ("fitted", "held_out", "held_out_true")
                    },
                }
            )
    return found


def _over_floor(mean_mm: list[float], floor_mm: float) -> dict[str, Any]:
    times = np.array(mean_mm) / floor_mm
    return {
        "mean": float(times.mean()),
        "largest": float(times.max()),
        "within_bar": int((times <= BAR).sum()),
    }


def summary(distance_mm: Array) -> dict[str, float]:
    """Return mean, peak and root mean square of position errors (P,)."""
    return {
        "mean_mm": float(distance_mm.mean()),
        "peak_mm": float(distance_mm.max()),
        "rms_mm": float(np.sqrt(np.mean(distance_mm**2))),
    }


def _two_level_record(found: Calibration, truth: dict[str, float]) -> dict[str, Any]:
    """Return rank, null directions and, where there is a truth, scores of the parameters."""
    names = [parameter.name for parameter in found.level.model.parameters]
    std = np.sqrt(np.diag(found.covariances.parameters))
    return {
        "converged": found.converged,
        "starts": len(found.starts),
        "starts_agreeing": found.starts_agreeing,
        **_rank_record(found.identifiability),
        "null_directions": [direction.weights for direction in found.unidentified_directions],
        "left_out": {},
        "scores": {
            name: float((value - truth[name]) / sigma)
            for name, value, sigma in zip(names, found.solution.x, std, strict=True)
            if name in truth and name not in found.not_identifiable
        },
    }


def _general_record(found: GeneralCalibration) -> dict[str, Any]:
    parameters: tuple[Parameter, ...] = found.problem.parameters
    identifiability = found.fit.identifiability
    return {
        "converged": found.fit.converged,
        **_rank_record(identifiability),
        "null_directions": [
            direction.weights for direction in unidentified_directions(identifiability, parameters)
        ],
        "left_out": {each.name: each.said_by for each in found.unknowns.redundant},
        "scores": {},
    }


def _rank_record(found: Identifiability) -> dict[str, Any]:
    return {
        "unknowns": len(found.singular_values),
        "rank": found.rank,
        "condition": found.condition,
    }
