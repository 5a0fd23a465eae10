"""The pictures and tables of one results folder, drawn in one process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pa10cal.errors import RecordError, SettingsError
from pa10cal.figures.options import FigureOptions
from pa10cal.figures.registry import Entry, NothingToShowError, entries
from pa10cal.figures.sources import Source
from pa10cal.figures.style import looks, name_in_title, write_figure
from pa10cal.figures.table import write_table
from pa10cal.files.output import whole_file
from pa10cal.results.codec import write
from pa10cal.results.fleet import PicturesRecord

#: Folder of the files of a picture, by what it is.
_PLACES = {"figure": "figures", "table": "tables", "film": "figures"}


def draw_all(source: Source, out: Path, settings: FigureOptions) -> PicturesRecord:
    """Write every picture that has something to show, and remove older files of the others.

    Args:
        source: what they are drawn from.
        out: gets the folders `figures` and `tables`, and `pictures.json`, which says what was drawn
            and why the rest was not.
        settings: how they are written.

    Raises:
        RecordError, RawDataError: when a result that is there cannot be used.
    """
    made, omitted = [], {}
    for place in {_PLACES[entry.kind] for entry in entries(source.folder).values()}:
        (out / place).mkdir(parents=True, exist_ok=True)
    for entry in entries(source.folder).values():
        why = _unmet(entry, source)
        try:
            if why is None:
                _write(entry, source, out, settings)
                made.append(entry.name)
        except NothingToShowError as nothing:
            why = str(nothing)
        if why is not None:
            omitted[entry.name] = why
            for path in (out / _PLACES[entry.kind]).glob(f"{entry.name}.*"):
                path.unlink()
    campaign = source.name if source.folder == "campaign" else None
    record = PicturesRecord(campaign=campaign, drawn=tuple(made), omitted=omitted)
    write(record, out / "pictures.json")
    return record


def summary(record: PicturesRecord) -> list[str]:
    """Say in a few lines what was drawn."""
    return [f"{name}: omitted, {why}" for name, why in record.omitted.items()] + [
        f"{len(record.drawn)} drawn: {', '.join(record.drawn) or 'none'}"
    ]


def draw_one(name: str, source: Source, out: Path, settings: FigureOptions) -> None:
    """Write one picture; the arguments are those of `draw_all`.

    Raises:
        SettingsError: when there is no picture of that name.
        RecordError: when a result that it needs is missing, or holds nothing to show.
    """
    known = entries(source.folder)
    if name not in known:
        raise SettingsError(
            "no such figure or table",
            where="--figure",
            value=name,
            allowed=", ".join(known),
            remedy="correct the name",
        )
    try:
        _write(known[name], source, out, settings)
    except NothingToShowError as nothing:
        raise RecordError(
            f"nothing to show: {nothing}",
            where=name,
            allowed="results with the data of the picture",
            remedy="do not request this picture",
        ) from None


def _unmet(entry: Entry, source: Source) -> str | None:
    """Return why a need of a picture is not met."""
    return next((why for need in entry.picture.needs if (why := source.lacks(need))), None)


def _write(entry: Entry, source: Source, out: Path, settings: FigureOptions) -> None:
    place, module = out / _PLACES[entry.kind], entry.module
    if entry.kind == "table":
        table = module.tabulate(source.content)
        named = replace(table, title=f"{source.name}: {table.title}")
        write_table(named, source.footer, place, entry.name)
        return
    with looks():
        if entry.kind == "film":
            with whole_file(place / f"{entry.name}.{settings.film}") as path:
                module.film(source.content, path, settings.png_dpi)
        else:
            figure = module.draw(source.content)
            name_in_title(figure, source.name)
            write_figure(figure, source.footer, place, entry.name, settings.png_dpi)
