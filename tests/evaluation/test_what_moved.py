"""What moved in an arm between two campaigns: verdicts of simulated pairs, and laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from changed_arm import Change, draw_changed, plan_of
from made_up_pair import campaign, parts, shifted
from made_up_poses import context_of
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.errors import ModelError
from pa10cal.evaluation.parameter_differences import differences
from pa10cal.evaluation.what_moved import drift, what_moved
from pa10cal.figures import draw
from pa10cal.figures.draw import write_drift
from pa10cal.files.arms import load_arm
from pa10cal.options import Tolerances
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint import (
    JointCompliance,
    JointCoupling,
    PeriodicError,
    SoftWindup,
    TransmissionError,
)
from pa10cal.terms.effects.joint_error_map import FadingPrior, GearError
from pa10cal.terms.effects.structure import LinkTorsion, ToolSag
from pa10cal.terms.field import Field
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import (
    Offsets,
    base_frame,
    link_departures,
    motion_of_base,
    tool_frame,
)
from pa10cal.terms.term import TermParameter
from pa10cal.terms.wrapped import OfCampaign
from pa10cal_lab.simulated import measure, observations_of, payload_of_individual

ARM = load_arm("ur10")


@pytest.fixture(scope="module")
def pair():
    """Return models of an arm before and after a change."""
    found = {}

    def make(change, kind="pose", seed=1):
        key = change, kind, seed
        if key not in found:
            plan = plan_of(kind, 100)
            robots = draw_changed(ARM, plan, change, np.random.default_rng(seed))
            models = []
            for number, robot in enumerate(robots):
                seen = observations_of(measure(robot, plan, 100 * seed + number))
                start = find_start(ARM, seen)
                payload = payload_of_individual(robot)
                models.append(fitted(calibrate_general(ARM, seen, start, payload)))
            found[key] = tuple(models)
        return found[key]

    return make


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kind", ["pose", "points", "distance"])
def test_nothing_moved_or_base_and_tool_alone(pair, kind):
    found = what_moved(*pair(Change(), kind))
    assert found.verdict == "unchanged"
    # Whether a spring is identified in a campaign may differ.
    assert not found.not_compared
    assert found.line.partition("; in one model alone: joint_spring")[0].startswith("unchanged")
    assert found.chance > 0.01
    assert 0.2 * found.dof < found.chi_square < 2.5 * found.dof
    if kind != "distance":
        found = what_moved(*pair(Change(place=True), kind))
        assert found.verdict == "base_or_tool_moved"
        assert {each.kind for each in found.moved} <= {"base", "tool"}
        assert found.chance > 0.01


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("place", [False, True])
@pytest.mark.parametrize("joint", [2, 3, 4, 5])
def test_the_zero_of_one_joint_moved(pair, joint, place):
    found = what_moved(*pair(Change(place, zero_rad=((joint, 1e-3),))))
    assert found.verdict == "joint_zero_moved"
    (zero,) = (each for each in found.moved if each.kind == "joint_zero")
    assert zero.of == f"joint {joint}"
    assert abs(zero.by - 1e-3) < 4 * zero.std
    assert zero.interval95 == pytest.approx((zero.by - 1.96 * zero.std, zero.by + 1.96 * zero.std))
    assert found.chance < 1e-6


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    "zeros", [((2, 3e-4), (5, -8e-4)), ((2, 8e-4), (3, 8e-4)), ((2, 3e-4), (3, 3e-4), (4, 4e-4))]
)
def test_zeros_of_several_joints_moved(pair, zeros):
    found = what_moved(*pair(Change(zero_rad=zeros)))
    assert found.verdict == "joint_zero_moved"
    assert found.factor == 1.0
    moved = {each.of: each for each in found.moved}
    assert set(moved) == {f"joint {joint}" for joint, _ in zeros}
    for joint, by in zeros:
        assert abs(moved[f"joint {joint}"].by - by) < 4 * moved[f"joint {joint}"].std


def test_a_stiffness_changed(pair):
    found = what_moved(*pair(Change(True, softer=((2, 0.7),))))
    assert found.verdict == "stiffness_changed"
    (spring,) = (each for each in found.moved if each.kind == "stiffness")
    assert spring.of == "joint 2"
    assert abs(spring.by - (1 / 0.7 - 1)) < 4 * spring.std


def test_a_link_became_longer(pair):
    found = what_moved(*pair(Change(longer_m=((2, 5e-4),))))
    assert found.verdict == "something_else"
    assert [each.of for each in found.moved] == ["delta_a_2"]


def test_the_other_way_round_it_moved_back(pair):
    first, second = pair(Change(False, zero_rad=((3, 1e-3),)))
    there, back = what_moved(first, second), what_moved(second, first)
    assert back.verdict == there.verdict
    assert back.chi_square == pytest.approx(there.chi_square, rel=1e-6)
    assert back.moved[0].by == pytest.approx(-there.moved[0].by, rel=1e-6)


def test_springs_solved_at_other_torques_are_the_same_springs():
    model = campaign(1)
    term = next(term for term in model.model.terms if isinstance(term, JointSpring))
    columns = np.arange(len(model.x))[model.model.columns_of(term)]
    other = JointSpring(term.joint, 0.5 * term.tau_ref_Nm, term.cubic)
    k_lin, k_cub = term.report(model.x[columns]).values
    x = model.x.copy()
    x[columns] = other.solved(k_lin, k_cub)
    terms = tuple(other if each is term else each for each in model.model.terms)
    again = replace(model, model=Model(model.model.chain, terms), x=x)
    found = what_moved(model, again)
    assert found.verdict == "unchanged"
    assert found.chi_square == pytest.approx(0.0, abs=1e-9)


def test_two_models_of_one_fit_differ_by_nothing_if_their_covariance_is_known():
    model = campaign(1)
    found = what_moved(model, shifted(model))
    assert (found.verdict, found.chi_square, found.chance) == ("unchanged", 0.0, 1.0)
    assert what_moved(model, replace(model, covariance=None)) is None


def test_what_sags_at_the_tool_is_no_tool_and_a_field_stays_out_of_it(pair):
    field = Field(((0.0,) * 6, (1.0,) * 6), (1.0,) * 6, (True,) * 6, 0.5, 1e-4)

    def with_both(model):
        for term, x in ((ToolSag("tool"), np.array([1e-4])), (field, np.full(6, 1e-4))):
            k, n = len(model.x), len(x)
            size = len(model.covariance) + n
            covariance = np.zeros((size, size))
            rest = [*range(k), *range(k + n, size)]
            covariance[np.ix_(rest, rest)] = model.covariance
            covariance[range(k, k + n), range(k, k + n)] = 1e-12
            terms = (*model.model.terms[:-1], term, model.model.terms[-1])
            order = model.model.parameter_indices(*model.model.terms[:-1])
            assert np.array_equal(order, np.arange(len(order)))
            x = np.concatenate([model.x[: len(order)], x, model.x[len(order) :]])
            inside = [*order, *range(k, k + n), *range(len(order), k), *range(k + n, size)]
            model = replace(
                model,
                model=Model(model.model.chain, terms),
                x=x,
                covariance=covariance[np.ix_(inside, inside)],
            )
        return model

    found = what_moved(*map(with_both, pair(Change(), "points")))
    assert found.verdict == "unchanged"


def test_what_moved_is_told_in_a_unit_of_its_own():
    model = campaign(1)
    twist = LinkTorsion.everywhere(context_of(model.arm))[0]
    k, columns = len(model.x), len(model.model.parameters)
    covariance = np.zeros((len(model.covariance) + 1,) * 2)
    others = np.delete(np.arange(len(covariance)), columns)
    covariance[np.ix_(others, others)] = model.covariance
    covariance[columns, columns] = 1e-14
    bent = model.bending_as([twist])
    chained = Model(bent.model.chain, (*bent.model.terms, twist))
    first, second = (
        replace(bent, model=chained, x=np.append(model.x[:k], c), covariance=covariance)
        for c in (0.0, 1e-5)
    )
    found = what_moved(first, second)
    assert [(each.kind, each.of) for each in found.moved] == [("effect", "link_torsion of forearm")]
    assert "1e-05 rad/(N m)" in found.line


# A departure that one model holds at zero.

HELD = ["delta_a_2", "delta_theta_3"]


def correlated(model, rank=60):
    """Return the model with a covariance that correlates all of it, base included."""
    count = len(model.covariance)
    root = np.random.default_rng(5).standard_normal((count, rank)) / np.sqrt(rank)
    size = np.sqrt(np.diag(model.covariance))
    return replace(model, covariance=np.outer(size, size) * (root @ root.T))


def held_at_zero(model, names):
    """Return the fit of the same readings with some departures held at zero.

    Its parameters minimise the squares of their distance from those fitted, in the information of
    that fit.
    """
    held = np.isin([parameter.name for parameter in model.model.parameters], names)
    at = np.append(~held, np.ones(6, bool))
    information = np.linalg.inv(model.covariance)
    covariance = np.linalg.inv(information[np.ix_(at, at)])
    step = covariance @ information[np.ix_(at, ~at)] @ model.x[held]
    kept = {p.name for p, dropped in zip(model.model.parameters, held, strict=True) if not dropped}
    return replace(
        model,
        model=model.model.only(kept),
        x=model.x[~held] + step[:-6],
        T_instr_base=model.T_instr_base @ motion_of_base(step[-6:]),
        covariance=covariance,
    )


def test_a_fit_differs_by_nothing_from_itself_with_departures_held_at_zero():
    free = correlated(campaign(1))
    held = held_at_zero(free, HELD)
    for first, second in ((free, held), (held, free)):
        found = differences(first, second)
        size = np.sqrt(np.diag(found.covariance))
        assert np.abs(found.values / size).max() < 1e-4
        assert np.allclose(found.covariance, differences(held, held).covariance)


def test_departures_held_at_zero_may_be_perfectly_correlated():
    model = campaign(1)
    k, other = (
        [parameter.name for parameter in model.model.parameters].index(name) for name in HELD
    )
    covariance = model.covariance.copy()
    size = np.sqrt(covariance[k, k] * covariance[other, other])
    covariance[k, other] = covariance[other, k] = size
    kept = {parameter.name for parameter in model.model.parameters} - set(HELD)
    at = np.delete(np.arange(len(covariance)), [k, other])
    held = replace(
        model,
        model=model.model.only(kept),
        x=np.delete(model.x, [k, other]),
        covariance=model.covariance[np.ix_(at, at)],
    )
    assert what_moved(replace(model, covariance=covariance), held).verdict == "unchanged"


@pytest.mark.parametrize("beyond", [0.0, 1e-13], ids=["perfectly", "all but perfectly"])
def test_what_both_models_hold_together_says_nothing(beyond):
    """Of parameters that are one in both models their difference is not an error of either."""
    first, second = campaign(1), campaign(2)
    k, other = (
        [parameter.name for parameter in first.model.parameters].index(name)
        for name in ("delta_theta_2", "delta_theta_3")
    )
    covariance = first.covariance.copy()
    size = np.sqrt(covariance[k, k] * covariance[other, other]) * (1.0 - beyond)
    covariance[k, other] = covariance[other, k] = size
    tied, free = (replace(model, covariance=covariance) for model in (first, second))
    found = what_moved(tied, free)
    assert found.verdict == "unchanged"
    assert found.dof == what_moved(first, second).dof - 1
    moved = what_moved(tied, shifted(free, delta_theta_5=3e-3))
    assert moved.line.startswith("joint zero moved: the zero of joint 5 by +")


def test_models_of_other_arms_are_refused():
    with pytest.raises(ModelError, match="different layouts"):
        what_moved(campaign(1), campaign(2, robot="ur10"))


def test_of_models_without_a_common_term_of_the_arm_only_base_and_tool_differ():
    model = campaign(1)
    frames = model.only(*(term for term in model.model.terms if "tool" in term.roles))
    found = differences(model, frames)
    assert (found.terms, len(found.x), len(found.values)) == ((), 0, 12)
    moved = what_moved(frames, frames)
    assert (moved.verdict, moved.dof) == ("not_comparable", 0)
    assert moved.line.startswith("not comparable: both fits identify no common parameter")


# What is the same in both models, and what cannot be compared.


SPRING = JointSpring(2, 80.0)


def with_effect(seed, *effects, x=(), spring=SPRING):
    """Return a campaign's model with effects of these amounts, one row of `x` each."""
    model = campaign(seed, terms=lambda arm: (*parts(arm)[::2], spring, *effects))
    values = model.x.copy()
    for effect, amounts in zip(effects, x, strict=True):
        values[model.model.parameter_indices(effect)] = amounts
    return replace(model, x=values)


