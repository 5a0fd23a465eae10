"""Repeats: which readings repeat others, and the noise that they show.

The noise is the pure error: the difference of successive readings of one pose, load and direction
of arrival. Successive readings are compared, and not readings with their mean, so that slow drifts
and dependence on the direction of arrival are no noise (von Neumann's mean square of successive
differences). If the order of the poses changes, hardly any is reached from the same side twice:
then all repeats of a pose and load are compared, less what follows the direction of each joint.
The noise is attributed to its sources, positions of joints and the instrument, so that it can be
stated for any pose.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.rules import NOISE
from pa10cal.errors import DiscoveryError
from pa10cal.numerics.covariances import likelier_variances, of_seen, source_variances
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_groups


def same_circumstances(readings: Observations) -> Index:
    """Return the number (P,), from 0, of each reading's pose, load and direction of arrival."""
    _, pose = np.unique(readings.pose, return_inverse=True)
    keys = np.column_stack([pose, readings.states.load_N, readings.states.arrival])
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def repeat_groups(readings: Observations) -> Index:
    """Return the number (P,), from 0, of each reading's group, within which readings are repeats.

    A group is of one pose, load and direction of arrival, or of one pose and load where hardly any
    is reached from the same side twice.
    """
    same = same_circumstances(readings)
    pairs = len(readings) - len(np.unique(same))
    if pairs >= NOISE.least_repeated_share * len(readings):
        return same
    any_side = reading_groups(readings)
    pairs_of_any_side = len(readings) - len(np.unique(any_side))
    return any_side if pairs_of_any_side > NOISE.any_side_ratio * pairs else same


def repeated(readings: Observations) -> int:
    """Return the number of readings that repeat an earlier one of their `repeat_groups`."""
    return len(_pairs(readings)[0])


def enough_repeats(readings: Observations) -> bool:
    """Return whether so many readings are repeats that these show the noise of all."""
    least = max(NOISE.least_differences, NOISE.least_repeated_share * len(readings))
    return repeated(readings) >= least


def _pairs(readings: Observations) -> tuple[Index, Index]:
    """Return the latest earlier reading of every one that repeats another, and that one, (D,) each.

    Of the same one of `repeat_groups`, with a component that both have: of an instrument that looks
    at targets in turn, the next reading may have none.
    """
    groups = repeat_groups(readings)
    order = np.lexsort((readings.states.time_s, groups))
    group, seen = groups[order], readings.measured.components_seen[order]
    earlier, later = np.full(len(order), -1), np.arange(len(order))
    back = 0
    while len(later):  # those for which none was found yet among as many before them
        back += 1
        later = later[later >= back]
        later = later[group[later] == group[later - back]]
        shared = (seen[later] & seen[later - back]).any(axis=1)
        earlier[later[shared]] = later[shared] - back
        later = later[~shared]
    at = np.flatnonzero(earlier >= 0)
    return order[earlier[at]], order[at]


# The noise that they show.


def noise_of_repeats(readings: Observations, deviation: Array, screws: Array) -> Noise:
    """Find the noise of P single readings from repeats.

    Args:
        deviation: (P, b) components measured less those of a model at each reading's own joint
            positions and torques.
        screws: (P, b, n) derivative of the components by the joint positions.

    Raises:
        DiscoveryError: when too little is repeated, or repeats show no noise.
    """
    first, second = _pairs(readings)
    _refuse_too_few(len(first))
    measured, states = readings.measured, readings.states
    seen = measured.components_seen
    both = seen[first] & seen[second]
    # Divided by the root of two, a difference has the variance of one reading.
    difference = np.where(both, deviation[second] - deviation[first], 0.0) / np.sqrt(2.0)
    tau_difference_Nm = (states.tau_Nm[second] - states.tau_Nm[first]) / np.sqrt(2.0)
    turned = (states.arrival[second] - states.arrival[first]) / np.sqrt(2.0)
    if turned.any():  # what follows the direction of arrival of each joint is no noise
        sizes = np.sqrt(np.diagonal(measured.stated_covariance, axis1=1, axis2=2)[first])
        by_direction = 0.5 * (screws[first] + screws[second]) * turned[:, None, :]
        difference = _without_arrivals(difference, by_direction, sizes, both)
        tau_difference_Nm = _torque_without_arrivals(tau_difference_Nm, turned)
    sources = _covariances_by_source(screws, measured)
    variances = _variances(difference, 0.5 * (sources[first] + sources[second]), both, measured)
    n = screws.shape[2]
    return Noise(
        cov=of_seen(np.einsum("k,pkij->pij", variances, sources), seen),
        differences=len(first),
        pairs_are="pairs of successive readings of one pose, load and direction",
        components_compared=int(both.sum()),
        joint_rad=np.sqrt(variances[:n]),
        instrument=float(np.sqrt(variances[n])),
        torque_Nm=_torque_noise_Nm(tau_difference_Nm, states.tau_Nm),
    )


