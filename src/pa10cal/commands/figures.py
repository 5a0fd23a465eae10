"""Command `figures`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from pa10cal.figures.options import PictureOptions


def figures(
    *,
    figure: str,
    campaign_dir: Path,
    results_dir: Path,
    out_dir: Path,
    settings: PictureOptions = PictureOptions(),
) -> None:
    """Draw one figure or table of a campaign.

    Args:
        figure: name of a figure or table.
        campaign_dir: folder of raw files.
        results_dir: results of this campaign.
        out_dir: folder for the figure or table.
        settings: sections figures, kcub_reading, montecarlo and evaluation.
    """
    from pa10cal.campaign.description import read_campaign
    from pa10cal.errors import SettingsError
    from pa10cal.figures.catalogue import FIGURES, TABLES
    from pa10cal.figures.results import Results

    if figure not in (*FIGURES, *TABLES):
        raise SettingsError(
            "no such figure or table",
            where="--figure",
            value=figure,
            allowed=", ".join((*FIGURES, *TABLES)),
            remedy="correct the name",
        )
    campaign = read_campaign(campaign_dir)
    results = Results(
        folder=results_dir,
        raw=campaign_dir,
        campaign=campaign.name,
        provenance=campaign.provenance,
        robot=campaign.robot,
        instrument=campaign.instrument.kind,
        instrument_uncertainty_mm=campaign.instrument.uncertainty_mm,
        settings=settings,
    )
    # By name, so that a picture is drawn anew only when its own module changes.
    module = import_module(f"pa10cal.figures.{figure}")
    if figure in TABLES:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(results), results.footer, out_dir, figure)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            drawn = module.draw(results)
            write_figure(drawn, results.footer, out_dir, figure, settings.figures.png_dpi)
    print(f"{campaign.name}: {figure}")
