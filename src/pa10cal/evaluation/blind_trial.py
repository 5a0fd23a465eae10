"""One blind trial: what was hidden, and the verdict without knowledge of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

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


@dataclass(frozen=True, order=True)
class Name:
    """An effect and its place, in the vocabulary's words."""

    id: str
    of: str


@dataclass(frozen=True)
class Hidden:
    """An effect that was hidden."""

    name: Name  # which, and where
    size: float  # factor of its reference size
    parameters: Mapping[str, object]  # as the cell has them; vectors are lists
    # how far it moves what the calibrated baseline leaves at averaged poses, root mean square;
    # None where the trial failed
    moved_mm: float | None
    # the same once the sizes of all else that is hidden are fitted; None where that is not known
    apart_mm: float | None = None


@dataclass(frozen=True)
class Disturbed:
    """A stressor or a fault that a wild trial puts into the raw files."""

    id: str  # which
    where: tuple[str, ...]  # poses, joints, loads or keys
    stressor: bool  # whether ordinary logs have it; else somebody must be told
    kinds: tuple[str, ...]  # kinds of fault of a verdict that tell it
    measured: bool  # whether `moved_mm` says how much it matters; else it is far above the noise
    # how far it moves what the calibrated model leaves; None where not known
    moved_mm: float | None


@dataclass(frozen=True)
class Told:
    """What a verdict and its calibration say of the log."""

    faults: tuple[tuple[str, str], ...] = ()  # kind and place of each fault of the verdict
    grade: str = ""  # of the calibration
    # poses with quarantined rows, or that are suspected outliers
    left_out: frozenset[str] = frozenset()
    motions: tuple[str, ...] = ()  # what is said of each motion in the course of time, in words


@dataclass(frozen=True)
class Named:
    """An effect of a verdict."""

    name: Name  # which, and where
    alternatives: tuple[Name, ...]  # what explains the data as well
    parameters: Mapping[str, tuple[float, float]]  # value and standard uncertainty, by name

    @property
    def all_names(self) -> tuple[Name, ...]:
        """Return the name and its alternatives."""
        return (self.name, *self.alternatives)

    @property
    def cycles(self) -> float | None:
        """Return the cycles a turn that it reports; None where it reports none."""
        return self.parameters["k"][0] if "k" in self.parameters else None


@dataclass(frozen=True)
class Formula:
    """A formula that was proposed."""

    form: str  # which form
    of: str  # where it sits
    numbers: tuple[float, ...] = ()  # what fixes it: orders first


@dataclass(frozen=True)
class Verdict:
    """The verdict on a trial."""

    word: str  # `none`, `named`, `ambiguous`, `unexplained`, `check_the_log` or `not_sought`
    effects: tuple[Named, ...]  # what was named, in order
    places: tuple[str | None, ...]  # where something without a name sits; None where it is unknown
    not_testable: frozenset[Name]  # what the data cannot show, or not surely at its plausible size
    indistinguishable: tuple[frozenset[Name], ...]  # groups that the poses cannot separate
    springs: tuple[int, ...]  # joints with a spring in the judged model, from 1
    noise_floor_mm: float  # mean position error of repeatability alone
    # mean position error of the extended model at held-out poses; None where there are none
    held_out_after_mm: float | None
    # seconds and seconds_simulating: what judging, and making, the trial took
    seconds: float
    seconds_simulating: float
    # of the calibrated model at held-out poses; None where there are none
    held_out_before_mm: float | None = None
    told: Told = Told()  # what is said of the log
    proposed: tuple[Formula, ...] = ()  # formulas for what has no name

    @property
    def says_something(self) -> bool:
        """Whether anything was found, with a name or without."""
        return self.word not in ("none", "not_sought") or bool(self.effects)


