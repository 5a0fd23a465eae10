"""A chain of links on two-axis joints, posed along curves: campaigns of it, calibrated and judged.

Each arm is a campaign like any other, of an arm that is described and of poses that are commanded:
simulated under `pose`, written, read, calibrated and judged on its held-out poses.

The two-level model, the paper's, departs by the rows of the chain and has no motions of the tool;
its inner level has the poses of the settings, and once more all of them. The general model has
whatever arm and instrument can identify. What an individual hides is looked at only after it was
calibrated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Literal

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import Campaign
from pa10cal.discovery.preparation import setup_of
from pa10cal.evaluation.holdout import UNCALIBRATED, Evaluation
from pa10cal.fit.model_reading import models_of
from pa10cal.options import DiscoveryOptions
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.evaluation import Distances, HeldOutModel
from pa10cal_curve import records as results
from pa10cal_curve.angles import chain_arm
from pa10cal_curve.options import CurveStudyOptions
from pa10cal_curve.postures import ChainPostures, draw_postures
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import truth_record
from pa10cal_lab.simulated import as_read, reported_scores
from pa10cal_lab.trial_records import TrueParameter

Departs = Literal["rows", "any_way"]

PROVENANCE = "synthetic: virtual cell, no hidden effect"
#: The mean error after calibration is to be within so many times that of the noise alone.
BAR = 1.5
#: Noise so far below the instrument's that what is seen counts as exact, though not free of it.
_EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8}
_SAID: dict[Departs, str] = {
    "rows": "departs by the parameters of its rows",
    "any_way": "departs in any way, axes and flange in six directions",
}
#: Options of each model, in place of those of the settings. With `_NOMINAL` the names are those of
#: the columns `<name>_mm` of `ErrorsByPose`.
_MODELS: dict[str, dict[str, Any]] = {
    "two_level": {"model": "paper"},
    "two_level_all": {"model": "paper", "inner_poses": "all"},
    "general": {"model": "general"},
}
_NOMINAL, _LOAD = "nominal", "0N"


def chain_study(
    options: CurveStudyOptions, calibration: CalibrationOptions
) -> results.CurveCalibrationRecord:
    """Simulate and calibrate arms that depart by their rows, and as many that depart in any way.

    Args:
        calibration: how to calibrate; the chain is rigid.

    Raises:
        CurveError: when hardly any shape can be taken.
        CalibrationError: when there are too few postures.
    """
    limit_rad = float(np.radians(options.limit_deg))
    arm = chain_arm(f"chain_{options.links}", options.links, options.link_m, limit_rad)
    rigid = calibration.model_copy(update={"flexible_joints": ()})
    # The mean length of a vector of three coordinates with this noise.
    floor_mm = float(options.position_mm * np.sqrt(8.0 / np.pi))
    shapes: list[ChainPostures] = []
    individuals: list[results.Individual] = []
    streams = np.random.default_rng(options.random_seed).spawn(options.individuals)
    for number, stream in enumerate(streams, start=1):
        postures = draw_postures(options.links, options.link_m, limit_rad, options.postures, stream)
        shapes.append(postures)
        seed = int(stream.integers(2**32))
        for departs in _SAID:
            plan = TrackerOptions(
                commanded=np.degrees(postures.q_rad).tolist(),
                holdout_share=options.holdout_share,
                departs=departs,
                target_m=0.0,  # on the flange, where it is stated
                target_rad=0.0,
                position_mm=options.position_mm,
                attitude_rad=options.attitude_rad,
            )
            settings = SimulateOptions(random_seed=seed, robot=arm.name, without_touches=plan)
            individuals.append(_individual(number, departs, arm, plan, settings, rigid))
    return results.CurveCalibrationRecord(
        provenance=PROVENANCE,
        settings=options.model_dump(mode="json") | {"calibration": rigid.model_dump(mode="json")},
        joints=arm.n,
        shapes_refused=sum(postures.refused for postures in shapes),
        noise_floor_mm=floor_mm,
        bar=BAR,
        summaries=summaries_of(individuals, floor_mm),
        individuals=tuple(individuals),
        postures_of_first=results.Postures(shape=shapes[0].shape, p_m=shapes[0].p_m),
    )


def _individual(
    number: int,
    departs: Departs,
    arm: Arm,
    plan: TrackerOptions,
    settings: SimulateOptions,
    options: CalibrationOptions,
) -> results.Individual:
    """Measure one arm, calibrate it with every model, and judge these."""
    made = simulate_campaign(f"{arm.name}-{number}-{departs}", arm, settings)
    campaign = as_read(made)
    about = campaign.description, campaign.arm, campaign.observations, _LOAD
    records = {
        name: calibrated_record(LoadCase(*about, options.model_copy(update=changes)))
        for name, changes in _MODELS.items()
    }
    # The last model of a record is the calibration itself, see `models_of`.
    models = {name: tuple(models_of(found, name).values())[-1] for name, found in records.items()}
    setup = setup_of(campaign.description, campaign.arm, options, DiscoveryOptions())

    def errors_of(campaign: Campaign, kind: str) -> dict[str, HeldOutModel]:
        found = Evaluation(campaign.observations, models, None, setup).judge(kind=kind)
        return {_NOMINAL if name == UNCALIBRATED else name: of for name, of in found.items()}

    def distances(of: HeldOutModel) -> Distances:
        return Distances(mean_mm=of.mean_mm, peak_mm=of.peak_mm, rms_mm=of.rms_mm)

    fitted, held_out = errors_of(campaign, "grid"), errors_of(campaign, "holdout")
    without_noise = settings.model_copy(update={"without_touches": plan.model_copy(update=_EXACT)})
    exact = as_read(simulate_campaign(made.name, arm, without_noise))
    true = errors_of(exact, "holdout")
    truth = truth_record(made, ()).parameters
    rows_of = {name: (fitted[name].rows, held_out[name].rows) for name in fitted}
    return results.Individual(
        number=number,
        departs=departs,
        said=_SAID[departs],
        errors={
            name: results.ErrorsOfModel(
                fitted=distances(fitted[name]),
                held_out=distances(held_out[name]),
                held_out_true=distances(true[name]),
            )
            for name in fitted
        },
        models={name: _fit(found, truth) for name, found in records.items()},
        poses=results.ErrorsByPose(
            pose=np.concatenate([rows.pose for rows in rows_of[_NOMINAL]]),
            held_out=np.repeat([False, True], [len(rows.pose) for rows in rows_of[_NOMINAL]]),
            **{
                f"{name}_mm": np.concatenate([rows.error_mm for rows in pair])
                for name, pair in rows_of.items()
            },
        ),
    )


def _fit(found: CalibrationRecord, truth: Mapping[str, TrueParameter]) -> results.IndividualFit:
    """Return rank, null directions and, of the paper's model, scores of what has a true value."""
    more: dict[str, Any]
    if isinstance(found, GeneralCalibrationRecord):
        redundant = {parameter.name: parameter.replaced_by for parameter in found.redundant}
        more = {"redundant": redundant, "scores": {}}
    else:
        more = {"starts": found.starts, "starts_agreeing": found.starts_agreeing, "redundant": {}}
        more["scores"] = reported_scores(found.parameters, truth)
    return results.IndividualFit(
        converged=found.status == "converged",
        unknowns=found.unknowns,
        rank=found.rank,
        condition=found.condition,
        null_directions=found.null_directions,
        **more,
    )


