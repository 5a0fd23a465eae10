"""Short forms of the base, and of what the instrument reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pa10cal.arm.chain import TOOL
from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import seen_in, static_loads_in
from pa10cal.terms.forms.form import Form, Numbers, Shape, sines, size
from pa10cal.terms.term import Parameter, Report

#: Tilt of a base to be expected [rad] at the moment at which it is [N m]; shift in time [m].
_TILT_RAD, _MOMENT_NM = 2e-4, 300.0
_SHIFT_M = 1e-4
#: Error of a reading to be expected [m], so far from the middle of what was measured [m].
_READING_M, _FROM_MIDDLE_M = 3e-5, 0.3


def _tilts(power: int) -> tuple[Parameter, ...]:
    return tuple(
        size(name, f"rad/(N m){'²³'[power - 2]}", _TILT_RAD / _MOMENT_NM**power)
        for name in ("cx", "cy")
    )


def _by_moment(
    of_moment: Callable[[Array, Numbers], Array],
) -> Callable[[PoseStates, int, Numbers], tuple[Array, ...]]:
    def columns(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array, ...]:
        del joint
        assert states.static_loads is not None
        return tuple(of_moment(states.static_loads.base_Nm[:, k], numbers) for k in (0, 1))

    return columns


def _beyond(moment_Nm: Array, numbers: Numbers) -> Array:
    return np.asarray(np.sign(moment_Nm) * np.maximum(np.abs(moment_Nm) - numbers[0], 0.0))


@dataclass(frozen=True)
class TiltForm(Form):
    """The base tilts about x and y by a short form of its overturning moment M."""

    shapes: ClassVar[Mapping[str, Shape]] = {
        "moment_abs_moment": Shape(
            "base.rx += cx M_x |M_x|, base.ry += cy M_y |M_y|, M the overturning moment",
            _by_moment(lambda moment, _: moment * np.abs(moment)),
            _tilts(2),
        ),
        "moment_cubed": Shape(
            "base.rx += cx M_x^3, base.ry += cy M_y^3, M the overturning moment",
            _by_moment(lambda moment, _: moment**3),
            _tilts(3),
        ),
        "moment_beyond": Shape(
            "base.rx += cx sgn(M_x) max(|M_x| - {0:.4g}, 0), base.ry likewise with cy and M_y, "
            "M the overturning moment",
            _by_moment(_beyond),
            tuple(size(name, "rad/(N m)", _TILT_RAD / _MOMENT_NM) for name in ("cx", "cy")),
            ("threshold",),
            between=0,
        ),
        "sign_of_moment": Shape(
            "base.rx += cx sgn(M_x), base.ry += cy sgn(M_y), M the overturning moment",
            _by_moment(lambda moment, _: np.sign(moment)),
            tuple(size(name, "rad", _TILT_RAD) for name in ("cx", "cy")),
        ),
    }

    @property
    def joint(self) -> int:
        """Return none."""
        return 0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the base's tilts."""
        return ("base.rx", "base.ry")

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return each column along its own tilt, (P, 2, 2)."""
        del x
        static_loads_in(states, self)
        return self.values(states)[:, :, None] * np.eye(2)


@dataclass(frozen=True)
class ShiftForm(Form):
    """The base shifts by a short form of time."""

    shapes: ClassVar[Mapping[str, Shape]] = {
        "settling": Shape(
            "base.x, y, z += (dx, dy, dz) exp(-(t - {1:.6g}) / {0:.4g}), t in s",
            lambda states, _, numbers: (np.exp(-(states.time_s - numbers[1]) / numbers[0]),) * 3,
            tuple(size(name, "m", _SHIFT_M) for name in ("dx", "dy", "dz")),
            ("time",),
            between=0,
        ),
        "wave_in_time": Shape(
            "base.x, y, z += (dx, dy, dz) sin(2 pi t / {0:.4g}) "
            "+ (ex, ey, ez) cos(2 pi t / {0:.4g}), t in s",
            lambda states, _, numbers: (
                *(np.sin(2.0 * np.pi * states.time_s / numbers[0]),) * 3,
                *(np.cos(2.0 * np.pi * states.time_s / numbers[0]),) * 3,
            ),
            tuple(size(name, "m", _SHIFT_M) for name in ("dx", "dy", "dz", "ex", "ey", "ez")),
            ("period",),
            between=0,
        ),
    }

    @property
    def joint(self) -> int:
        """Return none."""
        return 0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the base's shifts."""
        return ("base.x", "base.y", "base.z")

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return each column along its own shift, (P, 3, k)."""
        axes = np.tile(np.eye(3), len(x) // 3)
        return np.asarray(self.values(states)[:, None, :] * axes)


@dataclass(frozen=True)
class ReadingForm(Form):
    """One axis of the instrument reads too much by a short form of place.

    Its first number is the axis that reads so, the next are those along which it does, 0 to 2 for x
    to z. Coordinates are counted from a middle, in the instrument's frame.
    """

    # where the coordinates are counted from
    middle_instr_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shapes: ClassVar[Mapping[str, Shape]] = {
        "quadratic": Shape(
            "reading of {a} += c ({b} - {b}0)^2",
            lambda *_: (),
            (size("c", "1/m", _READING_M / _FROM_MIDDLE_M**2), size("d", "1", 1e-4)),
            ("axis", "along"),
        ),
        "cubic": Shape(
            "reading of {a} += c3 u^3 + c2 u^2 + c1 u, u = {b} {b0} m",
            lambda *_: (),
            (
                size("c3", "1/m²", _READING_M / _FROM_MIDDLE_M**3),
                size("c2", "1/m", _READING_M / _FROM_MIDDLE_M**2),
                size("c1", "1", 1e-4),
            ),
            ("axis", "along"),
        ),
        "product": Shape(
            "reading of {a} += c ({b} {b0} m) ({c} {c0} m)",
            lambda *_: (),
            (size("c", "1/m", _READING_M / _FROM_MIDDLE_M**2),),
            ("axis", "along", "along"),
        ),
        "wave": Shape(
            "reading of {a} += A sin(2 pi ({b} {b0} m) / ({2:.4g} m) + phi)",
            lambda *_: (),
            (size("s", "m", _READING_M), size("c", "m", _READING_M)),
            ("axis", "along", "period"),
            "turning",
            between=2,
        ),
    }

    @property
    def joint(self) -> int:
        """Return none."""
        return 0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the small motion at the end."""
        return TOOL

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        axes = [int(number) for number in self.numbers[1:3]]
        middle = [self.middle_instr_m[k % 3] for k in axes]
        names = {key: "xyz"[k % 3] for key, k in zip("bc", axes, strict=False)}
        at = {
            f"{key}0": f"{'-' if value >= 0.0 else '+'} {abs(value):.4g}"
            for key, value in zip("bc", middle, strict=False)
        }
        a = "xyz"[int(self.numbers[0])]
        return self.shape.words.format(*self.numbers, a=a, **names, **at)

    def of_place(self, p_instr_m: Array) -> Array:
        """Return what each parameter is multiplied with at places (..., 3), (..., k)."""
        u = p_instr_m - np.array(self.middle_instr_m)
        along = u[..., int(self.numbers[1])]
        if self.form == "quadratic":
            columns = [along**2, along]
        elif self.form == "cubic":
            columns = [along**3, along**2, along]
        elif self.form == "product":
            columns = [along * u[..., int(self.numbers[2])]]
        else:
            columns = list(sines(2.0 * np.pi * along / self.numbers[2]))
        return np.stack(columns, axis=-1)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return what the error of the readings makes of the measured pose, (P, 6, k)."""
        seen = seen_in(states, self)
        count, targets, _ = seen.p_instr_targets_m.shape
        field = np.zeros((count, targets, 3, len(x)))
        field[:, :, int(self.numbers[0])] = self.of_place(seen.p_instr_targets_m)
        by_place = field.reshape(count, 3 * targets, len(x))
        derivative: Array = seen.pose_by_targets @ by_place
        return derivative

    def report(self, x: Array) -> Report:
        """Return the parameters in the form of the formula."""
        if self.form != "quadratic":
            return super().report(x)
        c = x[0] if x[0] != 0.0 else np.finfo(float).tiny
        along = int(self.numbers[1])
        vertex = self.middle_instr_m[along] - 0.5 * x[1] / c
        jacobian = np.array([[1.0, 0.0], [0.5 * x[1] / c**2, -0.5 / c]])
        names = (self.shape.solved[0], Parameter(f"{'xyz'[along]}0", "m", 1.0))
        return Report(names, np.array([x[0], vertex]), jacobian)
