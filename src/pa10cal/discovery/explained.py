"""How much of the error beyond noise is explained, and by what.

The share of all effects is what the mean square error over held-out poses falls by, from the
calibrated model to the one that is exported, as part of what it had beyond noise. It is divided
among them by what the exported model loses without each, all else fitted again: joining one by
one, an effect may be masked by another. Shares sum to the whole. Errors without one are told as
no larger than those without any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.finding import Finding, name_of
from pa10cal.discovery.verdict import Verdict
from pa10cal.results.explained import Explained, ExplainedEffect
from pa10cal.results.record import EffectName

#: Without an effect found, errors so many times as large as those of noise, root mean squares, are
#: more than noise.
_MORE_THAN_NOISE = 1.15


@dataclass(frozen=True)
class Joining:
    """An effect that joins a model."""

    ids: tuple[str, ...]  # of the effect, then of its alternatives at the same place
    of: str  # where it sits
    # before_mm and after_mm: (P,) position errors without it and with it, over the same poses
    before_mm: Array
    after_mm: Array
    elsewhere: tuple[EffectName, ...] = ()  # alternatives at other places
    # `assumed` where its size is relative to weights that nobody stated
    weights: Literal["assumed"] | None = None


def explained_by(
    joining: Sequence[Joining],
    before_mm: Array,
    noise_rms_mm: float,
    over: Literal["held-out poses", "fitted poses"] = "held-out poses",
) -> Explained | None:
    """Return what effects take away; None where there is no more than noise to explain.

    Args:
        joining: the effects; the last of them ends at the model with all.
        before_mm: (P,) position errors of the model without any.
        noise_rms_mm: root mean square error that noise alone would leave.
        over: what the poses are.
    """
    noise = noise_rms_mm**2
    first = _squared(before_mm)
    beyond = first - noise
    least = 1.0 if joining else _MORE_THAN_NOISE**2
    if not beyond > (least - 1.0) * noise or not first > 0.0:
        return None
    last = _squared(joining[-1].after_mm) if joining else first
    share = float(np.clip((first - last) / beyond, 0.0, 1.0))
    taken = np.array(
        [max(_squared(one.before_mm) - _squared(one.after_mm), 0.0) for one in joining]
    )
    shares = taken * (share / taken.sum()) if taken.sum() > 0.0 else np.zeros(len(joining))
    entries = [
        ExplainedEffect(
            ids=effect.ids,
            of=effect.of,
            elsewhere=effect.elsewhere,
            weights=effect.weights,
            share=float(own),
            before_mm=min(_squared(effect.before_mm), first) ** 0.5,
            after_mm=_squared(effect.after_mm) ** 0.5,
        )
        for effect, own in zip(joining, shares, strict=True)
    ]
    return Explained(
        share=share,
        of=tuple(sorted(entries, key=lambda entry: -entry.share)),
        without_a_name=1.0 - share,
        over=over,
        before_mm=first**0.5,
        after_mm=last**0.5,
        noise_mm=noise_rms_mm,
    )


def explained(found: Verdict[object]) -> Explained | None:
    """Return what the effects of a verdict take away; None where not sought, or nothing is missing.

    Held-out poses with a suspected reading do not count; without held-out poses it is counted over
    those fitted. Joints that give way under weights that nobody stated joined the geometry in the
    calibration already: errors before are those of the geometry alone.
    """
    calibrated = found.gives_way
    if (found.method is None or found.verdict == "none") and not calibrated:
        return None
    over: Literal["held-out poses", "fitted poses"] = "held-out poses"
    gap, suspected = found.holdout, found.prepared.suspected
    if gap is None:
        gap, suspected, over = found.train, None, "fitted poses"
    rows = np.ones(len(gap.poses), dtype=bool) if suspected is None else ~suspected
    if not rows.any():
        return None
    joining = []

    def join(
        finding: Finding[object],
        before_mm: Array,
        after_mm: Array,
        weights: Literal["assumed"] | None = None,
    ) -> None:
        others = finding.alternatives
        ids = dict.fromkeys((finding.id, *(one.id for one in others if one.of == finding.of)))
        elsewhere = tuple(name_of(one) for one in others if one.of != finding.of)
        joining.append(Joining(tuple(ids), finding.of, before_mm, after_mm, elsewhere, weights))

    before_mm = gap.found_before.distance_mm[rows]
    for spring in found.gives_way:
        proof = spring.proof
        weights: Literal["assumed"] | None = (
            "assumed" if proof.weights in ("assumed", "total") else None
        )
        join(spring, proof.without_each_mm, gap.found_after.distance_mm[rows], weights)
        # Rigid joints have the effects found in them: without these it is no less.
        before_mm = max(before_mm, proof.all_rigid_each_mm, key=_squared)
    findings, last = {finding.effect: finding for finding in found.findings}, found.naming[-1]
    for effect, without in zip(last.effects, last.without, strict=True):
        join(findings[effect], without.judging.distance_mm[rows], last.judging.distance_mm[rows])
    return explained_by(joining, before_mm, gap.noise_rms_mm, over)


def _squared(errors_mm: Array) -> float:
    return float(np.mean(errors_mm**2))
