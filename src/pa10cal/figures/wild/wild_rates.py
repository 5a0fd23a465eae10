"""How often the pipeline fails on wild trials, beside what is allowed."""

from __future__ import annotations

from textwrap import fill

from matplotlib.figure import Figure

from pa10cal.figures.rates import draw_rates
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import BLACK, name_rows, new_figure, panel, write_text_at
from pa10cal.results.trials import Rate, WildScoresRecord

PICTURE = Picture(
    title="How often campaigns with stressors and faults go wrong",
    needs=(),
    caption="""
Rates of wild trials with exact intervals ({name}): simulated campaigns of several arms and
instruments, with stressors of ordinary logs or faults in their raw files, without stated masses, or
with rows that are sorted. Every command runs on
these files alone; what was put in is compared afterwards. The dash is the largest rate allowed, for
faults told and effects listed the least required. A fault counts where it is above three times the
noise. Synthetic data.
""",
)

_ROW_MM = 9.0
#: Names of the bars of stressors and faults short enough to stand beside them, in their order;
#: those of other kinds stand as they are, in lines of so many characters.
_WIDTH = 30
_NAMES = (
    "crash, or discovery\nwithheld",
    "no fault: a false name",
    "fault in the log:\na confident false name",
    "outside the vocabulary:\na confident false name",
    "fault above the noise: told",
    "something wrong: “none”",
    "held out worse",
    "one effect among stressors:\nlisted",
    "of these, above the\ndetection limit: listed",
    "right data called suspect",
    "an effect, no fault:\ncalled suspect",
)


def draw(scores: WildScoresRecord) -> Figure:
    """Draw the shares with their intervals."""
    shares = [bar for bar in scores.bars if bar.share]
    names = _NAMES if len(shares) == len(_NAMES) else [fill(bar.what, _WIDTH) for bar in shares]
    rows = [(name, bar) for name, bar in zip(names, shares, strict=True) if bar.trials]
    if not rows:
        raise NothingToShowError("no trial counts")
    height = _ROW_MM * len(rows)
    figure = new_figure(height + 36.0, "How often campaigns with stressors and faults go wrong")
    axes = panel(figure, 62.0, 24.0, 82.0, height)
    rates = [
        Rate(
            count=round((bar.reached or 0.0) * bar.trials),
            of=bar.trials,
            low=bar.low or 0.0,
            high=bar.high if bar.high is not None else 1.0,
            share=bar.reached,
        )
        for _, bar in rows
    ]
    draw_rates(axes, rates)
    for y, (_, bar) in enumerate(rows):
        axes.plot(100.0 * bar.limit, y, color=BLACK, marker="|", markersize=10.0, linestyle="none")
    axes.set_xlim(-2.0, 102.0)
    name_rows(axes, [name for name, _ in rows])
    axes.set_xlabel("share of trials [%]")
    write_text_at(
        figure,
        2.0,
        6.0,
        "Bars: 95 % intervals (Clopper and Pearson). Upright dash: what is allowed, or required.",
    )
    return figure
