"""The verdict: effects found, unexplained parts of the error, and the model with the effects.

A verdict rests on a `Basis`; where effects were sought that is a `Scorer`, which can fit the model
again with other effects (`discovery.refitted_verdict`).
"""

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
from pa10cal.arrays import Array, Rows
from pa10cal.calibration.rules import GRADES
from pa10cal.discovery.explained import ErrorsOfModels, explained_errors
from pa10cal.discovery.field import FieldFit, with_field
from pa10cal.discovery.finding import Finding, Untestable, line_of, name_of
from pa10cal.discovery.gap import (
    ErrorsByName,
    Gaps,
    PairedErrors,
    errors_by_name,
    errors_of,
    trusted,
)
from pa10cal.discovery.log_faults import (
    DiagnosedFault,
    as_corrected,
    fault_of,
    log_is_to_be_checked,
)
from pa10cal.discovery.model_with_effects import ModelWithEffects, with_targets_off
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.pose_scatter import PoseDeviations
from pa10cal.discovery.preparation import Prepared, complete
from pa10cal.discovery.proof import ComplianceProof
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.discovery.short_forms import FormComparison, FormulaProposal
from pa10cal.discovery.tuning import PLACES
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.fitted import FallBack, FittedTo, Otherwise
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage, Discrepancy
from pa10cal.observe.observations import Observations
from pa10cal.results.analysis import LackOfFit, PureErrorTest
from pa10cal.results.calibration import EffectByCampaign, InputFinding
from pa10cal.results.discovery import Explained, Separation, SuggestedPose, Unexplained
from pa10cal.results.discovery import Verdict as Word
from pa10cal.results.maps import JointWitness
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.statement_faults import is_fault


@dataclass(frozen=True)
class Plan:
    """What to measure next, and how well that is expected to separate effects."""

    poses: tuple[SuggestedPose, ...]  # in the order of choice; empty where poses cannot help
    # for each pair of effects that the data cannot separate; None where blocks judge and no effect
    # is ambiguous
    separations: tuple[Separation, ...] | None = None
    # why there are no poses that would separate effects, and what to do; None where there are, or
    # nothing is to be separated
    why_none: str | None = None


NOTHING_PLANNED = Plan(())


@dataclass(frozen=True, eq=False)
class Predicted:
    """A part of the error that has no name and is predicted in addition to the effects."""

    fit: FieldFit
    by_names: Gaps  # the other model has the effects alone, without this part


@dataclass(frozen=True, eq=False, kw_only=True)
class Basis(ABC):
    """What a verdict rests on: the calibrated model with the effects that were found.

    Methods with a body say what most bases do not have; those that have it say so.
    """

    extended: ModelWithEffects  # with the effects found, but no smooth functions
    covariance: Array  # (k, k) of all its unknowns

    #: How effects are judged; None where they are not sought.
    method: ClassVar[str | None] = None
    #: Whether the search for sets under weights that are not stated adds rivals to its findings.
    adds_rivals_of_sets: ClassVar[bool] = False

    @property
    @abstractmethod
    def searched_from(self) -> FittedModel:
        """Return the model at which the search started; the extended model has all its terms."""

    @abstractmethod
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        """Return where data and model disagree, of the calibrated and of the extended model."""

    @abstractmethod
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        """Return the extended model with some of its effects, all other parameters fitted again."""

    @property
    def nuisances(self) -> Array | None:
        """Return columns (P, b, k + 1) of nuisances that are in no model, and last their sum.

        In the components of the poses fitted; None without nuisances.
        """
        return None

    @property
    def seen(self) -> AngleCoverage | None:
        """Return the joint positions to which maps were fitted; None without maps."""
        return None

    @property
    def moved(self) -> MovedZeros | None:
        """Return steps in the zeros of joints that its readings show beside the model."""
        return None

    @property
    def scatter(self) -> PoseDeviations | None:
        """Return the scatter of single poses about the model; None where it is that of noise."""
        return None

    @property
    def torque_test(self) -> PureErrorTest | None:
        """Return the lack of fit of logged torques; None where these do not judge effects."""
        return None

    @property
    def searched(self) -> tuple[Effect, ...] | None:
        """Return the effects whose columns its rows contain; None where they contain any."""
        return None

    @property
    def unstated_forces(self) -> bool:
        """Return whether logged torques are of forces that nobody stated."""
        return False

    def targets_off_m(self, stated: int) -> Array:
        """Return the errors of the stated coordinates of targets, (a,) [m]."""
        return np.zeros(stated)

    def judged_states(self, fitted: Observations) -> PoseStates:
        """Return the states of the poses that were judged, by those of the averages fitted."""
        return fitted.states

    def next_poses(self, found: Verdict[Any], count: int, random_seed: int) -> Plan:
        """Return at most `count` poses to measure next, from a pool drawn with a seed."""
        del found, count, random_seed
        return NOTHING_PLANNED

    def record_keys(self, found: Verdict[Any]) -> dict[str, Any]:
        """Return the keys of the verdict's record that depend on the way of judging."""
        del found
        return {"search": None}

    def witness(self, effect: Effect) -> JointWitness | None:
        """Return the evidence whether sensor or gear causes a map of errors; None for none."""
        del effect
        return None

    def by_campaign(self) -> tuple[EffectByCampaign, ...] | None:
        """Return every effect as fitted to each campaign of a group alone; None for no group."""
        return None

    def contradictions(self) -> tuple[InputFinding, ...] | None:
        """Return which campaigns of a group contradict each other about the extended model.

        None for no group, or where that is not known.
        """
        return None


