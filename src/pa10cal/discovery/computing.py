"""Steps, damping and rounding of the fits of discovery: no verdict hangs on them.

They stand on the page of rules with those on which it does (`discovery/rules.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array


@dataclass(frozen=True)
class Computing:
    """Numbers that change how long a fit takes, or its last digits."""

    # part of a parameter's own certainty that stands for a prior where it has none (computing)
    least_precision: float = 1e-12
    no_part: float = 1e-9  # rows with less of the shared error than this have none (computing)
    same_share: float = 1e-9  # what differs by a smaller part is the same (computing)
    not_fitted: float = 1e-9  # size of a parameter that is not to be fitted (computing)
    no_waves_rad: float = 1e-12  # size of waves that a map has no knots for [rad] (computing)
    tiny: float = 1e-300  # a sum of weights that is none (computing)
    # correlations are kept from one, where their transform has no end (computing)
    most_correlation: float = 1.0 - 1e-9
    # a step that lowers the sum of squares by less than this part is the last (computing)
    fit_precision: float = 1e-8
    fit_steps: int = 50  # steps of such a fit (computing)
    fit_damping: float = 1e-6  # its first damping (computing)
    refit_steps: int = 6  # steps of a refit of everything (computing)
    refit_damping: float = 1e-3  # damping that hardly shortens a step (computing)
    refit_arrived: float = 0.1  # a step this small, in standard uncertainties, ends it (computing)
    # a fit that sets out nearby ends where a step gains no more than this part of what is left
    # (computing)
    nearby_settled: float = 1e-4
    nearby_steps: int = 20  # steps of that fit (computing)
    band_steps: int = 40  # steps of a climb of bands (computing)
    band_longest: float = 1.0  # longest step of a logarithm (computing)
    band_damping: float = 0.1  # least damping after a step that led downhill (computing)
    # gain of twice the log-likelihood below which the climb ends (computing)
    band_settled: float = 0.1
    band_difference: float = 1e-4  # step of its differences (computing)
    damping_up: float = 10.0  # by which damping grows after it (computing)
    damping_down: float = 0.1  # and falls after a good step (computing)
    refit_no_worse: float = 1e-9  # part by which a step of a refit may end worse (computing)
    noise_steps: int = 60  # steps by which variances of joints are found (computing)
    draws: int = 2000  # draws of a mean length (computing)
    same_nats: float = 1e-9  # log evidence that is the same [nat] (computing)
    no_size: float = 1e-12  # a size that is none (computing)
    least_singular: float = 1e-9  # singular values that are none, in the largest (computing)
    least_determinant: float = 1e-9  # a determinant that is none, in weights squared (computing)
    least_weight: float = 1e-12  # least weight of a line, in the largest (computing)


COMPUTING = Computing()


def none_and_spaced(lowest: float, highest: float, count: int) -> Array:
    """Return none, and values evenly spaced in their logarithm, (count + 1,)."""
    return np.append(0.0, np.geomspace(lowest, highest, count))
