"""Scatter of repeats beside the stated uncertainty; errors beside uncertain predictions."""

from types import SimpleNamespace

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.calibration.accuracy import HeldOut
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.uncertainty import scatter_of_repeats
from pa10cal.interface import calibrate, read_campaign
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.quantities import Deviations
from pa10cal.results.evaluation import Accuracy


def test_scatter_of_repeats_along_unlike_axes_is_that_of_a_coordinate(tmp_path):
    """Of a camera that is ten times less certain in depth, stated as rms of a coordinate."""
    noise_mm = np.array([0.1, 0.1, 1.0])
    u_mm = float(np.sqrt(np.mean(noise_mm**2)))
    raw = sighted(tmp_path, "pose", poses=45, repeats=2)
    rng = np.random.default_rng(0)
    columns = [raw.column(name) for name in ("x_mm", "y_mm", "z_mm")]
    for row, line in enumerate(raw.poses[1:], start=1):
        words = line.split(",")
        for k, error_mm in zip(columns, noise_mm * rng.normal(size=3), strict=True):
            words[k] = f"{float(words[k]) + error_mm:.6f}"
        raw.poses[row] = ",".join([*words, *[f"{u_mm:.3f}"] * 3])
    raw.poses[0] += ",u_x_mm,u_y_mm,u_z_mm"
    campaign = read_campaign(raw.write())
    place = scatter_of_repeats(campaign.observations, calibrate(campaign))[0]
    assert place.stated == pytest.approx(1e-3 * u_mm, rel=0.01)
    assert place.found == pytest.approx(1e-3 * u_mm, rel=0.3)


def test_independent_deviations_of_predictions_are_counted():
    rng, errors_of = np.random.default_rng(3), Deviations(np.ones(50), np.ones((50, 3)), None)
    whole, alike = rng.normal(size=(50, 3, 6)), np.ones((50, 3, 1))
    for position, cov, least, most in (
        (whole, 1e-8 * np.eye(6), 5.0, 6.0),
        (whole, np.diag([1e-8, *[1e-14] * 5]), 1.0, 1.01),
        (alike, np.full((1, 1), 1e-8), 1.0, 1.0),
    ):
        found = HeldOut.of(
            errors_of, HeldOutPlaces(), np.ones(50, bool), np.ones(50, int), np.ones(50, int)
        ).with_predictions(position, cov)
        assert least <= found.independent <= most + 1e-9
        square = np.einsum("pck,kl,pcl->p", position, cov, position)
        assert found.u_mm == pytest.approx(1e3 * np.sqrt(square.mean()))


@pytest.mark.parametrize(
    ("rms_mm", "u_mm", "independent", "over"),
    [
        (0.135, 0.065, 60.0, True),
        (0.135, 0.065, 1.2, False),  # one parameter is off by 2 u in one campaign of twenty
        (0.25, 0.065, 1.2, True),
        (0.035, 0.001, 1.2, True),  # noise is of each pose by itself
    ],
)
def test_deviations_that_one_uncertain_parameter_makes_in_all_poses_are_one(
    rms_mm, u_mm, independent, over
):
    errors = Accuracy(
        mean_mm=rms_mm, peak_mm=rms_mm, rms_mm=rms_mm, orientation_deg=None, configurations=60
    )
    fit = SimpleNamespace(taken=0.0, white=np.ones((40, 3, 1)))
    left = HeldOut(errors, u_mm, independent)
    evidence = GradeEvidence(fit, 0.0173, left, 0.0173, 500.0)
    assert (evidence.over_expected is not None) is over
