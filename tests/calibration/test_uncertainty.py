"""Scatter of repeats beside the stated uncertainty."""

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.calibration.uncertainty import scatter_of_repeats
from pa10cal.interface import calibrate, read_campaign


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
