"""Models judged on held-out points and loads (paper, Section II.E and Fig. 6).

On poses of their own campaign, or of another one, where base and tool are fitted anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.general.placed import refit_frames, with_tool_of
from pa10cal.calibration.uncertainty import align_nominal, summarise, summarise_by_load
from pa10cal.discovery import preparation
from pa10cal.discovery.finding import steps_told
from pa10cal.discovery.given import Extended
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.linear import residual, with_base_term
from pa10cal.discovery.noise import pose_weights, same_circumstances
from pa10cal.discovery.preparation import (
    MeasurementSetup,
    complete,
    complete_about,
    context_of,
    sought,
)
from pa10cal.discovery.wander import steps_in_time
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import with_torques
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import (
    Observations,
    average_repeats,
    measured_as_poses,
    part_of,
    poses_of,
    reading_groups,
)
from pa10cal.observe.order import HeldOutPlaces, with_arrivals
from pa10cal.results import evaluation as results
from pa10cal.results.record import CampaignIdentity
from pa10cal.rules import COMPARED
from pa10cal.terms.joint_spring import nominal
from pa10cal.terms.of_campaign import motion_of_base

#: Kinds of poses that are repeated.
_KINDS = ("grid", "holdout")
UNCALIBRATED, EXTENDED = "uncalibrated", "extended"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Models to judge, and the campaign to judge them by."""

    every: Observations  # single readings of the campaign
    # fitted models by name; where none is called `uncalibrated`, the nominal model stands for it,
    # its base aligned once on the unloaded positions
    models: Mapping[str, FittedModel]
    extended: Extended | None  # the model with the effects that are missing, or None
    setup: MeasurementSetup  # what is known of the campaign besides the poses

    def judge(
        self, *, kind: str = "holdout", elsewhere: bool = False, cuts_s: Sequence[float] = ()
    ) -> dict[str, results.HeldOutModel]:
        """Return errors by model on poses of one kind; none where there are no such poses.

        Elsewhere, in another campaign than that of the models, base and tool are fitted anew, the
        base part by part where it moved at times in order. There the extended model is never worse
        than the last of the others where base and tool were fitted: what does not stay with the arm
        is left out where it does not help, and its effects where they do not.

        Raises:
            CalibrationError: when base and tool are not determined by the poses.
        """
        every, models, extended, setup = self.every, self.models, self.extended, self.setup
        if not (every.kind == kind).any():
            return {}
        if UNCALIBRATED not in models:
            rigid = nominal(next(iter(models.values())).arm)
            T_instr_base = align_nominal(rigid, poses_of(every, "grid"))
            models = {UNCALIBRATED: FittedModel(rigid, np.zeros(0), T_instr_base), **models}

        # Those far from the last model, which knows most, by what its own poses scatter.
        *_, last_model = models.values()
        suspected = None
        if kind == "holdout" and not elsewhere and (every.kind == "grid").any():
            suspected = preparation.prepared(every, last_model, setup).suspected

        places = None
        if kind == "holdout" and not elsewhere:
            of_kinds = (average_repeats(every.of_kind(each)) for each in ("holdout", "grid"))
            places = HeldOutPlaces.of(*of_kinds)

        def judged(
            model: FittedModel, every: Observations, seen: AngleCoverage | None
        ) -> tuple[results.HeldOutModel, float]:
            """Return the errors of a model, and what it leaves of poses it is placed by."""
            left_mm = 0.0
            if elsewhere:
                there = placed(model, every, setup, cuts_s)
                model, left_mm = there.model, there.rms_mm
            poses = poses_for_model(every, kind, model, setup, cuts_s)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return held_out_errors(model, poses, beyond, suspected, places), left_mm

        learnt = None if extended is None else extended.seen
        # In another campaign what is new is told by the same angles for all models.
        seen = learnt or last_model.seen if elsewhere else None
        found, left_mm = {}, np.inf
        for name, model in models.items():
            found[name], left_mm = judged(model, every, seen)
        if extended is not None:
            *_, last = found.values()
            arrived = with_arrivals(every, last_model.arm)[0]
            if elsewhere:
                # Effects that do not even help in the poses to which base and tool were fitted stay
                # away.
                tried = [judged(each, arrived, seen or learnt) for each in self._carried]
                found[EXTENDED], _ = min([(last, left_mm), *tried], key=lambda each: each[1])
            else:
                found[EXTENDED], _ = judged(extended.model, arrived, seen or learnt)
        return found

    @property
    def _carried(self) -> tuple[FittedModel, ...]:
        """Return the extended model, and it without what may not hold in another campaign."""
        if self.extended is None:
            return ()
        whole = self.extended.model
        *_, last = self.models.values()
        known = {(term.id, term.of) for term in last.model.terms}
        terms = whole.model.terms
        kept = [each for each in terms if each.stays_with_arm or (each.id, each.of) in known]
        return (whole,) if len(kept) == len(terms) else (whole, whole.only(*kept))

    def judge_in_parts(
        self, cuts_s: Sequence[float]
    ) -> tuple[dict[str, results.HeldOutModel], tuple[results.PartOfCampaign, ...]]:
        """Judge the models with a base for every part of the campaign; return the parts too."""
        found = self.judge(elsewhere=True, cuts_s=cuts_s)
        return found, parts_of(*self.best(cuts_s), cuts_s)

    def best(self, cuts_s: Sequence[float] = ()) -> tuple[Placed, Observations]:
        """Return what leaves least of the calibration poses, and the readings as it takes them."""
        *_, last = self.models.values()
        best = placed(last, self.every, self.setup, cuts_s)
        arrived = with_arrivals(self.every, last.arm)[0]
        tried = [placed(each, arrived, self.setup, cuts_s) for each in self._carried]
        with_effects = min(tried, key=lambda each: each.rms_mm, default=best)
        return (with_effects, arrived) if with_effects.rms_mm < best.rms_mm else (best, self.every)