SAME = [
    (SoftWindup("joint 2", 100.0, 50.0), SoftWindup("joint 2", 100.0, 50.1), (1e-4, 10.0)),
    (GearLine("joint 2", 100.0), GearLine("joint 2", 100.1), (1e-4, 0.0, 100.0)),
    (JointCompliance("joint 2", 100.0), JointCompliance("joint 2", 90.0), (1e-6,)),
    (
        GearError("joint 2", 12),
        replace(GearError("joint 2", 12), spectrum=FadingPrior(1e-4, 3.0)),
        (1e-5,) * 12,
    ),
]


@pytest.mark.parametrize(("first", "second", "x"), SAME, ids=lambda each: getattr(each, "id", None))
def test_an_effect_is_the_same_whatever_its_campaign_says_of_range_and_size(first, second, x):
    larger = np.multiply(x, 9.0) if len(x) == 12 else np.array([9.0 * x[0], *x[1:]])
    found = what_moved(with_effect(1, first, x=[x]), with_effect(2, second, x=[larger]))
    assert (f"{first.id} of joint 2", found.not_compared) == (found.moved[0].of, ())
    plausible = what_moved(
        with_effect(1), with_effect(2, spring=replace(SPRING, plausible_rad=1e-3))
    )
    assert (plausible.verdict, plausible.not_compared) == ("unchanged", ())


