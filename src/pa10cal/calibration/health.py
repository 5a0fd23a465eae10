"""Whether a calibration is good: its convergence, rank and errors, and the grade they give.

A grade is one word, and one sentence that says what to do. The rule stands in `docs/general.md`;
thresholds and their reasons stand here and there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import reported_name
from pa10cal.calibration.fit_summary import FitSummary, correlated, poses_needed
from pa10cal.calibration.rules import GRADES
from pa10cal.calibration.uncertainty import HeldOut
from pa10cal.results import calibration as records
from pa10cal.results.evaluation import BETWEEN
from pa10cal.terms.term import TermParameter

#: Findings of a check that held-out poses refute where they would leave more.
_OF_JOINTS = ("joint_sign", "joint_order", "joint_coupling")
#: What acquits readings that are far from the model.
RIGID = (
    "the targets keep their distances, so the readings are right: the model lacks something there, "
    "or a joint was misread"
)


@dataclass(frozen=True)
class GradeEvidence:
    """What a grade rests on: how a fit ended, and the remaining errors of the calibrated model."""

    ended: FitSummary  # how the fit ended
    # root mean square position error of the poses fitted, suspected outliers aside
    train_rms_mm: float
    held_out: HeldOut | None  # errors of poses held out, None where there are none
    noise_mm: float | None  # the part that the noise of readings explains, None where not known
    spread_mm: float  # root mean square distance of the measured positions from their mean
    suspected_outliers: int = 0  # poses far outside the scatter of the others
    acquitted: int = 0  # of these, those whose targets keep their distances
    # the same as `train_rms_mm` with them; None where there are none
    all_rms_mm: float | None = None
    # whether that noise is what readings scatter by, and not what is stated
    noise_is_found: bool = False
    # error that the targets' places on an apparatus leave in all poses alike, and that no
    # parameter takes up
    apparatus_mm: float = 0.0
    # what repeats show of the stated uncertainty, by kind
    repeats: tuple[records.RepeatScatter, ...] = ()
    from_touches: bool = False  # whether the instrument touches balls
    findings: tuple[records.InputFinding, ...] = ()  # what checks of the input found
    # the same as `train_rms_mm` with rigid joints; None where the model has no springs
    without_springs_mm: float | None = None
    # where weights come from that nobody stated: `assumed` from the lengths of the links, or from
    # the mass of the whole arm (`total`); else nothing
    weights: str = ""
    # standard uncertainty of the tool's centre of mass, where springs go by it and nobody stated it
    com_u_m: float | None = None
    # standard uncertainty of predicted positions that is wanted; None where nobody says so
    wanted_mm: float | None = None
    # the same as `train_rms_mm` of the nominal arm, base and targets fitted; None where not known
    nominal_mm: float | None = None
    arm: Arm | None = None  # as described; None where that is not known
    # largest turn of the end-effector between two poses [rad]; None where not known
    turned_rad: float | None = None

    @cached_property
    def poses(self) -> records.PosesNeeded:
        """Return how many poses there are, and how many the uncertainty needs.

        Where nobody says what is wanted, it is one that adds hardly anything to the error.
        """
        wanted_mm = self.wanted_mm
        single_mm = self.single_mm if self.below_noise else self.train_rms_mm
        small_mm = GRADES.small_share * single_mm if wanted_mm is None else wanted_mm
        return poses_needed(self.ended, small_mm, wanted_mm)

    @property
    def u_model_mm(self) -> float:
        """Return the standard uncertainty of a predicted position; inf where not determined."""
        return float("inf") if self.poses.u_model_mm is None else self.poses.u_model_mm

    @property
    def rank(self) -> int:
        """Return how many directions are identified."""
        return self.ended.identifiability.rank

    @cached_property
    def rows(self) -> int:
        """Return how many components were fitted."""
        return int(np.count_nonzero(np.any(self.ended.white != 0.0, axis=2)))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return what these poses do not determine, and others of the arm could."""
        return tuple(sorted(self.ended.not_identifiable - self.ended.hidden))

    @property
    def soft(self) -> bool:
        """Return whether springs explain the larger part of what rigid joints leave."""
        rigid_mm = self.without_springs_mm
        return rigid_mm is not None and self.train_rms_mm**2 < GRADES.mostly_share * rigid_mm**2

    @property
    def within_noise(self) -> bool:
        """Return whether the remaining error is about the noise, however large that is."""
        over = self.over_noise
        return over is not None and over < GRADES.stated_ratio

    @property
    def fits_not(self) -> bool:
        """Return whether more remains than calibrated arms have, and than noise explains."""
        return self.train_rms_mm > GRADES.no_fit_share * self.spread_mm and not self.within_noise

    @property
    def confirmed(self) -> bool:
        """Return whether held-out poses are predicted as well as the fitted ones are explained."""
        away = self.held_out
        if away is None or away.accuracy.configurations < GRADES.few_held_out:
            return False
        # Where much is left, another cause may look like a departure.
        if self.fits_not or not (self.over_noise is None or self.within_noise):
            return False
        # What is exact is confirmed by what is as exact.
        known_mm = max(self.error_mm, self.own_noise_mm or 0.0)
        return away.accuracy.rms_mm < GRADES.confirmed_ratio * known_mm

    @property
    def error_mm(self) -> float:
        """Return the remaining error without what the fit has taken up of it."""
        taken = min(self.rank / max(self.rows, 1), GRADES.most_taken_share)
        return self.train_rms_mm / float(np.sqrt(1.0 - taken))

    @property
    def own_noise_mm(self) -> float | None:
        """Return the error that readings and apparatus explain; None where it is not known."""
        noise_mm = self.reading_noise_mm
        return None if noise_mm is None else float(np.hypot(noise_mm, self.apparatus_mm))

    @property
    def reading_noise_mm(self) -> float | None:
        """Return the noise of the poses fitted: as repeats show it, else as stated."""
        if self.noise_mm is None or self.noise_is_found or not self.repeats:
            return self.noise_mm
        return self.noise_mm * self.repeats[0].ratio

    @cached_property
    def departures(self) -> tuple[records.InputFinding, ...]:
        """Return the departures that no arm was built with, where held-out poses confirm them."""
        if not self.confirmed:
            return ()
        found = tuple(_departures(self))
        zeros = (each for each in self.findings if each.kind == "joint_zero")
        return (*(each for each in zeros if not found), *found)

    @property
    def below_noise(self) -> bool:
        """Return whether less remains than is stated, by more than chance: see `_remarks`."""
        over = self.over_noise
        return over is not None and over < 1.0 / GRADES.stated_ratio

    @property
    def single_mm(self) -> float:
        """Return the error of a single reading: what remains, or what is stated if that is more."""
        return (self.own_noise_mm or 0.0) if self.below_noise else self.error_mm

    @property
    def over_noise(self) -> float | None:
        """Return the remaining error over the noise; None where that is not known."""
        noise_mm = self.own_noise_mm
        return self.error_mm / noise_mm if noise_mm else None

    @property
    def most_over_noise(self) -> float:
        """Return how many times the noise the remaining error may be."""
        own_mm, reading_mm = self.own_noise_mm, self.reading_noise_mm
        dof = max(self.rows - self.rank, 1)
        limit = GRADES.over_noise * (1.0 + GRADES.chance_errors / float(np.sqrt(2.0 * dof)))
        if not own_mm or reading_mm is None:
            return limit
        of_targets_mm = GRADES.apparatus_ratio * self.apparatus_mm
        return limit * float(np.hypot(reading_mm, of_targets_mm)) / own_mm

    @property
    def over_expected(self) -> float | None:
        """Return the held-out error over the one that the fit promises; None where by chance.

        Noise grows where fewer readings were averaged; what the model lacks does not.
        """
        away = self.held_out
        if away is None:
            return None
        noise_mm = min(self.reading_noise_mm or self.error_mm, self.error_mm)
        lacking = self.error_mm**2 - noise_mm**2
        u_mm = self.u_model_mm if away.u_mm is None else away.u_mm
        expected_mm = float(np.sqrt(lacking + noise_mm**2 / away.repeats + u_mm**2))
        ratio = away.accuracy.rms_mm / expected_mm
        count = max(away.accuracy.configurations, 1)
        at_most = max(GRADES.over_expected, 1.0 + GRADES.chance_errors / np.sqrt(2.0 * count))
        return ratio if ratio > at_most else None


