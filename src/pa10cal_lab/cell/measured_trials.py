"""Trials that resemble campaigns of measured robots: unstated weights, sorted rows, many effects.

Their arms are described without masses, rated torques and gear ratios, and torques are not logged
(`unstated`). Instruments measure poses or points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.files.arms import arm_names
from pa10cal_lab.cell.effects.effect import LONG_LINKS, Site
from pa10cal_lab.cell.effects.vocabulary import all_effects, places_of
from pa10cal_lab.cell.individual import described, draw_unstated, nominal, put_on_slide
from pa10cal_lab.cell.mechanism import Departures, Mechanism, SimulatedStatics
from pa10cal_lab.cell.options import SlideOptions, UnstatedOptions
from pa10cal_lab.cell.poses import joint_bounds
from pa10cal_lab.cell.robot import tool_payload
from pa10cal_lab.cell.scenario import (
    ATTITUDE_RAD,
    POSITION_MM,
    SECONDS_A_POSE,
    Bench,
    Scenario,
    Trial,
    idle,
    log_uniform,
    trial_places,
)

UNSTATED, SORTED, MIXED = "unstated_masses", "sorted_rows", "mixed"
SPRING = "joint_compliance"
#: Effects that are hidden beside springs of unstated masses.
_OTHER_EFFECTS = (
    "encoder_eccentricity",
    "gear_ratio_error",
    "backlash",
    "link_bending",
    "base_compliance",
    "encoder_ellipticity",
    "joint_error_map",
    "wrist_coupling",
    "cmm_scale",
)
NO_SPRINGS, SOME_SPRINGS, ALL_SPRINGS = "no_springs", "some_springs", "all_springs"
AND_MORE, NOTHING = "_and_more", "nothing"
VOCABULARY, AND_BACKGROUND = "vocabulary", "vocabulary_and_background"
#: Subjects of trials, in turn. Unstated masses: springs in no joint, in some or in all, alone or
#: with one other effect; rigid joints alone are drawn twice as often. Sorted rows: effects of the
#: joint by which rows are sorted, which look like a motion over time, or a moving base. Mixed:
#: several effects, in every other trial with a background of effects outside the vocabulary.
SUBJECTS = {
    UNSTATED: (
        *(NO_SPRINGS, SOME_SPRINGS, ALL_SPRINGS),
        *(NO_SPRINGS + AND_MORE, SOME_SPRINGS + AND_MORE, ALL_SPRINGS + AND_MORE),
        NO_SPRINGS,
    ),
    SORTED: (
        *(NOTHING, SPRING, "encoder_eccentricity", "third_harmonic", "base_compliance"),
        *(NOTHING, "gear_ratio_error", "pedestal_tilt"),
    ),
    MIXED: (VOCABULARY, AND_BACKGROUND),
}
#: Deflection of a joint under its largest usual torque, and rotation of a link or the base under
#: its usual moment [rad], for arms of any size.
SAG_RAD = (3e-4, 4e-3)
_TURN_RAD = (1e-4, 1e-3)
#: Factors of the plausible size of other effects: large ones of sorted rows look most like a
#: motion.
_TIMES = {UNSTATED: (1.0, 1.0), SORTED: (1.0, 5.0)}
#: Least torque of a joint, relative to the largest of the arm, that counts as a load; stiffness is
#: computed for no less.
_LOADED = 0.02
#: Largest number of flexible joints in trials with some.
_MOST_SOFT = 3
#: Number of poses; share of campaigns with repeats, and their number.
POSES = (150, 500)
_REPEATED, _REPEATS = 0.2, 4
#: Share of poses that is held out; or number of the rows of which each last is.
_HELD_OUT_SHARE = 0.2
_HELD_OUT_EVERY = 5
#: Scatter of links about their motors, from reading to reading [rad]: 0.01 mm at a long arm.
_UNSEEN_RAD = 5e-6
#: Number of poses for usual loads.
_TYPICAL_POSES = 300
#: Orders of rows, with their probabilities: by one joint; by steps of one joint and within each by
#: another; or up along one joint and back, as along a rail.
_SORTED = {"one": 0.5, "nested": 0.3, "there_and_back": 0.2}
_STEPS = (6, 12)
_BY_FIRST = 0.5
_DECIMALS = 3

# Mixed trials. Bounds of sizes, drawn evenly in the logarithm, are those of measured arms, from
# below the noise of a tracker upwards.

#: Number of effects.
_MIXED_COUNT = (2, 6)
#: Relative probabilities of effects, others 1: arms have several springs, and rails are not
#: straight.
_WEIGHTS = {SPRING: 4.0, "slide_error": 8.0}
#: Rotations under usual weights [rad]. Springs: a KUKA titan sags by milliradians, low-cost arms by
#: 30. Links and base: tilts of a UR10 and an iiwa 7 other than springs amount to 0.1 to 0.2 mm.
_MIXED_TURN_RAD = {
    SPRING: (2e-4, 1e-2),
    "link_bending": (1e-4, 2e-3),
    "link_torsion": (1e-4, 2e-3),
    "base_compliance": (1e-4, 2e-3),
}
#: Factors of usual sizes of the others. Errors by angle: 0.04 to 0.6 mrad (0.3 at the joints of a
#: UR10; the waves of the titan, the maps of small arms). Lost motion: 0.02 to 0.63 mrad (0.01 to
#: 0.29 in the joints of a UR10, 0.42 and 0.63 proposed for an IRB 120 and an MA2010). Windup: iiwa
#: 7. Scale: up to 0.6e-3, proposed for a tracker. Drift: a UR10's base, 0.1 mm in half a campaign.
_MIXED_TIMES = {
    "encoder_eccentricity": (0.3, 4.0),
    "encoder_ellipticity": (0.3, 4.0),
    "joint_error_map": (0.3, 4.0),
    "gear_ratio_error": (0.3, 5.0),
    "backlash": (0.2, 6.5),
    "wrist_coupling": (0.2, 4.0),
    "soft_windup": (0.5, 10.0),
    "tool_sag": (0.3, 5.0),
    "cmm_scale": (0.2, 12.0),
    "base_drift": (0.25, 6.0),
    "thermal_growth": (0.2, 2.2),
}
#: Share of arms on a slide, strokes, drawn evenly in the logarithm, and shares of its kinds.
_ON_SLIDE, _STROKE_M = 0.13, (0.5, 4.0)
_SLIDES = {"rail": 0.6, "column": 0.2, "side_of_column": 0.2}
#: Numbers of the random streams of slides and of distance meters.
_SLIDE_STREAM, _BEAM_STREAM = 1, 2
#: Constant error of a tracker's distance meter: share of trials, factors of 0.1 mm, and distances
#: of the tracker over the arm's reach.
BEAMS = "range_constant"
_BEAMS, _BEAM_TIMES, _BEAM_REACHES = 0.1, (0.3, 6.0), (1.8, 3.0)
#: Further effects of arms on slides: rails bent by 0.03 to 0.2 mm a metre and twisted by 0.03 to
#: 0.2 mrad; columns that rotate by so much under the usual moment with the carriage extended.
_SLIDE_TIMES = {"slide_error": (0.3, 2.0)}
_SLIDE_TURN_RAD = {"slide_bending": (1e-4, 1e-3)}
#: The background: bearings that tilt under the usual moment, more about one axis, as of the titan
#: and the iiwa 7; small waves of every joint, as of the titan; and in some trials a log that is
#: late, as of the IRB 120.
BACKGROUND = ("soft_bearing", "small_waves", "along_move")
_BACKGROUND_TILT_RAD, _STIFFER = (5e-5, 1e-3), (0.1, 0.8)
_BACKGROUND_WAVES = (0.4, 4.0)  # of 10 arc seconds: 0.02 to 0.2 mrad
_LATE, _LATE_TIMES = 0.3, (0.3, 3.0)
#: Noise of a coordinate [mm]: 0.03 at the titan, 0.07 at the iiwa 7. Scatter of links about logged
#: angles [rad]; share of logs of commanded angles, and the larger scatter about these.
_MIXED_POSITION_MM = (0.01, 0.07)
_MIXED_UNSEEN_RAD, _COMMANDED, _COMMANDED_RAD = (2e-6, 1e-5), 0.3, (1e-5, 5e-5)
#: Share of files whose rows lie along paths; rows of a stretch; step of the joint that moves
#: furthest [rad, m of a prismatic joint]: 5 mrad at the MA2010. Every fifth row of a share of them
#: is held out, the last stretches of the others.
_ALONG_PATH, _STRETCH, _STEP_RAD, _EVERY_FIFTH = 0.25, (5, 25), (5e-3, 5e-2), 0.5
_MIXED_DRIFT_C = 5.0


@cache
def measured_benches() -> dict[str, Bench]:
    """Return the benches of all shipped arms under instruments of poses and of points, by name."""
    benches = [Bench(robot, kind) for robot in arm_names() for kind in ("pose", "points")]
    return {bench.name: bench for bench in benches}


@dataclass(frozen=True)
class _UnstatedArm:
    """One arm whose masses are not stated."""

    weights: UnstatedOptions  # true lengths and weights
    tool_kg: float  # true mass of the tool
    arm: Arm  # as the campaign describes it
    mechanism: Mechanism  # with nominal geometry and true weights

    @classmethod
    def draw(
        cls, shipped: Arm, rng: np.random.Generator, slide_rng: np.random.Generator | None = None
    ) -> _UnstatedArm:
        """Draw lengths and weights of a shipped arm.

        Args:
            slide_rng: draws whether it is on a slide, and which; None for no slide.
        """
        weights, tool_kg = draw_unstated(shipped, rng)
        if slide_rng is not None and slide_rng.random() < _ON_SLIDE:
            kind = str(slide_rng.choice(list(_SLIDES), p=list(_SLIDES.values())))
            stroke_m = round(log_uniform(_STROKE_M, slide_rng), 3)
            slide = SlideOptions.model_validate({"kind": kind, "stroke_m": stroke_m})
            weights = put_on_slide(weights, slide, slide_rng)
        mechanism = nominal(shipped, weights, tool_kg)
        return cls(weights, tool_kg, described(shipped, weights), mechanism)

    @cached_property
    def usual(self) -> SimulatedStatics:
        """Return the loads by the weights in usual poses."""
        rng = np.random.default_rng(0)
        q = rng.uniform(*joint_bounds(self.arm), (_TYPICAL_POSES, self.arm.n))
        return self.mechanism.statics(q, np.zeros(len(q)))

    @property
    def usual_torques_Nm(self) -> Array:
        """Return torques in usual poses, (P, n); zero for joints that slide."""
        return np.where(self.arm.prismatic, 0.0, self.usual.torque_Nm)

    @property
    def loaded(self) -> list[int]:
        """Return the joints, from 1, whose torque varies."""
        vary_Nm = self.usual_torques_Nm.std(axis=0)
        loaded = (vary_Nm > _LOADED * vary_Nm.max()) & (vary_Nm > 1e-9)
        return (np.flatnonzero(loaded) + 1).tolist()

    def stiffness(self, joint: int, sag_rad: float) -> float:
        """Return the stiffness [N m/rad] of a joint by its deflection; see `SAG_RAD`."""
        largest_Nm = np.abs(self.usual_torques_Nm).max(axis=0)
        torque_Nm = max(largest_Nm[joint - 1], _LOADED * largest_Nm.max())
        return round(float(torque_Nm / sag_rad), 3)

    def moment_Nm(self, link: int) -> float:
        """Return the root mean square moment at the end of a link, from 0; -1 for the base."""
        moment_Nm = self.usual.base_Nm if link < 0 else self.usual.link_Nm[:, link]
        return float(np.sqrt(np.mean(np.sum(moment_Nm**2, axis=1))))

    def site(self, of: str) -> Site:
        """Return the quantities that determine the size of an effect at a place."""
        site = Site(of, typical_Nm=0.0, half_m=0.5 * self.arm.reach_m)
        if not of.startswith("joint "):
            return site
        joint = int(of.split()[1]) - 1
        typical_Nm = float(self.usual_torques_Nm.std(axis=0)[joint])
        low, high = self.arm.joint_ranges_rad[joint].tolist()
        return replace(site, typical_Nm=typical_Nm, stroke_m=(low, high))

    def moment_at(self, place: str) -> float:
        """Return the usual moment at a long link or beyond a joint, or else at the base."""
        if place.startswith("joint "):
            return self.moment_Nm(int(place.split()[1]) - 1)
        if place in LONG_LINKS:
            return self.moment_Nm(self.mechanism.long_links[LONG_LINKS.index(place)])
        return self.moment_Nm(-1)


def draw_measured(
    kind: str, number: int, subject: str, benches: Mapping[str, Bench], rng: np.random.Generator
) -> Trial:
    """Draw a trial of unstated masses, of sorted rows, or of several effects at once.

    Args:
        subject: one of `SUBJECTS[kind]`.
        benches: by name.

    Raises:
        SettingsError: where the subject does nothing at any of the benches.
    """
    if kind == MIXED:
        return _draw_mixed(subject, benches[str(rng.choice(list(benches)))], rng)
    fitting = [name for name, bench in benches.items() if _fits(subject, bench.arm)]
    if not fitting:
        raise idle(subject, benches, "an arm with a joint that weights load among them")
    bench = benches[str(rng.choice(fitting))]
    scenario = Scenario(kind, rng, bench, int(rng.integers(2**31)))
    own = _UnstatedArm.draw(bench.arm, rng)
    plan: dict[str, Any] = {
        "instrument": bench.instrument,
        "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
        "tool_mass_kg": own.tool_kg,
        "targets": int(rng.choice([1, 2, 3])),
        "unseen_rad": _UNSEEN_RAD,
        "position_mm": round(log_uniform(POSITION_MM, rng), 4),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
        "unstated": own.weights.model_dump(),
    }
    poses = round(log_uniform(POSES, rng))
    by = None
    if kind == UNSTATED:
        repeats = _REPEATS if rng.random() < _REPEATED else 1
        plan |= {
            "poses": round(poses / repeats),
            "repeats": repeats,
            "order": "shuffled",
            "holdout_share": _HELD_OUT_SHARE,
        }
        soft = _soft_joints(subject.removesuffix(AND_MORE), own, rng)
        other_effect = str(rng.choice(_OTHER_EFFECTS)) if subject.endswith(AND_MORE) else None
    else:
        by = _sorting_joint(subject, own, rng)
        numbered = (number + number // len(SUBJECTS[SORTED])) % 2 == 0
        plan |= {
            "commanded": _sorted(own.arm, poses, by, rng),
            "holdout_share": 0.0,
            "holdout_every": _HELD_OUT_EVERY,
            "clock": "row" if numbered else "none",
        }
        soft = [by] if subject == SPRING else []
        other_effect = None if subject in (NOTHING, SPRING) else subject
    scenario.settings["without_touches"] = plan
    for joint in soft:
        K = own.stiffness(joint, log_uniform(SAG_RAD, rng))
        scenario.put(SPRING, f"joint {joint}", {"K": K}, 1.0)
    if other_effect is not None:
        places = places_of(trial_places(all_effects()[other_effect]), scenario.robot)
        of = f"joint {by}" if f"joint {by}" in places else str(rng.choice(places))
        _hide_other_effect(scenario, other_effect, of, own)
    return scenario.trial("wild")


def _fits(subject: str, arm: Arm) -> bool:
    """Return whether a subject acts: springs do not where all axes are vertical, as of a SCARA."""
    if subject != SPRING and not subject.startswith((SOME_SPRINGS, ALL_SPRINGS)):
        return True
    mechanism = Mechanism.of(arm, Departures.none(arm.n), tool_payload(0.0))
    frames = mechanism.T_base_joints(np.ones((1, arm.n)))
    return bool(np.any(np.abs(frames[:, 0, 2, 2]) <= 1.0 - 1e-9))  # an axis is not vertical


def _soft_joints(springs: str, own: _UnstatedArm, rng: np.random.Generator) -> list[int]:
    """Return the flexible joints, from 1."""
    if springs == NO_SPRINGS:
        return []
    if springs == ALL_SPRINGS:
        return (np.flatnonzero(~own.arm.prismatic) + 1).tolist()
    loaded = own.loaded
    count = int(rng.integers(1, min(_MOST_SOFT, len(loaded)), endpoint=True))
    return sorted(rng.choice(loaded, count, replace=False).tolist())


def _hide_other_effect(scenario: Scenario, name: str, of: str, own: _UnstatedArm) -> None:
    """Hide an effect with a factor of its plausible size, or by the moments of this arm."""
    effect, times = all_effects()[name], log_uniform(_TIMES[scenario.kind], scenario.rng)
    site = Site(of, half_m=0.5 * own.arm.reach_m, middle_m=scenario.bench.middle_m(scenario.robot))
    scenario.hide(effect, times * effect.plausible_size, site)
    parameters = scenario.hidden[-1]["parameters"]
    if effect.by_moment:
        turn = times * log_uniform(_TURN_RAD, scenario.rng) / own.moment_at(of)
        scenario.hidden[-1]["parameters"] = dict.fromkeys(parameters, turn)


def _sorting_joint(subject: str, own: _UnstatedArm, rng: np.random.Generator) -> int:
    """Draw the joint, from 1, by which rows are sorted; the first more often than others."""
    if subject == SPRING:
        return int(rng.choice(own.loaded))
    if rng.random() < _BY_FIRST:
        return 1
    fitting = np.ones(own.arm.n, bool) if subject == NOTHING else ~own.arm.prismatic
    return int(rng.choice(np.flatnonzero(fitting) + 1))


def _sorted(
    arm: Arm, poses: int, by: int, rng: np.random.Generator
) -> tuple[tuple[float, ...], ...]:
    """Draw configurations [deg, mm], sorted by a joint, from 1; see `_SORTED`."""
    low, high = (
        np.where(arm.prismatic, 1e3 * bound, np.degrees(bound)) for bound in joint_bounds(arm)
    )
    q = rng.uniform(low, high, (poses, arm.n))
    first, how = q[:, by - 1], str(rng.choice(list(_SORTED), p=list(_SORTED.values())))
    if how == "nested":
        steps = np.linspace(low[by - 1], high[by - 1], int(rng.integers(*_STEPS, endpoint=True)))
        level = np.abs(first[:, None] - steps).argmin(axis=1)
        q[:, by - 1] = steps[level]
        within = rng.choice([joint for joint in range(arm.n) if joint != by - 1])
        turned = np.where(level % 2 == 1, -1.0, 1.0) if rng.random() < 0.5 else 1.0
        order = np.lexsort([turned * q[:, within], level])
    elif how == "there_and_back":
        back = rng.random(poses) < 0.5
        order = np.lexsort([np.where(back, -first, first), back])
    else:
        order = np.argsort(first)
    if rng.random() < 0.5:
        order = order[::-1]
    return tuple(map(tuple, q[order].round(_DECIMALS).tolist()))


def _draw_mixed(subject: str, bench: Bench, rng: np.random.Generator) -> Trial:
    """Draw a trial that hides several effects, some below the noise, maybe with a background."""
    scenario = Scenario(MIXED, rng, bench, int(rng.integers(2**31)))
    # Slides have a random stream of their own: trials without one are the same as without slides.
    slide_rng = np.random.default_rng([scenario.seed, _SLIDE_STREAM])
    own = _UnstatedArm.draw(bench.arm, rng, slide_rng)
    poses = round(log_uniform(POSES, rng))
    plan: dict[str, Any] = {}
    if rng.random() < _ALONG_PATH:
        plan["commanded"] = _path(own.arm, poses, rng)
        if rng.random() < _EVERY_FIFTH:
            plan["holdout_every"] = _HELD_OUT_EVERY
    late = rng.random() < _LATE
    unseen_rad = _COMMANDED_RAD if rng.random() < _COMMANDED else _MIXED_UNSEEN_RAD
    scenario.settings["without_touches"] = {
        "instrument": bench.instrument,
        "poses": poses,
        "holdout_share": 0.0 if "holdout_every" in plan else _HELD_OUT_SHARE,
        "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
        "tool_mass_kg": own.tool_kg,
        "targets": int(rng.choice([1, 2, 3])),
        "unseen_rad": log_uniform(unseen_rad, rng),
        "position_mm": round(log_uniform(_MIXED_POSITION_MM, rng), 4),
        "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
        "unstated": own.weights.model_dump(),
        **plan,
    }
    _hide_several(scenario, own)
    if subject == AND_BACKGROUND:
        _hide_background(scenario, own, late=bool(late))
    _hide_beams(scenario, own)
    warms = any(each.by_temperature for each in scenario.effects)
    scenario.settings["temperature_drift_C"] = _MIXED_DRIFT_C if warms else 0.0
    return scenario.trial("wild")


def _hide_several(scenario: Scenario, own: _UnstatedArm) -> None:
    """Hide effects of the vocabulary, no two at one place, and none but springs twice."""
    rng, effects = scenario.rng, all_effects()
    turns_rad, times = _MIXED_TURN_RAD, _MIXED_TIMES
    if own.weights.slide is not None:
        turns_rad, times = turns_rad | _SLIDE_TURN_RAD, times | _SLIDE_TIMES
    names = [*turns_rad, *times]
    weights = np.array([_WEIGHTS.get(name, 1.0) for name in names])
    count, taken = int(rng.integers(*_MIXED_COUNT, endpoint=True)), set[str]()
    while len(scenario.hidden) < count:
        name = str(rng.choice(names, p=weights / weights.sum()))
        hidden_already = any(entry["id"] == name for entry in scenario.hidden)
        places = places_of(trial_places(effects[name]), scenario.robot, own.loaded)
        if name in _SLIDE_TIMES | _SLIDE_TURN_RAD:
            places = ["joint 1"]  # the slide below the arm, not a quill
        places = [place for place in places if place not in taken]
        if not places or (hidden_already and name != SPRING):
            continue
        of = str(rng.choice(places))
        taken.add(of)
        if name == SPRING:
            sag_rad = log_uniform(turns_rad[name], rng)
            K = own.stiffness(int(of.removeprefix("joint ")), sag_rad)
            scenario.put(name, of, {"K": K}, sag_rad / SAG_RAD[0])
        elif name in turns_rad:
            turn_rad = log_uniform(turns_rad[name], rng)
            effect = effects[name]
            drawn = effect.at_size(own.site(of), 1.0, rng) if name in _SLIDE_TURN_RAD else {}
            of_moment = [parameter for parameter in effect.model_fields if parameter != "stroke_m"]
            parameters = drawn | dict.fromkeys(of_moment, turn_rad / own.moment_at(of))
            scenario.put(name, of, parameters, turn_rad / _TURN_RAD[0])
        else:
            scenario.hide(effects[name], log_uniform(times[name], rng), own.site(of))


def _hide_beams(scenario: Scenario, own: _UnstatedArm) -> None:
    """Hide, in some trials, a constant error of a tracker's distances; with a stream of its own."""
    rng = np.random.default_rng([scenario.seed, _BEAM_STREAM])
    if rng.random() < _BEAMS:
        times = log_uniform(_BEAM_TIMES, rng)
        stand_off_m = tuple(round(reaches * own.arm.reach_m, 3) for reaches in _BEAM_REACHES)
        scenario.settings["without_touches"]["stand_off_m"] = stand_off_m
        parameters = all_effects()[BEAMS].at_size(own.site("instrument"), times, rng)
        scenario.put(BEAMS, "instrument", parameters, times)


