"""How two fitted models differ: parameter by parameter, and in the poses that they predict.

Parameters of a calibration are correlated: two good models may differ by many standard
uncertainties in some of them and yet predict the same poses. So models are judged by their
predictions. Base and target sit differently in every campaign: one constant motion of the base and
one of the tool are fitted and removed first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, homogeneous, nearest_rotation, rms
from pa10cal.evaluation.parameter_differences import refuse_other_layout
from pa10cal.evaluation.what_moved import NOTHING_OF_ARM, what_moved
from pa10cal.fit.fitted import FLANGE, TOOL_FRAME, Fitted, predicting_model
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward, states_at
from pa10cal.fit.plain_arm import arm_to_plain
from pa10cal.fit.validity import AngleCoverage, overlaps
from pa10cal.frame.point_fits import cross_matrix
from pa10cal.results import comparison as results
from pa10cal.results.calibration import UNRESERVED
from pa10cal.rules import COMPARED

#: Numbers of an arm beside its layout, in which the arms of two models may differ.
_NOT_OF_LAYOUT = ("limits_rad", "gear_ratio", "torque_limit_Nm", "mass_kg", "com_m")
#: Parts of an arm that are no numbers: compared as the file of a model describes them.
_AS_IN_FILE = ("coupling", "controller")
#: Postures compared, and the seed of their draw (computing).
POSTURES, SEED = 400, 1
#: Whole turns that are tried between angles that two models have seen, at most (computing).
_MOST_TURNS = 4
#: Steps of the fit of base and tool, at most, and the largest that ends it [m, rad] (computing).
_GAUSS_NEWTON_STEPS, _SMALL_STEP = 30, 1e-12
#: Weight of no rotation of the base where poses leave its rotation open (computing).
_NO_ROTATION = 1e-9


def compare_models(
    first: FittedModel, second: FittedModel, names: tuple[str, str] = ("first", "second")
) -> results.ComparisonRecord:
    """Compare two models of arms of the same layout, under their names.

    Raises:
        ModelError: when the arms differ in layout, or a model with springs does not know the
            weights that load them.
    """
    refuse_other_layout(first.arm, second.arm, names)
    predicting = predicting_model(first), predicting_model(second)
    common = _common_intervals(*predicting)
    q = _postures(common)
    # Postures alternate between no load and the heaviest at which no model extrapolates.
    heaviest = [max(m.fitted_to.loads_N, default=0.0) for m in (first, second) if m.fitted_to]
    common_load_N = min(heaviest) if len(heaviest) == 2 else 0.0
    loads_N = (0.0, common_load_N) if common_load_N > 0.0 else (0.0,)
    load_N = np.resize(loads_N, len(q))  # repeats them in turn
    compared = (FLANGE, TOOL_FRAME) if len(q) else ()
    frames = {frame: _compared_frame(*predicting, frame, q, load_N) for frame in compared}
    if frames:
        agree, line = _judged(frames[FLANGE], predicting, names)
    else:
        agree, line = None, _no_common_positions(common, *predicting)
    found = what_moved(first, second)
    if agree and found is not None and found.same_readings:
        line += "; both rest on the same readings, so that they may differ by less than is expected"
    if agree and found is not None and found.verdict not in NOTHING_OF_ARM:
        line += "; a part of the arm moved, which changes poses by less than that"
    return results.ComparisonRecord(
        first=_about(first, second, names[0]),
        second=_about(second, first, names[1]),
        described_otherwise=_described_otherwise(first, second),
        parameters=_parameters(first, second),
        postures=len(q),
        loads_N=loads_N,
        frames=frames,
        agree=agree,
        line=line,
        what_moved=found,
    )


def _described_otherwise(first: FittedModel, second: FittedModel) -> tuple[str, ...]:
    """Return the fields of arm and payload that differ between the models' descriptions."""
    of_arm = _differing(first.arm, second.arm, _NOT_OF_LAYOUT)
    if first.payload is None or second.payload is None:
        of_payload = [] if first.payload is second.payload else ["payload"]
    else:
        # For a group, the payload of its first campaign is compared.
        names = [field.name for field in fields(Payload) if field.name != "of_campaigns"]
        differing = _differing(first.payload, second.payload, names)
        of_payload = [f"payload.{name}" for name in differing]
    plain = [arm_to_plain(model.arm) for model in (first, second)]
    in_file = [name for name in _AS_IN_FILE if plain[0].get(name) != plain[1].get(name)]
    return (*of_arm, *of_payload, *in_file)


