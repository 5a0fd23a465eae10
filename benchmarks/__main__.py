"""Measure everything and write `benchmarks/results.md`."""

from __future__ import annotations

import platform
from pathlib import Path

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.output import write_text


def main() -> None:
    """Run all benchmarks, one BLAS thread, and write the table."""
    limit_threads()
    from benchmarks import calibration, curve, montecarlo

    rows = [*montecarlo.rows(), *calibration.rows(), *curve.rows()]
    lines = [
        "# What was measured",
        "",
        f"`make bench` on {platform.machine()}, Python {platform.python_version()}, one thread.",
        "Ratios are between things timed in the same run; single times are of one machine only.",
        "",
        "| what | measured | bar |",
        "| --- | --- | --- |",
        *(f"| {what} | {value:.3g} {unit} | {bar} |" for what, value, unit, bar in rows),
    ]
    text = "\n".join(lines) + "\n"
    write_text(Path(__file__).parent / "results.md", text)
    print(text)


if __name__ == "__main__":
    main()
