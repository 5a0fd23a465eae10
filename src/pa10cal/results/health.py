"""Whether a calibration is good: the `health` of its record."""

from __future__ import annotations

from typing import Literal

from pa10cal.results.record import Part, optional

#: How good a calibration is.
Grade = Literal["good", "few_poses", "incomplete", "suspect_input", "not_converged"]
#: Grades with which a model is exported and drawn without more ado.
UNRESERVED: frozenset[Grade] = frozenset({"good", "few_poses", "incomplete"})


class InputFinding(Part):
    """Something in the input that is probably wrong."""

    what: str  # what it is, one clause
    where: str  # column, joint, parameter, pose or file
    remedy: str  # what to do about it
    # root mean square position error that would remain if it were put right [mm]; null where that
    # was not tried
    would_leave_mm: float | None = None
    kind: str  # its kind in a word, such as `joint_sign`

    def __str__(self) -> str:
        left = self.would_leave_mm
        then = "" if left is None else f" ({left:.3g} mm rms would remain)"
        return f"{self.where}: {self.what}; {self.remedy}{then}"


class RepeatScatter(Part):
    """What repeats scatter by, beside the stated uncertainty."""

    kind: str  # `position`, `attitude` or `distance`
    found: float  # scatter of one reading, one component [m or rad]
    stated: float  # its stated standard uncertainty [m or rad]
    pairs: int  # pairs of successive readings behind it

    @property
    def ratio(self) -> float:
        """Return the scatter found over the one stated."""
        return self.found / self.stated


class CorrelatedPair(Part):
    """Two parameters that the poses can hardly separate."""

    parameters: tuple[str, str]  # names of the two parameters
    correlation: float  # their correlation, from -1 to 1


class ExpectedUncertainty(Part):
    """Standard uncertainty of a predicted position to be expected with so many poses."""

    poses: int  # number of poses
    u_optimal_mm: float  # with the best poses of those measured [mm]
    # with the first poses in the order measured [mm]; null where they do not determine the model
    u_measured_mm: float | None


class PosesNeeded(Part):
    """How many poses there are, and how many the uncertainty needs."""

    measured: int  # number of poses fitted
    needed: int | None  # number of poses needed; null where none suffices
    u_needed_mm: float  # standard uncertainty of a predicted position to reach [mm]
    # the same, where the settings ask for one; else the uncertainty to reach is one that adds
    # hardly anything to the remaining error
    wanted_mm: float | None = optional()
    # standard uncertainty of a predicted position now [mm]; null where not known
    u_model_mm: float | None
    d_optimal_order: tuple[str, ...]  # labels of the poses, the most informative first
    expected: tuple[ExpectedUncertainty, ...]  # uncertainty against the number of poses


class Health(Part):
    """What to look at before a calibration is trusted."""

    grade: Grade  # how good it is; the rule is in `docs/general.md`
    line: str  # the reason for it, in one sentence, with the remedy
    converged: bool  # whether the fit converged
    reason: str  # why the fit stopped
    iterations: int  # steps of the fit
    at_bounds: tuple[str, ...]  # parameters at the end of their physical range
    rank: int  # directions of parameter space that the data identify
    unknowns: int  # parameters fitted
    condition: float  # condition number over the identified directions
    not_identifiable: tuple[str, ...]  # parameters that are not identifiable
    correlated_pairs: tuple[CorrelatedPair, ...]  # nearly inseparable pairs
    train_rms_mm: float  # root mean square position error over the poses fitted [mm]
    # the same over held-out poses [mm], without those that have a suspected reading; null where
    # none were measured
    held_out_rms_mm: float | None
    # root mean square position error of averaged poses that noise alone leaves [mm]: with the
    # paper's model what all repeats of a pose and load scatter by, from any direction of arrival;
    # with the general model the stated uncertainty; null where it is not known
    noise_mm: float | None
    # remaining error over the noise that repeats show, or else the stated noise; null where neither
    # is known
    error_over_noise: float | None
    # held-out error over the error that the fit promises there, where chance does not explain it;
    # else null
    held_out_over_expected: float | None
    # stated and found uncertainty; empty where too little is repeated
    repeats: tuple[RepeatScatter, ...]
    # what is probably wrong in the input; empty where nothing is
    findings: tuple[InputFinding, ...]
    poses: PosesNeeded  # how many poses there are and how many are needed

    @property
    def ending(self) -> str:
        """Return how the fit ended, in one sentence without a full stop.

        Not in how many steps: their number depends on the processor, see decision 42.
        """
        return f"{'converged' if self.converged else 'not converged'}: {self.reason}"
