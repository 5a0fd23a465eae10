"""One blind trial: what its campaign hides, the verdict on it, and which effects can be found.

A campaign may be refused before it is calibrated. An error of discovery or evaluation afterwards
counts as a crash, since these must accept whatever can be calibrated. `trial_names` compares the
verdict's names with the truth, `trial_faults` what it says of the log.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.results.discovery import FoundEffect
from pa10cal_lab import trial_records as results
from pa10cal_lab.cell.effects.effect import SimulatedEffect, TorqueLogEffect
from pa10cal_lab.cell.effects.vocabulary import all_effects

#: Studies of trials: under trackers, without repeats; with stressors and faults in the raw files;
#: of erroneous sensors and gears.
TRACKED, WILD, DRIVES = "tracked", "wild", "drives"
#: The kind of trials that hide an effect outside the vocabulary.
OUTSIDE = "outside"
#: Id of a map of a joint's error by its angle.
MAP = "joint_error_map"
#: Id of a spring of a joint as an effect.
SPRING = "joint_compliance"
#: Residual over that of noise alone from which it is large, and from which its effect counts as
#: detectable.
LARGE_RATIO, DETECTABLE_RATIO = 3.0, 1.5
#: Held-out error with effects over that without, from which predictions count as worse.
_WORSE_FACTOR = 1.05
#: Root mean square over mean of the length of a vector with independent, equal normal components.
_RMS_OVER_MEAN = float(np.sqrt(3.0 * np.pi / 8.0))


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

    def with_effects(self, effects: Iterable[FoundEffect]) -> BlindTrial:
        """Return the trial with only these findings; itself where it failed."""
        if self.verdict is None:
            return self
        return replace(self, judgement=self.verdict.model_copy(update={"effects": tuple(effects)}))

    @property
    def predicts_worse(self) -> bool:
        """Return whether the findings make predictions of held-out poses worse."""
        holdout = None if self.verdict is None else self.verdict.gap.holdout
        return holdout is not None and (
            holdout.after.mean_mm > _WORSE_FACTOR * holdout.before.mean_mm
        )

    # Size of effects and faults, and whether the data can show them.

    def moved_over_floor(
        self, hidden: results.HiddenEffect | results.TrialDisturbance
    ) -> float | None:
        """Return the change of the residual by an effect or fault, relative to the noise floor.

        Both are position errors, root mean square over averaged poses. That of the floor is
        computed from its mean for equal normal components. None where it is not known.
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
        kind = effect_class(hidden)
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


def effect_class(hidden: results.HiddenEffect) -> type[SimulatedEffect]:
    """Return the class by which the virtual cell simulates a hidden effect."""
    return all_effects().get(hidden.id, SimulatedEffect)