def health(evidence: GradeEvidence) -> records.Health:
    """Judge a calibration by its convergence and its remaining errors."""
    ended, away = evidence.ended, evidence.held_out
    grade, line, findings = graded(evidence)
    return records.Health(
        grade=grade,
        line=line,
        converged=ended.solution.converged,
        reason=ended.solution.reason,
        iterations=ended.solution.iterations,
        at_bounds=tuple(map(reported_name, ended.at_bound)),
        rank=evidence.rank,
        unknowns=len(ended.parameters),
        condition=ended.identifiability.condition,
        not_identifiable=tuple(sorted(map(reported_name, ended.not_identifiable))),
        correlated_pairs=correlated(ended),
        train_rms_mm=evidence.train_rms_mm,
        held_out_rms_mm=None if away is None else away.accuracy.rms_mm,
        noise_mm=evidence.noise_mm,
        error_over_noise=evidence.over_noise,
        held_out_over_expected=evidence.over_expected,
        repeats=evidence.repeats,
        findings=findings,
        departures=evidence.departures,
        poses=evidence.poses,
    )


def graded(evidence: GradeEvidence) -> tuple[records.Grade, str, tuple[records.InputFinding, ...]]:
    """Grade a calibration.

    Returns:
        The grade, one sentence with the reason and the remedy, and what is suspected of the input.
    """
    solution = evidence.ended.solution
    if not solution.converged:
        remedy = "raise calibration.max_iterations, or measure more poses"
        return "not_converged", f"the fit did not converge: {solution.reason}; {remedy}", ()
    errors = _errors(evidence)
    doubts = (each for each in evidence.findings if not _is_moot(each, evidence))
    if findings := (*doubts, *_suspected(evidence)):
        more = f"; {len(findings) - 1} more in health.findings" if findings[1:] else ""
        return "suspect_input", f"{errors}; check the input: {findings[0]}{more}", findings
    beside = "".join(f"; {remark}" for remark in _remarks(evidence))
    if lacks := _lacking(evidence):
        return "incomplete", f"{errors}, {lacks}{beside}", ()
    if few := _few(evidence):
        return "few_poses", f"{errors}; {few}{beside}", ()
    if uncertain := _uncertain(evidence):
        return "few_poses", f"{uncertain}; {errors}{beside}", ()
    noise_mm = evidence.own_noise_mm
    over = evidence.over_noise
    agrees = "" if noise_mm is None else f", as the noise of {noise_mm:.3f} mm explains"
    if noise_mm is not None and f"{noise_mm:.3f}" == f"{evidence.train_rms_mm:.3f}":
        agrees = ", as the noise explains"
    if noise_mm is not None and over is not None and over > GRADES.noticed_ratio:
        agrees = f", {over:.2g} times the noise of {noise_mm:.3f} mm"
    if evidence.u_model_mm > GRADES.small_share * evidence.error_mm:
        beside = (
            f"; predicted positions have a standard uncertainty of {evidence.u_model_mm:.3f} mm"
            f"{beside}"
        )
    return (
        "good",
        f"{errors}{agrees}; everything that such an instrument can determine is determined"
        f" (rank {evidence.rank}){beside}",
        (),
    )


