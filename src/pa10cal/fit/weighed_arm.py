"""The arm of a campaign with its weights: stated, assumed, or estimated from logged torques.

Unknown weights are weights with a wide uncertainty. An arm without masses gets assumed ones;
implausible masses count as not stated. Where torques were logged, they determine weights that
nobody stated, and show which link is stated wrongly.

`sizes` (4 n + 3,) are standard uncertainties of the weights, `amounts` their deviations from those
described, both as `logged_torques` has them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, WeighedByLog, WeightsKnown, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, spread
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.logged_torques import LoggedTorques
from pa10cal.fit.uncertain_weights import implausible_masses, link_ends, with_assumed_weights
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.calibration import InputFinding
from pa10cal.results.number_text import plain_number, with_half_width_95
from pa10cal.rules import MASSES

F = TypeVar("F", bound=Fitted)

#: Divisors in place of a mass or a size of zero (computing).
_NO_MASS_KG, _NO_SIZE = 1e-9, 1e-12


def weighed_arm(
    arm: Arm,
    every: Observations,
    payload_of: Callable[[Arm], Payload | None],
    total_kg: float | None = None,
) -> Arm:
    """Return the arm of a campaign with weights and their uncertainties.

    | weights stated | torques logged              | weights of the arm | by the log          |
    |----------------|-----------------------------|--------------------|---------------------|
    | none           | none, or not of its weights | assumed            | nothing             |
    | none           | of its weights              | those of the log   | tool and covariance |
    | yes            | none, or not of its weights | stated             | nothing             |
    | yes            | as calculated               | stated             | all differences     |
    | yes            | contradict an inner link    | those of the log   | tool and covariance |
    | yes            | contradict last link, tool  | stated             | all differences     |

    Args:
        every: all readings of the campaign.
        payload_of: returns what an arm carries; None for an arm without masses.
        total_kg: mass of the whole arm as stated in a catalogue; None where not stated.
    """
    why = implausible_masses(arm, total_kg)
    if why:
        total_kg = None  # it or the masses of the links are wrong, and nothing says which
        arm = replace(arm, mass_kg=None, com_m=None)
    arm = with_assumed_weights(arm, total_kg)
    if why and arm.weights_known is not None:
        arm = replace(arm, weights_known=replace(arm.weights_known, why=why))
    payload = payload_of(arm)
    torques = None if payload is None else _torques_of_weights(arm, payload, every)
    if torques is None:
        return arm
    gains = _GainsShown.of(torques)
    return gains.told_of(
        _weighed_by(torques.less_gains(gains.gain) if gains.gain.any() else torques)
    )


def weighed_model(model: F, every: Observations) -> F:
    """Return a model of stated weights, with their differences by the log about its own postures.

    Before the fit only those of the nominal arm are known: zeros of joints that are some
    milliradians off, and links that sag, change torques by newton metres, which weights then take
    up and predictions have twice.

    Args:
        every: readings that the model was fitted to, with torques less their errors.
    """
    arm, payload = model.arm, model.payload
    by_log = weights_known(arm).by_log
    if by_log is None or payload is None or weights_known(arm).origin == "logged":
        return model
    torques = _torques_of_weights(arm, payload, every, model)
    if torques is None:
        return model
    contradicted = _contradictions(torques, arm.n)
    outer = [each.part for each in contradicted if each.part.link >= arm.n - 1]
    sizes = _freed(torques, outer)
    found = _differences_by_log(torques, sizes)
    by_log = replace(by_log, x=found.x, covariance=found.covariance)
    arm = replace(arm, weights_known=replace(weights_known(arm), by_log=by_log))
    chain = Chain.of(arm, bends=model.model.chain.bends)
    return replace(model, model=replace(model.model, chain=chain))


def _torques_of_weights(
    arm: Arm, payload: Payload, every: Observations, about: Fitted | None = None
) -> LoggedTorques | None:
    """Return the logged torques of calibration poses; None where they are none of weights."""
    grid = with_arrivals(every, arm)[0].of_kind("grid")
    if not len(grid) or not np.isfinite(grid.states.tau_Nm).all():
        return None
    if not np.linalg.norm(payload.gravity_m_s2):
        return None
    poses = average_repeats(grid)
    repeated = len(grid) - len(poses) > MASSES.repeated_share * len(grid)
    poses = poses.take(np.unique(spread(len(poses), MASSES.most_poses)))
    torques = LoggedTorques.of(arm, payload, poses, repeated=repeated, about=about)
    return torques if torques.are_of_weights else None


def _weighed_by(torques: LoggedTorques) -> Arm:
    """Return the arm with the weights that its torques have, as far as they follow them."""
    arm = torques.arm
    if arm.weights_known is not None:
        if not torques.follow_calculated:
            return arm
        return _arm_of_log(torques, torques.stated_sizes, weights_known(arm).why)
    if torques.follow_calculated:
        return _arm_less_contradictions(torques, _contradictions(torques, arm.n))
    # One part may be stated so wrongly. If it takes more, the signs of the torques or the direction
    # of gravity are as likely.
    one = _contradictions(torques, 1)
    if one and _with_part_of_log(torques, one[0].part).follow_calculated:
        return _arm_less_contradictions(torques, one)
    return arm


def weights_finding(arm: Arm) -> tuple[InputFinding, ...]:
    """Return the finding about wrongly stated weights; empty where there is none."""
    known = arm.weights_known
    if known is None or not known.why:
        return ()
    return (
        InputFinding(
            what=known.why,
            where=f"{arm.name}: mass_kg, com_m",
            remedy=(
                "if they are wrong, correct the masses in the arm's description, or the tool in "
                "campaign.yaml"
            ),
            kind="masses",
            would_leave_mm=None,
        ),
    )


# Gains of single joints, which stated loads show and nothing else that may be stated wrongly.


class _GainsShown(NamedTuple):
    """Gains of the logged torques of n joints, 0 where not shown, and what they are in words."""

    gain: Array  # (n,)
    u_gain: Array  # (n,) standard uncertainties
    text: str  # empty for none

    @classmethod
    def of(cls, torques: LoggedTorques) -> _GainsShown:
        """Return the gains that both loads and weights show, by forward selection.

        A spring fitted to the log is off by its gain, and poses cannot show that: under a log that
        is larger by a tenth, a joint stiffer by a tenth deflects as much. Torques can: those of a
        stated load are known. Only where no mass, centre, load or point of the loads explains them
        as well is it the gain of a joint. One of all joints looks like a load stated wrongly, and
        stays in the log. Where poses are repeated, gains are effects that a search finds, with the
        torques in the postures of the calibrated arm.
        """
        none = cls(np.zeros(torques.arm.n), np.zeros(torques.arm.n), "")
        if torques.repeated or torques.arm.weights_known is not None:
            return none
        if not torques.follow_calculated:
            return none
        sizes, shown, chosen = torques.stated_sizes, torques.gains_by_loads(), list[int]()
        while others := [joint for joint in shown if joint not in chosen]:
            beside = torques.beside_errors(chosen)
            objective = beside.fitted(sizes).objective
            of_gains = {
                joint: torques.beside_errors([*chosen, joint]).fitted(sizes).objective
                for joint in others
            }
            best = min(others, key=lambda joint: of_gains[joint])
            of_loads = torques.beside_errors(chosen, loads_stated=False).fitted(sizes).objective
            rivals = [of_loads, *(each.objective for each in _contradicted_beside(beside, []))]
            if (objective - of_gains[best]) / 2.0 < MASSES.needed_nats:
                break
            if (min(rivals) - of_gains[best]) / 2.0 < MASSES.needed_nats:
                break
            chosen.append(best)
        if not chosen:
            return none
        fit = torques.beside_errors(chosen).fitted(sizes)
        gain, u_gain = np.zeros(torques.arm.n), np.zeros(torques.arm.n)
        gain[chosen], u_gain[chosen] = fit.errors[-len(chosen) :], fit.errors_std[-len(chosen) :]
        listed = " and ".join(
            f"{with_half_width_95(1.0 + gain[joint], u_gain[joint])} times those of the loads and "
            f"weights stated at joint {joint + 1}"
            for joint in sorted(chosen)
        )
        text = (
            f"logged torques are {listed}, which is taken out before the fit: check the scale of "
            "the torque sensors"
        )
        return cls(gain, u_gain, text)

    def told_of(self, arm: Arm) -> Arm:
        """Return the weighed arm with the gains of its log."""
        known = weights_known(arm)
        if known.by_log is None or not self.text:
            return arm
        said = "; ".join(filter(None, (self.text, known.by_log.said)))
        by_log = replace(known.by_log, said=said, gain=self.gain, u_gain=self.u_gain)
        return replace(arm, weights_known=replace(known, by_log=by_log))


# Which masses and centres, stated of an arm, its logged torques contradict.


class _Part(NamedTuple):
    """A mass or a centre that may be stated wrongly, of a link or of the tool."""

    link: int  # number of the link, from 0; n for the tool
    what: Literal["mass", "centre"]
    columns: tuple[int, ...]  # which of `amounts` it is
    wide: float  # standard uncertainty of these where nothing is known


class _Contradiction(NamedTuple):
    """A stated mass or centre that logged torques contradict."""

    part: _Part
    objective: float  # of the fit with this part freed
    # Another part, where freeing it explains about as much. Torques are of products of mass and
    # lever, and centres along the axis of a joint look the same on both sides of it: base
    # parameters (Gautier and Khalil, IEEE Trans. Robot. Autom. 6(3), 1990).
    or_part: _Part | None = None


def _parts(arm: Arm, payload: Payload) -> tuple[_Part, ...]:
    """Return masses and centres that may be stated wrongly.

    The centre of the last link is that of the tool as well.
    """
    mass_kg, n = arm.mass_kg, arm.n
    assert mass_kg is not None
    tool_kg = payload.mass_kg if payload.known else 0.0
    most_kg = float(max(mass_kg.max(), tool_kg))
    reach_m = MASSES.centre_share * (1.0 + MASSES.drives_share) * arm.reach_m
    parts = []
    for link, kg in enumerate(mass_kg.tolist()):
        mass, carried_kg = 4 * link, kg + (tool_kg if link == n - 1 else 0.0)
        centre = (mass + 1, mass + 2, mass + 3)
        parts.append(_Part(link, "mass", (mass,), most_kg))
        parts.append(_Part(link, "centre", centre, reach_m * carried_kg))
    if tool_kg > 0.0:
        parts.append(_Part(n, "mass", (4 * n,), most_kg))
    return tuple(parts)


def _freed(torques: LoggedTorques, parts: Iterable[_Part]) -> Array:
    """Return the sizes of the weights as stated, with those of some parts widened."""
    sizes = torques.stated_sizes.copy()
    for part in parts:
        columns = list(part.columns)
        sizes[columns] = np.maximum(part.wide, sizes[columns])
    return sizes


def _contradictions(torques: LoggedTorques, most: int) -> list[_Contradiction]:
    """Return at most so many parts that torques contradict, each that which alone explains most."""
    found = list[_Contradiction]()
    objective = torques.fitted(torques.stated_sizes).objective
    while len(found) < most:
        by_objective = _contradicted_beside(torques, [each.part for each in found])
        if not by_objective:
            break
        if (objective - by_objective[0].objective) / 2.0 < MASSES.needed_nats:
            break
        found.append(_with_alternative(by_objective, torques.arm.n - 1))
        objective = found[-1].objective
    return found


def _contradicted_beside(torques: LoggedTorques, freed: list[_Part]) -> list[_Contradiction]:
    """Return the parts that torques contradict beside those freed, the strongest first."""
    found = []
    for part in _parts(torques.arm, torques.payload):
        columns = list(part.columns)
        fit = torques.fitted(_freed(torques, [*freed, part]))
        least = np.maximum(torques.stated_sizes[columns], _NO_SIZE)
        if np.max(np.abs(fit.amounts[columns]) / least) > MASSES.off_errors:
            found.append(_Contradiction(part, fit.objective))
    return sorted(found, key=lambda each: each.objective)


def _with_alternative(by_objective: list[_Contradiction], last: int) -> _Contradiction:
    """Return the first, strongest contradiction, with another that torques hardly tell from it.

    One of the last link (number `last`) or the tool goes first: a campaign states its tool by hand,
    and an arm is described once.
    """
    strongest = by_objective[0]
    for other in by_objective[1:]:
        nats = (other.objective - strongest.objective) / 2.0
        if strongest.part.link < last <= other.part.link and nats < MASSES.alike_nats:
            return other._replace(or_part=strongest.part)
        if strongest.part.link == other.part.link and nats < MASSES.needed_nats:
            return strongest._replace(or_part=other.part)
    return strongest


def _with_part_of_log(torques: LoggedTorques, part: _Part) -> LoggedTorques:
    """Return the torques compared with this part as they have it, and all else as stated."""
    sizes, columns = _freed(torques, [part]), list(part.columns)
    fit = torques.fitted_in_scale_of_log(sizes, torques.errors_shown(sizes))
    by_part = torques.by_weights[..., columns] @ fit.amounts[columns]
    return replace(torques, residual_Nm=torques.residual_Nm - by_part)


def _arm_less_contradictions(
    torques: LoggedTorques, contradictions: Sequence[_Contradiction]
) -> Arm:
    """Return the arm with those masses and centres corrected that the torques contradict.

    Last link and tool are named together, as either may be wrong: where only they are contradicted,
    or nothing is, the arm stays as stated, and predictions go by the log.
    """
    arm = torques.arm
    parts = [each.part for each in contradictions]
    inner = [each for each in contradictions if each.part.link < arm.n - 1]
    clauses = [_contradiction_text(torques, each, parts) for each in inner]
    outer = [each for each in contradictions if each.part.link >= arm.n - 1]
    if outer:
        links = {each.or_part.link + 1 for each in outer if each.or_part} | {arm.n}
        named = " or ".join(f"link {link}" for link in sorted(links) if link <= arm.n)
        clauses.append(
            f"logged torques contradict the mass or the centre stated of {named}, or of the tool"
        )
    why = "; ".join(clauses)
    if inner:
        return _arm_of_log(torques, _freed(torques, parts), why)
    known = weights_known(arm)
    by_log = _differences_by_log(torques, _freed(torques, parts))
    return replace(arm, weights_known=replace(known, why=why or known.why, by_log=by_log))


def _differences_by_log(torques: LoggedTorques, sizes: Array) -> WeighedByLog:
    """Return stated weights, known to their sizes, updated by the torques.

    That one mass, of a link or the tool, that the torques contradict most is determined by them
    alone.
    """
    arm, payload = torques.arm, torques.payload
    assert arm.mass_kg is not None
    stated_kg = np.append(arm.mass_kg, payload.mass_kg if payload.known else 0.0)
    freed, text, most_errors = sizes, "", MASSES.differs_errors
    # One mass is found for all campaigns of a group, whose tools are as stated of each.
    source = "what is stated of each campaign" if payload.of_campaigns else "the log"
    for k in np.flatnonzero(stated_kg > 0.0):
        mass = 4 * k
        widened = sizes.copy()
        widened[mass] = max(float(stated_kg.max()), sizes[mass])
        fit = torques.fitted(widened)
        std_kg = float(np.sqrt(fit.covariance[mass, mass]))
        u_kg = float(np.hypot(std_kg, torques.stated_sizes[mass]))
        errors = abs(float(fit.amounts[mass])) / u_kg
        if errors > most_errors:
            part = "the tool" if k == arm.n else f"link {k + 1}"
            log_kg = with_half_width_95(float(stated_kg[k] + fit.amounts[mass]), std_kg)
            text = (
                f"{part} is stated with {plain_number(stated_kg[k])} kg, and logged torques "
                f"have it at {log_kg} kg: predictions go by {source}"
            )
            freed, most_errors = widened, errors
    errors_shown = torques.errors_shown(freed)
    fit = torques.fitted_in_scale_of_log(freed, errors_shown)
    text = "; ".join(filter(None, (text, errors_shown.text)))
    return WeighedByLog(fit.amounts, fit.covariance, text, *errors_shown[:3])


def _arm_of_log(torques: LoggedTorques, sizes: Array, why: str) -> Arm:
    """Return the arm with masses and centres fitted to the torques from sizes as stated or freed.

    `why` weights are not taken as stated is one clause.
    """
    errors = torques.errors_shown(sizes)
    fit = torques.fitted_in_scale_of_log(sizes, errors)
    arm, amounts = torques.arm, fit.amounts
    assert arm.mass_kg is not None
    assert arm.com_m is not None
    of_links = amounts[: 4 * arm.n].reshape(-1, 4)
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))[: 4 * arm.n].reshape(-1, 4)
    mass_kg = arm.mass_kg + of_links[:, 0]
    divisor_kg = np.maximum(mass_kg, _NO_MASS_KG)
    com_m = (mass_kg[:, None] * arm.com_m + of_links[:, 1:]) / divisor_kg[:, None]
    # First moments were about the stated centres; now they are about the fitted ones.
    to_new_centres, links = np.eye(len(amounts)), np.arange(arm.n)
    for axis in range(3):
        to_new_centres[4 * links + axis + 1, 4 * links] = (arm.com_m - com_m)[:, axis]
    of_tool = np.where(np.arange(len(amounts)) < 4 * arm.n, 0.0, amounts)
    covariance = to_new_centres @ fit.covariance @ to_new_centres.T
    known = WeightsKnown(
        "logged",
        np.maximum(std[:, 0] / divisor_kg, 0.0),
        np.maximum(std[:, 1:].max(axis=1) / divisor_kg, 0.0),
        why,
        WeighedByLog(of_tool, covariance, errors.text, *errors[:3]),
    )
    return replace(arm, mass_kg=mass_kg, com_m=com_m, weights_known=known)


def _contradiction_text(
    torques: LoggedTorques, contradiction: _Contradiction, freed: Iterable[_Part]
) -> str:
    """Return a clause with what is stated of a link and what is in the log."""
    link, part, or_part = contradiction.part.link, contradiction.part, contradiction.or_part
    beside = [each for each in freed if each is not part]
    clauses, most_Nm = [], 0.0
    for each in filter(None, (part, or_part)):
        sizes = _freed(torques, [*beside, each])
        amounts = torques.fitted_in_scale_of_log(sizes, torques.errors_shown(sizes)).amounts
        columns = list(each.columns)
        more_Nm = torques.by_weights[:, link, columns] @ amounts[columns]
        most_Nm = max(most_Nm, float(np.abs(more_Nm).max()))
        if _is_possible(torques.arm, each, amounts) or not _loads_one_joint(torques, link):
            clauses.append(_part_text(torques.arm, each, amounts))
    balancer = (
        f"a balancer, counterweight or gas spring that nobody stated acts on joint {link + 1}"
    )
    if not clauses:
        return (
            f"the logged torques of joint {link + 1} differ from those of the weights by up to "
            f"{plain_number(most_Nm)} N m, which go with its angle, as no mass or centre that link "
            f"{link + 1} can have makes them: {balancer}; predictions take it as a weight of this "
            "link, which holds at the angles that were measured"
        )
    if _loads_one_joint(torques, link):
        clauses.append(balancer)
    text = ", or else ".join(clauses)
    if or_part is None:
        return text
    return f"the mass or the centre of link {link + 1} is stated wrongly: {text}"


def _loads_one_joint(torques: LoggedTorques, link: int) -> bool:
    """Return whether the weight of a link (from 0) loads its own joint alone.

    That is the first joint that lifts: a torque there that goes with its angle looks the same.
    """
    by_link = np.abs(torques.by_weights[:, :, 4 * link : 4 * link + 3]).max(axis=(0, 2))
    others = np.delete(by_link, link)
    return bool(others.max() <= MASSES.resolved_share * by_link[link])


def _is_possible(arm: Arm, part: _Part, amounts: Array) -> bool:
    """Return whether a link can have the mass or the centre that torques have of it.

    A centre lies between the ends of the link, or no further from these than a drive reaches, or
    than what is stated.
    """
    assert arm.mass_kg is not None
    assert arm.com_m is not None
    link = part.link
    log_kg = arm.mass_kg[link] + amounts[4 * link]
    if part.what == "mass":
        return bool(log_kg > MASSES.least_drawn_share * arm.mass_kg[link])
    near_m, far_m = (ends[link] for ends in link_ends(arm))
    moment_kg_m = amounts[4 * link + 1 : 4 * link + 4]
    log_m = arm.com_m[link] + moment_kg_m / max(log_kg, _NO_MASS_KG)
    along = far_m - near_m
    squared = max(float(along @ along), _NO_SIZE)
    stated_m, away_m = (
        float(
            np.linalg.norm(p - near_m - np.clip((p - near_m) @ along / squared, 0.0, 1.0) * along)
        )
        for p in (arm.com_m[link], log_m)
    )
    return away_m <= max(stated_m, MASSES.drives_share * arm.reach_m)


def _part_text(arm: Arm, part: _Part, amounts: Array) -> str:
    """Return one clause with the stated mass or centre of a link and the one in the log."""
    assert arm.mass_kg is not None
    assert arm.com_m is not None
    link = part.link
    mass_kg, com_m = arm.mass_kg[link], arm.com_m[link]
    log_kg, moment_kg_m = mass_kg + amounts[4 * link], amounts[4 * link + 1 : 4 * link + 4]
    if part.what == "mass":
        return (
            f"link {link + 1} is stated with {plain_number(mass_kg, 4)} kg, and logged torques "
            f"have it at {plain_number(log_kg)} kg"
        )
    log_m = com_m + moment_kg_m / max(log_kg, _NO_MASS_KG)
    return (
        f"the centre of mass of link {link + 1} is stated at {np.round(com_m, 3).tolist()} m, and "
        f"the logged torques have it at {np.round(log_m, 3).tolist()} m"
    )
