"""Does the stated uncertainty agree with what repeats scatter by?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from pa10cal.campaign.findings import InputFinding
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.averages import reading_groups
from pa10cal.observe.observations import Observations

#: Pairs of readings below which their scatter says too little about a factor of three.
_LEAST_PAIRS = 20
#: Mean square over median scatter, both as of a normal deviate, that a few gross errors make.
_FAR = 3.0
#: Median of the square of a normal deviate.
_MEDIAN_SQUARE = float(ndtri(0.75)) ** 2


@dataclass(frozen=True)
class ScatterOfRepeats:
    """Scatter of one reading, as repeats show it, beside what the instrument states."""

    kind: str  # `position`, `attitude` or `distance`
    # found and stated: standard uncertainty of one component [m or rad], typical of the readings
    found: float
    stated: float
    pairs: int  # pairs of readings behind it
    from_touches: bool = False  # whether the instrument touches balls

    @property
    def ratio(self) -> float:
        """Return the scatter found over the one stated."""
        return self.found / self.stated


def scatter_of_repeats(readings: Observations, model: FittedModel) -> tuple[ScatterOfRepeats, ...]:
    """Compare successive readings of the same pose, load and direction of arrival.

    What joint positions and torques of a reading explain is taken off by the model; what drifts
    slowly or depends on the direction of arrival is no noise. The median decides, so that gross
    errors do not.

    Args:
        readings: single readings of the poses fitted.
        model: a calibrated model.

    Returns:
        One entry a kind of components; none where too little is repeated.
    """
    arrival = np.unique(readings.states.arrival, axis=0, return_inverse=True)[1].ravel()
    group = reading_groups(readings) * (arrival.max(initial=0) + 1) + arrival
    order = np.lexsort((readings.states.time_s, group))
    at = np.flatnonzero(group[order][1:] == group[order][:-1])
    if len(at) < _LEAST_PAIRS:
        return ()
    poses = model.as_modelled(readings)
    measured = poses.measured
    T_instr_ee = model.T_instr_base @ model.model.predict(poses.states, model.x)
    residual = measured.compare(T_instr_ee, model.targets_m).residual
    variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
    first, second = order[at], order[at + 1]
    both = measured.components_seen[first] & measured.components_seen[second]
    difference, stated = residual[second] - residual[first], variance[second] + variance[first]
    found = []
    for kind, columns in measured.component_kinds:
        seen = both[:, columns]
        squares = difference[:, columns][seen] ** 2
        if seen.any(axis=1).sum() < _LEAST_PAIRS:
            continue
        size = float(np.sqrt(0.5 * np.median(stated[:, columns][seen])))
        ratio = np.sqrt(np.median(squares / stated[:, columns][seen]) / _MEDIAN_SQUARE)
        found.append(
            ScatterOfRepeats(kind, float(ratio) * size, size, len(at), measured.from_touches)
        )
    return tuple(found)


def gross_errors_of_repeats(mean_square_mm: float, usual_mm: float) -> tuple[InputFinding, ...]:
    """Return the finding that a few repeats are far from the others, if they are.

    Args:
        mean_square_mm: noise of averaged poses by the mean square of their repeats.
        usual_mm: the same by the median, which a few do not move.
    """
    if mean_square_mm <= _FAR * usual_mm:
        return ()
    return (
        InputFinding(
            f"the mean square of repeats is {mean_square_mm:.2g} mm, their median "
            f"{usual_mm:.2g} mm: a few readings are far from their repeats",
            "repeated poses",
            "look for exchanged labels and gross errors among them",
            kind="outlier",
        ),
    )