def _is_moot(finding: records.InputFinding, evidence: GradeEvidence) -> bool:
    """Return whether a finding of a check is none: confirmed, or refuted, by held-out poses.

    A sign or an order of joints that would leave more than the model does cannot be right, nor can
    joints that move together.
    """
    if not evidence.confirmed:
        return False
    left_mm = finding.would_leave_mm
    refuted = finding.kind in _OF_JOINTS and left_mm is not None
    return finding in evidence.departures or (refuted and (left_mm or 0.0) > evidence.train_rms_mm)


def most_stated(factor: float = GRADES.stated_ratio, *, from_touches: bool) -> float:
    """Return how many times the scatter of repeats a stated uncertainty may be."""
    return max(factor, GRADES.touches_ratio) if from_touches else factor


def _errors(evidence: GradeEvidence) -> str:
    fitted = f"{evidence.train_rms_mm:.3f} mm"
    text = f"remaining error {fitted} rms over the poses fitted"
    if (count := evidence.suspected_outliers) and evidence.all_rms_mm is not None:
        text = (
            f"remaining error {evidence.all_rms_mm:.3f} mm rms over the poses fitted ({fitted} "
            f"without {count} far from the model)"
        )
    if (away := evidence.held_out) is not None:
        there = f"{away.accuracy.rms_mm:.3f} mm"
        where = f" {away.where}" if away.where else ""
        text += (
            f" and over held-out poses{where}"
            if text.endswith("fitted") and there == fitted
            else f", {there} over held-out poses{where}"
        )
        if away.between is not None:
            text += f", {away.between.rms_mm:.3f} mm {BETWEEN}"
        if away.suspected:
            text += f" without {away.suspected} with a suspected reading"
    return text


