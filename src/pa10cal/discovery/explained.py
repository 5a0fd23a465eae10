"""Shares of the error beyond noise that effects explain.

The share of all effects is the decrease of the mean square error over held-out poses, from the
calibrated to the exported model, over what the former has beyond noise. It is divided among the
effects by the increase without each, all else fitted again: alone, an effect may be masked by
another. Errors without one effect count as no larger than those without any.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, rms
from pa10cal.discovery.finding import Finding, name_of
from pa10cal.discovery.gap import half_width_of_mean, means_by_label
from pa10cal.discovery.proof import ComplianceProof
from pa10cal.discovery.rules import JUDGING
from pa10cal.discovery.tuning import FIELD
from pa10cal.results.discovery import Explained, ExplainedEffect
from pa10cal.terms.field import NO_NAME, Field


@dataclass(frozen=True, eq=False)
class ErrorsOfModels:
    """Position errors of several models at the same P poses."""

    over: Literal["held-out poses", "fitted poses"]  # what the poses are
    pose: NDArray[np.str_]  # (P,) labels: errors under several loads of one pose go together
    noise_mm: float  # root mean square error that noise alone would leave
    calibrated_mm: Array  # (P,) of the calibrated model
    named_mm: Array  # (P,) of the model with the effects found
    exported_mm: Array  # (P,) of the exported model, which has the field as well
    without_mm: Mapping[Finding, Array]  # (P,) of the model with all effects but one


def explained_errors(
    errors: ErrorsOfModels, springs: Sequence[Finding[ComplianceProof]], by_joint: Array | None
) -> Explained | None:
    """Return what springs, effects and field explain; None where the error is not above noise.

    Args:
        springs: joints that give way, whose springs the calibrated model has already.
        by_joint: (n,) part of the field that follows each joint; None without a field.
    """
    before, effects = [errors.calibrated_mm], []
    for spring in springs:
        weights = spring.proof.weights
        assumed: Literal["assumed"] | None = "assumed" if weights in ("assumed", "total") else None
        effects.append(taken_away(spring, spring.proof.without_each_mm, errors.named_mm, assumed))
        # The model with rigid joints has the effects; without them its error is no less.
        before.append(spring.proof.all_rigid_each_mm)
    for finding, without_mm in errors.without_mm.items():
        effects.append(taken_away(finding, without_mm, errors.named_mm))
    if by_joint is not None:
        effects.append(by_field(by_joint, errors.named_mm, errors.exported_mm))
    before_mm = max(before, key=rms)
    found = explained_by(effects, rms(before_mm), errors.noise_mm, errors.over)
    if found is None or not effects:
        return found
    after_mm = errors.named_mm if by_joint is None else errors.exported_mm
    interval95 = interval_of_share(before_mm, after_mm, errors.pose, errors.noise_mm)
    return found.model_copy(update={"interval95": interval95})


def interval_of_share(
    before_mm: Array, after_mm: Array, pose: NDArray[np.str_], noise_mm: float
) -> tuple[float, float] | None:
    """Return the 95 % interval of the share that is explained over poses like these P.

    By the delta method: the share is a ratio of means of squares, paired over poses. None where
    all are of one label.
    """
    before, after = (
        means_by_label(errors_mm**2 - noise_mm**2, pose) for errors_mm in (before_mm, after_mm)
    )
    if len(before) < 2:
        return None
    left = float(after.mean() / before.mean())
    half = half_width_of_mean(after - left * before) / float(before.mean())
    low, high = np.clip([1.0 - left - half, 1.0 - left + half], 0.0, 1.0).tolist()
    return low, high


def taken_away(
    finding: Finding,
    before_mm: Array,
    after_mm: Array,
    weights: Literal["assumed"] | None = None,
) -> ExplainedEffect:
    """Return the effect of a finding on errors (P,), its share not yet known."""
    explanations = finding.explanations
    others = (e for e in explanations.smallest_set if (e.id, e.of) != (finding.id, finding.of))
    names = {name_of(other): explanations.probability(other) for other in others}
    here = {name.id: p for name, p in names.items() if name.of == finding.of}
    elsewhere = {name: p for name, p in names.items() if name.of != finding.of}
    return ExplainedEffect(
        ids=(finding.id, *here),
        of=finding.of,
        elsewhere=tuple(elsewhere),
        weights=weights,
        probability=finding.probability,
        others_probability=(*here.values(), *elsewhere.values()),
        share=0.0,
        before_mm=rms(before_mm),
        after_mm=rms(after_mm),
    )


def by_field(by_joint: Array, before_mm: Array, after_mm: Array) -> ExplainedEffect:
    """Return the effect of a field on errors (P,), by the part (n,) that follows each joint."""
    joints = {str(k): float(part) for k, part in enumerate(by_joint, start=1)}
    return ExplainedEffect(
        ids=(Field.id,),
        of=NO_NAME,
        joints={joint: part for joint, part in joints.items() if part >= FIELD.least_joint_part},
        share=0.0,
        before_mm=rms(before_mm),
        after_mm=rms(after_mm),
    )


def explained_by(
    effects: Sequence[ExplainedEffect],
    before_mm: float,
    noise_mm: float,
    over: Literal["held-out poses", "fitted poses"] = "held-out poses",
) -> Explained | None:
    """Return effects with their shares; None where the error is not above noise.

    Args:
        effects: effects on the errors; after the last, errors are those of the model with all.
        before_mm: root mean square error of the model without any.
        noise_mm: root mean square error that noise alone would leave.
        over: what the poses are.
    """
    beyond = before_mm**2 - noise_mm**2
    least = 1.0 if effects else JUDGING.more_than_noise**2
    if not beyond > (least - 1.0) * noise_mm**2 or not before_mm > 0.0:
        return None
    after_mm = effects[-1].after_mm if effects else before_mm
    share = float(np.clip((before_mm**2 - after_mm**2) / beyond, 0.0, 1.0))
    removed = [max(effect.before_mm**2 - effect.after_mm**2, 0.0) for effect in effects]
    scale = share / sum(removed) if sum(removed) > 0.0 else 0.0
    entries = [
        effect.model_copy(
            update={"share": scale * squares, "before_mm": min(effect.before_mm, before_mm)}
        )
        for effect, squares in zip(effects, removed, strict=True)
    ]
    return Explained(
        share=share,
        of=tuple(sorted(entries, key=lambda entry: -entry.share)),
        without_a_name=1.0 - share,
        over=over,
        before_mm=before_mm,
        after_mm=after_mm,
        noise_mm=noise_mm,
    )
