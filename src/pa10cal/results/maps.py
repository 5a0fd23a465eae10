"""Maps of joints in the results of discovery: form, bands, angles seen, what the ripple says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.results.arrays import Numbers, Shape
from pa10cal.results.record import Key, ParameterKey, Part, optional


class AnglesSeen(Part):
    """Values of a joint that the fit has seen."""

    turns: bool  # whether the joint turns; else it slides
    # intervals seen [rad; m of a sliding joint]
    stretches: Annotated[NDArray[np.float64], Shape("stretches", 2)]


class FallsBack(Part):
    """Where the effects found do not hold: there the extended model is the calibrated one."""

    # values of each joint in which the effects hold; no stretches: nowhere
    within: tuple[AnglesSeen, ...]
    why: str  # what held-out poses show, one sentence


class Fading(Part):
    """How the amplitudes of a map fade with their order."""

    size_rad: float  # standard deviation of an amplitude of low order [rad]
    half_order: float  # order at which amplitudes are half as large


class Band(Part):
    """How large the amplitudes of a map are in a band of orders, below it and above it."""

    slow_rad: float  # standard deviation of an amplitude of one or two cycles a turn [rad]
    below_rad: float  # standard deviation of an amplitude below the band [rad]
    level_rad: float  # standard deviation of an amplitude in the band [rad]
    first_order: float  # order at which the band begins
    last_order: float  # order at which the band ends
    decay: float  # power of the order by which amplitudes fall above the band
    floor_rad: float  # size that no amplitude is expected to fall below [rad]


class MapForm(Part):
    """Spacing and smoothness of a map that has its own."""

    knots: int  # knots a turn
    fading: Fading | None = optional()  # how its amplitudes fade with their order, where they do
    band: Band | None = optional()  # the band that its amplitudes have, where they do not fade


class BandOfMap(Part):
    """How well the band of one map is known; its numbers stand with the effect, as `form.band`."""

    of: str  # joint of the map
    # standard uncertainty of the logarithm of each number of the band
    log_std: Mapping[ParameterKey, float]


class LeftOut(Part):
    """Weighed squared error of poses left out, before maps had a band and with it."""

    before: float  # with sizes that fade with the order
    after: float  # with the band


class Bands(Part):
    """Bands found by marginal likelihood."""

    shared: bool  # whether all maps have one band
    scatter: float  # scatter of the weighed rows that goes with them
    maps: tuple[BandOfMap, ...]  # map by map
    of_time: LeftOut  # stretches of time left out
    of_angles: LeftOut  # stretches of angles of one joint left out


class PoseScatter(Part):
    """What single poses scatter by about the extended model."""

    # standard deviation of each joint's position [rad, m]: where it comes to stand
    joints: tuple[float, ...]
    # standard deviation of each kind of component [m, rad]
    kinds: Mapping[Annotated[str, Key("kind")], float]
    # part of the coordinates of positions fitted that lie in their 95 % intervals, by this scatter
    # and the uncertainty of the model
    inside95_train: float
    inside95_holdout: float | None  # the same of held-out poses; null where there are none


#: Correlation of campaigns or turns from which they agree, and how many arcs it takes.
LEAST_CORRELATION = 0.8
LEAST_ARCS = 15


class Agreement(Part):
    """How well campaigns, or turns of the joint, agree on its error where two of them were."""

    # of their means in arcs of 3 deg, noise taken off; less where the errors differ in size alone
    correlation: float
    slope: float  # of the later by the earlier
    arcs: int  # pairs of means compared

    @property
    def holds(self) -> bool:
        """Whether the error is the joint's own, and not that of a campaign or of a turn."""
        return self.arcs >= LEAST_ARCS and self.correlation >= LEAST_CORRELATION


# A sensor's error and a gear's turn the joint by the same function of its angle: poses alone cannot
# tell them apart. The residual of the joint has lines a cos(N n p) + b sin(N n p) in p = q +
# alpha e(q) + beta tau, with e the joint's error (true less commanded angle).

Cause = Literal["sensor", "gear"]

#: Share of the error that the motor must surely follow, or surely not, for a cause to be named: an
#: interval that ends here still holds "all of it" or "nothing of it", within the error of the map.
_NEARLY_ALL, _HARDLY_ANY = 0.7, 0.3
#: Share that the motor must not surely exceed: neither cause has it follow more than all.
_MORE_THAN_ALL = 1.3
#: Log-likelihood by which the motor's ripple must prefer one cause over the other, in nats.
LEAST_NATS = 4.0


class MotorRipple(Part):
    """Lines of the residual at multiples of the gear ratio: who errs, the sensor or the gear."""

    ratio: float  # motor turns a joint turn
    orders: tuple[int, ...]  # multiples of the ratio at which there are lines
    # share of the error that the motor followed: 0 where the gear errs, 1 where the sensor does
    alpha: float
    interval95: tuple[float, float]  # its 95 % interval, by profile likelihood
    gain_nats: float  # log-likelihood over alpha = 0
    gain_over_one_nats: float  # log-likelihood over alpha = 1
    # turn of the motor a torque [rad/(N m)]; null where torques do not vary
    beta_rad_Nm: float | None
    alphas: Numbers  # shares tried
    profile_nats: Numbers  # log-likelihood of each, less that of the best

    @property
    def excludes_gear(self) -> bool:
        """Whether the motor surely followed the error."""
        return self.interval95[0] > 0.0 and self.gain_nats > LEAST_NATS

    @property
    def excludes_sensor(self) -> bool:
        """Whether the motor surely did not follow the whole error."""
        return self.interval95[1] < 1.0 and self.gain_over_one_nats > LEAST_NATS

    @property
    def likely(self) -> Cause | None:
        """Return whose error most of it is; None where the ripple does not decide.

        Where the motor followed a part of the error, both err, and the ripple has decided that.
        """
        if self.excludes_gear and self.excludes_sensor:
            return "sensor" if self.alpha > 0.5 else "gear"
        return self.cause

    @property
    def cause(self) -> Cause | None:
        """Return whose error it is; None where the ripple does not decide, or where both err.

        Nor does one that would have the motor follow far more than the error.
        """
        low, high = self.interval95
        if low > _MORE_THAN_ALL and self.gain_over_one_nats > LEAST_NATS:
            return None
        if self.excludes_gear and not self.excludes_sensor and high > _NEARLY_ALL:
            return "sensor"
        if self.excludes_sensor and not self.excludes_gear and low < _HARDLY_ANY:
            return "gear"
        return None


class JointWitness(Part):
    """What says whose error a joint's error by its angle is."""

    ripple: MotorRipple | None  # of its motor; null where it shows none
    # of campaigns or turns; null where no two arcs were seen in two of them, or noise hides the
    # error there
    agreement: Agreement | None

    @property
    def cause(self) -> Cause | None:
        """Return whose error it is; None where it cannot be said."""
        if self.ripple is None or self.agreement is None or not self.agreement.holds:
            return None
        return self.ripple.cause
