"""How often a verdict on a blind trial is wrong, beside what is allowed."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.rates import draw_rates
from pa10cal.figures.registry import Picture
from pa10cal.figures.style import BLACK, name_rows, new_figure, panel, write_text_at
from pa10cal.results.trials import Rate, TrialScoresRecord

PICTURE = Picture(
    title="How often a verdict is wrong",
    needs=(),
    caption="""
Rate of wrong verdicts in blind trials, with exact intervals ({name}): names where nothing was
hidden, also where the campaign misstates the uncertainty of its instrument or the mass of a
link; names beyond the hidden effects; confident names for effects outside the vocabulary. The
dash is the largest rate allowed. *Unexplained* where nothing was hidden is no wrong name, but a
false alarm nevertheless. A few trials leave wide intervals; the full study has its own target.
""",
)

#: Shares allowed, as the bars have them.
_NULL, _EXTRA, _OUTSIDE = 0.02, 0.05, 0.05
_ROW_MM = 6.0


def draw(scores: TrialScoresRecord) -> Figure:
    """Draw the share of wrong verdicts of every kind of trial with its interval."""
    rows = _rows(scores)
    height = _ROW_MM * len(rows)
    figure = new_figure(height + 36.0, "How often a verdict on a blind trial is wrong")
    axes = panel(figure, 84.0, 24.0, 60.0, height)
    _draw_rates(axes, rows)
    write_text_at(
        figure,
        2.0,
        6.0,
        "Bars: 95 % intervals (Clopper and Pearson). Upright dash: at most this is allowed.",
    )
    return figure


def _rows(scores: TrialScoresRecord) -> list[tuple[str, Rate, float | None]]:
    hidden = scores.nothing_hidden
    rows: list[tuple[str, Rate, float | None]] = [
        ("nothing hidden: a name", hidden["null"].named, _NULL),
        ("nothing hidden: “unexplained”", hidden["null"].unexplained, None),
        ("wrong noise figure: a name", hidden["wrong_noise"].named, _NULL),
        ("wrong noise figure: “unexplained”", hidden["wrong_noise"].unexplained, None),
        ("wrong link mass: a name", hidden["wrong_mass"].named, _NULL),
        ("wrong link mass: “unexplained”", hidden["wrong_mass"].unexplained, None),
        ("one effect: something else named (too)", scores.single.wrong, None),
        ("two effects: something extra", _not(scores.several["pair"].nothing_extra), _EXTRA),
        ("three effects: something extra", _not(scores.several["triple"].nothing_extra), _EXTRA),
        ("no name for it: a confident wrong name", scores.outside.confidently_wrong, _OUTSIDE),
        ("no name for it: nothing found", scores.outside.silent, None),
    ]
    return [row for row in rows if row[1].of]


def _not(found: Rate) -> Rate:
    """Return the rate of the opposite."""
    share = None if found.share is None else 1.0 - found.share
    return Rate(
        count=found.of - found.count,
        of=found.of,
        low=1.0 - found.high,
        high=1.0 - found.low,
        share=share,
    )


def _draw_rates(axes: Axes, rows: list[tuple[str, Rate, float | None]]) -> None:
    draw_rates(axes, [found for _, found, _ in rows])
    for y, (_, _, allowed) in enumerate(rows):
        if allowed is not None:
            axes.plot(
                100.0 * allowed, y, color=BLACK, marker="|", markersize=10.0, linestyle="none"
            )
    highest = max(5.0, *(100.0 * found.high for _, found, _ in rows))
    axes.set_xlim(-0.02 * highest, 1.02 * highest)
    name_rows(axes, [name for name, _, _ in rows])
    axes.set_xlabel("share of trials [%]")
