"""Lost motion in simulated arms whose motors are logged: named where links lag, and only there."""

import numpy as np
import pytest
from benchmarks.lost_motion import judged, with_lost_motion


@pytest.mark.slow
@pytest.mark.parametrize("leads", [False, True])
def test_a_link_that_lags_has_backlash_and_one_that_leads_has_none(tmp_path, leads):
    _, joint, b_rad = with_lost_motion(tmp_path / "arm", np.random.default_rng([1, 3]), leads)
    word, named = judged(tmp_path / "arm")
    assert (b_rad < 0.0) == leads
    if leads:
        assert not any("backlash" in name for name in named)
    else:
        assert word in (
            "named",
            "ambiguous",
        )  # 0.94 beside a lost motion that varies with the angle
        assert named == (f"backlash of joint {joint}",)
