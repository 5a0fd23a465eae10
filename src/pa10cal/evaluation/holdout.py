"""Models judged on held-out points and loads (paper, Section II.E and Fig. 6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import summarise, summarise_by_load
from pa10cal.calibration.records import by_load
from pa10cal.discovery.preparation import MeasurementSetup, complete_about
from pa10cal.evaluation.tool_twist import constant_tool_twist
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import with_torques
from pa10cal.observe.averages import average_repeats, measured_as_poses
from pa10cal.observe.observations import Observations
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.evaluation import HeldOutModel, HeldOutRows, ToolTwist

#: More points than this are listed pose by pose only.
_MOST_POINTS = 500


def prepared(
    every: Observations,
    kind: str,
    model: FittedModel,
    setup: MeasurementSetup,
    cuts_s: Sequence[float] = (),
) -> Observations:
    """Return averaged poses of one kind, with what the terms of a model need in their states.

    Args:
        every: single readings of a campaign.
        kind: `grid` or `holdout`.
        model: the model that is to predict them.
        setup: what is known of the campaign besides the poses.
        cuts_s: times that part the campaign.
    """
    poses = average_repeats(every.of_kind(kind), cuts_s)
    states, _ = with_torques(model.model, model.x, poses.states, setup.payload)
    poses = poses.with_states(states)
    read = measured_as_poses(poses) if poses.measured.measures_pose else poses
    turned = read.turned(model.R_ee_target)
    return poses.with_states(complete_about(turned, model.nominal(), model, setup).states)


def judged(
    model: FittedModel,
    held_out: Observations,
    extrapolated: NDArray[np.bool_] | None = None,
    suspected: NDArray[np.bool_] | None = None,
) -> HeldOutModel:
    """Return errors of one model over held-out poses, by load, by point and pose by pose.

    Args:
        model: the model.
        held_out: P poses, `prepared` for it.
        extrapolated: (P,) which of them leave the joint angles that the model has learnt from;
            None where it has learnt nothing that stops there.
        suspected: (P,) which of them have a suspected reading; None for none.
    """
    found = model.deviations(held_out)

    def errors(rows: NDArray[np.bool_] | None) -> Accuracy | None:
        return summarise(found.take(rows)) if rows is not None and rows.any() else None

    return HeldOutModel(
        **dict(summarise(found)),
        per_load=by_load(summarise_by_load(found, held_out.states.load_N)),
        per_point={
            str(label): summarise(found.take(held_out.pose == label)) for label in _points(held_out)
        },
        tool_twist=_twist(model, held_out),
        inside=errors(None if extrapolated is None else ~extrapolated),
        outside=errors(extrapolated),
        trusted=errors(None if suspected is None else ~suspected),
        rows=HeldOutRows(
            pose=held_out.pose,
            load_N=held_out.states.load_N,
            position_mm=found.position_mm,
            error_mm=found.distance_mm,
            rotation_deg=found.rotation_deg,
            extrapolated=extrapolated,
        ),
    )


def _points(held_out: Observations) -> NDArray[np.str_]:
    labels = np.unique(held_out.pose)
    return labels if len(labels) <= _MOST_POINTS else labels[:0]


def _twist(model: FittedModel, held_out: Observations) -> ToolTwist | None:
    attitudes = held_out.measured.turned(model.R_ee_target).attitudes
    if attitudes is None:
        return None
    R_predicted = model.T_instr_base[:3, :3] @ model.as_read(held_out)[:, :3, :3]
    return constant_tool_twist(R_predicted, attitudes)