def _differing(one: object, other: object, names: Sequence[str]) -> list[str]:
    """Return which of these attributes differ between two descriptions."""
    return [name for name in names if not _same(getattr(one, name), getattr(other, name))]


def _same(mine: object, theirs: object) -> bool:
    if mine is None or theirs is None:
        return mine is theirs
    one, other = np.asarray(mine, dtype=float), np.asarray(theirs, dtype=float)
    return np.allclose(one, other, rtol=COMPARED.same, atol=COMPARED.same, equal_nan=True)


def _about(model: FittedModel, other: FittedModel, name: str) -> results.ComparedModel:
    fitted = model.fitted_to
    theirs = {(term.id, term.of) for term in other.model.terms}
    return results.ComparedModel(
        name=name,
        robot=model.arm.name,
        campaign=fitted.campaign if fitted else None,
        calibration=fitted.calibration if fitted else None,
        grade=model.grade or None,
        health=(fitted.health or None) if fitted else None,
        covariance=model.covariance is not None,
        only_here=tuple(
            f"{term.id} of {term.of}"
            for term in model.model.terms
            if (term.id, term.of) not in theirs
        ),
    )


def _parameters(first: FittedModel, second: FittedModel) -> results.ParameterRows:
    """Return every parameter of two models, in the order of the first."""
    in_first, in_second = _estimates(first), _estimates(second)
    # Each model counts rotations of the tool from the orientation that its own fit began with.
    same_start = np.allclose(first.R_ee_target, second.R_ee_target, rtol=0, atol=COMPARED.same)
    absent = _Estimate(np.nan, np.nan, typical=np.nan)  # counts as not determined
    rows = []
    for key in dict.fromkeys((*in_first, *in_second)):
        term, of, parameter, unit = key
        one, other = in_first.get(key, absent), in_second.get(key, absent)
        # The tool of a campaign of a group is called tool@ and the campaign.
        of_tool = of.partition("@")[0] == "tool"
        comparable = same_start or not (of_tool and unit == "rad")
        difference = other.value - one.value if comparable else np.nan
        expected = np.hypot(one.std, other.std)
        determined = one.determined and other.determined
        rows.append(
            {
                "term": term,
                "of": of,
                "parameter": parameter,
                "unit": unit,
                "first": one.value,
                "first_std": one.std,
                "second": other.value,
                "second_std": other.std,
                "difference": difference,
                "over_u": difference / expected if determined else np.nan,
            }
        )
    return results.ParameterRows.model_validate(rows)


class _Estimate(NamedTuple):
    """A reported parameter of a fitted model."""

    value: float
    std: float  # its standard uncertainty
    typical: float  # its typical size

    @property
    def determined(self) -> bool:
        """Return whether the uncertainty is more than rounding.

        It is only rounding where no pose determines the parameter, or it is at an end of its range.
        """
        return self.std > COMPARED.same * max(self.typical, abs(self.value))


def _estimates(model: FittedModel) -> dict[tuple[str, str, str, str], _Estimate]:
    """Return the reported parameters of a model by id and place of the term, name and unit."""
    return {
        (term.id, term.of, parameter.name, parameter.unit): _Estimate(
            value, std, abs(parameter.scale)
        )
        for term, parameter, value, std in model.every_reported()
    }