def _suspected(evidence: GradeEvidence) -> Iterator[records.InputFinding]:
    """Return what the fit itself shows to be wrong in the input."""
    if evidence.fits_not and not evidence.soft:
        yield records.InputFinding(
            what="the arm as described does not fit the readings",
            where="the whole campaign",
            remedy="check robot, order, signs and zeros of the joints, and units",
            kind="other_arm",
        )
    yield from _stated(evidence)
    if not evidence.confirmed:
        yield from _departures(evidence)


def _departures(evidence: GradeEvidence) -> Iterator[records.InputFinding]:
    """Return departures that no arm was built with, the largest first.

    Where held-out poses confirm them they are what was found, and else what is suspected.
    """
    ended, over = evidence.ended, max(evidence.over_noise or 1.0, 1.0)
    std = np.sqrt(np.maximum(np.diag(ended.covariance), 0.0))
    apart = ended.not_identifiable | ended.of_mounting
    far = [
        (abs(float(value)) / each.tolerance, float(value), each)
        for each, value, sigma in zip(ended.parameters, ended.solution.x, std, strict=True)
        if each.tolerance
        and each.name not in apart
        and abs(value) - GRADES.chance_errors * over * sigma > GRADES.far_off_ratio * each.tolerance
    ]
    for size, value, each in sorted(far, key=lambda each: -each[0]):
        of = ended.departures.get(each.name, "")
        yield records.InputFinding(
            what=_departed(each, of, value, size) + _looks_like(evidence.arm, of, value),
            where=each.name,
            remedy="check this value in the description of the arm, and the zero of its joint in "
            "the log",
            kind="departure",
        )


def _departed(parameter: TermParameter, of: str, value: float, tolerances: float) -> str:
    """Return a departure as people say it: angles in degrees, lengths in millimetres."""
    unit, (kind, _, joint) = parameter.unit, of.rpartition("_")
    off = f"{np.degrees(value):.3g} deg" if unit == "rad" else f"{1e3 * value:.3g} mm"
    if kind == "theta":
        off = f"{np.degrees(abs(value)):.3g} deg"
        return f"joint {joint} was mastered {off} off ({tolerances:.0f} tolerances)"
    return f"{off} from nominal ({tolerances:.0f} tolerances)"


def _looks_like(arm: Arm | None, of: str, value: float) -> str:
    """Return what a departure looks like: whole turns of a motor, or the wrong sign of a length."""
    kind, _, number = of.rpartition("_")
    if arm is None or kind not in ("theta", "a", "d"):
        return ""
    row = int(number) - 1
    if kind != "theta":
        length = float((arm.a_m if kind == "a" else arm.d_m)[row])
        reversed_ = abs(value + 2.0 * length) < GRADES.of_a_length * abs(length)
        return f": as if the sign of its {1e3 * length:.4g} mm were wrong" if reversed_ else ""
    ratio = abs(float(arm.gear_ratio[row]))
    turns = abs(value) * ratio / (2.0 * np.pi)
    whole = round(turns) if np.isfinite(turns) else 0
    if ratio <= 1.0 or not whole or abs(turns - whole) > GRADES.of_a_turn:
        return ""
    return f": {whole} turn{'s' * (whole > 1)} of a motor of ratio {ratio:g}"