def held_out_record(
    campaign: CampaignIdentity, calibration: str, own: Evaluation
) -> results.HoldoutRecord:
    """Judge models on held-out poses of their own campaign.

    Where the verdict tells steps, they are judged with a base for every part as well.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    found = own.judge()
    cuts_s: Sequence[float] = ()
    if found and own.extended is not None and not own.every.measured.campaigns:
        cuts_s = worth_cutting(own.every, own.extended.steps_s)
    parts = by_parts = None
    if cuts_s:
        in_parts, parts = own.judge_in_parts(cuts_s)
        by_parts = _errors_of(in_parts)
    return results.HoldoutRecord(
        calibration=calibration,
        parts=parts,
        by_parts=by_parts,
        note=None if found else "no held-out rows measured",
        **_shared_keys(campaign, found),
    )


def transfer_record(
    campaign: CampaignIdentity, from_: str, there: Evaluation
) -> results.TransferRecord:
    """Judge models of one campaign in another, part by part where instrument or base moved there.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    found = there.judge(elsewhere=True)
    cuts_s: Sequence[float] = ()
    if found:
        best, arrived = there.best()
        cuts_s = steps_elsewhere(best.model, arrived, there.setup)
    parts = one_base = None
    if cuts_s:
        one_base = _errors_of(found)
        found, parts = there.judge_in_parts(cuts_s)
    return results.TransferRecord(
        from_=from_,
        parts=parts,
        one_base=one_base,
        worse=said_of_worse(found, from_) or None,
        **_shared_keys(campaign, found),
    )


def _shared_keys(
    campaign: CampaignIdentity, models: Mapping[str, results.HeldOutModel]
) -> dict[str, Any]:
    return {
        "campaign": campaign.name,
        "provenance": campaign.provenance,
        "configurations": max((each.configurations for each in models.values()), default=0),
        "models": models,
    }


def _errors_of(models: Mapping[str, results.HeldOutModel]) -> dict[str, results.Accuracy]:
    """Return the errors of models over all configurations."""
    return {
        name: results.Accuracy.model_validate(model, from_attributes=True)
        for name, model in models.items()
    }


