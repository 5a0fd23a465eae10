"""What is missing from results and model, and what to measure next."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pa10cal.figures.parameter_names import written
from pa10cal.reports.blocks import (
    Block,
    Callout,
    Folded,
    Items,
    Paragraph,
    Section,
    count,
    grid,
    listed,
    mm,
    parameters,
    sentence,
)
from pa10cal.reports.gathered import Gathered
from pa10cal.reports.pictures import poses_drawing
from pa10cal.results.discovery import NotTestable, VerdictRecord

#: Of more suggested poses only the first are shown; all are in the file.
_MOST_POSES = 10
#: An aim that several joints of one pose may share.
_UNSEEN = re.compile(r"angle of joint (\d+) not seen")


def missing(found: Gathered) -> Section:
    """Return what these data do not show."""
    return Section("missing", "What is missing", tuple(_missing(found)))


def _missing(found: Gathered) -> Iterator[Block]:
    for each in found.absent:
        yield Callout("missing", f"{each.why} {each.remedy}")
    told = tuple(_told(found))
    if told:
        yield Items(told)
    if found.calibration is not None and (pairs := found.calibration.health.correlated_pairs):
        title = "Parameters that these poses can hardly separate"
        rows = [(*map(written, each.parameters), f"{each.correlation:+.3f}") for each in pairs]
        table = grid(title, ("parameter", "and", "correlation"), rows, (2,))
        yield Folded(f"{title} ({count(len(pairs), 'pair')})", (table,))
    record = found.verdict
    if record is not None:
        if record.not_testable:
            yield _effects("These data cannot show some effects", record.not_testable)
        if record.below_detection_limit:
            yield _effects(
                "Effects that were sought, but are likely to be missed at their plausible size",
                record.below_detection_limit,
            )
        if record.indistinguishable:
            yield Items(
                tuple(
                    f"These poses cannot separate {listed(each.words for each in group)}."
                    for group in record.indistinguishable
                )
            )
    if not (found.absent or told or (record is not None and record.not_testable)):
        yield Paragraph("Nothing is missing that these data could have shown.")


def _told(found: Gathered) -> Iterator[str]:
    if found.calibration is not None:
        health = found.calibration.health
        if health.not_identifiable:
            names = parameters(health.not_identifiable)
            yield f"Not identifiable from these poses: {names}."
        if not health.repeats:
            yield "No pose is repeated often enough to know how readings scatter."
        if not found.calibration.torques_logged:
            yield "Joint torques were not logged: springs use those of the described masses."
    if found.verdict is not None and found.verdict.verdict == "not_sought":
        yield f"Effects were not sought. {sentence(found.verdict.remedy or '')}"


def _effects(title: str, entries: tuple[NotTestable, ...]) -> Folded:
    """Group effects that cannot be shown for the same reason."""
    groups: dict[tuple[str, str], list[str]] = {}
    for entry in entries:
        groups.setdefault((entry.id, entry.why), []).append(entry.of.replace("_", " "))
    rows = [(id_.replace("_", " "), listed(places), why) for (id_, why), places in groups.items()]
    table = grid(title, ("effect", "of", "why"), rows)
    return Folded(f"{title} ({count(len(entries), 'effect')})", (table,))


def next_poses(found: Gathered) -> Section:
    """Return what to measure next, and what for."""
    return Section("next", "What to measure next", tuple(_next(found)))


def _next(found: Gathered) -> Iterator[Block]:
    if found.calibration is not None:
        poses = found.calibration.health.poses
        now = f"{poses.measured} poses give a standard uncertainty of {mm(poses.u_model_mm)} mm"
        if poses.u_model_mm is None:
            yield Paragraph("How uncertain predictions are is not known.")
        elif poses.needed is None:
            yield Paragraph(
                f"{now}; {mm(poses.u_needed_mm)} mm would add hardly anything to the remaining "
                "error, and no number of such poses reaches it."
            )
        else:
            yield Paragraph(
                f"{now} of a predicted position. {mm(poses.u_needed_mm)} mm is enough, beside the "
                f"remaining error; {poses.needed} well-chosen poses reach it. For a "
                "repetition of the campaign, the most informative of those measured are, in order: "
                f"{', '.join(list(dict.fromkeys(poses.d_optimal_order))[:_MOST_POSES])}."
            )
        drawing = poses_drawing(poses)
        if drawing is not None:
            yield drawing
    record = found.verdict
    if record is None:
        yield Callout("missing", found.why_absent(VerdictRecord.FILE))
        return
    if not record.suggested_poses:
        yield Paragraph("No further poses are suggested to tell effects apart.")
        return
    joints = len(record.suggested_poses[0].q_deg)
    yield grid(
        f"The {count(min(len(record.suggested_poses), _MOST_POSES), 'pose')} that tell most, in "
        "discovery/suggested_poses.csv too. An arrow says whether the joint arrives from smaller "
        "(↑) or from larger (↓) angles.",
        ("order", *(f"q{j} [deg]" for j in range(1, joints + 1)), "load [N]", "to tell"),
        [
            (str(k), *_angles(each.q_deg, each.arrive_from), f"{each.load_N:g}", _aims(each.for_))
            for k, each in enumerate(record.suggested_poses[:_MOST_POSES], start=1)
        ],
        range(joints + 2),
    )
    hopeless = [each.pair for each in record.separations or () if not each.can_be_split]
    if hopeless:
        names = "; ".join(each.replace("_", " ") for each in hopeless)
        yield Callout("note", f"No pose of this arm and instrument shows: {names}.")


def _angles(q_deg: object, arrive_from: object) -> Iterator[str]:
    sides = [""] * len(q_deg) if arrive_from is None else arrive_from  # type: ignore[arg-type]
    for angle, side in zip(q_deg, sides, strict=True):  # type: ignore[call-overload]
        yield f"{angle:.1f}{'' if side == '' else ' ↑' if side < 0 else ' ↓'}"


def _aims(names: tuple[str, ...]) -> str:
    unseen = [found[1] for name in names if (found := _UNSEEN.fullmatch(name))]
    rest = [name.replace("_", " ") for name in names if not _UNSEEN.fullmatch(name)]
    if unseen:
        rest.append(f"angle{'s' if unseen[1:] else ''} of joint {listed(unseen)} not seen")
    return "; ".join(rest)
