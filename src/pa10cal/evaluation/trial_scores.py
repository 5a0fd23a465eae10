"""What many blind trials come to: rates of right and wrong names, and the bars they are held to."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pa10cal.evaluation.blind_trial import OUTSIDE, TRACKED, BlindTrial, Hidden
from pa10cal.evaluation.trial_rates import bar, figure, rate
from pa10cal.results.trial_bars import Bar
from pa10cal.results.trials import GapScore, NothingHidden, Outside, Several, Singles

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


def score_nothing_hidden(trials: Sequence[BlindTrial]) -> NothingHidden:
    """Score trials of one kind that hide no effect."""
    return NothingHidden(
        named=rate(t.verdict is None or bool(t.verdict.effects) for t in trials),
        unexplained=rate(t.verdict is not None and t.verdict.word == "unexplained" for t in trials),
    )


def score_singles(trials: Sequence[BlindTrial]) -> Singles:
    """Score trials that hide one effect; one that failed counts against every share."""
    pairs = [(trial, trial.hidden[0]) for trial in trials]
    moving = [(t, h) for t, h in pairs if t.moves_poses(h)]
    large = [(t, h) for t, h in moving if t.verdict is None or _is_large(t, h)]
    above = [(t, h) for t, h in moving if t.verdict is None or (t.ratio(h) or 0.0) >= LIMIT]
    found = [(t, h) for t, h in pairs if t.verdict is None or t.verdict.says_something]
    testable = [(t, h) for t, h in pairs if t.verdict is None or t.is_testable(h)]
    torque = [(t, h) for t, h in testable if not t.moves_poses(h)]
    alternatives = [t.alternatives(h) for t, h in pairs if t.lists(h)]
    return Singles(
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


def _is_large(trial: BlindTrial, hidden: Hidden) -> bool:
    return (trial.ratio(hidden) or 0.0) >= LARGE and trial.is_separable(hidden)


def score_outside(trials: Sequence[BlindTrial]) -> Outside:
    """Score trials that hide what no name covers; one that failed counts against every share."""
    return Outside(
        confidently_wrong=rate(t.verdict is None or t.is_confidently_wrong() for t in trials),
        right_place=rate(t.has_right_place() for t in trials),
        silent=rate(t.verdict is None or not t.verdict.says_something for t in trials),
    )


def score_several(trials: Sequence[BlindTrial]) -> Several:
    """Score trials that hide several effects; one that failed counts against every share."""
    above = [(t, [h for h in t.hidden if _is_above(t, h)]) for t in trials]
    return Several(
        all_listed=rate(t.all_listed(t.hidden) for t in trials),
        nothing_extra=rate(t.verdict is not None and not t.extra() for t in trials),
        above_listed=rate(t.all_listed(those) for t, those in above if those),
    )


def _is_above(trial: BlindTrial, hidden: Hidden) -> bool:
    if trial.verdict is None:
        return True
    if not trial.moves_poses(hidden):
        return trial.is_testable(hidden)
    return (trial.ratio(hidden) or 0.0) >= LIMIT


def score_gap(trials: Sequence[BlindTrial]) -> GapScore | None:
    """Score held-out errors layout by layout; None without nulls or without any name."""
    null = of_kinds(trials, "null")
    reference = {
        layout: float(np.mean(held))
        for layout in {trial.layout for trial in null}
        if (held := _held_out([t for t in null if t.layout == layout]))
    }

    def over(chosen: list[BlindTrial]) -> list[float]:
        return [
            held / reference[trial.layout]
            for trial in chosen
            if trial.layout in reference
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
    return GapScore(
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


def bars(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    """Return the figures to reach and those reached."""
    singles = score_singles(of_kinds(trials, "single"))
    outside = score_outside(of_kinds(trials, OUTSIDE))
    several = score_several(of_kinds(trials, *SEVERAL))
    null = score_nothing_hidden(of_kinds(trials, "null"))
    gap = score_gap(trials)
    seconds = [t.verdict.seconds for t in trials if t.verdict is not None]
    whole = [
        t.verdict.seconds + t.verdict.seconds_simulating + t.seconds_twin
        for t in trials
        if t.verdict is not None
    ]
    plausible = (
        bar(
            "one effect of plausible size, testable: among the effect or its alternatives",
            singles.testable,
            0.95,
        ),
        bar("one effect: a confident wrong name", singles.confidently_wrong, 0.02, at_least=False),
    )
    tracked = any(trial.measured == TRACKED for trial in trials)
    return (
        bar(
            "false alarm: nothing hidden, yet an effect was named", null.named, 0.02, at_least=False
        ),
        *(plausible if tracked else ()),
        bar(
            f"one effect, separable, residual {LARGE:g} times the floor or more: "
            "right id and place",
            singles.large,
            0.95,
        ),
        bar(
            f"one effect, residual {LIMIT:g} times the floor or more: "
            "among the effect or its alternatives",
            singles.above,
            0.97,
        ),
        bar(
            "one effect, anything found: among the effect or its alternatives",
            singles.found,
            0.97,
        ),
        bar(
            "effect outside the vocabulary: a confident wrong name",
            outside.confidently_wrong,
            0.05,
            at_least=False,
        ),
        bar("effect outside the vocabulary: found at the right place", outside.right_place, 0.8),
        bar("two or three effects: all named or in the alternatives", several.all_listed, 0.9),
        bar(
            f"two or three effects: those of a residual {LIMIT:g} times the floor or more",
            several.above_listed,
            0.9,
        ),
        bar("two or three effects: nothing extra", several.nothing_extra, 0.95),
        figure(
            "held-out mean after naming, over that of campaigns without missing effect",
            None if gap is None else gap.mean,
            GAP_ALLOWED,
            0 if gap is None else gap.trials,
        ),
        figure(
            "seconds of the processor to judge one campaign, longest",
            max(seconds, default=None),
            15.0,
            len(seconds),
        ),
        figure(
            "trials an hour on two cores",
            2.0 * 3600.0 / float(np.mean(whole)) if whole else None,
            240.0,
            len(whole),
            at_least=True,
        ),
    )
