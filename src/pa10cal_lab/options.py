"""Options of the studies of the laboratory: blind trials, coverage."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, FiniteFloat, NonNegativeInt, ValidationInfo, field_validator

from pa10cal.observe.kinds import TrackerKind, sees_several
from pa10cal.options import Section


class TrialCounts(Section):
    """How many blind trials of each kind."""

    null: NonNegativeInt = Field(200, description="nothing hidden")
    single: NonNegativeInt = Field(
        20, description="rounds through the vocabulary, one effect a trial"
    )
    pair: NonNegativeInt = Field(100, description="two effects")
    triple: NonNegativeInt = Field(100, description="three effects")
    outside: NonNegativeInt = Field(
        25, description="rounds through the effects that no name covers, one a trial"
    )
    wrong_noise: NonNegativeInt = Field(
        40, description="nothing hidden, the instrument's uncertainty is misstated"
    )
    wrong_mass: NonNegativeInt = Field(
        40, description="nothing hidden, a link's mass differs from the arm's description"
    )


class WildCounts(Section):
    """How many wild trials of each kind."""

    right: NonNegativeInt = Field(170, description="nothing wrong and nothing hidden")
    stressed: NonNegativeInt = Field(
        7, description="rounds through the stressors, one a trial, nothing hidden"
    )
    effect: NonNegativeInt = Field(
        4, description="rounds through the vocabulary, one effect a trial, among a stressor"
    )
    beyond: NonNegativeInt = Field(
        6, description="rounds through the effects that no name covers, one a trial"
    )
    fault: NonNegativeInt = Field(5, description="rounds through the faults, one a trial")


class DriveCounts(Section):
    """How many trials of errors of sensors and gears, by what errs."""

    sensor: NonNegativeInt = Field(40, description="sensors behind gears")
    gear: NonNegativeInt = Field(40, description="gears")
    both: NonNegativeInt = Field(20, description="sensor and gear of the same joint")
    neither: NonNegativeInt = Field(40, description="no error; motors still ripple")


class UnstatedCounts(Section):
    """How many trials of arms whose masses are not stated."""

    unstated_masses: NonNegativeInt = Field(
        210, description="springs in no joint, in some or in all, alone or with one other effect"
    )


class SortedCounts(Section):
    """How many trials of files that are sorted by a joint."""

    sorted_rows: NonNegativeInt = Field(
        104, description="nothing hidden, or an effect that goes with that joint; no time"
    )


class MixedCounts(Section):
    """How many trials of several effects at once, on arms as measured ones are."""

    mixed: NonNegativeInt = Field(
        300, description="two to six effects, in every other trial among a background without names"
    )


class BlindTrialsOptions(Section):
    """Campaigns of the virtual cell judged without their truth, and scored apart."""

    random_seed: Annotated[int, Field(ge=0)] = Field(
        20080427, description="draws robots, poses, noise and hidden effects"
    )
    trials_a_job: Annotated[int, Field(ge=1)] = Field(10, description="trials that one job runs")
    full: TrialCounts = Field(
        TrialCounts(), description="what `snakemake --cores 2 blind_trials` runs"
    )
    reduced: TrialCounts = Field(
        TrialCounts(null=4, single=1, pair=2, triple=1, outside=1, wrong_noise=0, wrong_mass=0),
        description="the first of them: `snakemake --cores 2 blind_trials_reduced`",
    )
    tracked: TrialCounts = Field(
        TrialCounts(
            null=156, single=10, pair=24, triple=12, outside=6, wrong_noise=12, wrong_mass=12
        ),
        description="what it runs of trackers, with many different poses and none repeated",
    )
    reflectors: TrialCounts = Field(
        TrialCounts(null=12, single=2, pair=0, triple=0, outside=1, wrong_noise=0, wrong_mass=0),
        description="of trackers without orientations: of one target, of three, of a distance each",
    )
    wild: WildCounts = Field(
        WildCounts(),
        description="what `snakemake --cores 2 wild_trials` runs: any instrument, stressors and "
        "faults in the raw files",
    )
    drives: DriveCounts = Field(
        DriveCounts(),
        description="what `snakemake --cores 2 drive_trials` runs: errors of sensors and gears",
    )
    unstated: UnstatedCounts = Field(
        UnstatedCounts(),
        description="what `snakemake --cores 2 blind_trials_unstated` runs: arms described without "
        "masses, of any length",
    )
    sorted_by_joint: SortedCounts = Field(
        SortedCounts(),
        description="what `snakemake --cores 2 blind_trials_sorted` runs: rows sorted by a joint, "
        "without a time",
    )
    mixed: MixedCounts = Field(
        MixedCounts(),
        description="what `snakemake --cores 2 blind_trials_mixed` runs: several effects at once, "
        "on arms as measured ones are",
    )


#: Studies of blind trials by their folder of results: what measures, and which of the counts above.
TRIAL_STUDIES = {
    "blind_trials": ("touched", "full"),
    "blind_trials_reduced": ("touched", "reduced"),
    "blind_trials_tracked": ("tracked", "tracked"),
    "wild_trials": ("wild", "wild"),
    "drive_trials": ("drives", "drives"),
    "blind_trials_unstated": ("wild", "unstated"),
    "blind_trials_sorted": ("wild", "sorted_by_joint"),
    "blind_trials_mixed": ("wild", "mixed"),
    # Instruments that measure no orientation.
    "blind_trials_points_one": ("points_one", "reflectors"),
    "blind_trials_points_three": ("points_three", "reflectors"),
    "blind_trials_distance": ("distance", "reflectors"),
}
#: Studies of those trials alone that hide what no name covers: of which study, and their kind.
OUTSIDE_STUDIES = {
    "blind_trials_outside": ("blind_trials", "outside"),
    "blind_trials_tracked_outside": ("blind_trials_tracked", "outside"),
    "wild_trials_outside": ("wild_trials", "beyond"),
}


class CoverageCaseOptions(Section):
    """An arm under an instrument, calibrated with the general model."""

    robot: str = Field(description="an arm description")
    instrument: TrackerKind = Field(description="what observes it")
    targets: Annotated[int, Field(ge=1)] = Field(1, description="targets of points")
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (), description="joints with a linear spring, of an arm with masses"
    )

    @field_validator("targets")
    @classmethod
    def _one_unless_several_are_seen(cls, count: int, info: ValidationInfo) -> int:
        kind = info.data.get("instrument")
        if count > 1 and kind is not None and not sees_several(kind):
            raise ValueError(f"1: an instrument of {kind} sees one target")
        return count

    @field_validator("flexible_joints")
    @classmethod
    def _each_joint_once(cls, joints: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(joints)) < len(joints):
            raise ValueError("each joint once")
        return joints


def _case(**fields: Any) -> CoverageCaseOptions:
    """Return a case of the defaults, unchecked: a check brings the instruments, numpy and scipy."""
    return CoverageCaseOptions.model_construct(**fields)


class CoverageOptions(Section):
    """Do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?"""

    random_seed: Annotated[int, Field(ge=0)] = Field(1, description="of the first campaign")
    campaigns: Annotated[int, Field(ge=1)] = Field(
        50, description="touched campaigns calibrated with the paper's model"
    )
    general_campaigns: Annotated[int, Field(ge=1)] = Field(
        200, description="campaigns of each case calibrated with the general model, twice over"
    )
    poses: Annotated[int, Field(ge=1)] = Field(60, description="poses in each of these")
    position_mm: Annotated[FiniteFloat, Field(ge=1e-5)] = Field(
        0.05, description="noise of a coordinate or a distance, and its stated uncertainty"
    )
    attitude_rad: Annotated[FiniteFloat, Field(ge=1e-8)] = Field(
        2e-4, description="noise of an orientation about each axis, and its stated uncertainty"
    )
    cases: tuple[CoverageCaseOptions, ...] = Field(
        (
            _case(robot="iiwa14", instrument="pose"),
            _case(robot="iiwa14", instrument="points"),
            _case(robot="iiwa14", instrument="distance"),
            _case(robot="gx4_351s", instrument="pose"),
            _case(robot="gx4_351s", instrument="points"),
            _case(robot="gx4_351s", instrument="distance"),
            _case(robot="ur10", instrument="points"),
            _case(robot="ur10", instrument="distance"),
            _case(robot="ur10", instrument="pose", flexible_joints=(2, 3, 4, 5)),
            _case(robot="irb120", instrument="points", targets=3),
        ),
        description="an arm under an instrument each; targets are those of points",
    )

    @field_validator("cases")
    @classmethod
    def _each_case_once(
        cls, cases: tuple[CoverageCaseOptions, ...]
    ) -> tuple[CoverageCaseOptions, ...]:
        if any(case in cases[:k] for k, case in enumerate(cases)):
            raise ValueError("each case once")
        return cases