UNLIKE = [
    (PeriodicError("joint 2", 3.0), PeriodicError("joint 2", 5.0), (3e-4, 0.0)),
    (TransmissionError("joint 2", 200.0), TransmissionError("joint 2", 320.0), (3e-4, 0.0)),
    (GearLine("joint 2", 40.0), GearLine("joint 2", 100.0), (3e-4, 0.0, 40.0)),
    (JointCoupling("joint 3", 2, False), JointCoupling("joint 3", 1, False), (1e-3,)),
]


@pytest.mark.parametrize(("first", "second", "x"), UNLIKE)
def test_unlike_effects_of_one_name_are_not_compared_and_that_is_told(first, second, x):
    name = f"{first.id} of {first.of}"
    found = what_moved(with_effect(1, first, x=[x]), with_effect(2, second, x=[x]))
    assert (found.verdict, found.not_compared, found.only_in_one) == ("unchanged", (name,), ())
    assert found.line == f"unchanged as far as compared; not compared: {name}"
    over_time = drift([with_effect(1, first, x=[x]), with_effect(2, second, x=[x])], NAMES[:2])
    assert over_time.line == f"june to july: {found.line}"


def test_springs_of_unlike_forms_and_of_one_model_alone_are_told():
    model, linear = with_effect(1), replace(SPRING, cubic=False)
    columns = model.model.parameter_indices(SPRING)
    at = np.delete(np.arange(len(model.covariance)), columns[1])
    terms = tuple(linear if term == SPRING else term for term in model.model.terms)
    of_linear = replace(
        model,
        model=Model(model.model.chain, terms),
        x=np.delete(model.x, columns[1]),
        covariance=model.covariance[np.ix_(at, at)],
    )
    softer = shifted(of_linear, windup_2=0.5 * of_linear.x[columns[0]])
    found = what_moved(model, softer)
    assert found.line == "unchanged as far as compared; not compared: joint_spring of joint 2"
    rigid = model.only(*(term for term in model.model.terms if term != SPRING))
    found = what_moved(model, rigid)
    assert found.line == "unchanged as far as compared; in one model alone: joint_spring of joint 2"
    assert found.only_in_one == ("joint_spring of joint 2",)


