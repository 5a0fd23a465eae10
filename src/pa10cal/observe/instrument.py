"""What every kind of instrument has: what it measured, and all that depends on its kind.

An instrument is P measured poses: what it measured in each, with covariance. Whatever differs from
one kind to another is a method of its class, so that no other code depends on the kind.

The chain ends at the end-effector frame. Where the target sits on it is part of the model: for an
instrument that measures poses six small motions of the tool, for others the place of every target.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.statics import ObservedTargets
from pa10cal.arrays import Array, Index, Mask, Rows, homogeneous, take_rows
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import Located, cross_matrix
from pa10cal.observe import quantities
from pa10cal.rules import READINGS
from pa10cal.terms.term import TermParameter

#: How the base is found before any calibration, as `seed/base_frame.json` has it.
LocatingMethod = Literal[
    "rigid_fit_nominal", "hand_eye_poses", "hand_eye_points", "ranging", "nominal_arm"
]


@dataclass(frozen=True)
class Instrument(ABC):
    """What an instrument measured in P poses, b components each.

    In its methods `T_instr_ee` and `T_base_ee` are the end of the chain (P, 4, 4) in the frame of
    the instrument or of the base [m], and `targets_m` the places (t,) of the targets in the
    end-effector frame, as `target_parameters`.
    """

    kind: ClassVar[str]  # the word of `instrument.kind` in campaign.yaml
    # how `locate` finds the base, a word of `seed/base_frame.json`
    locates_by: ClassVar[LocatingMethod] = "nominal_arm"
    words: ClassVar[quantities.Words]  # how captions speak of its errors
    # whether it measures position and orientation, as the paper's model needs
    measures_pose: ClassVar[bool] = False
    # whether its raw data are touches and a resolver log, as in the paper
    from_touches: ClassVar[bool] = False
    # whether it moves along three axes of its own, each with a scale of its own
    three_axes: ClassVar[bool] = False
    # whether what it measures has directions in its frame; else neither the orientation of the base
    # nor the direction of an error shows
    directional: ClassVar[bool] = True
    # whether straight moves along the base's axes help to find the base frame
    uses_lines: ClassVar[bool] = False
    # whether it measures several targets on the end-effector
    several_targets: ClassVar[bool] = False
    # whether it may see targets on the base as well, in every configuration
    sees_base: ClassVar[bool] = False
    # rows from which on a single one can be found to be wrong: four times those that determine
    # frames and targets
    least_rows: ClassVar[int]
    #: Fields that belong to all poses together.
    _of_all: ClassVar[tuple[str, ...]] = ()

    def __len__(self) -> int:
        return len(self.places_m)

    @property
    def campaigns(self) -> tuple[tuple[str, Instrument], ...]:
        """Return name and readings of every campaign of a group; none of a single campaign."""
        return ()

    @property
    def R_first_target_of(self) -> Mapping[str, Array]:
        """Return the orientation (3, 3) of each campaign's target in the first's; of a group."""
        return {}

    @property
    def parts_seen(self) -> tuple[tuple[Index | slice, slice], ...]:
        """Return poses and the components that may be seen in them, of each campaign of a group."""
        return ((slice(None), slice(None)),)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the words of the instruments that measured, each once."""
        return (self.kind,)

    @abstractmethod
    def in_frame(self, T: Array) -> Self:
        """Return what was measured, in a frame in which the instrument's stands at T (4, 4)."""

    def steadied(self, base: BaseTargets) -> Self:
        """Return what it would have measured standing still, as targets on the base show."""
        return self

    def take(self, rows: Rows) -> Self:
        """Return what was measured in some of the poses; arrays have one entry a pose."""
        return take_rows(self, rows, *self._of_all)

    @abstractmethod
    def averaged(self, code: Index) -> Self:
        """Average the readings of each group: a row each, covariances those of independent ones.

        Groups are numbered from 0, none omitted: that of each reading is in `code` (P,).
        """

    @abstractmethod
    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Instrument:
        """Return what it would measure of poses (P, 4, 4) without error, all targets in sight."""

    @classmethod
    @abstractmethod
    def foreseen(cls, T_instr_ee: Array, stated: quantities.Stated) -> Instrument:
        """Return what it would measure of poses (P, 4, 4), all targets in sight, as stated.

        Raises:
            CalibrationError: when the stated targets are not what it measures.
        """

    @property
    @abstractmethod
    def places_m(self) -> Array:
        """Return where B targets were measured (P, B, 3), or how far (P, 1, 1); nan where not."""

    @property
    def counts(self) -> tuple[str, ...]:
        """Return what was counted of its targets, in words, for the summary of ingest."""
        return ()

    @property
    def target_names(self) -> tuple[str, ...]:
        """Return the names of the targets that it measures one by one."""
        return ()

    @property
    def target_parameters(self) -> tuple[TermParameter, ...]:
        """Return the coordinates of targets in the end-effector frame that are unknowns of a fit.

        They are t = 3 a target, or none where the tool is part of the chain.
        """
        return tuple(
            TermParameter(f"target_{name}_{axis}".replace("__", "_"), "m", 1e-3)
            for name in self.target_names
            for axis in "xyz"
        )

    @abstractmethod
    def compare(self, T_instr_ee: Array, targets_m: Array) -> quantities.Comparison:
        """Compare predicted poses of the end of the chain with what was measured."""

    def end_poses(self, T_instr_ee: Array) -> Array:
        """Return poses of the end of the chain (P, 4, 4): measured where they are, else these."""
        return T_instr_ee

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        """Return where the targets were, and what a false reading of them makes of the pose.

        The pose that follows false readings is the one whose targets are nearest to them.
        """
        p_instr_m, arms = quantities.carried_targets(T_instr_ee, targets_m)
        by_end, _ = quantities.by_end_and_targets(T_instr_ee, arms)
        by_reading = np.linalg.pinv(by_end.reshape(len(T_instr_ee), -1, 6))
        R = T_instr_ee[:, :3, :3].transpose(0, 2, 1)
        return ObservedTargets(
            p_instr_m, np.concatenate([R @ by_reading[:, :3], R @ by_reading[:, 3:]], axis=1)
        )

    def axes_of_end(self, T_instr_ee: Array) -> Array:
        """Return what turns components from the end's own axes to those measured, (P, b, b)."""
        count, components = self.components_seen.shape
        if components % 3:
            return np.broadcast_to(np.eye(components), (count, components, components))
        turn = np.zeros((count, components, components))
        for first in range(0, components, 3):
            turn[:, first : first + 3, first : first + 3] = T_instr_ee[:, :3, :3]
        return turn

    @property
    def by_stated_targets(self) -> Array:
        """Return the derivative (P, b, a) of the components by coordinates of an apparatus [m].

        Their error is the same in every pose; a = 0 where targets are unknowns of the fit.
        """
        return np.zeros((*self.components_seen.shape, 0))

    @property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which of the b components of a comparison were measured in each pose, (P, b)."""
        count, targets, axes = self.places_m.shape
        return np.isfinite(self.places_m).reshape(count, targets * axes)

    @property
    @abstractmethod
    def stated_covariance(self) -> Array:
        """Return the stated covariance (P, b, b) of the components; unit where nothing was seen."""

    @property
    @abstractmethod
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        """Return the kinds of components that have a scatter of their own, and where they are."""

    def rounded_kinds(self, difference: Array, seen: Mask) -> tuple[str, ...]:
        """Return the kinds of components (N, b) in which most repeats are equal, and others not.

        They are written with so few digits that their noise does not show. Readings that were
        copied are equal in all.
        """
        equal = {}
        for kind, columns in self.component_kinds:
            of_kind = np.abs(difference[:, columns][seen[:, columns]])
            equal[kind] = bool(len(of_kind)) and float(np.median(of_kind)) < READINGS.same
        return () if all(equal.values()) else tuple(kind for kind in equal if equal[kind])

    @property
    def position_columns(self) -> Index:
        """Return the components of positions or distances, (p,)."""
        return np.arange(self.components_seen.shape[1])[self.component_kinds[0][1]]

    @abstractmethod
    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        """Find base and targets from nominal poses (P, 4, 4), wherever they are.

        Args:
            roughly: whether the scatter to a part in a million is enough.

        Raises:
            CalibrationError: when the poses do not determine them.
        """

    def misfit_m(self, T_base_ee: Array) -> float:
        """Return the root mean square that `locate` leaves, roughly; inf where nothing is found."""
        try:
            return self.locate(T_base_ee, roughly=True).misfit_m
        except CalibrationError:
            return np.inf

    def least_misfit_m(self, T_base_ee: Array) -> float:
        """Return what `misfit_m` is at least, quickly; 0 where nothing says so."""
        return 0.0

    def find_start(self, T_base_ee: Array) -> quantities.Start:
        """Find where a fit starts from nominal poses (P, 4, 4); see `locate`."""
        found = self.locate(T_base_ee)
        T_ee_target = np.eye(4) if found.T_ee_target is None else found.T_ee_target
        targets_m = np.zeros(0) if found.p_ee_targets_m is None else found.p_ee_targets_m.ravel()
        return quantities.Start(
            found.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], targets_m
        )

    def target_on(self, T_instr_base: Array, T_base_ee: Array) -> Array | None:
        """Return the target (4, 4) in the end-effector frame, with a base frame that is known.

        None where the end-effector itself is measured, or no orientation is.
        """
        return None

    @abstractmethod
    def scale(self, T_base_ee: Array) -> float | None:
        """Return metres that the nominal model moves for one measured metre: 1 in the right unit.

        None where the poses do not determine it.
        """

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return them with positions and distances so many times as long, and as uncertain."""

    @abstractmethod
    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> quantities.Misfit:
        """Fit the nominal model to some poses, weighted, and return how far every pose is from it.

        Raises:
            CalibrationError: when these poses do not determine frames and targets.
        """

    def in_order(self, order: Sequence[int]) -> Self:
        """Return what was measured, each label given to the target of a number."""
        return self

    def turned(self, R_ee_target: Array) -> Self:
        """Return them with orientations of the end-effector in place of the target's."""
        return self

    @property
    def attitudes(self) -> Array | None:
        """Return the measured orientations (P, 3, 3); None where none are measured."""
        return None

    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        """Return predicted poses as read through targets that are (a,) off their stated places."""
        return T_base_ee

    @abstractmethod
    def deviations(
        self, T_base_ee: Array, T_instr_base: Array, targets_m: Array
    ) -> quantities.Deviations:
        """Compare predictions with measurements, configuration by configuration."""

    @property
    def spread_mm(self) -> float:
        """Return how far the measured places or distances spread about their middle, rms."""
        places_m = self.places_m.reshape(-1, self.places_m.shape[2])
        return 1e3 * float(np.sqrt(np.sum(np.nanvar(places_m, axis=0))))

    @classmethod
    @abstractmethod
    def from_columns(cls, columns: Mapping[str, Array], stated: quantities.Stated) -> Self:
        """Read P poses from columns (P,) of the table of poses."""

    @abstractmethod
    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return what was measured as columns (P,) of the table of poses."""

    @classmethod
    @abstractmethod
    def raw_columns(cls, header: Sequence[str]) -> quantities.RawColumns:
        """Return the columns of `files.poses` that hold what it measured."""

    @classmethod
    def unusable(
        cls, columns: quantities.RawColumns, values: Array
    ) -> Iterable[quantities.Unusable]:
        """Return rows (N, k) of these columns that are no measurement; no row twice."""
        return ()

    @classmethod
    def raw_notes(
        cls, columns: quantities.RawColumns, stated: quantities.Stated
    ) -> tuple[str, ...]:
        """Return what the reader should know of its columns, one clause each."""
        return ()

    @classmethod
    @abstractmethod
    def from_raw(
        cls, columns: quantities.RawColumns, values: Array, u: Array, stated: quantities.Stated
    ) -> Instrument:
        """Read P rows of `files.poses`.

        Args:
            values: (P, k) what the columns hold, nan where left blank.
            u: (P, k) standard uncertainties, nan where not stated.
        """


def group_means(values: Array, code: Index) -> Array:
    """Return the mean (G, ...) of the values (P, ...) of each group."""
    count = np.bincount(code)
    total = np.zeros((len(count), *values.shape[1:]))
    np.add.at(total, code, values)
    return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))


# Targets that are fixed to the base or the floor, read with every configuration.
#
# They stand still, so that what moves them together is the instrument, or the base with them. The
# motion is taken out of the readings before anything else is done with them.

#: Names of the components of a motion.
_MOTION = tuple(f"motion_{name}" for name in ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"))
_COV = "motion_cov_{}{}"


@dataclass(frozen=True)
class Knocked:
    """A base target that moved against the others."""

    targets: tuple[str, ...]  # its name; several where they explain what was seen equally well
    pose: str  # label of the first configuration after it
    time_s: float
    shift_mm: float  # how far, in the directions that show

    def __str__(self) -> str:
        return (
            f"{' or '.join(self.targets)} moved by {self.shift_mm:.3f} mm against the others, "
            f"before pose {self.pose} ({self.time_s:g} s)"
        )


@dataclass(frozen=True)
class Misread:
    """Single readings that are not of their base target."""

    target: str  # its name
    readings: int  # how many of them
    pose: str  # label of the configuration of the furthest
    off_mm: float  # how far that is from where the target stands

    def __str__(self) -> str:
        times = f"{self.readings} readings" if self.readings > 1 else "one reading"
        most = ", the furthest" if self.readings > 1 else ""
        return f"{times} of {self.target}{most} {self.off_mm:.3g} mm off (pose {self.pose})"


@dataclass(frozen=True)
class MotionFound:
    """How the motion of base targets was found."""

    form: str  # `still`: none shows; `walk`: smoothed in time; `each`: each configuration by itself
    # middle of the targets in the instrument's frame, about which they turn
    about_mm: tuple[float, float, float]
    turns: bool  # whether they show turns, as three that are not in line do
    noise: float  # scatter of their readings over the stated uncertainty
    # targets that moved against the others; their readings of the shorter stretch are not used
    knocked: tuple[Knocked, ...]
    misread: tuple[Misread, ...]  # targets with wrong readings, which are not used
    without: int  # configurations without a reading that could be used


@dataclass(frozen=True)
class BaseTargets:
    """K fixed targets as they were read in P configurations, and the motion that they show."""

    names: tuple[str, ...]  # (K,) their names, `base1` and so on
    p_instr_m: Array  # (P, K, 3) as read, nan where one was not seen
    u_m: Array  # (P, K, 3) stated standard uncertainties
    motion: Array  # (P, 6) shift [m] and turn [rad] of what was read, about `found.about_mm`
    motion_cov: Array  # (P, 6, 6) their covariance
    found: MotionFound | None = None  # how they were found; None where they were not looked at yet

    @classmethod
    def read(cls, names: tuple[str, ...], p_instr_m: Array, u_m: Array) -> BaseTargets:
        """Return targets whose motion is not known."""
        count = len(p_instr_m)
        return cls(names, p_instr_m, u_m, np.zeros((count, 6)), np.zeros((count, 6, 6)))

    def take(self, rows: Rows) -> BaseTargets:
        """Return some of the configurations."""
        return take_rows(self, rows, "names", "found")

    @property
    def T_moved(self) -> Array:
        """Return the motion (P, 4, 4) of all that the instrument read."""
        R = Rotation.from_rotvec(self.motion[:, 3:]).as_matrix()
        return homogeneous(R, self.about_m + self.motion[:, :3] - R @ self.about_m)

    @property
    def about_m(self) -> Array:
        """Return the point (3,) about which they turn."""
        return quantities.MM * np.array(self.found.about_mm if self.found else (0.0, 0.0, 0.0))

    @property
    def cov_at_origin(self) -> Array:
        """Return the covariance (P, 6, 6) of shift and turn about the origin of the instrument."""
        to_origin = np.eye(6)
        to_origin[:3, 3:] = cross_matrix(self.about_m)
        found: Array = to_origin @ self.motion_cov @ to_origin.T
        return found

    def to_columns(self) -> dict[str, NDArray[Any]]:
        """Return columns (P,) of the table of poses."""
        columns = quantities.columns_of_places(self.names, self.p_instr_m)
        columns |= quantities.columns_of_places([f"{name}_u" for name in self.names], self.u_m)
        columns |= dict(zip(_MOTION, (self.motion / quantities.MM_RAD_TO_SI).T, strict=True))
        return columns | quantities.columns_of_covariance(self.motion_cov, _COV)

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, NDArray[Any]], found: MotionFound | None
    ) -> BaseTargets | None:
        """Read what `to_columns` gave; None where a table has no base targets."""
        if _MOTION[0] not in columns:
            return None
        names = tuple(
            name.removesuffix("_x_mm") for name in columns if re.fullmatch(r"base\d+_x_mm", name)
        )
        return cls(
            names,
            quantities.places_of(columns, names),
            quantities.places_of(columns, [f"{name}_u" for name in names]),
            quantities.MM_RAD_TO_SI * np.column_stack([columns[name] for name in _MOTION]),
            quantities.covariance_of(columns, _COV),
            found,
        )
