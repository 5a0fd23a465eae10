"""What a description says of the tool, and what nobody said."""

import pytest

from made_up_sightings import sighted
from pa10cal.campaign.description import Tool, read_description
from pa10cal.files.arms import load_arm


@pytest.mark.parametrize(
    ("stated", "u_m"),
    [
        ({"mass_kg": 3.2, "com_mm": (0, 0, 0)}, 0.1),
        ({"mass_kg": 3.2, "com_mm": (0, 0, 0), "load_point_mm": (0, 30, 40)}, 0.05),
        ({"mass_kg": 3.2, "com_mm": (0, 0, 0), "balls_mm": {"T1": (0, 0, 240)}}, 0.24),
        ({"mass_kg": 3.2, "com_mm": (0, 0, 60)}, None),
        ({"mass_kg": 0.0, "com_mm": (0, 0, 0)}, None),  # of an unknown mass the whole is unknown
    ],
)
def test_a_centre_of_mass_at_the_flange_is_one_that_nobody_stated(stated, u_m):
    """It lies somewhere along the tool."""
    tool = Tool.model_validate({"load_point_mm": (0, 0, 0), **stated})
    assert tool.com_u_m == (None if u_m is None else pytest.approx(u_m))


def test_without_gravity_no_weights_are_calculated(tmp_path):
    raw = sighted(tmp_path, "points")
    raw.description["gravity_m_s2"] = [0, 0, 0]
    arm = load_arm("ur10")
    campaign = read_description(raw.write())
    assert campaign.payload(arm) is None
    assert campaign.model_copy(update={"gravity_m_s2": (0.0, 0.0, -9.81)}).payload(arm) is not None
