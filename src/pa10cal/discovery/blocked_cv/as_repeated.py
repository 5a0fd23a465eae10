"""A campaign in which hardly any pose is repeated, as the search by evidence would have it.

Poses that separate rival effects are proposed from such a problem, whichever scorer found them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem, pose_noise_model
from pa10cal.discovery.model_with_effects import ModelWithEffects
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.nuisances import TimeFindings
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.tuning import NEXT_POSES
from pa10cal.numerics.covariances import whitener_of


def as_repeated(
    survey: Survey, found: ModelWithEffects, noise: Noise
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return a campaign without repeats as the problem of one with repeats, and a fit to it.

    The scatter beyond the noise of readings is the variance of the error that readings of a pose
    share. Of very many poses some are used, each of which stands for several.
    """
    count = len(survey.poses)
    rows = np.linspace(0, count - 1, min(count, NEXT_POSES.most_measured)).round().astype(np.intp)
    survey = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    poses = survey.poses
    joint_rad = noise.joint_rad if len(noise.joint_rad) else np.zeros(poses.states.n)
    noise = replace(noise, cov=noise.cov[rows], joint_rad=joint_rad)
    white = whitener_of(noise.cov) @ survey.net_residual(found.at)[:, :, None]
    scatter = float(np.sum(white**2) / poses.measured.components_seen.sum())
    in_time = TimeFindings(survey.wander, has_drift=False)
    cov = noise.cov * len(rows) / count
    setup = survey.setup
    problem = EvidenceProblem(
        calibrated=survey.baseline,
        baseline=survey.baseline,
        setup=setup,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        noise=noise,
        pose=pose_noise_model(poses, cov, survey.baseline, setup, in_time),
        torque=None,
        torque_without_weights_Nm=np.zeros_like(poses.states.tau_Nm),
        context=survey.context,
        torques_logged=survey.torques_logged,
        in_time=in_time,
        poses_a_cell=count / len(rows),
    )
    fit = EvidenceFit(
        effects=found.effects,
        at=found.at,
        converged=found.converged,
        iterations=found.iterations,
        sizes=(EVIDENCE.sizes.index(1.0),) * len(found.effects),
        variances=SharedVariances(max(scatter - 1.0, 0.0), 0.0),
    )
    return problem, fit
