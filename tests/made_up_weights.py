"""Torques of weights by virtual work, and how joint 2 of a UR10 sags under them on a spring."""

import numpy as np

from made_up_poses import at_joint
from made_up_survey import ARM
from pa10cal.arm.chain import Chain, frames

K_NM_RAD, G_M_S2 = 2e4, 9.80665  # the spring of joint 2


def potential_J(q_rad, masses):
    """Return the energy (P,) of masses [(kg, link from 0, place in its frame)]; last the end."""
    chain = Chain.of(ARM)
    there = frames(chain, chain.coordinates(q_rad))
    at = [*there.T_base_rows, there.T_base_ee]
    return sum(
        kg * G_M_S2 * (at[link][:, 2, :3] @ place_m + at[link][:, 2, 3])
        for kg, link, place_m in masses
    )


def holding_Nm(q_rad, masses):
    """Return the torque (P,) of joint 2 that holds masses, by virtual work."""
    step = np.zeros(ARM.n)
    step[1] = 1e-5
    return (potential_J(q_rad + step, masses) - potential_J(q_rad - step, masses)) / 2e-5


#: The arm as described, and the tool of the cell.
LINKS = [(float(kg), k, ARM.com_m[k]) for k, kg in enumerate(ARM.mass_kg)]
LINKS += [(1.0, ARM.n, np.array([0.0, 0.0, 0.06]))]


def sagging(masses=(), off_rad=lambda q_rad: 0.0):
    """Return what turns the joints (P, 6), of how they came to stand: joint 2 sags.

    Args:
        masses: what the description lacks; see `potential_J`.
        off_rad: by which joint 2 is off besides, of its angle.
    """

    def turn(motion):
        off = off_rad(motion.q_rad[:, 1]) + np.zeros(len(motion.q_rad))
        sag_rad = np.zeros(len(off))
        for _ in range(4):  # to the equilibrium in the posture that it sags to
            q_rad = motion.q_rad + at_joint(2, off - sag_rad)
            sag_rad = holding_Nm(q_rad, [*LINKS, *masses]) / K_NM_RAD
        return at_joint(2, off - sag_rad)

    return turn
