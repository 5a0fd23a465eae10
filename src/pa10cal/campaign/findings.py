"""What is probably wrong in the input: one finding, wherever it was found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InputFinding:
    """Something in the input that is probably wrong."""

    what: str  # what it is, one clause
    where: str  # column, joint, parameter, pose or file
    remedy: str  # what to do about it
    # root mean square position error that would remain if it were put right; None where that was
    # not tried
    would_leave_mm: float | None = None
    kind: str = "input"  # a word of the table in `docs/raw-data.md`, such as `joint_sign`

    def __str__(self) -> str:
        left = self.would_leave_mm
        then = "" if left is None else f" ({left:.3g} mm rms would remain)"
        return f"{self.where}: {self.what}; {self.remedy}{then}"
