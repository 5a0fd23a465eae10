"""Disturbances of raw files: ordinary imperfections of logs, and faults; one function each.

A stressor is an ordinary imperfection that a verdict has to tolerate. A fault is an error in the
log that has to be reported by kind and place. Arguments of a function after the first two are the
parameters of the disturbance. Simulated readings are changed afterwards, without a model of the
arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import Parameter, signature
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import numpy as np
from pydantic import Field, create_model
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError
from pa10cal.options import Section
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell.effects.effect import Finite, FinitePositive
from pa10cal_lab.cell.instruments.touch_trigger_cmm import APPROACH_S, DWELL_S
from pa10cal_lab.cell.options import DisturbanceOptions
from pa10cal_lab.cell.raw_log import QUATERNION, Need, RawLog

Rng = np.random.Generator
#: Draws one parameter, for an arm of so many joints.
Draw = Callable[[int, Rng], Any]
_F = TypeVar("_F", bound=Callable[..., list[str]])

Size = Annotated[FinitePositive, "by how much"]
Factor = Annotated[FinitePositive, "stated over true"]
Joint = Annotated[int, Field(ge=1), "joint, from 1"]


@dataclass(frozen=True)
class Disturbance:
    """A change of the raw files of a campaign."""

    id: str
    # changes the raw files in place, and returns the places of the change: poses, joints, loads or
    # keys; the generator draws what is no parameter
    put_into: Callable[..., list[str]]
    parameters: type[Section]
    stressor: bool  # whether it is an ordinary imperfection that need not be reported
    # whether trials measure its effect on the residual; else it is far above the noise
    measured: bool
    kinds: tuple[str, ...]  # kinds of faults in a verdict that report it
    needs: tuple[Need, ...]  # what the campaign must have
    draws: Mapping[str, Draw]  # how trials draw parameters, in this order; others have defaults

    def draw_parameters(self, joints: int, rng: Rng) -> dict[str, Any]:
        """Return parameters drawn for a trial, for an arm of so many joints."""
        drawn = {name: draw(joints, rng) for name, draw in self.draws.items()}
        return {name: drawn[name] for name in self.parameters.model_fields if name in drawn}


#: Every disturbance by its id, in the order of this file, on which random draws depend.
DISTURBANCES: dict[str, Disturbance] = {}


def disturb(
    log: RawLog, entries: Sequence[DisturbanceOptions], seed: int
) -> tuple[tuple[str, ...], ...]:
    """Put disturbances into raw files, one after the other, and return the places of each.

    Args:
        seed: of the campaign; every disturbance has a random stream of its own.

    Raises:
        SettingsError: for an unknown disturbance or parameter, or one that does nothing here.
    """
    places = []
    for number, entry in enumerate(entries):
        where = f"disturbances[{number}]"
        if entry.id not in DISTURBANCES:
            raise SettingsError(
                "unknown disturbance",
                where=f"{where}.id",
                value=entry.id,
                allowed=", ".join(DISTURBANCES),
                remedy="correct the name",
            )
        known = DISTURBANCES[entry.id]
        if lacking := [need for need in known.needs if not log.has(need)]:
            raise SettingsError(
                "the disturbance does nothing in this campaign",
                where=f"{where}.id",
                value=entry.id,
                allowed=f"a campaign with {' and '.join(lacking)}",
                remedy="remove it, or change the campaign",
            )
        parameters = parse_section(known.parameters, entry.parameters, where=f"{where}.parameters")
        rng = np.random.default_rng([seed, 1 + number, len(entry.id)])
        places.append(tuple(known.put_into(log, rng, **dict(parameters))))
    return tuple(places)


def disturbance(
    *,
    stressor: bool = False,
    measured: bool = False,
    kinds: tuple[str, ...] = (),
    needs: tuple[Need, ...] = (),
    draws: Mapping[str, Draw] | None = None,
) -> Callable[[_F], _F]:
    """Register a function as a disturbance of its name; for the arguments see `Disturbance`."""

    def enter(put_into: _F) -> _F:
        name, types = put_into.__name__, get_type_hints(put_into, include_extras=True)
        fields: dict[str, Any] = {}
        for parameter in list(signature(put_into).parameters.values())[2:]:
            default = ... if parameter.default is Parameter.empty else parameter.default
            of_type = types[parameter.name]
            meaning = of_type.__metadata__[-1]
            fields[parameter.name] = of_type, Field(default, description=meaning)
        parameters = create_model(name, __base__=Section, **fields)
        DISTURBANCES[name] = Disturbance(
            name, put_into, parameters, stressor, measured, kinds, needs, draws or {}
        )
        return put_into

    return enter


def one_of(*values: str | float) -> Draw:
    """Return a function that draws one of these values."""
    return lambda _joints, rng: rng.choice(values).item()


def between(low: float, high: float) -> Draw:
    """Return a function that draws a number between two, to three decimals."""
    return lambda _joints, rng: round(float(rng.uniform(low, high)), 3)


def log_between(low: float, high: float, decimals: int = 3) -> Draw:
    """Return a function that draws a number between two, evenly in its logarithm."""
    bounds = np.log([low, high])
    return lambda _joints, rng: round(float(np.exp(rng.uniform(*bounds))), decimals)


def off_by(low: float, high: float) -> Draw:
    """Return a function that draws a factor between two, or its inverse."""
    bounds = np.log([low, high])
    return lambda _joints, rng: round(
        float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(*bounds))), 3
    )


# What ordinary logs have: noise that is not normal, an instrument that moves, wrong statements.


@disturbance(stressor=True, measured=True, kinds=("payload",), needs=("masses", "springs"))
def link_masses_off(
    log: RawLog,
    rng: Rng,
    part: Annotated[FinitePositive, "by which part each is off, more or less"] = 0.1,
) -> list[str]:
    """The masses of the links in the description of the arm are off."""
    off = part * rng.choice([-1.0, 1.0], log.arm.n)
    _describe(log, replace(log.arm, mass_kg=np.asarray(log.arm.mass_kg) * (1.0 + off)))
    return ["mass_kg"]


@disturbance(stressor=True)
def heavy_tails(
    log: RawLog,
    rng: Rng,
    dof: Annotated[float, Field(gt=2.0, allow_inf_nan=False), "degrees of freedom"] = 3.0,
    times: Annotated[FinitePositive, "its standard deviation over the stated one"] = 1.0,
) -> list[str]:
    """Readings scatter by Student's t besides; the campaign states the whole of it."""
    instrument = log.description["instrument"]
    u_mm = float(instrument["uncertainty_mm"])
    unit = 1.0 / np.sqrt(dof / (dof - 2.0))
    of_touches = 0.3 if log.touched else 1.0  # touches repeat better than is stated of them

    def scatter(shape: tuple[int, ...]) -> Array:
        return np.asarray(times * unit * rng.standard_t(dof, shape))

    for columns in log.points:
        values = log.readings[columns]
        log.readings[columns] = values + of_touches * u_mm * scatter(values.shape)
    grown = float(np.hypot(1.0, times))
    if "u_qw" in log.readings:
        turn = 2.0 * log.readings["u_qw"].to_numpy()[:, None] * scatter((len(log.readings), 3))
        read = Rotation.from_quat(log.readings[QUATERNION].to_numpy(), scalar_first=True)
        turned = Rotation.from_rotvec(turn) * read
        log.readings[QUATERNION] = turned.as_quat(canonical=True, scalar_first=True)
    for name in log.uncertainties:
        log.readings[name] *= grown
    instrument["uncertainty_mm"] = round(u_mm * (1.0 if log.touched else grown), 6)
    return ["instrument"]


