"""Sets solved by block elimination against least squares written out."""

import numpy as np
import pytest

from pa10cal.discovery.blocked_cv.block_rows import ShapedEffect
from pa10cal.discovery.blocked_cv.effect_set import Candidate, Columns, both_kinds_agree, start
from pa10cal.discovery.blocked_cv.judge import in_place_of, over_expected, unexplained
from pa10cal.discovery.blocked_cv.normal_equations import BlockEquations
from pa10cal.discovery.blocked_cv.search import Search
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.results.discovery import Remaining, Tried
from pa10cal.terms.effects.generic import PlaceMap, WindupMap
from pa10cal.terms.effects.joint import Backlash, JointCompliance
from pa10cal.terms.effects.joint_error_map import JointErrorMap

BLOCKS, ROWS = 5, 40


def products_of(columns, data):
    """Return the products of columns (B, R, k) and data (B, R) of blocks."""
    return BlockEquations(
        np.einsum("bri,brj->bij", columns, columns),
        np.einsum("bri,br->bi", columns, data),
        np.sum(data**2, axis=1),
    )


@pytest.fixture(scope="module")
def rows():
    """Columns and data of some blocks, and their products."""
    rng = np.random.default_rng(11)
    columns = rng.standard_normal((BLOCKS, ROWS, 14)) * np.geomspace(1e-3, 1e3, 14)
    data = rng.standard_normal((BLOCKS, ROWS)) + columns[:, :, 4] / 5.0
    products = products_of(columns, data)
    return (
        columns,
        data,
        BlockEquations(products.gram, products.projection, products.squares, of_positions=products),
    )


OWN = Columns(np.arange(3), np.array([1e3, 1e3, 1e3]))
ONE = Columns(np.array([4]), np.array([2.0]))
TWO = Columns(np.array([7, 9]), np.array([0.5, 0.01]))
THREE = Columns(np.array([3, 8, 12]), np.array([10.0, 0.1, 1e-3]))


def started(rows, *members):
    """Return the set of some members, which join one after the other."""
    found = start(rows[2], OWN)
    for each in members:
        found = found.with_member(each)
    return found


def by_hand(rows, members):
    """Sums of squares of blocks left out, each by its own least squares."""
    columns, data, _ = rows
    at = np.concatenate([each.index for each in members])
    prior = np.diag(1.0 / np.concatenate([each.sizes for each in members]))
    found = []
    for b in range(BLOCKS):
        rest = [other for other in range(BLOCKS) if other != b]
        matrix = np.concatenate([columns[rest][:, :, at].reshape(-1, len(at)), prior])
        target = np.concatenate([data[rest].ravel(), np.zeros(len(at))])
        x = np.linalg.lstsq(matrix, target, rcond=None)[0]
        found.append(np.sum((data[b] - columns[b][:, at] @ x) ** 2))
    return np.array(found)


def test_members_that_join_and_leave_are_as_if_solved_anew(rows):
    grown = started(rows, ONE, TWO, THREE)
    less = grown.without_member(1)
    assert less.members == (ONE, THREE)
    for state in (grown, less):
        np.testing.assert_allclose(state.squares, by_hand(rows, (OWN, *state.members)), rtol=1e-8)
        np.testing.assert_allclose(state.squares_by_kind[0], state.squares)


def test_candidates_are_judged_without_joining_and_members_without_leaving(rows):
    state = started(rows, ONE, TWO)
    joined, left = started(rows, ONE).squares_with_each([TWO, THREE]), state.squares_without_each()
    sets = ((ONE, TWO), (ONE, THREE), (TWO,), (ONE,))
    for squares, members in zip((*joined, *left), sets, strict=True):
        np.testing.assert_allclose(squares, by_hand(rows, (OWN, *members)), rtol=1e-8)
    assert np.all(state.solution_without(1)[:, -2:] == 0.0)


def test_candidates_that_were_judged_before_keep_their_squares(rows):
    state = started(rows, ONE)
    first = state.squares_with_each([TWO])
    both = state.squares_with_each([THREE, TWO])
    np.testing.assert_array_equal(both[1], first[0])
    np.testing.assert_allclose(both, started(rows, ONE).squares_with_each([THREE, TWO]), rtol=1e-12)
    assert not np.array_equal(state.with_member(THREE).squares_with_each([TWO]), first)


def with_told(rows, told):
    """Return the rows without orientations, weights being told something in every block."""
    products = rows[2]
    gram = products.gram.copy()
    gram[:, np.arange(14), np.arange(14)] += told
    return BlockEquations(gram, products.projection, products.squares, None, told)


def test_what_is_known_of_weights_is_neither_a_position_nor_an_orientation(rows):
    # An effect for which weights have to be other than described, where positions gain all the
    # same: no orientation was measured that could contradict it.
    told = np.zeros(14)
    told[0] = 50.0
    before = start(with_told(rows, told), OWN)
    after = before.with_member(ONE)
    for state in (before, after):
        (positions,) = state.squares_by_kind
        beside = state.solution**2 @ told[state.index]
        np.testing.assert_allclose(positions + beside, state.squares)
        assert beside.max() > 0.0
    assert both_kinds_agree(before, after)


