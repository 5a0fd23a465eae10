"""Every setting of the pipeline, typed, with its default; unknown keys are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import yaml
from pydantic import (
    Field,
    FiniteFloat,
    NonNegativeInt,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from pa10cal.errors import SettingsError
from pa10cal.refused_settings import refusal
from pa10cal.settings_coverage import CoverageCaseSettings as CoverageCaseSettings
from pa10cal.settings_coverage import CoverageSettings as CoverageSettings
from pa10cal.settings_curve import CurveStudySettings as CurveStudySettings
from pa10cal.settings_section import NonNegative as NonNegative
from pa10cal.settings_section import Positive as Positive
from pa10cal.settings_section import Section as Section
from pa10cal.settings_simulate import CellNoiseSettings as CellNoiseSettings
from pa10cal.settings_simulate import CellPosesSettings as CellPosesSettings
from pa10cal.settings_simulate import HiddenEffectSettings as HiddenEffectSettings
from pa10cal.settings_simulate import SightedPlan as SightedPlan
from pa10cal.settings_simulate import SimulateSettings as SimulateSettings

_S = TypeVar("_S", bound="Section")


class IngestSettings(Section):
    """Raw logs to a table of poses."""

    stray_touch_sigma: Positive = Field(
        6.0,
        description="a touch further off its sphere than this many instrument sigmas is a stray",
    )
    still_speed_deg_s: Positive = Field(
        0.02, description="a joint slower than this stands still [deg/s]"
    )
    max_quarantined_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.2, description="more rows left out than this stops the stage"
    )


class BaseFrameSettings(Section):
    """Base frame from the straight-line moves, equations (5)-(7)."""

    min_length_mm: Positive = Field(50.0, description="a shorter straight move is refused")
    max_bend_mm: Positive = Field(
        5.0, description="largest rms distance from the fitted line before it counts as bent"
    )
    min_angle_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        60.0, description="a smaller angle between the x and y moves counts as parallel"
    )


class ToleranceSettings(Section):
    """Manufacturing tolerances that scale the departures (paper, Section II.C)."""

    a_m: Positive = 0.25e-3
    alpha_rad: Positive = 1e-3
    d_m: Positive = 0.25e-3
    beta_rad: Positive = 1e-3
    theta_rad: Positive = 5e-4


class GeneralSettings(Section):
    """The general model, for any arm and instrument."""

    springs: tuple[Annotated[int, Field(ge=1)], ...] | Literal["auto"] = Field(
        "auto",
        description="a list of joints from 1, those with a linear spring; or auto: those whose "
        "torque varies",
    )
    robust: bool = Field(True, description="poses far outside the scatter weigh less")


class CalibrationSettings(Section):
    """The two-level calibration, equations (1)-(4), and the readings of the paper."""

    model: Literal["auto", "paper", "general"] = Field(
        "auto",
        description="auto: the paper's where balls are touched, with the general one beside it, "
        "and the general one for other instruments",
    )
    general: GeneralSettings = GeneralSettings()
    epsilon: NonNegative = Field(1.6e-4, description="weight of the tolerance terms")
    epsilon_acts_on: Literal["residual", "cost"] = Field(
        "residual", description="what epsilon multiplies"
    )
    tolerance_terms: Literal["null_space", "all"] = Field(
        "null_space",
        description="null_space: the terms settle only what the data leave open; "
        "all: on every departure, as printed",
    )
    tolerances: ToleranceSettings = ToleranceSettings()
    inner_poses: Annotated[int, Field(ge=1)] | Literal["all"] = Field(
        8, description="M: poses of the inner level"
    )
    inner_subsets: Annotated[int, Field(ge=0)] = Field(
        20, description="random choices of the M poses tried to see how much the answer depends"
    )
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (2, 3, 5), description="joints with a cubic spring; the others are rigid"
    )
    r_max_m: Positive = Field(1.0, description="length that normalises positions")
    starts: Annotated[int, Field(ge=1)] = Field(8, description="initial guesses tried")
    random_seed: Annotated[int, Field(ge=0)] = 20080427
    max_iterations: Annotated[int, Field(ge=1)] = 200
    apparatus_uncertainty_mm: NonNegative = Field(
        0.005,
        description="standard uncertainty of a tooling ball's place on the apparatus, per axis",
    )

    @field_validator("flexible_joints")
    @classmethod
    def _each_once(cls, joints: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(joints)) < len(joints):
            raise ValueError("each joint once")
        return joints


class MonteCarloSettings(Section):
    """Position error from resolver uncertainty, plane by plane."""

    planes_mm: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (
        300,
        400,
        500,
        600,
        700,
    )
    cycles: Annotated[int, Field(ge=2)] = 100_000
    positions: Annotated[int, Field(ge=2)] = 200
    sigma_deg: Positive = 0.011
    reach_m: tuple[Positive, Positive] = (0.5, 0.9)
    random_seed: Annotated[int, Field(ge=0)] = 20080427
    map_spacing_mm: Positive = 50.0

    @field_validator("reach_m")
    @classmethod
    def _increasing(cls, reach_m: tuple[float, float]) -> tuple[float, float]:
        if reach_m[0] >= reach_m[1]:
            raise ValueError("two distances [m], the nearer first")
        return reach_m


class EvaluationSettings(Section):
    """Held-out points and loads."""

    calibration: str = Field("combined", description="which load case's models are evaluated")


class DiscoverySettings(Section):
    """The search for missing effects."""

    error_rate: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.01, description="probability allowed of a name where nothing is missing"
    )
    load_uncertainty: NonNegative = Field(
        0.005, description="standard uncertainty of an external load, relative"
    )
    load_point_uncertainty_mm: NonNegative = Field(
        2.0, description="standard uncertainty of where the load hangs, per axis"
    )
    tool_com_uncertainty_mm: NonNegative = Field(
        2.0, description="standard uncertainty of the apparatus' centre of mass, per axis"
    )
    level_uncertainty_mrad: NonNegative = Field(
        1.0, description="standard uncertainty of the direction of gravity in the base frame"
    )
    mass_uncertainty: NonNegative = Field(
        0.3, description="standard uncertainty of a link's mass, relative"
    )
    com_uncertainty_mm: NonNegative = Field(
        30.0, description="standard uncertainty of a link's centre of mass, per axis"
    )
    torque_zero_uncertainty: NonNegative = Field(
        0.01, description="standard uncertainty of a torque's zero, relative to the rated torque"
    )
    suggestions: Annotated[int, Field(ge=0)] = Field(
        10, description="poses to suggest where effects cannot be told apart"
    )
    random_seed: Annotated[int, Field(ge=0)] = Field(
        20080427, description="of the poses from which suggestions are chosen"
    )


class TrialCounts(Section):
    """How many blind trials of each kind."""

    null: NonNegativeInt = Field(200, description="nothing hidden")
    single: NonNegativeInt = Field(380, description="one effect, each of the vocabulary in turn")
    pair: NonNegativeInt = Field(100, description="two effects")
    triple: NonNegativeInt = Field(100, description="three effects")
    outside: NonNegativeInt = Field(100, description="one effect that no name covers")
    wrong_noise: NonNegativeInt = Field(40, description="nothing hidden, uncertainty misstated")
    wrong_mass: NonNegativeInt = Field(40, description="nothing hidden, one link's mass is wrong")


class BlindTrialsSettings(Section):
    """Campaigns of the virtual cell judged without their truth, and scored apart."""

    random_seed: Annotated[int, Field(ge=0)] = 20080427
    trials_a_job: Annotated[int, Field(ge=1)] = Field(10, description="trials one job runs")
    full: TrialCounts = Field(TrialCounts(), description="what `snakemake blind_trials` runs")
    reduced: TrialCounts = Field(
        TrialCounts(null=4, single=19, pair=2, triple=1, outside=4, wrong_noise=0, wrong_mass=0),
        description="the first of them, which the default target runs",
    )


class FigureSettings(Section):
    """Looks shared by all figures."""

    png_dpi: Annotated[int, Field(ge=50, le=600)] = 150


class Settings(Section):
    """The whole of config.yaml."""

    campaigns: Annotated[tuple[str, ...], Field(min_length=1)]
    raw_dir: str = "data/raw"
    results_dir: str = "results"
    kcub_reading: Literal["text_e7", "table_e8"] = Field(
        "text_e7",
        description="the exponent of the paper's cubic stiffness: its text or its Table I",
    )
    ingest: IngestSettings = IngestSettings()
    base_frame: BaseFrameSettings = BaseFrameSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    montecarlo: MonteCarloSettings = MonteCarloSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    discovery: DiscoverySettings = DiscoverySettings()
    blind_trials: BlindTrialsSettings = BlindTrialsSettings()
    coverage: CoverageSettings = CoverageSettings()
    curve: CurveStudySettings = CurveStudySettings()
    figures: FigureSettings = FigureSettings()
    dataset_sources: dict[str, str] = Field(
        default_factory=dict,
        description="folder or address a public data set is taken from, by its name; the others "
        "come from where they are published",
    )
    simulate: dict[str, SimulateSettings] = Field(
        default_factory=dict, description="campaigns the virtual cell can write, by name"
    )

    @field_validator("results_dir")
    @classmethod
    def _apart_from_raw(cls, results_dir: str, info: ValidationInfo) -> str:
        raw, results = Path(info.data.get("raw_dir", ".")).resolve(), Path(results_dir).resolve()
        if results == raw or raw in results.parents:
            raise ValueError("a folder outside raw_dir, which is only read")
        return results_dir


class PictureSettings(Section):
    """The settings that pictures read."""

    figures: FigureSettings = FigureSettings()
    kcub_reading: Literal["text_e7", "table_e8"] = "text_e7"
    montecarlo: MonteCarloSettings = MonteCarloSettings()
    evaluation: EvaluationSettings = EvaluationSettings()


class JudgingSettings(Section):
    """The settings by which a campaign is judged."""

    ingest: IngestSettings = IngestSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    discovery: DiscoverySettings = DiscoverySettings()


def parse_settings(raw: object, *, where: str) -> Settings:
    """Check a mapping against `Settings`.

    Args:
        raw: what YAML or the command line gave.
        where: the file or option it came from, for the message.

    Raises:
        SettingsError: naming the first offending key, its value and the nearest right name.
    """
    return parse_section(Settings, raw, where=where)


def parse_section(section: type[_S], raw: object, *, where: str) -> _S:
    """Check a mapping against one section; see `parse_settings`."""
    try:
        return section.model_validate(raw)
    except ValidationError as error:
        raise refusal(section, error, where) from None


def read_settings_argument(section: type[_S], argument: str, *, where: str = "--settings") -> _S:
    """Read a section from the command line: a JSON object, or the path of a YAML file.

    Args:
        section: what to read.
        argument: what was given.
        where: the option it was given with.

    Raises:
        SettingsError: when it is neither, or its content does not fit `section`.
    """
    inline = argument.lstrip().startswith("{")
    where = where if inline else argument
    try:
        text = argument if inline else Path(argument).read_text(encoding="utf-8")
        raw = json.loads(text) if inline else yaml.safe_load(text)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise SettingsError(
            "settings cannot be read",
            where=where,
            value=str(error),
            allowed="a JSON object or the path of a YAML file",
            remedy="check the path and its syntax",
        ) from None
    return parse_section(section, raw, where=where)