def judged_where_repeated(
    own: Evaluation, *, held_out: Mapping[str, results.HeldOutModel]
) -> dict[str, Mapping[str, results.HeldOutModel]]:
    """Judge models on all configurations of the kinds that have repeats, by kind.

    Errors of the held-out poses are those that `own.judge()` gave.
    """
    found: dict[str, Mapping[str, results.HeldOutModel]] = {}
    for kind in _KINDS:
        single = own.every.of_kind(kind)
        if len(single) == len(np.unique(reading_groups(single))):
            continue
        known = held_out if kind == "holdout" else None
        found[kind] = known or own.judge(kind=kind)
    return found


def said_of_worse(models: Mapping[str, results.HeldOutModel], from_: str) -> str:
    """Return in one sentence which carried models are worse than the nominal arm; empty if none."""
    nominal_mm = models[UNCALIBRATED].rms_mm if models else 0.0
    worse = [
        f"{name} {model.rms_mm:.3f} mm rms"
        for name, model in models.items()
        if model.rms_mm > COMPARED.worse_ratio * nominal_mm
    ]
    if not worse:
        return ""
    return (
        f"worse here than the nominal arm, which has {nominal_mm:.3f} mm rms with base and tool "
        f"fitted alike: {', '.join(worse)}; what {from_} determined does not hold here, do not use "
        "it: calibrate this campaign, and compare the two models"
    )


def said_of_parts(parts: Sequence[results.PartOfCampaign]) -> str:
    """Return in one sentence how instrument or base moved between parts; empty where not."""
    moves = [
        f"{part.moved_by_mm:.2g} mm before {part.from_s:g} s"
        for part in parts
        if part.moved_by_mm is not None
    ]
    if not moves:
        return ""
    return f"instrument or base moved suddenly, by {', '.join(moves)}: a base for every part"


def summary(record: results.HoldoutRecord, *, springs: bool) -> str:
    """Return the errors in one line; without springs linear and cubic are one model."""
    if not record.models:
        return "no held-out rows to evaluate"
    rigid = {"linear": "calibrated", "cubic": ""}
    names = {name: name if springs else rigid.get(name, name) for name in record.models}
    by_place: dict[str, dict[str, results.PartAccuracy]] = {}
    for name, model in record.models.items():
        for words, part in model.by_place.items():
            by_place.setdefault(words, {})[name] = part
    told = []
    for words, models in by_place.items():
        errors = ", ".join(
            f"{names[name]} {results.mean_and_peak(part, part.trusted)}"
            for name, part in models.items()
            if names[name]
        )
        count = max(part.configurations for part in models.values())
        told.append(f"{words}{' ' * bool(words)}({count}): mean/peak {errors}")
    return f"held out {'; '.join(told)}"


def poses_for_model(
    every: Observations,
    kind: str,
    model: FittedModel,
    setup: MeasurementSetup,
    cuts_s: Sequence[float] = (),
) -> Observations:
    """Return averaged poses of one kind, with what the terms of a model need in their states."""
    poses = average_repeats(every.of_kind(kind), cuts_s)
    states, _ = with_torques(model.model, model.x, poses.states, setup.payload)
    poses = poses.with_states(states)
    read = measured_as_poses(poses) if poses.measured.measures_pose else poses
    turned = read.turned(model.R_ee_target)
    return poses.with_states(complete_about(turned, model.nominal(), model, setup).states)


