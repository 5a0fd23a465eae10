"""A model in another place: its frames are found there, its uncertainty goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.calibration.general.other_campaign import refit_frames
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint_error_map import BandPrior, SensorError
from pa10cal.terms.model import Model
from pa10cal.terms.term import link_departures

BAND = BandPrior(5e-5, 3e-5, 6e-5, 3.0, 8.0, 3.0, 1e-6)


@pytest.fixture(name="model")
def _model():
    arm = load_arm("ur10")
    links = link_departures(arm, Tolerances()).only({"delta_a_2", "delta_theta_3"})
    terms = (links, *(SensorError(f"joint {joint}", 36, BAND) for joint in (1, 2)))
    root = np.zeros((2 + 72 + 6,) * 2)
    root[0, 0], root[1, 1] = 1e-4, 1e-4
    for k, term in enumerate(terms[1:]):
        at = slice(2 + 36 * k, 38 + 36 * k)
        root[at, at] = term.prior_factor
    return FittedModel(
        Model(Chain.of(arm), terms), np.zeros(74), np.eye(4), covariance=root @ root.T
    )


def test_what_frames_take_up_is_uncertain_no_more(model, see):
    rng = np.random.default_rng(8)
    every = see("ur10", "pose", count=120, size=0.0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=3).as_matrix(), [0.4, -1.2, 0.3]
    root = np.linalg.cholesky(model.covariance[:74, :74] + 1e-20 * np.eye(74))
    squares, expected = [], []
    for _ in range(12):
        true = replace(model, x=root @ rng.standard_normal(74))
        seen = T @ true.model.predict(every.states, true.x)
        poses = replace(every, measured=replace(every.measured, T_instr_target=seen))
        moved = refit_frames(model, poses)
        assert moved.covariance.shape == (74 + 6 + 6,) * 2
        squares.append(moved.deviations(poses).distance_mm ** 2)
        expected.append(moved.predict(every.states.q_rad, frame="tool").u_mm ** 2)
    ratio = np.mean(squares) / np.mean(expected)
    assert ratio == pytest.approx(1.0, abs=0.25)
    before = model.predict(every.states.q_rad).u_mm
    assert np.mean(expected) < np.mean(before**2)
