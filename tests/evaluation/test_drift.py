"""One arm over campaigns, and a model adapted to more and more poses of another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_up_pair import campaign, parts, shifted
from pa10cal.errors import ModelError
from pa10cal.evaluation.drift import drift
from pa10cal.figures.draw import write_drift
from pa10cal.terms.of_campaign import OfCampaign
from pa10cal.terms.term import base_frame, tool_frame

NAMES = ("june", "july", "august")


def test_every_parameter_is_there_with_its_interval_and_what_moved_is_told():
    models = [campaign(1), campaign(2), shifted(campaign(3), delta_theta_3=1e-3)]
    found = drift(models, NAMES)
    rows = found.parameters
    assert set(rows.campaign) == set(NAMES)
    at = (rows.parameter == "delta_theta_3") & (rows.campaign == "august")
    assert rows.high[at] - rows.value[at] == pytest.approx(1.96 * rows.std[at])
    assert [step.what_moved.verdict for step in found.steps] == ["unchanged", "joint_zero_moved"]
    assert found.line.startswith("july to august: joint zero moved: the zero of joint 3")
    assert not set(rows.of) & {"tool", "base"}
    assert drift([campaign(1), campaign(2)], NAMES[:2]).line == "unchanged over 2 campaigns"


def test_bases_and_tools_of_the_campaigns_of_a_group_are_not_of_the_arm():
    def of_group(arm):
        of_second = (OfCampaign(frame, 1, "second") for frame in (base_frame(), tool_frame()))
        return (*parts(arm), *of_second)

    found = drift([campaign(k, terms=of_group) for k in (1, 2)], NAMES[:2])
    assert not {of.partition("@")[0] for of in found.parameters.of} & {"tool", "base"}


@pytest.mark.slow
def test_one_picture_shows_all(tmp_path):
    models = [campaign(1), campaign(2), shifted(campaign(3), delta_theta_3=1e-3)]
    write_drift(drift(models, NAMES), tmp_path, "drift", 80)
    assert {path.name for path in tmp_path.iterdir()} == {"drift.svg", "drift.pdf", "drift.png"}


@pytest.mark.parametrize(
    ("models", "names", "message"),
    [
        ([campaign(1)], ("june",), "drift over a single model"),
        ([campaign(1), replace(campaign(2), covariance=None)], NAMES[:2], "covariance"),
        ([campaign(1), campaign(2)], ("june", "june"), "two models of the same name"),
        ([campaign(1), campaign(2, robot="ur10")], NAMES[:2], "different layouts"),
    ],
)
def test_what_cannot_be_drawn_is_refused(models, names, message):
    with pytest.raises(ModelError, match=message):
        drift(models, names)


@pytest.mark.slow
def test_intervals_hold_what_a_seed_of_noise_moves():
    found = drift([campaign(k) for k in range(10, 30)], [f"c{k}" for k in range(20)])
    rows = found.parameters
    at = rows.parameter == "delta_theta_4"
    spread = np.std(rows.value[at])
    assert spread == pytest.approx(np.mean(rows.std[at]), rel=0.5)
