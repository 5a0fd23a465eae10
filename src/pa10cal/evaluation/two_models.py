"""How two fitted models differ: parameter by parameter, and where they put the robot.

Parameters of a calibration go together: two good models may differ by many standard uncertainties
in some of them and put the robot in the same places. So models are judged by their predictions.
Where the base stands, and how the target sits on the flange, is of each campaign; what a constant
motion on either side of the arm explains is taken off before models are judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.evaluation.what_moved import what_moved
from pa10cal.fit.fitted import FLANGE, TOOL_FRAME
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward, states_at
from pa10cal.frame.rigid_fit import cross_matrix
from pa10cal.results import comparison as results
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import COMPARED

#: Fields of an arm that make its layout; the others do not move a rigid arm.
_LAYOUT = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
_FRAMES = ("T_base_row1", "T_row_n_ee")
_OTHERS = ("limits_rad", "gear_ratio", "torque_limit_Nm", "mass_kg", "com_m")


def compare_models(
    first: FittedModel, second: FittedModel, names: tuple[str, str] = ("first", "second")
) -> results.ComparisonRecord:
    """Compare two models of arms of the same layout, under their names.

    Raises:
        ModelError: when the arms differ in layout, or a model with springs does not know the
            weights that load them.
    """
    _refuse_other_layout(first.arm, second.arm, names)
    q = _postures(first, second)
    # Loads of the postures, in turn: none, and the heaviest that both have seen.
    heaviest = [max(m.fitted_to.loads_N, default=0.0) for m in (first, second) if m.fitted_to]
    most_N = min(heaviest) if len(heaviest) == 2 else 0.0
    loads_N = (0.0, most_N) if most_N > 0.0 else (0.0,)
    load_N = np.resize(loads_N, len(q))
    compared = (FLANGE, TOOL_FRAME) if len(q) else ()
    frames = {frame: _compared_frame(first, second, frame, q, load_N) for frame in compared}
    agree, line = _judged(frames, (first, second), names)
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
        what_moved=what_moved(first, second),
    )


def _refuse_other_layout(one: Arm, other: Arm, names: tuple[str, str]) -> None:
    differs = [
        f"{word}: {getattr(one, name)!r} and {getattr(other, name)!r}"
        for word, name in (("joints", "n"), ("convention", "convention"))
        if getattr(one, name) != getattr(other, name)
    ]
    if not differs:
        for name in _LAYOUT:
            mine, theirs = (np.asarray(getattr(arm, name), dtype=float) for arm in (one, other))
            differs += [
                f"{name} of row {row + 1}: {mine[row]:g} and {theirs[row]:g}"
                for row in np.flatnonzero(~(np.abs(mine - theirs) <= COMPARED.same))
            ]
        differs += [name for name in _FRAMES if not _same(getattr(one, name), getattr(other, name))]
    if differs:
        more = f", and {len(differs) - 3} more" if len(differs) > 3 else ""
        where = f"{names[0]} ({one.name}), {names[1]} ({other.name})"
        raise ModelError(
            "models of arms of different layouts are not compared",
            where=where,
            value="; ".join(differs[:3]) + more,
            allowed="two models of the same arm",
            remedy="give two models whose nominal rows are the same",
        )


def _described_otherwise(first: FittedModel, second: FittedModel) -> tuple[str, ...]:
    pairs = {name: (getattr(first.arm, name), getattr(second.arm, name)) for name in _OTHERS}
    payloads = first.payload, second.payload
    if None in payloads:
        pairs["payload"] = payloads
    else:
        # Of the campaigns of a group the first stands for it.
        names = [each.name for each in fields(Payload) if each.name != "of_campaigns"]
        pairs |= {f"payload.{name}": tuple(getattr(p, name) for p in payloads) for name in names}
    return tuple(name for name, pair in pairs.items() if not _same(*pair))


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
    mine, theirs = (
        {
            (term.id, term.of, each.name, each.unit): (value, std, abs(each.scale))
            for term, each, value, std in model.every_reported()
        }
        for model in (first, second)
    )
    # Turns of the tool count from the orientation that their own fit began with; the frames show
    # the whole.
    began_alike = np.allclose(first.R_ee_target, second.R_ee_target, rtol=0, atol=COMPARED.same)
    rows = []
    for key in dict.fromkeys((*mine, *theirs)):
        term, of, parameter, unit = key
        (x, u, scale), (y, v, size) = (known.get(key, (np.nan,) * 3) for known in (mine, theirs))
        difference = y - x if began_alike or (of, unit) != ("tool", "rad") else np.nan
        # A parameter that no pose determines stays where it began, and one at the end of its range
        # there: their uncertainties are rounding.
        determined = u > COMPARED.same * max(scale, abs(x)) and v > COMPARED.same * max(
            size, abs(y)
        )
        rows.append(
            {
                "term": term,
                "of": of,
                "parameter": parameter,
                "unit": unit,
                "first": x,
                "first_std": u,
                "second": y,
                "second_std": v,
                "difference": difference,
                "over_u": difference / np.hypot(u, v) if determined else np.nan,
            }
        )
    return results.ParameterRows.model_validate(rows)


def _judged(
    frames: Mapping[str, results.ComparedFrame],
    models: tuple[FittedModel, FittedModel],
    names: tuple[str, str],
) -> tuple[bool | None, str]:
    """Return whether two models agree, and the sentence that says so."""
    if not frames:
        return None, (
            "whether the models agree cannot be judged: there is a joint of which they have seen "
            "no common angles"
        )
    flange = frames[FLANGE]
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


# How far apart two fitted models put a frame of the robot, and how far they should.

#: Postures compared, and the seed of their draw (computing).
POSTURES, SEED = 400, 1
#: Steps along the range of a joint in which angles seen by both are looked for (computing).
_STEPS = 3601
#: Refinements of base and tool: each squares what is left of a wrong one (computing).
_REFINED = 6


def _postures(first: FittedModel, second: FittedModel) -> Array:
    """Return postures (P, n) drawn from the joint angles in which both models hold.

    There is none where both have seen no common angle of some joint.
    """
    arm = first.arm
    low, high = np.nan_to_num(arm.joint_ranges_rad, posinf=2 * np.pi, neginf=-2 * np.pi).T
    grid = np.linspace(low, high, _STEPS)
    common = np.ones_like(grid, dtype=bool)
    for model in (first, second):
        for where in (model.seen, model.falls_back.within if model.falls_back else None):
            common &= True if where is None else where.each(grid)
    if not common.any(axis=0).all():
        return np.zeros((0, arm.n))
    rng = np.random.default_rng(SEED)
    drawn = [
        rng.choice(angles[seen], POSTURES) for angles, seen in zip(grid.T, common.T, strict=True)
    ]
    return np.column_stack(drawn)


def _predicted(
    model: FittedModel, frame: str, q: Array, load_N: Array, temperature_C: float | None
) -> tuple[Array, Array | None]:
    """Predict a frame in P postures.

    Returns:
        Its poses (P, 4, 4) [m], and its motions (P, 6, k) under k independent causes of standard
        size one; None where the covariance is not known.
    """
    forward = Forward.of(model, frame)
    states = forward.states(states_at(model, q, load_N, temperature_C=temperature_C))
    end = forward.end(states)
    noise = None
    if model.covariance is not None:
        variances, axes = np.linalg.eigh(forward.covariance)
        noise = forward.by_parameters(states, end) @ (axes * np.sqrt(np.maximum(variances, 0.0)))
    return end.T @ forward.T_end_frame, noise


def _compared_frame(
    first: FittedModel, second: FittedModel, frame: str, q: Array, load_N: Array
) -> results.ComparedFrame:
    """Compare one frame in postures (P, n) under loads (P,)."""
    # The temperature between those of both fits.
    of_fits = [m.fitted_to.temperature_C for m in (first, second) if m.fitted_to]
    known_C = [each for each in of_fits if each is not None]
    temperature_C = None if len(known_C) < 2 else float(np.mean(known_C))
    T_one, noise_one = _predicted(first, frame, q, load_N, temperature_C)
    T_other, noise_other = _predicted(second, frame, q, load_N, temperature_C)
    apart_mm, apart_deg = _apart(T_one, T_other)
    moved = _base_and_tool_fitted(T_other, T_one)
    left_mm, left_deg = _apart(T_one, moved)
    explained_mm, _ = _apart(moved, T_other)
    expected_mm = expected_deg = chance = None
    if noise_one is not None and noise_other is not None:
        noise = np.concatenate([noise_one, noise_other], axis=2)
        by_place, by_turn = _without_base_and_tool(noise, T_one)
        expected_m, chance_m = _expected(by_place, 1e-3 * left_mm)
        expected_rad, chance_rad = _expected(by_turn, np.radians(left_deg))
        expected_mm, expected_deg = 1e3 * expected_m, float(np.degrees(expected_rad))
        chances = chance_m, chance_rad
        chance = min(1.0, len(chances) * min(chances))
    return results.ComparedFrame(
        rms_mm=_rms(apart_mm),
        peak_mm=float(apart_mm.max()),
        orientation_deg=_rms(apart_deg),
        base_and_tool_mm=_rms(explained_mm),
        remaining_rms_mm=_rms(left_mm),
        remaining_peak_mm=float(left_mm.max()),
        remaining_deg=_rms(left_deg),
        expected_mm=expected_mm,
        expected_deg=expected_deg,
        chance=chance,
    )


def _apart(T: Array, T_other: Array) -> tuple[Array, Array]:
    """Return distances [mm] and angles [deg] between poses."""
    turn = Rotation.from_matrix(np.swapaxes(T[:, :3, :3], 1, 2) @ T_other[:, :3, :3])
    distance = np.linalg.norm(T[:, :3, 3] - T_other[:, :3, 3], axis=1)
    return 1e3 * distance, np.degrees(turn.magnitude())


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _base_and_tool_fitted(T: Array, T_wanted: Array) -> Array:
    """Return poses carried to others by one motion of the base and one of what the flange carries.

    Places determine the base and where the frame sits on the flange, orientations how it is turned.
    """
    for _ in range(_REFINED):
        step, *_ = np.linalg.lstsq(_by_base_and_tool(T), (T_wanted - T)[:, :3, 3].ravel())
        base, offset = np.eye(4), np.eye(4)
        base[:3, :3] = Rotation.from_rotvec(step[3:6]).as_matrix()
        base[:3, 3], offset[:3, 3] = step[:3], step[6:]
        T = base @ T @ offset
    turn = np.eye(4)
    missing = np.swapaxes(T[:, :3, :3], 1, 2) @ T_wanted[:, :3, :3]
    turn[:3, :3] = Rotation.from_matrix(missing).mean().as_matrix()
    moved: Array = T @ turn
    return moved


def _by_base_and_tool(T: Array) -> Array:
    """Return how places follow motions of the base and offsets of the tool, (3 P, 9)."""
    ones = np.broadcast_to(np.eye(3), (len(T), 3, 3))
    columns = np.concatenate([ones, -cross_matrix(T[:, :3, 3]), T[:, :3, :3]], axis=2)
    return columns.reshape(-1, 9)


def _without_base_and_tool(motions: Array, T: Array) -> tuple[Array, Array]:
    """Return what base and tool leave of motions (P, 6, k): places and orientations, (3 P, k)."""
    count = motions.shape[2]
    places = motions[:, :3].reshape(-1, count)
    columns = _by_base_and_tool(T)
    fitted, *_ = np.linalg.lstsq(columns, places)
    turns = motions[:, 3:] - fitted[3:6]
    R = T[:, :3, :3]
    turns = turns - R @ (np.swapaxes(R, 1, 2) @ turns).mean(axis=0)
    return places - columns @ fitted, turns.reshape(-1, count)


def _expected(noise: Array, left: Array) -> tuple[float, float]:
    """Return the rms size expected of differences, and the chance of those that are left.

    By differences (3 P, k) under k independent causes of standard size one, and those found (P,).
    Their sum of squares is a weighted sum of chi-square variables; one chi-square of the same mean
    and variance stands for it (Satterthwaite).
    """
    square = noise.T @ noise
    mean, spread = float(np.trace(square)), float(np.sum(square**2))
    found = float(np.sum(left**2))
    expected = float(np.sqrt(mean / len(left)))
    if spread == 0.0:
        return expected, float(found == 0.0)
    return expected, float(chdtrc(mean**2 / spread, found * mean / spread))


# One arm over campaigns: its parameters with intervals, and what moved from each to the next.


def drift(models: Sequence[FittedModel], names: Sequence[str]) -> results.DriftRecord:
    """Return the parameters of an arm over two campaigns or more, in order of time.

    Raises:
        ModelError: when there are fewer than two, the arms differ in layout, or a covariance is not
            known.
    """
    _refuse(models, names)
    steps = []
    for (first, before), (second, after) in pairwise(zip(models, names, strict=True)):
        _refuse_other_layout(first.arm, second.arm, (before, after))
        moved = what_moved(first, second)
        assert moved is not None
        steps.append(results.DriftStep(first=before, second=after, what_moved=moved))
    told = [
        f"{step.first} to {step.second}: {step.what_moved.line}"
        for step in steps
        if step.what_moved.verdict != "unchanged"
    ]
    return results.DriftRecord(
        robot=models[0].arm.name,
        campaigns=tuple(names),
        parameters=_rows(models, names),
        steps=tuple(steps),
        line="; ".join(told) or f"unchanged over {len(models)} campaigns",
    )


def _refuse(models: Sequence[FittedModel], names: Sequence[str]) -> None:
    if len(models) < 2:
        raise ModelError(
            "drift over a single model",
            where="models",
            value=len(models),
            allowed="two models or more, in order of time",
            remedy="give the models of further campaigns",
        )
    for model, name in zip(models, names, strict=True):
        if model.covariance is None:
            raise ModelError(
                "the covariance of a model is not known",
                where=name,
                allowed="models with the file of their covariance beside them",
                remedy="copy model.covariance.npz together with model.yaml, or export it again",
            )
    if len(set(names)) < len(names):
        raise ModelError(
            "two models of the same name",
            where="models",
            value=list(names),
            allowed="a name for each",
            remedy="give each campaign once",
        )


def _rows(models: Sequence[FittedModel], names: Sequence[str]) -> results.DriftRows:
    """Return links, springs and effects of all models, with 95 % intervals."""
    rows = [
        {
            "campaign": name,
            "term": term.id,
            "of": term.of,
            "parameter": parameter.name,
            "unit": parameter.unit,
            "value": value,
            "std": std,
            "low": value - HALF_WIDTH_95 * std,
            "high": value + HALF_WIDTH_95 * std,
        }
        for model, name in zip(models, names, strict=True)
        for term, parameter, value, std in model.every_reported()
        if std > 0.0
        and len(term.parameters) <= COMPARED.most_parameters
        and (term.holds == "campaign" or {"base", "tool", "weight"}.isdisjoint(term.roles))
    ]
    return results.DriftRows.model_validate(rows)
