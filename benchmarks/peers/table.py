"""From the records of all runs to one page: medians, the bars, and what failed and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan
from statistics import median

OURS = "pa10cal"
#: Held-out error of a peer over ours that is still no loss, and how much faster we mean to be.
ERROR_BAR = 0.99
TIME_BARS = {"rows-0027": 5.0, "rows-1000": 40.0}
#: What counts as failed though it converged: a UR10 has no length near this one; the best has no
#: such share of the error.
LONGEST_M, FAR_OFF = 2.0, 2.0

_TABLES = {
    "Held-out mean position error [µm]": "mean_um",
    "Held-out rms position error [µm]": "rms_um",
    "Time of the calibration call [s]": "seconds",
    "Parameters fitted": "parameters",
}


@dataclass(frozen=True)
class Run:
    """One method on one problem, once.

    Attributes:
        method: name of the method.
        case: name of the problem without its seed.
        turn: number of the round; runs of one round had the same readings.
        status: `ok`, or what else.
        reason: why not ok.
        mean_mm, rms_mm: held-out position error; nan where there is none.
        seconds: time of the calibration call; nan where it did not end.
        parameters: how many were fitted, 0 where unknown.
        longest_m: longest length found; nan where not told.
    """

    method: str
    case: str
    turn: int
    status: str
    reason: str = ""
    mean_mm: float = nan
    rms_mm: float = nan
    seconds: float = nan
    parameters: int = 0
    longest_m: float = nan


@dataclass(frozen=True)
class Cell:
    """All runs of one method on one case; medians over those that gave a result.

    Attributes:
        runs: how many runs.
        results: how many gave a result, converged or not.
        mean_mm, rms_mm, seconds: medians; nan without results.
        parameters: least and most fitted.
    """

    runs: int
    results: int
    mean_mm: float
    rms_mm: float
    seconds: float
    parameters: tuple[int, int]


def page(
    runs: Sequence[Run],
    methods: Sequence[str],
    uncalibrated_mm: Mapping[str, float],
    conditions: Sequence[str],
    notes: Sequence[str],
) -> str:
    """Return the whole page.

    Args:
        runs: all runs.
        methods: order of the methods.
        uncalibrated_mm: median held-out mean error without calibration, by case, in order.
        conditions: lines that say what was run.
        notes: what was left out, one line each.
    """
    of, cases = cells(runs), list(uncalibrated_mm)
    methods = [method for method in methods if any(method == key[0] for key in of)]
    shown = ", ".join(f"{case} {1e3 * value:.4g}" for case, value in uncalibrated_mm.items())
    lines = ["# Side by side with other packages", "", *conditions]
    for title, what in _TABLES.items():
        lines += ["", f"## {title}", "", *_held_out(of, methods, cases, what)]
        if what == "mean_um":
            lines += ["", f"Nominal rows, base and target fitted: {shown}."]
            lines += [
                "(k of n): from k of n rounds, thus of other arms than the rest of its column."
            ]
    lines += ["", "## Against the bars", ""]
    lines += _bars(runs, [method for method in methods if method != OURS], cases)
    lines += ["", "## What failed", ""]
    lines += [*_failures(runs, uncalibrated_mm), *(f"- {note}" for note in notes)] or ["- nothing"]
    return "\n".join(lines) + "\n"


def cells(runs: Iterable[Run]) -> dict[tuple[str, str], Cell]:
    """Return the cell of every method and case that was run."""
    grouped: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        grouped.setdefault((run.method, run.case), []).append(run)
    return {key: _cell(group) for key, group in grouped.items()}


def _held_out(
    of: Mapping[tuple[str, str], Cell], methods: Sequence[str], cases: Sequence[str], what: str
) -> list[str]:
    """Return a Markdown table of one quantity, methods down and cases across."""
    lines = [f"| | {' | '.join(cases)} |", "| --- |" + " --- |" * len(cases)]
    most = {
        case: max((cell.runs for (_, at), cell in of.items() if at == case), default=0)
        for case in cases
    }
    for method in methods:
        shown = [_shown(of.get((method, case)), what, most[case]) for case in cases]
        lines.append(f"| {method} | {' | '.join(shown)} |")
    return lines


def _bars(runs: Sequence[Run], peers: Sequence[str], cases: Sequence[str]) -> list[str]:
    """Return a table that holds the peers against us; each by the rounds that both gave."""
    lines = [
        "| case | best peer | its error over ours | no peer better by > 1 % | fastest peer "
        "| its time over ours | bar |",
        "| --- |" + " --- |" * 6,
    ]
    for case in cases:
        errors = {peer: _over_ours(runs, peer, case, "mean_mm") for peer in peers}
        times = {peer: _over_ours(runs, peer, case, "seconds") for peer in peers}
        told = [peer for peer in peers if not isnan(errors[peer])]
        row = [case, *["–"] * 6]
        if told:
            best, fastest = min(told, key=errors.__getitem__), min(told, key=times.__getitem__)
            row[1:4] = [best, f"{errors[best]:.3f}", _kept(errors[best] >= ERROR_BAR)]
            row[4:6] = [fastest, f"{times[fastest]:.1f}"]
            if case in TIME_BARS:
                row[6] = f"≥ {TIME_BARS[case]:g}: {_kept(times[fastest] >= TIME_BARS[case])}"
        lines.append(f"| {' | '.join(row)} |")
    return lines


def _over_ours(runs: Sequence[Run], peer: str, case: str, what: str) -> float:
    """Return a peer's median over ours in the rounds that both gave a result; nan without."""
    theirs, ours = (
        {
            run.turn: float(getattr(run, what))
            for run in runs
            if run.method == method and run.case == case and not isnan(run.mean_mm)
        }
        for method in (peer, OURS)
    )
    both = theirs.keys() & ours.keys()
    if not both:
        return nan
    return median(theirs[turn] for turn in both) / median(ours[turn] for turn in both)


