"""Roles of columns by names alone."""

from __future__ import annotations

import pytest

from pa10cal.campaign.numbered_columns import numbered_sets
from pa10cal.campaign.recognise import attitude_of, polar_columns, roles_of

J = [f"J{k}" for k in range(1, 7)]
XYZ = ["x", "y", "z"]


def with_unit(unit, names=J):
    return [f"{name} [{unit}]" for name in names]


@pytest.mark.parametrize("unit", ["Nm", "°C", "deg/s", "A"])
@pytest.mark.parametrize("first", [True, False])
def test_joints_are_the_columns_whose_unit_is_one_of_positions(unit, first):
    own, other = with_unit("deg"), with_unit(unit)
    found = roles_of([*(own + other if first else other + own), *XYZ], 6)
    assert found.joints == tuple(own)
    assert found.torques == (tuple(other) if unit == "Nm" else ())


def test_of_joints_in_two_units_the_first_columns_are_taken_whole():
    assert roles_of([*with_unit("rad"), *with_unit("deg"), *XYZ], 6).joints == tuple(
        with_unit("rad")
    )
    scara = ["J1 [deg]", "J2 [deg]", "J3 [mm]", "J4 [deg]"]
    again = ["J1 [rad]", "J2 [rad]", "J3 [m]", "J4 [rad]"]
    mixed = [name for pair in zip(scara, again, strict=True) for name in pair]
    assert roles_of([*mixed, *XYZ], 4).joints == tuple(scara)
    # q0 … q3 may be a quaternion; with units beside them are the joints.
    q_deg = [f"q{k}_deg" for k in range(1, 7)]
    assert roles_of(["q0", "q1", "q2", "q3", *q_deg, *XYZ], 6).joints == tuple(q_deg)
    assert numbered_sets([*with_unit("deg"), *with_unit("rad")], 6) == [tuple(with_unit("deg"))]


@pytest.mark.parametrize(
    "u",
    [
        ["x_U95", "y_U95", "z_U95"],
        ["U95_x", "U95_y", "U95_z"],
        ["u95x", "u95y", "u95z"],
        ["expanded_u_x", "expanded_u_y", "expanded_u_z"],
        ["2σ x", "2σ y", "2σ z"],
    ],
)
def test_an_expanded_uncertainty_is_no_target(u):
    found = roles_of([*J, *XYZ, *u], 6)
    assert found.positions == {"": tuple(XYZ)}
    assert found.uncertain == dict(zip(XYZ, u, strict=True))


def test_one_column_is_the_uncertainty_of_all_where_its_unit_is_a_length():
    for name in ("sigma [mm]", "std [mm]", "U (k=2)", "uncertainty"):
        assert roles_of([*J, *XYZ, name], 6).uncertain == dict.fromkeys(XYZ, name)
    for name in ("std", "std [deg]", "rms [mm]"):
        assert roles_of([*J, *XYZ, name], 6).uncertain == {}


def test_the_least_of_several_readings_and_a_speed_are_no_position():
    least = [f"{name}_min" for name in (*XYZ, *J)]
    speeds = [f"{name} [m/s]" for name in XYZ] + [f"{name}_max" for name in XYZ]
    found = roles_of([*least, *speeds, *XYZ, *J], 6)
    assert found.positions == {"": tuple(XYZ)}
    assert found.joints == tuple(J)


def test_places_that_are_called_alike_keep_labels_of_their_own():
    places = [["tcp3_x", "tcp3_y", "tcp3_z"], ["tcp_x", "tcp_y", "tcp_z"]]
    places += [["x_tcp", "y_tcp", "z_tcp"]]
    names = [name for place in places for name in place]
    assert list(roles_of([*J, *names], 6).positions.values()) == list(map(tuple, places))


def test_a_quaternion_has_its_parts_in_the_order_of_its_convention():
    for order, convention in (("wxyz", "wxyz"), ("xyzw", "xyzw"), ("zyxw", "xyzw")):
        names = [f"q{part}" for part in order]
        expected = tuple(f"q{part}" for part in convention)
        assert attitude_of(names) == (expected, f"quaternion_{convention}")


def test_a_horizontal_distance_is_no_angle_and_no_slope_distance():
    own = ["horizontal angle", "vertical angle", "slope distance"]
    assert polar_columns(["horizontal distance", *own[::-1]]) == tuple(own)
    assert polar_columns(["horizontal distance", *own[:2]]) is None
    assert polar_columns(["Hz (r)", "V (r)", "s"]) == ("Hz (r)", "V (r)", "s")


@pytest.mark.parametrize("difference", [("ΔX", "ΔY", "ΔZ"), ("∆X", "∆Y", "∆Z"), ("dX", "dY", "dZ")])
@pytest.mark.parametrize("places", [("X", "Y", "Z"), ("Actual X", "Actual Y", "Actual Z")])
def test_differences_are_no_place_whatever_stands_first(difference, places):
    joints = [f"J{k}" for k in range(1, 7)]
    positions = roles_of([*joints, *difference, *places], 6).positions
    assert list(positions.values()) == [places]


def test_a_target_d_is_a_place_beside_others():
    targets = [tuple(f"{target}{axis}" for axis in "XYZ") for target in "abcd"]
    found = roles_of([name for triple in targets for name in triple], 6).positions
    assert list(found.values()) == targets


@pytest.mark.parametrize("first", ["#", "No", "°"])
@pytest.mark.parametrize("name", ["uncertainty [mm]", "U95 [mm]"])
def test_an_uncertainty_of_the_target_is_not_that_of_a_column_without_words(first, name):
    joints = [f"J{k}" for k in range(1, 7)]
    uncertain = roles_of([first, *joints, "x", "y", "z", name], 6).uncertain
    assert uncertain == dict.fromkeys("xyz", name)


@pytest.mark.parametrize(
    ("of", "name"),
    [
        (["Laser distance [mm]"], "Distance uncertainty [mm]"),
        (["BallX", "BallY", "BallZ"], "Ball uncertainty [mm]"),
        (["Ball X", "Ball Y", "Ball Z"], "Ball uncertainty [mm]"),
    ],
)
def test_an_uncertainty_belongs_to_what_its_words_say(of, name):
    joints = [f"J{k}" for k in range(1, 7)]
    assert roles_of([*joints, *of, name], 6).uncertain == dict.fromkeys(of, name)