def _refuse_too_few(pairs: int) -> None:
    if pairs < NOISE.least_differences:
        raise DiscoveryError(
            "too few repeats to determine the repeatability of the measurement",
            where="grid poses",
            value=f"{pairs} pairs of successive readings of one pose, load and direction",
            allowed=f"at least {NOISE.least_differences}",
            remedy="measure poses repeatedly",
        )


def _without_arrivals(difference: Array, columns: Array, sizes: Array, seen: Mask) -> Array:
    """Return differences (D, b), 0 where not seen, less their fit by what follows arrivals.

    Args:
        columns: (D, b, n) what an error of each joint that follows its arrival makes of them.
        sizes: (D, b) stated standard uncertainties, by which the fit weighs them.
        seen: (D, b) components that both readings have.
    """
    weight = np.where(seen, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
    white = (columns * weight[..., None]).reshape(-1, columns.shape[2])
    amounts = np.linalg.lstsq(white, (difference * weight).ravel(), rcond=None)[0]
    return np.where(seen, difference - columns @ amounts, 0.0)


def _torque_without_arrivals(tau_difference_Nm: Array, turned: Array) -> Array:
    """Return differences of torques (D, n) less the part that follows the arrival of each joint."""
    logged = np.isfinite(tau_difference_Nm)
    squares = np.sum(turned**2, axis=0, where=logged)
    products = np.sum(turned * tau_difference_Nm, axis=0, where=logged)
    return np.asarray(tau_difference_Nm - turned * products / np.where(squares, squares, 1.0))


def _covariances_by_source(screws: Array, measured: Instrument) -> Array:
    """Return the covariances (P, s, b, b) of components by unit variances of s sources.

    Of each joint's position, of what the instrument states, and of an independent error of each
    kind of component.
    """
    seen, stated = measured.components_seen, measured.stated_covariance
    of_sources = [np.einsum("pik,pjk->pkij", screws, screws), stated[:, None]]
    for _, at in measured.component_kinds:
        rows, of_kind = np.arange(seen.shape[1])[at], np.zeros((len(seen), 1, *stated.shape[1:]))
        of_kind[:, 0, rows, rows] = seen[:, at]
        of_sources.append(of_kind)
    return np.concatenate(of_sources, axis=1)


def _variances(difference: Array, sources: Array, both: Mask, measured: Instrument) -> Array:
    """Return the variances (s,) of sources: joints, what the instrument states, errors of kinds.

    They are those that fit differences best, unless the instrument's alone are likelier.

    Args:
        difference: (D, b) of pairs of readings, of the variance of one.
        sources: (D, s, b, b) covariance by unit variances, see `_covariances_by_source`.
        both: (D, b) components that both readings of a pair have.
        measured: all readings.

    Raises:
        DiscoveryError: when some component shows no noise.
    """
    of_pairs = np.where((both[:, :, None] & both[:, None, :])[:, None], sources, 0.0)
    stated = sources.shape[1] - len(measured.component_kinds) - 1
    try:
        found = source_variances(difference, of_pairs, both, NOISE.reweighted)
        of_instrument = np.eye(len(found))[stated]
        return likelier_variances(found, of_instrument, difference, of_pairs, both)
    except np.linalg.LinAlgError:
        raise _no_noise(measured, difference, both) from None


def _no_noise(measured: Instrument, difference: Array, both: Mask) -> DiscoveryError:
    """Return the refusal of repeats whose differences (D, b) show no noise."""
    largest = f"largest difference of two readings {np.abs(difference).max():.3g} m or rad"
    if rounded := measured.rounded_kinds(difference, both):
        return DiscoveryError(
            f"repeats of the {' and the '.join(rounded)} are the same in every digit",
            where="grid poses",
            value=largest,
            allowed="numbers with so many digits that repeats differ by the noise",
            remedy="export them with more digits",
        )
    return DiscoveryError(
        "the scatter of repeats shows no noise in some component of the readings",
        where="grid poses",
        value=largest,
        allowed="repeats that differ by the noise of joints and instrument",
        remedy="look for readings with a gross error, and for readings that were copied",
    )


def _torque_noise_Nm(difference_Nm: Array, tau_Nm: Array) -> Array:
    """Return the noise of each joint's torque, (n,), by differences (D, n) of the torques (P, n).

    A torque whose log does not scatter, as if it always reads zero, counts as uncertain as the one
    that scatters most.
    """
    logged = np.isfinite(difference_Nm)
    count = logged.sum(axis=0)
    squares = np.sum(difference_Nm**2, axis=0, where=logged)
    noise_Nm = np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)
    largest_Nm = np.abs(tau_Nm).max(initial=0.0, where=np.isfinite(tau_Nm))
    scatters = noise_Nm > NOISE.rounded_torque_share * largest_Nm
    quiet = (count > 0) & ~scatters
    return np.where(quiet, noise_Nm.max(initial=0.0, where=scatters), noise_Nm)