def without_variance(model, *names):
    """Return the model without uncertainty of parameters; of the frames if none is named."""
    held = [parameter.name in names for parameter in model.model.parameters]
    held = np.flatnonzero([*held, *[not names] * (len(model.covariance) - len(held))])
    covariance = model.covariance.copy()
    covariance[held] = covariance[:, held] = 0.0
    return replace(model, covariance=covariance)


def test_parameters_that_differ_without_uncertainty_are_not_compared():
    model = campaign(1)
    other = without_variance(shifted(campaign(1), delta_a_2=1e-3), "delta_a_2")
    found = what_moved(without_variance(model, "delta_a_2"), other)
    assert found.line == "unchanged as far as compared; not compared: delta_a_2"
    kept = {parameter.name for parameter in model.model.parameters} - {"delta_a_2"}
    alone = [parameter.name == "delta_a_2" for parameter in model.model.parameters]
    at = np.flatnonzero(~np.array([*alone, *[False] * 6]))
    without = replace(
        model,
        model=model.model.only(kept),
        x=model.x[at[:-6]],
        covariance=model.covariance[np.ix_(at, at)],
    )
    assert what_moved(without, other).not_compared == ("delta_a_2",)
    of_zero = replace(other, x=np.where(alone, 0.0, other.x))
    assert what_moved(without, of_zero).not_compared == ()


