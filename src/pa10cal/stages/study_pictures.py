"""What stages that draw one picture of a study share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Protocol


class Study(Protocol):
    """What a study's pictures are drawn from."""

    @property
    def footer(self) -> str:
        """Return what stands below every picture."""


def describe_picture(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that every such stage takes."""
    parser.add_argument("--figure", required=True, help="name of a figure or table of the study")
    parser.add_argument("--settings", default="{}", help="section figures: JSON or YAML file")
    parser.add_argument("--out-dir", type=Path, required=True)


def draw_picture(
    arguments: argparse.Namespace,
    figures: tuple[str, ...],
    tables: tuple[str, ...],
    read: Callable[[], Study],
    of: str,
) -> None:
    """Draw one figure or write one table of a study.

    Args:
        arguments: with those of `describe_picture`.
        figures, tables: names of the modules that there are.
        read: reads the study, once the name is known to be right.
        of: what the study is of, for messages.

    Raises:
        SettingsError: when there is no picture of that name.
    """
    from pa10cal.errors import SettingsError
    from pa10cal.settings import FigureSettings, read_settings_argument

    name = arguments.figure
    if name not in (*figures, *tables):
        raise SettingsError(
            f"no such figure or table of {of}",
            where="--figure",
            value=name,
            allowed=", ".join((*figures, *tables)),
            remedy="correct the name",
        )
    settings = read_settings_argument(FigureSettings, arguments.settings)
    study = read()
    # By name, so that a picture is drawn anew only when its own module changes.
    module = import_module(f"pa10cal.figures.{name}")
    if name in tables:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(study), study.footer, arguments.out_dir, name)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            figure = module.draw(study)
            write_figure(figure, study.footer, arguments.out_dir, name, settings.png_dpi)
    print(f"{of}: {name}")
