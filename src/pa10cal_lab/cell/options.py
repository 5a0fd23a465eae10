"""Options of the virtual cell."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, NonNegativeInt, ValidationInfo, field_validator

from pa10cal.observe.kinds import TrackerKind, sees_several
from pa10cal.options import NonNegative, Positive, Section

#: Keys that have a meaning whatever the instrument.
_OF_ANY_INSTRUMENT = (
    "random_seed",
    "robot",
    "hidden_effects",
    "temperature_drift_C",
    "mass_factor",
    "stated_uncertainty_mm",
    "disturbances",
)


class HiddenEffectOptions(Section):
    """One effect for the virtual cell to hide, in the vocabulary of effects."""

    id: str = Field(description="of the vocabulary of effects, such as transmission_error")
    of: str = Field(description="where it sits: `joint 2`, `forearm`, `base`, ...")
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="values of its parameters, by name"
    )


class DisturbanceOptions(Section):
    """One change of the raw files before they are written: a stressor, or a fault of the log."""

    id: str = Field(description="of docs/virtual-cell.md, such as jump or labels_exchanged")
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="values of its parameters, by name"
    )


class CellPosesOptions(Section):
    """Where the virtual cell measures: calibration and held-out poses, two straight moves."""

    layout: Literal["grid", "wide"] = Field(
        "grid",
        description="grid: 3 x 3 x 3 calibration poses, held-out points around them; wide: both "
        "drawn over large sweeps of all joints",
    )
    wide_poses: Annotated[int, Field(ge=1)] = Field(
        60, description="calibration poses of the wide layout"
    )
    centre_deg: tuple[float, ...] = Field(
        (0.0, 15.0, 90.0, 0.0, 45.0, -90.0),
        description="joint angles in the middle of the grid; they set its place, the orientation "
        "that all others vary, and the branch of the inverse kinematics",
    )
    spacing_m: tuple[Positive, Positive, Positive] = Field(
        (0.125, 0.125, 0.125), description="spacing of the grid along the robot's base axes"
    )
    tilt_rad: tuple[NonNegative, NonNegative, NonNegative] = Field(
        (0.5, 0.1, 0.1),
        description="the tool turns by up to this about its x, y and z axes, pose by pose",
    )
    outside_m: Positive = Field(
        0.1, description="held-out points lie outside the grid's volume by up to this"
    )
    line_length_m: Positive = Field(0.2, description="length of the straight moves")
    extra_deg: tuple[tuple[FiniteFloat, ...], ...] = Field(
        (),
        description="further calibration poses, joint angles each, measured after those of the "
        "layout in every repeat",
    )
    tilt_seed: NonNegativeInt = Field(
        1, description="draws orientations, held-out points and wide poses"
    )


class CellNoiseOptions(Section):
    """Standard deviations of what differs from reading to reading; 0 switches one off."""

    touch_mm: NonNegative = Field(0.004, description="one touch, each coordinate")
    apparatus_mm: NonNegative = Field(
        0.005, description="the separate measurement of the balls' places, each coordinate"
    )
    servo_rad: NonNegative = Field(
        1.5e-5, description="motor angle about its command; the resolver sees it"
    )
    unseen_rad: NonNegative = Field(
        6e-6, description="link against motor from repeat to repeat; the resolver does not see it"
    )
    resolver_rad: NonNegative = Field(4e-6, description="one resolver sample")
    resolver_count_rad: NonNegative = Field(7.67e-6, description="one count at the joint")
    torque_fraction: NonNegative = Field(
        1.7e-3, description="one torque sample, as a fraction of the joint's rated torque"
    )


class SlideOptions(Section):
    """What an arm stands on that slides: its first joint, before those of `robot`."""

    kind: Literal["rail", "column", "side_of_column"] = Field(
        description="rail: level, the arm upright on it; column: upright, and the arm too; "
        "side_of_column: upright, the first axis of the arm level"
    )
    stroke_m: Positive = Field(description="how far it slides, from 0")


class UnstatedOptions(Section):
    """What an arm weighs of which a campaign describes the geometry alone, and its own lengths."""

    lengths: Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        description="lengths, offsets and stroke of each row over those of `robot`"
    )
    mass_kg: tuple[NonNegative, ...] = Field(description="masses of the links")
    com_m: tuple[tuple[FiniteFloat, FiniteFloat, FiniteFloat], ...] = Field(
        description="their centres of mass in the frame that the joint carries along, z its axis"
    )
    slide: SlideOptions | None = Field(
        None,
        description="a rail or a column under the arm, which is then the first row of the others",
    )


class TrackerOptions(Section):
    """A simulated campaign of any arm under an instrument that does not touch it.

    The arm is an individual drawn from tolerances. Spreads are standard deviations.
    """

    instrument: TrackerKind = Field(
        "pose", description="kind of instrument from docs/instruments.md, other than touches"
    )
    poses: Annotated[int, Field(ge=1)] = Field(
        60, description="configurations, at random within the joint limits"
    )
    commanded: tuple[tuple[FiniteFloat, ...], ...] = Field(
        (),
        description="configurations instead of random ones, in this order: joint positions each "
        "[deg; mm of a sliding joint]",
    )
    holdout_share: Annotated[FiniteFloat, Field(ge=0, lt=1)] = Field(
        0.25, description="share of them held out, the last ones"
    )
    repeat_every: NonNegativeInt = Field(
        0, description="every n-th calibration pose is measured once more; 0: none"
    )
    repeats: Annotated[int, Field(ge=1)] = Field(
        1, description="how often every calibration pose is measured"
    )
    order: Literal["same", "there_and_back", "there_there_back_back", "shuffled"] = Field(
        "same",
        description="of the poses in each repeat: that of the first; every other one backwards; "
        "the first half forwards and the others backwards; or drawn anew",
    )
    by_first_joint: bool = Field(
        False, description="whether calibration poses go from the least angle of joint 1 upwards"
    )
    loads_N: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = Field(
        (0.0,), description="external loads, pose by pose in turn"
    )
    seconds_a_pose: Positive = Field(10.0, description="time that one configuration takes")
    stand_off_m: tuple[Positive, Positive] = Field(
        (1.5, 2.5),
        description="least and greatest distance of the robot from the instrument's origin, in any "
        "direction",
    )
    departs: Literal["any_way", "rows"] = Field(
        "any_way",
        description="any_way: joint axes and flange are off in all directions, by axis_m, "
        "axis_rad and zero_rad; rows: by the parameters of its rows, drawn from the tolerances",
    )
    axis_m: NonNegative = Field(
        0.25e-3,
        description="displacement of each joint's axis and of the flange, along x, y and z; that "
        "of a sliding joint's zero too",
    )
    axis_rad: NonNegative = Field(1e-3, description="turn of each joint's axis about x and y")
    zero_rad: NonNegative = Field(5e-4, description="joint zeros")
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (), description="turning joints with a spring, of an arm with masses; the others are rigid"
    )
    hardening: bool = Field(True, description="whether springs are cubic; else linear")
    tool_mass_kg: NonNegative = Field(1.0, description="mass of the tool")
    targets: Annotated[int, Field(ge=1)] = Field(
        3, description="targets of an instrument that sees several"
    )
    base_targets: NonNegativeInt = Field(
        0,
        description="targets bolted to the plate under the base, read with every "
        "configuration; of instruments of positions or poses",
    )
    states_targets: bool = Field(
        True, description="whether the campaign states where the targets are, but that of pose"
    )
    target_m: NonNegative = Field(
        1e-3, description="places of the targets about those stated, each coordinate"
    )
    target_rad: NonNegative = Field(
        5e-3, description="orientation of the target of pose about the end-effector's, each axis"
    )
    unseen_share: Annotated[FiniteFloat, Field(ge=0, lt=1)] = Field(
        0.1, description="share of several targets not seen, at least one a pose is"
    )
    position_mm: Annotated[FiniteFloat, Field(ge=1e-5)] = Field(
        0.05, description="noise of one coordinate or one distance, and its stated uncertainty"
    )
    attitude_rad: Annotated[FiniteFloat, Field(ge=1e-8)] = Field(
        2e-4, description="noise of an orientation about each axis, and its stated uncertainty"
    )
    unseen_rad: NonNegative = Field(
        0.0, description="links about their motors, which no log shows [rad; m of a sliding joint]"
    )
    resolver_rad: NonNegative = Field(0.0, description="noise of a logged angle")
    resolver_mm: NonNegative = Field(0.0, description="noise of a sliding joint's logged position")
    logs_torques: bool = Field(False, description="whether torques are logged; needs masses")
    unstated: UnstatedOptions | None = Field(
        None,
        description="true lengths and weights of an arm that is described without masses, rated "
        "torques and gear ratios, under a name of its own, with a tool of unknown mass",
    )
    clock: Literal["time", "row", "none"] = Field(
        "time", description="column for the time of a row: the time, the row's number, or none"
    )
    holdout_every: Annotated[int, Field(ge=0)] = Field(
        0, description="every n-th pose is held out, in place of the last ones; 0: none"
    )
    torque_fraction: NonNegative = Field(
        1.7e-3, description="noise of a logged torque, as a fraction of the joint's rated torque"
    )

    @field_validator("stand_off_m")
    @classmethod
    def _least_first(cls, ends_m: tuple[float, float]) -> tuple[float, float]:
        if ends_m[0] > ends_m[1]:
            raise ValueError("the least distance first")
        return ends_m

    @property
    def target_count(self) -> int:
        """Return the number of targets on the flange."""
        return self.targets if sees_several(self.instrument) else 1


class SimulateOptions(Section):
    """The virtual cell: what campaign `pa10cal simulate` writes."""

    random_seed: Annotated[int, Field(ge=0)] = Field(
        2008, description="draws the individual, the poses and the noise"
    )
    hidden_effects: tuple[HiddenEffectOptions, ...] = Field(
        (),
        description="entries {id, of, parameters} in the vocabulary of effects, or outside of it",
    )
    robot: str = Field(
        "pa10_6ce", description="an arm that is shipped, or the file of its description (.yaml)"
    )
    built: Literal["table_1", "drawn"] = Field(
        "table_1",
        description="table_1: departures and springs of the paper (its robot only); drawn: from "
        "the manufacturing tolerances and the rated torques",
    )
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (2, 3, 5), description="joints with a cubic spring"
    )
    loads_N: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = Field(
        (0.0, 22.0, 44.0), description="external loads at the calibration poses"
    )
    repeats: Annotated[int, Field(ge=1)] = Field(
        10, description="how often each calibration pose is measured at each load"
    )
    holdout_points: Annotated[int, Field(ge=0)] = Field(10, description="held-out poses")
    holdout_loads_N: tuple[NonNegative, ...] = Field(
        (22.0, 44.0, 66.0, 90.0), description="external loads at the held-out poses"
    )
    holdout_repeats: Annotated[int, Field(ge=1)] = Field(
        3, description="how often each held-out pose is measured at each load"
    )
    path: Literal["same", "alternating"] = Field(
        "same",
        description="same: every repeat runs along one path, so a joint always arrives in a pose "
        "from the same side; alternating: every other repeat runs it backwards",
    )
    temperature_drift_C: NonNegative = Field(
        0.0, description="amplitude of the hall's slow drift about the reference temperature"
    )
    mass_factor: tuple[Positive, ...] = Field(
        (), description="true masses of the links over those of the description; empty: all 1"
    )
    stated_uncertainty_mm: Positive | None = Field(
        None,
        description="what the campaign states of its instrument, right or wrong; the touches "
        "scatter by `noise` whatever it says; none: the paper's figure",
    )
    disturbances: tuple[DisturbanceOptions, ...] = Field(
        (),
        description="entries {id, parameters}: what is changed in the raw files before they are "
        "written, in this order",
    )
    poses: CellPosesOptions = Field(CellPosesOptions(), description="where it measures")
    noise: CellNoiseOptions = Field(
        CellNoiseOptions(), description="what differs from reading to reading"
    )
    without_touches: TrackerOptions | None = Field(
        None,
        description="a campaign of any arm under another instrument; of the other keys only "
        "random_seed, robot, hidden_effects, temperature_drift_C, mass_factor, "
        "stated_uncertainty_mm and disturbances then have a meaning",
    )

    @field_validator("without_touches")
    @classmethod
    def _not_with_touches(
        cls, plan: TrackerOptions | None, info: ValidationInfo
    ) -> TrackerOptions | None:
        touching = [
            name
            for name, value in info.data.items()
            if name not in _OF_ANY_INSTRUMENT and value != cls.model_fields[name].default
        ]
        if plan is not None and touching:
            raise ValueError(
                f"beside it only {', '.join(_OF_ANY_INSTRUMENT)}; {touching[0]} is for touches"
            )
        return plan