def _no_common_positions(common: Sequence[Array], first: Fitted, second: Fitted) -> str:
    """Return why two models cannot be judged that have no common positions of some joints."""
    without = [joint for joint, intervals in enumerate(common) if not len(intervals)]
    beyond_limits = [joint for joint in without if len(_known_to_both(first, second, joint))]
    not_seen = [joint for joint in without if joint not in beyond_limits]
    turned = [joint for joint in not_seen if _whole_turns_apart(first, second, joint)]
    positions = "positions" if any(first.arm.prismatic[not_seen]) else "angles"
    because = []
    if not_seen:
        because.append(f"they have seen no common {positions} of {_joints(not_seen)}")
    if turned:
        because.append(f"those of {_joints(turned)} are whole turns apart")
    if beyond_limits:
        because.append(
            f"no position of {_joints(beyond_limits)} that both know is within the limits of both "
            "arms"
        )
    return f"whether the models agree cannot be judged: {'; '.join(because)}"


def _joints(joints: Sequence[int]) -> str:
    """Return the names of joints, numbered from 0, in words."""
    return f"joint{'s' if len(joints) > 1 else ''} {', '.join(str(joint + 1) for joint in joints)}"


def _whole_turns_apart(first: Fitted, second: Fitted, joint: int) -> bool:
    """Return whether what both models have seen of a joint, from 0, overlaps modulo a turn."""
    one, other = first.seen, second.seen
    if first.arm.prismatic[joint] or one is None or other is None:
        return False
    turns_rad = 2.0 * np.pi * np.arange(-_MOST_TURNS, _MOST_TURNS + 1)
    shifted = (one.intervals[joint] + turn_rad for turn_rad in turns_rad)
    return any(len(overlaps(each, other.intervals[joint])) for each in shifted)


def _judged(
    flange: results.ComparedFrame, models: tuple[Fitted, Fitted], names: tuple[str, str]
) -> tuple[bool | None, str]:
    """Return whether two models agree, and the sentence that says so."""
    apart = (
        f"their flanges differ by {flange.remaining_rms_mm:.3f} mm rms "
        f"({flange.remaining_peak_mm:.3f} mm at most) and {flange.remaining_deg:.4f} deg, base and "
        "tool taken off"
    )
    if flange.chance is None:
        without = [name for name, m in zip(names, models, strict=True) if m.covariance is None]
        return None, (
            "whether the models agree cannot be judged: the covariance is missing of "
            f"{' and of '.join(without)}; {apart}"
        )
    agree = flange.chance >= COMPARED.least_chance
    verdict = (
        "the models agree within their uncertainty"
        if agree
        else "the models differ by more than their uncertainty"
    )
    doubtful = [
        f"{name} is graded {m.grade}"
        for name, m in zip(names, models, strict=True)
        if m.grade and m.grade not in UNRESERVED
    ]
    but = f"; mind that {' and '.join(doubtful)}" if doubtful else ""
    return agree, (
        f"{verdict}: {apart}, where {flange.expected_mm:.3f} mm and {flange.expected_deg:.4f} deg "
        f"are expected{but}"
    )


# Differences in the predicted poses of a frame, and those expected of the covariances.


def _common_intervals(first: Fitted, second: Fitted) -> list[Array]:
    """Return for each joint the intervals (m, 2) of positions at which both models are valid.

    They are within the limits of both arms. Where the file of a model lacks the limits of a joint,
    they are taken to be a turn to either side, or what was seen of it if that is more; of a joint
    that slides, what the poses visited, or a metre to either side, of zero or of the limit that
    there is.
    """
    common = []
    for joint in range(first.arm.n):
        unlimited = _without_limits(first, second, joint)
        ranges = [arm.joint_ranges_rad[joint] for arm in (first.arm, second.arm)]
        one, other = (np.where(np.isfinite(each), each, unlimited) for each in ranges)
        within = overlaps(one[None], other[None])
        known = [_known_to_both(first, second, joint, low, high) for low, high in within]
        common.append(_with_ends(np.concatenate([np.zeros((0, 2)), *known])))
    return common


