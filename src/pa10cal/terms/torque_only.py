"""What terms share that show in torques and move the arm by way of the springs alone."""

from __future__ import annotations

from abc import abstractmethod

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array


class TorqueOnly:
    """A term that adds to no coordinate of the chain, and to torques in proportion to x."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return none: it moves the arm by way of the springs alone."""
        return ()

    @abstractmethod
    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return what the log shows beyond the weights, or what calculated torques lack, (P, n)."""
        torque: Array = self.torque_derivative(states, x) @ x
        return torque
