"""The arm of a campaign with its weights: stated, assumed, or as logged torques have them.

Weights that are not known are weights with wide uncertainty. So an arm without masses gets assumed
ones, and masses that cannot be meant count as none. Where torques were logged they weigh the arm:
they set weights that nobody stated, and show which link is stated wrongly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, WeighedByLog, WeightsKnown, weights_known
from pa10cal.arm.statics import CENTRE, DRIVES, Payload, PoseStates, with_assumed_weights
from pa10cal.arrays import MEDIAN_TO_SIGMA, Array
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.loads import statics_of
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import MASSES
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights, WeightSizes, holds_weights

#: Times that scatter is found anew; a mass and a size that are none (computing).
_REWEIGHTED, _NO_MASS_KG, _NO_SIZE = 4, 1e-9, 1e-12


def weighed_arm(
    arm: Arm,
    every: Observations,
    payload_of: Callable[[Arm], Payload | None],
    total_kg: float | None = None,
) -> Arm:
    """Return the arm of a campaign with weights, and how well these are known.

    Args:
        payload_of: what an arm carries; None of one without masses.
        total_kg: the mass of the whole arm, as a catalogue states it; None where it is not stated.
    """
    why = _not_meant(arm, total_kg)
    if why:
        if arm.mass_kg is not None and total_kg is not None:
            total_kg = None  # one of the two is wrong, and nothing says which
        arm = replace(arm, mass_kg=None, com_m=None)
    arm = with_assumed_weights(arm, total_kg)
    if why and arm.weights_known is not None:
        arm = replace(arm, weights_known=replace(arm.weights_known, why=why))
    payload = payload_of(arm)
    grid = every.of_kind("grid")
    if payload is None or not len(grid) or not np.isfinite(grid.states.tau_Nm).all():
        return arm
    if not np.linalg.norm(payload.gravity_m_s2):
        return arm
    poses = average_repeats(grid)
    some = np.linspace(0, len(poses) - 1, min(len(poses), MASSES.most_poses)).astype(int)
    poses = poses.take(np.unique(some))
    rows = _Torques.of(arm, payload, poses)
    if not rows.of_weights:
        return arm
    if arm.weights_known is not None:
        return rows.weighed() if rows.follow else arm
    if rows.follow:
        found = rows.without_contradiction()
        if found.weights_known is None:
            by_log = rows.by_log()
            found = replace(found, weights_known=replace(weights_known(found), by_log=by_log))
        return found
    # One link may be so far off; more than one are as well the signs of torques, or gravity.
    found = rows.without_contradiction(most=1)
    return found if _Torques.of(found, payload, poses).follow else arm


def weights_finding(arm: Arm) -> tuple[InputFinding, ...]:
    """Return what is wrong with the weights that the description states; none where nothing is."""
    known = arm.weights_known
    if known is None or not known.why:
        return ()
    return (
        InputFinding(
            what=known.why,
            where=f"{arm.name}: mass_kg, com_m",
            remedy="correct the masses in the arm's description, or the tool in campaign.yaml",
            kind="masses",
            would_leave_mm=None,
        ),
    )


def _not_meant(arm: Arm, total_kg: float | None) -> str:
    """Return why stated masses cannot be meant; empty where they can, or where there are none."""
    if arm.mass_kg is None:
        return ""
    if np.isin(arm.mass_kg, MASSES.placeholders_kg).all():
        return (
            "the masses of the links are all 0 or 1 kg, as a drawing program exports them where "
            "none were given: they are treated as not known"
        )
    if arm.com_m is not None:
        away_m = np.linalg.norm(arm.com_m, axis=1)
        link = int(away_m.argmax())
        if away_m[link] > arm.reach_m:
            return (
                f"the centre of mass of link {link + 1} is stated {away_m[link]:.4g} m from its "
                f"frame, and the arm reaches {arm.reach_m:.3g} m: masses and centres are treated "
                "as not known"
            )
    sum_kg = float(arm.mass_kg.sum())
    if total_kg is not None and abs(sum_kg - total_kg) > MASSES.total_off_share * max(
        sum_kg, total_kg
    ):
        return (
            f"masses.total_kg is {total_kg:g} kg, and the masses of the links add up to "
            f"{sum_kg:.4g} kg: both are treated as not known"
        )
    return ""


def errors_of_logs(
    torque_Nm: Array, rated_Nm: Array, arrival: Array, gain: float = MASSES.gain
) -> Array:
    """Return what logged torques are usually off by, each at its size, (P, n, 3 n).

    Scales of joints, their friction and their zeros, by the torques of the weights and the
    directions of arrival (P, n), and rated torques (n,).
    """
    each = np.eye(len(rated_Nm))
    zeros = np.broadcast_to(
        MASSES.zero_share * rated_Nm[:, None] * each, (*torque_Nm.shape, len(rated_Nm))
    )
    friction_Nm = MASSES.friction_share * (rated_Nm * arrival)[:, :, None] * each
    return np.concatenate([gain * torque_Nm[:, :, None] * each, friction_Nm, zeros], axis=2)


def scatter_about(
    columns: Array, left_Nm: Array, rounds: int, least_Nm: float = 0.0
) -> tuple[Array, Array]:
    """Return the scatter (n,) of torques (P, n) about columns (P, n, k), and their amounts (k,)."""
    noise_Nm = np.maximum(_spread(left_Nm - np.median(left_Nm, axis=0)), least_Nm)
    for _ in range(rounds):
        x = Gaussian.of(columns / noise_Nm[:, None], left_Nm / noise_Nm).mean
        noise_Nm = np.maximum(_spread(left_Nm - columns @ x), least_Nm)
    return noise_Nm, x


@dataclass(frozen=True)
class _Torques:
    """Logged torques beside those of the weights."""

    arm: Arm  # with its weights
    payload: Payload  # what it carries
    logged_Nm: Array  # (P, n) logged torques
    left_Nm: Array  # (P, n) these less calculated ones
    by_weights: Array  # (P, n, 4 n + 3) derivative of the calculated ones
    nuisance: Array  # (P, n, c) what logs are usually off by, at its size

    @classmethod
    def of(cls, arm: Arm, payload: Payload, poses: Observations) -> _Torques:
        states, described = poses.states, arm
        if arm.weights_known is not None:
            known = replace(arm.weights_known, by_log=None)
            described = replace(arm, weights_known=known)
        found = statics_of(Model(Chain.of(described), ()), np.zeros(0), states, payload)
        rated_Nm = arm.rated_Nm(np.abs(found.torque_Nm).max(axis=0))
        # A load hung elsewhere or of another size, and the tool, are faults of their own.
        load = found.static_loads.by_load * states.load_N[:, None]
        # A scale of the torques is one of weights that nobody stated.
        gain = MASSES.gain if arm.weights_known is None else 0.0
        usual = errors_of_logs(found.torque_Nm, rated_Nm, states.arrival, gain)
        left_Nm = states.tau_Nm - found.torque_Nm
        return cls(
            arm,
            payload,
            states.tau_Nm,
            left_Nm,
            found.static_loads.by_weights,
            np.concatenate([usual, load[:, :, None]], axis=2),
        )

    @property
    def of_weights(self) -> bool:
        """Return whether weights of some kind, or their opposite, make such torques."""
        noise_Nm = np.sqrt(np.mean(self._noise_Nm**2))
        return bool(noise_Nm < MASSES.scatter_share * np.sqrt(np.mean(self.logged_Nm**2)))

    @property
    def follow(self) -> bool:
        """Return whether logged torques follow those of the weights described."""
        calculated_Nm = self.logged_Nm - self.left_Nm
        along = float(np.sum(calculated_Nm * self.logged_Nm))
        size = np.linalg.norm(calculated_Nm) * np.linalg.norm(self.logged_Nm)
        return bool(along > MASSES.follows * size)

    def weighed(self) -> Arm:
        """Return the arm with the weights that its torques have, of one that states none."""
        sizes = weight_sizes(self.arm, self.payload).columns(self.arm)
        x, covariance, _ = self._solve(sizes)
        return self._with(x, covariance, weights_known(self.arm).why)

    def without_contradiction(self, most: int | None = None) -> Arm:
        """Return the arm; with a weight or a centre as the torques have it where they contradict.

        One link after the other, each in its mass or its centre, whichever alone explains most.

        Args:
            most: how many links at most; None for all.
        """
        arm, mass_kg = self.arm, self.arm.mass_kg
        assert mass_kg is not None
        sizes = weight_sizes(arm, self.payload).columns(arm)
        known, before = sizes.copy(), self._solve(sizes)[2]
        reach_m = CENTRE * (1.0 + DRIVES) * arm.reach_m
        said = []
        for _ in range(most or arm.n):
            tried = []
            for link in range(arm.n):
                for part, columns, wide in (
                    ("mass", [4 * link], float(mass_kg.max())),
                    ("centre", [4 * link + k for k in (1, 2, 3)], reach_m * mass_kg[link]),
                ):
                    opened = known.copy()
                    opened[columns] = np.maximum(wide, known[columns])
                    x, _, left = self._solve(opened)
                    off = np.abs(x[columns]) / np.maximum(sizes[columns], _NO_SIZE)
                    if off.max() > MASSES.off_errors:
                        tried.append((left, link, part, columns, opened))
            if not tried:
                break
            left, link, part, columns, opened = min(tried, key=lambda each: each[0])
            if (before - left) / 2.0 < MASSES.needed_nats:
                break
            known, before = opened, left
            said.append((link, part, columns))
        if not said:
            return arm
        last = arm.n - 1
        if any(link == last for link, _, _ in said):
            # The tool may be as wrong as the link that carries it: the verdict tells them apart.
            why = (
                f"logged torques contradict the mass or the centre stated of link {arm.n}, or of "
                "the tool"
            )
            return replace(arm, weights_known=replace(weights_known(arm), why=why))
        x, covariance, _ = self._solve(known)
        found = self._with(x, covariance, "")
        assert found.mass_kg is not None
        assert found.com_m is not None
        assert arm.com_m is not None
        clauses = [
            f"link {link + 1} is stated with {mass_kg[link]:.4g} kg, and logged torques have it "
            f"at {found.mass_kg[link]:.3g} kg"
            if part == "mass"
            else f"the centre of mass of link {link + 1} is stated at "
            f"{np.round(arm.com_m[link], 3).tolist()} m, and the logged torques have it at "
            f"{np.round(found.com_m[link], 3).tolist()} m"
            for link, part, _ in said
        ]
        assert found.weights_known is not None
        return replace(found, weights_known=replace(found.weights_known, why="; ".join(clauses)))

    def by_log(self) -> WeighedByLog:
        """Return what the torques say of stated weights, of which each is known to its part.

        A mass that they contradict, be it of a link or the tool, is as they have it.
        """
        arm, tool_kg = self.arm, self.payload.mass_kg if self.payload.known else 0.0
        assert arm.mass_kg is not None
        stated_kg = np.append(arm.mass_kg, tool_kg)
        sizes = weight_sizes(arm, self.payload).columns(arm)
        opened, said, furthest = sizes, "", MASSES.differs_errors
        for k in np.flatnonzero(stated_kg > 0.0):
            tried = sizes.copy()
            tried[4 * k] = max(float(stated_kg.max()), sizes[4 * k])
            x, covariance, _ = self._solve(tried)
            std_kg = float(np.sqrt(covariance[4 * k, 4 * k]))
            off = abs(float(x[4 * k])) / float(np.hypot(std_kg, sizes[4 * k]))
            if off > furthest:
                what = "the tool" if k == arm.n else f"link {k + 1}"
                said = (
                    f"{what} is stated with {stated_kg[k]:.3g} kg, and logged torques have it at "
                    f"{stated_kg[k] + x[4 * k]:.3g} ± {HALF_WIDTH_95 * std_kg:.1g} kg: predictions "
                    "go by the log"
                )
                opened, furthest = tried, off
        # Springs are fitted to torques of the log's scale, and predictions need them of that scale.
        scaled = replace(self, nuisance=self.nuisance[:, :, arm.n :])
        x, covariance, _ = scaled._solve(opened)
        return WeighedByLog(x, covariance, said)

    def _solve(self, sizes: Array) -> tuple[Array, Array, float]:
        """Return weights (4 n + 3,) beside those described, their covariance, and the squares left.

        Args:
            sizes: (4 n + 3,) standard uncertainties.
        """
        columns = np.concatenate([self.by_weights * sizes, self.nuisance], axis=2)
        count, own, noise_Nm = columns.shape[2], len(sizes), self._noise_Nm
        white = (columns / noise_Nm[:, None]).reshape(-1, count)
        data = (self.left_Nm / noise_Nm).ravel()
        every = Gaussian.of(white, data)
        x, least = every.mean, self._least(sizes, count)
        for _ in range(_REWEIGHTED):
            clipped = white @ x + np.clip(data - white @ x, -MASSES.edge, MASSES.edge)
            x = every.taken_of(white.T @ clipped)
            if (x < least).any():
                from scipy.optimize import lsq_linear  # late: it takes long to load

                root = every.lower.T
                wanted = np.linalg.solve(root.T, white.T @ clipped)
                x = lsq_linear(root, wanted, (least, np.inf), method="bvls").x
        off = np.clip(data - white @ x, -MASSES.edge, MASSES.edge)
        covariance = every.covariance[:own, :own] * np.outer(sizes, sizes)
        return x[:own] * sizes, covariance, float(off @ off + x @ x)

    def _least(self, sizes: Array, count: int) -> Array:
        """Return how far unknowns may fall, (count,): every link weighs something."""
        least, mass_kg = np.full(count, -np.inf), self.arm.mass_kg
        assert mass_kg is not None
        at = 4 * np.flatnonzero((mass_kg > 0.0) & (sizes[: 4 * self.arm.n : 4] > 0.0))
        least[at] = -(1.0 - MASSES.least_share) * mass_kg[at // 4] / sizes[at]
        return least

    @cached_property
    def _noise_Nm(self) -> Array:
        """Return the scatter (n,) of logged torques about weights of any kind."""
        bare = replace(self.arm, mass_kg=None, com_m=None, weights_known=None)
        sizes = weight_sizes(with_assumed_weights(bare), self.payload).columns(self.arm)
        sizes = np.maximum(sizes, MASSES.least_of_largest * sizes.max())
        columns = np.concatenate([self.by_weights * sizes, self.nuisance], axis=2)
        least_Nm = MASSES.resolved_share * max(float(np.abs(self.logged_Nm).max()), 1.0)
        return scatter_about(MASSES.any_sizes * columns, self.left_Nm, _REWEIGHTED, least_Nm)[0]

    def _with(self, x: Array, covariance: Array, why: str) -> Arm:
        """Return the arm with other weights, and their uncertainty."""
        arm = self.arm
        assert arm.mass_kg is not None
        assert arm.com_m is not None
        mass, moments = x[: 4 * arm.n : 4], x[: 4 * arm.n].reshape(-1, 4)[:, 1:]
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))[: 4 * arm.n].reshape(-1, 4)
        mass_kg = arm.mass_kg + mass
        least_kg = np.maximum(mass_kg, _NO_MASS_KG)
        com_m = ((arm.mass_kg + mass)[:, None] * arm.com_m + moments) / least_kg[:, None]
        # First moments are about the centres, which are others now.
        about, links = np.eye(len(x)), np.arange(arm.n)
        for axis in range(3):
            about[4 * links + axis + 1, 4 * links] = (arm.com_m - com_m)[:, axis]
        rest = np.where(np.arange(len(x)) < 4 * arm.n, 0.0, x)
        known = WeightsKnown(
            "logged",
            np.maximum(std[:, 0] / least_kg, 0.0),
            np.maximum(std[:, 1:].max(axis=1) / least_kg, 0.0),
            why,
            WeighedByLog(rest, about @ covariance @ about.T),
        )
        return replace(arm, mass_kg=mass_kg, com_m=com_m, weights_known=known)


def _spread(left_Nm: Array) -> Array:
    """Return the scatter (n,) of each joint, from its median."""
    spread = MEDIAN_TO_SIGMA * np.median(np.abs(left_Nm), axis=0)
    return np.asarray(np.maximum(spread, MASSES.least_of_largest * spread.max()))


# How far the weights of an arm may be from those described, and a model that has them unknown.
#
# Where torques are calculated and not logged, what weights differ by goes through the springs into
# every pose. Makers state masses to some ten parts in a hundred, centres to a centimetre or two; an
# error of the size stated here costs half a nat, one twice as large two, far less than a name
# needs.

F = TypeVar("F", bound=Fitted)


def weight_sizes(arm: Arm, payload: Payload) -> WeightSizes:
    """Return how far the weights of an arm and its tool may be from those described."""
    if payload.known:
        tool_kg, com_m = payload.mass_kg, payload.com_u_m or MASSES.tool_com_m
        size_kg = MASSES.tool_share * tool_kg
    else:
        total_kg = 0.0 if arm.mass_kg is None else float(arm.mass_kg.sum())
        tool_kg = size_kg = MASSES.unknown_tool_share * total_kg
        com_m = MASSES.unknown_tool_com_m
    known = weights_known(arm)
    return WeightSizes(
        link_mass=known.mass,
        link_com_m=known.com_m,
        payload_kg=size_kg,
        payload_kg_m=tool_kg * com_m,
        level_rad=MASSES.level_assumed_rad if known.assumed else MASSES.level_rad,
    )


def unknown_tool(arm: Arm, payload: Payload) -> tuple[Weights, ...]:
    """Return mass and first moment of a tool, as far as nobody stated them."""
    if payload.known and payload.com_u_m is None:
        return ()
    none = np.zeros(arm.n)
    sizes = replace(weight_sizes(arm, payload), link_mass=none, link_com_m=none, level_rad=0.0)
    if payload.known:
        sizes = replace(sizes, payload_kg=0.0)
    return (replace(Weights.about(arm, sizes), unknown_tool=not payload.known),)


def unknown_weights(arm: Arm, payload: Payload, states: PoseStates) -> tuple[Weights, ...]:
    """Return the weights that a calibration fits with the springs: those nobody stated."""
    known = weights_known(arm)
    if known.origin == "stated":
        return unknown_tool(arm, payload)
    weights = Weights.about(arm, weight_sizes(arm, payload))
    loads = states.static_loads
    if known.assumed and not scale_is_known(payload, states) and loads is not None:
        weights = weights.relative(loads.joint_Nm, loads.by_weights)
    return (weights,)


def scale_is_known(payload: Payload, states: PoseStates) -> bool:
    """Return whether loads of known size set the scale of weights that nobody stated."""
    masses_kg = {each.mass_kg for each in payload.of_campaigns if each.known}
    return len(masses_kg) > 1 or bool(np.ptp(states.load_N) > 0.0)


def with_uncertain_weights(model: F, payload: Payload) -> F:
    """Return a model, fitted to calculated torques, with all its weights unknown.

    What it has found of some of them already is kept.
    """
    arm, terms = model.arm, model.model.terms
    if any(0 in term.columns for term in filter(holds_weights, terms)):
        return model  # all of them are unknowns already
    weights = Weights.about(arm, weight_sizes(arm, payload))
    weights = replace(weights, unknown_tool=not payload.known)
    found: dict[int, float] = {}
    for term in filter(holds_weights, terms):
        found |= zip(term.columns, model.values_of(term), strict=True)
    own = model.only(*(term for term in terms if not holds_weights(term)))
    values = np.array([found.get(column, 0.0) for column in weights.columns])
    covariance, at = own.covariance, len(own.x) + np.arange(len(values))
    if covariance is not None:
        for axis in (0, 1):
            covariance = np.insert(covariance, np.full(len(at), len(own.x)), 0.0, axis=axis)
        covariance[at, at] = np.square(weights.sizes)
    return replace(
        own,
        model=Model(model.model.chain, (*own.model.terms, weights)),
        x=np.concatenate([own.x, values]),
        covariance=covariance,
    )


def with_weights_by_log(model: F, payload: Payload) -> F:
    """Return a model, fitted to logged torques, with its weights as uncertain as the log leaves.

    Predictions take the torques of the weights, of which the fit knows nothing: with stated ones a
    tool of 1.4 kg for 2.4 moved them by 0.3 mm.
    """
    known = weights_known(model.arm)
    if model.model.terms_of("weight"):
        return model
    found = with_uncertain_weights(model, payload)
    if known.by_log is None or payload.of_campaigns:
        return found
    (weights,) = filter(holds_weights, found.model.terms)
    at = np.arange(len(found.x))[found.model.columns_of(weights)]
    columns, x, covariance = list(weights.columns), found.x.copy(), found.covariance
    x[at] = known.by_log.x[columns]
    if covariance is not None:
        covariance = covariance.copy()
        covariance[np.ix_(at, at)] = known.by_log.covariance[np.ix_(columns, columns)]
    return replace(found, x=x, covariance=covariance)


def open_unknowns(model: Model) -> int:
    """Return how many parameters of a model nothing but the readings determines."""
    return int(np.count_nonzero(~model.having("weight")))
