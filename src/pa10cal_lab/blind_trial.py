"""One blind trial: what was hidden, and the verdict without knowledge of it, held against it.

A campaign may be refused before it is calibrated; what stops discovery or evaluation afterwards is
counted as a crash, since a campaign that can be calibrated is not withheld.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from pa10cal.results.discovery import FoundEffect
from pa10cal.results.record import SURE, Name
from pa10cal_lab import trial_records as results
from pa10cal_lab.cell.effects.effect import SimulatedEffect, TorqueLogEffect
from pa10cal_lab.cell.effects.vocabulary import all_effects, nameless
from pa10cal_lab.cell.measured_trials import SUBJECTS

MAP = "joint_error_map"
#: A map that is one line, of `k` cycles a turn.
LINE = "periodic_error"
GEAR_LINE = "gear_line"
#: How trials are measured: in which no pose is repeated; with stressors and faults in the raw
#: files; of sensors and gears that err.
TRACKED, WILD, DRIVES = "tracked", "wild", "drives"
#: The kind of trials that hide what no name covers.
OUTSIDE = "outside"
SENSOR = "sensor_error"
GEAR = "gear_error"
#: Root mean square over mean of the length of a vector with independent, equal normal components.
_RMS_OVER_MEAN = float(np.sqrt(3.0 * np.pi / 8.0))
#: Orders less than this apart may be one.
_SAME_ORDER = 0.5
#: What the springs of the judged model are.
SPRING = "joint_compliance"

#: A residual so many times that of noise alone is large; from `LIMIT` on an effect counts as above
#: its detection limit; from `ABOVE` on, in units of the noise floor, something wrong must show.
LARGE, LIMIT, ABOVE = 3.0, 1.5, 3.0
#: Held-out error with effects over that without, at most.
WORSE = 1.05
SUSPECT, CHECK = "suspect_input", "check_the_log"
#: Faults whose place is a time, or a key that no verdict names.
_PLACED_BY_KIND = ("step_in_time", "payload")
#: Words of a motion that offer another reading of it: rows that go with a joint, a rail or a load.
_RIVAL = re.compile(r"\bjoint \d|\brail\b|\bload\b|\border of (the )?rows\b", re.I)
#: Fault and effect that are motions in the course of time, and the words of one without a name.
_IN_TIME, _DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)
_SAYS_MOST = 200

#: What became of a hidden effect, where it is not called by an id.
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
    """A trial: what is true, and what was said of it."""

    truth: results.TrialTruthRecord
    said: results.TrialVerdictRecord

    @property
    def verdict(self) -> results.JudgedTrialRecord | None:
        """The verdict; None where the trial failed."""
        return self.said if isinstance(self.said, results.JudgedTrialRecord) else None

    @property
    def refused(self) -> bool:
        """Whether a command refused the campaign, as not fit to be calibrated."""
        return isinstance(self.said, results.FailedTrialRecord) and self.said.refused

    @property
    def kind(self) -> str:
        """What kind of trial it is."""
        return self.truth.kind

    @property
    def hidden(self) -> tuple[results.HiddenEffect, ...]:
        """The effects that it hides."""
        return self.truth.hidden_effects

    @property
    def to_be_named(self) -> tuple[results.HiddenEffect, ...]:
        """Return those of them that are not of a background outside the vocabulary."""
        return tuple(each for each in self.hidden if not each.outside)

    @property
    def put_in(self) -> tuple[results.PutIn, ...]:
        """Stressors and faults in its raw files."""
        return self.truth.put_in

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The effects that the verdict names; none where the trial failed."""
        return () if self.verdict is None else self.verdict.effects

    # How large something is, and whether the data can show it.

    def moved_over_floor(self, hidden: results.HiddenEffect | results.PutIn) -> float | None:
        """Return how far an effect moves the residual, relative to that of noise alone.

        Both are position errors, root mean square over averaged poses; the floor's from its mean as
        for a vector with equal components. A turn about the last axis moves no position.
        """
        if self.verdict is None or hidden.moved_mm is None:
            return None
        return hidden.moved_mm / (_RMS_OVER_MEAN * self.verdict.gap.noise_floor_mm)

    def ratio(self, hidden: results.HiddenEffect, *, partial: bool = False) -> float | None:
        """Return the residual that an effect makes of the floor, in floors: sqrt(1 + moved²).

        Args:
            partial: whether the sizes of all else that is hidden are fitted as well; where the
                truth says the noise.
        """
        moved = self.moved_over_floor(hidden)
        if self.truth.noise_mm is not None:
            moved_mm = hidden.apart_mm if partial else hidden.moved_mm
            moved = None if moved_mm is None else moved_mm / self.truth.noise_mm
        return None if moved is None else float(np.hypot(1.0, moved))

    def moves_poses(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect can move the residual of the poses at all."""
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
        mine = hidden.name
        groups = [
            {each.name for each in group if each.id != MAP}
            for group in self.verdict.indistinguishable
        ]
        if mine.id != MAP:
            return not any(mine in group and len(group) > 1 for group in groups)
        return not any(sum(name.of == mine.of for name in group) > 1 for group in groups)

    def is_above(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is above its detection limit; all are where a trial failed."""
        if self.verdict is None:
            return True
        if not self.moves_poses(hidden):
            return self.is_testable(hidden)
        return (self.ratio(hidden) or 0.0) >= LIMIT

    # Which names are given, and whether they are right.

    def names(self, hidden: results.HiddenEffect) -> bool:
        """Return whether the verdict names an effect at its place."""
        return any(named.name == hidden.name for named in self.effects)

    def lists(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is among those named and their alternatives."""
        return any(hidden.name in named.all_names for named in self.effects)

    def alternatives(self, hidden: results.HiddenEffect) -> int | None:
        """Return how many other names stand beside an effect; None where it is not listed."""
        beside = [len(n.alternatives) for n in self.effects if hidden.name in n.all_names]
        return min(beside, default=None)

    def matched(self, among: Sequence[results.HiddenEffect]) -> int:
        """Return how many hidden effects and findings can be paired off."""
        fits = np.zeros((len(among), len(self.effects)))
        for row, hidden in enumerate(among):
            fits[row] = [hidden.name in named.all_names for named in self.effects]
        return int(fits[linear_sum_assignment(fits, maximize=True)].sum())

    def extra(self) -> int:
        """Return how many findings match no hidden effect."""
        return len(self.effects) - self.matched(self.hidden)

    def has_right_place(self) -> bool:
        """Return whether a place without a name was found where an unnamed effect is hidden."""
        if self.verdict is None:
            return False
        (hidden,) = self.hidden
        return hidden.of in self.verdict.places or any(map(self._leaves_open, self.effects))

    def tells_place(self, hidden: results.HiddenEffect) -> bool:
        """Return whether anything was said where an effect is hidden, whatever its name."""
        said = self.without_springs()
        places = [name.of for effect in said.effects for name in effect.all_names]
        return hidden.of in (*places, *(() if self.verdict is None else self.verdict.places))

    def is_confidently_wrong(self, *words: str) -> bool:
        """Return whether the verdict is `named` and a name stands alone that is not what is hidden.

        A map at the joint of an error that depends on the joint's angle leaves the cause open.

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
        """Return whether an effect is named that is not hidden, none hidden among its alternatives.

        Whatever the word of the verdict: a list of effects is read as what the robot has.
        """
        hidden = {each.name for each in self.hidden}
        return any(not hidden & set(named.all_names) for named in self.effects)

    def has_wrong_name_alone(self) -> bool:
        """Return whether a name that is all but certain is not hidden, whatever the word."""
        hidden = {each.name for each in self.hidden}
        return any(each.probability >= SURE and each.name not in hidden for each in self.effects)

    # How probable names are, and whether what is claimed comes true.

    def claims(self) -> Iterator[Claim]:
        """Yield what each finding claims of its name, its alternatives, and of none of these."""
        true = {hidden.name for hidden in self.hidden}
        true |= {Name(SPRING, f"joint {joint}") for joint in self.truth.flexible_joints}
        true |= {
            Name(also, hidden.of)
            for hidden in self.hidden
            for also in (_kind_of(hidden).also_called if hidden.outside else ())
        }
        for named in self.effects:
            every = {named.name: named.probability}
            every |= {each.name: each.probability for each in named.alternatives}
            # A set may have members that are too improbable to be listed.
            names = {*every, *(each.name for each in named.set95)}
            right = {name: name in true or self._is_nameless(name, named) for name in names}
            for name, probability in every.items():
                of = "name" if name == named.name else "alternative"
                yield Claim(of, probability, right[name])
            none = not any(right.values())
            yield Claim("none of these", named.none_of_these, none)
            # None of these is a member of the set, too, where it is likely enough.
            held = any(right[each.name] for each in named.set95)
            yield Claim("set", SURE, held or (none and named.none_of_these > 1.0 - SURE))

    def _is_nameless(self, name: Name, named: FoundEffect) -> bool:
        """Return whether a map or a line stands for an error by a joint's angle without a name.

        Waves behind everything (`outside`) are what a map was found for, and no alternative.
        """
        here = [each for each in self.hidden if each.of == name.of and _kind_of(each).by_angle]
        if name.id == GEAR_LINE:
            return name == named.name and any(_has_line(each, named) for each in here)
        return name.id in (MAP, LINE) and any(
            name == named.name or not each.outside for each in here
        )

    def without_springs(self) -> BlindTrial:
        """Return it without findings of springs that the arm has and the calibration did not."""
        if self.verdict is None:
            return self
        true = {Name(SPRING, f"joint {joint}") for joint in self.truth.flexible_joints}
        effects = tuple(named for named in self.effects if not true & set(named.all_names))
        return replace(self, said=self.verdict.model_copy(update={"effects": effects}))

    def without_background(self) -> BlindTrial:
        """Return it without findings that describe what is hidden outside the vocabulary."""
        if self.verdict is None:
            return self
        effects = tuple(named for named in self.effects if not self._describes_outside(named))
        return replace(self, said=self.verdict.model_copy(update={"effects": effects}))

    def _describes_outside(self, named: FoundEffect) -> bool:
        """Return whether a name is right of something outside, or leaves its cause open."""
        for each in (each for each in self.hidden if each.outside and each.of == named.of):
            kind = _kind_of(each)
            if named.id in (LINE, GEAR_LINE) and kind.by_angle:
                if _has_line(each, named):
                    return True
            elif named.id in (each.id, *kind.also_called) or (named.id == MAP and kind.by_angle):
                return True
        return False

    def _leaves_open(self, named: FoundEffect) -> bool:
        """Return whether a name is the map of an unnamed error of a joint's angle, or its line."""
        here = [each for each in self.hidden if each.of == named.of and _kind_of(each).by_angle]
        if named.id == LINE:
            return any(is_right(each, line_of(named)) for each in here)
        return named.id == MAP and bool(here)

    def outcome(self, hidden: results.HiddenEffect) -> str:
        """Return what became of one hidden effect: an id of the vocabulary or one of the words.

        Where findings match no hidden effect, the first of them counts.
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

    # Sensors and gears that err.

    def drive_outcome(self, of: str) -> str:
        """Return what the error of a joint's drive was called; see `JudgedEffect.outcome`."""
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

    # Faults in the log, and what is said of them.

    def has_fault(self) -> bool:
        """Return whether something in the log is wrong that somebody should be told of."""
        return any(not each.stressor or each.kinds for each in self.put_in)

    def matters(self, put_in: results.PutIn) -> bool:
        """Return whether what was put in is more than three times the noise.

        Where it cannot be measured, since the campaign was refused, it is.
        """
        if not put_in.measured:
            return bool(put_in.kinds) or not put_in.stressor
        return self.verdict is None or (self.moved_over_floor(put_in) or 0.0) >= ABOVE

    def is_told(self, put_in: results.PutIn) -> bool:
        """Return whether a fault is told, by kind and place, or by a refusal or a suspicion.

        What is described wrongly, and found by the calibration, is told as a departure.
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
        """Return whether a hidden effect is more than three times the noise."""
        return any((self.moved_over_floor(each) or 0.0) >= ABOVE for each in self.hidden)

    def has_false_comfort(self) -> bool:
        """Return whether `none` is said where something large is wrong, untold."""
        if self.verdict is None or self.verdict.word != "none":
            return False
        if self.kind in SUBJECTS:
            return any((self.ratio(each) or 0.0) >= LIMIT for each in self.hidden)
        untold = any(self.matters(each) and not self.is_told(each) for each in self.put_in)
        return untold or self.hides_much()

    def is_worse(self) -> bool:
        """Return whether held-out poses are predicted worse with what was found."""
        if self.verdict is None or self.verdict.gap.holdout is None:
            return False
        holdout = self.verdict.gap.holdout
        return holdout.after.mean_mm > WORSE * holdout.before.mean_mm

    def is_accused(self) -> bool:
        """Return whether the campaign is refused, or its data are said to be wrong."""
        if self.verdict is None:
            return self.refused
        return self.verdict.word == CHECK or self.verdict.grade == SUSPECT

    def motions_as_facts(self) -> tuple[str, ...]:
        """Return what is said of motions in the course of time, and of nothing else as cause."""
        if self.verdict is None:
            return ()
        unexplained = () if self.verdict.unexplained is None else self.verdict.unexplained.all
        motions = (
            *(fault.what for fault in self.verdict.faults if fault.kind == _IN_TIME),
            *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
            *(effect.either for effect in self.effects if effect.id == _DRIFT),
        )
        return tuple(said for said in motions if not _RIVAL.search(said))

    # Formulas proposed: the form that was hidden, of the same order and place?

    def is_outside(self) -> bool:
        """Return whether all that it hides is outside the vocabulary."""
        return bool(self.hidden) and all(hidden.id in nameless() for hidden in self.hidden)

    def proposed(self) -> tuple[Formula, ...]:
        """Return the formulas proposed, and the lines named in the place of maps."""
        if self.verdict is None:
            return ()
        lines = (each for each in self.effects if each.id == LINE)
        return (
            *(Formula(each.form, each.of, each.numbers) for each in self.verdict.proposed or ()),
            *map(line_of, lines),
        )

    def proposes(self, *, right: bool) -> bool:
        """Return whether a formula was proposed that is what is hidden, or one that is not."""
        return any(
            any(is_right(hidden, formula) for hidden in self.hidden) == right
            for formula in self.proposed()
        )

    def judged_effect(self, hidden: results.HiddenEffect) -> results.JudgedEffect:
        """Return what became of a hidden effect."""
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
        """Return its row of the scores.

        Args:
            failings: figures to reach that it counts against.
        """
        verdict = self.verdict
        said = f"{'refused' if self.refused else 'crashed'}: {getattr(self.said, 'failed', '')}"
        if verdict is not None:
            names = (effect.either for effect in verdict.effects)
            faults = (f"{fault.kind} of {fault.where}" for fault in verdict.faults)
            said = "; ".join([f"{verdict.word}, {verdict.grade}", *names, *faults])
        failed = "refused" if self.refused else FAILED
        return results.JudgedTrial(
            campaign=self.truth.campaign,
            kind=self.kind,
            layout=self.truth.layout,
            path=self.truth.path,
            hidden=tuple(map(self.judged_effect, self.hidden)),
            put_in=tuple(f"{each.id} at {', '.join(each.where)}" for each in self.put_in),
            verdict=failed if verdict is None else verdict.word,
            said=said[:_SAYS_MOST],
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


def cycles_of(found: FoundEffect) -> float | None:
    """Return the cycles a turn that a finding reports; None where it reports none."""
    return found.parameters["k"].value if "k" in found.parameters else None


def _has_line(hidden: results.HiddenEffect, found: FoundEffect) -> bool:
    """Return whether waves that are hidden have the cycles a turn that a finding reports."""
    orders = np.atleast_1d(np.array(hidden.parameters.get("orders", ()), float))
    return bool(np.any(np.abs(orders - (cycles_of(found) or 0.0)) < _SAME_ORDER))


class Formula(NamedTuple):
    """What counts of a formula that was proposed."""

    form: str  # which form
    of: str  # where it sits
    numbers: tuple[float, ...] = ()  # what fixes it: orders first


def line_of(found: FoundEffect) -> Formula:
    """Return the formula of a line that was named in the place of a map."""
    return Formula("harmonic", found.of, (cycles_of(found) or 0.0,))


def is_right(hidden: results.HiddenEffect, formula: Formula) -> bool:
    """Return whether a formula is what is hidden: form, order and place."""
    kind = _kind_of(hidden)
    if formula.form not in kind.forms or formula.of != hidden.of:
        return False
    numbers = kind.formula_numbers(hidden.parameters)
    return formula.numbers[: len(numbers)] == numbers


def _kind_of(hidden: results.HiddenEffect) -> type[SimulatedEffect]:
    """Return the class of what is hidden."""
    return all_effects().get(hidden.id, SimulatedEffect)
