"""The Monte Carlo of one plane (paper, Section II.D): places, draws, closed form, map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.errors import ArmError
from pa10cal.montecarlo.displacement import joint_motion, plan_displacement
from pa10cal.montecarlo.places import Places, draw_places, grid_places, reference_in_plane
from pa10cal.montecarlo.sampling import ErrorSums, Progress, sample_errors, stream
from pa10cal.montecarlo.statistics import ExpectedError, counts_of, expected_error


@dataclass(frozen=True)
class PlaneTask:
    """What to compute."""

    plane_mm: int  # height of the flange above the base
    reach_m: tuple[float, float]  # least and greatest distance of the flange from the base z axis
    positions: int  # places drawn
    cycles: int  # draws at each place
    sigma_rad: float  # standard uncertainty of every joint
    random_seed: int  # of places and draws
    map_spacing_m: float  # grid of the map


@dataclass(frozen=True)
class PlaneErrors:
    """Errors in one plane."""

    places: Places  # P places that were drawn
    sums: ErrorSums  # of the drawn errors there
    expected: ExpectedError  # closed form there
    map_places: Places  # K places of the map
    map_expected: ExpectedError  # closed form there


def study_plane(
    arm: Arm, task: PlaneTask, progress: Progress = lambda _done, _all: None
) -> PlaneErrors:
    """Draw resolver errors at places of one plane and set the closed form beside them.

    Args:
        arm: the nominal arm.
        task: what to compute.
        progress: called before the first and after every position.

    Raises:
        SettingsError: when the plane cannot be reached or the map is too fine.
        ArmError: when a joint slides.
    """
    _refuse_sliding_joints(arm)
    chain = Chain.of(arm)
    reference = reference_in_plane(chain, 1e-3 * task.plane_mm, task.reach_m)
    map_places = grid_places(chain, reference, task.reach_m, task.map_spacing_m)
    map_motion = joint_motion(chain, map_places.q_rad)
    source = stream(task.random_seed, task.plane_mm, None)
    places = draw_places(chain, reference, task.reach_m, task.positions, source)
    motion = joint_motion(chain, places.q_rad)
    streams = [
        stream(task.random_seed, task.plane_mm, position) for position in range(task.positions)
    ]
    plan = plan_displacement(motion, task.sigma_rad)
    return PlaneErrors(
        places=places,
        sums=sample_errors(plan, streams, counts_of(task.cycles), progress),
        expected=expected_error(motion.jacobian, task.sigma_rad),
        map_places=map_places,
        map_expected=expected_error(map_motion.jacobian, task.sigma_rad),
    )


def _refuse_sliding_joints(arm: Arm) -> None:
    if arm.prismatic.any():
        raise ArmError(
            "resolver uncertainty is an angle, but a joint is prismatic",
            where=arm.name,
            value=f"joint {int(np.argmax(arm.prismatic)) + 1}",
            allowed="arms with revolute joints only",
            remedy="do not run the Monte Carlo for this robot",
        )
