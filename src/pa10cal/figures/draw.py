"""The pictures and tables of one results folder, drawn in one process; parameters in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from pa10cal.campaign.description import read_description
from pa10cal.command_settings import FigureOptions, PictureOptions
from pa10cal.errors import RecordError, SettingsError
from pa10cal.figures.registry import ELSEWHERE, NEEDS, NothingToShowError, Picture, entries
from pa10cal.figures.style import name_in_title, new_figure, panel, theme, write_figure
from pa10cal.figures.table import write_table
from pa10cal.files.output import whole_file
from pa10cal.reports.formatting import display_name, first_sentences, shown_in
from pa10cal.reports.results_bundle import MODEL_NAMES, ResultsBundle, is_synthetic
from pa10cal.reports.theme import BLUE, GREY, VERMILLION
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.codec import write
from pa10cal.results.comparison import DriftRecord
from pa10cal.results.outcomes import Caption, PicturesRecord

#: Folder of the files of a picture, by what it is.
_PLACES = {"figure": "figures", "table": "tables", "film": "figures"}
#: Longer provenances are cut after a sentence.
_MOST_LETTERS = 400
#: Campaigns whose numbers stand below a panel, at most.
_MOST_NUMBERS = 8
#: Panels side by side; their width and height, and what is between them across and down [mm].
_COLUMNS, _WIDE_MM, _HIGH_MM, _LABELS_MM, _APART_MM = 4, 26.0, 20.0, 14.0, 12.0


@dataclass(frozen=True)
class Source:
    """What the pictures of a results folder are drawn from."""

    folder: str  # which pictures, of `registry.FOLDERS`
    name: str  # what messages call it, and every title begins with
    footer: str  # stands below every picture: where its data come from
    content: Any  # what each module of that folder draws


def read_source(
    folder: Path, campaign_dir: Path | None, settings: PictureOptions, *, force: bool = False
) -> Source:
    """Return what the pictures of a results folder are drawn from.

    Args:
        folder: results of a campaign, of blind trials, of a curve, or of chains along curves.
        campaign_dir: raw files of the campaign; None where it is none.
        settings: what pictures read of the settings.
        force: whether a campaign's calibrations are drawn whatever their grade.

    Raises:
        SettingsError: when it is not known what the results are of.
        RecordError, RawDataError: when they cannot be used.
    """
    if campaign_dir is not None:
        description = read_description(campaign_dir)
        return of_campaign(
            ResultsBundle(folder, description=description, settings=settings, force=force)
        )
    for kind, name in ELSEWHERE.items():
        module = import_module(name)
        if (folder / module.FROM).exists():
            return Source(kind, folder.name, *module.read_content(folder))
    raise SettingsError(
        "results of nothing that pictures are drawn of",
        where="--results",
        value=str(folder),
        allowed="a folder with scores.json, curve.json or calibration.json, or one of a campaign",
        remedy="correct the folder; for a campaign give --campaign-dir as well",
    )


def of_campaign(results: ResultsBundle) -> Source:
    """Return the source of a campaign's pictures, with a description.

    Every picture says where the data come from, in the campaign's words, the first of many. One of
    a calibration that is drawn because of `force` alone is marked by its grade.
    """
    assert results.description is not None
    name, text = results.description.name, results.description.provenance.strip()
    words = [f"Campaign {name}."]
    if results.force and (results.folder / "calibration/combined.json").exists():
        grade = results.sound_calibration().health.grade
        words += [] if grade in UNRESERVED else [f"Grade of the calibration: {grade}."]
    words += ["Synthetic data."] if is_synthetic(text) else []
    first = text if len(text) <= _MOST_LETTERS else first_sentences(text, _MOST_LETTERS)
    words.append(f"Provenance: {first.removesuffix('.')}.")
    words += [] if first == text else ["More in its campaign.yaml."]
    return Source("campaign", name, " ".join(words), results)


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
    omitted, captions = {}, {}
    kind = " Synthetic data." if "Synthetic data." in source.footer else ""
    every = entries(source.folder).values()
    for place in {_PLACES[entry.kind] for entry in every}:
        (out / place).mkdir(parents=True, exist_ok=True)
    for entry in every:
        why = None
        if isinstance(source.content, ResultsBundle):
            missing = (_why_not(source.content, need) for need in entry.needs)
            why = next(filter(None, missing), None)
        try:
            if why is None:
                _write(entry, source, out, settings)
                text = entry.caption.replace("{name}", source.name) + kind
                captions[entry.name] = Caption(title=entry.title, text=text, section=entry.section)
        except NothingToShowError as nothing:
            why = str(nothing)
        if why is not None:
            omitted[entry.name] = why
            for path in (out / _PLACES[entry.kind]).glob(f"{entry.name}.*"):
                path.unlink()
    campaign = source.name if source.folder == "campaign" else None
    record = PicturesRecord(
        campaign=campaign, drawn=tuple(captions), omitted=omitted, captions=captions
    )
    write(record, out / "pictures.json")
    return record


def _why_not(results: ResultsBundle, need: str) -> str | None:
    """Say why a need of a picture is not met, None where it is."""
    verdict, files = results.verdict, [NEEDS[need][0]]
    if need == "planes":
        files += results.plane_files
    if need == "analysis" and verdict is not None and verdict.verdict == "not_sought":
        return f"effects were not sought: {verdict.why}"
    for file in files:
        if not (results.folder / file).exists():
            return f"there is no {file}"
    if need == "planes" and not results.planes_of_settings():
        why = {plane.why for plane in results.planes_not_studied}
        return f"no plane was studied: {'; '.join(sorted(why))}"
    general_beside = (results.folder / "calibration/general.json").exists()
    if need == "papers_calibration" or (need == "general" and not general_beside):
        model = results.sound_calibration().model
        needed = "general" if need == "general" else "paper"
        return None if model == needed else f"calibrated with the {MODEL_NAMES[model]}"
    if need == "held_out" and not results.sound_held_out().models:
        return "no configuration was held out"
    return None


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


def _write(entry: Picture, source: Source, out: Path, settings: FigureOptions) -> None:
    place = out / _PLACES[entry.kind]
    if entry.kind == "table":
        table = entry.make(source.content)
        titled = replace(table, title=f"{source.name}: {table.title}")
        write_table(titled, source.footer, place, entry.name)
        return
    with theme():
        if entry.kind == "film":
            with whole_file(place / f"{entry.name}.{settings.film}") as path:
                entry.make(source.content, path, settings.png_dpi)
        else:
            figure = entry.make(source.content)
            name_in_title(figure, source.name)
            write_figure(figure, source.footer, place, entry.name, settings.png_dpi)


def write_drift(record: DriftRecord, folder: Path, name: str, png_dpi: int) -> None:
    """Draw every parameter less its value in the first campaign, as SVG, PDF and PNG.

    Args:
        record: the parameters, and what moved from campaign to campaign.
        folder: to write to.
        name: of the files.
        png_dpi: resolution of the PNG [dots per inch].
    """
    rows, count = record.parameters, len(record.campaigns)
    keys = list(dict.fromkeys(zip(rows.term, rows.of, rows.parameter, strict=True)))
    moved = {thing.of for step in record.steps for thing in step.what_moved.moved}
    height_mm = 26.0 - (-len(keys) // _COLUMNS) * (_HIGH_MM + _APART_MM)
    with theme():
        title = f"{record.robot}: parameters over {count} campaigns, less the first"
        figure = new_figure(height_mm, title)
        last = 0 if count <= _MOST_NUMBERS else count - 1  # of more, the last is named alone
        numbers = [str(k + 1) if k >= last else "" for k in range(count)]
        for k, (term, of, parameter) in enumerate(keys):
            line, column = divmod(k, _COLUMNS)
            x_mm = 16.0 + column * (_WIDE_MM + _LABELS_MM)
            y_mm = height_mm - 4.0 - (line + 1) * (_HIGH_MM + _APART_MM)
            axes = panel(figure, x_mm, y_mm, _WIDE_MM, _HIGH_MM)
            at = (rows.term == term) & (rows.of == of) & (rows.parameter == parameter)
            unit, scale = shown_in(str(rows.unit[at][0]))
            joint = f"joint {parameter.rpartition('_')[2]}"
            of_joint = joint in moved and parameter.startswith(("delta_theta", "K_lin"))
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            axes.errorbar(
                [record.campaigns.index(campaign) for campaign in rows.campaign[at]],
                scale * (rows.value[at] - rows.value[at][0]),
                scale * (rows.high[at] - rows.value[at]),
                color=VERMILLION if parameter in moved or of_joint else BLUE,
                marker="o",
                markersize=2.5,
                linewidth=0.8,
                capsize=1.5,
            )
            axes.set(title=f"{display_name(parameter)} [{unit}]", xlim=(-0.4, count - 0.6))
            axes.set_xticks(np.arange(count), numbers)
            axes.yaxis.set_major_locator(MaxNLocator(3))
        names = ", ".join(f"{k + 1} {campaign}" for k, campaign in enumerate(record.campaigns))
        footer = f"Bars: 95 % intervals. Campaigns from left to right: {names}. {record.line}"
        write_figure(figure, footer, folder, name, png_dpi)
