"""Effects found, fitted by linear least squares: how fine their maps become."""

import numpy as np

from made_up_poses import at_joint
from made_up_survey import Hidden, observe
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect
from pa10cal.discovery.blocked_cv.linear_fit import made_finer, refine_maps
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap


def map_of(joint, knots=144):
    return ShapedEffect(JointErrorMap(f"joint {joint}", knots, FadingPrior(3e-4, 100.0)))


def test_a_map_is_refined_beyond_one_whose_joint_took_too_few_angles():
    grid_rad = 1.0 + np.linspace(-0.17, 0.17, 30)  # angles for 216 knots, not for 360

    def moved(q_rad):
        joint_3, joint_5 = grid_rad[np.arange(len(q_rad)) % len(grid_rad)], q_rad[:, 4] / 8.0
        return np.column_stack([q_rad[:, :2], joint_3, q_rad[:, 3], joint_5, q_rad[:, 5]])

    def turn(motion):
        q = motion.q_rad
        of_joint_5 = 2e-4 * np.sin(90.0 * q[:, 4]) + 3e-4 * np.sin(140.0 * q[:, 4])
        return at_joint(3, 4e-4 * np.sin(90.0 * q[:, 2])) + at_joint(5, of_joint_5)

    survey = observe(Hidden(turn=turn), poses=200, held_out=0, moved=moved).survey
    rows = BlockedRows(survey, unweighted(survey.poses.measured), (), 144)
    joint_3, joint_5 = map_of(3), map_of(5)

    def knots(*maps):
        return [each.effect.knots for each in refine_maps(rows, maps).members]

    assert knots(joint_3, joint_5) == [216, 360]
    assert knots(joint_3) == [216]
    assert made_finer(rows, map_of(5, 360), 216).effect.knots == 360
