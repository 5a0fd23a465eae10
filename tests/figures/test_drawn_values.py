"""What the paper's pictures show is what the records say."""

from functools import partial

import numpy as np
import pytest
from matplotlib.text import Text

from made_up_results import elsewhere
from pa10cal.figures.campaign import paper_figures
from pa10cal.figures.campaign.paper_against_ours import tabulate_paper_against_ours
from pa10cal.figures.campaign.paper_figures import PLACE_MM, places
from pa10cal.figures.registry import NothingToShowError

pytestmark = pytest.mark.usefixtures("project_looks")


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


@pytest.fixture
def changed(results, changed_from):
    """Copy the results with changes to the JSON of one of them."""
    return partial(changed_from, results)


def test_the_path_is_that_of_the_arm_in_its_own_frame(results):
    figure = paper_figures.draw_fig4_test_path(results)
    space = figure.axes[0]
    grid, held_out, line_x, line_y = (np.array(line.get_data_3d()) for line in space.lines[:4])
    assert (grid.shape, held_out.shape) == ((3, 27), (3, 10))
    T = results.base_frame.T_instr_base
    poses = places(results)
    first = poses[poses["kind"] == "grid"][list(PLACE_MM)].to_numpy()[0]
    np.testing.assert_allclose(1e3 * T[:3, 3] + T[:3, :3] @ grid[:, 0], first, atol=1e-9)
    # The straight moves run along the axes of the frame that they give, to what the arm errs by.
    assert np.ptp(line_x[0]) > 50 * np.ptp(line_x[1:], axis=1).max()
    assert np.ptp(line_y[1]) > 50 * np.ptp(line_y[[0, 2]], axis=1).max()


def test_before_and_after_are_written_as_recorded(results):
    texts = texts_of(paper_figures.draw_fig5_before_after(results))
    together = results.paper_calibration()
    for load, case in results.load_cases().items():
        before, after = case.errors[load].before, case.errors[load].after
        assert f"{before.mean_mm:.2f} / {before.peak_mm:.2f}" in texts
        for errors in (after, together.errors[load].after):
            assert f"{errors.mean_mm:.3f} / {errors.peak_mm:.3f}" in texts
    assert {"0.58 / 1.22", "1.80 / 2.45", "0.33 / 0.71", "0.014"} <= set(texts)


def test_an_attitude_that_was_not_seen_has_no_panel_and_no_values(changed):
    def without_attitude(record):
        for errors in record["errors"].values():
            for found in errors.values():
                found["orientation_deg"] = None

    def unseen(record):
        for model in record["models"].values():
            model.update(orientation_deg=None, tool_twist=None)
            for row in model["rows"]:
                row["rotation_deg"] = None

    source = changed("calibration/*.json", without_attitude)
    figure = paper_figures.draw_fig5_before_after(source)
    assert [axes.get_ylabel() for axes in figure.axes] == ["position error [mm]"]
    assert figure.axes[0].get_xlabel() == "external load"
    held_out = changed("evaluation/holdout.json", unseen)
    texts = texts_of(paper_figures.draw_fig6_holdout(held_out))
    assert not any("orientation" in text and "paper" not in text for text in texts)
    for of, quantity in (
        (source, "mean orientation error before calibration"),
        (held_out, "mean orientation error, held out"),
    ):
        rows = tabulate_paper_against_ours(of).data.set_index("quantity").loc[quantity]
        assert set(rows["ours"]) == {"not measured"}


def test_the_papers_figures_stand_beside_its_own_arm_only(results):
    def legend_of(figure):
        return {text.get_text() for legend in figure.legends for text in legend.get_texts()}

    other = elsewhere(results, robot="other")
    for make in (paper_figures.draw_fig5_before_after, paper_figures.draw_montecarlo_planes):
        more = legend_of(make(results)) - legend_of(make(other))
        assert more
        assert all("paper" in text for text in more)
    assert not any("paper:" in text for text in texts_of(paper_figures.draw_fig6_holdout(other)))


def test_held_out_errors_are_drawn_load_by_load(results):
    axes = paper_figures.draw_fig6_holdout(results).axes[0]
    for line, name in zip(axes.lines, ("uncalibrated", "linear", "cubic"), strict=False):
        model = results.held_out.models[name]
        assert name in line.get_label()
        drawn = line.get_ydata()
        assert len(drawn) == 40
        assert drawn.mean() == pytest.approx(model.mean_mm)
        at_90_N = model.rows.position_mm[model.rows.load_N == 90]
        assert sorted(drawn[30:]) == pytest.approx(sorted(np.linalg.norm(at_90_N, axis=1)))


def test_what_is_extrapolated_is_hollow(changed):
    def beyond(record):
        for k, row in enumerate(record["models"]["cubic"]["rows"]):
            row["extrapolated"] = k < 3

    figure = paper_figures.draw_fig6_holdout(changed("evaluation/holdout.json", beyond))
    (hollow,) = (line for line in figure.axes[0].lines if line.get_label() == "extrapolated")
    assert len(hollow.get_ydata()) == 3
    assert hollow.get_markerfacecolor() == "white"


def test_a_campaign_without_held_out_points_has_nothing_to_show(changed):
    empty = changed("evaluation/holdout.json", lambda r: r.update(models={}, configurations=0))
    with pytest.raises(NothingToShowError, match=r"^no held-out configuration was"):
        paper_figures.draw_fig6_holdout(empty)


def held_rigid(record):
    for name in [name for name in record["parameters"] if name.startswith("K_")]:
        del record["parameters"][name]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("file", "change", "said", "not_said"),
    [
        ("calibration/combined.json", held_rigid, "calibrated with all loads", "springs"),
        (
            "evaluation/holdout.json",
            lambda r: r.update(calibration="22N"),
            "22N alone",
            "all loads",
        ),
        ("seed/base_frame.json", lambda record: None, "with all loads together", "alone"),
    ],
)
def test_says_which_models_were_calibrated_with_what(changed, file, change, said, not_said):
    texts = texts_of(paper_figures.draw_fig6_holdout(changed(file, change)))
    assert any(said in text for text in texts)
    assert not any(not_said in text for text in texts)
