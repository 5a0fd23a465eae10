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
    from pa10cal.files.output import write_text
    from pa10cal.report.gathered import gather
    from pa10cal.report.page import page_text

    found = gather(results, calibration, campaign_dir)
    text = page_text(found)
    write_text(out, text)
    print(f"{found.campaign}: report {out}, {len(text.encode()) / 1e6:.1f} MB")
