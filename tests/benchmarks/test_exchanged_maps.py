"""Maps of single joints that one model takes over from another, whatever their knots."""

import numpy as np
from benchmarks.exchanged_maps import maps_of, with_maps_of

from made_up_model import fitted
from pa10cal.numerics.periodic_spline import knots_rad, unit_splines
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.offsets import link_departures


def mapped(seed, knots):
    def terms(arm):
        maps = (JointErrorMap(f"joint {joint}", knots) for joint in (2, 3))
        return (link_departures(arm, Tolerances()), *maps)

    return fitted("ur10", seed, terms)


def test_a_map_is_taken_over_at_its_own_knots_and_nothing_else_changes():
    own, other = mapped(1, 36), mapped(2, 12)
    changed = with_maps_of(own, other, [3])
    of_joint = own.model.columns_of(maps_of(own)[3])
    kept = np.ones(len(own.x), dtype=bool)
    kept[of_joint] = False
    np.testing.assert_array_equal(changed.x[kept], own.x[kept])
    theirs = unit_splines(12)(knots_rad(36)) @ other.x[other.model.columns_of(maps_of(other)[3])]
    np.testing.assert_allclose(changed.x[of_joint], theirs)
    assert np.abs(theirs - own.x[of_joint]).max() > 1e-6
