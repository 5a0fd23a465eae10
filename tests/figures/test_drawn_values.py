"""What pictures show is what the records say."""

import json
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from matplotlib.quiver import Quiver, QuiverKey
from matplotlib.text import Text

from pa10cal.figures.campaign import errors as errors_pictures
from pa10cal.figures.campaign import health as health_pictures
from pa10cal.figures.campaign import montecarlo, paper_against_ours, paper_figures
from pa10cal.figures.campaign import parameters as parameters_pictures
from pa10cal.figures.campaign import residuals as residuals_pictures
from pa10cal.figures.registry import NothingToShowError
from pa10cal.figures.results import PLACE_MM
from pa10cal.results.calibration import LCurvePoint

pytestmark = pytest.mark.usefixtures("project_looks")


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


def legend_of(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.fixture
def changed(results, changed_from):
    """Copy the results with changes to the JSON of one of them."""
    return partial(changed_from, results)


def test_the_path_is_that_of_the_arm_in_its_own_frame(results):
    figure = paper_figures.draw_fig4_test_path(results)
    space = figure.axes[0]
    grid, held_out, line_x, line_y = (np.array(line.get_data_3d()) for line in space.lines[:4])
    assert grid.shape == (3, 27)
    assert held_out.shape == (3, 10)
    T = results.base_frame()
    poses = results.poses()
    first = poses[poses["kind"] == "grid"][list(PLACE_MM)].to_numpy()[0]
    np.testing.assert_allclose(1e3 * T[:3, 3] + T[:3, :3] @ grid[:, 0], first, atol=1e-9)
    # The straight moves run along the axes of the frame that they give, to what the arm errs by.
    assert np.ptp(line_x[0]) > 50 * np.ptp(line_x[1:], axis=1).max()
    assert np.ptp(line_y[1]) > 50 * np.ptp(line_y[[0, 2]], axis=1).max()


def test_before_and_after_are_written_as_recorded(results):
    texts = texts_of(paper_figures.draw_fig5_before_after(results))
    alone, together = results.load_cases(), results.calibration()
    for load, case in alone.items():
        before, after = case.errors[load].before, case.errors[load].after
        assert f"{before.mean_mm:.2f} / {before.peak_mm:.2f}" in texts
        assert f"{after.mean_mm:.3f} / {after.peak_mm:.3f}" in texts
        errors = together.errors[load].after
        assert f"{errors.mean_mm:.3f} / {errors.peak_mm:.3f}" in texts
    assert {"0.58 / 1.22", "1.80 / 2.45", "0.33 / 0.71", "0.014"} <= set(texts)


def without_attitude(record):
    for errors in record["errors"].values():
        for found in errors.values():
            found["orientation_deg"] = None


def test_an_attitude_that_was_not_seen_has_no_panel(results, tmp_path):
    folder = tmp_path / "positions"
    shutil.copytree(results.folder, folder)
    for path in (folder / "calibration").glob("*.json"):
        record = json.loads(path.read_text("utf-8"))
        without_attitude(record)
        path.write_text(json.dumps(record), encoding="utf-8")
    source = replace(results, folder=folder)
    figure = paper_figures.draw_fig5_before_after(source)
    assert [axes.get_ylabel() for axes in figure.axes] == ["position error [mm]"]
    assert figure.axes[0].get_xlabel() == "external load"
    rows = paper_against_ours.tabulate_paper_against_ours(source).data.to_numpy()
    said = {row[5] for row in rows if row[0].startswith("mean orientation error before")}
    assert said == {"not measured"}


def test_held_out_errors_without_attitude(changed):
    def unseen(record):
        for model in record["models"].values():
            model.update(orientation_deg=None, tool_twist=None)
            for row in model["rows"]:
                row["rotation_deg"] = None

    source = changed("evaluation/holdout.json", unseen)
    texts = texts_of(errors_pictures.draw_fig6_holdout(source))
    assert not any("orientation" in text and "paper" not in text for text in texts)
    rows = paper_against_ours.tabulate_paper_against_ours(source).data.to_numpy()
    held_out = [row for row in rows if row[0] == "mean orientation error, held out"]
    assert {(row[5], row[7]) for row in held_out} == {("not measured", "")}


def test_the_papers_figures_stand_beside_its_own_arm_only(results):
    other = replace(results, robot="other")
    for make in (
        paper_figures.draw_fig5_before_after,
        montecarlo.draw_montecarlo_planes,
        parameters_pictures.draw_parameter_uncertainty,
    ):
        ours = legend_of(make(other))
        with_paper = legend_of(make(results))
        assert set(ours) < set(with_paper)
        assert all("paper" in text for text in set(with_paper) - set(ours))
    assert not any("paper:" in text for text in texts_of(errors_pictures.draw_fig6_holdout(other)))


def test_held_out_errors_are_drawn_load_by_load(results):
    axes = errors_pictures.draw_fig6_holdout(results).axes[0]
    models = results.held_out().models
    for line, (name, model) in zip(axes.lines, models.items(), strict=False):
        assert name.split("_")[0] in line.get_label()
        drawn = line.get_ydata()
        assert len(drawn) == 40
        assert drawn.mean() == pytest.approx(model.mean_mm)
        at_90_N = model.rows.position_mm[model.rows.load_N == 90]
        assert sorted(drawn[30:]) == pytest.approx(sorted(np.linalg.norm(at_90_N, axis=1)))


def test_what_is_extrapolated_is_hollow(changed):
    def beyond(record):
        for k, row in enumerate(record["models"]["cubic"]["rows"]):
            row["extrapolated"] = k < 3

    figure = errors_pictures.draw_fig6_holdout(changed("evaluation/holdout.json", beyond))
    (hollow,) = (line for line in figure.axes[0].lines if line.get_label() == "extrapolated")
    assert len(hollow.get_ydata()) == 3
    assert hollow.get_markerfacecolor() == "white"


def test_a_campaign_without_held_out_points_has_nothing_to_show(changed):
    def empty(record):
        record.update(models={}, configurations=0)

    with pytest.raises(NothingToShowError, match=r"^no held-out configuration was"):
        errors_pictures.draw_fig6_holdout(changed("evaluation/holdout.json", empty))


def test_arrows_run_from_the_predicted_to_the_measured_place(results):
    figure = residuals_pictures.draw_residual_vectors(results)
    arrows = [artist for axes in figure.axes for artist in axes.findobj(Quiver)]
    assert len(arrows) == 6
    residuals = results.calibration().residuals
    unloaded = residuals.load_N == 0
    from_above = arrows[0]
    np.testing.assert_allclose(from_above.X, residuals.place_mm[unloaded, 0])
    scale = -from_above.U / residuals.position_mm[unloaded, 0]
    np.testing.assert_allclose(scale, scale[0])
    (key,) = figure.findobj(QuiverKey)
    assert f"enlarged {scale[0]:g} times" in key.text.get_text()
    assert key.text.get_text().startswith(f"this arrow: {key.U / scale[0]:g} mm")


def test_open_and_bound_parameters_are_named(changed):
    def bound(record):
        record["parameters"]["K_cub_3"]["at_bound"] = True

    texts = texts_of(
        parameters_pictures.draw_parameter_uncertainty(changed("calibration/combined.json", bound))
    )
    assert texts.count("not identifiable: set by the tolerance") == 2
    assert "joint 3\nat bound" in texts
    assert "joint 5" in texts


def held_rigid(record):
    for name in [name for name in record["parameters"] if name.startswith("K_")]:
        del record["parameters"][name]
        record["inner_dependence"]["std"].pop(name)


def test_an_arm_without_springs_is_drawn(changed):
    figure = parameters_pictures.draw_parameter_uncertainty(
        changed("calibration/combined.json", held_rigid)
    )
    assert texts_of(figure).count("all joints held rigid") == 2


def test_an_arm_without_springs_has_one_calibrated_model(changed):
    texts = texts_of(
        errors_pictures.draw_fig6_holdout(changed("calibration/combined.json", held_rigid))
    )
    assert "calibrated" in texts
    assert not any("springs" in text for text in texts)


def test_the_spread_of_a_stiffness_ends_at_zero(changed):
    def wide(record):
        record["inner_dependence"]["std"]["K_lin_2"] = 1e9

    axes = parameters_pictures.draw_parameter_uncertainty(
        changed("calibration/combined.json", wide)
    ).axes[2]
    assert axes.get_title(loc="left") == "linear stiffness"
    starts = [min(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) == 2]
    assert min(starts) == 0.0


def test_says_when_the_intervals_do_not_cover_what_the_model_lacks(results, changed):
    assert not any(
        "incomplete" in text
        for text in texts_of(parameters_pictures.draw_parameter_uncertainty(results))
    )

    def worse(record):
        for errors in record["errors"].values():
            errors["after"]["mean_mm"] = 1.0

    texts = texts_of(
        parameters_pictures.draw_parameter_uncertainty(changed("calibration/combined.json", worse))
    )
    assert any("the model is incomplete" in text for text in texts)


def test_says_which_calibration_was_evaluated(results, changed):
    assert any(
        "with all loads together" in text
        for text in texts_of(errors_pictures.draw_fig6_holdout(results))
    )
    other = changed("evaluation/holdout.json", lambda record: record.update(calibration="22N"))
    assert any(
        "with 22N alone" in text for text in texts_of(errors_pictures.draw_fig6_holdout(other))
    )


def points(weights, values):
    return tuple(
        LCurvePoint(weight=weight, misfit=value, departure=1 / value, mean_mm=2 * value)
        for weight, value in zip(weights, values, strict=True)
    )


def test_both_readings_of_epsilon_are_marked_where_the_curve_reaches(changed):
    def curve(last):
        def put(record):
            record["l_curve"] = [p.model_dump() for p in points([1e-6, 1.6e-4, last], [1, 2, 4])]

        return put

    short = legend_of(
        health_pictures.draw_l_curve(changed("calibration/combined.json", curve(1e-2)))
    )
    assert any("weight 0.00016: remaining error 4.000 mm" in text for text in short)
    assert any("weight 0.013: beyond the weights tried" in text for text in short)


def test_the_second_reading_is_marked_on_a_curve_that_reaches_it(changed):
    def put(record):
        weights = [1e-6, 1.6e-4, 1.6e-4**0.5, 1e-1]
        record["l_curve"] = [p.model_dump() for p in points(weights, [1, 2, 3, 4])]

    long = legend_of(health_pictures.draw_l_curve(changed("calibration/combined.json", put)))
    assert any("weight 0.013: remaining error 6.000 mm" in text for text in long)


def test_says_how_the_terms_act_in_the_calibration_itself(results, changed):
    assert any(
        "poses do not identify" in text for text in texts_of(health_pictures.draw_l_curve(results))
    )

    def as_printed(record):
        record["settings"].update(tolerance_terms="all", epsilon_acts_on="cost")

    texts = texts_of(health_pictures.draw_l_curve(changed("calibration/combined.json", as_printed)))
    assert any("act on every departure, with ε on the cost" in text for text in texts)


def test_the_map_shows_every_point_and_nothing_elsewhere(results):
    plane = results.planes()[0]
    image = montecarlo.draw_montecarlo_map(results).axes[0].images[0]
    shown = image.get_array()
    assert shown.count() == len(plane.map.rows)
    left, right, bottom, top = image.get_extent()
    for x_mm, y_mm, mean_mm in plane.map.rows:
        column = int((x_mm - left) / (right - left) * shown.shape[1])
        row = int((y_mm - bottom) / (top - bottom) * shown.shape[0])
        assert shown[row, column] == mean_mm


def test_a_plane_without_a_grid_point_in_reach_says_so(results, changed):
    def empty(record):
        record["map"]["rows"] = []

    part = changed("montecarlo/z500.json", empty)
    assert texts_of(montecarlo.draw_montecarlo_map(part)).count("no grid point in reach") == 1
    settings = part.settings.model_copy(
        update={"montecarlo": part.settings.montecarlo.model_copy(update={"planes_mm": (500,)})}
    )
    alone = montecarlo.draw_montecarlo_map(replace(part, settings=settings))
    assert "no grid point in reach" in texts_of(alone)


def test_convergence_ends_where_the_record_does(results):
    running = montecarlo.draw_montecarlo_convergence(results).axes[0]
    for line, plane in zip(running.lines, results.planes(), strict=False):
        percent = 100 * (plane.mean_mm / plane.closed_form_mean_mm - 1)
        assert line.get_ydata()[-1] == pytest.approx(percent, abs=1e-5)
        assert line.get_xdata()[-1] == plane.cycles
