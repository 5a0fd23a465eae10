"""Records of studies of simulated campaigns: how often intervals hold the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import JsonValue

from pa10cal.results import record


class ParameterCoverage(record.Part):
    """How often the interval of one parameter holds the truth."""

    inside: float  # share inside the 95 % interval
    rms: float  # root mean square of error over standard uncertainty


class Coverage(ParameterCoverage):
    """How often intervals hold the truth."""

    inside_interval95: tuple[float, float]  # 95 % interval of the share


class PaperCoverage(Coverage):
    """The paper's robot under touched balls, calibrated with the paper's model."""

    campaigns: int  # campaigns simulated
    parameters: Mapping[record.ParameterKey, ParameterCoverage]  # by parameter


class ClassCoverage(Coverage):
    """Coverage of the parameters of one arm under one instrument."""

    # by class of parameters: `angles`, `lengths`, `base`, `tool`, ...
    by_class: Mapping[Annotated[str, record.Key("class")], Coverage]
    by_parameter: Mapping[record.ParameterKey, ParameterCoverage]  # by parameter


class FreeDeparture(record.Part):
    """Arms that depart in any way, which have no true parameters."""

    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    predictions: Coverage  # of predicted positions


class CoverageCase(record.Part):
    """One arm under one instrument."""

    case: str  # the case in words
    robot: str  # name of the arm
    instrument: str  # kind of the instrument
    targets: int  # number of targets
    flexible_joints: tuple[int, ...]  # joints with a spring, from 1
    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    unknowns: int  # parameters fitted
    # parameters not fitted, and those that replace them
    redundant: Mapping[record.ParameterKey, Mapping[record.ParameterKey, float]]
    parameters: ClassCoverage  # of parameters
    predictions: Coverage  # of predicted positions
    departing_in_any_way: FreeDeparture  # arms that depart in any way


@record.filed("pa10cal-coverage/2", "coverage.json", by="coverage")
class CoverageRecord(record.Record):
    """`coverage.json`: how often intervals hold the truth of simulated campaigns."""

    provenance: str  # where the data come from
    settings: Mapping[Annotated[str, record.Key("option")], JsonValue]  # settings of the study
    paper: PaperCoverage  # the paper's model
    cases: tuple[CoverageCase, ...]  # the general model, one entry an arm and instrument
