"""Weights that are uncertain, or assumed: how much so, and models that have them as unknowns.

Where torques are calculated and not logged, errors of the weights act through the springs on every
pose. Makers state masses to about ten per cent, centres of mass to one or two centimetres. An error
as large as its standard uncertainty costs 0.5 nat of log evidence, one twice as large 2 nats: far
less than naming an effect needs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm, WeightsKnown, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.fit.fitted import Fitted
from pa10cal.results.number_text import plain_number
from pa10cal.rules import MASSES, SIZES
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights, WeightSizes, holds_weights

F = TypeVar("F", bound=Fitted)


def weight_sizes(arm: Arm, payload: Payload) -> WeightSizes:
    """Return standard uncertainties of the weights of an arm and its tool, as described."""
    if payload.known:
        tool_kg, com_m = payload.mass_kg, payload.com_u_m or arm.size_ratio * MASSES.tool_com_m
        size_kg = MASSES.tool_share * tool_kg
    else:
        total_kg = 0.0 if arm.mass_kg is None else float(arm.mass_kg.sum())
        tool_kg = size_kg = MASSES.unknown_tool_share * total_kg
        com_m = arm.size_ratio * MASSES.unknown_tool_com_m
    known = weights_known(arm)
    return WeightSizes(
        link_mass=known.mass,
        link_com_m=known.com_m,
        payload_kg=size_kg,
        payload_kg_m=tool_kg * com_m,
        level_rad=MASSES.level_assumed_rad if known.assumed else MASSES.level_rad,
    )


def unknown_tool(arm: Arm, payload: Payload) -> tuple[Weights, ...]:
    """Return the term of the tool's mass and first moment, as far as these are not stated."""
    if payload.known and payload.com_u_m is None:
        return ()
    zeros = np.zeros(arm.n)
    sizes = replace(weight_sizes(arm, payload), link_mass=zeros, link_com_m=zeros, level_rad=0.0)
    if payload.known:
        sizes = replace(sizes, payload_kg=0.0)
    return (replace(Weights.about(arm, sizes), unknown_tool=not payload.known),)


def unknown_weights(arm: Arm, payload: Payload, states: PoseStates) -> tuple[Weights, ...]:
    """Return the term of all weights that are not stated, which a calibration fits, or none."""
    known = weights_known(arm)
    if known.origin == "stated":
        return unknown_tool(arm, payload)
    weights = Weights.about(arm, weight_sizes(arm, payload))
    loads = states.static_loads
    if known.assumed and not _scale_is_known(payload, states) and loads is not None:
        weights = weights.relative(loads.joint_Nm, loads.by_weights)
    return (weights,)


def _scale_is_known(payload: Payload, states: PoseStates) -> bool:
    """Return whether loads of known size determine the scale of weights that are not stated."""
    masses_kg = {each.mass_kg for each in payload.of_campaigns if each.known}
    return len(masses_kg) > 1 or bool(np.ptp(states.load_N) > 0.0)


def with_uncertain_weights(model: F, payload: Payload) -> F:
    """Return a model that was fitted to calculated torques, with a term of all its weights.

    Values of weights that it fitted already are kept; the covariance of all is that of the prior.
    """
    arm, terms = model.arm, model.model.terms
    if any(0 in term.columns for term in filter(holds_weights, terms)):
        return model  # it has a term of all weights already
    weights = Weights.about(arm, weight_sizes(arm, payload))
    weights = replace(weights, unknown_tool=not payload.known)
    fitted_values: dict[int, float] = {}
    for term in filter(holds_weights, terms):
        fitted_values |= zip(term.columns, model.values_of(term), strict=True)
    without = model.only(*(term for term in terms if not holds_weights(term)))
    values = np.array([fitted_values.get(column, 0.0) for column in weights.columns])
    count, covariance = len(without.x), without.covariance
    if covariance is not None:
        # Parameters come first, then base and targets: the weights are inserted between them.
        for axis in (0, 1):
            covariance = np.insert(covariance, np.full(len(values), count), 0.0, axis=axis)
        at = count + np.arange(len(values))
        covariance[at, at] = np.square(weights.sizes)
    return replace(
        without,
        model=Model(model.model.chain, (*without.model.terms, weights)),
        x=np.concatenate([without.x, values]),
        covariance=covariance,
    )