@disturbance(
    stressor=True,
    measured=True,
    kinds=("step_in_time",),
    needs=("tracker",),
    draws={"size_mm": between(0.1, 0.25)},
)
def random_walk(
    log: RawLog,
    rng: Rng,
    size_mm: Annotated[FinitePositive, "walked in the mean at the end, each axis"] = 0.15,
    turn_mrad: Annotated[Finite, "turned likewise; of instruments of positions"] = 0.0,
) -> list[str]:
    """The instrument walks: independent steps from configuration to configuration."""
    count = len(log.configurations)
    steps = size_mm / np.sqrt(count) * rng.standard_normal((count, 3))
    log.move(np.cumsum(steps, axis=0))
    if turn_mrad and log.kind == "points":
        turns = 1e-3 * turn_mrad / np.sqrt(count) * rng.standard_normal((count, 3))
        log.turn(np.cumsum(turns, axis=0))
    return ["instrument"]


@disturbance(stressor=True, needs=("tracker",))
def temperature_ramp(
    log: RawLog, rng: Rng, rise_C: Annotated[Finite, "from beginning to end"] = 6.0
) -> list[str]:
    """The hall warms up through the whole campaign; the arm does not mind."""
    start_C = float(log.description["reference_temperature_C"]) + rng.uniform(-1.0, 1.0)
    ramp_C = start_C + rise_C * np.linspace(0.0, 1.0, len(log.readings))
    log.readings["temperature_C"] = ramp_C.round(2)
    return ["temperature_C"]