def _stated(evidence: GradeEvidence) -> Iterator[records.InputFinding]:
    """Return where stated and found uncertainty are off by more than a factor."""
    for scatter in evidence.repeats:
        turns = scatter.kind.startswith("attitude")
        unit, off = ("mrad", GRADES.attitude_ratio) if turns else ("mm", GRADES.stated_ratio)
        joints = GRADES.joint_rad * (1.0 if turns else 1e-3 * evidence.spread_mm)
        too_small = scatter.found > off * np.hypot(scatter.stated, joints)
        most = most_stated(off, from_touches=evidence.from_touches)
        too_large = scatter.stated > most * scatter.found
        if too_small or too_large:
            yield records.InputFinding(
                what=f"{1e3 * scatter.stated:.2g} {unit} is stated, repeats scatter by "
                f"{1e3 * scatter.found:.2g} {unit}",
                where=f"stated uncertainty of the {scatter.kind}",
                remedy="check its unit and value, and whether readings were copied or averaged",
                kind="stated_uncertainty",
            )
    if evidence.repeats or evidence.noise_is_found or not evidence.noise_mm:
        return
    ratio = evidence.error_mm / evidence.noise_mm
    # The unit in which it seems stated, by the error that remains over it.
    units = {"metres, multiply it by 1000": 1e3, "micrometres, divide it by 1000": 1e-3}
    near = {name: abs(np.log(max(ratio, GRADES.tiny) / factor)) for name, factor in units.items()}
    unit = min(near, key=lambda name: near[name])
    like_unit = near[unit] < np.log(GRADES.of_unit)
    # Noise that is stated too large by another factor is no mistake of the input: see `_remarks`.
    if (ratio < 1.0 and like_unit) or ratio > GRADES.unit_ratio:
        looks = f": it looks like {unit}" if like_unit else ""
        yield records.InputFinding(
            what=f"{evidence.noise_mm:.2g} mm is stated, {evidence.error_mm:.2g} mm remain",
            where="stated uncertainty of the position (instrument.uncertainty_mm)",
            remedy=f"check its unit and value{looks}",
            kind="stated_uncertainty",
        )


def _lacking(evidence: GradeEvidence) -> str:
    """Return what shows that the model lacks something; nothing where it does not."""
    parts = []
    over = evidence.over_noise
    if over is not None and over > evidence.most_over_noise:
        known = "" if evidence.noise_is_found or evidence.repeats else "stated "
        parts.append(
            f"{over:.2g} times the {known}noise of {evidence.own_noise_mm:.3f} mm: the model is "
            "missing an effect"
            + (", or the stated uncertainty is too small" if known else "")
            + (", or the instrument moved between readings" if over >= GRADES.stated_ratio else "")
        )
    if (ratio := evidence.over_expected) is not None:
        parts.append(
            f"{ratio:.2g} times the error that the fit promises for held-out poses: they differ "
            "from the poses fitted, or the model is missing an effect"
        )
    rigid_mm = evidence.without_springs_mm
    # Of another robot a springy model leaves as much: a reader is to know why it was not refused.
    refused = evidence.fits_not
    if parts and refused and evidence.soft and rigid_mm is not None:
        parts.append(
            f"a soft arm: with rigid joints {rigid_mm:.3f} mm remain, springs explain the larger "
            "part"
        )
    return "; ".join(parts) + "; see the verdict" if parts else ""


