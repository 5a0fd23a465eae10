"""The mechanism of one individual arm of any kind, in many poses at once.

Every joint moves about or along the z axis of a frame of its own, which sits anywhere on the link
before it: a placement is any rigid motion, so that axes may be off in all directions. Poses are
products of placements and joint motions, torques a recursion of wrenches from the tool inward;
neither knows of Denavit-Hartenberg parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.built import Departures, Springs
from pa10cal.cell.equilibrium import MAX_ITERATIONS, TOLERANCE, refuse_unrest
from pa10cal.cell.mechanism import GRAVITY_M_S2, row_parts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Payload:
    """What an arm carries; places in the end-effector frame.

    Attributes:
        mass_kg: mass of the tool.
        com_m: (3,) its centre of mass.
        load_point_m: (3,) where an external load hangs.
    """

    mass_kg: float
    com_m: Array
    load_point_m: Array


@dataclass(frozen=True)
class Rest:
    """P configurations of an arm at rest.

    Attributes:
        q: (P, n) positions of the links [rad, or m of a sliding joint].
        tau_Nm: (P, n) torques that the motors exert (forces [N] of sliding joints).
        T_base_ee: (P, 4, 4) end-effector in the base [m].
    """

    q: Array
    tau_Nm: Array
    T_base_ee: Array


@dataclass(frozen=True)
class Linkage:
    """Joints, links and springs of one individual arm.

    Attributes:
        placements: (n, 4, 4) frame of each joint at position 0, in the frame that the joint before
            it carries along (the base, for the first) [m].
        T_last_ee: (4, 4) end-effector in the frame that the last joint carries along [m].
        slides: (n,) whether the joint slides along its z axis.
        mass_kg: (n,) masses of the links.
        com_m: (n, 3) their centres of mass in the frame that their joint carries along.
        payload: what the arm carries.
        springs: what yields between motors and links.
    """

    placements: Array
    T_last_ee: Array
    slides: NDArray[np.bool_]
    mass_kg: Array
    com_m: Array
    payload: Payload
    springs: Springs

    @classmethod
    def of(cls, arm: Arm, departures: Departures, payload: Payload, springs: Springs) -> Linkage:
        """Lay out the rows of an arm, its links without weight where their masses are not known."""
        parts = (
            np.array([part.homogeneous for part in half]) for half in row_parts(arm, departures)
        )
        before, after = parts
        placements = before.copy()
        placements[0] = arm.T_base_row1 @ before[0]
        placements[1:] = after[:-1] @ before[1:]
        com_m = np.zeros((arm.n, 3)) if arm.com_m is None else arm.com_m
        return cls(
            placements=placements,
            T_last_ee=after[-1] @ arm.T_row_n_ee,
            slides=arm.prismatic,
            mass_kg=np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg,
            com_m=np.einsum("kij,kj->ki", after[:, :3, :3], com_m) + after[:, :3, 3],
            payload=payload,
            springs=springs,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.placements)

    def rest(self, q_motor: Array, load_N: Array) -> Rest:
        """Find where the links come to rest, their springs under the torque of that posture.

        Args:
            q_motor: (P, n) positions of the motors [rad, or m of a sliding joint].
            load_N: (P,) weights that hang at the load point.

        Raises:
            SimulationError: where no equilibrium is found.
        """
        q, delta = q_motor, np.zeros_like(q_motor)
        for _ in range(MAX_ITERATIONS):
            steps = self._steps(q)
            R_base_links = self._attitudes(steps)
            tau = self._torques(steps, R_base_links, load_N)
            delta = self.springs.step(delta, tau)
            q_next = q_motor - delta
            moved = float(np.abs(q_next - q).max(initial=0.0))
            q = q_next
            if moved <= TOLERANCE:
                return Rest(q, tau, self.T_base_ee(q))
        raise refuse_unrest(moved)

    def T_base_ee(self, q: Array) -> Array:
        """Return the end-effector in the base, (P, 4, 4) [m], with the links at `q` (P, n)."""
        T = np.eye(4)
        for step in self._steps(q):
            T = T @ step
        return T @ self.T_last_ee

    def torques_Nm(self, q: Array, load_N: Array) -> Array:
        """Return the (P, n) torques [N m; N] that hold the links at `q` (P, n) under gravity."""
        steps = self._steps(q)
        return self._torques(steps, self._attitudes(steps), load_N)

    def _steps(self, q: Array) -> Array:
        """Return (n, P, 4, 4): what each joint carries along, seen from the joint before it."""
        steps = np.repeat(self.placements[:, None], len(q), axis=1)
        cos, sin = np.cos(q.T)[..., None], np.sin(q.T)[..., None]
        x, y, z = (self.placements[:, None, :3, axis] for axis in range(3))
        turns = ~self.slides
        steps[turns, :, :3, 0] = (cos * x + sin * y)[turns]
        steps[turns, :, :3, 1] = (cos * y - sin * x)[turns]
        steps[self.slides, :, :3, 3] += (q.T[..., None] * z)[self.slides]
        return steps

    def _attitudes(self, steps: Array) -> Array:
        """Return (n, P, 3, 3): attitude in the base of what each joint carries along."""
        attitudes = steps[..., :3, :3].copy()
        for joint in range(1, self.n):
            attitudes[joint] = attitudes[joint - 1] @ attitudes[joint]
        return attitudes

    def _torques(self, steps: Array, R_base_links: Array, load_N: Array) -> Array:
        """Carry force and moment that hold the arm up from the tool to the base."""
        down = GRAVITY_M_S2 @ R_base_links  # gravity along the axes of every link, (n, P, 3)
        tau = np.empty((len(load_N), self.n))
        force, moment = self._hold_up_the_tool(down[-1], load_N)
        for joint in reversed(range(self.n)):
            weight = self.mass_kg[joint] * down[joint]
            force = force - weight
            moment = moment - np.cross(self.com_m[joint], weight)
            tau[:, joint] = (force if self.slides[joint] else moment)[:, 2]
            R, p = steps[joint, :, :3, :3], steps[joint, :, :3, 3]
            force, moment = (np.einsum("pij,pj->pi", R, held) for held in (force, moment))
            moment = moment + np.cross(p, force)
        return tau

    def _hold_up_the_tool(self, down: Array, load_N: Array) -> tuple[Array, Array]:
        """Return force and moment (P, 3) on tool and load, about and along the last link's axes."""
        R, p = self.T_last_ee[:3, :3], self.T_last_ee[:3, 3]
        tool = self.payload.mass_kg * down
        load = (load_N / np.linalg.norm(GRAVITY_M_S2))[:, None] * down
        moment = np.cross(R @ self.payload.com_m + p, tool)
        moment += np.cross(R @ self.payload.load_point_m + p, load)
        return -(tool + load), -moment
