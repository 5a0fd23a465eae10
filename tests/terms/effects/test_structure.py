from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain, long_links
from pa10cal.terms.model import Model


def rows(arm, q_rad):
    """Frames of the rows, standard Denavit-Hartenberg, written out: T_base_0 … T_base_n."""
    found = [np.eye(4)]
    for i, q in enumerate(q_rad):
        turn, twist = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_euler("z", q + arm.theta_rad[i]).as_matrix()
        turn[2, 3] = arm.d_m[i]
        twist[:3, :3] = Rotation.from_euler("x", arm.alpha_rad[i]).as_matrix()
        twist[0, 3] = arm.a_m[i]
        found.append(found[-1] @ turn @ twist)
    return found


def motion(effect, arm, states, x):
    """Velocity of the end over its angular velocity, (P, 6), in the model."""
    model = Model(Chain.of(arm, bends=long_links(arm)), (effect,))
    return model.predict_with_jacobian(states, np.zeros(len(x))).jacobian @ x


def test_a_bent_link_turns_what_follows_about_a_third_of_its_length(at, arm, states):
    for name, row in (("upper_arm", 2), ("forearm", 4)):
        moved = motion(at("link_bending", name), arm, states, np.array([1e-6]))
        for p, q_rad in enumerate(states.q_rad):
            frames = rows(arm, q_rad)
            start, end = frames[row - 1][:3, 3], frames[row][:3, 3]
            axis = (end - start) / np.linalg.norm(end - start)
            moment = frames[row][:3, :3] @ states.static_loads.link_Nm[p, row - 1]
            turn = 1e-6 * (moment - axis * (axis @ moment))
            shift = np.cross(turn, frames[-1][:3, 3] - (start + (end - start) / 3.0))
            np.testing.assert_allclose(moved[p], np.hstack([shift, turn]), atol=1e-15)


def test_a_twisted_forearm_turns_what_follows_about_its_axis(at, arm, states):
    moved = motion(at("link_torsion", "forearm"), arm, states, np.array([1e-6]))
    for p, q_rad in enumerate(states.q_rad):
        frames = rows(arm, q_rad)
        axis = (frames[4][:3, 3] - frames[3][:3, 3]) / 0.48
        turn = 1e-6 * axis * (axis @ frames[4][:3, :3] @ states.static_loads.link_Nm[p, 3])
        shift = np.cross(turn, frames[-1][:3, 3] - frames[4][:3, 3])
        np.testing.assert_allclose(moved[p], np.hstack([shift, turn]), atol=1e-15)


def test_a_compliant_base_tilts_under_the_overturning_moment(at, arm, states):
    moved = motion(at("base_compliance", "base"), arm, states, np.array([2e-6, 5e-6]))
    turn = states.static_loads.base_Nm * [2e-6, 5e-6, 0.0]
    p_base_ee = Chain.of(arm).forward(states.q_rad)[:, :3, 3]
    np.testing.assert_allclose(moved, np.hstack([np.cross(turn, p_base_ee), turn]), atol=1e-15)


def test_a_tool_sags_across_its_axis_and_not_along_it(at, arm, states):
    carried = replace(states.static_loads, down_ee=np.tile([0.6, 0.0, 0.8], (len(states), 1)))
    moved = motion(
        at("tool_sag", "tool"), arm, replace(states, static_loads=carried), np.array([1e-4])
    )
    x_base_ee = Chain.of(arm).forward(states.q_rad)[:, :3, 0]
    np.testing.assert_allclose(moved[:, :3], 0.6e-4 * x_base_ee, atol=1e-18)
    assert not moved[:, 3:].any()
