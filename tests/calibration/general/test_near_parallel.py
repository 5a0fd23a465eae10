"""Axes all but parallel: links stay as long as they are, whatever says their direction."""

from dataclasses import replace

import numpy as np
import pytest

from calibrated import general
from pa10cal.arm.description import with_hayati_rows
from pa10cal.calibration.general.as_model import fitted
from pa10cal.files.arms import load_arm

TILTS_DEG = (0.01, 0.1, 0.5)
ROBOTS = ("ur10", "gx4_351s")


def tilted(robot, tilt_deg):
    """Tilt the parallel axes of an arm against each other, one to one side, the next to another."""
    arm = load_arm(robot)
    sides = np.where(np.arange(arm.n) % 2, -0.7, 1.0) * arm.hayati
    return with_hayati_rows(replace(arm, alpha_rad=arm.alpha_rad + np.radians(tilt_deg) * sides))


def lengths_mm(found):
    return {
        parameter.name: 1e3 * value
        for parameter, value in zip(found.problem.parameters, found.fit.x, strict=True)
        if parameter.name.startswith("delta_") and parameter.unit == "m"
    }


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kind", ["pose", "point", "distance"])
@pytest.mark.parametrize("tilt_deg", TILTS_DEG)
@pytest.mark.parametrize("robot", ROBOTS)
def test_tilts_that_the_description_does_not_know_are_found(see, robot, tilt_deg, kind):
    true, described = tilted(robot, tilt_deg), load_arm(robot)
    # The height of a target on the SCARA is told by that of its base: held at zero, so put there.
    targets_m = np.array([[0.04, -0.03, 0.0]])
    observations = see(true, kind, count=80, noise_m=5e-5, size=0.0, targets_m=targets_m)
    found = general(described, observations)
    assert found.fit.converged
    tilt_rad = true.alpha_rad - described.alpha_rad
    tilts = {f"delta_alpha_{row}": tilt for row, tilt in enumerate(tilt_rad, start=1)}
    std = np.sqrt(np.diag(found.fit.covariance))
    scores = {
        parameter.name: (value - tilts.get(parameter.name, 0.0)) / sigma
        for parameter, value, sigma in zip(found.problem.parameters, found.fit.x, std, strict=True)
        if parameter.name.startswith("delta_")
    }
    assert max(map(abs, scores.values())) < 4.0
    assert max(map(abs, lengths_mm(found).values())) < 0.5


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("kind", ["pose", "point", "points", "distance"])
@pytest.mark.parametrize("tilt_deg", TILTS_DEG)
@pytest.mark.parametrize("robot", ROBOTS)
def test_tilts_that_the_description_knows_lengthen_no_link(see, robot, tilt_deg, kind):
    """Departures of every kind, those too that the model leaves to others."""
    arm = tilted(robot, tilt_deg)
    observations = see(arm, kind, count=80, noise_m=5e-5)
    found = general(arm, observations)
    assert found.fit.converged
    assert max(map(abs, lengths_mm(found).values())) < 3.0
    others = fitted(found).deviations(see(arm, kind, count=40))
    assert others.distance_mm.max() < 0.15


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kind", ["pose", "point", "points", "distance"])
@pytest.mark.parametrize("tilt_deg", TILTS_DEG)
def test_a_tilt_does_not_change_what_is_left_out(see, tilt_deg, kind):
    """One that is known to be small: the height of tool or target, not the turn of a link."""

    def left_out(arm):
        found = general(arm, see(arm, kind))
        parts = [abs(part) for each in found.redundant for part in each.replaced_by.values()]
        return {each.name for each in found.redundant}, max(parts)

    names, _ = left_out(load_arm("gx4_351s"))
    tilted_names, largest = left_out(tilted("gx4_351s", tilt_deg))
    assert tilted_names == names
    assert largest < 3.0
