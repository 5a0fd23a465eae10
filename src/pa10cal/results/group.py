"""What the campaigns of a group say of each other, in the results of a group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.record import FlagColumn, Key, Numbers, Part, optional


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


class ParameterAlone(Part):
    """A parameter of an effect, as one campaign alone has it."""

    value: float = Field(description="its value")
    std: float = Field(description="its standard uncertainty")


class JointErrorAlone(Part):
    """The error of a joint by its angle, as one campaign alone has it."""

    error_mrad: Numbers = Field(description="at 0, 1, 2, … deg of the turn [mrad]")
    visited: FlagColumn = Field(description="whether the campaign has poses there")


class CampaignsAgree(Part):
    """How well two campaigns agree on the error of a joint, over the angles both visited."""

    first: str = Field(description="one campaign")
    second: str = Field(description="the other")
    correlation: float | None = Field(description="of the two errors; null: too few angles")
    correlation95: tuple[float, float] | None = Field(description="its interval of 95 %")
    slope: float | None = Field(description="of the second by the first, both uncertain alike")
    slope95: tuple[float, float] | None = Field(description="its interval of 95 %")
    first_rms_mrad: float | None = Field(description="rms of the first, less its mean [mrad]")
    second_rms_mrad: float | None = Field(description="rms of the second, less its mean [mrad]")
    difference_rms_mrad: float | None = Field(description="rms of what they differ by [mrad]")
    share_of_turn: float = Field(description="part of the turn that both visited")


class EffectByCampaign(Part):
    """An effect that all campaigns of a group share, fitted to each of them alone."""

    id: str = Field(description="id of the effect")
    of: str = Field(description="where it sits")
    parameters: (
        Mapping[
            Annotated[str, Key("campaign")],
            Mapping[Annotated[str, Key("parameter")], ParameterAlone],
        ]
        | None
    ) = optional("its parameters; of an error by a joint's angle see `errors`")
    errors: Mapping[Annotated[str, Key("campaign")], JointErrorAlone] | None = optional(
        "of an error by a joint's angle"
    )
    agreement: tuple[CampaignsAgree, ...] = Field(
        description="how well every two campaigns agree on an error by a joint's angle"
    )