@disturbance(stressor=True, draws={"factor": off_by(1.3, 2.3)})
def misstated_noise(log: RawLog, _rng: Rng, factor: Factor = 2.0) -> list[str]:
    """The campaign states a wrong uncertainty, by less than a factor of three."""
    return _state_times(log, factor)


@disturbance(stressor=True, needs=("tracker",))
def one_uncertainty(log: RawLog, _rng: Rng) -> list[str]:
    """No uncertainties stand beside the readings; the description states that of a coordinate."""
    log.tables["poses"] = log.readings.drop(columns=log.uncertainties)
    return ["u_ columns"]


@disturbance(stressor=True, kinds=("outlier",))
def gross_errors(
    log: RawLog,
    rng: Rng,
    share: Annotated[FinitePositive, "share of the configurations"] = 0.02,
    size_mm: Size = 8.0,
) -> list[str]:
    """Some readings of calibration poses are wrong by much: a beam broken, a reflector taken."""
    grid = log.of_kind("grid")
    wrong = rng.choice(grid, max(1, round(share * len(grid))), replace=False)
    shift_mm = np.zeros((len(log.configurations), 3))
    for number in wrong.tolist():
        shift_mm[number] = _displacement(log.kind, size_mm, rng)
    log.move(shift_mm, base=False)
    return [log.label(number) for number in sorted(wrong.tolist())]


@disturbance(stressor=True, needs=("masses",))
def level_off(
    log: RawLog, rng: Rng, off_deg: Annotated[Finite, "tilt about a horizontal axis"] = 0.5
) -> list[str]:
    """The base stands by a degree off the level that gravity is stated for."""
    about = rng.uniform(-np.pi, np.pi)
    turn = np.radians(off_deg) * np.array([np.cos(about), np.sin(about), 0.0])
    gravity = Rotation.from_rotvec(turn).apply(log.description["gravity_m_s2"])
    log.description["gravity_m_s2"] = gravity.round(6).tolist()
    return ["gravity_m_s2"]


@disturbance(stressor=True, needs=("masses",))
def unknown_tool(log: RawLog, _rng: Rng) -> list[str]:
    """The tool's mass is not known, and 0 is stated: that is what 0 means."""
    log.description["tool"]["mass_kg"] = 0.0
    return ["tool"]


# Faults of a whole log: joints with another sign or zero, orientations read wrong, a step in time.

#: A joint between the first, whose zero is the base's, and the last, the tool's.
_INNER_JOINT: Mapping[str, Draw] = {"joint": lambda joints, rng: int(rng.integers(2, joints))}
#: Joints 2 and 3 have most friction.
_WITH_FRICTION: Mapping[str, Draw] = {"joint": lambda _joints, rng: int(rng.integers(2, 4))}


def _two_to_four_deg(_joints: int, rng: Rng) -> float:
    return round(float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 4.0)), 3)


@disturbance(kinds=("joint_zero",), draws={"off_deg": _two_to_four_deg, **_INNER_JOINT})
def joint_zero(
    log: RawLog, _rng: Rng, joint: Joint, off_deg: Annotated[Finite, "by how much"] = 3.0
) -> list[str]:
    """The zero of a joint is off in the log."""
    log.joints[log.angle_column(joint)] += off_deg
    return [f"joint {joint}"]


