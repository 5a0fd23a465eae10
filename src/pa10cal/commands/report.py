"""Command `report`."""

from __future__ import annotations

from pathlib import Path


def report(
    results: Path, *, out: Path, campaign_dir: Path | None = None, calibration: str = "combined"
) -> None:
    """Write the report of a campaign: one page for its reader, that needs no network.

    What is missing among the results is named on the page, with the reason.

    Args:
        results: results of a campaign, RESULTS_DIR/CAMPAIGN.
        out: page to write (.html).
        campaign_dir: folder of raw files, for what campaign.yaml says of the instrument.
        calibration: load case that was evaluated.

    Examples:
        pa10cal report results/cell-a --out report.html
    """
    from pa10cal.reports.page import write_page

    name, size = write_page(results, out, campaign_dir, calibration)
    print(f"{name}: report {out}, {size / 1e6:.1f} MB")


def write_what_there_is(results: Path, campaign_dir: Path, calibration: str) -> Path | None:
    """Write the report of a run that a stage has ended, and return its path.

    None without results, or with those of a run that came to its end before: they are not of the
    raw files as they are now.

    Args:
        results, campaign_dir, calibration: see `report`.
    """
    from pa10cal.errors import Pa10calError
    from pa10cal.reports.gathered import MODEL
    from pa10cal.reports.page import write_page

    if (results / MODEL).exists():
        return None
    out = results / "report.html"
    try:
        write_page(results, out, campaign_dir, calibration)
    except Pa10calError:  # there is nothing to tell but what ended the run
        return None
    return out
