"""Logged torques: compared with those of the weights, fitted by weights, and their errors.

Usual errors of a log are its scale, and friction and zero of every joint. Of the arm (n joints) and
its tool the weights are fitted as `amounts` (4 n + 3,), deviations from those described: of every
link mass [kg] and first moments [kg m], then the tool's mass and two tilts of gravity, as the
columns of `StaticLoads.by_weights`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Mask, standard_error_of_sum
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.loads import statics_of, with_static_loads, with_torques
from pa10cal.fit.uncertain_weights import weight_sizes, with_assumed_weights, with_weights_by_log
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations
from pa10cal.results.number_text import with_half_width_95
from pa10cal.rules import LACK, MASSES
from pa10cal.terms.model import Model
from pa10cal.terms.term import shows_torque, yields

#: Iterations of robust reweighting (computing).
_REWEIGHTED = 4
#: Singular values of what a scatter is about that are none, in the largest (computing).
_LEAST_SINGULAR = 1e-9


def without_torque_errors(every: Observations, arm: Arm) -> Observations:
    """Return readings whose torques are without the errors that the weighed arm has of its log.

    These are gains, zeros and friction. A fit takes a zero, through a spring, as one of the joint,
    friction of a motor as lost motion, and a gain as one of the spring. Predictions calculate
    torques from the weights, which have none of these.
    """
    by_log = weights_known(arm).by_log
    if by_log is None:
        return every
    if not any(errors.any() for errors in (by_log.gain, by_log.zero_Nm, by_log.friction_Nm)):
        return every
    tau_Nm = every.states.tau_Nm
    if len(by_log.gain):
        tau_Nm = tau_Nm / (1.0 + by_log.gain)
    if len(by_log.zero_Nm):
        tau_Nm = tau_Nm - by_log.zero_Nm
    if len(by_log.friction_Nm):
        tau_Nm = tau_Nm - by_log.friction_Nm * with_arrivals(every, arm)[0].states.arrival
    return every.with_states(replace(every.states, tau_Nm=tau_Nm))


def errors_of_logs(
    torque_Nm: Array, rated_Nm: Array, arrival: Array, gain: float = MASSES.gain
) -> Array:
    """Return the usual errors of logged torques as columns of unit expected size, (P, n, 3 n).

    Scale errors, friction and zeros of the n joints.

    Args:
        torque_Nm, arrival: (P, n) torques of the weights, and directions of arrival.
        rated_Nm: (n,) rated torques.
        gain: expected size of a scale error.
    """
    diagonal = np.eye(len(rated_Nm))
    zeros_Nm = np.broadcast_to(
        MASSES.zero_share * rated_Nm[:, None] * diagonal, (*torque_Nm.shape, len(rated_Nm))
    )
    friction_Nm = MASSES.friction_share * (rated_Nm * arrival)[:, :, None] * diagonal
    return np.concatenate([gain * torque_Nm[:, :, None] * diagonal, friction_Nm, zeros_Nm], axis=2)


def _by_posture(nominal: Model, states: PoseStates, payload: Payload) -> Array:
    """Return what joints that turn change of torques if mastered as usual, (P, n, n)."""
    by_posture = np.zeros((*states.tau_Nm.shape, states.n))
    for joint in np.flatnonzero(~nominal.chain.arm.prismatic):
        for off_rad in (MASSES.mastered_rad, -MASSES.mastered_rad):
            moved = replace(states, q_rad=states.q_rad + off_rad * np.eye(states.n)[joint])
            torque_Nm = statics_of(nominal, np.zeros(0), moved, payload).joint_Nm
            by_posture[:, :, joint] += 0.5 * np.sign(off_rad) * torque_Nm
    return by_posture


def torque_scatter_Nm(at: Fitted, states: PoseStates, payload: Payload) -> Array:
    """Return the scatter (n,) of logged torques about a fit by the torques of the weights.

    Zero for a joint with too few torques for each fitted column.
    """
    weights = statics_of(at.model, at.x, states, payload)
    residual_Nm = states.tau_Nm - weights.joint_Nm
    scatter_Nm, one = np.zeros(states.n), np.ones(len(states))
    for j in range(states.n):
        of_weights = weights.joint_Nm[:, j], weights.by_weights[:, j]
        columns = np.column_stack([one, states.arrival[:, j], states.load_N, *of_weights])
        x, _, rank, _ = np.linalg.lstsq(columns, residual_Nm[:, j], rcond=_LEAST_SINGULAR)
        dof = len(states) - int(rank)
        if dof >= MASSES.torques_a_weight * int(rank):
            scatter_Nm[j] = np.sqrt(np.sum((residual_Nm[:, j] - columns @ x) ** 2) / dof)
    return scatter_Nm


class RobustFit(NamedTuple):
    """Torques of n joints fitted by columns, each joint weighted by its own scatter."""

    scatter_Nm: Array  # (n,) of the residuals
    x: Array  # (k,) coefficients of the columns, with a standard normal prior


def robust_fit(columns: Array, torque_Nm: Array, rounds: int, least_Nm: float = 0.0) -> RobustFit:
    """Fit torques (P, n) by columns (P, n, k), reweighted in some rounds; see `RobustFit`.

    Args:
        least_Nm: lower bound of the scatter.
    """
    noise_Nm = np.maximum(_spread(torque_Nm - np.median(torque_Nm, axis=0)), least_Nm)
    for _ in range(rounds):
        x = Gaussian.of(columns / noise_Nm[:, None], torque_Nm / noise_Nm).mean
        noise_Nm = np.maximum(_spread(torque_Nm - columns @ x), least_Nm)
    return RobustFit(noise_Nm, x)


def _spread(residual_Nm: Array) -> Array:
    """Return the scatter (n,) of each joint's residuals (P, n), from the median of their size."""
    sigma_Nm = MEDIAN_TO_SIGMA * np.median(np.abs(residual_Nm), axis=0)
    return np.asarray(np.maximum(sigma_Nm, MASSES.least_of_largest * sigma_Nm.max()))