@disturbance(kinds=("joint_sign",), draws=_INNER_JOINT)
def joint_sign(log: RawLog, _rng: Rng, joint: Joint) -> list[str]:
    """A joint is logged with the wrong sign, its torque too."""
    log.joints[log.angle_column(joint)] *= -1.0
    if (torque := f"tau{joint}_Nm") in log.joints:
        log.joints[torque] *= -1.0
    return [f"joint {joint}"]


@disturbance(kinds=("joint_sign", "label"), draws=_INNER_JOINT)
def joints_exchanged(log: RawLog, _rng: Rng, joint: Joint) -> list[str]:
    """The columns of a joint and of the one before it are exchanged."""
    one, other = log.angle_column(joint - 1), log.angle_column(joint)
    log.joints[[one, other]] = log.joints[[other, one]].to_numpy()
    return [f"joint {joint - 1}", f"joint {joint}"]


@disturbance(kinds=("direction",), needs=("touches",), draws=_WITH_FRICTION)
def direction_reversed(log: RawLog, _rng: Rng, joint: Joint) -> list[str]:
    """The approaches of a joint are logged as if it came from the other side."""
    approach, name = len(APPROACH_S), log.angle_column(joint)
    q = log.joints[name].to_numpy().reshape(-1, approach + len(DWELL_S)).copy()
    rest = q[:, approach:].mean(axis=1, keepdims=True)
    q[:, :approach] = 2.0 * rest - q[:, :approach]
    log.joints[name] = q.ravel()
    return [f"joint {joint}"]


@disturbance(needs=("attitude",), draws={"read": one_of("xyzw", "inverse")})
def attitudes(
    log: RawLog,
    _rng: Rng,
    read: Annotated[Literal["xyzw", "inverse"], "what stands under w, x, y, z"] = "xyzw",
) -> list[str]:
    """Quaternions do not stand as their headers say: scalar last, or the vector turned round."""
    wxyz = log.readings[QUATERNION].to_numpy(dtype=float)
    wrong = np.roll(wxyz, -1, axis=1) if read == "xyzw" else wxyz * [1, -1, -1, -1]
    log.readings[QUATERNION] = wrong
    return ["qw, qx, qy, qz"]


@disturbance(
    kinds=("step_in_time",), draws={"size_mm": log_between(0.1, 0.5), "after": between(0.35, 0.65)}
)
def jump(
    log: RawLog,
    rng: Rng,
    size_mm: Size = 0.1,
    after: Annotated[FinitePositive, "part of the configurations before it"] = 0.5,
) -> list[str]:
    """The instrument moves once, some way through the campaign."""
    count = len(log.configurations)
    later = np.arange(count) >= after * count
    log.move(later[:, None] * _displacement(log.kind, size_mm, rng))
    first = log.configurations.iloc[int(np.argmax(later))]
    return [f"time {first['time_s']:g} s"]


# Faults of single rows: labels, loads, readings, a log that ends early.


@disturbance(kinds=("label",), needs=("targets",))
def labels_exchanged(log: RawLog, rng: Rng) -> list[str]:
    """Two balls or targets that were seen are exchanged in one configuration."""
    number = int(rng.choice(log.of_kind("grid")))
    if log.touched:
        names = sorted(set(log.readings["ball"]))
        first, second = rng.choice(names, 2, replace=False).tolist()
        there = log.configuration == number
        balls = log.readings.loc[there, "ball"]
        log.readings.loc[there, "ball"] = balls.replace({first: second, second: first})
        return [log.label(number)]
    points = log.points
    one, other = (points[k] for k in rng.choice(len(points), 2, replace=False).tolist())
    seen = log.readings[[*one, *other]].notna().all(axis=1).to_numpy()
    number = int(rng.choice(np.intersect1d(log.of_kind("grid"), np.flatnonzero(seen))))
    values = log.readings.loc[number, [*one, *other]].to_numpy(copy=True)
    log.readings.loc[number, [*other, *one]] = values
    return [log.label(number)]


