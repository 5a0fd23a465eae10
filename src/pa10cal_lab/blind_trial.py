"""One blind trial: the verdict on a simulated campaign compared with what the campaign hides.

A campaign may be refused before it is calibrated. An error of discovery or evaluation afterwards
counts as a crash, since these must accept whatever can be calibrated.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from pa10cal.results.discovery import FoundEffect
from pa10cal.results.number_text import SURE
from pa10cal.results.record import Name
from pa10cal_lab import trial_records as results
from pa10cal_lab.cell.effects.effect import SimulatedEffect, TorqueLogEffect
from pa10cal_lab.cell.effects.vocabulary import all_effects, nameless
from pa10cal_lab.cell.measured_trials import SUBJECTS

MAP = "joint_error_map"
#: A map that is a single wave of `k` cycles a turn.
LINE = "periodic_error"
GEAR_LINE = "gear_line"
#: Studies of trials: under trackers, without repeats; with stressors and faults in the raw files;
#: of erroneous sensors and gears.
TRACKED, WILD, DRIVES = "tracked", "wild", "drives"
#: The kind of trials that hide an effect outside the vocabulary.
OUTSIDE = "outside"
SENSOR = "sensor_error"
GEAR = "gear_error"
#: Root mean square over mean of the length of a vector with independent, equal normal components.
_RMS_OVER_MEAN = float(np.sqrt(3.0 * np.pi / 8.0))
#: Difference of orders, in cycles a turn, below which they count as equal.
_SAME_ORDER = 0.5
#: A spring of a joint as an effect.
SPRING = "joint_compliance"

#: Residual over that of noise alone from which it is large, and from which its effect counts as
#: detectable.
LARGE_RATIO, DETECTABLE_RATIO = 3.0, 1.5
#: Change of the residual over the noise floor from which a fault has to be reported.
FAULT_RATIO = 3.0
#: Held-out error with effects over that without, from which predictions count as worse.
WORSE_FACTOR = 1.05
SUSPECT, CHECK = "suspect_input", "check_the_log"
#: Faults without a place that a verdict could name.
_PLACED_BY_KIND = ("step_in_time", "payload")
#: Words that offer another cause of a motion: rows that follow a joint, a rail or a load.
_RIVAL = re.compile(r"\bjoint \d|\brail\b|\bload\b|\border of (the )?rows\b", re.I)
#: The fault and the effect that are motions over time, and words for one without a name.
_IN_TIME, _DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)
#: Largest number of characters that the scores quote of a verdict.
_MOST_QUOTED = 200

#: Outcomes of a hidden effect other than the id that it was called.
LISTED = "in the alternatives"
ELSEWHERE = "right id elsewhere"
RIGHT_PLACE = "no name, right place"
WRONG_PLACE = "no name, other place"
NOTHING = "nothing found"
NOT_TESTABLE = "said to be not testable"
FAILED = "failed"


class Claim(NamedTuple):
    """A probability that a verdict states, and whether what it states is true."""

    of: str  # `name`, `alternative`, `none of these`, or `set`: that the smallest set holds it
    probability: float
    right: bool


@dataclass(frozen=True)
class BlindTrial:
    """The truth of a trial and the verdict on it."""

    truth: results.TrialTruthRecord
    judgement: results.TrialVerdictRecord  # the verdict, or why there is none

    @property
    def verdict(self) -> results.JudgedTrialRecord | None:
        """Return the verdict; None where the trial failed."""
        return self.judgement if isinstance(self.judgement, results.JudgedTrialRecord) else None

    @property
    def refused(self) -> bool:
        """Return whether a command refused the campaign as unfit to be calibrated."""
        return isinstance(self.judgement, results.FailedTrialRecord) and self.judgement.refused

    @property
    def kind(self) -> str:
        """Return the kind of the trial."""
        return self.truth.kind

    @property
    def hidden(self) -> tuple[results.HiddenEffect, ...]:
        """Return the hidden effects."""
        return self.truth.hidden_effects

    @property
    def to_be_named(self) -> tuple[results.HiddenEffect, ...]:
        """Return the hidden effects without those of a background outside the vocabulary."""
        return tuple(hidden for hidden in self.hidden if not hidden.outside)

    @property
    def put_in(self) -> tuple[results.TrialDisturbance, ...]:
        """Return stressors and faults in the raw files."""
        return self.truth.put_in

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Return the effects that the verdict names; empty where the trial failed."""
        return () if self.verdict is None else self.verdict.effects

    # Size of effects and faults, and whether the data can show them.

    def moved_over_floor(
        self, hidden: results.HiddenEffect | results.TrialDisturbance
    ) -> float | None:
        """Return the change of the residual by an effect, relative to the noise floor.

        Both are position errors, root mean square over averaged poses. That of the floor is
        computed from its mean for equal normal components.
        """
        if self.verdict is None or hidden.moved_mm is None:
            return None
        return hidden.moved_mm / (_RMS_OVER_MEAN * self.verdict.gap.noise_floor_mm)

    def ratio(self, hidden: results.HiddenEffect, *, partial: bool = False) -> float | None:
        """Return the residual with an effect, over the noise floor: sqrt(1 + moved²).

        Args:
            partial: whether the sizes of all other hidden effects are fitted as well; only where
                the truth has the noise.
        """
        moved = self.moved_over_floor(hidden)
        if self.truth.noise_mm is not None:
            moved_mm = hidden.apart_mm if partial else hidden.moved_mm
            moved = None if moved_mm is None else moved_mm / self.truth.noise_mm
        return None if moved is None else float(np.hypot(1.0, moved))

    def moves_poses(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect can change the residual of the poses."""
        kind = _kind_of(hidden)
        if issubclass(kind, TorqueLogEffect) and not kind.in_log_alone:
            return int(hidden.of.removeprefix("joint ")) in self.truth.flexible_joints
        return not kind.in_log_alone

    def is_testable(self, hidden: results.HiddenEffect) -> bool:
        """Return whether the verdict lists an effect as testable, at its plausible size.

        A compliance at a joint to which the judged model gives a spring is in the model already.
        """
        if self.verdict is None or hidden.name in self.verdict.not_shown:
            return False
        springs = {f"joint {joint}" for joint in self.verdict.springs}
        return hidden.id != SPRING or hidden.of not in springs

    def is_separable(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is testable and distinguishable from others by the verdict.

        A map of its joint's error can do what any named form of the joint does and is no rival of
        one. A map is separable where the forms of its joint are distinguishable.
        """
        if self.verdict is None or not self.is_testable(hidden):
            return False
        groups = [
            {effect.name for effect in group if effect.id != MAP}
            for group in self.verdict.indistinguishable
        ]
        if hidden.id != MAP:
            return not any(hidden.name in group and len(group) > 1 for group in groups)
        return not any(sum(name.of == hidden.of for name in group) > 1 for group in groups)

    def is_above(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is above its detection limit; all are where a trial failed."""
        if self.verdict is None:
            return True
        if not self.moves_poses(hidden):
            return self.is_testable(hidden)
        return self.is_detectable(hidden)

    def is_detectable(self, hidden: results.HiddenEffect) -> bool:
        """Return whether the residual with an effect is `DETECTABLE_RATIO` times the noise."""
        return (self.ratio(hidden) or 0.0) >= DETECTABLE_RATIO

    # Names in the verdict, and whether they are right.

    def names(self, hidden: results.HiddenEffect) -> bool:
        """Return whether the verdict names an effect at its place."""
        return any(named.name == hidden.name for named in self.effects)

    def lists(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is among those named and their alternatives."""
        return any(hidden.name in named.all_names for named in self.effects)

    def alternatives(self, hidden: results.HiddenEffect) -> int | None:
        """Return the number of other names listed with an effect; None where it is not listed."""
        counts = [len(n.alternatives) for n in self.effects if hidden.name in n.all_names]
        return min(counts, default=None)

    def matched(self, among: Sequence[results.HiddenEffect]) -> int:
        """Return the largest number of hidden effects that can be paired with findings."""
        fits = np.zeros((len(among), len(self.effects)))
        for row, hidden in enumerate(among):
            fits[row] = [hidden.name in named.all_names for named in self.effects]
        return int(fits[linear_sum_assignment(fits, maximize=True)].sum())

    def extra(self) -> int:
        """Return the number of findings that match no hidden effect."""
        return len(self.effects) - self.matched(self.hidden)

    def has_right_place(self) -> bool:
        """Return whether an unnamed effect was found at the place of the one hidden effect."""
        if self.verdict is None:
            return False
        (hidden,) = self.hidden
        return hidden.of in self.verdict.places or any(map(self._leaves_open, self.effects))

    def finds_place(self, hidden: results.HiddenEffect) -> bool:
        """Return whether anything was found at the place of a hidden effect, whatever its name."""
        effects = self.without_springs().effects
        places = [name.of for effect in effects for name in effect.all_names]
        return hidden.of in (*places, *(() if self.verdict is None else self.verdict.places))

    def is_confidently_wrong(self, *words: str) -> bool:
        """Return whether the verdict is `named` with a sure name that is not hidden.

        A map at a joint whose error depends on its angle does not count: it leaves the cause open.

        Args:
            words: further verdicts whose names are trusted.
        """
        if self.verdict is None or self.verdict.word not in ("named", *words):
            return False
        right = {hidden.name for hidden in self.hidden}
        return any(
            named.probability >= SURE and named.name not in right and not self._leaves_open(named)
            for named in self.effects
        )

    def has_wrong_name(self) -> bool:
        """Return whether a finding has no hidden effect among its name and alternatives.

        The word of the verdict does not matter: users read a list of effects as what the robot has.
        """
        hidden = {each.name for each in self.hidden}
        return any(hidden.isdisjoint(named.all_names) for named in self.effects)

    def has_wrong_name_alone(self) -> bool:
        """Return whether a sure name is not hidden, whatever the word of the verdict."""
        hidden = {each.name for each in self.hidden}
        return any(each.probability >= SURE and each.name not in hidden for each in self.effects)

    # Claimed probabilities, and whether the claims are true.

    @property
    def _true_springs(self) -> set[Name]:
        """Return the names of the springs that the arm has."""
        return {Name(SPRING, f"joint {joint}") for joint in self.truth.flexible_joints}

    def claims(self) -> Iterator[Claim]:
        """Yield the probabilities of each finding's name, of its alternatives, and of none."""
        true = {hidden.name for hidden in self.hidden} | self._true_springs
        for hidden in self.hidden:
            if hidden.outside:
                true |= {Name(id, hidden.of) for id in _kind_of(hidden).also_called}
        for named in self.effects:
            probabilities = {named.name: named.probability}
            probabilities |= {other.name: other.probability for other in named.alternatives}
            # The 95 % set may have members that are too improbable to be listed.
            names = {*probabilities, *(member.name for member in named.set95)}
            right = {
                name: name in true or self._describes_error_by_angle(name, named) for name in names
            }
            for name, probability in probabilities.items():
                of = "name" if name == named.name else "alternative"
                yield Claim(of, probability, right[name])
            none_is_right = not any(right.values())
            yield Claim("none of these", named.none_of_these, none_is_right)
            # `none of these` belongs to the set too, if it is probable enough.
            holds_none = none_is_right and named.none_of_these > 1.0 - SURE
            in_set = any(right[member.name] for member in named.set95)
            yield Claim("set", SURE, in_set or holds_none)

    def _describes_error_by_angle(self, name: Name, named: FoundEffect) -> bool:
        """Return whether a map or a line rightly describes a hidden error by a joint's angle.

        Errors of the background (`outside`) make a map or a line right as the name only, not as an
        alternative. The line that is named needs the right cycles a turn.
        """
        here = [each for each in self.hidden if each.of == name.of and _kind_of(each).by_angle]
        if name == named.name and name.id in (LINE, GEAR_LINE):
            return any(_has_line(each, named) for each in here)
        return name.id in (MAP, LINE) and any(
            name == named.name or not each.outside for each in here
        )

    def _leaves_open(self, named: FoundEffect) -> bool:
        """Return whether the name of a finding describes a hidden error by the joint's angle."""
        return self._describes_error_by_angle(named.name, named)

    def without_springs(self) -> BlindTrial:
        """Return the trial without findings of springs that the arm has."""
        springs = self._true_springs
        return self._with_effects(e for e in self.effects if springs.isdisjoint(e.all_names))

    def without_background(self) -> BlindTrial:
        """Return the trial without findings that describe the hidden background."""
        return self._with_effects(e for e in self.effects if not self._describes_background(e))

    def _with_effects(self, effects: Iterable[FoundEffect]) -> BlindTrial:
        """Return the trial with only these findings; itself where it failed."""
        if self.verdict is None:
            return self
        return replace(self, judgement=self.verdict.model_copy(update={"effects": tuple(effects)}))

    def _describes_background(self, named: FoundEffect) -> bool:
        """Return whether a finding names an effect of the background, or is a map of its error."""
        for hidden in self.hidden:
            if not hidden.outside or hidden.of != named.of:
                continue
            kind = _kind_of(hidden)
            if named.id in (LINE, GEAR_LINE) and kind.by_angle:
                if _has_line(hidden, named):
                    return True
            elif named.id in (hidden.id, *kind.also_called) or (named.id == MAP and kind.by_angle):
                return True
        return False

    def outcome(self, hidden: results.HiddenEffect) -> str:
        """Return the outcome of a hidden effect: an id of the vocabulary, or a word such as LISTED.

        Where findings match no hidden effect, the id of the first is returned.
        """
        if self.truth.measured == DRIVES:
            return self.drive_outcome(hidden.of)
        if self.verdict is None:
            return FAILED
        if self.names(hidden):
            return hidden.id
        if self.lists(hidden):
            return LISTED
        if self.kind == OUTSIDE and self.has_right_place():
            return RIGHT_PLACE
        if self.effects:
            ids = [named.id for named in self.effects]
            return ELSEWHERE if hidden.id in ids else ids[0]
        if self.verdict.word == "unexplained":
            return RIGHT_PLACE if hidden.of in self.verdict.places else WRONG_PLACE
        return NOTHING if self.is_testable(hidden) else NOT_TESTABLE

    # Erroneous sensors and gears.

    def drive_outcome(self, of: str) -> str:
        """Return the outcome for the drive of a joint; see `JudgedEffect.outcome`."""
        if self.verdict is None:
            return FAILED
        hidden = {each.id for each in self.hidden if each.of == of}
        named = next((e for e in self.effects if e.of == of and e.id in (SENSOR, GEAR, MAP)), None)
        if named is None:
            return "missed"
        causes = {name.id for name in named.all_names if name.of == of} & {SENSOR, GEAR}
        if not causes:
            return "no_cause"
        if causes == hidden:
            return "right"
        return "ambiguous" if hidden & causes else "wrong"

    # Faults in the log, and whether they are reported.

    def has_fault(self) -> bool:
        """Return whether the log has a fault that should be reported."""
        return any(not each.stressor or each.kinds for each in self.put_in)

    def matters(self, put_in: results.TrialDisturbance) -> bool:
        """Return whether a stressor or fault is at least `FAULT_RATIO` noise floors.

        One that cannot be measured matters if it should be reported, as do all of a trial without
        a verdict.
        """
        if not put_in.measured:
            return bool(put_in.kinds) or not put_in.stressor
        return self.verdict is None or (self.moved_over_floor(put_in) or 0.0) >= FAULT_RATIO

    def is_reported(self, put_in: results.TrialDisturbance) -> bool:
        """Return whether a fault is reported: by kind and place, by a refusal or by a suspicion.

        A wrong description that calibration corrects is reported as a departure.
        """
        if self.verdict is None:
            return self.refused
        if self.verdict.grade == SUSPECT:
            return True
        of_poses = bool({"outlier", "label"} & set(put_in.kinds) and put_in.where)
        if of_poses and set(put_in.where) <= set(self.verdict.left_out):
            return True
        if put_in.where and set(put_in.where) <= set(self.verdict.departures):
            return True
        places = [re.compile(rf"(?<![\w.]){re.escape(p)}(?![\w.])") for p in put_in.where]
        return any(
            fault.kind in put_in.kinds
            and (fault.kind in _PLACED_BY_KIND or any(p.search(fault.where) for p in places))
            for fault in self.verdict.faults
        )

    def hides_much(self) -> bool:
        """Return whether a hidden effect is at least `FAULT_RATIO` noise floors."""
        return any((self.moved_over_floor(each) or 0.0) >= FAULT_RATIO for each in self.hidden)

    def has_false_comfort(self) -> bool:
        """Return whether the verdict is `none` though something large is wrong and not reported."""
        if self.verdict is None or self.verdict.word != "none":
            return False
        if self.kind in SUBJECTS:
            return any(map(self.is_detectable, self.hidden))
        untold = any(self.matters(each) and not self.is_reported(each) for each in self.put_in)
        return untold or self.hides_much()

    def is_worse(self) -> bool:
        """Return whether the findings make predictions of held-out poses worse."""
        if self.verdict is None or self.verdict.gap.holdout is None:
            return False
        holdout = self.verdict.gap.holdout
        return holdout.after.mean_mm > WORSE_FACTOR * holdout.before.mean_mm

    def suspects_data(self) -> bool:
        """Return whether the campaign is refused, or its data are reported as suspect."""
        if self.verdict is None:
            return self.refused
        return self.verdict.word == CHECK or self.verdict.grade == SUSPECT

    def motions_as_facts(self) -> tuple[str, ...]:
        """Return statements about motions over time that mention no other possible cause."""
        if self.verdict is None:
            return ()
        unexplained = () if self.verdict.unexplained is None else self.verdict.unexplained.all
        motions = (
            *(fault.what for fault in self.verdict.faults if fault.kind == _IN_TIME),
            *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
            *(effect.either for effect in self.effects if effect.id == _DRIFT),
        )
        return tuple(text for text in motions if not _RIVAL.search(text))

    # Proposed formulas: whether they have the hidden form, order and place.

    def is_outside(self) -> bool:
        """Return whether all hidden effects are outside the vocabulary."""
        return bool(self.hidden) and all(hidden.id in nameless() for hidden in self.hidden)

    def proposed(self) -> tuple[Formula, ...]:
        """Return the proposed formulas, and lines that were named instead of maps."""
        if self.verdict is None:
            return ()
        lines = (each for each in self.effects if each.id == LINE)
        return (
            *(Formula(each.form, each.of, each.numbers) for each in self.verdict.proposed or ()),
            *map(line_of, lines),
        )

    def proposes(self, *, right: bool) -> bool:
        """Return whether a right formula was proposed; with `right=False`, a wrong one."""
        return any(
            any(is_right(hidden, formula) for hidden in self.hidden) == right
            for formula in self.proposed()
        )

    def judged_effect(self, hidden: results.HiddenEffect) -> results.JudgedEffect:
        """Return the record of how a hidden effect was judged."""
        return results.JudgedEffect(
            id=hidden.id,
            of=hidden.of,
            size=hidden.size,
            ratio=self.ratio(hidden),
            testable=self.is_testable(hidden),
            separable=self.is_separable(hidden),
            moves_poses=self.moves_poses(hidden),
            listed=self.lists(hidden),
            outcome=self.outcome(hidden),
        )

    def score_row(self, failings: tuple[str, ...]) -> results.JudgedTrial:
        """Return the row of the trial in the scores.

        Args:
            failings: what counts against targets.
        """
        verdict = self.verdict
        failed = "refused" if self.refused else FAILED
        return results.JudgedTrial(
            campaign=self.truth.campaign,
            kind=self.kind,
            layout=self.truth.layout,
            path=self.truth.path,
            hidden=tuple(map(self.judged_effect, self.hidden)),
            put_in=tuple(f"{each.id} at {', '.join(each.where)}" for each in self.put_in),
            verdict=failed if verdict is None else verdict.word,
            said=self._summary()[:_MOST_QUOTED],
            named=tuple(effect.either for effect in self.effects),
            places=tuple(
                place or "unknown" for place in (() if verdict is None else verdict.places)
            ),
            extra=self.extra(),
            failings=failings,
            held_out_after_mm=None if verdict is None else verdict.held_out_after_mm,
            noise_floor_mm=None if verdict is None else verdict.gap.noise_floor_mm,
            seconds=None if verdict is None else verdict.seconds,
        )

    def _summary(self) -> str:
        """Return verdict, grade, names and faults in words, or why there is none."""
        if self.verdict is None:
            reason = getattr(self.judgement, "failed", "")
            return f"{'refused' if self.refused else 'crashed'}: {reason}"
        names = (effect.either for effect in self.effects)
        faults = (f"{fault.kind} of {fault.where}" for fault in self.verdict.faults)
        return "; ".join([f"{self.verdict.word}, {self.verdict.grade}", *names, *faults])


def cycles_of(found: FoundEffect) -> float | None:
    """Return the cycles a turn that a finding reports; None where it reports none."""
    return found.parameters["k"].value if "k" in found.parameters else None


def _has_line(hidden: results.HiddenEffect, found: FoundEffect) -> bool:
    """Return whether one of the hidden waves has the cycles a turn that a finding reports."""
    of_formula = _kind_of(hidden).formula_numbers(hidden.parameters)[:1]
    orders = np.atleast_1d(np.array(hidden.parameters.get("orders", of_formula), float))
    return bool(np.any(np.abs(orders - (cycles_of(found) or 0.0)) < _SAME_ORDER))


class Formula(NamedTuple):
    """A proposed formula without its amplitudes."""

    form: str
    of: str  # its place
    numbers: tuple[float, ...] = ()  # constants of the form, orders first


def line_of(found: FoundEffect) -> Formula:
    """Return the formula of a line that was named instead of a map."""
    return Formula("harmonic", found.of, (cycles_of(found) or 0.0,))


def is_right(hidden: results.HiddenEffect, formula: Formula) -> bool:
    """Return whether a formula has the form, orders and place of a hidden effect."""
    kind = _kind_of(hidden)
    if formula.form not in kind.forms or formula.of != hidden.of:
        return False
    numbers = kind.formula_numbers(hidden.parameters)
    return formula.numbers[: len(numbers)] == numbers


def _kind_of(hidden: results.HiddenEffect) -> type[SimulatedEffect]:
    """Return the class of a hidden effect."""
    return all_effects().get(hidden.id, SimulatedEffect)
