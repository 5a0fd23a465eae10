"""Options of ingest."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pa10cal.settings_section import Positive, Section


class IngestOptions(Section):
    """Raw logs to a table of poses."""

    stray_touch_sigma: Positive = Field(
        6.0,
        description="a touch further off its sphere than this many instrument sigmas is an outlier",
    )
    still_speed_deg_s: Positive = Field(
        0.02, description="a joint slower than this is at rest [deg/s]"
    )
    max_quarantined_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.2, description="a larger share of quarantined rows is refused"
    )
