"""Records of results that nobody measured, complete, with the keys that a test cares about."""

from __future__ import annotations

import numpy as np

from pa10cal.results.discovery import (
    AllUnexplained,
    Alternative,
    BlockedCrossValidation,
    EvidenceByBlocks,
    FoundEffect,
    Gap,
    Needed,
    NotTestable,
    Reduction,
    SearchByBlocks,
    SetGap,
    Unexplained,
    VerdictKeys,
)
from pa10cal.results.evaluation import Accuracy, BeforeAfter, EffectParameter
from pa10cal.results.record import EffectName


def accuracy(mean_mm=0.02, peak_mm=None, rms_mm=None, configurations=45):
    """Errors, of positions alone."""
    return Accuracy(
        mean_mm=mean_mm,
        peak_mm=3.0 * mean_mm if peak_mm is None else peak_mm,
        rms_mm=1.25 * mean_mm if rms_mm is None else rms_mm,
        orientation_deg=None,
        configurations=configurations,
    )


def set_gap(before, after, inside=None, outside=None):
    """A gap of accuracies before and after, and of such pairs inside and beyond the angles seen."""
    pairs = [None if p is None else BeforeAfter(before=p[0], after=p[1]) for p in (inside, outside)]
    return SetGap(
        before=before,
        after=after,
        noise_floor_mm=0.01,
        reduction=Reduction(mean_mm=0.04, interval95_mm=(0.03, 0.05), poses=45),
        per_load={},
        inside=pairs[0],
        outside=pairs[1],
    )


def names(*entries):
    """Names of effects from (id, of)."""
    return tuple(EffectName(id=id, of=of) for id, of in entries)


def effect(id, of, parameters, alternatives=()):
    """An effect found by blocks, of parameters (value, standard uncertainty) by name.

    It is as likely as each of its alternatives.
    """
    probability = 0.99 / (1 + len(alternatives))
    others = tuple(Alternative(id=id, of=of, probability=probability) for id, of in alternatives)
    return FoundEffect(
        id=id,
        of=of,
        form=None,
        parameters={
            name: EffectParameter(value=value, std=std, unit="rad")
            for name, (value, std) in parameters.items()
        },
        probability=probability,
        alternatives=others,
        others=0.0,
        none_of_these=0.01,
        set95=names((id, of), *alternatives),
        evidence=EvidenceByBlocks(
            cross_validation_over_blocks=BlockedCrossValidation(
                rms_without_mm=0.3,
                rms_with_mm=0.1,
                blocks=10,
                improved=9,
                gain=0.8,
                gain_std=0.1,
                z=8.0,
            )
        ),
    )


def verdict_keys(word, effects, *, places=(), not_testable=(), gap=None, angles_seen=None):
    """A verdict.

    Args:
        word: the verdict in a word.
        effects: those found.
        places: where something without a name sits; None where that is not known.
        not_testable: names of effects that cannot be shown.
        gap: the gap; None for one that was closed.
        angles_seen: of each joint.
    """
    unexplained = tuple(
        Unexplained(of=of, form=None, shared_error_mm=None, why="made up") for of in places
    )
    return VerdictKeys(
        verdict=word,
        method="cross-validation over blocks",
        effects=effects,
        unexplained=AllUnexplained(**dict(unexplained[0]), all=unexplained) if places else None,
        not_testable=tuple(
            NotTestable(id=name.id, of=name.of, why="made up") for name in not_testable
        ),
        indistinguishable=(),
        gap=gap or made_up_gap(),
        search=SearchByBlocks(
            candidates=80,
            error_rate=0.01,
            blocks=10,
            needed=Needed(
                standard_errors=3.0, sum_of_squares=17.0, part_of_remaining_error_over_noise=0.05
            ),
            poses_down_weighted=0,
            refit_converged=True,
        ),
        angles_seen=angles_seen,
        faults=(),
        suggested_poses=(),
    )


def made_up_gap(train=None, holdout=None, noise_floor_mm=0.01):
    """A gap that was closed, where none is given."""
    closed = set_gap(accuracy(0.05), accuracy(0.01))
    return Gap(noise_floor_mm=noise_floor_mm, train=train or closed, holdout=holdout or closed)


def stretches_deg(*stretches):
    """Stretches (m, 2) of a joint's angle [rad] from pairs in degrees."""
    return np.radians(np.reshape(stretches, (-1, 2)))
