"""Where a fit and the data disagree, and errors name by name: parts of `analysis.json`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery import lack_of_fit as domain
from pa10cal.discovery.clustered import Estimate
from pa10cal.discovery.evidence.pure_error import ChannelTest, PureErrorTest
from pa10cal.discovery.joint_space import Periodogram
from pa10cal.discovery.naming import Named
from pa10cal.discovery.records import name_of
from pa10cal.results import accuracy
from pa10cal.results import analysis as parts

Array = NDArray[np.float64]

#: Digits of what is there to be drawn.
_DIGITS = 6


def lack_of_fit_part(found: domain.LackOfFit) -> parts.LackOfFit:
    """Return the numbers of a lack of fit."""
    return parts.LackOfFit(
        pose=_channel(found.pose),
        torque=None if found.torque is None else _channel(found.torque),
        rms_mm=found.rms_mm,
        floor_mm=found.floor_mm,
        by_load=_parts(found.by_load),
        by_pose=_parts(found.by_pose),
        by_axis=_parts(found.by_axis),
        by_joint=tuple(
            parts.JointPart(
                joint=part.joint,
                rms_rad=part.rms_rad,
                floor_rad=part.floor_rad,
                arrivals=tuple(
                    parts.JointArrival(
                        direction=arrival.direction,
                        cells=arrival.cells,
                        mean_rad=arrival.mean.value,
                        std_rad=_known(arrival.mean.std),
                    )
                    for arrival in part.arrivals
                ),
                periodogram=_periodogram(part.periodogram),
            )
            for part in found.by_joint
        ),
        by_torque=tuple(
            parts.TorquePart(
                joint=part.joint,
                rms_Nm=part.rms_Nm,
                noise_Nm=part.noise_Nm,
                arrivals=tuple(
                    parts.TorqueArrival(
                        direction=arrival.direction,
                        cells=arrival.cells,
                        mean_Nm=arrival.mean.value,
                        std_Nm=_known(arrival.mean.std),
                    )
                    for arrival in part.arrivals
                ),
            )
            for part in found.by_torque
        ),
        drifts=tuple(
            parts.Drift(
                axis=drift.axis,
                by_time_mm_per_h=_estimate(drift.mm_per_h),
                by_temperature_mm_per_K=None
                if drift.mm_per_K is None
                else _estimate(drift.mm_per_K),
            )
            for drift in found.drifts
        ),
        cells=_cells(found),
    )


def naming_steps(steps: Iterable[Named]) -> tuple[parts.NamingStep, ...]:
    """Return the errors of each step; the effects are all those in the model by then."""
    return tuple(
        parts.NamingStep(
            effects=tuple(name_of(effect) for effect in step.effects),
            train=step.train,
            holdout=step.holdout,
        )
        for step in steps
    )


def _cells(found: domain.LackOfFit) -> parts.Cells:
    states = found.cells.states
    torque = found.torque_left_Nm
    x_mm, y_mm, z_mm = _rounded(found.position_mm).T
    return parts.Cells(
        pose=found.cells.pose,
        load_N=_rounded(states.load_N),
        readings=found.cells.readings,
        time_s=_rounded(states.time_s),
        temperature_C=_rounded(states.temperature_C),
        position_x_mm=x_mm,
        position_y_mm=y_mm,
        position_z_mm=z_mm,
        joints=tuple(
            parts.CellJoint(
                joint=j + 1,
                q_rad=_rounded(states.q_rad[:, j]),
                arrival=_rounded(states.arrival[:, j]),
                error_rad=_rounded(found.joints.error_rad[:, j]),
                std_rad=_rounded(found.joints.std_rad[:, j]),
                torque_residual_Nm=None if torque is None else _rounded(torque[:, j]),
            )
            for j in range(states.n)
        ),
    )


def _channel(found: ChannelTest) -> parts.Channel:
    return parts.Channel(
        shared=_test(found.shared),
        unshared=_test(found.unshared),
        shared_variance_of_a_reading=found.shared_variance,
    )


def _test(found: PureErrorTest | None) -> parts.PureErrorTest | None:
    if found is None:
        return None
    return parts.PureErrorTest(
        chi_square=found.chi_square,
        dof=found.dof,
        pure_error_dof=found.pure_dof,
        F=found.ratio,
        p_value=found.p_value,
    )


def _parts(found: Iterable[domain.Part]) -> tuple[parts.ErrorPart, ...]:
    return tuple(
        parts.ErrorPart(of=part.of, cells=part.cells, rms_mm=part.rms_mm, floor_mm=part.floor_mm)
        for part in found
    )


def _estimate(found: Estimate) -> accuracy.Estimate:
    return accuracy.Estimate(value=found.value, std=_known(found.std))


def _known(number: float) -> float | None:
    return number if np.isfinite(number) else None


def _periodogram(found: Periodogram | None) -> parts.Periodogram | None:
    if found is None:
        return None
    return parts.Periodogram(
        orders=_rounded(found.orders),
        explained_rad=_rounded(found.explained_rad),
        marked=np.array(found.marked),
        marked_rad=_rounded(found.marked_rad),
    )


def _rounded(values: Array) -> Array:
    """Return numbers rounded to what a picture shows."""
    flat = [float(f"{value:.{_DIGITS}g}") for value in np.ravel(values).tolist()]
    return np.array(flat).reshape(np.shape(values))
