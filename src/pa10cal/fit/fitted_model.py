"""A fitted model: everything that a user takes away from a calibration, and what it predicts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.compensation import compensate
from pa10cal.fit.fitted import FLANGE, Compensation, Fitted, Prediction
from pa10cal.fit.forward import Forward, T_flange_frame, predicted, states_at
from pa10cal.fit.model_file import covariance_beside, file_of, model_from_plain, save_model
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.yaml_file import read_yaml


@dataclass(frozen=True, eq=False, repr=False)
class FittedModel(Fitted):
    """A chain with terms and the values of their parameters; enough by itself to predict."""

    def save(self, path: str | Path) -> None:
        """Write the model as `model.yaml`, its covariance beside it, whole or not at all.

        Raises:
            OutputError: when it cannot be written there.
        """
        save_model(self, Path(path))

    def predict(
        self,
        q: ArrayLike,
        *,
        frame: str = FLANGE,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Prediction:
        """Predict where a frame of the robot is.

        Torques are those of the weights described. What an instrument reads falsely, and what a
        torque log shows falsely, moves no robot and plays no part.

        Args:
            q: (N, n) or (n,) motor-side joint positions [rad; m for a prismatic joint].
            frame: `flange`, the last frame of the nominal arm; `tool`, the target of a pose
                instrument, else the first target with the flange's orientation; `target_<name>`. Of
                a group also `tool@<campaign>` and `target_<name>@<campaign>`.
            load_N: external load, one for all poses or (N,).
            arrival: direction in which each joint arrives, -1 or 1, one for all or (N, n); 0 where
                it is not known, whose lost motion is then part of `u_mm`.
            temperature_C: temperature, one or (N,); None for the mean of the fit.
            time_s: time on the campaign's clock, one or (N,); None for the middle of the fit.
            extrapolate: predict also for loads heavier than any that the fit has seen.

        Raises:
            ModelError: when q is of another arm, the frame is unknown, a load is heavier than those
                of the fit, or the model has springs and the masses that load them are not known.
        """
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, self._positions(q), *of_pose, extrapolate=extrapolate)
        return predicted(self, given, frame)

    def compensate(
        self,
        T: ArrayLike,
        *,
        frame: str = FLANGE,
        seed: ArrayLike | None = None,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
        T_flange_tcp: ArrayLike | None = None,
    ) -> Compensation:
        """Find the joint positions to command so that a frame of the robot comes to poses.

        `T_send`, and `cartesian(angles)` of what is returned, have the poses to send to a
        controller that takes no joint positions and holds the nominal model.

        Args:
            T: (N, 4, 4) or (4, 4) poses wanted of the frame, in the robot's base frame [m].
            seed: (N, n) or (n,) joint positions; of all branches the nearest within the joint
                limits is taken. A row of nan, and every row but the first where (n,) is given, has
                the nearest to the row before; without any the first row has the nearest to the
                middle of the angles that the fit has seen.
            frame, load_N, arrival, temperature_C, time_s, extrapolate: see `predict`.
            T_flange_tcp: (4, 4) TCP that the controller holds, in its flange [m]; None for the
                frame as the model has it (none for the flange).

        Raises:
            ModelError: when a pose is none, or see `predict`.
        """
        wanted = np.asarray(T, dtype=float)
        wanted = wanted[None] if wanted.ndim == 2 else wanted
        nowhere = np.zeros((len(wanted), self.arm.n))
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, nowhere, *of_pose, extrapolate=extrapolate)
        return compensate(self, wanted, frame, given, seed, T_flange_tcp)

    def jacobian(self, q: ArrayLike, *, frame: str = FLANGE, load_N: ArrayLike = 0.0) -> Array:
        """Return how a frame moves with the joints, (N, 6, n), at positions as for `predict`.

        Velocity of its origin [m] over angular velocity [rad], along base axes, a unit of each
        joint. Exact: springs and effects, which change with angles and weights, are in it.
        """
        forward, given = Forward.of(self, frame), states_at(self, self._positions(q), load_N)
        return forward.by_joints(forward.states(given), terms=True)[1]

    def states(self, q: ArrayLike, load_N: ArrayLike = 0.0) -> PoseStates:
        """Return the states in which poses are predicted, with what their weights do.

        Raises:
            ModelError: see `predict`.
        """
        return Forward.of(self).states(states_at(self, self._positions(q), load_N))

    def T_flange_frame(self, frame: str) -> Array:
        """Return where a frame is in the flange, unloaded, (4, 4) [m].

        Raises:
            ModelError: when the frame is unknown.
        """
        return T_flange_frame(self, frame)

    def _positions(self, q: ArrayLike) -> Array:
        """Return joint positions (N, n).

        Raises:
            ModelError: when they are of an arm with other joints, or are no numbers.
        """
        positions = np.atleast_2d(np.asarray(q, dtype=float))
        n = self.arm.n
        if positions.ndim != 2 or positions.shape[1] != n or not np.isfinite(positions).all():
            raise ModelError(
                f"joint positions of {positions.shape[-1]} joints"
                if positions.shape[-1] != n
                else "joint positions that are no finite numbers",
                where="q",
                value=positions.shape,
                allowed=f"(N, {n}) for {self.arm.name}",
                remedy="give one column a joint, in radians (metres for a joint that slides)",
            )
        return positions


def load_model(path: str | Path) -> FittedModel:
    """Read a fitted model; without the file of its covariance it predicts without uncertainty.

    Args:
        path: of model.yaml, or of the folder `model`, or of the results, that it lies in.

    Raises:
        ModelError: when the file, or that of its covariance, cannot be read, is of another schema,
            or lacks a key.
        TermError: when it has a term that is not known.
    """
    path = file_of(Path(path))
    content = read_yaml(
        path,
        ModelError,
        what="the model cannot be read",
        allowed="a model.yaml that this package wrote",
        remedy="correct the path, or write the model again",
    )
    covariance = covariance_beside(path)
    return model_from_plain(content, FittedModel, where=str(path), covariance=covariance)


def models_of(record: CalibrationRecord, where: str) -> dict[str, FittedModel]:
    """Return the fitted models of a calibration by the names under which they are evaluated.

    Args:
        record: what `calibration/<load>.json` holds; the last model is the calibration itself.
        where: file that it was read from, for messages.

    Raises:
        ModelError: when a model cannot be made of what is written.
        TermError: when it has a term that is not known.
    """
    models = {}
    for name, fit in record.fits_by_model.items():
        place = f"{where}: fitted_model of {name}"
        model = model_from_plain(fit.fitted_model, FittedModel, where=place)
        # The covariance is of the parameters that it is solved in, or of those reported.
        names, matrix = fit.covariance.names, fit.covariance.matrix
        solved = tuple(parameter.name for parameter in model.model.parameters)
        report, k = model.model.report(model.x), len(solved)
        covariance = np.zeros((k + 6, k + 6))
        if names[:k] == solved:
            base = [name.replace(".", "_") for name in BASE]
            known = [names.index(name) for name in (*solved, *base) if name in names]
            at = [*range(k), *(k + base.index(name) for name in names if name in base)]
            covariance[np.ix_(at, at)] = matrix[np.ix_(known, known)]
            model = replace(model, covariance=covariance)
        elif names == tuple(parameter.name for parameter in report.parameters):
            back = np.linalg.pinv(report.jacobian)
            covariance[:k, :k] = back @ matrix @ back.T
            model = replace(model, covariance=covariance)
        models[name] = model
    return models
