"""The arm of a campaign with its weights: stated, assumed, or estimated from logged torques.

Unknown weights are weights with a wide uncertainty. An arm without masses gets assumed ones;
implausible masses count as not stated. Where torques were logged, they determine weights that
nobody stated, and show which link is stated wrongly.

`amounts` (4 n + 3,) are deviations of the weights from those described: of n links mass [kg] and
first moments [kg m], then the tool's mass and two tilts of gravity (columns of `by_weights`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, WeighedByLog, WeightsKnown, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, spread
from pa10cal.fit.loads import statics_of
from pa10cal.fit.log_errors import ErrorsShown, errors_of_logs, scatter_about
from pa10cal.fit.uncertain_weights import implausible_masses, weight_sizes, with_assumed_weights
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import plain_number, with_half_width_95
from pa10cal.rules import MASSES
from pa10cal.terms.model import Model

#: Iterations of robust reweighting; divisors in place of a mass or a size of zero (computing).
_REWEIGHTED, _NO_MASS_KG, _NO_SIZE = 4, 1e-9, 1e-12


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
    return arm if torques is None else _weighed_by(torques)


def _torques_of_weights(arm: Arm, payload: Payload, every: Observations) -> _LoggedTorques | None:
    """Return the logged torques of calibration poses; None where they are none of weights."""
    grid = with_arrivals(every, arm)[0].of_kind("grid")
    if not len(grid) or not np.isfinite(grid.states.tau_Nm).all():
        return None
    if not np.linalg.norm(payload.gravity_m_s2):
        return None
    poses = average_repeats(grid)
    repeated = len(grid) - len(poses) > MASSES.repeated_share * len(grid)
    poses = poses.take(np.unique(spread(len(poses), MASSES.most_poses)))
    torques = _LoggedTorques.of(arm, payload, poses, repeated=repeated)
    return torques if torques.are_of_weights else None


def _weighed_by(torques: _LoggedTorques) -> Arm:
    """Return the arm with the weights that its torques have, as far as they follow them."""
    arm = torques.arm
    if arm.weights_known is not None:
        return torques.arm_by_log_alone() if torques.follow_calculated else arm
    if torques.follow_calculated:
        return torques.arm_less_contradictions(torques.contradictions(arm.n))
    # One part may be stated so wrongly. If it takes more, the signs of the torques or the direction
    # of gravity are as likely.
    one = torques.contradictions(1)
    if one and torques.less_error_of(one[0].part).follow_calculated:
        return torques.arm_less_contradictions(one)
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
            remedy="correct the masses in the arm's description, or the tool in campaign.yaml",
            kind="masses",
            would_leave_mm=None,
        ),
    )


class _WeightFit(NamedTuple):
    """Weights fitted to logged torques."""

    amounts: Array  # (4 n + 3,) deviations from the weights described
    covariance: Array  # (4 n + 3, 4 n + 3) their covariance
    objective: float  # robust sum of squares plus that of the prior
    errors: Array  # (c,) errors of the log, over their sizes
    errors_std: Array  # (c,) their standard uncertainties


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


@dataclass(frozen=True)
class _LoggedTorques:
    """Logged torques compared with those of the weights described."""

    arm: Arm  # with its weights
    payload: Payload  # what it carries
    logged_Nm: Array  # (P, n) logged torques
    residual_Nm: Array  # (P, n) logged minus calculated torques
    by_weights: Array  # (P, n, 4 n + 3) derivative of the calculated ones by `amounts`
    nuisance: Array  # (P, n, c) columns of usual errors of the log, of unit expected size
    load_N: Array  # (P,) external load of each pose
    arrival: Array  # (P, n) direction in which each joint arrived
    repeated: bool  # whether many of the poses are averages of readings

    @classmethod
    def of(
        cls, arm: Arm, payload: Payload, poses: Observations, *, repeated: bool
    ) -> _LoggedTorques:
        states, described = poses.states, arm
        if arm.weights_known is not None:
            known = replace(arm.weights_known, by_log=None)
            described = replace(arm, weights_known=known)
        calculated = statics_of(Model(Chain.of(described), ()), np.zeros(0), states, payload)
        rated_Nm = arm.rated_Nm(np.abs(calculated.torque_Nm).max(axis=0))
        # A wrong size or point of the external load, and a wrong tool, are faults of their own.
        load = calculated.static_loads.by_load * states.load_N[:, None]
        # Where nobody stated weights, a scale of the torques is one of the weights.
        gain = MASSES.gain if arm.weights_known is None else 0.0
        usual_errors = errors_of_logs(calculated.torque_Nm, rated_Nm, states.arrival, gain)
        return cls(
            arm,
            payload,
            logged_Nm=states.tau_Nm,
            residual_Nm=states.tau_Nm - calculated.torque_Nm,
            by_weights=calculated.static_loads.by_weights,
            nuisance=np.concatenate([usual_errors, load[:, :, None]], axis=2),
            load_N=states.load_N,
            arrival=states.arrival,
            repeated=repeated,
        )

    @property
    def are_of_weights(self) -> bool:
        """Return whether some weights, of either sign, explain most of the logged torques."""
        noise_Nm = np.sqrt(np.mean(self._noise_Nm**2))
        return bool(noise_Nm < MASSES.scatter_share * np.sqrt(np.mean(self.logged_Nm**2)))

    @property
    def follow_calculated(self) -> bool:
        """Return whether logged torques, less zeros, correlate with those of the weights."""
        calculated_Nm = self.logged_Nm - self.residual_Nm
        less_zeros_Nm = (
            calculated_Nm + self._less_errors(self._errors_shown(self._any_sizes)).residual_Nm
        )
        product = float(np.sum(calculated_Nm * less_zeros_Nm))
        size = np.linalg.norm(calculated_Nm) * np.linalg.norm(less_zeros_Nm)
        return bool(product > MASSES.follows * size)

    def arm_by_log_alone(self) -> Arm:
        """Return the arm, which states no weights, with those fitted to its torques."""
        return self._arm_of_fit(self._stated_sizes, weights_known(self.arm).why)

    def arm_less_contradictions(self, contradictions: list[_Contradiction]) -> Arm:
        """Return the arm with those masses and centres corrected that the torques contradict.

        Last link and tool are told together, as either may be wrong: where only they are
        contradicted, or nothing is, the arm stays as stated, and predictions go by the log.
        """
        arm = self.arm
        parts = [each.part for each in contradictions]
        inner = [each for each in contradictions if each.part.link < arm.n - 1]
        clauses = [self._contradiction_text(each, parts) for each in inner]
        outer = [each for each in contradictions if each.part.link >= arm.n - 1]
        if outer:
            links = {each.or_part.link + 1 for each in outer if each.or_part} | {arm.n}
            named = " or ".join(f"link {link}" for link in sorted(links) if link <= arm.n)
            clauses.append(
                f"logged torques contradict the mass or the centre stated of {named}, or of the "
                "tool"
            )
        why = "; ".join(clauses)
        if inner:
            return self._arm_of_fit(self._freed(parts), why)
        known = weights_known(arm)
        return replace(
            arm, weights_known=replace(known, why=why or known.why, by_log=self.by_log(parts))
        )

    def less_error_of(self, part: _Part) -> _LoggedTorques:
        """Return the torques compared with those of this part as they have it, all else stated."""
        sizes, columns = self._freed([part]), list(part.columns)
        amounts = self._in_scale_of_log(sizes, self._errors_shown(sizes)).amounts[columns]
        return replace(self, residual_Nm=self.residual_Nm - self.by_weights[..., columns] @ amounts)

    def contradictions(self, most: int) -> list[_Contradiction]:
        """Return what the torques contradict, part by part that which alone explains most.

        Args:
            most: number of parts at most.
        """
        found = list[_Contradiction]()
        objective = self._solve(self._stated_sizes).objective
        while len(found) < most:
            by_objective = self._contradicted_beside([each.part for each in found])
            if not by_objective:
                break
            strongest = by_objective[0]
            if (objective - strongest.objective) / 2.0 < MASSES.needed_nats:
                break
            found.append(self._with_alternative(by_objective))
            objective = found[-1].objective
        return found

    def _with_alternative(self, by_objective: list[_Contradiction]) -> _Contradiction:
        """Return the strongest contradiction, with another that torques hardly tell from it.

        One of the last link or the tool goes first: a campaign states its tool by hand, and an arm
        is described once.
        """
        strongest, last = by_objective[0], self.arm.n - 1
        for other in by_objective[1:]:
            nats = (other.objective - strongest.objective) / 2.0
            if strongest.part.link < last <= other.part.link and nats < MASSES.alike_nats:
                return other._replace(or_part=strongest.part)
            if strongest.part.link == other.part.link and nats < MASSES.needed_nats:
                return strongest._replace(or_part=other.part)
        return strongest

    def _contradicted_beside(self, freed: list[_Part]) -> list[_Contradiction]:
        """Return the parts that torques contradict beside those freed, the strongest first."""
        found = []
        for part in self._parts:
            columns = list(part.columns)
            fit = self._solve(self._freed([*freed, part]))
            least = np.maximum(self._stated_sizes[columns], _NO_SIZE)
            if np.max(np.abs(fit.amounts[columns]) / least) > MASSES.off_errors:
                found.append(_Contradiction(part, fit.objective))
        return sorted(found, key=lambda each: each.objective)

    @cached_property
    def _stated_sizes(self) -> Array:
        """Return the standard uncertainties (4 n + 3,) of the weights as stated."""
        return weight_sizes(self.arm, self.payload).columns(self.arm)

    @cached_property
    def _parts(self) -> tuple[_Part, ...]:
        """Return masses and centres that may be stated wrongly.

        The centre of the last link is that of the tool as well.
        """
        mass_kg, n = self.arm.mass_kg, self.arm.n
        assert mass_kg is not None
        tool_kg = self.payload.mass_kg if self.payload.known else 0.0
        most_kg = float(max(mass_kg.max(), tool_kg))
        reach_m = MASSES.centre_share * (1.0 + MASSES.drives_share) * self.arm.reach_m
        parts = []
        for link, kg in enumerate(mass_kg.tolist()):
            mass, carried_kg = 4 * link, kg + (tool_kg if link == n - 1 else 0.0)
            centre = (mass + 1, mass + 2, mass + 3)
            parts.append(_Part(link, "mass", (mass,), most_kg))
            parts.append(_Part(link, "centre", centre, reach_m * carried_kg))
        if tool_kg > 0.0:
            parts.append(_Part(n, "mass", (4 * n,), most_kg))
        return tuple(parts)

    def _freed(self, parts: Iterable[_Part]) -> Array:
        """Return the uncertainties (4 n + 3,) as stated, with those of some parts widened."""
        sizes = self._stated_sizes.copy()
        for part in parts:
            columns = list(part.columns)
            sizes[columns] = np.maximum(part.wide, sizes[columns])
        return sizes

    def _contradiction_text(self, contradiction: _Contradiction, freed: list[_Part]) -> str:
        """Return a clause with what is stated of a link and what is in the log."""
        link, part, or_part = contradiction.part.link, contradiction.part, contradiction.or_part
        beside = [each for each in freed if each is not part]
        clauses = []
        for each in filter(None, (part, or_part)):
            sizes = self._freed([*beside, each])
            of_log = self._in_scale_of_log(sizes, self._errors_shown(sizes))
            clauses.append(_part_text(self.arm, each, of_log.amounts))
        text = ", or else ".join(clauses)
        if or_part is None:
            return text
        return f"the mass or the centre of link {link + 1} is stated wrongly: {text}"

    def by_log(self, contradicted: Iterable[_Part] = ()) -> WeighedByLog:
        """Return stated weights, known to their uncertainty, updated by the torques.

        Contradicted parts are determined by the torques alone, and so is that one mass, of a link
        or the tool, that they contradict most.
        """
        arm, tool_kg = self.arm, self.payload.mass_kg if self.payload.known else 0.0
        assert arm.mass_kg is not None
        stated_kg = np.append(arm.mass_kg, tool_kg)
        sizes = self._freed(contradicted)
        freed, text, most_errors = sizes, "", MASSES.differs_errors
        for k in np.flatnonzero(stated_kg > 0.0):
            mass = 4 * k
            widened = sizes.copy()
            widened[mass] = max(float(stated_kg.max()), sizes[mass])
            fit = self._solve(widened)
            std_kg = float(np.sqrt(fit.covariance[mass, mass]))
            u_kg = float(np.hypot(std_kg, self._stated_sizes[mass]))
            errors = abs(float(fit.amounts[mass])) / u_kg
            if errors > most_errors:
                part = "the tool" if k == arm.n else f"link {k + 1}"
                log_kg = with_half_width_95(float(stated_kg[k] + fit.amounts[mass]), std_kg)
                text = (
                    f"{part} is stated with {plain_number(stated_kg[k])} kg, and logged torques "
                    f"have it at {log_kg} kg: predictions go by the log"
                )
                freed, most_errors = widened, errors
        of_log = self._errors_shown(freed)
        fit = self._in_scale_of_log(freed, of_log)
        said = "; ".join(filter(None, (text, of_log.said)))
        return WeighedByLog(fit.amounts, fit.covariance, said, *of_log[:3])

    def _in_scale_of_log(self, sizes: Array, errors: ErrorsShown) -> _WeightFit:
        """Fit weights to torques less their errors.

        Springs are fitted to torques with the log's scale errors, and predictions need torques with
        the same scale: the columns of scale errors, the first n, are left out.
        """
        without = self._less_errors(errors)
        return replace(without, nuisance=without.nuisance[:, :, self.arm.n :])._solve(sizes)

    def _less_errors(self, errors: ErrorsShown) -> _LoggedTorques:
        """Return the torques less their zeros and friction."""
        residual_Nm = self.residual_Nm
        if len(errors.zero_Nm):
            residual_Nm = residual_Nm - errors.zero_Nm
        if len(errors.friction_Nm):
            residual_Nm = residual_Nm - errors.friction_Nm * self.arrival
        return replace(self, residual_Nm=residual_Nm)

    def _errors_shown(self, sizes: Array) -> ErrorsShown:
        """Return what the torques show beside weights of these uncertainties (4 n + 3,).

        Zeros no larger than those of usual logs are not told. Friction is that of motors and gears,
        which act before the spring of a joint: sensors at the joint show hardly any, so that as
        small a part is left in. Where poses are repeated, friction is sought as an effect.
        """
        friction_Nm, zero_Nm, u_friction_Nm, u_zero_Nm = self._friction_and_zeros(sizes)
        zero_shown = np.abs(zero_Nm) > MASSES.differs_errors * u_zero_Nm
        of_motor_Nm = MASSES.friction_of_motor * self._usual_zeros_Nm / MASSES.zero_share
        least_Nm = np.maximum(MASSES.differs_errors * u_friction_Nm, of_motor_Nm)
        friction_shown = (friction_Nm > least_Nm) & (not self.repeated)
        told = zero_shown & (np.abs(zero_Nm) > self._usual_zeros_Nm)
        said = []
        if told.any():
            said.append(
                f"logged torques have a zero of {self._listed(zero_Nm, u_zero_Nm, told)}, which is "
                "taken out before the fit: set the zeros of the torque sensors"
            )
        if friction_shown.any():
            most = friction_shown & (friction_Nm == friction_Nm[friction_shown].max())
            count = int(friction_shown.sum())
            said.append(
                f"logged torques hold friction at {count} joint{'s' * (count > 1)}, at the most "
                f"{self._listed(friction_Nm, u_friction_Nm, most)}, which is taken out before the "
                "fit"
            )
        none = np.zeros(0)
        return ErrorsShown(
            np.where(zero_shown, zero_Nm, 0.0) if zero_shown.any() else none,
            np.where(friction_shown, friction_Nm, 0.0) if friction_shown.any() else none,
            np.where(friction_shown, u_friction_Nm, 0.0) if friction_shown.any() else none,
            "; ".join(said),
        )

    def _listed(self, torque_Nm: Array, u_Nm: Array, told: NDArray[np.bool_]) -> str:
        """Return torques (n,) with their intervals in words, of the joints that are told (n,)."""
        return ", ".join(
            f"{with_half_width_95(torque_Nm[j], u_Nm[j], sign='+')} "
            f"{'N' if self.arm.prismatic[j] else 'N m'} at joint {j + 1}"
            for j in np.flatnonzero(told)
        )

    def _friction_and_zeros(self, sizes: Array) -> tuple[Array, Array, Array, Array]:
        """Return friction and zero (n,) of each joint's logged torque, then their uncertainties.

        They are those beside weights, gain, and every load of its own size; infinitely uncertain
        where the torques are too few, or of a group, whose campaigns have a zero each.
        """
        n, of_load = self.arm.n, self.nuisance[:, :, -1]
        rated_Nm = self._usual_zeros_Nm / MASSES.zero_share
        zeros = np.broadcast_to(np.diag(rated_Nm), (*self.logged_Nm.shape, n))
        friction = zeros * self.arrival[:, None, :]
        of_loads = [of_load * (self.load_N == load)[:, None] for load in np.unique(self.load_N)]
        gains = self.nuisance[:, :, :n]
        nuisance = np.concatenate([gains, np.stack(of_loads, axis=2), friction, zeros], axis=2)
        spare = self.residual_Nm.size - len(sizes) - nuisance.shape[2]
        if spare <= 0 or self.payload.of_campaigns:
            none, unknown = np.zeros(n), np.full(n, np.inf)
            return none, none, unknown, unknown
        fit = replace(self, nuisance=nuisance)._solve(sizes)
        widened = np.sqrt(self.residual_Nm.size / spare)  # the scatter is of residuals
        found, u = (each[-2 * n :] * np.tile(rated_Nm, 2) for each in (fit.errors, fit.errors_std))
        return found[:n], found[n:], widened * u[:n], widened * u[n:]

    @property
    def _usual_zeros_Nm(self) -> Array:
        """Return the zero (n,) that the torque of each joint may have in any log."""
        n = self.arm.n
        return np.asarray(self.nuisance[0, :, 2 * n : 3 * n].diagonal())

    def _solve(self, sizes: Array) -> _WeightFit:
        """Fit weights by Huber's loss, with a prior about those described and masses above zero.

        Args:
            sizes: (4 n + 3,) standard uncertainties of `amounts`.
        """
        columns = np.concatenate([self.by_weights * sizes, self.nuisance], axis=2)
        column_count, weight_count, noise_Nm = columns.shape[2], len(sizes), self._noise_Nm
        white = (columns / noise_Nm[:, None]).reshape(-1, column_count)
        data = (self.residual_Nm / noise_Nm).ravel()
        rows = Gaussian.of(white, data)
        x, lower = rows.mean, self._lower_bounds(sizes, column_count)
        for _ in range(_REWEIGHTED):
            clipped = white @ x + np.clip(data - white @ x, -MASSES.edge, MASSES.edge)
            x = rows.taken_of(white.T @ clipped)
            if (x < lower).any():
                from scipy.optimize import lsq_linear  # late: it takes long to load

                root = rows.lower.T
                right = np.linalg.solve(root.T, white.T @ clipped)
                x = lsq_linear(root, right, (lower, np.inf), method="bvls").x
        residual = np.clip(data - white @ x, -MASSES.edge, MASSES.edge)
        covariance = rows.covariance[:weight_count, :weight_count] * np.outer(sizes, sizes)
        objective = float(residual @ residual + x @ x)
        std = np.sqrt(np.diag(rows.covariance)[weight_count:])
        return _WeightFit(x[:weight_count] * sizes, covariance, objective, x[weight_count:], std)

    def _lower_bounds(self, sizes: Array, column_count: int) -> Array:
        """Return lower bounds of all unknowns over their sizes: every mass stays above zero."""
        lower, mass_kg = np.full(column_count, -np.inf), self.arm.mass_kg
        assert mass_kg is not None
        described_kg = np.append(mass_kg, self.payload.mass_kg)  # the tool's is the last
        masses = 4 * np.arange(len(described_kg))
        bounded = (described_kg > 0.0) & (sizes[masses] > 0.0)
        least_kg = -(1.0 - MASSES.least_share) * described_kg[bounded]
        lower[masses[bounded]] = least_kg / sizes[masses[bounded]]
        return lower

    @cached_property
    def _any_sizes(self) -> Array:
        """Return the sizes (4 n + 3,) of weights of which nothing is stated."""
        bare = replace(self.arm, mass_kg=None, com_m=None, weights_known=None)
        sizes = weight_sizes(with_assumed_weights(bare), self.payload).columns(self.arm)
        return np.asarray(np.maximum(sizes, MASSES.least_of_largest * sizes.max()))

    @cached_property
    def _noise_Nm(self) -> Array:
        """Return the scatter (n,) of logged torques about a fit by weights of any size."""
        columns = np.concatenate([self.by_weights * self._any_sizes, self.nuisance], axis=2)
        least_Nm = MASSES.resolved_share * max(float(np.abs(self.logged_Nm).max()), 1.0)
        scaled = MASSES.any_sizes * columns
        return scatter_about(scaled, self.residual_Nm, _REWEIGHTED, least_Nm)[0]

    def _arm_of_fit(self, sizes: Array, why: str) -> Arm:
        """Return the arm with fitted masses and centres, and their uncertainty.

        Args:
            sizes: (4 n + 3,) standard uncertainties of the weights before the fit.
        """
        errors = self._errors_shown(sizes)
        fit = self._in_scale_of_log(sizes, errors)
        arm, amounts = self.arm, fit.amounts
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
        known = WeightsKnown(
            "logged",
            np.maximum(std[:, 0] / divisor_kg, 0.0),
            np.maximum(std[:, 1:].max(axis=1) / divisor_kg, 0.0),
            why,
            WeighedByLog(
                of_tool,
                to_new_centres @ fit.covariance @ to_new_centres.T,
                errors.said,
                *errors[:3],
            ),
        )
        return replace(arm, mass_kg=mass_kg, com_m=com_m, weights_known=known)


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
