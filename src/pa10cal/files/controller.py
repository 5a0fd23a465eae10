"""The model with which a robot's controller computes, by what campaign.yaml states of it.

A controller with a maker's accuracy option, and every one of Universal Robots, computes with an arm
that the maker measured. The joint positions that it logs are those of its encoders, and are used as
any. A Cartesian target is converted by the maker's model, and must be relative to that model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pa10cal.arm.chain import refuse_another_robot
from pa10cal.arm.description import Arm, Controller
from pa10cal.files.arms import load_arm, maker_calibration
from pa10cal.options import Section


def _switch(value: Any) -> Any:
    """Return `on` or `off`, which YAML reads as true and false without quotes."""
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


class StatedController(Section):
    """What a robot's controller does by itself."""

    compensation: Annotated[Literal["on", "off"], BeforeValidator(_switch)] = Field(
        description="whether it corrects an arm that its maker measured"
    )
    model: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        default=None, description="the arm that it computes with, by the name of its description"
    )


def controller_of(
    stated: StatedController | None,
    arm: Arm,
    folder: Path,
    arms: Path | None = None,
    *,
    where: str,
) -> Controller | None:
    """Return the controller with the model that it computes with; None where nothing is stated.

    The model is the one stated. Without one it is, while the controller compensates, the arm's own
    rows if they are its maker's calibration, and while it does not, the arm as designed.

    Args:
        stated: what the campaign states.
        arm: the arm of the campaign, as described.
        folder, arms: where descriptions are looked for, see `load_arm`.
        where: the campaign's file, for messages.

    Raises:
        ArmError: when there is no such model, or it is another robot.
    """
    if stated is None:
        return None
    on, other = stated.compensation == "on", None
    calibrated = maker_calibration(arm.name, folder, arms)
    known = calibrated is not None or not on
    if stated.model is not None:
        known = True
        other = None if stated.model == arm.name else load_arm(stated.model, folder, arms)
    elif not on and calibrated is not None:
        other = calibrated.designed
        known = other is not None
    if other is not None:
        refuse_another_robot(arm, other, where)
    return Controller(on, known, other)


def controller_notes(controller: Controller | None, arm: Arm) -> tuple[str, ...]:
    """Return notes for a reader on a controller that compensates; none if it does not."""
    if controller is None or not controller.compensation:
        return ()
    computes = "the controller corrects an arm that its maker measured"
    if not controller.known:
        return (
            f"{computes}, and controller.model does not name it: corrected Cartesian targets "
            "cannot be computed, joint positions can",
        )
    if controller.arm is None:
        return ()
    return (
        f"{computes} ({controller.arm.name}): Cartesian targets are relative to that one; what "
        f"{arm.name} as designed misses (uncalibrated) is not what the robot misses",
    )


def controller_warnings(controller: Controller | None, *, commanded: bool) -> tuple[str, ...]:
    """Return a warning where joint positions are commanded and the controller corrects them."""
    if controller is None or not controller.compensation or not commanded:
        return ()
    return (
        "joint positions are commanded ones, and the controller compensates: of Cartesian moves "
        "they are those before its correction, and the joints were elsewhere; log what the "
        "encoders read, or move by joint positions alone",
    )
