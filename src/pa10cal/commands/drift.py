"""Command `drift`."""

from __future__ import annotations

from pathlib import Path


def drift(models: tuple[Path, ...], *, out: Path, figures: Path | None = None) -> None:
    """Show how the parameters of one arm went over campaigns, and what moved between them.

    Args:
        models: model.yaml of every campaign, or the results that hold it, in order of time.
        out: every parameter with its interval, and what moved from each campaign to the next, to
            write (.json).
        figures: folder for a figure of the same name.

    Examples:
        pa10cal drift results/june results/july results/august --out drift.json --figures figures
    """
    from pa10cal.evaluation.two_models import drift as over_campaigns
    from pa10cal.fit.model_file import load_model
    from pa10cal.results.codec import write

    found = [load_model(path) for path in models]
    names = [
        model.fitted_to.campaign if model.fitted_to else str(path)
        for path, model in zip(models, found, strict=True)
    ]
    if len(set(names)) < len(names):
        names = [str(path) for path in models]
    record = over_campaigns(found, names)
    write(record, out)
    if figures is not None:
        from pa10cal.figures.options import FigureOptions
        from pa10cal.figures.over_campaigns import write_drift

        write_drift(record, figures, out.stem, FigureOptions().png_dpi)
    for step in record.steps:
        print(f"{step.first} to {step.second}: {step.what_moved.line}")