def _without_limits(first: Fitted, second: Fitted, joint: int) -> Array:
    """Return the lowest and highest position (2,) of a joint, from 0, that has no limits."""
    if first.arm.prismatic[joint]:
        return np.array([-np.inf, np.inf])
    seen = [each.intervals[joint].ravel() for each in _coverages(first, second)]
    positions = np.concatenate([[-2.0 * np.pi, 2.0 * np.pi], *seen])
    return np.array([positions.min(), positions.max()])


def _known_to_both(
    first: Fitted, second: Fitted, joint: int, low: float = -np.inf, high: float = np.inf
) -> Array:
    """Return the intervals (m, 2) of a joint, from 0, at which both models hold, in a range."""
    if not first.arm.prismatic[joint] and not np.isfinite([low, high]).all():
        # Angles modulo a turn are repeated turn by turn, as often as there are.
        low, high = 2.0 * np.pi * _MOST_TURNS * np.array([-1.0, 1.0])
    intervals = np.array([[low, high]])
    for coverage in _coverages(first, second):
        intervals = overlaps(intervals, coverage.intervals_within(joint, low, high))
    return intervals


def _coverages(first: Fitted, second: Fitted) -> list[AngleCoverage]:
    """Return where two models hold: by what they have seen, and where they do not fall back."""
    within = [model.falls_back.within for model in (first, second) if model.falls_back]
    return [*(model.seen for model in (first, second) if model.seen is not None), *within]


def _with_ends(intervals: Array) -> Array:
    """Return intervals (m, 2) [m] with ends in place of infinite ones, a metre from the others."""
    low, high = intervals.T
    other_of_low = np.where(np.isfinite(high), high, 0.0)
    other_of_high = np.where(np.isfinite(low), low, 0.0)
    return np.column_stack(
        [
            np.where(np.isfinite(low), low, other_of_low - 1.0),
            np.where(np.isfinite(high), high, other_of_high + 1.0),
        ]
    )


def _postures(common: Sequence[Array]) -> Array:
    """Return postures (P, n) drawn from the intervals of each joint; empty where one has none.

    Coverage is known joint by joint, so the joints are drawn independently.
    """
    if not all(map(len, common)):
        return np.zeros((0, len(common)))
    rng = np.random.default_rng(SEED)
    return np.column_stack([_drawn_from(intervals, rng) for intervals in common])


def _drawn_from(intervals: Array, rng: np.random.Generator) -> Array:
    """Return positions (P,) drawn uniformly from intervals (m, 2), or from points if all are."""
    lengths = intervals[:, 1] - intervals[:, 0]
    total = lengths.sum()
    chances = lengths / total if total > 0.0 else None
    chosen = rng.choice(len(intervals), POSTURES, p=chances)
    return np.asarray(intervals[chosen, 0] + rng.random(POSTURES) * lengths[chosen])


def _predicted(
    model: Fitted, frame: str, q: Array, load_N: Array, temperature_C: float | None
) -> tuple[Array, Array | None]:
    """Predict a frame in P postures.

    Returns:
        Its poses (P, 4, 4) [m]; the error modes (P, 6, k), motions of the frame by k independent
        errors of unit variance, whose outer product is the covariance, or None where that is not
        known.
    """
    forward = Forward.of(model, frame)
    states = forward.states(states_at(model, q, load_N, temperature_C=temperature_C))
    end = forward.end(states)
    error_modes = None
    if model.covariance is not None:
        variances, axes = np.linalg.eigh(forward.covariance)
        independent = axes * np.sqrt(np.maximum(variances, 0.0))
        error_modes = forward.by_parameters(states, end) @ independent
    return end.T @ forward.T_end_frame, error_modes


