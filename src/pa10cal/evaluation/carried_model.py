"""A model carried to another campaign: base and tool fitted anew, one base or one for every part.

A campaign in which instrument or base moved suddenly is divided at the times of these steps. The
search in time (`discovery.in_time`) finds them in the residuals of the calibration poses; held-out
poses are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array, Index
from pa10cal.calibration.accuracy import summarise
from pa10cal.calibration.general.refit_frames import refit_frames, with_tool_of
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.log_faults import steps_told
from pa10cal.discovery.model_with_effects import with_base_motion
from pa10cal.discovery.nuisances import steps_in_time
from pa10cal.discovery.pose_scatter import PoseWeights, pose_weights, scatter_of
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of, sought
from pa10cal.discovery.repeats import enough_repeats, repeat_groups
from pa10cal.evaluation.model_errors import poses_for_model
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import with_torques
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.observations import Observations, part_of, reading_groups
from pa10cal.results.evaluation import PartOfCampaign
from pa10cal.rules import COMPARED
from pa10cal.terms.offsets import motion_of_base


@dataclass(frozen=True, eq=False)
class RefittedModel:
    """A model whose base and tool were fitted to the calibration poses of a campaign."""

    model: FittedModel  # the model with base and tool as fitted
    every: Observations  # single readings of the campaign
    poses: Observations  # its calibration poses, averaged, with all that the model's terms read
    rms_mm: float  # error of the model in these poses
    # as for the campaign; where it states no tool, with that of the model's own campaign
    setup: MeasurementSetup


def with_frames_refitted(
    model: FittedModel, every: Observations, setup: MeasurementSetup, cuts_s: Sequence[float] = ()
) -> RefittedModel:
    """Fit base and tool of a model to the calibration poses of a campaign.

    The base is fitted for every part between the times `cuts_s`, the tool for all together.

    Raises:
        CalibrationError: when the poses do not determine base and tool.
    """
    logged = bool(np.isfinite(every.states.tau_Nm).all())
    model = with_tool_of(model, setup.payload, logged=logged)
    if setup.payload is not None:
        setup = replace(setup, payload=model.payload)
    poses = poses_for_model(every, "grid", model, setup, cuts_s)
    refitted = refit_frames(model, poses, cuts_s)
    rms_mm = summarise(refitted.deviations(poses)).rms_mm
    return RefittedModel(refitted, every, poses, rms_mm, setup)


def base_steps_s(refitted: RefittedModel) -> tuple[float, ...]:
    """Return the times [s] at which instrument or base moved suddenly, to divide a campaign at.

    Empty where the search in time finds no certain step, as where rows tell no time (`in_time_of`),
    and for a group, each of whose campaigns has its own base.
    """
    model, setup = refitted.model, refitted.setup
    readings = refitted.every.of_kind("grid").turned(model.R_ee_target)
    if readings.measured.campaigns or not len(readings):
        return ()
    model = replace(model.with_bends(), covariance=None, falls_back=None)
    states, torques = with_torques(model.model, model.x, readings.states, setup.payload)
    poses = complete(readings.with_states(states), model, setup)
    x = np.concatenate([model.x, np.zeros(6)])
    with_base = replace(model, model=with_base_motion(model), x=x)
    residuals = with_base.compared(poses).residual
    search = in_time_of(
        with_base,
        poses,
        _noise_whiteners(with_base, poses, residuals),
        sought(context_of(poses, model, setup), model.model.terms),
        logged=torques == "logged",
        weights=poses.states.static_loads is not None,
    )
    if search.wander is None:
        return ()
    steps_s = steps_told(steps_in_time(search.wander, with_base, poses))
    return with_enough_poses(refitted.every, steps_s)


def _noise_whiteners(at: FittedModel, poses: Observations, residuals: Array) -> Array:
    """Return whiteners (P, b, b) of single readings, by the scatter of repeats if they suffice.

    Else by the residuals (P, b) of the model, so that what it lacks counts as noise.
    """
    rows, fitted_count = np.arange(len(poses)), float(COMPARED.of_frames)
    if enough_repeats(poses):  # they show the noise without any model
        rows, residuals = _deviations_of_repeats(poses, residuals)
        fitted_count = 0.0
    shown = poses.take(rows)
    weight = np.ones(len(poses))
    weight[rows] = pose_weights(residuals, fitted_count, shown.measured).weight
    covariance = scatter_of(at, shown, residuals).covariance(at, poses)
    return PoseWeights(whitener_of(covariance), weight).whiteners()


def _deviations_of_repeats(poses: Observations, residuals: Array) -> tuple[Index, Array]:
    """Return R rows of repeated readings, and their deviations (R, b) by the residuals (P, b).

    Deviations from the mean of n repeats are widened by sqrt(n / (n - 1)) to those of single
    readings. A row with a component that none of its repeats has is left out.
    """
    group, seen = repeat_groups(poses), poses.measured.components_seen
    total, n = (np.zeros((group.max() + 1, residuals.shape[1])) for _ in range(2))
    np.add.at(total, group, np.where(seen, residuals, 0.0))
    np.add.at(n, group, seen)
    total, n = total[group], n[group]
    deviations = (residuals - total / np.maximum(n, 1.0)) * np.sqrt(n / np.maximum(n - 1.0, 1.0))
    rows = np.flatnonzero(seen.any(axis=1) & ((n > 1.0) | ~seen).all(axis=1))
    return rows, np.where(seen, deviations, 0.0)[rows]


def with_enough_poses(every: Observations, steps_s: Sequence[float]) -> tuple[float, ...]:
    """Return the steps [s] between which there are poses enough for a base, in order of time.

    A part with too few is joined to a neighbour by omitting the less certain of the steps at its
    ends.

    Args:
        steps_s: times of steps, the most certain first.
    """
    readings, kept = every.of_kind("grid"), list(steps_s)
    while kept:
        cuts_s = sorted(kept)
        short = [k for k, enough in enumerate(_enough(readings, cuts_s)) if not enough]
        if not short:
            break
        at_ends = cuts_s[max(short[0] - 1, 0) : short[0] + 1]
        kept.remove(max(at_ends, key=kept.index))
    return tuple(sorted(kept))


def _enough(readings: Observations, cuts_s: Sequence[float]) -> list[bool]:
    """Return whether each part has enough calibration poses for a base of its own."""
    part, group = part_of(readings.states.time_s, cuts_s), reading_groups(readings, cuts_s)
    seen = readings.measured.components_seen
    first_of_pose = np.unique(group, return_index=True)[1]
    seen_in_pose = np.zeros((len(first_of_pose), seen.shape[1]), dtype=bool)
    np.logical_or.at(seen_in_pose, group, seen)
    poses_and_components = [
        (int(here.sum()), int(seen_in_pose[here].sum()))
        for here in (part[first_of_pose] == k for k in range(len(cuts_s) + 1))
    ]
    return [
        poses >= COMPARED.own_base_poses and components >= COMPARED.own_base_components
        for poses, components in poses_and_components
    ]


def campaign_parts(refitted: RefittedModel, cuts_s: Sequence[float]) -> tuple[PartOfCampaign, ...]:
    """Return the parts of a campaign, and how the base moved from each to the next.

    Args:
        refitted: a model with a base for every part.
        cuts_s: times between these parts.
    """
    every, parts = refitted.every, []
    part = part_of(every.states.time_s, cuts_s)
    for k, (moved_mm, turned_mrad) in enumerate(_base_motions(refitted, cuts_s[0])):
        here = every.take(part == k)
        parts.append(
            PartOfCampaign(
                from_s=float(here.states.time_s.min()),
                to_s=float(here.states.time_s.max()),
                poses=_configurations(here, "grid"),
                held_out=_configurations(here, "holdout"),
                moved_by_mm=moved_mm,
                turned_by_mrad=turned_mrad,
            )
        )
    return tuple(parts)


def _base_motions(
    refitted: RefittedModel, first_part_s: float
) -> list[tuple[float | None, float | None]]:
    """Return how far the base of each part moved from that of the part before.

    As the rms displacement of the measured poses [mm] and the angle [mrad]; None for the first
    part, in which `first_part_s` is a time, such as that of the cut at its end: see `part_of`.
    """
    model, states = refitted.model, refitted.poses.states
    in_first_part = replace(states, time_s=np.full(len(states), first_part_s))
    ends_m = model.model.predict(in_first_part, model.x)[:, :3, 3]
    T_first_bases: list[Array] = [np.eye(4)]  # each base in that of the first part
    for term in model.model.terms:
        if term.holds == "part":  # one for each part but the first, in order of time
            motion = np.zeros(6)
            motion[[BASE.index(name) for name in term.coordinates]] = model.values_of(term)
            T_first_bases.append(motion_of_base(motion))
    motions: list[tuple[float | None, float | None]] = [(None, None)]
    for T, T_next in pairwise(T_first_bases):
        by_m = ends_m @ (T_next - T)[:3, :3].T + (T_next - T)[:3, 3]
        angle_rad = Rotation.from_matrix(T_next[:3, :3].T @ T[:3, :3]).magnitude()
        rms_m = np.sqrt(np.mean(np.sum(by_m**2, axis=1)))
        motions.append((1e3 * float(rms_m), 1e3 * float(angle_rad)))
    return motions


def _configurations(every: Observations, kind: str) -> int:
    return len(np.unique(reading_groups(every.of_kind(kind))))