def test_orientations_that_come_out_worse_contradict():
    rng = np.random.default_rng(7)
    columns = rng.standard_normal((BLOCKS, ROWS, 2))

    def of(of_rows, sign):  # the second column, turned or not
        own = columns[:, of_rows] * [1.0, sign]
        data = columns[:, of_rows, 1] + 0.01 * rng.standard_normal((BLOCKS, len(of_rows)))
        return products_of(own, data)

    own, effect = (Columns(np.array([at]), np.ones(1)) for at in (0, 1))
    for sign, agree in ((1.0, True), (-1.0, False)):
        positions, attitudes = of(np.arange(30), 1.0), of(np.arange(30, ROWS), sign)
        both = {
            name: getattr(positions, name) + getattr(attitudes, name)
            for name in ("gram", "projection", "squares")
        }
        before = start(BlockEquations(**both, of_positions=positions), own)
        after = before.with_member(effect)
        assert after.squares.sum() < before.squares.sum()
        assert both_kinds_agree(before, after) is agree


def test_estimates_add_to_held_out_squares_what_drawn_noise_shows(rows):
    """With no prior to speak of: held-out squares of noise alone have this expectation."""
    columns, rng = rows[0][:, :, :6], np.random.default_rng(3)
    own = Columns(np.arange(6), np.full(6, 1e9))
    found = []
    for _ in range(400):
        noise = rng.standard_normal((BLOCKS, ROWS))
        held_out = start(products_of(columns, noise), own).squares
        found.append(float(held_out.sum() - np.sum(noise**2)))
    expected = start(products_of(columns, noise), own).squares_of_estimates
    assert expected > 6.0  # more than 1 of each parameter: blocks are predicted from the others
    std = np.std(found) / np.sqrt(len(found))
    assert abs(np.mean(found) - expected) < 4.0 * std < 0.2 * expected


@pytest.mark.parametrize(
    ("means_mm", "over"),
    [
        (np.full(10, 0.0101), False),
        (np.r_[np.full(9, 0.0101), 5.0], False),  # one block alone tells nothing of the others
        (np.linspace(0.2, 0.4, 10), True),
        (np.r_[np.linspace(0.2, 0.4, 9), 20.0], True),  # and hides nothing of them
    ],
)
def test_one_bad_block_neither_makes_nor_hides_what_is_left(means_mm, over):
    assert over_expected(means_mm, float(means_mm.mean()), 0.01) is over


def remaining(*tried, over_floor=True):
    return Remaining(
        mean_mm=0.3,
        std_mm=0.01,
        rms_mm=0.3,
        floor_mm=0.05,
        expected_mm=0.06,
        over_floor=over_floor,
        tried=tried,
    )


def test_what_was_found_without_a_name_is_told_however_little_is_left():
    entry = Tried(
        id="backlash",
        of="joint 1",
        gain=0.1,
        gain_std=0.01,
        helps=True,
        positions_and_attitudes_agree=True,
    )
    little = remaining(entry, over_floor=False)
    (found,) = unexplained(little, (WindupMap("joint 3", 10.0),), ())
    assert (found.of, found.form) == ("joint 3", "windup_map")
    assert unexplained(little, (), ()) == ()


def test_a_part_of_a_smooth_function_is_found_where_the_whole_fits_noise():
    rng = np.random.default_rng(8)
    columns = rng.standard_normal((BLOCKS, 60, 58)) / np.sqrt(60.0)
    effect = PlaceMap("instrument", (0.0, 0.0, 0.0))
    part = effect.parts[0]
    data = 4.5 * columns[..., 1 + part[0]] + rng.standard_normal((BLOCKS, 60))
    products, own = products_of(columns, data), Columns(np.array([0]), np.ones(1))
    whole, bow = (
        Candidate(1 + np.array(places), np.full(len(places), 30.0), ShapedEffect(effect))
        for places in (range(57), part)
    )
    for candidates, found in (((whole,), ()), ((whole, bow), (bow,))):
        assert Search(products, own, candidates, BLOCKS * 60.0, 0.01).run().members == found


@pytest.mark.parametrize(
    ("effect", "agree", "physical", "found_at", "words"),
    [
        ("backlash", False, True, "joint 1", "positions and orientations contradict"),
        ("backlash", True, False, "joint 1", "sign or size that it physically cannot have"),
        ("backlash", True, True, "joint 1", "what was found in its place predicts as much"),
        ("backlash", True, True, "joint 2", "it joined no set within the rounds of the search"),
        ("lateral_compliance", True, True, "joint 2", "it is only exchanged for a named effect"),
    ],
)
def test_what_helps_is_told_with_why_it_was_not_taken(effect, agree, physical, found_at, words):
    entry = Tried(
        id=effect,
        of="joint 1",
        gain=0.12,
        gain_std=0.01,
        helps=True,
        positions_and_attitudes_agree=agree,
        physical=physical,
    )
    (found,) = unexplained(remaining(entry), (), {found_at})
    assert found.of == "joint 1"
    assert found.form == effect
    assert words in found.why
    assert "nothing that was tried" not in found.why