def _failures(runs: Sequence[Run], uncalibrated_mm: Mapping[str, float]) -> list[str]:
    """Return one line for each way in which a method failed, with the cases and how often."""
    found: dict[tuple[str, str], list[str]] = {}
    for method, case in dict.fromkeys((run.method, run.case) for run in runs):
        group = [run for run in runs if (run.method, run.case) == (method, case)]
        ways = [_failure(run, runs, uncalibrated_mm[case]) for run in group]
        for way in dict.fromkeys(ways):
            if way:
                place = f"{case} in {ways.count(way)} of {len(group)}"
                found.setdefault((method, way), []).append(place)
    return [f"- {method}: {way} ({', '.join(places)})" for (method, way), places in found.items()]


def _failure(run: Run, runs: Sequence[Run], uncalibrated_mm: float) -> str:
    """Return how a run failed, or nothing."""
    if run.status != "ok":
        return f"{run.status}, {run.reason}"
    if run.mean_mm > uncalibrated_mm:
        return "worse than no calibration"
    if run.longest_m > LONGEST_M:
        return f"lengths beyond {LONGEST_M:g} m"
    same = [
        other.mean_mm
        for other in runs
        if (other.case, other.turn) == (run.case, run.turn) and not isnan(other.mean_mm)
    ]
    if run.mean_mm > FAR_OFF * min(same):
        return f"more than {FAR_OFF:g} times the error of the best"
    return ""


def _cell(runs: Sequence[Run]) -> Cell:
    there = [run for run in runs if not isnan(run.mean_mm)]
    if not there:
        return Cell(len(runs), 0, nan, nan, nan, (0, 0))
    return Cell(
        runs=len(runs),
        results=len(there),
        mean_mm=median(run.mean_mm for run in there),
        rms_mm=median(run.rms_mm for run in there),
        seconds=median(run.seconds for run in there),
        parameters=(
            min(run.parameters for run in there),
            max(run.parameters for run in there),
        ),
    )


def _shown(cell: Cell | None, what: str, most: int) -> str:
    """Return what a cell shows, marked where it stands on fewer runs than others of its case."""
    if cell is None:
        return "–"
    if not cell.results:
        return "no result"
    if what == "parameters":
        least, largest = cell.parameters
        return str(least) if least == largest else f"{least}–{largest}"
    mark = "" if cell.results == most else f" ({cell.results} of {most})"
    if what == "seconds":
        return f"{cell.seconds:.3g}{mark}"
    return f"{1e3 * (cell.mean_mm if what == 'mean_um' else cell.rms_mm):.4g}{mark}"


def _kept(kept: bool) -> str:
    return "yes" if kept else "NO"