def _few(evidence: GradeEvidence) -> str:
    """Return what more poses would bring; nothing where there are enough."""
    names, unknowns = evidence.undetermined, len(evidence.ended.parameters)
    told = f"the poses identify {evidence.rank} of {unknowns} unknowns"
    if not np.isfinite(evidence.u_model_mm):
        return f"{told}; measure at least {-(-unknowns // 2)} poses, well spread"
    if names:
        weights = {*names} <= {*evidence.ended.having("weight")}
        remedy = (
            "state the mass of the tool and its centre (tool in campaign.yaml), or measure under "
            "loads: joints as stiff as these hardly show weights"
            if weights
            else "measure poses in other orientations: the tool hardly turned "
            f"({np.degrees(evidence.turned_rad):.2g} deg at most)"
            if evidence.turned_rad is not None and evidence.turned_rad < GRADES.hardly_turned_rad
            else "measure poses that move every joint over its range"
        )
        return f"not identifiable with these poses: {_listed(names)} ({told}); {remedy}"
    return ""


def _uncertain(evidence: GradeEvidence) -> str:
    """Return what more poses would bring to predictions; nothing where they are as wanted.

    Where nobody says what is wanted, they are to be no more uncertain than single readings.
    """
    u_mm, wanted_mm = evidence.u_model_mm, evidence.wanted_mm or evidence.single_mm
    if u_mm <= wanted_mm:
        return ""
    more = int(np.ceil(len(evidence.ended.white) * ((u_mm / wanted_mm) ** 2 - 1.0)))
    word = "good" if u_mm <= evidence.single_mm else "more uncertain than single readings"
    text = f"{word}: {u_mm:.3f} mm standard uncertainty of predicted positions"
    if f"{wanted_mm:.3f}" == f"{u_mm:.3f}":
        return text
    return f"{text}; {more} more pose{'s' * (more > 1)} would reach {wanted_mm:.3f} mm"


def _remarks(evidence: GradeEvidence) -> Iterator[str]:
    """Return what a reader should know besides."""
    # A linear spring at its bound is a joint as rigid as the readings can show: no remark.
    rigid = evidence.ended.having("windup")
    held = tuple(name for name in evidence.ended.at_bound if name not in rigid)
    if held:
        yield f"{_listed(held)} at the end of the physical range"
    if evidence.weights:
        yield (
            "no masses are stated, so weights are assumed "
            + (
                "from the lengths of the links"
                if evidence.weights == "assumed"
                else "from the mass of the whole arm"
            )
            + ": stiffness is relative to them"
        )
    log = None if evidence.arm is None else weights_known(evidence.arm).by_log
    if log is not None and log.said:
        yield log.said
    if evidence.com_u_m is not None:
        yield (
            "the tool's centre of mass is not stated (tool.com_mm is 0, 0, 0): it counts as "
            f"unknown by {1e3 * evidence.com_u_m:.0f} mm"
        )
    if off := evidence.departures:
        more = f" ({len(off) - 1} more in health.departures)" if off[1:] else ""
        yield f"{off[0].where}: {off[0].what}, as held-out poses confirm{more}"
    if evidence.below_noise and not (evidence.repeats or evidence.noise_is_found):
        yield (
            f"the stated noise of {evidence.noise_mm:.2g} mm is larger than what remains: effects "
            "below it stay hidden until a smaller one is stated (instrument.uncertainty_mm)"
        )
    nominal_mm = evidence.nominal_mm
    if nominal_mm is not None and nominal_mm <= GRADES.noticed_ratio * evidence.train_rms_mm:
        yield f"the nominal arm fits as well ({nominal_mm:.3f} mm): nothing is to be calibrated"
    if evidence.ended.identifiability.condition > GRADES.condition:
        yield f"condition number {evidence.ended.identifiability.condition:.1e}"
    if count := evidence.suspected_outliers:
        many = "s have" if count > 1 else " has"
        yield (
            f"{count} suspected outlier{many} less weight in the fit; see tables/suspected_outliers"
        )
        if evidence.acquitted:
            yield f"in {evidence.acquitted} of them {RIGID}"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(map(reported_name, names[: GRADES.most_names]))
    return shown + (" and others" if names[GRADES.most_names :] else "")
