"""Files appear whole or not at all, and look the same whatever the user has set."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from pa10cal.figures.style import (
    WIDTH_MM,
    draw_points,
    evenly,
    name_in_title,
    new_figure,
    panel,
    plain_log,
    theme,
    write_figure,
)


def simple(text="a line"):
    figure = new_figure(60.0, text)
    panel(figure, 20.0, 20.0, 100.0, 30.0).plot([1, 2, 3])
    return figure


def size_of(png):
    """Return width and height of a picture in pixels."""
    return np.frombuffer(png.read_bytes()[16:24], ">u4").astype(int)


def test_writes_svg_pdf_and_png_without_a_date(tmp_path, project_looks):
    write_figure(simple(), "footer", tmp_path, "line", 100)
    assert {path.name for path in tmp_path.iterdir()} == {"line.svg", "line.pdf", "line.png"}
    assert b"<dc:date>" not in (tmp_path / "line.svg").read_bytes()
    assert b"CreationDate" not in (tmp_path / "line.pdf").read_bytes()
    assert size_of(tmp_path / "line.png")[0] == round(100 * WIDTH_MM / 25.4 - 0.5)


def test_long_titles_grow_upward_and_long_footers_downward(tmp_path, project_looks):
    words = [f"word{k:02d}" for k in range(40)]
    for name, title, footer, more in (
        ("mine", "a line", "footer", 0),
        ("of-a-rather-long-name-" + "x" * 20, " ".join(words[:12]), "footer", 1),
        ("mine", "a line", " ".join(words), 2),
    ):
        figure = simple(title)
        name_in_title(figure, name)
        write_figure(figure, footer, tmp_path, str(more), 100)
        assert "".join(figure.get_suptitle().splitlines()[0]).startswith(name)
        lines = [text.get_text() for text in figure.texts if text.get_text() in footer]
        assert " ".join(lines) == footer
        assert len(lines) - 1 + figure.get_suptitle().count("\n") == more
        width, height = size_of(tmp_path / f"{more}.png") - size_of(tmp_path / "0.png")
        assert abs(width) <= 1
        assert height == pytest.approx(more * 3.5 * 100 / 25.4, abs=1.5)


def test_settings_of_the_user_change_nothing(tmp_path):
    for k, size in enumerate((10.0, 33.0)):
        with mpl.rc_context({"font.size": size, "lines.linewidth": size, "axes.facecolor": "red"}):
            with theme():
                write_figure(simple(), "footer", tmp_path / str(k), "line", 80)
            assert mpl.rcParams["font.size"] == size
    for ending in ("svg", "pdf", "png"):
        first, second = ((tmp_path / str(k) / f"line.{ending}").read_bytes() for k in (0, 1))
        assert first == second


def test_nothing_is_left_when_one_format_fails(tmp_path, project_looks, monkeypatch):
    write = Figure.savefig

    def fail_at_pdf(figure, path, **options):
        write(figure, path, **options)
        if options["format"] == "pdf":
            raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", fail_at_pdf)
    with pytest.raises(OSError, match="disk full"):
        write_figure(simple(), "footer", tmp_path, "line", 80)
    assert not list(tmp_path.iterdir())


def test_panels_are_placed_in_millimetres(project_looks):
    axes = panel(new_figure(100.0, ""), 17.0, 10.0, 34.0, 50.0)
    np.testing.assert_allclose(axes.get_position().bounds, (0.1, 0.1, 0.2, 0.5))


@pytest.mark.parametrize(("low", "high"), [(0.21, 0.9), (0.001, 4.0), (3.0, 9.0)])
def test_a_logarithmic_axis_always_has_plain_numbers(low, high, project_looks):
    axes = panel(new_figure(60.0, ""), 20.0, 20.0, 100.0, 30.0)
    plain_log(axes, "y", low, high)
    figure = axes.get_figure()
    figure.draw_without_rendering()
    inside = [t for t in axes.get_yticklabels() if low <= t.get_position()[1] <= high]
    assert inside
    assert all(float(t.get_text()) == pytest.approx(t.get_position()[1]) for t in inside)


@pytest.mark.parametrize(("count", "image"), [(300, False), (301, True)])
def test_many_points_are_drawn_as_an_image(count, image, project_looks):
    axes = panel(new_figure(60.0, ""), 20.0, 20.0, 100.0, 30.0)
    draw_points(axes, np.arange(count), np.zeros(count), marker=".", color="k")
    (line,) = axes.lines
    assert bool(line.get_rasterized()) is image
    assert line.get_linestyle() == "None"


@pytest.mark.parametrize("count", [1, 9, 10, 11, 5000])
def test_rows_are_spread_evenly_and_no_more_than_asked_for(count):
    rows = evenly(count, 10)
    assert len(rows) == min(count, 10)
    assert (rows[0], rows[-1]) == (0, count - 1)
    assert np.ptp(np.diff(rows)) <= 1 if count > 1 else True
