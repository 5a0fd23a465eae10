"""The verdict: effects found, what has no name, the word for it, and the model with the effects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import Any, ClassVar, Generic, Literal, Self

import numpy as np
from typing_extensions import TypeIs, TypeVar

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.field import FieldFit, with_field
from pa10cal.discovery.finding import (
    DiagnosedFault,
    Finding,
    GivesWay,
    Untestable,
    fault_of,
    name_of,
    to_check,
)
from pa10cal.discovery.gap import (
    ErrorsByName,
    PairedErrors,
    by_field,
    errors_by_name,
    explained_by,
    taken_away,
    trusted,
)
from pa10cal.discovery.linear import ModelWithEffects, rms
from pa10cal.discovery.other_numbers import PLACES
from pa10cal.discovery.pose_scatter import PoseDeviations
from pa10cal.discovery.preparation import Prepared
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.discovery.short_forms import FormComparison, FormulaProposal
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.analysis import LackOfFit, PureErrorTest
from pa10cal.results.calibration import EffectByCampaign
from pa10cal.results.discovery import (
    Separation,
    SuggestedPose,
    Unexplained,
)
from pa10cal.results.discovery import Verdict as Word
from pa10cal.results.explained import Explained
from pa10cal.results.maps import JointWitness
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap, is_error_map
from pa10cal.terms.weights import is_fault
from pa10cal.terms.wording import sized


@dataclass(frozen=True)
class Plan:
    """What to measure next, and what it is expected to bring."""

    # the configurations, in the order of choice; none where poses cannot help
    poses: tuple[SuggestedPose, ...]
    # one for each pair of effects that the data cannot separate; None where effects are judged by
    # blocks and none is ambiguous
    separations: tuple[Separation, ...] | None = None


NOTHING_PLANNED = Plan(())


@dataclass(frozen=True, eq=False)
class Predicted:
    """What has no name and is predicted all the same, beside what was found."""

    fit: FieldFit  # the field, with what poses that were held out say of it
    # the gap of the model with the effects alone, without the field
    train: PairedErrors
    holdout: PairedErrors | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Basis(ABC):
    """What a verdict rests on: the calibrated model, with the effects that were found."""

    # the calibrated model with the effects found, and nothing generic in it
    extended: ModelWithEffects
    covariance: Array  # (k, k) of all its unknowns

    #: How effects are judged; None where they are not sought.
    method: ClassVar[str | None] = None
    #: Whether it names springs under weights that nobody stated, of which sets are sought.
    of_sets: ClassVar[bool] = False

    @property
    @abstractmethod
    def searched_from(self) -> FittedModel:
        """Return the model from which the search set out, whose terms the extended model has."""

    @abstractmethod
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        """Return where data and model disagree, before and after."""

    @abstractmethod
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        """Return the extended model with some of its effects, all else fitted again."""

    @property
    def beside(self) -> Array | None:
        """Return columns (P, b, k + 1) of what is in no model, and last what it comes to.

        In the components of the poses fitted; None for nothing.
        """
        return None

    @property
    def seen(self) -> AngleCoverage | None:
        """Return the joint positions that maps have learnt from; None without a map of its own."""
        return None

    @property
    def scatter(self) -> PoseDeviations | None:
        """Return what single poses scatter by about the model; None where that is noise alone."""
        return None

    @property
    def torque_test(self) -> PureErrorTest | None:
        """Return the lack of fit of the logged torques; None where they do not judge."""
        return None

    @property
    def searched(self) -> tuple[Effect, ...] | None:
        """Return the effects that its rows hold; None where they hold any."""
        return None

    def targets_off_m(self, stated: int) -> Array:
        """Return by how much so many stated coordinates of targets are off their places, (a,)."""
        return np.zeros(stated)

    def judged(self, fitted: Observations) -> PoseStates:
        """Return the states of the poses that were judged, of which some averages were fitted."""
        return fitted.states

    def next_poses(self, found: Verdict[Any], count: int, random_seed: int) -> Plan:
        """Return configurations to measure next, at most so many, drawn with a seed."""
        del found, count, random_seed
        return NOTHING_PLANNED

    def keys(self, found: Verdict[Any]) -> dict[str, Any]:
        """Return the keys of the verdict's record that this way of judging has, as `search`."""
        del found
        return {"search": None}

    def witness(self, effect: Effect) -> JointWitness | None:
        """Return what says whose error an error by a joint's angle is; None where nothing does."""
        del effect
        return None

    def by_campaign(self) -> tuple[EffectByCampaign, ...] | None:
        """Return every effect as each campaign of a group alone has it; None without any."""
        return None