def _compared_frame(
    first: Fitted, second: Fitted, frame: str, q: Array, load_N: Array
) -> results.ComparedFrame:
    """Compare one frame in postures (P, n) under loads (P,)."""
    # At the mean of the temperatures of both fits; where only one knows its temperature, each at
    # that of its own fit.
    of_fits = [m.fitted_to.temperature_C for m in (first, second) if m.fitted_to]
    known_C = [each for each in of_fits if each is not None]
    temperature_C = None if len(known_C) < 2 else float(np.mean(known_C))
    T_one, modes_one = _predicted(first, frame, q, load_N, temperature_C)
    T_other, modes_other = _predicted(second, frame, q, load_N, temperature_C)
    apart_mm, apart_deg = _apart(T_one, T_other)
    T_base, T_tool = _moved_onto(T_other, T_one)
    T_moved = T_base @ T_other @ T_tool
    remaining_mm, remaining_deg = _apart(T_one, T_moved)
    base_and_tool_mm, _ = _apart(T_moved, T_other)
    expected_mm = expected_deg = chance = None
    if modes_one is not None and modes_other is not None:
        modes_moved = _modes_moved(modes_other, T_other, T_base, T_tool)
        of_each = [_without_base_and_tool(modes_one, T_one)]
        of_each += [_without_base_and_tool(modes_moved, T_moved)]
        of_positions, of_rotations = map(np.hstack, zip(*of_each, strict=True))
        expected_m, chance_m = _expected(of_positions, 1e-3 * remaining_mm)
        expected_rad, chance_rad = _expected(of_rotations, np.radians(remaining_deg))
        expected_mm, expected_deg = 1e3 * expected_m, float(np.degrees(expected_rad))
        chances = [each for each in (chance_m, chance_rad) if each is not None]
        chance = min([1.0, *(len(chances) * each for each in chances)])  # Bonferroni
    return results.ComparedFrame(
        rms_mm=rms(apart_mm),
        peak_mm=float(apart_mm.max()),
        orientation_deg=rms(apart_deg),
        base_and_tool_mm=rms(base_and_tool_mm),
        remaining_rms_mm=rms(remaining_mm),
        remaining_peak_mm=float(remaining_mm.max()),
        remaining_deg=rms(remaining_deg),
        expected_mm=expected_mm,
        expected_deg=expected_deg,
        chance=chance,
    )


def _apart(T: Array, T_other: Array) -> tuple[Array, Array]:
    """Return distances [mm] and angles [deg] between poses."""
    turn = Rotation.from_matrix(np.swapaxes(T[:, :3, :3], 1, 2) @ T_other[:, :3, :3])
    distance = np.linalg.norm(T[:, :3, 3] - T_other[:, :3, 3], axis=1)
    return 1e3 * distance, np.degrees(turn.magnitude())


def _moved_onto(T: Array, T_wanted: Array) -> tuple[Array, Array]:
    """Return the motions of base and tool (4, 4) that move poses onto others, least squares.

    The poses moved are the first @ `T` @ the second. Positions determine the base and the tool's
    offset, then orientations the tool's rotation.
    """
    base, tool = _base_alone(T, T_wanted), np.eye(4)
    for _ in range(_GAUSS_NEWTON_STEPS):
        moved = base @ T @ tool
        missing_m = (T_wanted - moved)[:, :3, 3].ravel()
        step: Array = np.linalg.lstsq(_by_base_and_tool(moved), missing_m)[0].astype(float)
        rotation = Rotation.from_rotvec(step[3:6]).as_matrix()
        base = homogeneous(rotation, step[:3]) @ base
        tool = tool @ homogeneous(np.eye(3), step[6:])
        if np.abs(step).max() < _SMALL_STEP:
            break
    moved = base @ T
    missing = Rotation.from_matrix(np.swapaxes(moved[:, :3, :3], 1, 2) @ T_wanted[:, :3, :3])
    return base, tool @ homogeneous(missing.mean().as_matrix(), np.zeros(3))