def _hide_background(scenario: Scenario, own: _UnstatedArm, *, late: bool) -> None:
    """Hide effects outside the vocabulary that most joints of real arms have."""
    rng, (bearing, waves, late_log) = scenario.rng, BACKGROUND
    turning = (np.flatnonzero(~own.arm.prismatic) + 1).tolist()
    for joint in turning[1:]:
        soft_rad = log_uniform(_BACKGROUND_TILT_RAD, rng)
        soft = soft_rad / max(own.moment_Nm(joint - 2), _LOADED * own.moment_Nm(-1))
        tilts = {"soft": soft, "stiff": soft * rng.uniform(*_STIFFER)}
        tilts |= {"phi": float(rng.uniform(0.0, np.pi))}
        scenario.put(bearing, f"joint {joint}", tilts, soft_rad / _BACKGROUND_TILT_RAD[0])
    for joint in turning:
        site = own.site(f"joint {joint}")
        scenario.hide(all_effects()[waves], log_uniform(_BACKGROUND_WAVES, rng), site)
    if late:
        scenario.hide(all_effects()[late_log], log_uniform(_LATE_TIMES, rng), own.site("arm"))


def _path(arm: Arm, poses: int, rng: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Draw configurations [deg, mm] along stretches, each from a random one towards another."""
    step_rad = log_uniform(_STEP_RAD, rng)
    low, high = joint_bounds(arm)
    stretches, rows = [], 0
    while rows < poses:
        start, end = rng.uniform(low, high, (2, arm.n))
        count = int(rng.integers(*_STRETCH, endpoint=True))
        share_of_way = step_rad / np.abs(end - start).max() * np.arange(count)
        stretches.append(start + np.outer(np.minimum(share_of_way, 1.0), end - start))
        rows += count
    q = np.concatenate(stretches)[:poses]
    q = np.where(arm.prismatic, 1e3 * q, np.degrees(q)).round(_DECIMALS)
    return tuple(map(tuple, q.tolist()))
