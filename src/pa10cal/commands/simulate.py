"""Command `simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pa10cal.cell.options import SimulateOptions


def simulate(
    *,
    name: str,
    out: Path,
    truth: Path,
    kcub_reading: Literal["text_e7", "table_e8"] = "text_e7",
    settings: SimulateOptions = SimulateOptions(),
) -> None:
    """Write a campaign with the virtual cell.

    Args:
        name: name of the campaign.
        out: folder of the campaign.
        truth: file for what is hidden in it.
        kcub_reading: exponent of the paper's cubic stiffness.
        settings: an entry of section simulate.

    Examples:
        pa10cal simulate --name mine --out data/raw/mine --truth truth.json
        pa10cal simulate --name mine --out data/raw/mine --truth truth.json --settings \\
          '{"robot": "ur10", "without_touches": {}}'
    """
    from pa10cal.cell.campaign import simulate_campaign
    from pa10cal.cell.write import write_campaign
    from pa10cal.files.arms import load_arm, read_arm

    described = settings.robot.endswith(".yaml")
    arm = read_arm(Path(settings.robot)) if described else load_arm(settings.robot)
    write_campaign(simulate_campaign(name, arm, settings, kcub_reading), out, truth)
    print(f"{name}: {arm.title} in {out}, what is hidden in {truth}")
