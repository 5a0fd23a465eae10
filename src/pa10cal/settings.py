"""Every setting of the pipeline: sections of its packages, composed as in config.yaml."""

from __future__ import annotations

from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from pa10cal import command_settings
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.command_settings import EvaluationOptions, FigureOptions
from pa10cal.errors import NAME_RULE, fits_a_folder
from pa10cal.options import (
    BaseFrameOptions,
    DiscoveryOptions,
    IngestOptions,
    MonteCarloOptions,
    Section,
)
from pa10cal.settings_reading import parse_section

# Sections of the packages beside this one, which import it: they are found by name.
_LAB = import_module("pa10cal_lab.options")
if TYPE_CHECKING:
    BlindTrialsOptions: TypeAlias = Any
    CoverageOptions: TypeAlias = Any
    CurveStudyOptions: TypeAlias = Any
    SimulateOptions: TypeAlias = Any
else:
    BlindTrialsOptions, CoverageOptions = _LAB.BlindTrialsOptions, _LAB.CoverageOptions
    CurveStudyOptions = import_module("pa10cal_curve.options").CurveStudyOptions
    SimulateOptions = import_module("pa10cal_lab.cell.options").SimulateOptions

#: Folders of `results_dir` that are no campaign's.
RESERVED = (
    "curve",
    "datasets",
    "fleet",
    "measured",
    "simulated",
    *_LAB.TRIAL_STUDIES,
    *_LAB.OUTSIDE_STUDIES,
)


def _campaign_name(name: str) -> str:
    """Refuse a name that is not fit for a folder of results."""
    if not fits_a_folder(name) or name in RESERVED:
        raise ValueError(f"{NAME_RULE}, and none of {', '.join(RESERVED)}")
    return name


CampaignName = Annotated[str, AfterValidator(_campaign_name)]


class Settings(Section):
    """The whole of config.yaml."""

    campaigns: Annotated[tuple[CampaignName, ...], Field(min_length=1)] = Field(
        description="folders of raw_dir; Snakemake also takes a table (.csv) or a pattern: '*'",
        json_schema_extra={"type": ["array", "string"]},
    )
    groups: dict[CampaignName, tuple[CampaignName, ...]] = Field(
        default_factory=dict,
        description="one robot in several campaigns of raw_dir, e.g. {ur10: [ur10-a, ur10-c]}",
    )
    raw_dir: str = Field("data/raw", description="campaigns, only read")
    results_dir: str = Field("results", description="one folder a campaign is written here")
    kcub_reading: command_settings.KcubReading = "text_e7"
    ingest: command_settings.Ingest = IngestOptions()
    base_frame: command_settings.BaseFrame = BaseFrameOptions()
    calibration: command_settings.Calibration = CalibrationOptions()
    montecarlo: command_settings.MonteCarlo = MonteCarloOptions()
    evaluation: command_settings.Evaluation = EvaluationOptions()
    discovery: command_settings.Discovery = DiscoveryOptions()
    blind_trials: BlindTrialsOptions = Field(
        BlindTrialsOptions(),
        description="campaigns of the virtual cell judged without their truth, and scored apart",
    )
    coverage: CoverageOptions = Field(
        CoverageOptions(),
        description="do 95 % intervals contain the truth of simulated campaigns in 95 % of cases?",
    )
    curve: CurveStudyOptions = Field(
        CurveStudyOptions(),
        description="calibration of a chain of links on two-axis joints, posed along curves, in "
        "the virtual cell",
    )
    figures: command_settings.Figures = FigureOptions()
    dataset_sources: dict[str, str] = Field(
        default_factory=dict,
        description="folder or address of a public data set by name, e.g. {ipa-robot-accuracy: "
        "../data}",
    )
    measured_dir: str = Field(
        "data/measured",
        description="campaigns and fetched data sets that `snakemake measured` runs",
    )
    simulate: dict[CampaignName, SimulateOptions] = Field(
        default_factory=dict,
        description="campaigns that `snakemake --cores 1 simulate` writes with the virtual cell",
    )

    @field_validator("groups")
    @classmethod
    def _campaigns_and_names_apart(
        cls, groups: dict[str, tuple[str, ...]], info: ValidationInfo
    ) -> dict[str, tuple[str, ...]]:
        for name, members in groups.items():
            if name in (*info.data.get("campaigns", ()), *chain.from_iterable(groups.values())):
                raise ValueError(f"group {name} is called like a campaign")
            if len(members) < 2 or len(set(members)) < len(members):
                raise ValueError(f"group {name} has not two or more campaigns, each once")
        return groups

    @field_validator("results_dir")
    @classmethod
    def _apart_from_raw(cls, results_dir: str, info: ValidationInfo) -> str:
        raw, results = Path(info.data.get("raw_dir", ".")).resolve(), Path(results_dir).resolve()
        if results == raw or raw in results.parents:
            raise ValueError("a folder outside raw_dir, which is only read")
        return results_dir


def parse_settings(raw: object, *, where: str) -> Settings:
    """Check a mapping against `Settings`; see `parse_section`."""
    return parse_section(Settings, raw, where=where)