def with_weights_by_log(model: F, payload: Payload) -> F:
    """Return a model that was fitted to logged torques, with weights and covariance by the log.

    The fit itself does not determine the weights, but predictions calculate torques from them: a
    tool stated as 1.4 kg in place of 2.4 kg moved predictions by 0.3 mm.
    """
    by_log = weights_known(model.arm).by_log
    if model.model.terms_of("weight"):
        return model
    uncertain = with_uncertain_weights(model, payload)
    if by_log is None or payload.of_campaigns:
        return uncertain
    (weights,) = filter(holds_weights, uncertain.model.terms)
    at = np.arange(len(uncertain.x))[uncertain.model.columns_of(weights)]
    columns, x, covariance = list(weights.columns), uncertain.x.copy(), uncertain.covariance
    x[at] = by_log.x[columns]
    if covariance is not None:
        covariance = covariance.copy()
        covariance[np.ix_(at, at)] = by_log.covariance[np.ix_(columns, columns)]
    return replace(uncertain, x=x, covariance=covariance)


def open_unknowns(model: Model) -> int:
    """Return the number of parameters without a prior: all but the weights."""
    return int(np.count_nonzero(~model.having("weight")))


# Weights assumed from the lengths of an arm's links, where its description states none. Masses that
# are implausible count as not stated.


def implausible_masses(arm: Arm, total_kg: float | None) -> str:
    """Return why stated masses are implausible; empty where they are plausible or not stated."""
    if arm.mass_kg is None:
        return ""
    if np.isin(arm.mass_kg, MASSES.placeholders_kg).all():
        return (
            "the masses of the links are all 0 or 1 kg, as a drawing program exports them where "
            "none were given: they are treated as not known"
        )
    if arm.com_m is not None:
        far_m = np.linalg.norm(arm.com_m, axis=1)
        link = int(far_m.argmax())
        if far_m[link] > arm.reach_m:
            return (
                f"the centre of mass of link {link + 1} is stated {far_m[link]:.4g} m from its "
                f"frame, and the arm reaches {arm.reach_m:.3g} m: masses and centres are treated "
                "as not known"
            )
    sum_kg = float(arm.mass_kg.sum())
    if total_kg is not None and abs(sum_kg - total_kg) > MASSES.total_off_share * max(
        sum_kg, total_kg
    ):
        return (
            f"masses.total_kg is {total_kg:g} kg, and the masses of the links add up to "
            f"{plain_number(sum_kg, 4)} kg: both are treated as not known"
        )
    return ""


def with_assumed_weights(arm: Arm, total_kg: float | None = None) -> Arm:
    """Return an arm with weights: itself where it states them, else with assumed ones.

    Assumed masses add up to the total, where it is known.
    """
    if arm.mass_kg is not None:
        return arm
    near_m, far_m = link_ends(arm)
    length_m = np.linalg.norm(far_m - near_m, axis=1)
    size_m = length_m + MASSES.drives_share * arm.reach_m
    if total_kg is None:
        # A rail bears the arm, and makes it no heavier.
        rail_m = float(np.abs(arm.joint_ranges_rad[0]).max()) if arm.prismatic[0] else 0.0
        reach_m, usual_m = arm.reach_m - rail_m, SIZES.extent_m[1]
        all_kg = MASSES.kg_at_1_m * min(reach_m, usual_m) ** MASSES.length_power
        all_kg *= max(reach_m / usual_m, 1.0)  # booms are built light, each part as the one before
    else:
        all_kg = total_kg
    mass_kg = all_kg * size_m / size_m.sum()
    known = WeightsKnown(
        "assumed" if total_kg is None else "total",
        np.full(arm.n, MASSES.u_mass if total_kg is None else MASSES.u_mass_of_total),
        MASSES.centre_share * size_m,
    )
    return replace(arm, mass_kg=mass_kg, com_m=0.5 * (near_m + far_m), weights_known=known)


def link_ends(arm: Arm) -> tuple[Array, Array]:
    """Return start and end of each link, (n, 3) both, in the frame of its own row [m].

    A link starts at its joint and ends at the next one; the last link ends at the end-effector.
    """
    chain = Chain.of(arm)
    at = frames(chain, chain.coordinates(np.zeros((1, arm.n))))
    places = np.concatenate([at.T_base_joints[:, 0, :3, 3], at.T_base_ee[:, :3, 3]])
    rows = at.T_base_rows[:, 0]

    def in_rows(p_base: Array) -> Array:
        in_row: Array = np.einsum("jba,jb->ja", rows[:, :3, :3], p_base - rows[:, :3, 3])
        return in_row

    return in_rows(places[:-1]), in_rows(places[1:])