@dataclass(frozen=True, eq=False, kw_only=True)
class Scorer(Basis):
    """What judged the effects of a campaign, and fits the model again with other effects."""

    @abstractmethod
    def refitted(self, effects: tuple[Effect, ...], known: Sequence[Finding]) -> Self:
        """Return the scorer with another extended model: the calibrated one with these effects.

        Args:
            effects: effects of the known findings, or alternatives of these.
            known: the findings.
        """

    @abstractmethod
    def fitted_poses(self, campaign: Prepared) -> Observations:
        """Return the averaged poses to which the model is fitted."""

    @abstractmethod
    def gap_on(self, poses: Observations, before: PairedErrors | None = None) -> PairedErrors:
        """Return the errors of the calibrated and the extended model at averaged poses.

        Nuisances that the new fit does not have are those of the gap `before` it.
        """

    @abstractmethod
    def comparison(self, held: Sequence[Effect], most_poses: int | None = None) -> FormComparison:
        """Return the rows on which short forms are compared with effects without a name.

        Args:
            held: the effects that the forms may replace.
            most_poses: number of poses that is enough; None for all poses.
        """

    def likelier(self, found: Verdict[Self]) -> Verdict[Self] | None:
        """Return the verdict about a likelier set of compliances; None where there is none."""
        del found
        return None