@pytest.mark.parametrize("gain_std", [0.004, 0.01])
def test_nothing_that_was_tried_is_told_only_where_nothing_helps(gain_std):
    """The nearest is told where its gain is more than chance."""
    entry = Tried(
        id="backlash",
        of="joint 1",
        gain=0.01,
        gain_std=gain_std,
        helps=False,
        positions_and_attitudes_agree=None,
    )
    (found,) = unexplained(remaining(entry), (), ())
    assert "nothing that was tried significantly predicts it" in found.why
    assert ("the nearest is backlash" in found.why) == (gain_std < 0.005)


def test_what_imitates_a_rival_is_no_alternative_to_a_name():
    # The member, a rival without a name, and an effect that follows both of them a little.
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((BLOCKS, 200, 4))
    member, rival, imitator = 1, 2, 3
    columns[..., imitator] *= 0.7
    columns[..., imitator] += columns[..., member] / 3.0 + columns[..., rival]
    data = columns[..., member] + 3.0 * columns[..., rival]
    data += 0.1 * rng.standard_normal(data.shape)
    products = products_of(columns, data)
    backlash, nameless, spring = (
        Candidate(np.array([at]), np.ones(1), ShapedEffect(effect))
        for at, effect in (
            (member, Backlash("joint 1")),
            (rival, WindupMap("joint 3", 10.0)),
            (imitator, Backlash("joint 2")),
        )
    )
    own = Columns(np.array([0]), np.ones(1))
    search = Search(products, own, (backlash, nameless, spring), BLOCKS * 2.0, 0.01)
    with_rival = start(products, own).with_member(backlash).with_member(nameless)
    alone = with_rival.without_member(1)

    def found(chosen):
        beside = dict(zip((spring,), chosen.squares_with_each((spring,)), strict=True))
        return in_place_of(search, chosen, 0, beside, len(data))

    close, (rival_of_it,) = found(alone)
    assert close == (spring.effect,)
    assert rival_of_it.effect == spring.effect
    close, (rival_of_it,) = found(with_rival)
    assert close == ()
    assert rival_of_it.nats.shape == (BLOCKS,)
    assert rival_of_it.nats.sum() < 0.0


@pytest.mark.parametrize("found", [Backlash("joint 1"), JointErrorMap("joint 1")])
def test_what_can_do_more_than_a_name_weighs_less_beside_one(found):
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((BLOCKS, 200, 5))
    data = columns[..., 1] + 0.1 * rng.standard_normal((BLOCKS, 200))
    products = products_of(columns, data)
    others = (Backlash("joint 2"), WindupMap("joint 3", 10.0), JointErrorMap("joint 2"))
    member, *rivals = (
        Candidate(np.array([at]), np.ones(1), ShapedEffect(effect))
        for at, effect in enumerate((found, *others), start=1)
    )
    own = Columns(np.array([0]), np.ones(1))
    search = Search(products, own, (member, *rivals), BLOCKS * 2.0, 0.01)
    chosen = start(products, own).with_member(member)
    beside = dict(zip(rivals, chosen.squares_with_each(rivals), strict=True))
    _, tried = in_place_of(search, chosen, 0, beside, len(data))
    of_map = 1.0 if found == JointErrorMap("joint 1") else PROBABILITIES.flexible
    weights = {each.effect: each.prior_odds for each in tried}
    assert weights == dict(zip(others, (1.0, PROBABILITIES.flexible, of_map), strict=True))


@pytest.mark.parametrize(("of_spring", "names_found"), [(-3.0, False), (3.0, True)])
def test_a_map_stays_where_a_name_in_its_place_has_an_impossible_sign(of_spring, names_found):
    """The spring joins first, and the lost motion, whose sign is possible, joins last."""
    rng = np.random.default_rng(7)
    columns = rng.standard_normal((BLOCKS, 200, 4))
    both = of_spring * columns[..., 2] + 2.0 * columns[..., 3]
    columns[..., 1] = both + 0.02 * rng.standard_normal((BLOCKS, 200))
    data = both + 0.1 * rng.standard_normal((BLOCKS, 200))
    of_map, spring, lost_motion = (
        JointErrorMap("joint 1"),
        JointCompliance("joint 1", 100.0),
        Backlash("joint 1"),
    )
    candidates = [
        Candidate(np.array([at]), np.full(1, 10.0), ShapedEffect(effect))
        for at, effect in enumerate((of_map, spring, lost_motion), start=1)
    ]
    own = Columns(np.array([0]), np.ones(1))
    chosen = Search(products_of(columns, data), own, candidates, BLOCKS * 2.0, 0.01).run()
    found = [member.effect for member in chosen.members]
    assert found == ([spring, lost_motion] if names_found else [of_map])
