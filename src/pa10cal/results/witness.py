"""What the motor's ripple says of a joint's error, in the records of discovery."""

from __future__ import annotations

from pydantic import Field

from pa10cal.results.record import Numbers, Part


class Agreement(Part):
    """How well campaigns, or turns of the joint, agree on its error where two of them were."""

    correlation: float = Field(description="of their means in arcs of 3 deg, noise taken off")
    slope: float = Field(description="of one by the other")
    arcs: int = Field(description="pairs of means compared")


class MotorRipple(Part):
    """Lines of the residual at multiples of the gear ratio: who errs, the sensor or the gear."""

    ratio: float = Field(description="motor turns a joint turn")
    orders: tuple[int, ...] = Field(description="multiples of the ratio at which there are lines")
    alpha: float = Field(
        description="share of the error that the motor followed: 0 where the gear errs, 1 where "
        "the sensor does"
    )
    interval95: tuple[float, float] = Field(description="its 95 % interval, by profile likelihood")
    gain_nats: float = Field(description="log-likelihood over alpha = 0")
    gain_over_one_nats: float = Field(description="log-likelihood over alpha = 1")
    beta_rad_Nm: float | None = Field(
        description="turn of the motor a torque [rad/(N m)]; null where torques do not vary"
    )
    alphas: Numbers = Field(description="shares tried")
    profile_nats: Numbers = Field(description="log-likelihood of each, less that of the best")


class JointWitness(Part):
    """What says whose error a joint's error by its angle is."""

    ripple: MotorRipple | None = Field(description="of its motor; null where it shows none")
    agreement: Agreement | None = Field(
        description="of campaigns or turns; null where no angle was seen in two of them"
    )
