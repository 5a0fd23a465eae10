"""What many blind trials come to: rates of right and wrong names, and the bars they are held to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from pa10cal.lab.blind_trial import MAP, OUTSIDE, TRACKED, BlindTrial
from pa10cal.lab.trial_rates import LEVEL, bar, figure, longest, power, rate, score_formulas
from pa10cal.results import trials as results
from pa10cal.results.discovery import FoundEffect

NOTHING_HIDDEN = ("null", "wrong_noise", "wrong_mass")
SEVERAL = ("pair", "triple")
#: A residual so many times that of noise alone is large ...
LARGE = 3.0
#: ... and from here on an effect counts as above its detection limit.
LIMIT = 1.5
#: Held-out error after naming, over that of campaigns without missing effect, allowed.
GAP_ALLOWED = 1.3


def of_kinds(trials: Iterable[BlindTrial], *kinds: str) -> list[BlindTrial]:
    """Return the trials of some kinds."""
    return [trial for trial in trials if trial.kind in kinds]


def score_nothing_hidden(trials: Sequence[BlindTrial]) -> results.NothingHidden:
    """Score trials of one kind that hide no effect."""
    return results.NothingHidden(
        named=rate(t.verdict is None or bool(t.verdict.effects) for t in trials),
        unexplained=rate(t.verdict is not None and t.verdict.word == "unexplained" for t in trials),
    )


def score_singles(trials: Sequence[BlindTrial]) -> results.Singles:
    """Score trials that hide one effect; one that failed counts against every share."""
    pairs = [(trial, trial.hidden[0]) for trial in trials]
    moving = [(t, h) for t, h in pairs if t.moves_poses(h)]
    large = [(t, h) for t, h in moving if t.verdict is None or _is_large(t, h)]
    above = [(t, h) for t, h in moving if t.verdict is None or (t.ratio(h) or 0.0) >= LIMIT]
    found = [(t, h) for t, h in pairs if t.verdict is None or t.verdict.says_something]
    testable = [(t, h) for t, h in pairs if t.verdict is None or t.is_testable(h)]
    torque = [(t, h) for t, h in testable if not t.moves_poses(h)]
    alternatives = [t.alternatives(h) for t, h in pairs if t.lists(h)]
    return results.Singles(
        large=rate(t.names(h) for t, h in large),
        large_alone=rate(t.names(h) and not t.alternatives(h) and not t.extra() for t, h in large),
        above=rate(t.lists(h) for t, h in above),
        found=rate(t.lists(h) for t, h in found),
        torque_alone=rate(t.lists(h) for t, h in torque),
        testable=rate(t.lists(h) for t, h in testable),
        confidently_wrong=rate(t.verdict is None or t.is_confidently_wrong() for t, _ in pairs),
        detected=rate(t.verdict is not None and t.verdict.says_something for t, _ in testable),
        wrong=rate(t.verdict is None or t.extra() > 0 for t, _ in pairs),
        alternatives=float(np.mean(alternatives)) if alternatives else None,
        not_testable=len(pairs) - len(testable),
    )


def _is_large(trial: BlindTrial, hidden: results.HiddenEffect) -> bool:
    return (trial.ratio(hidden) or 0.0) >= LARGE and trial.is_separable(hidden)


def score_outside(trials: Sequence[BlindTrial]) -> results.Outside:
    """Score trials that hide what no name covers; one that failed counts against every share."""
    return results.Outside(
        confidently_wrong=rate(t.verdict is None or t.is_confidently_wrong() for t in trials),
        right_place=rate(t.has_right_place() for t in trials),
        silent=rate(t.verdict is None or not t.verdict.says_something for t in trials),
    )


def score_several(trials: Sequence[BlindTrial]) -> results.Several:
    """Score trials that hide several effects; one that failed counts against every share."""
    above = [(t, [h for h in t.hidden if _is_above(t, h)]) for t in trials]
    return results.Several(
        all_listed=rate(t.all_listed(t.hidden) for t in trials),
        nothing_extra=rate(t.verdict is not None and not t.extra() for t in trials),
        above_listed=rate(t.all_listed(those) for t, those in above if those),
    )


def _is_above(trial: BlindTrial, hidden: results.HiddenEffect) -> bool:
    if trial.verdict is None:
        return True
    if not trial.moves_poses(hidden):
        return trial.is_testable(hidden)
    return (trial.ratio(hidden) or 0.0) >= LIMIT


def score_gap(trials: Sequence[BlindTrial]) -> results.GapScore | None:
    """Score held-out errors layout by layout; None without nulls or without any name."""
    null = of_kinds(trials, "null")
    reference = {
        layout: float(np.mean(held))
        for layout in {trial.truth.layout for trial in null}
        if (held := _held_out([t for t in null if t.truth.layout == layout]))
    }

    def over(chosen: list[BlindTrial]) -> list[float]:
        return [
            held / reference[trial.truth.layout]
            for trial in chosen
            if trial.truth.layout in reference
            for held in _held_out([trial])
        ]

    named = [
        t
        for t in of_kinds(trials, "single", *SEVERAL)
        if t.verdict is not None and t.verdict.effects and t.verdict.word != "unexplained"
    ]
    ratios = over(named)
    if not ratios:
        return None
    return results.GapScore(
        mean=float(np.mean(ratios)),
        median=float(np.median(ratios)),
        high=float(np.quantile(ratios, 0.95)),
        null_high=float(np.quantile(over(null), 0.95)),
        trials=len(ratios),
    )


def _held_out(trials: list[BlindTrial]) -> list[float]:
    return [
        t.verdict.held_out_after_mm
        for t in trials
        if t.verdict is not None and t.verdict.held_out_after_mm is not None
    ]


def bars(trials: Sequence[BlindTrial]) -> tuple[results.Bar, ...]:
    """Return the figures to reach and those reached."""
    singles = score_singles(of_kinds(trials, "single"))
    outside = score_outside(of_kinds(trials, OUTSIDE))
    several = score_several(of_kinds(trials, *SEVERAL))
    null = score_nothing_hidden(of_kinds(trials, "null"))
    gap = score_gap(trials)
    whole = [
        t.verdict.seconds + t.verdict.seconds_simulating + t.truth.seconds_twin
        for t in trials
        if t.verdict is not None
    ]
    tracked = any(trial.truth.measured == TRACKED for trial in trials)

    def least(found: results.Rate, limit: float) -> tuple[results.Rate, bool, float]:
        return found, True, limit

    def most(found: results.Rate, limit: float) -> tuple[results.Rate, bool, float]:
        return found, False, limit

    plausible = {
        "one effect of plausible size, testable: among the effect or its alternatives": least(
            singles.testable, 0.95
        ),
        "one effect: a confident wrong name": most(singles.confidently_wrong, 0.02),
    }
    shares = {
        "false alarm: nothing hidden, yet an effect was named": most(null.named, 0.02),
        **(plausible if tracked else {}),
        f"one effect, separable, residual {LARGE:g} times the floor or more: "
        "right id and place": least(singles.large, 0.95),
        f"one effect, residual {LIMIT:g} times the floor or more: "
        "among the effect or its alternatives": least(singles.above, 0.97),
        "one effect, anything found: among the effect or its alternatives": least(
            singles.found, 0.97
        ),
        "effect outside the vocabulary: a confident wrong name": most(
            outside.confidently_wrong, 0.05
        ),
        "effect outside the vocabulary: found at the right place": least(outside.right_place, 0.8),
        "two or three effects: all named or in the alternatives": least(several.all_listed, 0.9),
        f"two or three effects: those of a residual {LIMIT:g} times the floor or more": least(
            several.above_listed, 0.9
        ),
        "two or three effects: nothing extra": least(several.nothing_extra, 0.95),
    }
    return (
        *(bar(what, *share) for what, share in shares.items()),
        figure(
            "held-out mean after naming, over that of campaigns without missing effect",
            None if gap is None else gap.mean,
            GAP_ALLOWED,
            0 if gap is None else gap.trials,
        ),
        longest(trials),
        figure(
            "trials an hour on two cores",
            2.0 * 3600.0 / float(np.mean(whole)) if whole else None,
            240.0,
            len(whole),
            at_least=True,
        ),
    )


# Whether reported parameters of effects hold what was hidden inside their intervals.

_AXES = "xyz"


def intervals(trials: Sequence[BlindTrial]) -> results.Intervals:
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
    return results.Intervals(
        inside=rate(map(is_inside, scores)),
        rms=float(np.sqrt(np.mean(values**2))) if scores else None,
        by_parameter=tuple(
            results.ParameterRate(
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


def is_inside(score: results.ParameterScore) -> bool:
    """Return whether the 95 % interval of a parameter holds the truth."""
    return bool(abs(score.score) <= ndtri(0.5 + LEVEL / 2.0))


def _scores(hidden: results.HiddenEffect, named: FoundEffect) -> list[results.ParameterScore]:
    if hidden.id == MAP:
        return []
    truth = true_parameters(hidden)
    scores = []
    for parameter, found in named.parameters.items():
        if parameter not in truth or found.std <= 0.0:
            continue
        off = found.value - truth[parameter]
        if parameter == "phi":
            off = float(np.angle(np.exp(1j * off)))
        scores.append(
            results.ParameterScore(id=named.id, parameter=parameter, score=off / found.std)
        )
    return scores


def true_parameters(hidden: results.HiddenEffect) -> dict[str, float]:
    """Return what was hidden under the names of a verdict, amplitudes positive."""
    flat: dict[str, float] = {}
    known: Mapping[str, object] = hidden.parameters
    for name, value in known.items():
        if isinstance(value, Sequence) and len(value) == len(_AXES):
            flat |= {f"{name}_{axis}": float(v) for axis, v in zip(_AXES, value, strict=True)}
        elif isinstance(value, int | float):
            flat[name] = float(value)
    if "phi" in flat and flat["A"] < 0.0:
        flat |= {"A": -flat["A"], "phi": flat["phi"] + np.pi}
    return flat


# What became of each hidden effect: the rows of the confusion matrix, and curves of power.

LISTED = "in the alternatives"
ELSEWHERE = "right id elsewhere"
RIGHT_PLACE = "no name, right place"
WRONG_PLACE = "no name, other place"
NOTHING = "nothing found"
NOT_TESTABLE = "said to be not testable"
FAILED = "failed"

#: Edges of the bins in which shares are counted: of how far the residual moves, over the floor. Two
#: of them are where the residual is `LIMIT` and `LARGE` times the floor.
MOVED_EDGES = (
    *(0.0, 0.1, 0.2, 0.4),
    *(float(np.sqrt(ratio**2 - 1.0)) for ratio in (LIMIT, LARGE)),
    *(8.0, np.inf),
)
#: Less than this counts as this; keeps logarithms finite.
_LEAST_MOVED = 0.03


def outcome(trial: BlindTrial, hidden: results.HiddenEffect) -> str:
    """Return what became of one hidden effect: an id of the vocabulary or one of the words here.

    Where findings match no hidden effect, the first of them counts.
    """
    verdict = trial.verdict
    if verdict is None:
        return FAILED
    if trial.names(hidden):
        return hidden.id
    if trial.lists(hidden):
        return LISTED
    if trial.kind == OUTSIDE and trial.has_right_place():
        return RIGHT_PLACE
    if verdict.effects:
        ids = [named.id for named in verdict.effects]
        return ELSEWHERE if hidden.id in ids else ids[0]
    if verdict.word == "unexplained":
        return RIGHT_PLACE if hidden.of in verdict.places else WRONG_PLACE
    return NOTHING if trial.is_testable(hidden) else NOT_TESTABLE


def confusion(trials: Sequence[BlindTrial]) -> dict[str, Counter[str]]:
    """Count the outcomes of each id, of trials that hide one effect."""
    counts: dict[str, Counter[str]] = {}
    for trial in trials:
        (hidden,) = trial.hidden
        counts.setdefault(hidden.id, Counter())[outcome(trial, hidden)] += 1
    return counts


def study_power(trials: Sequence[BlindTrial]) -> results.PowerStudy:
    """Fit power curves to trials that hide one effect and did not fail."""
    known = [(t, t.hidden[0]) for t in trials if t.verdict is not None]
    ids = sorted({hidden.id for _, hidden in known})
    moving = [(t, h) for t, h in known if t.moves_poses(h)]
    moved = np.array([t.moved_over_floor(h) or 0.0 for t, h in moving])
    listed = np.array([t.lists(h) for t, h in moving], dtype=bool)
    return results.PowerStudy(
        by_id={
            name: power(
                np.array([h.size for _, h in known if h.id == name]),
                np.array([t.lists(h) for t, h in known if h.id == name], dtype=bool),
            )
            for name in ids
        },
        by_moved=power(np.maximum(moved, _LEAST_MOVED), listed),
        bins=tuple(
            results.MovedBin(
                low=low,
                high=high if np.isfinite(high) else None,
                listed=rate(listed[(moved >= low) & (moved < high)].tolist()),
            )
            for low, high in pairwise(MOVED_EDGES)
        ),
    )


# `scores.json` of a study of blind trials.

_PROVENANCE = "synthetic: virtual cell, robots, poses, noise and hidden effects drawn at random"


def scores_record(trials: Sequence[BlindTrial]) -> results.TrialScoresRecord:
    """Return what many trials come to."""
    singles, outside = (of_kinds(trials, kind) for kind in ("single", OUTSIDE))
    seconds = [t.verdict.seconds for t in trials if t.verdict is not None]
    return results.TrialScoresRecord(
        provenance=_PROVENANCE,
        trials=len(trials),
        failed=tuple(
            results.Failure(campaign=trial.truth.campaign, kind=trial.kind, message=trial.failed)
            for trial in trials
            if trial.failed is not None
        ),
        bars=bars(trials),
        nothing_hidden={
            kind: score_nothing_hidden(of_kinds(trials, kind)) for kind in NOTHING_HIDDEN
        },
        single=score_singles(singles),
        outside=score_outside(outside),
        several={kind: score_several(of_kinds(trials, kind)) for kind in SEVERAL},
        gap=score_gap(trials),
        intervals=intervals(trials),
        confusion=results.Confusion(
            single={name: dict(counts) for name, counts in confusion(singles).items()},
            outside={name: dict(counts) for name, counts in confusion(outside).items()},
        ),
        proposed=score_formulas(trials),
        power=study_power(singles),
        seconds=results.Seconds(
            median=float(np.median(seconds)) if seconds else None,
            longest=max(seconds, default=None),
        ),
        per_trial=tuple(map(_judged, trials)),
    )


def _judged(trial: BlindTrial) -> results.JudgedTrial:
    """Return what became of a trial."""
    verdict = trial.verdict
    return results.JudgedTrial(
        campaign=trial.truth.campaign,
        kind=trial.kind,
        layout=trial.truth.layout,
        path=trial.truth.path,
        hidden=tuple(
            results.JudgedEffect(
                id=hidden.id,
                of=hidden.of,
                size=hidden.size,
                ratio=trial.ratio(hidden),
                testable=trial.is_testable(hidden),
                separable=trial.is_separable(hidden),
                moves_poses=trial.moves_poses(hidden),
                listed=trial.lists(hidden),
                outcome=outcome(trial, hidden),
            )
            for hidden in trial.hidden
        ),
        verdict=FAILED if verdict is None else verdict.word,
        named=() if verdict is None else tuple(effect.either for effect in verdict.effects),
        places=tuple(place or "unknown" for place in (() if verdict is None else verdict.places)),
        extra=trial.extra(),
        held_out_after_mm=None if verdict is None else verdict.held_out_after_mm,
        noise_floor_mm=None if verdict is None else verdict.gap.noise_floor_mm,
        seconds=None if verdict is None else verdict.seconds,
    )
