"""Whether reported parameters of effects hold what was hidden inside their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from pa10cal.evaluation.blind_trial import MAP, BlindTrial, Hidden, Named
from pa10cal.evaluation.trial_rates import LEVEL, Rate, rate

_AXES = "xyz"


@dataclass(frozen=True)
class Score:
    """One parameter of one finding.

    Attributes:
        id, parameter: which.
        score: (value - truth) / standard uncertainty.
    """

    id: str
    parameter: str
    score: float

    @property
    def inside(self) -> bool:
        """Return whether the 95 % interval holds the truth."""
        return bool(abs(self.score) <= norm.ppf(0.5 + LEVEL / 2.0))


@dataclass(frozen=True)
class Calibration:
    """How reported intervals do.

    Attributes:
        inside: how many of all parameters lie inside their 95 % interval.
        rms: root mean square of the scores, 1 where uncertainties are right; None of none.
        by_parameter: the same for each (effect, parameter).
        scores: all of them.
    """

    inside: Rate
    rms: float | None
    by_parameter: dict[tuple[str, str], Rate]
    scores: tuple[Score, ...]


def intervals(trials: Sequence[BlindTrial]) -> Calibration:
    """Score the parameters of every finding that is what was hidden, at its place.

    Of phases the difference modulo a turn counts, with the sign of an amplitude taken into the
    phase. Maps are left out: cell and estimator have other knots, and calibration takes their
    mean.
    """
    scores = tuple(
        score
        for trial in trials
        if trial.verdict is not None
        for hidden in trial.hidden
        for named in trial.verdict.effects
        if named.name == hidden.name
        for score in _scores(hidden, named)
    )
    keys = sorted({(score.id, score.parameter) for score in scores})
    values = np.array([score.score for score in scores])
    return Calibration(
        inside=rate(score.inside for score in scores),
        rms=float(np.sqrt(np.mean(values**2))) if scores else None,
        by_parameter={
            key: rate(s.inside for s in scores if (s.id, s.parameter) == key) for key in keys
        },
        scores=scores,
    )


def _scores(hidden: Hidden, named: Named) -> list[Score]:
    if hidden.name.id == MAP:
        return []
    truth = true_parameters(hidden)
    scores = []
    for parameter, (value, std) in named.parameters.items():
        if parameter not in truth or std <= 0.0:
            continue
        off = value - truth[parameter]
        if parameter == "phi":
            off = float(np.angle(np.exp(1j * off)))
        scores.append(Score(named.name.id, parameter, off / std))
    return scores


def true_parameters(hidden: Hidden) -> dict[str, float]:
    """Return what was hidden under the names of a verdict, amplitudes positive."""
    flat: dict[str, float] = {}
    for name, value in hidden.parameters.items():
        if isinstance(value, Sequence) and len(value) == len(_AXES):
            flat |= {f"{name}_{axis}": float(v) for axis, v in zip(_AXES, value, strict=True)}
        elif isinstance(value, int | float):
            flat[name] = float(value)
    if "phi" in flat and flat["A"] < 0.0:
        flat |= {"A": -flat["A"], "phi": flat["phi"] + np.pi}
    return flat
