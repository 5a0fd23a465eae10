"""Measured poses, whatever the instrument: the one form in which all that follows takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypeVar

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.observe.base_targets import BaseTargets
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Rows

M = TypeVar("M", bound=Instrument)
M_co = TypeVar("M_co", bound=Instrument, default=Instrument, covariant=True)

#: Kinds of poses: straight moves along the base's axes, poses to fit, and poses held out.
KINDS = ("line_x", "line_y", "grid", "holdout")


@dataclass(frozen=True)
class JointLog:
    """How the joints of P configurations were read."""

    q_u: Array  # (P, n) standard uncertainty of the mean position [rad, m], nan where unknown
    tau_u: Array  # (P, n) standard uncertainty of the mean torque [N m, N], nan where unknown
    samples: NDArray[np.int64]  # (P,) samples averaged; 0 where there is no log

    def take(self, rows: Rows) -> JointLog:
        """Return some of the configurations."""
        return JointLog(self.q_u[rows], self.tau_u[rows], self.samples[rows])


@dataclass(frozen=True)
class Observations(Generic[M_co]):
    """P measured poses; `Observations[Pose]` where position and attitude were measured."""

    pose: NDArray[np.str_]  # (P,) labels; the same label is the same command
    states: PoseStates  # state of the arm in each pose
    measured: M_co  # what the instrument measured in each
    kind: NDArray[np.str_]  # (P,) one of `KINDS`
    repeat: NDArray[np.int64]  # (P,) number of the repeat; of averages that of the first reading
    readings: NDArray[np.int64]  # (P,) readings averaged into each row
    # how the joints were read; None where that is not known, as of averages
    log: JointLog | None = None
    # targets on the base as they were read, and their motion, which `measured` is without; None
    # where there are none, and of averages
    base: BaseTargets | None = None

    @staticmethod
    def single(
        pose: NDArray[np.str_], states: PoseStates, measured: M, kind: str = "grid"
    ) -> Observations[M]:
        """Return single readings, all of one kind."""
        ones = np.ones(len(pose), dtype=np.int64)
        return Observations(pose, states, measured, np.full(len(pose), kind), ones, ones)

    def __len__(self) -> int:
        return len(self.pose)

    def take(self, rows: Rows) -> Observations[M_co]:
        """Return some of the poses."""
        return Observations(
            self.pose[rows],
            self.states.take(rows),
            self.measured.take(rows),
            self.kind[rows],
            self.repeat[rows],
            self.readings[rows],
            None if self.log is None else self.log.take(rows),
            None if self.base is None else self.base.take(rows),
        )

    def by_campaign(self) -> dict[str, Observations]:
        """Return the poses of every campaign of a group by its name, each as if it were alone."""
        campaign = self.states.campaign
        if campaign is None:
            return {}
        found = {}
        for number, (name, part) in enumerate(self.measured.campaigns):
            rows = campaign == number
            states = replace(self.states.take(rows), campaign=None)
            log = None if self.log is None else self.log.take(rows)
            rest = (self.kind[rows], self.repeat[rows], self.readings[rows], log)
            found[name] = Observations(self.pose[rows], states, part, *rest)
        return found

    def of_kind(self, kind: str) -> Observations[M_co]:
        """Return the poses of one kind, ordered by pose, load and time."""
        rows = np.flatnonzero(self.kind == kind)
        states = self.states
        order = np.lexsort((states.time_s[rows], states.load_N[rows], self.pose[rows]))
        return self.take(rows[order])

    def turned(self, R_ee_target: Array) -> Observations[M_co]:
        """Return the observations with attitudes of the end-effector in place of the target's."""
        return replace(self, measured=self.measured.turned(R_ee_target))

    def with_states(self, states: PoseStates) -> Observations[M_co]:
        """Return the same measurements with other states of the arm."""
        return replace(self, states=states)

    def with_measured(self, **changes: Any) -> Observations[M_co]:
        """Return the same poses with some fields of what was measured replaced."""
        return replace(self, measured=replace(self.measured, **changes))
