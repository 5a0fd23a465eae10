"""The interface of all kinds of instruments: measurements, and whatever depends on the kind.

An instrument holds measurements of P poses with their covariance. Everything that differs between
kinds is a method of their class, so that no other code depends on the kind.

The chain ends at the end-effector frame. The position of a target in it belongs to the model: six
small motions of the tool for an instrument that measures poses, three coordinates of each target
for others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import ObservedTargets
from pa10cal.arrays import Array, Index, Mask, Rows, take_rows
from pa10cal.errors import CalibrationError
from pa10cal.frame.hand_eye import Located
from pa10cal.observe import quantities
from pa10cal.observe.base_targets import BaseTargets
from pa10cal.rules import READINGS
from pa10cal.terms.term import TermParameter

#: How the base is found before any calibration, as `seed/base_frame.json` has it.
LocatingMethod = Literal[
    "rigid_fit_nominal", "hand_eye_poses", "hand_eye_points", "ranging", "nominal_arm"
]


@dataclass(frozen=True)
class Instrument(ABC):
    """Measurements of P poses, of b components each.

    Arguments of the methods: `T_instr_ee` and `T_base_ee` are the end of the chain (P, 4, 4) in the
    frame of the instrument or of the base [m]; `targets_m` are the coordinates (t,) of the targets
    in the end-effector frame, in the order of `target_parameters`; `compare` and `deviations` take
    (P, t) as well, where they differ from pose to pose.
    """

    kind: ClassVar[str]  # the word of `instrument.kind` in campaign.yaml
    # how `locate` finds the base, a word of `seed/base_frame.json`
    locates_by: ClassVar[LocatingMethod] = "nominal_arm"
    words: ClassVar[quantities.Words]  # phrases for captions
    # whether it measures position and orientation, as the paper's model needs
    measures_pose: ClassVar[bool] = False
    # whether its raw data are touches and a resolver log, as in the paper
    from_touches: ClassVar[bool] = False
    # whether it moves along three axes, each with a scale error of its own
    three_axes: ClassVar[bool] = False
    # whether measurements depend on directions in its frame; if not, neither the orientation of the
    # base nor the direction of an error can be determined
    directional: ClassVar[bool] = True
    # whether straight moves along the base's axes help to find the base frame
    uses_lines: ClassVar[bool] = False
    # whether it measures several targets on the end-effector
    several_targets: ClassVar[bool] = False
    # whether it may measure targets on the base as well, in every configuration
    sees_base: ClassVar[bool] = False
    # least number of rows for which a wrong one can be found: four times the number that determines
    # frames and targets
    least_rows: ClassVar[int]
    #: Names of the fields that belong to all poses together.
    _of_all: ClassVar[tuple[str, ...]] = ()

    def __len__(self) -> int:
        return len(self.places_m)

    @property
    def campaigns(self) -> tuple[tuple[str, Instrument], ...]:
        """Return name and measurements of every campaign of a group; empty for one campaign."""
        return ()

    @property
    def R_first_target_of(self) -> Mapping[str, Array]:
        """Return by name, for a group, each campaign's target orientation (3, 3) in the first's."""
        return {}

    @property
    def p_first_instr_of(self) -> Mapping[str, Array]:
        """Return by name, for a group, where each instrument stands (3,), in the common frame."""
        return {}

    @property
    def parts_seen(self) -> tuple[tuple[Index | slice, slice], ...]:
        """Return, for each campaign of a group, its poses and the components measured in them."""
        return ((slice(None), slice(None)),)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the words of the instruments of all campaigns, each once."""
        return (self.kind,)

    @abstractmethod
    def in_frame(self, T: Array) -> Self:
        """Return the measurements in a frame in which the instrument's frame is at T (4, 4)."""

    def steadied(self, base: BaseTargets) -> Self:
        """Return the measurements without the motion that targets on the base show."""
        return self

    def with_end_uncertain(self, motion_cov: Array, places_m: Array) -> Self:
        """Return what was measured, where the end was being less certain than it was.

        All components of a pose are uncertain together by that.

        Args:
            motion_cov: (P, 6, 6) covariance of a shift [m] and a turn [rad] of the end about the
                instrument's origin.
            places_m: (P, B, 3) about where the targets were.
        """
        return self

    def take(self, rows: Rows) -> Self:
        """Return the measurements of these poses."""
        return take_rows(self, rows, *self._of_all)

    @abstractmethod
    def averaged(self, code: Index) -> Self:
        """Return the mean of the readings of each group, with covariances for independent readings.

        Args:
            code: (P,) number of each reading's group; every number from 0 on occurs.
        """

    def averaged_at_rest(self, code: Index) -> Self:
        """Return the mean of the readings of each group, as certain as one of them is stated.

        What is stated of the readings of an arm at rest is an error that they have in common.

        Args:
            code: (P,) as in `averaged`.
        """
        mean = self.averaged(code)
        count = self.components_seen.astype(float)
        return mean.less_certain(group_means(count, code) * np.bincount(code)[:, None])

    @property
    def noise_axes(self) -> Index:
        """Return the axis of each component (b,): x, y, z, then rotations about them, from 0.

        Empty for an instrument that does not measure along axes of its own.
        """
        return np.zeros(0, dtype=np.intp)

    @property
    def inverse(self) -> bool:
        """Return whether poses of the instrument in the target's frame were measured.

        Then all components of a pose here are uncertain together, by errors along the target's
        axes.
        """
        return False

    def along_noise_axes(self) -> Array:
        """Return by what errors of components are along the axes of `noise_axes`, (P, b, b)."""
        count, b = self.components_seen.shape
        return np.tile(np.eye(b), (count, 1, 1))

    def with_noise_along_axes(self, u_place_m: Array | None, u_turn_rad: Array | None) -> Self:
        """Return the measurements with other uncertainties along the axes of `noise_axes`.

        Args:
            u_place_m: (P, 3) of positions; None for those that they have.
            u_turn_rad: (3,) of orientations; None for those that they have.
        """
        return self

    def less_certain(self, times: Array) -> Self:
        """Return the measurements with the variances of their components (P, b) times so much."""
        raise NotImplementedError

    @abstractmethod
    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Instrument:
        """Return measurements of poses (P, 4, 4) without error, all targets being visible."""

    @classmethod
    @abstractmethod
    def foreseen(cls, T_instr_ee: Array, stated: quantities.StatedByCampaign) -> Instrument:
        """Return measurements of poses (P, 4, 4) without error, by the stated instrument.

        All targets are visible, and uncertainties are as stated.

        Raises:
            CalibrationError: when the stated targets cannot be measured by this kind.
        """

    @property
    @abstractmethod
    def places_m(self) -> Array:
        """Return measured positions (P, B, 3) of B targets, or distances (P, 1, 1); else nan."""

    @property
    def single_targets(self) -> Instrument:
        """Return the readings of single targets, by which a pose was found; else itself."""
        return self

    @property
    def counts(self) -> tuple[str, ...]:
        """Return numbers of observed targets, in words, for the summary of ingest."""
        return ()

    @property
    def target_names(self) -> tuple[str, ...]:
        """Return the names of the targets, if it measures them one by one."""
        return ()

    @property
    def places_stated(self) -> bool:
        """Return whether the campaign states where the targets are, or none is estimated."""
        return True

    @property
    def target_parameters(self) -> tuple[TermParameter, ...]:
        """Return the t coordinates of targets in the end-effector frame that a fit may estimate.

        There are three for each target, or none where the tool is part of the chain.
        """
        return tuple(
            TermParameter(name, "m", 1e-3) for name in target_coordinates(self.target_names)
        )

    @abstractmethod
    def compare(self, T_instr_ee: Array, targets_m: Array) -> quantities.Comparison:
        """Compare predicted poses of the end of the chain with the measurements.

        Residuals are predicted less measured.
        """

    def end_poses(self, T_instr_ee: Array) -> Array:
        """Return the measured poses of the end of the chain (P, 4, 4); these if none are."""
        return T_instr_ee

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        """Return the targets' positions, and the derivative of the pose by errors of readings.

        The pose by erroneous readings is the one whose targets fit them by least squares.
        """
        p_instr_m, levers_m = quantities.carried_targets(T_instr_ee, targets_m)
        by_end, by_targets = quantities.by_end_and_targets(T_instr_ee, levers_m)
        count, coordinates = len(T_instr_ee), 3 * levers_m.shape[1]
        by_end = by_end.reshape(count, coordinates, 6)
        by_reading = np.linalg.pinv(by_end)
        R = T_instr_ee[:, :3, :3].transpose(0, 2, 1)
        by_place = by_targets.reshape(count, coordinates, coordinates)  # its inverse: transposed
        return ObservedTargets(
            p_instr_m,
            np.concatenate([R @ by_reading[:, :3], R @ by_reading[:, 3:]], axis=1),
            by_place.transpose(0, 2, 1) @ (np.eye(coordinates) - by_end @ by_reading),
        )

    def axes_of_end(self, T_instr_ee: Array) -> Array:
        """Return rotations (P, b, b) of components along the end's axes to those measured."""
        count, components = self.components_seen.shape
        if components % 3:
            return np.broadcast_to(np.eye(components), (count, components, components))
        turn = np.zeros((count, components, components))
        for first in range(0, components, 3):
            turn[:, first : first + 3, first : first + 3] = T_instr_ee[:, :3, :3]
        return turn

    @property
    def by_stated_targets(self) -> Array:
        """Return the derivative (P, b, a) of the components by stated coordinates of targets [m].

        The error of a stated coordinate is the same in every pose. a = 0 where the fit estimates
        the targets.
        """
        return np.zeros((*self.components_seen.shape, 0))

    def with_stated_targets(self, by_stated_targets: Array) -> Self:
        """Return the readings with another such derivative, where a is not 0."""
        raise NotImplementedError(self.kind)

    @property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which components were measured in each pose, (P, b)."""
        count, targets, axes = self.places_m.shape
        return np.isfinite(self.places_m).reshape(count, targets * axes)

    @property
    @abstractmethod
    def stated_covariance(self) -> Array:
        """Return the stated covariance (P, b, b) of the components; unit where not measured."""

    @property
    @abstractmethod
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        """Return the kinds of components, such as `position`, and the components of each."""

    def rounded_kinds(self, difference: Array, seen: Mask) -> tuple[str, ...]:
        """Return the kinds of components that were written with too few digits to show noise.

        Their repeats mostly differ by nothing. If those of all kinds do, readings were copied, and
        none is returned.

        Args:
            difference: (N, b) differences of repeats.
            seen: (N, b) which of these were measured.
        """
        rounded = []
        for kind, columns in self.component_kinds:
            of_kind = np.abs(difference[:, columns][seen[:, columns]])
            if len(of_kind) and float(np.median(of_kind)) < READINGS.same:
                rounded.append(kind)
        return () if len(rounded) == len(self.component_kinds) else tuple(rounded)

    @property
    def position_columns(self) -> Index:
        """Return the columns of the components that are positions or distances, (p,)."""
        return np.arange(self.components_seen.shape[1])[self.component_kinds[0][1]]

    @property
    def targets_seen(self) -> Array:
        """Return by how many targets the position of each pose is the mean, (P,); 1 at least."""
        seen = self.components_seen[:, self.position_columns]
        return np.asarray(np.maximum(seen.sum(axis=1) / 3.0, 1.0))  # three coordinates a target

    @abstractmethod
    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        """Find base and targets from nominal poses (P, 4, 4), without a start.

        Args:
            roughly: whether a scatter to a part in a million is enough.

        Raises:
            CalibrationError: when the poses do not determine them.
        """

    def misfit_m(self, T_base_ee: Array) -> float:
        """Return the root mean square residual of `locate`; inf where it finds nothing."""
        try:
            return self.locate(T_base_ee, roughly=True).misfit_m
        except CalibrationError:
            return np.inf

    def least_misfit_m(self, T_base_ee: Array) -> float:
        """Return a lower bound of `misfit_m` that is quick to compute; 0 where there is none."""
        return 0.0

    def find_start(self, T_base_ee: Array) -> quantities.Start:
        """Return the start of a fit from nominal poses (P, 4, 4); see `locate`."""
        at = self.locate(T_base_ee)
        T_ee_target = np.eye(4) if at.T_ee_target is None else at.T_ee_target
        targets_m = np.zeros(0) if at.p_ee_targets_m is None else at.p_ee_targets_m.ravel()
        return quantities.Start(at.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], targets_m)

    def target_on(self, T_instr_base: Array, T_base_ee: Array) -> Array | None:
        """Return the pose (4, 4) of the target in the end-effector frame, for a known base frame.

        None where the end-effector itself is measured, or orientations are not.
        """
        return None

    @abstractmethod
    def scale(self, T_base_ee: Array) -> float | None:
        """Return nominal over measured lengths: 1 where the unit of measurements is right.

        None where the poses do not determine it.
        """

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return the measurements with lengths multiplied by a factor, uncertainties unchanged."""

    @abstractmethod
    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> quantities.Misfit:
        """Return the residuals of all poses about the nominal model, fitted to some.

        Args:
            used: poses that base and targets are fitted to.
            weights: of these.

        Raises:
            CalibrationError: when these poses do not determine frames and targets.
        """

    def in_order(self, order: Sequence[int]) -> Self:
        """Return the measurements with label k given to target `order[k]`."""
        return self

    def turned(self, R_ee_target: Array) -> Self:
        """Return the measurements with orientations of the end-effector, not of the target."""
        return self

    def of_end(self, T_end_shown: Array) -> Self:
        """Return the measurements of an end in which targets show another, at T_end_shown (4, 4).

        None but those of an apparatus' targets show another.
        """
        return self

    @property
    def attitudes(self) -> Array | None:
        """Return the measured orientations (P, 3, 3); None where not measured."""
        return None

    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        """Return predicted poses as measured by targets (a,) off their stated coordinates."""
        return T_base_ee

    @abstractmethod
    def deviations(
        self, T_base_ee: Array, T_instr_base: Array, targets_m: Array
    ) -> quantities.Deviations:
        """Compare predictions with measurements, configuration by configuration."""

    @property
    def spread_mm(self) -> float:
        """Return the root mean square distance of positions or distances from their mean.

        The mean is that of each target: how far targets are from each other does not count.
        """
        count = np.isfinite(self.places_m).all(axis=2).sum(axis=0)
        seen = count > 0
        variance_m2 = np.nanvar(self.places_m[:, seen], axis=0).sum(axis=1)
        return 1e3 * float(np.sqrt(np.average(variance_m2, weights=count[seen])))

    @classmethod
    @abstractmethod
    def from_columns(
        cls, columns: Mapping[str, Array], stated: quantities.StatedByCampaign
    ) -> Self:
        """Return the measurements in columns (P,) of the table of poses."""

    @abstractmethod
    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return the measurements as columns (P,) of the table of poses."""

    @classmethod
    @abstractmethod
    def raw_columns(cls, header: Sequence[str]) -> quantities.RawColumns:
        """Return the columns of `files.poses` that hold measurements."""

    @classmethod
    def unusable(
        cls, columns: quantities.RawColumns, values: Array
    ) -> Iterable[quantities.Unusable]:
        """Return which rows of values (N, k) of these columns are no measurement; no row twice."""
        return ()

    @classmethod
    def raw_notes(
        cls, columns: quantities.RawColumns, stated: quantities.StatedByCampaign
    ) -> tuple[str, ...]:
        """Return notes for the user about its columns, one clause each."""
        return ()

    @classmethod
    @abstractmethod
    def from_raw(
        cls,
        columns: quantities.RawColumns,
        values: Array,
        u: Array,
        stated: quantities.StatedByCampaign,
    ) -> Instrument:
        """Return the measurements in P rows of `files.poses`.

        Args:
            values: (P, k) numbers in the columns, nan where blank.
            u: (P, k) standard uncertainties, nan where not stated.
        """


def group_means(values: Array, code: Index) -> Array:
    """Return the mean (G, ...) of the values (P, ...) of each group."""
    count = np.bincount(code)
    total = np.zeros((len(count), *values.shape[1:]))
    np.add.at(total, code, values)
    return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))


def target_coordinates(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the coordinates of targets, three for each."""
    return tuple(f"target_{name}_{axis}".replace("__", "_") for name in names for axis in "xyz")