@disturbance(kinds=("label", "outlier"), needs=("repeats", "tracker"))
def poses_exchanged(log: RawLog, rng: Rng) -> list[str]:
    """The readings of two poses are exchanged in one repeat."""
    one, other = rng.choice(log.of_kind("grid"), 2, replace=False).tolist()
    columns = [name for point in log.points for name in point]
    columns += [name for name in QUATERNION if name in log.readings]
    values = log.readings.loc[[other, one], columns].to_numpy()
    log.readings.loc[[one, other], columns] = values
    return sorted({log.label(one), log.label(other)})


@disturbance(measured=True, kinds=("load",), needs=("loads", "touches"))
def loads_exchanged(log: RawLog, rng: Rng) -> list[str]:
    """The largest load and the least are exchanged at one pose, in all repeats."""
    rows, grid = log.readings, log.readings["kind"] == "grid"
    label = str(rng.choice(sorted(set(rows.loc[grid, "pose"]))))
    least, most = rows.loc[grid, "load_N"].min(), rows.loc[grid, "load_N"].max()
    there = grid & (rows["pose"] == label)
    log.readings.loc[there, "load_N"] = rows.loc[there, "load_N"].replace(
        {least: most, most: least}
    )
    return [label]


@disturbance(measured=True, kinds=("load",), needs=("loads", "springs"))
def load_misstated(log: RawLog, _rng: Rng, part: Factor = 0.909) -> list[str]:
    """The largest load of the calibration poses is not what the log says: 40 N for 44."""
    most = float(log.configurations["load_N"].iloc[log.of_kind("grid")].max())
    stated = float(np.round(part * most))
    log.readings.loc[log.readings["load_N"] == most, "load_N"] = stated
    return [f"{stated:g} N"]


@disturbance(kinds=("outlier",), needs=("held_out",))
def held_out_reading_off(log: RawLog, rng: Rng, size_mm: Size = 40.0) -> list[str]:
    """One reading of a held-out pose is far off."""
    return _move_one(log, "holdout", size_mm, rng)


@disturbance(kinds=("outlier",), draws={"size_mm": log_between(2.0, 30.0, 2)})
def one_reading_off(log: RawLog, rng: Rng, size_mm: Size = 5.0) -> list[str]:
    """One reading of a calibration pose is off."""
    return _move_one(log, "grid", size_mm, rng)


@disturbance(needs=("touches",))
def log_cut(
    log: RawLog, _rng: Rng, part: Annotated[FinitePositive, "what is left of it"] = 0.04
) -> list[str]:
    """The joint log ends early."""
    log.tables["resolver"] = log.joints.iloc[: max(1, round(part * len(log.joints)))]
    return ["resolver"]


# Faults of what a campaign states: units, gravity, masses, lengths, places of targets.

Wrong = Literal["uncertainty_um", "uncertainty_m", "mass_g", "kelvin", "fahrenheit", "gravity_mm"]
#: Rows no longer than this are no links [m].
_LINK_M = 0.1


@disturbance(draws={"of": one_of(*get_args(Wrong))})
def unit(
    log: RawLog, _rng: Rng, of: Annotated[Wrong, "which figure, and the unit that it is in"]
) -> list[str]:
    """A figure is in another unit than its key says."""
    said = log.description
    if of.startswith("uncertainty"):
        return _state_times(log, 1e3 if of.endswith("um") else 1e-3)
    if of == "mass_g":
        said["tool"]["mass_kg"] *= 1e3
        return ["tool.mass_kg"]
    if of == "gravity_mm":
        said["gravity_m_s2"] = [1e3 * each for each in said["gravity_m_s2"]]
        return ["gravity_m_s2"]
    table = log.joints
    if "temperature_C" not in table:
        table["temperature_C"] = np.full(len(table), float(said["reference_temperature_C"]))
    if of == "kelvin":
        table["temperature_C"] = table["temperature_C"] + 273.15
    else:
        table["temperature_C"] = (1.8 * table["temperature_C"] + 32.0).round(2)
    return ["temperature_C"]


@disturbance(needs=("repeats", "tracker"), draws={"factor": off_by(6.0, 20.0)})
def uncertainty_off(log: RawLog, _rng: Rng, factor: Factor = 10.0) -> list[str]:
    """The stated uncertainty is off by much more than a factor of three."""
    return _state_times(log, factor)