def summaries_of(
    individuals: Sequence[results.Individual], floor_mm: float
) -> tuple[results.CurveStudySummary, ...]:
    """Return what became of all arms that depart in the same way, model by model."""
    summaries = []
    for departs, model in product(_SAID, _MODELS):
        alike = [arm for arm in individuals if arm.departs == departs]
        fits = [arm.models[model] for arm in alike]
        scores = [score for fit in fits for score in fit.scores.values()]
        errors = [arm.errors[model] for arm in alike]
        least_determined = max(fits, key=lambda fit: fit.unknowns - fit.rank)
        over_floor = {
            kind: _over_floor([getattr(error, kind) for error in errors], floor_mm)
            for kind in ("fitted", "held_out", "held_out_true")
        }
        summaries.append(
            results.CurveStudySummary(
                departs=departs,
                said=_SAID[departs],
                model=model,
                individuals=len(alike),
                converged=sum(fit.converged for fit in fits),
                unknowns=least_determined.unknowns,
                rank=least_determined.rank,
                null_directions=least_determined.null_directions,
                rms_score=float(np.sqrt(np.mean(np.square(scores)))) if scores else None,
                **over_floor,
            )
        )
    return tuple(summaries)


def _over_floor(errors: Sequence[Distances], floor_mm: float) -> results.OverFloor:
    times = np.array([error.mean_mm for error in errors]) / floor_mm
    within = int((times <= BAR).sum())
    return results.OverFloor(
        mean=float(times.mean()), largest=float(times.max()), within_bar=within
    )
