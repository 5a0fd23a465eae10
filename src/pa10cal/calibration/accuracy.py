"""Errors of predicted poses: summaries as the paper states them, and those of held-out poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.rules import GRADES
from pa10cal.calibration.two_level_problem import fit_base_frame
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.tails import far_from_prediction
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import Deviations
from pa10cal.observe.seed import least_loaded
from pa10cal.results.evaluation import BETWEEN, UNSEEN, Accuracy, BeforeAfter
from pa10cal.terms.model import Model


def summarise(found: Deviations, rows: NDArray[np.bool_] | slice = slice(None)) -> Accuracy:
    """Summarise deviations over some rows, all by default."""
    distance, angle = found.distance_mm[rows], found.angle_deg
    return Accuracy(
        mean_mm=float(distance.mean()),
        peak_mm=float(distance.max()),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        orientation_deg=None if angle is None else float(angle[rows].mean()),
        configurations=len(distance),
    )


def summarise_by_load(found: Deviations, load_N: Array) -> dict[str, Accuracy]:
    """Summarise deviations for every load, keyed as the files are named: `0N`, `22N`, …"""
    return {f"{load:g}N": summarise(found, load_N == load) for load in np.unique(load_N)}


def summarise_trusted(
    before: Deviations, after: Deviations, load_N: Array, flagged: NDArray[np.bool_]
) -> dict[str, BeforeAfter]:
    """Summarise, for each load with flagged configurations, two models over those not flagged.

    Args:
        before, after: over P configurations.
        load_N: (P,) their loads.
        flagged: (P,) which of them have a reading far from the model.
    """
    found = {}
    for load in np.unique(load_N[flagged]):
        rows = (load_N == load) & ~flagged
        if rows.any():
            found[f"{load:g}N"] = BeforeAfter(
                before=summarise(before, rows), after=summarise(after, rows)
            )
    return found


def targets_seen(measured: Instrument) -> Array:
    """Return how many targets were seen in each pose, (P,); 1 where none was."""
    seen = measured.components_seen[:, measured.position_columns]
    return np.asarray(np.maximum(1.0, seen.sum(axis=1) // 3))


def of_one_target(measured: Instrument, jacobian: Array) -> Array:
    """Return the position rows (P, c, k) of a derivative (P, b, k), scaled to one target.

    They are divided by the square root of the number of targets seen, so that the sum of squares
    over all targets becomes their mean.
    """
    root = np.sqrt(targets_seen(measured))[:, None, None]
    return np.asarray(jacobian[:, measured.position_columns] / root)


def gram(rows: Array) -> Array:
    """Return the Gram matrix (k, k) of rows (P, b, k)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return np.asarray(flat.T @ flat)


def position_noise_mm(measured: Instrument, covariance: Array) -> float:
    """Return the rms position error of one target by a covariance (P, b, b) of the readings."""
    columns = measured.position_columns
    variances = np.diagonal(covariance, axis1=1, axis2=2)[:, columns]
    seen = np.where(measured.components_seen[:, columns], variances, 0.0)
    return float(1e3 * np.sqrt(np.mean(seen.sum(axis=1) / targets_seen(measured))))


def align_nominal(nominal: Model, observations: Observations[Pose]) -> Array:
    """Return T_instr_base (4, 4) that aligns the nominal model with the least loaded positions.

    The paper's errors before calibration rest on this alignment: by positions alone, of the poses
    with the smallest load, which was zero in the paper's campaign; of all where few have it.
    """
    unloaded = observations.take(least_loaded(observations))
    return fit_base_frame(
        nominal.predict(unloaded.states, np.zeros(0)),
        unloaded.measured.T_instr_target,
        attitude_weight_m2=0.0,
    ).T_instr_base


@dataclass(frozen=True)
class NoisyCampaign:
    """The campaign of a group whose error exceeds its noise by more than the others' does."""

    name: str
    error_mm: float  # rms error of its poses
    noise_mm: float  # the same that its stated noise makes
    others_mm: float  # rms error of the poses of the other campaigns
    others_noise_mm: float  # the same that their stated noise makes

    def __str__(self) -> str:
        return (
            f"{self.name} alone is noisier than stated: {self.error_mm:.3f} mm rms beside a noise "
            f"of {self.noise_mm:.3f} mm, the others {self.others_mm:.3f} mm beside "
            f"{self.others_noise_mm:.3f} mm; check there the resolution of the joints' log, the "
            "instrument, and how tool and targets are fixed"
        )


