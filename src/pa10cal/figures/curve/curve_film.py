"""A chain that moves, as a film: GIF, or MP4 where ffmpeg is installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from pa10cal.errors import OutputError
from pa10cal.figures.curve_drawing import draw_angles, space
from pa10cal.figures.curve_results import ONE_SHAPE, CurveResults
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import new_figure, panel

PICTURE = Picture(
    title="A chain that moves, as a film",
    needs=(),
    caption="""
A chain of links that moves ({name}), shape after shape, with the angles of its joints. The
film has one frame a shape, at the speed of the gait where that needs between one and fifty
frames a second. The helix stays in place while every link turns about itself, so every joint
bends to all sides in turn. Nothing of it was measured: the angles follow from the shapes alone.
""",
)

_HEIGHT_MM = 92.0
_LEAST_RATE_HZ, _MOST_RATE_HZ = 1, 50


def film(results: CurveResults, path: Path, dpi: int) -> None:
    """Write the shapes one after the other, as fast as they follow.

    Args:
        results: several shapes.
        path: ends in `.gif` or `.mp4`.
        dpi: dots an inch.

    Raises:
        NothingToShowError: when there is one shape.
        OutputError: when there is no writer of that kind.
    """
    if not results.moves:
        raise NothingToShowError(ONE_SHAPE)
    rate = (len(results.time_s) - 1) / float(results.time_s[-1] - results.time_s[0])
    writer = _writer(path, int(np.clip(rate, _LEAST_RATE_HZ, _MOST_RATE_HZ)))
    title = f"{results.record.links} links along a curve that moves (synthetic)"
    figure = new_figure(_HEIGHT_MM, title)
    with writer.saving(figure, str(path), dpi):
        for shape, time_s in enumerate(results.time_s):
            for axes in figure.axes:
                axes.remove()
            chain = space(figure, results, shape, (4.0, 4.0, 100.0, 78.0), numbers=False)
            chain.set_title(f"{time_s:.2f} s", loc="center")
            angles = panel(figure, 120.0, 24.0, 46.0, 50.0)
            draw_angles(angles, results, shape)
            angles.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1)
            writer.grab_frame()


def _writer(path: Path, rate_hz: int) -> AbstractMovieWriter:
    if path.suffix == ".gif":
        return PillowWriter(fps=rate_hz)
    if path.suffix == ".mp4" and FFMpegWriter.isAvailable():
        return FFMpegWriter(fps=rate_hz)
    raise OutputError(
        "no writer for this kind of film",
        where=str(path),
        value=path.suffix,
        allowed=".gif; .mp4 where ffmpeg is installed",
        remedy="write a GIF, or install ffmpeg",
    )
