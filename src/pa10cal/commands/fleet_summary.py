"""Command `fleet_summary`."""

from __future__ import annotations

from pathlib import Path


def fleet_summary(*, campaigns: str, raw_dir: Path, results: Path, out: Path) -> None:
    """Summarise a fleet whose campaigns are done: table, record, page and picture.

    Args:
        campaigns: table of campaigns (.csv), or a pattern of folders of --raw-dir.
        raw_dir: folder of the campaigns.
        results: holds a folder of results for each.
        out: folder for fleet.csv, fleet.json, fleet.html, and fleet.png, .svg and .pdf.

    Examples:
        pa10cal fleet_summary --campaigns arms.csv --raw-dir data/raw --results results \\
          --out results/fleet
    """
    from pa10cal.figures.options import FigureOptions
    from pa10cal.figures.over_campaigns import write_fleet
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.fleet.campaigns import campaigns_of, fleet_csv
    from pa10cal.fleet.standing import fleet_record
    from pa10cal.reports.page import fleet_page_text
    from pa10cal.results.codec import write

    found = fleet_record(campaigns_of(campaigns, raw_dir), results)
    outputs = tuple(out / f"fleet.{ending}" for ending in ("csv", "html", "json"))
    with whole_files(*outputs) as (table, page, record):
        write_text(table, fleet_csv(found))
        write_text(page, fleet_page_text(found))
        write(found, record)
        write_fleet(found, out, "fleet", FigureOptions().png_dpi)
    words = ", ".join(f"{count} {word}" for word, count in found.counts.items())
    first = [each for each in found.arms if each.attention != "none"]
    print(f"fleet: {len(found.campaigns)} campaigns of {len(found.arms)} arms: {words}")
    print(f"fleet: {len(first)} arms need attention: {', '.join(e.arm for e in first[:10])}")