@disturbance(needs=("masses", "springs"), draws={"way": one_of("up", "sideways")})
def gravity(
    log: RawLog,
    _rng: Rng,
    way: Annotated[Literal["up", "sideways"], "where it is stated to point"] = "up",
) -> list[str]:
    """Gravity points another way than stated."""
    x, y, z = log.description["gravity_m_s2"]
    log.description["gravity_m_s2"] = [x, y, -z] if way == "up" else [z, x, y]
    return ["gravity_m_s2"]


@disturbance(
    measured=True,
    kinds=("payload",),
    needs=("masses", "springs"),
    draws={"factor": one_of(0.8, 1.2)},
)
def payload_off(log: RawLog, _rng: Rng, factor: Factor = 1.2) -> list[str]:
    """The stated mass of the tool is off."""
    log.description["tool"]["mass_kg"] *= factor
    return ["tool"]


@disturbance(measured=True, kinds=("payload",), needs=("masses", "springs"))
def payload_centre_off(
    log: RawLog, rng: Rng, off_mm: Annotated[Finite, "along any axis of the flange"] = 50.0
) -> list[str]:
    """The stated centre of mass of the tool is off."""
    axis = int(rng.integers(3))
    log.description["tool"]["com_mm"][axis] += off_mm * float(rng.choice([-1.0, 1.0]))
    return ["tool"]


@disturbance()
def length_typo(
    log: RawLog, rng: Rng, off_mm: Annotated[Finite, "by how much"] = 27.0
) -> list[str]:
    """The length of one of the longer rows in the description of the arm is a typing error."""
    arm = log.arm
    # That of the first row along z is the height of the base, and the last is the tool's.
    rows = np.flatnonzero(np.abs(arm.a_m[:-1]) > _LINK_M)
    along_x = len(rows) > 0
    along_z = 1 + np.flatnonzero(np.abs(arm.d_m[1:-1]) > _LINK_M)
    row = int(rng.choice(rows if along_x else along_z))
    off_m = 1e-3 * off_mm * (np.arange(arm.n) == row)
    wrong = replace(arm, a_m=arm.a_m + off_m) if along_x else replace(arm, d_m=arm.d_m + off_m)
    _describe(log, wrong)
    return [f"delta_{'a' if along_x else 'd'}_{row + 1}"]


@disturbance(needs=("stated_targets",))
def places_exchanged(log: RawLog, rng: Rng) -> list[str]:
    """The places of two balls or targets are exchanged in the description."""
    places = log.description["tool"]["balls_mm"]
    first, second = rng.choice(sorted(places), 2, replace=False).tolist()
    places[first], places[second] = places[second], places[first]
    return [f"tool.balls_mm {first}, {second}"]


# Shared parts.


def _state_times(log: RawLog, factor: float) -> list[str]:
    """Multiply every stated uncertainty."""
    instrument = log.description["instrument"]
    instrument["uncertainty_mm"] = float(f"{factor * instrument['uncertainty_mm']:.4g}")
    for name in log.uncertainties:
        log.readings[name] *= factor
    return ["instrument.uncertainty_mm"]


def _move_one(log: RawLog, kind: str, size_mm: float, rng: Rng) -> list[str]:
    """Move one reading of a pose of a kind in any direction."""
    number = int(rng.choice(log.of_kind(kind)))
    shift_mm = np.zeros((len(log.configurations), 3))
    shift_mm[number] = _displacement(log.kind, size_mm, rng)
    log.move(shift_mm)
    return [log.label(number)]


def _displacement(kind: str, size_mm: float, rng: Rng) -> Array:
    """Draw a displacement (3,) of a size; for a distance its first component has all of it."""
    if kind == "distance":
        return np.array([size_mm * rng.choice([-1.0, 1.0]), 0.0, 0.0])
    direction = rng.standard_normal(3)
    return np.asarray(size_mm * direction / np.linalg.norm(direction))


def _describe(log: RawLog, arm: Arm) -> None:
    """Describe an arm in the folder of the campaign, under a name of its own."""
    log.arm = replace(arm, name=f"{arm.name.removesuffix('_own')}_own")
    log.description["robot"] = log.arm.name
