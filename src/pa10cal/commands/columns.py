"""Command `columns`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm


def columns(file: Path, *, robot: str | None = None, name: str | None = None) -> None:
    """Propose how to read a tracker's or controller's export as it is: a campaign.yaml for it.

    Separator, decimal sign and columns are recognised by the header and the numbers; with --robot
    units and the convention of attitudes by the kinematics of the nominal arm too, and the file is
    read once so. Save what is printed as campaign.yaml beside the file, correct it, and use
    pa10cal run.

    Args:
        file: one row a configuration: joint positions, and what was measured.
        robot: name of the arm's description, shipped or beside the file.
        name: name of the campaign; without it, that of the folder.

    Examples:
        pa10cal columns examples/ur10-pose/tracker.txt --robot ur10
        pa10cal columns measured/export.csv --robot ur10 > measured/campaign.yaml
    """
    import sys

    import yaml

    from pa10cal.campaign.csv_rows import sniff
    from pa10cal.campaign.propose import follows_contract, label_of, propose
    from pa10cal.files.arms import load_arm

    arm = None if robot is None else load_arm(robot, file.parent)
    found = sniff(file)
    label = name or label_of(file.absolute().parent)
    proposal = propose(found, file.name, label, robot or "my_arm", arm)
    if follows_contract(found):
        del proposal.content["columns"]
    text = yaml.safe_dump(
        proposal.content, sort_keys=False, default_flow_style=None, width=90, allow_unicode=True
    )
    told = [] if arm is None else _tried(file, text, arm)
    print("\n".join((*told, *(f"# check {each}" for each in proposal.checks))))
    print(text, end="")
    if sys.stdout.isatty():
        print(f"\nSave this as {file.parent / 'campaign.yaml'}, correct it, and then:")
        print(f"  pa10cal run {file.parent}")


def _tried(file: Path, text: str, arm: Arm) -> list[str]:
    """Read a campaign as it is proposed, and return what its reader is to know of that."""
    from tempfile import TemporaryDirectory

    from pa10cal.campaign.description import DESCRIPTION_FILE
    from pa10cal.campaign.read import read_campaign
    from pa10cal.errors import Pa10calError
    from pa10cal.files.arm_text import arm_text

    with TemporaryDirectory() as folder:
        beside = Path(folder)
        (beside / DESCRIPTION_FILE).write_text(text, encoding="utf-8")
        (beside / f"{arm.name}.yaml").write_text(arm_text(arm), encoding="utf-8")
        (beside / file.name).symlink_to(file.absolute())
        try:
            found = read_campaign(beside)
        except Pa10calError as error:
            return [f"# check all of it: it is refused: {error}".replace(f"{folder}/", "")]
        rows = f"{len(found.observations)} rows can be used, {len(found.quarantined)} cannot"
        return [f"# read so: {rows}", *(f"# check: {warning}" for warning in found.warnings)]