def with_target(seed, z_m):
    model = campaign(seed, terms=lambda arm: parts(arm)[:-1])
    covariance = np.pad(model.covariance, (0, 3))
    at = len(model.covariance) + np.arange(3)
    covariance[at, at] = (1e-5) ** 2
    place_m = np.array([0.0, 0.0, z_m])
    return replace(model, targets_m=place_m, target_names=("a",), covariance=covariance)


def test_targets_without_uncertainty_and_those_beside_a_tool_are_not_compared():
    first, second = with_target(1, 0.1), with_target(2, 0.15)
    assert what_moved(first, second).verdict == "base_or_tool_moved"
    found = what_moved(*map(without_variance, (first, second)))
    assert (found.verdict, found.not_compared) == ("unchanged", ("target_a_z",))
    assert what_moved(campaign(1), second).not_compared == ("tool or targets",)


def test_a_tool_of_one_coordinate_moved_by_an_amount():
    height = Offsets((TermParameter("tool_z", "m", 1e-3),), ("tool.z",), of="tool")
    model = campaign(1, terms=lambda arm: (link_departures(arm, Tolerances()), height))
    found = what_moved(model, shifted(model, tool_z=3e-3))
    (tool,) = found.moved
    assert (tool.kind, tool.unit, tool.by) == ("tool", "m", pytest.approx(3e-3, rel=1e-2))


def test_models_that_rest_on_the_same_readings_are_told():
    june, july = campaign(1), campaign(2)
    of_june, of_july = (
        replace(model, fitted_to=model.fitted_to.model_copy(update={"readings": (text,)}))
        for model, text in ((june, "1"), (july, "2"))
    )
    assert not what_moved(of_june, of_july).same_readings
    about = of_july.fitted_to.model_copy(
        update={"readings_of_prior": of_june.fitted_to.all_readings}
    )
    found = what_moved(of_june, replace(of_july, fitted_to=about))
    assert found.same_readings
    assert found.line.startswith("unchanged as far as compared; both models rest on the same")
    assert about.all_readings == ("2", "1")


# The parameters of one arm over several campaigns.

NAMES = ("june", "july", "august")