def noisy_campaign(poses: Observations, error_mm: Array, covariance: Array) -> NoisyCampaign | None:
    """Return the campaign of a group that alone is noisier than stated; None for none.

    Args:
        poses: P poses, of a group or not.
        error_mm: (P,) their position errors.
        covariance: (P, b, b) of their readings, as stated.
    """
    excess: dict[str, tuple[float, NoisyCampaign]] = {}
    campaign = np.asarray(poses.states.campaign)
    for number, (name, _) in enumerate(poses.measured.campaigns):
        own: Mask = campaign == number
        if not 0 < own.sum() < len(own):
            continue
        (error, noise, u), (others, others_noise, u_others) = (
            _mean_squares(poses.take(rows), error_mm[rows], covariance[rows])
            for rows in (own, ~own)
        )
        # what it would be if it exceeded its noise by as much as the others do theirs
        expected = noise + max(others - others_noise, 0.0)
        more = error - expected
        surely = more > GRADES.chance_errors * np.hypot(u, u_others)
        if surely and error > GRADES.over_noise**2 * expected:
            roots = np.sqrt([error, noise, others, others_noise]).tolist()
            excess[name] = more, NoisyCampaign(name, *roots)
    return max(excess.values(), key=lambda found: found[0])[1] if excess else None


def _mean_squares(
    poses: Observations, error_mm: Array, covariance: Array
) -> tuple[float, float, float]:
    """Return mean squared errors [mm²]: as found, of noise, and the uncertainty of the first.

    Errors of all targets in a pose may be one error of the arm: they count as one position.
    """
    found = float(np.mean(error_mm**2))
    seen = poses.measured.components_seen[:, poses.measured.position_columns].sum(axis=1)
    count = float(np.minimum(seen, 3).sum())
    noise_mm = position_noise_mm(poses.measured, covariance)
    return found, noise_mm**2, found * float(np.sqrt(2.0 / max(count, 1.0)))


@dataclass(frozen=True)
class HeldOut:
    """Remaining errors of held-out poses."""

    accuracy: Accuracy  # the errors; of poses along a path, those on stretches that were not fitted
    u_mm: float | None = None  # rms standard uncertainty of the predictions; None where not known
    repeats: float = 1.0  # readings averaged per held-out pose, over those per fitted pose
    suspected: int = 0  # poses that `accuracy` is without, as a reading is a suspected outlier
    where: str = ""  # where the poses lie, in words; empty where they are well separated
    # errors of poses between fitted ones; None where `accuracy` is of all poses
    between: Accuracy | None = None

    @classmethod
    def of(
        cls, found: Deviations, places: HeldOutPlaces, trusted: Mask, fitted: Index, away: Index
    ) -> HeldOut:
        """Return the errors of P held-out poses without those with a suspected outlier.

        Args:
            trusted: (P,) which of them have no suspected outlier.
            fitted, away: readings averaged for each pose fitted, and for each held out (P,).
        """
        rows, between_fitted = places.counted(trusted), places.between
        of_these = np.ones_like(trusted) if places.unseen is None else places.unseen
        where = ""
        between: Accuracy | None = None
        if places.unseen is not None:
            where = UNSEEN
            if between_fitted is not None and (between_fitted & trusted).any():
                between = summarise(found, between_fitted & trusted)
        elif between_fitted is not None:
            where = BETWEEN
        return cls(
            accuracy=summarise(found, rows),
            repeats=float(np.mean(1.0 / fitted) / np.mean(1.0 / away[rows])),
            suspected=int(np.count_nonzero(of_these & ~rows)),
            where=where,
            between=between,
        )


def held_out_errors(
    model: FittedModel,
    every: Observations,
    fitted: Observations,
    held_out: Observations,
    position: Array,
    cov: Array,
) -> HeldOut:
    """Return the errors of held-out poses, and the uncertainty of the predictions there.

    Poses with a suspected outlier do not count, unless all have one.

    Args:
        every: all readings; those of `held_out` are all its readings that are held out.
        fitted, held_out: averaged poses, P of them held out, in the order of their readings.
        position: (P, c, k) derivative of the predicted positions of those held out [m], of one
            target each (`of_one_target`).
        cov: (k, k) of the parameters.
    """
    # The evaluation finds suspected outliers by the same rule.
    single, used = every.of_kind("holdout"), every.of_kind("grid")
    far, _ = far_from_prediction(model.as_modelled(single), model, model.as_modelled(used))
    suspected = np.bincount(reading_groups(single), far) > 0.0
    trusted = ~suspected | suspected.all()
    places = HeldOutPlaces.of(held_out, fitted)
    deviations = model.deviations(held_out)
    errors = HeldOut.of(deviations, places, trusted, fitted.readings, held_out.readings)
    position = position[places.counted(trusted)]
    variance = np.einsum("pck,kl,pcl->p", position, cov, position, optimize=True)
    return replace(errors, u_mm=float(1e3 * np.sqrt(np.mean(np.maximum(variance, 0.0)))))