def _base_alone(T: Array, T_wanted: Array) -> Array:
    """Return the motion of the base (4, 4) from which steps lead poses onto others.

    It turns positions, and the axes of rotations from the first pose, onto those wanted (Kabsch).
    A tool elsewhere in the hand makes that inexact, not far off.
    """
    p_m, p_wanted_m = T[:, :3, 3], T_wanted[:, :3, 3]
    middle_m, middle_wanted_m = p_m.mean(axis=0), p_wanted_m.mean(axis=0)
    products = (p_wanted_m - middle_wanted_m).T @ (p_m - middle_m)
    products += _axes_from_first(T_wanted).T @ _axes_from_first(T)
    rotation = nearest_rotation(products + _NO_ROTATION * np.eye(3))
    return homogeneous(rotation, middle_wanted_m - rotation @ middle_m)


def _axes_from_first(T: Array) -> Array:
    """Return the axes of rotations from the first pose to P poses, (P, 3), times twice the sine."""
    R = T[:, :3, :3]
    return np.asarray(np.cross(R[:1], R, axis=1).sum(axis=2))


def _modes_moved(modes: Array, T: Array, T_base: Array, T_tool: Array) -> Array:
    """Return error modes (P, 6, k) of poses T moved with base and tool, as `_moved_onto` has them.

    The frame's origin is elsewhere on the tool, and all is seen along the axes of another base.
    """
    lever_m = T[:, :3, :3] @ T_tool[:3, 3]
    velocities, rotations = modes[:, :3], modes[:, 3:]
    velocities = velocities - cross_matrix(lever_m) @ rotations
    return np.concatenate([T_base[:3, :3] @ velocities, T_base[:3, :3] @ rotations], axis=1)


def _by_base_and_tool(T: Array) -> Array:
    """Return the derivative of positions by motions of base and tool offset, (3 P, 9)."""
    ones = np.broadcast_to(np.eye(3), (len(T), 3, 3))
    columns = np.concatenate([ones, -cross_matrix(T[:, :3, 3]), T[:, :3, :3]], axis=2)
    return columns.reshape(-1, 9)


def _without_base_and_tool(motions: Array, T: Array) -> tuple[Array, Array]:
    """Return residuals of motions (P, 6, k) after a fit of base and tool.

    Of positions and of orientations, (3 P, k) each; see `_moved_onto`.
    """
    count = motions.shape[2]
    positions = motions[:, :3].reshape(-1, count)
    columns = _by_base_and_tool(T)
    fitted, *_ = np.linalg.lstsq(columns, positions)
    rotations = motions[:, 3:] - fitted[3:6]
    R = T[:, :3, :3]
    rotations = rotations - R @ (np.swapaxes(R, 1, 2) @ rotations).mean(axis=0)
    return positions - columns @ fitted, rotations.reshape(-1, count)


def _expected(error_modes: Array, remaining: Array) -> tuple[float, float | None]:
    """Return the expected rms of differences, and the probability of larger ones than these (P,).

    The probability is None where both are rounding: differences that base and tool explain in every
    posture, as those of orientation do where all joints slide.

    The outer product of `error_modes` (3 P, k) is their covariance C. Their sum of squares S is a
    weighted sum of chi-square variables with mean tr C and variance 2 tr C²; S tr C / tr C² is
    taken as chi-square with (tr C)² / tr C² degrees of freedom (Satterthwaite).
    """
    inner = error_modes.T @ error_modes  # it has the traces of C
    trace, trace_of_square = float(np.trace(inner)), float(np.sum(inner**2))
    sum_of_squares = float(np.sum(remaining**2))
    expected = float(np.sqrt(trace / len(remaining)))
    if max(rms(remaining), expected) < COMPARED.same:
        return expected, None
    if trace_of_square == 0.0:
        return expected, float(sum_of_squares == 0.0)
    dof, scaled = trace**2 / trace_of_square, sum_of_squares * trace / trace_of_square
    return expected, float(chdtrc(dof, scaled))