@dataclass(frozen=True, eq=False, kw_only=True)
class Scorer(Basis):
    """What judged effects in a campaign: it holds what they are fitted by, and fits them anew."""

    @abstractmethod
    def refitted(self, effects: tuple[Effect, ...], known: Sequence[Finding]) -> Self:
        """Return it with the calibrated model and these effects as extended model.

        Each is one of what is known, or one of its alternatives.
        """

    @abstractmethod
    def fitted_poses(self, campaign: Prepared) -> Observations:
        """Return the averaged poses of the fit."""

    @abstractmethod
    def gap_on(self, poses: Observations, before: PairedErrors | None = None) -> PairedErrors:
        """Return the gap of the calibrated and the extended model on averaged poses.

        With what is in no model as it was before that model was fitted anew, where it was.
        """

    @abstractmethod
    def comparison(self, held: Sequence[Effect], most_poses: int | None = None) -> FormComparison:
        """Return what short forms are held against in place of some effects without a name.

        Args:
            held: which of those that it holds.
            most_poses: so many poses are enough, where there are many; None for all.
        """

    def likelier(self, found: Verdict[Self]) -> Verdict[Self] | None:
        """Return the verdict about a likelier set of what gives way; None where there is none."""
        del found
        return None


S = TypeVar("S", bound=Basis, default=Basis, covariant=True)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Verdict(Generic[S]):
    """What became of a campaign."""

    prepared: Prepared  # the campaign
    scorer: S  # what judged it, and holds the model with the effects found
    context: CandidateContext  # where effects may sit in it
    candidates: int = 0  # how many effects were tried
    # what was found and is in the extended model, in the order found: effects of the vocabulary,
    # and faults of the whole log
    findings: tuple[Finding, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()  # what remains without a name
    # smooth unknown functions of the search that stand for a part of that
    nameless: tuple[Effect, ...] = ()
    over_noise: bool = False  # whether the search left more than noise, wherever it sits
    not_testable: tuple[Untestable, ...] = ()  # effects that these data cannot show
    # effects sought that would be missed too often at their plausible size; settled before
    # residuals are looked at. None known where judged by repeats.
    below_detection_limit: tuple[Untestable, ...] | None = None
    # groups of named candidates that these poses cannot separate
    indistinguishable: tuple[tuple[Effect, ...], ...] = ()
    # what is predicted beside the model with the effects without a name; None where poses held out
    # gain nothing by it
    predicted: Predicted | None = None
    noise_floor_mm: float  # mean position error that noise alone would leave
    noise_floor_from: str | None = None  # what it was found from, where not from repeats
    # train and holdout: the gap before and after, with what is predicted; None without held-out
    # poses
    train: PairedErrors
    holdout: PairedErrors | None
    # faults of single rows or poses that were found after the search
    faults_of_rows: tuple[DiagnosedFault, ...] = ()
    # where the effects hold; None where nothing speaks against them
    falls_back: FallBack | None = None
    proposed: tuple[FormulaProposal, ...] = ()  # formulas for what has no name; they name nothing
    # joints that give way under weights that nobody stated. Their springs are part of the
    # calibrated model already.
    gives_way: tuple[Finding[GivesWay], ...] = ()
    # why effects cannot be sought, and what would do; None where they were
    why: str | None = None
    remedy: str | None = None

    @property
    def method(self) -> str | None:
        """Return how effects are judged; None where they are not sought."""
        return self.scorer.method

    @property
    def extended(self) -> ModelWithEffects:
        """Return the calibrated model with the effects found, and nothing generic in it."""
        return self.scorer.extended

    @property
    def covariance(self) -> Array:
        """Return the covariance (k, k) of all its unknowns."""
        return self.scorer.covariance

    @property
    def verdict(self) -> Word:
        """Return the verdict in a word."""
        if self.why is not None:
            return "not_sought"
        named = (*self.gives_way, *self.effects)
        if to_check(self.faults, effects=bool(named)):
            return "check_the_log"
        return word_of(named, self.unexplained)

    @property
    def effects(self) -> tuple[Finding, ...]:
        """Return the effects of the vocabulary that were found, in the order found."""
        return tuple(found for found in self.findings if not is_fault(found.effect))

    @property
    def faults(self) -> tuple[DiagnosedFault, ...]:
        """Return the faults of the log: of single rows first, then of all of it.

        What is an effect as well is none where that was found.
        """
        names = {name_of(found.effect) for found in self.findings}
        of_all = (
            fault_of(found.effect, found.x, found.covariance, found.gain)
            for found in self.findings
            if is_fault(found.effect)
        )
        of_input = (fault for fault in self.prepared.faults if fault.effect not in names)
        return (*of_input, *self.faults_of_rows, *of_all)

    @property
    def error_rate(self) -> float:
        """Return the probability allowed of naming anything where nothing is missing."""
        return self.prepared.setup.options.error_rate

    @property
    def baseline(self) -> FittedModel:
        """Return the calibrated model."""
        return self.prepared.baseline

    @property
    def weights_assumed(self) -> bool:
        """Return whether torques are those of weights that nobody stated."""
        known = weights_known(self.baseline.arm)
        return self.prepared.torques == "masses" and known.origin != "stated"

    @property
    def states(self) -> PoseStates:
        """Return the states of the poses that were judged."""
        return self.scorer.judged(self.train.poses)

    @property
    def without_name(self) -> tuple[Effect, ...]:
        """Return the maps found, whatever made them, and the rivals that the search held."""
        maps = (e.effect for e in self.effects if is_error_map(e.effect))
        return (*maps, *self.nameless)

    @property
    def everything(self) -> tuple[Effect, ...]:
        """Return what has no name, and the names found beside it, as far as rows hold them."""
        every = dict.fromkeys((*self.without_name, *(e.effect for e in self.effects)))
        searched = self.scorer.searched
        return tuple(each for each in every if searched is None or each in searched)

    def with_gaps(self, changed: Callable[[PairedErrors], PairedErrors]) -> Self:
        """Return the verdict with both its gaps changed."""
        held_out = None if self.holdout is None else changed(self.holdout)
        return replace(self, train=changed(self.train), holdout=held_out)

    @property
    def holds_nowhere(self) -> bool:
        """Whether all poses are left to the calibrated model."""
        return self.falls_back is not None and self.falls_back.within.nowhere

    @property
    def trusted_holdout(self) -> PairedErrors | None:
        """Return the gap of held-out poses without a suspected reading; None without any."""
        return trusted(self.holdout, self.prepared.suspected)

    @property
    def gap(self) -> Mapping[str, PairedErrors | None]:
        """Return the gap by set of poses: `train`, and `holdout` where poses were held out."""
        return {"train": self.train, "holdout": self.holdout}

    @property
    def _shown(self) -> tuple[str, ...]:
        """Return what is shown of it beside its word, a line each."""
        if self.why is not None and self.remedy is not None:
            return self.why, self.remedy
        found = [f"{label_of(e.effect, None)}: {sized(e.parameters)}" for e in self.effects]
        found += [f"proposed, no name: {each.form.formula}" for each in self.proposed]
        more = len(found) - PLACES.most_shown
        found[PLACES.most_shown :] = [f"and {more} more"] if more > 0 else []
        found += [
            f"{name}: {gap.before.mean_mm:.4f} mm → {gap.after.mean_mm:.4f} mm in the mean"
            for name, gap in self.gap.items()
            if gap is not None
        ]
        return tuple(found)

    def __repr__(self) -> str:
        """Return the word, what was found and the gap in at most 12 lines."""
        return "\n".join((f"<{type(self).__name__}: {self.verdict}", *self._shown)) + ">"

    def _repr_html_(self) -> str:
        """Return the verdict as a notebook shows it."""
        lines = "".join(f"<li>{escape(line)}</li>" for line in self._shown)
        return f"<p>verdict: {self.verdict}</p><ul>{lines}</ul>"

    @cached_property
    def model(self) -> FittedModel:
        """Return the calibrated model with the effects found."""
        if not is_sought(self):
            return self.scorer.model_with(())
        fitted, away = self.extended.fitted(self.covariance), self.falls_back
        stated, seen = self.prepared.readings.measured.by_stated_targets, self.scorer.seen
        if away is not None and self.predicted is not None and self.holds_nowhere:
            beside = with_field(self.baseline, self.predicted.fit)
            discrepancy = discrepancy_of(beside, self.train.poses)
            away = replace(away, model=replace(beside, discrepancy=discrepancy))
        elif self.predicted is not None:
            fitted = with_field(fitted, self.predicted.fit)
        return replace(
            fitted,
            targets_off_m=self.scorer.targets_off_m(stated.shape[2]),
            seen=self.baseline.seen if seen is None else seen,
            discrepancy=discrepancy_of(fitted, self.train.poses),
            falls_back=away,
        )

    def next_poses(self, count: int, random_seed: int = 0) -> Plan:
        """Return configurations to measure next, at most so many, drawn with a seed."""
        return self.scorer.next_poses(self, count, random_seed)

    def lack_of_fit(self) -> tuple[LackOfFit, LackOfFit]:
        """Return where data and model disagree, before and after."""
        return self.scorer.lack_of_fit(self)

    @cached_property
    def errors_by_name(self) -> ErrorsByName:
        """Return the errors that remain as the effects join the model one by one."""
        within = None if self.falls_back is None else self.falls_back.within
        effects, by_names = self.extended.effects, self.predicted or self
        model_with = self.scorer.model_with
        return errors_by_name(by_names.train, by_names.holdout, effects, model_with, within)

    @property
    def explained(self) -> Explained | None:
        """Return what the effects take away; None where not sought, or nothing is missing.

        Held-out poses with a suspected reading do not count; without held-out poses it is counted
        over those fitted. Joints that give way under weights that nobody stated joined the geometry
        in the calibration already: errors before are those of the geometry alone.
        """
        nothing = self.verdict == "none" and self.predicted is None
        if (self.method is None or nothing) and not self.gives_way:
            return None
        over: Literal["held-out poses", "fitted poses"] = "held-out poses"
        gap, suspected = self.holdout, self.prepared.suspected
        if gap is None:
            gap, suspected, over = self.train, None, "fitted poses"
        rows = np.ones(len(gap.poses), dtype=bool) if suspected is None else ~suspected
        if not rows.any():
            return None
        by_names = self.predicted or self
        named = by_names.train if by_names.holdout is None else by_names.holdout
        effects, after_mm = [], named.found_after.distance_mm[rows]
        before_mm = rms(gap.found_before.distance_mm[rows])
        for spring in self.gives_way:
            proof, assumed = spring.proof, spring.proof.weights != "logged"
            without_mm = proof.without_each_mm
            effects.append(taken_away(spring, without_mm, after_mm, "assumed" if assumed else None))
            # Rigid joints have the effects found in them: without these it is no less.
            before_mm = max(before_mm, rms(proof.all_rigid_each_mm))
        findings = {finding.effect: finding for finding in self.findings}
        for effect, without in self.errors_by_name.without.items():
            effects.append(taken_away(findings[effect], without.distance_mm[rows], after_mm))
        if self.predicted is not None:
            with_it_mm = gap.found_after.distance_mm[rows]
            effects.append(by_field(self.predicted.fit.by_joint, after_mm, with_it_mm))
        return explained_by(effects, before_mm, gap.noise_rms_mm, over)


def is_sought(found: Verdict) -> TypeIs[Verdict[Scorer]]:
    """Return whether effects were sought, so that it can be fitted anew with others."""
    return isinstance(found.scorer, Scorer)


def label_of(effect: Effect, rival: Effect | None) -> str:
    """Return the name of an effect and its rival."""
    name = f"{effect.id} of {effect.of}"
    return name if rival is None else f"{name} or {rival.id} of {rival.of}"


K = TypeVar("K", bound=Scorer)
F = TypeVar("F", bound=Finding)


# Other findings than a search ended with: all is fitted anew.


def with_findings(found: Verdict[K], findings: Sequence[Finding]) -> Verdict[K]:
    """Return a verdict with these findings, all fitted anew, and their parameters with it.

    Args:
        found: the verdict.
        findings: some of its own, each with its own effect or one of its alternatives.
    """
    scorer = found.scorer.refitted(tuple(each.effect for each in findings), found.findings)
    held_out = found.prepared.held_out
    reported = [scorer.extended.reported(each.effect, scorer.covariance) for each in findings]
    return replace(
        found,
        scorer=scorer,
        findings=tuple(
            replace(each, x=x, covariance=covariance)
            for each, (x, covariance) in zip(findings, reported, strict=True)
        ),
        train=scorer.gap_on(scorer.fitted_poses(found.prepared), found.train),
        holdout=None if held_out is None else scorer.gap_on(held_out, found.holdout),
    )


def instead(found: Verdict, finding: Finding, effect: Effect | None = None) -> tuple[Finding, ...]:
    """Return the findings, one in the place of that of an effect, or else of its own."""
    effect = effect or finding.effect
    return tuple(finding if one.effect == effect else one for one in found.findings)


def without_names(
    found: Verdict[K], reasons: Mapping[Finding, str], left_mm: float | None = None
) -> Verdict[K]:
    """Return a verdict, fitted anew, without some names: they are unexplained, for a reason.

    With the mean error [mm] that is left without them; None for that of the new fit.
    """
    gone = [finding.effect for finding in reasons]
    found = with_findings(found, [one for one in found.findings if one.effect not in gone])
    left_mm = found.train.after.mean_mm if left_mm is None else left_mm
    unknown = (no_name(finding, left_mm, why) for finding, why in reasons.items())
    return replace(found, unexplained=(*found.unexplained, *unknown))


def no_name(finding: Finding, left_mm: float, why: str) -> Unexplained:
    """Return what a finding is that fits best and is no name, by the mean error left without it."""
    said = f"{label_of(finding.effect, None)} fits best, but is not named: {why}"
    return Unexplained(of=finding.of, form=finding.id, shared_error_mm=left_mm, why=said)


# How sure it is, and how it is said.


def with_likely(found: Verdict) -> Verdict:
    """Return a verdict whose findings have as alternatives what is likely enough to be listed.

    Where more than noise is left without a name, what was tried may all be wrong more often.
    """
    return replace(
        found,
        findings=tuple(in_doubt(found, each).with_likely() for each in found.findings),
        gives_way=tuple(in_doubt(found, each).with_likely() for each in found.gives_way),
    )


def in_doubt(found: Verdict, finding: F) -> F:
    """Return a finding with how probable it is that something makes it that was not tried."""
    if (by_errors := finding.proof.unknown) is not None:
        return replace(finding, unknown=by_errors.probability(found.noise_floor_mm))
    left = bool(found.unexplained) or found.over_noise
    return replace(finding, unknown=PROBABILITIES.unknown_beside if left else PROBABILITIES.unknown)


def smooth_unknown(effect: Effect, left_mm: float, what: str) -> Unexplained:
    """Return what a smooth unknown function holds: it predicts something, with a position error."""
    why = (
        f"a smooth unknown function ({effect.id}) of {effect.of} predicts {what} better than "
        f"any name{effect.advice}"
    )
    return Unexplained(of=effect.of, form=effect.id, shared_error_mm=left_mm, why=why)


def word_of(findings: Sequence[Finding], unexplained: Sequence[Unexplained]) -> Word:
    """Return the verdict in a word."""
    if unexplained or not findings:
        return "unexplained" if unexplained else "none"
    surely = (each.explanations.of(each.effect) >= PROBABILITIES.surely for each in findings)
    return "named" if all(surely) else "ambiguous"


def is_named(effect: Effect) -> bool:
    """Return whether an effect says what is wrong, and not only where."""
    return not (effect.generic or effect.id == JointErrorMap.id or is_fault(effect))
