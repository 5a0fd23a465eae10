"""What commands that draw one picture of a study share."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Protocol


class Study(Protocol):
    """What a study's pictures are drawn from."""

    @property
    def footer(self) -> str:
        """Return what stands below every picture."""


def draw_picture(
    name: str,
    out_dir: Path,
    png_dpi: int,
    figures: tuple[str, ...],
    tables: tuple[str, ...],
    read: Callable[[], Study],
    of: str,
) -> None:
    """Draw one figure or write one table of a study.

    Args:
        name: of the figure or table.
        out_dir: folder for it.
        png_dpi: resolution of a figure's PNG.
        figures, tables: names of the modules that there are.
        read: reads the study, once the name is known to be right.
        of: what the study is of, for messages.

    Raises:
        SettingsError: when there is no picture of that name.
    """
    from pa10cal.errors import SettingsError

    if name not in (*figures, *tables):
        raise SettingsError(
            f"no such figure or table of {of}",
            where="--figure",
            value=name,
            allowed=", ".join((*figures, *tables)),
            remedy="correct the name",
        )
    study = read()
    # By name, so that a picture is drawn anew only when its own module changes.
    module = import_module(f"pa10cal.figures.{name}")
    if name in tables:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(study), study.footer, out_dir, name)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            figure = module.draw(study)
            write_figure(figure, study.footer, out_dir, name, png_dpi)
    print(f"{of}: {name}")
