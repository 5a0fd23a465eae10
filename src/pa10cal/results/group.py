"""What the campaigns of a group say of each other, in the results of a group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.record import Key, Part


class Difference(Part):
    """The one parameter that, if it alone differed between campaigns, explains most."""

    name: str = Field(description="the parameter")
    unit: str = Field(description="its unit")
    value: float = Field(description="this campaign less the others")
    std: float = Field(description="standard uncertainty of that")
    chi_square: float = Field(description="how much of the chi-square it explains")


class CampaignAlone(Part):
    """One campaign of a group, held against the others."""

    poses: int = Field(description="poses fitted")
    rms_mm: float = Field(description="remaining error of its poses in the fit of the group [mm]")
    alone_rms_mm: float = Field(description="the same with parameters of its own [mm]")
    chi_square: float = Field(description="of its shared parameters against those of the others")
    dof: float = Field(description="directions of shared parameters that both determine")
    p_value: float = Field(description="probability of that where nothing differs")
    contradicts: bool = Field(description="whether the arm was changed against the others")
    worst: Difference = Field(description="the parameter that explains most of the difference")


class SharedParameter(Part):
    """Where a parameter that all campaigns of a group share comes from."""

    unit: str = Field(description="its unit")
    std: float = Field(description="standard uncertainty by all campaigns together")
    std_alone: Mapping[Annotated[str, Key("campaign")], float] = Field(
        description="standard uncertainty by each campaign alone"
    )
    determined_by: tuple[str, ...] = Field(description="campaigns that determine it alone")


class GroupOfCampaigns(Part):
    """What the campaigns of a group say alone, linear about the fit of all."""

    campaigns: Mapping[Annotated[str, Key("campaign")], CampaignAlone] = Field(
        description="each campaign, held against the others"
    )
    parameters: Mapping[Annotated[str, Key("parameter")], SharedParameter] = Field(
        description="shared parameters, in the form in which they were solved"
    )
