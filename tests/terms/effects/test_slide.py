"""Effects of joints that slide, against their form written out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

from made_up_poses import context_of
from pa10cal.arm.chain import Chain, frames
from pa10cal.errors import TermError
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.model import Model
from pa10cal.terms.plain import term_from_plain, term_to_plain

FIRST = replace(load_arm("pa10_6ce"), prismatic=np.arange(6) == 0)


def slides(arm):
    ids = ("slide_bending", "slide_error", "slide_positioning")
    return [e for e in candidates(context_of(arm)) if e.id in ids]


def of_first(id_):
    (effect,) = (e for e in slides(FIRST) if e.id == id_)
    return effect


def polynomials(u):
    """Legendre's polynomials by their degree, written out."""
    P = {1: u, 2: (3 * u**2 - 1) / 2, 3: (5 * u**3 - 3 * u) / 2}
    P[4] = (35 * u**4 - 30 * u**2 + 3) / 8
    P[5] = (63 * u**5 - 70 * u**3 + 15 * u) / 8
    P[6] = (231 * u**6 - 315 * u**4 + 105 * u**2 - 5) / 16
    return P


def even_over_stroke(states):
    u = np.linspace(-1.5, 1.5, 20001)
    return replace(states.take(np.zeros(20001, int)), q_rad=np.outer(u, np.eye(6)[0]))


def rms_over_stroke(shift):
    return np.sqrt(simpson(shift**2, dx=1.0, axis=0) / (len(shift) - 1.0))


def moved(effect, arm, states, x):
    """Velocity of the end over its angular velocity, (P, 6), in the model."""
    model = Model(Chain.of(arm, bends=tuple(range(1, arm.n))), (effect,))
    return model.predict_with_jacobian(states, np.zeros(len(x))).jacobian @ x


def test_sit_at_joints_that_slide_before_any_turns():
    assert not slides(load_arm("pa10_6ce"))
    assert not slides(load_arm("gx4_351s"))  # a quill
    arm = load_arm("pa10_6ce")
    assert [(e.id, e.of) for e in slides(replace(arm, prismatic=np.arange(6) < 2))] == [
        ("slide_bending", "joint 1"),
        ("slide_bending", "joint 2"),
        ("slide_error", "joint 1"),
        ("slide_error", "joint 2"),
        ("slide_positioning", "joint 1"),
        ("slide_positioning", "joint 2"),
    ]
    gantry = replace(arm, prismatic=np.full(6, True))
    *_, error = (e for e in slides(gantry) if e.id == "slide_error")
    assert (error.of, error.coordinates[0]) == ("joint 6", "tool.x")


@pytest.mark.parametrize("also_along", [False, True], ids=["now", "of older files"])
def test_a_slide_error_is_a_polynomial_of_the_stroke(also_along, states):
    effect = replace(of_first("slide_error"), also_along=also_along)
    x = np.random.default_rng(4).normal(0.0, 1e-4, 34 if also_along else 28)
    names = [each.name.removeprefix("slide_error_1_") for each in effect.parameters]
    of = dict(zip(names, x, strict=True))
    u = np.clip(states.q_rad[:, 0] / 1.5, -1.0, 1.0)
    P = polynomials(u)

    def series(axes):
        return np.stack([sum(of.get(f"{a}_{k}", 0.0) * P[k] for k in P) for a in axes], axis=1)

    chain = Chain.of(FIRST)
    found = frames(chain, chain.coordinates(states.q_rad))
    R, p = found.T_base_joints[1, :, :3, :3], found.T_base_joints[1, :, :3, 3]
    turn = np.einsum("pij,pj->pi", R, series(("rx", "ry", "rz")))
    along = found.T_base_joints[0, :, :3, 2]
    shift = np.einsum("pij,pj->pi", R, series("xyz"))
    if also_along:
        shift = shift + along * (of["s_1"] * u)[:, None]
    else:
        np.testing.assert_allclose(np.sum(shift * along, axis=1), 0.0, atol=1e-15)
    shift = shift + np.cross(turn, found.T_base_ee[:, :3, 3] - p)
    np.testing.assert_allclose(
        moved(effect, FIRST, states, x), np.hstack([shift, turn]), rtol=0.0, atol=1e-15
    )


