"""What is kept of an effect is what it would say anew, at whatever states."""

from dataclasses import replace

import numpy as np

from pa10cal.terms.model import Kept


def drawn(effect, rng):
    """Return parameters of an effect, of about its plausible sizes."""
    sizes = np.ones(len(effect.parameters))
    start = effect.starts[-1]
    start = np.where(start == 0.0, 1e-4 * sizes, start)
    return start * rng.uniform(0.5, 1.0, len(sizes))


def test_kept_derivatives_and_shifts_are_those_worked_out_anew(effect, states):
    rng, kept = np.random.default_rng(5), Kept()
    cooler = replace(states, temperature_C=states.temperature_C - 3.0)
    for at in (
        states,
        states,
        replace(states, tau_Nm=0.5 * states.tau_Nm),
        cooler,
        replace(cooler, q_rad=cooler.q_rad + 0.1),
        states.take(slice(0, 2)),
        states,
    ):
        x = drawn(effect, rng)
        np.testing.assert_array_equal(
            kept.derivative(effect, at, x), effect.derivative(at, x), strict=True
        )
        shift = effect.shift(at, x)
        np.testing.assert_allclose(kept.shift(effect, at, x), shift, rtol=1e-12, atol=1e-18)
