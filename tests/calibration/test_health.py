"""One plain line that says whether a calibration is good."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.calibration.design import pose_design, poses_needed
from pa10cal.calibration.health import Errors, FitSummary, health
from pa10cal.fit.identifiability import identify, not_identifiable
from pa10cal.terms.term import Parameter

NOISE_M = 1e-5


def ended(poses=40, unknowns=6, told=None, **changes):
    """A linear fit of positions with so many unknowns, of which the rows tell some."""
    generator = np.random.default_rng(poses)
    told = unknowns if told is None else told
    position = generator.standard_normal((poses, 3, unknowns))
    position[:, :, told:] = 0.0
    parameters = tuple(Parameter(f"delta_a_{k}", "m", 1e-3) for k in range(1, unknowns + 1))
    white = position / NOISE_M
    found = identify(white.reshape(-1, unknowns), np.full(unknowns, 1e-3))
    flat = white[:, :, :told].reshape(-1, told)
    covariance = np.zeros((unknowns, unknowns))
    covariance[:told, :told] = np.linalg.inv(flat.T @ flat)
    made = FitSummary(
        True, "settled", 5, (), parameters, covariance, found, white, position,
        not_identifiable(found, parameters),
    )  # fmt: skip
    return replace(made, **changes)


def accuracy(mean_mm, peak_mm, rms_mm, configurations):
    """Errors of positions alone."""
    return Accuracy(
        mean_mm=mean_mm,
        peak_mm=peak_mm,
        rms_mm=rms_mm,
        orientation_deg=None,
        configurations=configurations,
    )


def errors(**changes):
    """What noise alone leaves."""
    left = accuracy(0.017, 0.03, 0.0173, 60)
    return replace(Errors(0.0167, left, 0.0173, 500.0), **changes)


def test_a_fit_down_to_the_noise_is_good():
    found = health(ended(), errors())
    assert found.verdict == "good"
    assert "all 6 unknowns" in found.line


@pytest.mark.parametrize(
    ("fit", "left", "verdict", "says"),
    [
        ({"converged": False, "reason": "50 steps"}, {}, "not usable", "did not converge: 50"),
        ({}, {"train_rms_mm": 6.0}, "not usable", "does not fit the readings"),
        ({"told": 3}, {}, "not usable", "identify only 3 of 6"),
        ({"told": 5}, {}, "usable", "not identifiable with these poses: delta_a_6"),
        ({"at_bound": ("cubic_share_2",)}, {}, "usable", "cubic_share_2 at the end"),
        ({"at_bound": ("windup_2",)}, {}, "good", "all 6"),
        ({}, {"noise_mm": 0.004}, "usable", "missing an effect"),
        ({}, {"suspected_outliers": 1}, "usable", "1 suspected outlier is excluded"),
        ({}, {"held_out": accuracy(0.04, 0.1, 0.05, 60)}, "usable", "larger errors than expected"),
    ],
)
def test_what_is_wrong_is_said(fit, left, verdict, says):
    found = health(ended(**fit), errors(**left))
    assert found.verdict == verdict
    assert says in found.line


def test_a_few_poses_promise_larger_errors_elsewhere():
    # Eight unknowns of twelve equations: residuals shrink to 0.58 of the errors.
    few = ended(poses=4, unknowns=8)
    train_rms_mm = 0.0173 * np.sqrt(1.0 - 8.0 / 12.0)
    seen = accuracy(0.02, 0.05, 0.0173, 60)
    found = health(few, errors(train_rms_mm=train_rms_mm, held_out=seen))
    assert "larger errors than expected" not in found.line


def test_the_first_poses_of_the_d_optimal_order_tell_more_than_any_others():
    made = ended(poses=30)
    design = pose_design(made.white, made.position, np.full(6, 1e-3), 6)
    assert sorted(design.order) == list(range(30))
    both = np.isfinite(design.u_optimal_m)
    assert np.all(np.diff(design.u_optimal_m[both]) < 0.0)
    assert design.u_optimal_m[-1] == pytest.approx(design.u_all_m)
    some = np.flatnonzero(design.numbers == 5)[0]
    assert design.u_optimal_m[some] < design.u_measured_m[some]
    wanted = poses_needed(design, float(design.u_optimal_m[some]))
    assert wanted == 5
    assert poses_needed(design, 0.0) is None