def test_every_parameter_is_there_with_its_interval_and_what_moved_is_told():
    models = [campaign(1), campaign(2), shifted(campaign(3), delta_theta_3=1e-3)]
    found = drift(models, NAMES)
    rows = found.parameters
    assert set(rows.campaign) == set(NAMES)
    at = (rows.parameter == "delta_theta_3") & (rows.campaign == "august")
    assert rows.high[at] - rows.value[at] == pytest.approx(1.96 * rows.std[at])
    assert [step.what_moved.verdict for step in found.steps] == ["unchanged", "joint_zero_moved"]
    assert found.line.startswith("july to august: joint zero moved: the zero of joint 3")
    assert not set(rows.of) & {"tool", "base"}
    assert drift([campaign(1), campaign(2)], NAMES[:2]).line == "unchanged over 2 campaigns"


def test_an_arm_that_creeps_is_told_by_the_first_and_the_last_campaign():
    creeping = [shifted(campaign(10 + k), delta_theta_3=3e-5 * k) for k in range(8)]
    names = [f"c{k}" for k in range(8)]
    found = drift(creeping, names)
    assert {step.what_moved.verdict for step in found.steps} == {"unchanged"}
    assert (found.overall.first, found.overall.second) == ("c0", "c7")
    assert found.line.startswith("over all, c0 to c7: joint zero moved: the zero of joint 3")
    still = drift([campaign(10 + k) for k in range(8)], names)
    assert still.line == "unchanged over 8 campaigns"
    assert drift(creeping[:2], names[:2]).overall is None


def test_bases_and_tools_of_the_campaigns_of_a_group_are_not_of_the_arm():
    def of_group(arm):
        of_second = (OfCampaign(frame, 1, "second") for frame in (base_frame(), tool_frame()))
        return (*parts(arm), *of_second)

    found = drift([campaign(k, terms=of_group) for k in (1, 2)], NAMES[:2])
    assert not {of.partition("@")[0] for of in found.parameters.of} & {"tool", "base"}


@pytest.mark.slow
def test_one_picture_shows_all(tmp_path):
    models = [campaign(1), campaign(2), shifted(campaign(3), delta_theta_3=1e-3)]
    write_drift(drift(models, NAMES), tmp_path, "drift", 80)
    assert {path.name for path in tmp_path.iterdir()} == {"drift.svg", "drift.pdf", "drift.png"}


def test_numbers_at_the_axes_lie_in_the_picture_and_over_no_other_panel(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(draw, "write_figure", lambda figure, *_: drawn.append(figure))
    models = [campaign(1), campaign(2), shifted(campaign(3), delta_theta_3=1e-3, delta_a_5=1e-6)]
    write_drift(drift(models, NAMES), tmp_path, "drift", 80)
    (figure,) = drawn
    figure.canvas.draw()
    frames = [axes.get_window_extent() for axes in figure.axes]
    for axes in figure.axes:
        assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2", "3"]
        for label in (*axes.get_xticklabels(), *axes.get_yticklabels(), axes.title):
            box = label.get_window_extent()
            assert box.x0 >= 0.0
            others = (f for f in frames if f is not frames[figure.axes.index(axes)])
            assert not any(box.overlaps(frame) for frame in others)


@pytest.mark.parametrize(
    ("models", "names", "message"),
    [
        ([campaign(1)], ("june",), "drift over a single model"),
        ([campaign(1), replace(campaign(2), covariance=None)], NAMES[:2], "covariance"),
        ([campaign(1), campaign(2)], ("june", "june"), "two models of the same name"),
        ([campaign(1), campaign(2, robot="ur10")], NAMES[:2], "different layouts"),
        ([campaign(1), campaign(2)], NAMES[:1], "names that are not as many as the models"),
    ],
)
def test_what_cannot_be_drawn_is_refused(models, names, message):
    with pytest.raises(ModelError, match=message):
        drift(models, names)


@pytest.mark.slow
def test_intervals_hold_what_a_seed_of_noise_moves():
    found = drift([campaign(k) for k in range(10, 30)], [f"c{k}" for k in range(20)])
    rows = found.parameters
    at = rows.parameter == "delta_theta_4"
    spread = np.std(rows.value[at])
    assert spread == pytest.approx(np.mean(rows.std[at]), rel=0.5)