S = TypeVar("S", bound=Basis, default=Basis, covariant=True)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Verdict(Generic[S]):
    """The verdict on a campaign.

    The attributes are a part of the Python interface, hence flat; they stand in groups: how the
    campaign was judged, errors with a name and without, what these data cannot show, the gap, and
    what the model says of itself.
    """

    # The search (`by_blocks`, `by_repeats`) sets them, but for those that the titles of the groups
    # give another module: it sets these later, in the order of `discover.discover`. With every fit
    # `findings`, `unexplained` and the gap follow (`refitted_verdict`).

    prepared: Prepared  # the campaign
    scorer: S  # what judged it, with the extended model
    context: CandidateContext  # where effects are possible in it
    candidates: int = 0  # number of effects that were tried
    why: str | None = None  # why effects cannot be sought; None where they were sought
    remedy: str | None = None  # what to do about that

    # Errors with a name: `gives_way` by `compliance`, `in_log` by `torque_faults`.

    # effects of the vocabulary and faults of the whole log that are in the extended model, in the
    # order found
    findings: tuple[Finding, ...] = ()
    # joints that give way under weights that are not stated; their springs are in the calibrated
    # model already
    gives_way: tuple[Finding[ComplianceProof], ...] = ()
    in_log: tuple[Finding, ...] = ()  # errors of logged torques, which were taken out of them
    faults_of_rows: tuple[DiagnosedFault, ...] = ()  # faults of single rows, found after the search

    # Errors without a name: as they are reported, as the search found them, as the model has them.
    # `proposed` by `proposals`, `predicted` by `discover`.

    # parts of the error that have no name: where, and why there is none
    unexplained: tuple[Unexplained, ...] = ()
    # smooth functions that the search chose for such parts; they are not in the model
    nameless: tuple[Effect, ...] = ()
    over_noise: bool = False  # whether the search left more than noise
    proposed: tuple[FormulaProposal, ...] = ()  # formulas for such parts, not in the model
    # terms of the model that predict such parts; None where held-out poses do not gain by them
    predicted: Predicted | None = None

    # What these data cannot show.

    not_testable: tuple[Untestable, ...] = ()  # effects that these data cannot show
    # effects that would often be missed at their plausible size, decided without the residuals;
    # None where repeats judge
    below_detection_limit: tuple[Untestable, ...] | None = None
    # groups of named candidates that these poses cannot separate
    indistinguishable: tuple[tuple[Effect, ...], ...] = ()

    # The gap.

    train: PairedErrors  # errors before and after, `predicted` included, at the poses fitted
    holdout: PairedErrors | None  # the same at held-out poses; None without any
    noise_floor_mm: float  # mean position error that noise alone would leave
    noise_floor_from: str | None = None  # its source in words; None where it is from repeats
    # that readings of single targets wander in time, in words; None where they do not
    readings_wander: str | None = None

    # What the model says of itself: `falls_back` by `no_harm`, `otherwise` and `doubt` by
    # `other_explanations`, `campaigns_agree` by `discover`.

    # joint positions within which the extended model holds; None where it holds everywhere
    falls_back: FallBack | None = None
    otherwise: Otherwise | None = None  # the model under another explanation of the readings
    # whether the calibrated model has campaigns of a group contradict each other, and the extended
    # one does not
    campaigns_agree: bool = False
    # probability that an effect named is none of those known, and what the model lacks without it
    doubt: tuple[float, Discrepancy] | None = None

    # What was judged, and how.

    @property
    def method(self) -> str | None:
        """Return how effects are judged; None where they are not sought."""
        return self.scorer.method

    @property
    def error_rate(self) -> float:
        """Return the probability allowed of naming an effect where none is missing."""
        return self.prepared.setup.options.error_rate

    @property
    def baseline(self) -> FittedModel:
        """Return the calibrated model."""
        return self.prepared.baseline

    @property
    def states(self) -> PoseStates:
        """Return the states of the poses that were judged."""
        return self.scorer.judged_states(self.train.poses)

    @property
    def weights_assumed(self) -> bool:
        """Return whether torques are computed from weights that are not stated."""
        known = weights_known(self.baseline.arm)
        return self.prepared.torques == "masses" and known.origin != "stated"

    @property
    def extended(self) -> ModelWithEffects:
        """Return the calibrated model with the effects found."""
        return self.scorer.extended

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance (k, k) of all unknowns of the extended model."""
        known, moved = self.scorer.covariance, self.prepared.moved
        if moved is None or not is_sought(self):
            return known
        return known + moved.covariance_of_fit(self.extended.at, self.train.poses, known)

    @property
    def since(self) -> MovedZeros | None:
        """Return the steps of joints since the last of which the extended model is of the arm."""
        return self.prepared.moved if is_sought(self) and not self.holds_nowhere else None

    # What the verdict says.

    @property
    def verdict(self) -> Word:
        """Return the verdict in a word."""
        if self.why is not None:
            return "not_sought"
        named = (*self.gives_way, *self.in_log, *self.effects)
        unexplained = bool(self.unexplained)
        if log_is_to_be_checked(self.faults, has_effects=bool(named), is_unexplained=unexplained):
            return "check_the_log"
        return word_of(named, self.unexplained)

    @property
    def effects(self) -> tuple[Finding, ...]:
        """Return the effects of the vocabulary that were found, in the order found."""
        return tuple(found for found in self.findings if not is_fault(found.effect))

    @property
    def faults(self) -> tuple[DiagnosedFault, ...]:
        """Return the faults of the log: of the input first, of single rows, of the whole log.

        A fault with the same consequences as an effect is omitted where that effect was found, and
        departures of the arm where held-out poses confirm them.
        """
        names = {name_of(found.effect) for found in self.findings}
        of_all = (
            fault_of(found.effect, found.x, found.covariance, found.proof.explains)
            for found in self.findings
            if is_fault(found.effect)
        )
        of_input = (
            fault
            for fault in self.prepared.faults
            if fault.effect not in names
            and not (fault.is_departure and self.departures_are_confirmed)
        )
        faults = (*of_input, *self.faults_of_rows, *of_all)
        return faults if self.since is None else tuple(map(as_corrected, faults))

    @cached_property
    def departures_are_confirmed(self) -> bool:
        """Return whether the model with the effects found predicts held-out poses to the noise.

        Another cause may then no longer look like a large departure from the nominal arm, as it may
        by the larger error of the calibrated model.
        """
        gap = self.trusted_holdout
        if gap is None or not self.effects or self.holds_nowhere:
            return False
        enough = gap.after.configurations >= GRADES.few_held_out
        return enough and gap.after.rms_mm < GRADES.confirmed_ratio * gap.noise_rms_mm

    @property
    def without_name(self) -> tuple[Effect, ...]:
        """Return what shows where an error is and not its cause: maps found, and `nameless`."""
        maps = (e.effect for e in self.effects if is_error_map(e.effect))
        return (*maps, *self.nameless)

    def next_poses(self, count: int, random_seed: int = 0) -> Plan:
        """Return at most `count` poses to measure next, from a pool drawn with a seed."""
        return self.scorer.next_poses(self, count, random_seed)

    def lack_of_fit(self) -> tuple[LackOfFit, LackOfFit]:
        """Return where data and model disagree, of the calibrated and of the extended model."""
        return self.scorer.lack_of_fit(self)

    @property
    def _shown(self) -> tuple[str, ...]:
        """Return the lines that are shown in addition to the word of the verdict."""
        faults = [f"fault, {each.where}: {each.what}" for each in self.faults]
        if self.why is not None:
            return (self.why, *filter(None, [self.remedy]), *_at_most(PLACES.most_shown, faults))
        found = [*map(line_of, (*self.gives_way, *self.in_log, *self.effects)), *faults]
        found += [f"no name, {each.of or 'place unknown'}: {each.why}" for each in self.unexplained]
        found += [f"proposed, no name: {each.form.formula}" for each in self.proposed]
        gaps = [
            f"{name}: {gap.before.mean_mm:.4f} mm → {gap.after.mean_mm:.4f} mm in the mean"
            for name, gap in self.gap.items()
            if gap is not None
        ]
        return (*_at_most(PLACES.most_shown, found), *gaps)

    def __repr__(self) -> str:
        """Return the word, what was found and the gap in at most 12 lines."""
        return "\n".join((f"<{type(self).__name__}: {self.verdict}", *self._shown)) + ">"

    def _repr_html_(self) -> str:
        """Return the verdict as a notebook shows it."""
        lines = "".join(f"<li>{escape(line)}</li>" for line in self._shown)
        return f"<p>verdict: {self.verdict}</p><ul>{lines}</ul>"

    # The gap.

    @property
    def gap(self) -> Mapping[str, PairedErrors | None]:
        """Return the gap by set of poses: `train`, and `holdout`, None without held-out poses."""
        return {"train": self.train, "holdout": self.holdout}

    @property
    def trusted_holdout(self) -> PairedErrors | None:
        """Return the gap at held-out poses without a suspected reading; None without any."""
        return trusted(self.holdout, self.prepared.suspected)

    @property
    def by_names(self) -> Gaps:
        """Return the errors of the model with the effects alone, without what has no name."""
        return Gaps(self.train, self.holdout) if self.predicted is None else self.predicted.by_names

    def with_gaps(self, changed: Callable[[PairedErrors], PairedErrors]) -> Self:
        """Return the verdict with a function applied to the gaps of train and holdout."""
        held_out = None if self.holdout is None else changed(self.holdout)
        return replace(self, train=changed(self.train), holdout=held_out)

    @cached_property
    def errors_by_name(self) -> ErrorsByName:
        """Return the errors that remain as the effects join the model one by one."""
        within = None if self.falls_back is None else self.falls_back.within
        effects, model_with = self.extended.effects, self.scorer.model_with
        return errors_by_name(*self.by_names, effects, model_with, within)

    @property
    def explained(self) -> Explained | None:
        """Return the part of the error that each effect explains.

        None where effects were not sought, or none is missing. It is computed at held-out poses
        without a suspected reading, or at the poses fitted where there are none. Springs under
        weights that are not stated are in the calibrated model already: errors before are those of
        the geometry alone. Where zeros of joints moved they are those of the model fitted anew: the
        calibrated one is of no one state of the arm.
        """
        nothing = not (self.effects or self.unexplained or self.faults or self.predicted)
        if (self.method is None or nothing) and not self.gives_way:
            return None
        part_by_joint = None if self.predicted is None else self.predicted.fit.by_joint
        return explained_errors(self._errors_of_models(), self.gives_way, part_by_joint)

    def _errors_of_models(self) -> ErrorsOfModels:
        """Return the errors of all models at the poses at which `explained` is computed."""
        by_names, errors = self.by_names, self.errors_by_name
        suspected = self.prepared.suspected
        rows: Rows = slice(None)
        over: Literal["held-out poses", "fitted poses"]
        if self.trusted_holdout is None:
            over = "fitted poses"
            gap, named, without = self.train, by_names.train, errors.fitted_without
        else:
            assert self.holdout is not None
            assert by_names.holdout is not None
            over, rows = "held-out poses", rows if suspected is None else ~suspected
            gap, named, without = self.holdout, by_names.holdout, errors.held_out_without
        findings = {finding.effect: finding for finding in self.findings}
        calibrated = gap.found_before
        if self.since is not None:
            calibrated = errors_of(self.scorer.model_with(()), gap.poses)
        return ErrorsOfModels(
            over=over,
            pose=gap.poses.pose[rows],
            noise_mm=gap.noise_rms_mm,
            calibrated_mm=calibrated.distance_mm[rows],
            named_mm=named.found_after.distance_mm[rows],
            exported_mm=gap.found_after.distance_mm[rows],
            without_mm={findings[e]: found.distance_mm[rows] for e, found in without.items()},
        )

    # The model that a user takes away.

    @cached_property
    def model(self) -> FittedModel:
        """Return the calibrated model with the effects found, and with what is `predicted`."""
        if not is_sought(self):
            return self.scorer.model_with(())
        fitted = self.extended.fitted(self.covariance)
        if self.predicted is not None and not self.holds_nowhere:
            fitted = with_field(fitted, self.predicted.fit)
        fitted = self.with_targets_off(fitted)
        return replace(
            fitted,
            fitted_to=self._fitted_to(),
            seen=self.baseline.seen if self.scorer.seen is None else self.scorer.seen,
            discrepancy=self._in_doubt(self._discrepancy_of(fitted)),
            falls_back=self._with_field_of_fall_back(),
            otherwise=self.otherwise,
        )

    @property
    def holds_nowhere(self) -> bool:
        """Whether all poses are left to the calibrated model."""
        return self.falls_back is not None and self.falls_back.within.nowhere

    def with_targets_off(self, fitted: FittedModel) -> FittedModel:
        """Return a model with the errors of the targets' stated places on their apparatus."""
        stated = self.prepared.readings.measured.by_stated_targets.shape[2]
        off_m = self.scorer.targets_off_m(stated)
        return with_targets_off(fitted, off_m, self.prepared.setup.apparatus_m, self.train.poses)

    def _with_field_of_fall_back(self) -> FallBack | None:
        """Return `falls_back`, with what is `predicted` where the effects hold nowhere.

        All poses are then predicted by the model fallen back to, so that the field is a part of
        that one. Either model states what it lacks itself.
        """
        if self.falls_back is None or self.predicted is None or not self.holds_nowhere:
            return self.falls_back
        model = with_field(self.baseline, self.predicted.fit)
        model = replace(model, discrepancy=self._discrepancy_of(model))
        return replace(self.falls_back, model=model)

    def _discrepancy_of(self, fitted: FittedModel) -> Discrepancy | None:
        """Return what a model lacks by the fitted poses, and by those held out of this campaign."""
        held_out = self.trusted_holdout
        kept_apart = None if held_out is None else held_out.poses
        readings = complete(self.prepared.trusted, self.baseline, self.prepared.setup, fitted)
        return discrepancy_of(fitted, self.train.poses, kept_apart=kept_apart, readings=readings)

    def _in_doubt(self, lacks: Discrepancy | None) -> Discrepancy | None:
        """Return what the model lacks, with what it does if an effect is none of those known."""
        return lacks if lacks is None or self.doubt is None else lacks.mixed_with(*self.doubt)

    def _fitted_to(self) -> FittedTo | None:
        """Return what the model was fitted to, its grade as the effects leave it."""
        about = self.baseline.fitted_to
        if about is None:
            return None
        return about.confirmed(
            departures=self.departures_are_confirmed,
            campaigns=self.campaigns_agree,
            effects=[] if self.holds_nowhere else [name_of(each.effect) for each in self.findings],
            steps=self.since is not None,
        )


def _at_most(count: int, lines: Sequence[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    more = len(lines) - count
    return [*lines[:count], *([f"and {more} more"] if more > 0 else [])]


def is_sought(found: Verdict) -> TypeIs[Verdict[Scorer]]:
    """Return whether effects were sought: then the model can be fitted with other effects."""
    return isinstance(found.scorer, Scorer)


def word_of(findings: Sequence[Finding], unexplained: Sequence[Unexplained]) -> Word:
    """Return the verdict in a word."""
    if unexplained or not findings:
        return "unexplained" if unexplained else "none"
    surely = (each.probability >= PROBABILITIES.surely for each in findings)
    return "named" if all(surely) else "ambiguous"