@pytest.mark.parametrize("also_along", [False, True], ids=["now", "of older files"])
def test_readers_see_its_root_mean_square_over_the_stroke(also_along, states):
    effect = replace(of_first("slide_error"), also_along=also_along)
    x = np.random.default_rng(4).normal(0.0, 1e-4, 34 if also_along else 28)
    rms = rms_over_stroke(effect.shift(even_over_stroke(states), x))
    report = effect.report(x)
    across = np.array([True, True, also_along, True, True, True])  # it slides along y of the next
    across[1], across[2] = across[2], across[1]
    names = [f"{kind}_{axis}" for kind in ("shift", "turn") for axis in "xyz"]
    assert [each.name for each in report.parameters] == np.array(names)[across].tolist()
    np.testing.assert_allclose(report.values, rms[across], rtol=1e-6)
    for k in range(len(x)):
        by_x = (effect.report(x + 1e-9 * np.eye(len(x))[k]).values - report.values) / 1e-9
        np.testing.assert_allclose(report.jacobian[:, k], by_x, atol=1e-4)


def test_shifts_across_a_stroke_that_is_along_no_axis_are_across_it(states):
    along = np.array([0.36, 0.48, 0.8])
    effect = replace(of_first("slide_error"), along=tuple(along.tolist()))
    assert [each.name for each in effect.report(np.ones(28)).parameters[:2]] == [
        "shift_x",
        "shift_y",
    ]
    by_shifts = effect.per_unit(states)[:, :3, :10]
    np.testing.assert_allclose(np.einsum("i,pik->pk", along, by_shifts), 0.0, atol=1e-15)
    x, y = (by_shifts[0] / np.linalg.norm(by_shifts[0], axis=0)).T[:2]
    assert x @ y == pytest.approx(0.0, abs=1e-15)


def test_a_positioning_error_is_a_polynomial_along_the_stroke(states):
    effect, x = of_first("slide_positioning"), np.array([3e-4, -2e-4, 1e-4, 4e-5, -7e-5])
    P = polynomials(np.clip(states.q_rad[:, 0] / 1.5, -1.0, 1.0))
    along = sum(each * P[degree] for degree, each in enumerate(x, start=2))
    assert effect.coordinates == ("d_1",)
    np.testing.assert_allclose(effect.shift(states, x), along[:, None], rtol=0.0, atol=1e-15)
    report = effect.report(x)
    (known,) = report.parameters
    rms = rms_over_stroke(effect.shift(even_over_stroke(states), x))
    assert (known.name, report.values[0]) == ("shift", pytest.approx(rms[0], rel=1e-6))
    by_x = [(effect.report(x + 1e-9 * unit).values - report.values)[0] / 1e-9 for unit in np.eye(5)]
    np.testing.assert_allclose(report.jacobian, [by_x], atol=1e-4)


def test_an_older_file_has_the_shift_along_the_stroke_in_its_slide_error():
    now = term_to_plain(of_first("slide_error"))
    assert now["form"].pop("also_along") is False
    older = term_from_plain(now, where="model.yaml")
    names = [each.name for each in older.parameters]
    assert names[:4] == [f"slide_error_1_{each}" for each in ("s_1", "x_2", "y_2", "z_2")]
    assert len(names) == 34


def test_beyond_the_measured_stroke_it_stays_as_at_its_end(states):
    effect = of_first("slide_error")
    far = states.q_rad.copy()
    far[:, 0] = 1.5
    at_end = effect.per_unit(replace(states, q_rad=far))
    far[:, 0] = 9.0
    np.testing.assert_array_equal(effect.per_unit(replace(states, q_rad=far)), at_end)


