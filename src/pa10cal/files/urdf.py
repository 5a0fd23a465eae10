"""URDF files to import arms from."""

from __future__ import annotations

from pathlib import Path

from pa10cal.arm.imported import ImportedArm, arm_from_urdf_text
from pa10cal.errors import ArmError


def arm_from_urdf(
    path: Path, base: str | None = None, tip: str | None = None, name: str | None = None
) -> ImportedArm:
    """Import an arm from a URDF.

    Args:
        path: the file.
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        name: of the arm; the file's where None.

    Raises:
        ArmError: when the file cannot be read or used.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ArmError(
            "the URDF cannot be read",
            where=str(path),
            value=getattr(error, "strerror", None) or str(error),
            allowed="a URDF file, UTF-8",
            remedy="check the path",
        ) from None
    return arm_from_urdf_text(text, name or path.stem, base=base, tip=tip, where=str(path))
