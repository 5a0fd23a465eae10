"""How accurate predictions are: errors of poses in summary, and those of held-out poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.tails import far_from_prediction
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.quantities import Deviations
from pa10cal.results.evaluation import BETWEEN, UNSEEN, Accuracy, BeforeAfter


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


@dataclass(frozen=True)
class HeldOut:
    """Remaining errors of held-out poses."""

    accuracy: Accuracy  # the errors; of poses along a path, those on stretches that were not fitted
    u_mm: float | None = None  # rms standard uncertainty of the predictions; None where not known
    # how many of their deviations by it are independent: one where a single parameter, such as a
    # stiffness under loads beyond those fitted, makes them all; None where not known
    independent: float | None = None
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

    def with_predictions(self, position: Array, cov: Array) -> HeldOut:
        """Return the errors with the uncertainty of the predictions.

        Args:
            position: (P, c, k) derivative of the predicted positions [m].
            cov: (k, k) of the parameters.
        """
        rows = position.reshape(-1, len(cov))
        # The covariance of predictions, rows cov rows', has the trace of this product, and its
        # square that of the square.
        product = rows.T @ rows @ cov
        variance, square = max(float(np.trace(product)), 0.0), float(np.sum(product * product.T))
        return replace(
            self,
            u_mm=1e3 * float(np.sqrt(variance / len(position))),
            independent=variance**2 / square if square > 0.0 else None,
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
    return errors.with_predictions(position[places.counted(trusted)], cov)