@pytest.mark.parametrize("id_", ["slide_error", "slide_bending", "slide_positioning"])
def test_a_file_with_a_stroke_of_no_length_is_refused(id_):
    plain = term_to_plain(of_first(id_))
    plain["form"]["span_m"] = [0.5, 0.5]
    with pytest.raises(TermError, match=r"span_m.* a lower and a higher position"):
        term_from_plain(plain, where="model.yaml")


@pytest.mark.parametrize("beyond_m", [0.0, 0.4])
def test_what_a_carriage_slides_on_is_an_even_beam(beyond_m, states):
    """Slope and deflection of its free end by quadrature of its curvature, from where it is held.

    That is below the low end of the stroke; beyond its high end the beam goes on.
    """
    effect = of_first("slide_bending")
    chain, whole_m = Chain.of(FIRST), 3.0
    found = frames(chain, chain.coordinates(states.q_rad))
    model = Model(Chain.of(FIRST, bends=tuple(range(1, FIRST.n))), (effect,))
    by_c = model.predict_with_jacobian(states, np.array([0.0, beyond_m])).jacobian[:, :, 0]
    got = 1e-6 * by_c
    carriage = found.T_base_joints[0, :, :3, 3] + (
        states.q_rad[:, :1] * found.T_base_joints[0, :, :3, 2]
    )
    for p in range(len(states)):
        R, end = found.T_base_joints[1, p, :3, :3], found.T_base_joints[1, p, :3, 3]
        axis, loads = found.T_base_joints[0, p, :3, 2], states.static_loads
        force = R @ loads.link_N[p, 0]
        moment = R @ loads.link_Nm[p, 0] + np.cross(end - carriage[p], force)
        out_m = max(states.q_rad[p, 0] + 1.5 + beyond_m, 0.0)
        along = np.linspace(0.0, out_m, 2001)
        beyond = np.outer(out_m - along, axis)
        bend = moment + np.cross(beyond, force)
        curvature = 1e-6 / whole_m * (bend - np.outer(bend @ axis, axis))
        turn = simpson(curvature, x=along, axis=0)
        lever = beyond + found.T_base_ee[p, :3, 3] - carriage[p]
        shift = simpson(np.cross(curvature, lever), x=along, axis=0)
        np.testing.assert_allclose(got[p], np.hstack([shift, turn]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_what_geometry_takes_up_is_left_out(axis, states):
    """Another direction of the stroke shifts across it by the stroke; no parameter does that."""
    effect = of_first("slide_error")
    turned = Rotation.from_rotvec(1e-6 * np.eye(3)[axis]).apply([0.0, 0.0, 1.0]) - [0.0, 0.0, 1.0]
    chain = Chain.of(FIRST)
    found = frames(chain, chain.nominal[None])
    R = found.T_base_joints[1, 0, :3, :3].T @ found.T_base_joints[0, 0, :3, :3]
    u = np.linspace(-1.5, 1.5, 2001)
    even = replace(states.take(np.zeros(2001, int)), q_rad=np.outer(u, np.eye(6)[0]))
    columns = effect.per_unit(even).reshape(6 * len(u), -1)
    wanted = np.hstack([np.outer(u, R @ turned), np.zeros((len(u), 3))]).ravel()
    left = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    assert np.linalg.norm(left) == pytest.approx(np.linalg.norm(wanted), rel=1e-3, abs=1e-11)


def test_one_factor_of_all_leads_is_the_sum_of_their_errors(states):
    """There is none where a single joint slides: it is the error of that joint's lead."""

    def of(arm, id_):
        return [e for e in candidates(context_of(arm)) if e.id == id_]

    assert of(FIRST, "slide_scale") == []
    two = replace(FIRST, prismatic=np.arange(6) < 2)
    (every,) = of(two, "slide_scale")
    leads = [e for e in of(two, "gear_ratio_error") if e.slides]
    assert every.coordinates == ("d_1", "d_2")
    x = np.array([1e-4])
    of_each = sum(moved(lead, two, states, x) for lead in leads)
    np.testing.assert_allclose(moved(every, two, states, x), of_each, atol=1e-15)
