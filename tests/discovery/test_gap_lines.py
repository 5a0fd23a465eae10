"""What the log says of the error before and after."""

import pytest

from made_up_records import accuracy, set_gap
from pa10cal.results.discovery import Reduction
from pa10cal.stages.discover import gap_lines


@pytest.mark.parametrize(
    ("kind", "after_mm", "low_mm", "said"),
    [
        ("train", 0.02, 0.02, "less by 0.0200 to 0.0366 mm (95 %); noise"),
        (
            "train",
            0.001,
            0.02,
            "below the noise: the fit passes through its poses, or the noise is smaller;",
        ),
        ("holdout", 0.001, 0.02, "less by 0.0200 to 0.0366 mm (95 %); noise"),
        ("holdout", 0.032, -0.01, "less by -0.0100 to 0.0366 mm (95 %), within chance; noise"),
    ],
)
def test_an_interval_is_told_for_what_it_is(kind, after_mm, low_mm, said):
    reduction = Reduction(mean_mm=0.01, interval95_mm=(low_mm, 0.0366), poses=14)
    gap = set_gap(accuracy(0.033), accuracy(after_mm)).model_copy(update={"reduction": reduction})
    assert said in next(gap_lines(kind, gap))