@dataclass(frozen=True)
class BlindTrial:
    """A trial with its verdict."""

    # campaign, kind, layout and path: which trial
    campaign: str
    kind: str
    layout: str
    path: str
    measured: str  # `touched`, with poses repeated, `tracked`, without, or `wild`, either
    flexible_joints: tuple[int, ...]  # joints with a spring
    hidden: tuple[Hidden, ...]  # what it hides
    seconds_twin: float  # what it took to find how far the residual is moved
    verdict: Verdict | None  # None where it failed
    failed: str | None  # the message where it failed
    # whether that is a command's, that the campaign is not fit to be calibrated
    refused: bool = False
    put_in: tuple[Disturbed, ...] = ()  # stressors and faults in its raw files
    # what noise alone leaves of positions, root mean square, by the truth; None where the
    # verdict's noise floor stands for it
    noise_mm: float | None = None

    def moved_over_floor(self, hidden: Hidden | Disturbed) -> float | None:
        """Return how far an effect moves the residual, relative to that of noise alone.

        Both are position errors, root mean square over averaged poses; the floor's from its mean as
        for a vector with equal components. A turn about the last axis moves no position.
        """
        if self.verdict is None or hidden.moved_mm is None:
            return None
        return hidden.moved_mm / (_RMS_OVER_MEAN * self.verdict.noise_floor_mm)

    def ratio(self, hidden: Hidden, *, apart: bool = False) -> float | None:
        """Return the residual that an effect makes of the floor, in floors: sqrt(1 + moved²).

        Args:
            hidden: the effect.
            apart: whether the sizes of all else that is hidden are fitted as well; where the truth
                says the noise.
        """
        if self.noise_mm is not None:
            moved_mm = hidden.apart_mm if apart else hidden.moved_mm
            return None if moved_mm is None else float(np.hypot(1.0, moved_mm / self.noise_mm))
        moved = self.moved_over_floor(hidden)
        return None if moved is None else float(np.hypot(1.0, moved))

    def moves_poses(self, hidden: Hidden) -> bool:
        """Return whether an effect can move the residual of the poses at all."""
        if hidden.name.id == _TORQUE_BY_SPRING:
            return int(hidden.name.of.removeprefix("joint ")) in self.flexible_joints
        return hidden.name.id != _TORQUE_ALONE

    def is_testable(self, hidden: Hidden) -> bool:
        """Return whether the verdict lists an effect as testable, at its plausible size.

        A compliance at a joint to which the judged model gives a spring is in the model already.
        """
        if self.verdict is None or hidden.name in self.verdict.not_testable:
            return False
        springs = {f"joint {joint}" for joint in self.verdict.springs}
        return hidden.name.id != SPRING or hidden.name.of not in springs

    def is_separable(self, hidden: Hidden) -> bool:
        """Return whether an effect is testable and distinguishable from others by the verdict.

        A map of its joint's error can do what any named form of the joint does and is no rival of
        one. A map is separable where the forms of its joint are distinguishable.
        """
        if self.verdict is None or not self.is_testable(hidden):
            return False
        mine = hidden.name
        groups = [
            {name for name in group if name.id != MAP} for group in self.verdict.indistinguishable
        ]
        if mine.id != MAP:
            return not any(mine in group and len(group) > 1 for group in groups)
        return not any(sum(name.of == mine.of for name in group) > 1 for group in groups)

    def names(self, hidden: Hidden) -> bool:
        """Return whether the verdict names an effect at its place."""
        return any(named.name == hidden.name for named in self._effects())

    def lists(self, hidden: Hidden) -> bool:
        """Return whether an effect is among those named and their alternatives."""
        return any(hidden.name in named.all_names for named in self._effects())

    def alternatives(self, hidden: Hidden) -> int:
        """Return how many other names stand beside an effect that is listed."""
        return min(
            len(named.alternatives) for named in self._effects() if hidden.name in named.all_names
        )

    def all_listed(self, among: Sequence[Hidden]) -> bool:
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
        return hidden.name.of in self.verdict.places or any(map(self._leaves_open, self._effects()))

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

    def _leaves_open(self, named: Named) -> bool:
        """Return whether a name is the map of an unnamed error of a joint's angle, or its line."""
        here = [hidden.name.id for hidden in self.hidden if hidden.name.of == named.name.of]
        if named.name.id == LINE:
            return any(_CYCLES.get(each) == named.cycles for each in here)
        return named.name.id == MAP and any(each in _OF_ANGLE for each in here)

    def _effects(self) -> tuple[Named, ...]:
        return () if self.verdict is None else self.verdict.effects

    def _matched(self, among: Sequence[Hidden]) -> int:
        """Return how many hidden effects and findings can be paired off."""
        return max(map(len, self._pairings(among)), default=0)

    def _pairings(self, among: Sequence[Hidden]) -> Iterator[list[Named]]:
        effects = self._effects()
        count = min(len(effects), len(among))
        for chosen in permutations(among, count):
            for kept in permutations(effects, count):
                yield [
                    named
                    for hidden, named in zip(chosen, kept, strict=True)
                    if hidden.name in named.all_names
                ]
