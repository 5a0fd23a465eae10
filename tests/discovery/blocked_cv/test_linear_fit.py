"""Effects found, fitted by linear least squares: how fine their maps become."""

from itertools import permutations

import numpy as np
from scipy.linalg import block_diag

from made_up_poses import at_joint
from made_up_survey import Hidden, observe
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect
from pa10cal.discovery.blocked_cv.linear_fit import linear_fit, made_finer, refine_maps
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.discovery.rules import BLOCKS
from pa10cal.numerics.periodic_spline import b_splines_by_knots
from pa10cal.terms.effects.joint import EncoderEccentricity, GearRatioError
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap


def map_of(joint, knots=144):
    return ShapedEffect(JointErrorMap(f"joint {joint}", knots, FadingPrior(3e-4, 100.0)))


def rows_of_two_joints():
    def turn(motion):
        q = motion.q_rad
        return at_joint(3, 4e-4 * np.sin(3.0 * q[:, 2])) + at_joint(5, 2e-4 * np.cos(q[:, 4]))

    survey = observe(Hidden(turn=turn), poses=100, held_out=0).survey
    return BlockedRows(survey, unweighted(survey.poses.measured), (), 36)


def test_knots_are_those_of_least_squares_in_all_of_them_with_their_prior():
    """No pose touches some of the B-splines: the prior alone determines these."""
    ratio, error_map = ShapedEffect(GearRatioError("joint 2")), map_of(3, 36)
    rows = rows_of_two_joints().with_effects_of([ratio])
    assert len(rows.touched([3], [36])[0]) < 36
    designs = [rows.design(block) for block in range(BLOCKS.blocks)]
    at = [rows.joints.index(3)]
    of_knots = [each.maps([36], at).toarray() @ b_splines_by_knots(36) for each in designs]
    dense = [np.hstack([each.dense, more]) for each, more in zip(designs, of_knots, strict=True)]
    design, data = np.vstack(dense), np.concatenate([each.data for each in designs])
    factor = error_map.effect.prior_factor
    prior = block_diag(np.eye(rows.dense_count), np.linalg.inv(factor @ factor.T))
    x = np.linalg.solve(design.T @ design + prior, design.T @ data)
    fit = linear_fit(rows, (error_map, ratio))
    knots, _ = fit.effect_parameters
    np.testing.assert_allclose(knots, x[rows.dense_count :], atol=1e-9 * np.abs(knots).max())
    of_model = np.delete(x[: rows.dense_count], rows.columns_of_effects()[0])
    np.testing.assert_allclose(fit.model_amounts, of_model, atol=1e-9)


def test_the_order_of_members_changes_no_parameter():
    ratio, eccentric = GearRatioError("joint 2"), EncoderEccentricity("joint 4", 1.0)
    members = ShapedEffect(ratio), map_of(3, 36), ShapedEffect(eccentric), map_of(5, 72)
    rows = rows_of_two_joints()
    expected = dict(zip(members, linear_fit(rows, members).effect_parameters, strict=True))
    for order in list(permutations(members))[::5]:
        found = zip(order, linear_fit(rows, order).effect_parameters, strict=True)
        for member, x in found:
            size = np.abs(expected[member]).max()
            np.testing.assert_allclose(x, expected[member], atol=1e-9 * size)


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
