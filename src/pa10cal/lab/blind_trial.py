"""One blind trial: what was hidden, and the verdict without knowledge of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from pa10cal.results import trials as results
from pa10cal.results.discovery import FoundEffect

MAP = "joint_error_map"
#: A map that is one line, of `k` cycles a turn, and effects outside the vocabulary that are one.
LINE = "periodic_error"
_CYCLES = {"third_harmonic": 3.0}
#: Kind of trial that hides what no name covers.
OUTSIDE = "outside"
#: Trials of trackers, in which no pose is repeated.
TRACKED = "tracked"
#: Trials with stressors and faults in the raw files.
WILD = "wild"
#: Kinds of these that are as measured robots come.
UNSTATED, SORTED = "unstated_masses", "sorted_rows"
#: Trials of sensors and gears that err.
DRIVES = "drives"
#: Root mean square over mean of the length of a vector with independent, equal normal components.
_RMS_OVER_MEAN = float(np.sqrt(3.0 * np.pi / 8.0))
#: What shows in the logged torque at every joint, and in the pose only by way of a spring.
_TORQUE_ALONE = "torque_gain"
_TORQUE_BY_SPRING = "friction_torque"
#: What the springs of the judged model are.
SPRING = "joint_compliance"
#: Effects outside the vocabulary that are an error depending on the joint's angle, so that a map at
#: their joint gives the place and leaves the cause open.
_OF_ANGLE = ("third_harmonic", "dress_pack", "sawtooth", "soft_by_angle")


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
    def failed(self) -> str | None:
        """The message where it failed."""
        return self.said.failed if isinstance(self.said, results.FailedTrialRecord) else None

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
    def put_in(self) -> tuple[results.PutIn, ...]:
        """Stressors and faults in its raw files."""
        return self.truth.put_in

    def moved_over_floor(self, hidden: results.HiddenEffect | results.PutIn) -> float | None:
        """Return how far an effect moves the residual, relative to that of noise alone.

        Both are position errors, root mean square over averaged poses; the floor's from its mean as
        for a vector with equal components. A turn about the last axis moves no position.
        """
        if self.verdict is None or hidden.moved_mm is None:
            return None
        return hidden.moved_mm / (_RMS_OVER_MEAN * self.verdict.gap.noise_floor_mm)

    def ratio(self, hidden: results.HiddenEffect, *, apart: bool = False) -> float | None:
        """Return the residual that an effect makes of the floor, in floors: sqrt(1 + moved²).

        Args:
            apart: whether the sizes of all else that is hidden are fitted as well; where the truth
                says the noise.
        """
        if self.truth.noise_mm is not None:
            moved_mm = hidden.apart_mm if apart else hidden.moved_mm
            return (
                None if moved_mm is None else float(np.hypot(1.0, moved_mm / self.truth.noise_mm))
            )
        moved = self.moved_over_floor(hidden)
        return None if moved is None else float(np.hypot(1.0, moved))

    def moves_poses(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect can move the residual of the poses at all."""
        if hidden.id == _TORQUE_BY_SPRING:
            return int(hidden.of.removeprefix("joint ")) in self.truth.flexible_joints
        return hidden.id != _TORQUE_ALONE

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

    def names(self, hidden: results.HiddenEffect) -> bool:
        """Return whether the verdict names an effect at its place."""
        return any(named.name == hidden.name for named in self._effects())

    def lists(self, hidden: results.HiddenEffect) -> bool:
        """Return whether an effect is among those named and their alternatives."""
        return any(hidden.name in named.all_names for named in self._effects())

    def alternatives(self, hidden: results.HiddenEffect) -> int:
        """Return how many other names stand beside an effect that is listed."""
        return min(
            len(named.alternatives) for named in self._effects() if hidden.name in named.all_names
        )

    def all_listed(self, among: Sequence[results.HiddenEffect]) -> bool:
        """Return whether some hidden effects are listed, each by a finding of its own."""
        return self._matched(among) == len(among)

    def extra(self) -> int:
        """Return how many findings match no hidden effect."""
        return len(self._effects()) - self._matched(self.hidden)

    def has_right_place(self) -> bool:
        """Return whether a place without a name was found where an unnamed effect is hidden."""
        if self.verdict is None:
            return False
        (hidden,) = self.hidden
        return hidden.of in self.verdict.places or any(map(self._leaves_open, self._effects()))

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
            not named.alternatives and named.name not in right and not self._leaves_open(named)
            for named in self._effects()
        )

    def _leaves_open(self, named: FoundEffect) -> bool:
        """Return whether a name is the map of an unnamed error of a joint's angle, or its line."""
        here = [hidden.id for hidden in self.hidden if hidden.of == named.of]
        if named.id == LINE:
            return any(_CYCLES.get(each) == cycles_of(named) for each in here)
        return named.id == MAP and any(each in _OF_ANGLE for each in here)

    def _effects(self) -> tuple[FoundEffect, ...]:
        return () if self.verdict is None else self.verdict.effects

    def _matched(self, among: Sequence[results.HiddenEffect]) -> int:
        """Return how many hidden effects and findings can be paired off."""
        effects = self._effects()
        fits = np.zeros((len(among), len(effects)))
        for row, hidden in enumerate(among):
            fits[row] = [hidden.name in named.all_names for named in effects]
        return int(fits[linear_sum_assignment(fits, maximize=True)].sum())


def cycles_of(found: FoundEffect) -> float | None:
    """Return the cycles a turn that a finding reports; None where it reports none."""
    return found.parameters["k"].value if "k" in found.parameters else None
