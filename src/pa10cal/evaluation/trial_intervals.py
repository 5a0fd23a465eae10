"""Whether reported parameters of effects hold what was hidden inside their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from pa10cal.evaluation.blind_trial import MAP, BlindTrial, Hidden, Named
from pa10cal.evaluation.trial_rates import LEVEL, rate
from pa10cal.results.trials import Intervals, ParameterRate, ParameterScore

_AXES = "xyz"


def intervals(trials: Sequence[BlindTrial]) -> Intervals:
    """Score the parameters of every finding that is what was hidden, at its place.

    Of phases the difference modulo a turn counts, with the sign of an amplitude taken into the
    phase. Maps are omitted: cell and estimator have other knots, and calibration takes their
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
    return Intervals(
        inside=rate(map(is_inside, scores)),
        rms=float(np.sqrt(np.mean(values**2))) if scores else None,
        by_parameter=tuple(
            ParameterRate(
                id=effect,
                parameter=parameter,
                **dict(
                    rate(is_inside(s) for s in scores if (s.id, s.parameter) == (effect, parameter))
                ),
            )
            for effect, parameter in keys
        ),
        scores=scores,
    )


def is_inside(score: ParameterScore) -> bool:
    """Return whether the 95 % interval of a parameter holds the truth."""
    return bool(abs(score.score) <= ndtri(0.5 + LEVEL / 2.0))


def _scores(hidden: Hidden, named: Named) -> list[ParameterScore]:
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
        scores.append(ParameterScore(id=named.name.id, parameter=parameter, score=off / std))
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
