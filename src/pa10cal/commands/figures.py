"""Command `figures`: the static pictures and tables of a results folder."""

from __future__ import annotations

from pathlib import Path

from pa10cal.command_settings import PictureOptions


def figures(
    *,
    results: Path,
    campaign_dir: Path | None = None,
    figure: str | None = None,
    out_dir: Path | None = None,
    force: bool = False,
    settings: PictureOptions = PictureOptions(),
) -> None:
    """Draw the figures and tables of a results folder.

    Args:
        results: results of a campaign, of blind trials, of a curve or of chains along curves.
        campaign_dir: folder of raw files, for a campaign.
        figure: name of a figure or table to draw alone; by default all that have something to show.
        out_dir: gets the folders figures and tables; by default the results.
        force: draw a calibration that is neither good nor few_poses nor incomplete; every picture
            is marked.
        settings: sections figures, kcub_reading, montecarlo and evaluation.

    Examples:
        pa10cal figures --results results/mine --campaign-dir data/raw/mine
        pa10cal figures --results results/mine --campaign-dir data/raw/mine --figure gap_by_step \\
          --out-dir /tmp/one
    """
    from pa10cal.figures.draw import draw_all, draw_one, read_source, summary

    source = read_source(results, campaign_dir, settings, force=force)
    out = out_dir or results
    if figure is not None:
        draw_one(figure, source, out, settings.figures)
        print(f"{source.name}: {figure}")
    else:
        for line in summary(draw_all(source, out, settings.figures)):
            print(f"{source.name}: {line}")