class ErrorsShown(NamedTuple):
    """Zeros and friction of n joints that logged torques show."""

    zero_Nm: Array  # (n,), 0 where not shown; empty where no joint shows one
    friction_Nm: Array  # the same, by the direction of arrival
    u_friction_Nm: Array  # its standard uncertainty
    text: str  # the large ones, and what to do; empty for none


class WeightFit(NamedTuple):
    """Weights of n links and a tool, fitted to logged torques."""

    amounts: Array  # (4 n + 3,) deviations from the weights described
    covariance: Array  # (4 n + 3, 4 n + 3) their covariance
    objective: float  # robust sum of squares plus that of the prior
    errors: Array  # (c,) errors of the log, over their sizes
    errors_std: Array  # (c,) their standard uncertainties


class _ErrorFit(NamedTuple):
    """Friction and zeros of n joints fitted to logged torques, with standard uncertainties."""

    friction_Nm: Array
    zero_Nm: Array
    u_friction_Nm: Array
    u_zero_Nm: Array


@dataclass(frozen=True)
class LoggedTorques:
    """Logged torques of P poses compared with those of the weights described."""

    arm: Arm  # with its weights
    payload: Payload  # what it carries
    logged_Nm: Array  # (P, n) logged torques
    residual_Nm: Array  # (P, n) logged minus calculated torques
    by_weights: Array  # (P, n, 4 n + 3) derivative of the calculated ones by `amounts`
    # (P, n, c) columns of usual errors of the log, of unit expected size: those of
    # `errors_of_logs`, then that of the external load
    nuisance: Array
    # (P, n, k) columns of what turns joints of an arm that is not calibrated yet, of unit expected
    # size: zeros of joints and links that sag move torques, and are no errors of the log; none of
    # one that is
    by_posture: Array
    load_N: Array  # (P,) external load of each pose
    arrival: Array  # (P, n) direction in which each joint arrived
    repeated: bool  # whether many of the poses are averages of readings
    # (n,) scatter of the torques, where it was found beside more errors than are in `nuisance`
    scatter_Nm: Array | None = None

    @classmethod
    def of(
        cls,
        arm: Arm,
        payload: Payload,
        poses: Observations,
        *,
        repeated: bool,
        about: Fitted | None = None,
    ) -> LoggedTorques:
        """Return the torques of poses, all logged, of an arm with stated or assumed weights.

        Args:
            about: model of its postures; None for the nominal arm.
        """
        states, described = poses.states, arm
        if arm.weights_known is not None:
            known = replace(arm.weights_known, by_log=None)
            described = replace(arm, weights_known=known)
        model, x = Model(Chain.of(described), ()), np.zeros(0)
        by_posture = np.zeros((*states.tau_Nm.shape, 0))
        if about is None:
            by_posture = _by_posture(model, states, payload)
        else:
            chain = Chain.of(described, bends=about.model.chain.bends)
            model, x = replace(about.model, chain=chain, derivative_cache=None), about.x
        calculated = statics_of(model, x, states, payload)
        rated_Nm = arm.rated_Nm(np.abs(calculated.joint_Nm).max(axis=0))
        # A wrong size or point of the external load, and a wrong tool, are faults of their own.
        load = calculated.by_load * states.load_N[:, None]
        # Where nobody stated weights, a scale of the torques is one of the weights.
        gain = MASSES.gain if arm.weights_known is None else 0.0
        usual_errors = errors_of_logs(calculated.joint_Nm, rated_Nm, states.arrival, gain)
        return cls(
            arm,
            payload,
            logged_Nm=states.tau_Nm,
            residual_Nm=states.tau_Nm - calculated.joint_Nm,
            by_weights=calculated.by_weights,
            nuisance=np.concatenate([usual_errors, load[:, :, None]], axis=2),
            by_posture=by_posture,
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
        """Return whether logged torques, less their errors, correlate with those calculated."""
        calculated_Nm = self.logged_Nm - self.residual_Nm
        without = self.without_errors(self.errors_shown(self._any_sizes))
        logged_Nm = calculated_Nm + without.residual_Nm
        product = float(np.sum(calculated_Nm * logged_Nm))
        size = np.linalg.norm(calculated_Nm) * np.linalg.norm(logged_Nm)
        return bool(product > MASSES.follows * size)

    @cached_property
    def stated_sizes(self) -> Array:
        """Return the standard uncertainties (4 n + 3,) of the weights as stated."""
        return weight_sizes(self.arm, self.payload).columns(self.arm)

    @cached_property
    def _any_sizes(self) -> Array:
        """Return the sizes (4 n + 3,) of weights of which nothing is stated."""
        bare = replace(self.arm, mass_kg=None, com_m=None, weights_known=None)
        sizes = weight_sizes(with_assumed_weights(bare), self.payload).columns(self.arm)
        return np.asarray(np.maximum(sizes, MASSES.least_of_largest * sizes.max()))

    @cached_property
    def _noise_Nm(self) -> Array:
        """Return the scatter (n,) of logged torques about a fit by weights of any size."""
        if self.scatter_Nm is not None:
            return self.scatter_Nm
        columns = self._columns(self._any_sizes)
        least_Nm = MASSES.resolved_share * max(float(np.abs(self.logged_Nm).max()), 1.0)
        scaled = MASSES.any_sizes * columns
        return robust_fit(scaled, self.residual_Nm, _REWEIGHTED, least_Nm).scatter_Nm

    @property
    def _usual_zeros_Nm(self) -> Array:
        """Return the zero (n,) that the torque of each joint may have in any log."""
        n = self.arm.n
        return np.asarray(self.nuisance[0, :, 2 * n : 3 * n].diagonal())

    def fitted(self, sizes: Array) -> WeightFit:
        """Fit weights by Huber's loss, with a prior about those described and masses above zero.

        Args:
            sizes: (4 n + 3,) standard uncertainties of `amounts`.
        """
        columns, noise_Nm = self._columns(sizes), self._noise_Nm
        column_count, weight_count = columns.shape[2], len(sizes)
        of_errors = slice(weight_count + self.by_posture.shape[2], None)
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
        std = np.sqrt(np.diag(rows.covariance)[of_errors])
        return WeightFit(x[:weight_count] * sizes, covariance, objective, x[of_errors], std)

    def _columns(self, sizes: Array) -> Array:
        """Return the columns of unit size: weights (4 n + 3,) of these sizes, postures, errors."""
        return np.concatenate([self.by_weights * sizes, self.by_posture, self.nuisance], axis=2)

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

    def fitted_in_scale_of_log(self, sizes: Array, errors: ErrorsShown) -> WeightFit:
        """Fit weights to torques less their errors, with what is left of these in the weights.

        Springs are fitted to torques with the scale errors of the log, and with zeros that do not
        show, and predictions need the same torques: their columns are left out. Weights beside such
        a zero are off by what it takes up, which predictions then lack. Postures are those of the
        model by which predictions go.
        """
        n, without = self.arm.n, self.without_errors(errors)
        kept = np.ones(without.nuisance.shape[2], dtype=bool)
        kept[:n] = False
        kept[2 * n : 3 * n] = errors.zero_Nm != 0.0 if len(errors.zero_Nm) else False
        nuisance, as_modelled = without.nuisance[:, :, kept], without.by_posture[:, :, :0]
        return replace(without, nuisance=nuisance, by_posture=as_modelled).fitted(sizes)

    def without_errors(self, errors: ErrorsShown) -> LoggedTorques:
        """Return the torques less their zeros and friction."""
        residual_Nm = self.residual_Nm
        if len(errors.zero_Nm):
            residual_Nm = residual_Nm - errors.zero_Nm
        if len(errors.friction_Nm):
            residual_Nm = residual_Nm - errors.friction_Nm * self.arrival
        return replace(self, residual_Nm=residual_Nm)

    def beside_errors(
        self, gains: Sequence[int] = (), *, loads_stated: bool = True
    ) -> LoggedTorques:
        """Return the torques beside friction, zeros, gains of joints, and loads stated wrongly.

        Their scatter is that beside all of these; gains have no prior size. They are of one joint
        against the others: all together may have the usual one, as the loads, gravity and the
        scale of the log make it, and springs then have it too. It is none of theirs if every joint
        has its own.

        Args:
            gains: joints, from 0, whose gains may be of any size; others have none.
            loads_stated: whether every load is as stated, or its size and its point may be wrong.
        """
        n, calculated_Nm = self.arm.n, self.logged_Nm - self.residual_Nm
        every_gain, common = calculated_Nm[:, :, None] * np.eye(n), MASSES.gain * calculated_Nm
        usual = self.nuisance[:, :, n : 3 * n]
        if len(gains) < n:
            usual = np.concatenate([usual, common[:, :, None]], axis=2)
        of_loads = self._loads_stated_wrongly()
        every = replace(self, nuisance=np.concatenate([usual, of_loads, every_gain], axis=2))
        of_loads = of_loads[:, :, : 0 if loads_stated else None]
        nuisance = np.concatenate([usual, of_loads, every_gain[:, :, list(gains)]], axis=2)
        return replace(self, nuisance=nuisance, scatter_Nm=every._noise_Nm)

    def _loads_stated_wrongly(self) -> Array:
        """Return columns of the size of every load, and of where all of them act, (P, n, l + 3)."""
        last, of_load = 4 * (self.arm.n - 1), self.nuisance[:, :, -1]
        sizes = [of_load * (self.load_N == load)[:, None] for load in np.unique(self.load_N)]
        gravity = float(np.linalg.norm(self.payload.gravity_m_s2))
        moments = self.by_weights[:, :, last + 1 : last + 4] * self.load_N[:, None, None] / gravity
        return np.concatenate([np.stack(sizes, axis=2), moments], axis=2)

    def gains_by_loads(self) -> tuple[int, ...]:
        """Return the joints, from 0, whose torques grow with stated loads by another factor than 1.

        Weights of any size are beside the gains, so that loads alone show them; none without loads.
        """
        n = self.arm.n
        if len(np.unique(self.load_N)) < 2 or self.payload.of_campaigns:
            return ()
        fit = self.beside_errors(range(n)).fitted(self._any_sizes)
        gain, u_gain = fit.errors[-n:], fit.errors_std[-n:]
        shown = np.abs(gain) > np.maximum(MASSES.least_gain, MASSES.differs_errors * u_gain)
        return tuple(np.flatnonzero(shown).tolist())

    def less_gains(self, gain: Array) -> LoggedTorques:
        """Return the torques less gains (n,)."""
        logged_Nm = self.logged_Nm / (1.0 + gain)
        residual_Nm = self.residual_Nm + logged_Nm - self.logged_Nm
        return replace(self, logged_Nm=logged_Nm, residual_Nm=residual_Nm)

    def errors_shown(self, sizes: Array) -> ErrorsShown:
        """Return what the torques show beside weights of these uncertainties (4 n + 3,).

        Zeros no larger than those of usual logs are not reported. Friction is that of motors and
        gears, which act before the spring of a joint: sensors at the joint show hardly any, so that
        as small a part is left in. Where poses are repeated, friction is sought as an effect.
        """
        fit = self._friction_and_zeros(sizes)
        zero_shown = np.abs(fit.zero_Nm) > MASSES.differs_errors * fit.u_zero_Nm
        of_motor_Nm = MASSES.friction_of_motor * self._usual_zeros_Nm / MASSES.zero_share
        least_Nm = np.maximum(MASSES.differs_errors * fit.u_friction_Nm, of_motor_Nm)
        friction_shown = (fit.friction_Nm > least_Nm) & (not self.repeated)

        def where(shown: Mask, torque_Nm: Array) -> Array:
            """Return torques (n,), 0 where not shown; empty where none is."""
            return np.where(shown, torque_Nm, 0.0) if shown.any() else np.zeros(0)

        return ErrorsShown(
            where(zero_shown, fit.zero_Nm),
            where(friction_shown, fit.friction_Nm),
            where(friction_shown, fit.u_friction_Nm),
            self._errors_text(fit, zero_shown, friction_shown),
        )

    def _errors_text(self, fit: _ErrorFit, zero_shown: Mask, friction_shown: Mask) -> str:
        """Return the large errors that are shown (n,) in words, and what to do."""
        large_zeros = zero_shown & (np.abs(fit.zero_Nm) > self._usual_zeros_Nm)
        clauses = []
        if large_zeros.any():
            listed = self._listed(fit.zero_Nm, fit.u_zero_Nm, large_zeros)
            clauses.append(
                f"logged torques have a zero of {listed}, which is "
                "taken out before the fit: set the zeros of the torque sensors"
            )
        if friction_shown.any():
            most = friction_shown & (fit.friction_Nm == fit.friction_Nm[friction_shown].max())
            count = int(friction_shown.sum())
            clauses.append(
                f"logged torques hold friction at {count} joint{'s' * (count > 1)}, at the most "
                f"{self._listed(fit.friction_Nm, fit.u_friction_Nm, most)}, which is taken out "
                "before the fit"
            )
        return "; ".join(clauses)

    def _listed(self, torque_Nm: Array, u_Nm: Array, of_joints: Mask) -> str:
        """Return torques (n,) with their intervals in words, of some joints (n,)."""
        return ", ".join(
            f"{with_half_width_95(torque_Nm[j], u_Nm[j], sign='+')} "
            f"{'N' if self.arm.prismatic[j] else 'N m'} at joint {j + 1}"
            for j in np.flatnonzero(of_joints)
        )

    def _friction_and_zeros(self, sizes: Array) -> _ErrorFit:
        """Fit friction and zeros beside weights, gain, and every load of its own size.

        They are infinitely uncertain where the torques are too few, or of a group, whose campaigns
        have a zero each.
        """
        n, of_load = self.arm.n, self.nuisance[:, :, -1]
        rated_Nm = self._usual_zeros_Nm / MASSES.zero_share
        zeros = np.broadcast_to(np.diag(rated_Nm), (*self.logged_Nm.shape, n))
        friction = zeros * self.arrival[:, None, :]
        of_loads = [of_load * (self.load_N == load)[:, None] for load in np.unique(self.load_N)]
        gains = self.nuisance[:, :, :n]
        nuisance = np.concatenate([gains, np.stack(of_loads, axis=2), friction, zeros], axis=2)
        others = self.by_posture.shape[2] + nuisance.shape[2]
        spare = self.residual_Nm.size - len(sizes) - others
        if spare <= 0 or self.payload.of_campaigns:
            none, unknown = np.zeros(n), np.full(n, np.inf)
            return _ErrorFit(none, none, unknown, unknown)
        fit = replace(self, nuisance=nuisance).fitted(sizes)
        widened = np.sqrt(self.residual_Nm.size / spare)  # the scatter is of residuals
        of_both, u = (
            each[-2 * n :] * np.tile(rated_Nm, 2) for each in (fit.errors, fit.errors_std)
        )
        return _ErrorFit(of_both[:n], of_both[n:], widened * u[:n], widened * u[n:])


# Models fitted to logged torques, under the torques of the weights, by which they predict.
#
# A fit takes the torques of its springs from the log, a prediction those of the weights. The two
# differ where the log has a gain, or states a tool or a load wrongly: springs are then right with
# the log and wrong without it, and no error of poses whose torques were logged shows that.

F = TypeVar("F", bound=Fitted)


def is_fitted_to_log(model: Fitted) -> bool:
    """Return whether springs of a model were fitted to logged torques, and weights are known."""
    known, springs = weights_known(model.arm), any(map(yields, model.model.terms))
    logged = known.origin == "logged" or known.by_log is not None
    return logged and springs and model.payload is not None and model.arm.mass_kg is not None


def under_weights(model: F, poses: Observations) -> tuple[F, Observations]:
    """Return a model without errors of the torque log, and poses with the torques of the weights.

    Args:
        model: was fitted to a log, see `is_fitted_to_log`.
        poses: with all else that the model's terms read.
    """
    payload = model.payload
    assert payload is not None
    of_robot = [
        term for term in model.model.terms if not (shows_torque(term) and term.error_of == "log")
    ]
    whole = with_weights_by_log(model.only(*of_robot), payload)
    nowhere = replace(
        poses.states, tau_Nm=np.full_like(poses.states.tau_Nm, np.nan), static_loads=None
    )
    states, _ = with_torques(whole.model, whole.x, nowhere, payload)
    states = with_static_loads(whole.model, whole.x, states, payload)
    return whole, poses.with_states(states)


def further_off_mm2(model: Fitted, poses: Observations) -> Array:
    """Return by how much squared errors are larger as a model predicts than with the log, (P,)."""
    # An apparatus is as stated in both: what a fit makes of it stands for a constant of the log.
    model = replace(model, targets_off_m=np.zeros(0))
    if not np.array_equal(model.T_end_shown, np.eye(4)):
        poses = replace(poses, measured=poses.measured.of_end(model.T_end_shown))
    by_log_mm = model.deviations(poses).distance_mm
    whole, weighed = under_weights(model, poses)
    return np.asarray(whole.deviations(weighed).distance_mm ** 2 - by_log_mm**2)


def lost_without_log_mm(model: Fitted, *poses: Observations) -> float:
    """Return the rms error that a model's predictions have beyond that with the log [mm].

    It is 0 where chance explains it, or torques were not logged. Noise of the log moves the poses
    of a fit and not predictions, so that these may be better.

    Args:
        poses: averaged poses, as modelled, in sets, such as those fitted and those held out: the
            largest of the sets counts.
    """
    if not is_fitted_to_log(model):
        return 0.0
    return max((_lost_mm(model, each) for each in poses if len(each)), default=0.0)


def _lost_mm(model: Fitted, poses: Observations) -> float:
    more_mm2 = further_off_mm2(model, poses)
    if not np.isfinite(more_mm2).all():
        return 0.0
    # Loads at one pose go with each other: they count as one.
    pose = np.unique(poses.pose, return_inverse=True)[1]
    of_poses_mm2 = np.bincount(pose, more_mm2).astype(float)
    if of_poses_mm2.sum() <= LACK.surely * standard_error_of_sum(of_poses_mm2):
        return 0.0
    return float(np.sqrt(more_mm2.mean()))