def held_out_errors(
    model: FittedModel,
    held_out: Observations,
    extrapolated: Mask | None = None,
    suspected: Mask | None = None,
    places: HeldOutPlaces | None = None,
) -> results.HeldOutModel:
    """Return errors of one model over P `poses_for_model`, by load, point, pose and place.

    Some leave the joint angles that the model has learnt from, (P,); None where it has learnt
    nothing that stops there. Some have a suspected reading, (P,); None for none.
    """
    found, labels = model.deviations(held_out), np.unique(held_out.pose)
    twist, attitudes = None, held_out.measured.turned(model.R_ee_target).attitudes
    if attitudes is not None:
        R_predicted = model.T_instr_base[:3, :3] @ model.as_read(held_out)[:, :3, :3]
        twist = constant_tool_twist(R_predicted, attitudes)

    def errors(rows: Mask | None) -> results.Accuracy | None:
        return summarise(found, rows) if rows is not None and rows.any() else None

    def part(rows: Mask | None) -> results.PartAccuracy | None:
        if rows is None:
            return None
        trusted = None
        if suspected is not None and (suspected & rows).any():
            trusted = errors(rows & ~suspected)
        return results.PartAccuracy(**dict(summarise(found, rows)), trusted=trusted)

    return results.HeldOutModel(
        **dict(summarise(found)),
        per_load=summarise_by_load(found, held_out.states.load_N),
        per_point={
            str(label): summarise(found, held_out.pose == label)
            for label in (labels if len(labels) <= COMPARED.most_points else ())
        },
        tool_twist=twist,
        inside=errors(None if extrapolated is None else ~extrapolated),
        outside=errors(extrapolated),
        trusted=errors(None if suspected is None else ~suspected),
        unseen=part(None if places is None else places.unseen),
        between=part(None if places is None else places.between),
        rows=results.HeldOutRows(
            pose=held_out.pose,
            load_N=held_out.states.load_N,
            position_mm=found.position_mm,
            error_mm=found.distance_mm,
            rotation_deg=found.rotation_deg,
            extrapolated=extrapolated,
        ),
    )


# How much of an orientation error a constant twist of the tool would explain.
#
# After calibration the paper's orientations agree to 0.05 deg, yet to 1.2 deg on held-out points: a
# tool that sat differently on the flange between the two sessions would show just so.


def constant_tool_twist(R_predicted: Array, R_measured: Array) -> results.ToolTwist:
    """Fit one rotation of the tool to the differences of (P, 3, 3) orientations."""
    difference = Rotation.from_matrix(R_predicted.transpose(0, 2, 1) @ R_measured)
    twist = difference.mean()
    left = twist.inv() * difference
    return results.ToolTwist(
        rotation_deg=np.degrees(twist.as_rotvec()),
        angle_deg=float(np.degrees(twist.magnitude())),
        before_deg=float(np.degrees(difference.magnitude()).mean()),
        after_deg=float(np.degrees(left.magnitude()).mean()),
    )


# A campaign in which instrument or base moved suddenly: a base for every part of it, one tool. The
# search in time (`discovery.in_time`) looks at what the carried model leaves of the calibration
# poses; held-out poses have no part in it.


@dataclass(frozen=True, eq=False)
class Placed:
    """A model whose base and tool were fitted to the calibration poses of a campaign."""

    model: FittedModel  # the model there
    poses: Observations  # those poses, averaged, with what its terms need
    rms_mm: float  # what it leaves of them


def placed(
    model: FittedModel, every: Observations, setup: MeasurementSetup, cuts_s: Sequence[float] = ()
) -> Placed:
    """Fit base and tool of a model to the calibration poses of a campaign, part by part.

    Raises:
        CalibrationError: when the poses do not determine base and tool.
    """
    logged = bool(np.isfinite(every.states.tau_Nm).all())
    model = with_tool_of(model, setup.payload, logged=logged)
    poses = poses_for_model(every, "grid", model, setup, cuts_s)
    there = refit_frames(model, poses, cuts_s)
    return Placed(there, poses, summarise(there.deviations(poses)).rms_mm)


def steps_elsewhere(
    model: FittedModel, every: Observations, setup: MeasurementSetup
) -> tuple[float, ...]:
    """Return when instrument or base moved suddenly [s], by what a carried model leaves.

    Empty where the search in time finds no step that is certain, where the order of rows is no
    time, and in a group, each of whose campaigns has its own base. Base and tool of the model were
    fitted to the calibration poses.
    """
    readings = every.of_kind("grid").turned(model.R_ee_target)
    if readings.measured.campaigns or not len(readings):
        return ()
    model = replace(model.with_bends(), covariance=None, falls_back=None)
    states, torques = with_torques(model.model, model.x, readings.states, setup.payload)
    poses = complete(readings.with_states(states), model, setup)
    at = replace(model, model=with_base_term(model), x=np.concatenate([model.x, np.zeros(6)]))
    left, fitted = residual(at, poses), float(COMPARED.of_frames)
    group = same_circumstances(poses)
    if np.bincount(group).max() > 1:  # then repeats show the noise
        left = left - group_means(left, group)[group]
        fitted = float(group.max() + 1) * left.shape[1]
    found = in_time_of(
        at,
        poses,
        pose_weights(left, fitted, poses.measured).whiteners(np.arange(len(poses))),
        sought(context_of(poses, model, setup), model.model.terms),
        logged=torques == "logged",
        weights=poses.states.static_loads is not None,
    )
    if found.wander is None:
        return ()
    return worth_cutting(every, steps_told(steps_in_time(found.wander, at, poses)))


def worth_cutting(every: Observations, steps_s: Sequence[float]) -> tuple[float, ...]:
    """Return the steps at which to part a campaign in order of time, of those by certainty.

    A part with too few calibration poses for a base of its own joins its neighbour across the less
    certain step.
    """
    readings, kept = every.of_kind("grid"), list(steps_s)
    while kept:
        cuts_s = sorted(kept)
        short = [k for k, enough in enumerate(_enough(readings, cuts_s)) if not enough]
        if not short:
            break
        sides = cuts_s[max(short[0] - 1, 0) : short[0] + 1]
        kept.remove(max(sides, key=kept.index))
    return tuple(sorted(kept))


def parts_of(
    found: Placed, every: Observations, cuts_s: Sequence[float]
) -> tuple[results.PartOfCampaign, ...]:
    """Return the parts of a campaign, and how the base of every part of a model moved."""
    model, states = found.model, found.poses.states
    before = replace(states, time_s=np.full(len(states), cuts_s[0]))
    ends_m = model.model.predict(before, model.x)[:, :3, 3]
    bases = [np.eye(4)]
    for term in model.model.terms:
        if term.holds == "part":
            small = np.zeros(6)
            small[[BASE.index(name) for name in term.coordinates]] = model.values_of(term)
            bases.append(motion_of_base(small))
    moved: list[tuple[float | None, float | None]] = [(None, None)]
    for last, next_ in pairwise(bases):
        by_m = ends_m @ (next_ - last)[:3, :3].T + (next_ - last)[:3, 3]
        turned = Rotation.from_matrix(next_[:3, :3].T @ last[:3, :3]).magnitude()
        moved.append((1e3 * float(np.sqrt(np.mean(np.sum(by_m**2, axis=1)))), 1e3 * float(turned)))
    part = part_of(every.states.time_s, cuts_s)
    parts = []
    for k, (moved_mm, turned_mrad) in enumerate(moved):
        here = every.take(part == k)
        parts.append(
            results.PartOfCampaign(
                from_s=float(here.states.time_s.min()),
                to_s=float(here.states.time_s.max()),
                poses=_configurations(here, "grid"),
                held_out=_configurations(here, "holdout"),
                moved_by_mm=moved_mm,
                turned_by_mrad=turned_mrad,
            )
        )
    return tuple(parts)


def _configurations(every: Observations, kind: str) -> int:
    return len(np.unique(reading_groups(every.of_kind(kind))))


def _enough(readings: Observations, cuts_s: Sequence[float]) -> list[bool]:
    """Return whether each part has enough calibration poses for a base of its own."""
    part, group = part_of(readings.states.time_s, cuts_s), reading_groups(readings, cuts_s)
    seen = readings.measured.components_seen
    found = []
    for k in range(len(cuts_s) + 1):
        here = np.unique(group[part == k], return_index=True)[1]
        components = int(seen[part == k][here].sum())
        found.append(
            len(here) >= COMPARED.own_base_poses and components >= COMPARED.own_base_components
        )
    return found
