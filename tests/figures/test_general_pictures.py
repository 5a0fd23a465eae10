"""What pictures of health and of the general model show is what the records say."""

import json

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from pa10cal.figures.campaign import by_joint, joint_maps
from pa10cal.figures.campaign import errors as errors_pictures
from pa10cal.figures.campaign import health as health_pictures
from pa10cal.figures.campaign import residuals as residuals_pictures
from pa10cal.figures.campaign.by_joint import PoseResiduals, joint_errors, running_mean
from pa10cal.figures.registry import NothingToShowError
from pa10cal.figures.style import looks, write_figure

pytestmark = pytest.mark.usefixtures("project_looks")
COMBINED = "calibration/combined.json"
HOLDOUT = "evaluation/holdout.json"


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


def legend_of(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def box_of(axes):
    FigureCanvasAgg(axes.figure).draw()
    return axes.get_tightbbox()


class TestHealth:
    @pytest.mark.slow
    @pytest.mark.parametrize("kind", ["nothing", "pose", "distance"])
    def test_shows_both_orders_and_what_is_wanted(self, results, sighted, kind):
        source = results if kind == "nothing" else sighted[kind]
        found = source.any_calibration().health.poses
        curve = health_pictures.draw_health(source).axes[0]
        optimal, measured = curve.lines[:2]
        assert list(optimal.get_xdata()) == [point.poses for point in found.expected]
        assert list(optimal.get_ydata()) == [point.u_optimal_mm for point in found.expected]
        known = [p.u_measured_mm for p in found.expected if p.u_measured_mm is not None]
        assert list(measured.get_ydata()) == known
        star = curve.lines[2]
        assert (star.get_xdata()[0], star.get_ydata()[0]) == (found.measured, found.u_model_mm)
        assert curve.lines[3].get_ydata()[0] == found.u_needed_mm

    def test_says_the_grade_and_what_it_rests_on(self, sighted):
        found = sighted["distance"].general().health
        said = " ".join(texts_of(health_pictures.draw_health(sighted["distance"])))
        assert f"{found.grade.replace('_', ' ').capitalize()}: {found.line}." in said
        assert f"Rank {found.rank} of {found.unknowns}" in said
        assert f"{found.held_out_rms_mm:.3f}" in said
        assert "distance error [mm]" in said

    def test_lists_pairs_the_worst_first_and_says_how_many_more(self, copied, sighted):
        pairs = [
            {"parameters": ["delta_a_2", f"delta_d_{k}"], "correlation": -0.99 + 0.002 * k}
            for k in range(1, 12)
        ]
        source = copied(
            sighted["pose"], COMBINED, lambda r: r["health"].update(correlated_pairs=pairs)
        )
        texts = texts_of(health_pictures.draw_health(source))
        assert "δa₂ and δd₁: -0.988" in texts
        assert "and 3 more, see the table" in texts

    def test_copes_with_what_is_not_known(self, copied, sighted):
        def unknown(record):
            record["health"].update(noise_mm=None, held_out_rms_mm=None)
            record["health"]["poses"].update(needed=None, u_model_mm=None)
            record["health"]["poses"]["expected"][0]["u_measured_mm"] = None

        figure = health_pictures.draw_health(copied(sighted["pose"], COMBINED, unknown))
        assert texts_of(figure).count("not known") == 3
        ordered = len(sighted["pose"].general().health.poses.d_optimal_order)
        assert any(f"not reached with {ordered} chosen poses" in text for text in legend_of(figure))

    @pytest.mark.slow
    @pytest.mark.parametrize("ends", [(0.022, 0.034), (0.024, 0.48), (0.011, 0.0111)])
    def test_texts_are_whole_and_apart(self, copied, sighted, ends):
        def between(record):
            low, high = ends
            record["health"].update(noise_mm=high, held_out_rms_mm=high, train_rms_mm=low)
            record["health"]["poses"].update(u_model_mm=low, u_needed_mm=0.00736)

        figure = health_pictures.draw_health(copied(sighted["distance"], COMBINED, between))
        expected, errors = figure.axes
        assert box_of(expected).x0 > 0.0
        assert not box_of(expected).overlaps(box_of(errors))
        first, second = (label.get_window_extent() for label in errors.get_xticklabels())
        assert first.x1 + 3.0 < second.x0


class TestHeldOutErrors:
    def test_every_model_is_drawn_with_its_rms(self, sighted):
        found = sighted["pose"].held_out()
        figure = errors_pictures.draw_held_out_errors(sighted["pose"])
        assert len(figure.axes) == 2  # the attitude was seen
        titles = ("nominal, frames fitted", "geometry", "geometry and springs")
        for said, title, model in zip(
            legend_of(figure), titles, found.models.values(), strict=True
        ):
            assert said.startswith(f"{title}: rms {model.rms_mm:.3f}, peak {model.peak_mm:.3f} mm")
        uncalibrated = figure.axes[0].lines[0]
        errors = np.sort(found.models["uncalibrated"].rows.error_mm)
        np.testing.assert_allclose(uncalibrated.get_xdata(), errors)
        np.testing.assert_allclose(uncalibrated.get_ydata()[[0, -1]], [100 / len(errors), 100])

    def test_poses_beyond_the_angles_learnt_are_apart(self, learnt):
        figure = errors_pictures.draw_held_out_errors(learnt)
        extended = learnt.held_out().models["extended"]
        inside, beyond = legend_of(figure)[-2:]
        assert inside.startswith("with discovered effects, angles seen: rms ")
        assert f"rms {extended.inside.rms_mm:.3f}" in inside
        assert f"({extended.outside.configurations} poses)" in beyond
        assert "extrapolated" in beyond
        drawn = figure.axes[0].lines[-2]
        assert drawn.get_linestyle() == ":"
        errors = extended.rows.error_mm[extended.rows.extrapolated]
        np.testing.assert_allclose(drawn.get_xdata(), np.sort(errors))

    @pytest.mark.parametrize(
        ("kind", "axis", "said"),
        [
            ("points", "position error [mm]", "root mean square over the targets"),
            ("distance", "distance error [mm]", "across the line of sight are not measured"),
        ],
    )
    def test_without_attitude_says_what_the_error_is_of(self, sighted, kind, axis, said):
        figure = errors_pictures.draw_held_out_errors(sighted[kind])
        assert [axes.get_xlabel() for axes in figure.axes] == [axis]
        assert any(said in text for text in texts_of(figure))
        assert not any("°" in text for text in legend_of(figure))

    @pytest.mark.parametrize("count", [1, 20, 1001])
    def test_a_line_is_the_share_of_poses_and_its_mark_on_it(self, copied, sighted, count):
        error_mm = np.random.default_rng(count).gamma(1.0, size=count)

        def many(record):
            for model in record["models"].values():
                model["rows"] = [model["rows"][0] | {"error_mm": error} for error in error_mm]

        axes = errors_pictures.draw_held_out_errors(
            copied(sighted["distance"], HOLDOUT, many)
        ).axes[0]
        line, mark = axes.lines[:2]
        share = [100.0 * np.mean(error_mm <= x) for x in line.get_xdata()]
        np.testing.assert_allclose(line.get_ydata(), share)
        rms = np.sqrt(np.mean(error_mm**2))
        assert mark.get_xdata()[0] == pytest.approx(rms)
        step = np.searchsorted(line.get_xdata(), rms * (1.0 + 1e-12), side="right") - 1
        assert mark.get_ydata()[0] == line.get_ydata()[step]

    def test_lines_that_coincide_are_all_seen(self, sighted):
        figure = errors_pictures.draw_held_out_errors(sighted["pose"])
        geometry, springs = figure.axes[0].lines[2], figure.axes[0].lines[4]
        assert geometry.get_linestyle() == "--"
        assert geometry.get_zorder() > springs.get_zorder()
        assert geometry.get_linewidth() < springs.get_linewidth()

    def test_without_springs_there_is_one_calibrated_model(self, sighted):
        said = legend_of(errors_pictures.draw_held_out_errors(sighted["points"]))
        assert [text.partition(":")[0] for text in said] == ["nominal, frames fitted", "calibrated"]

    def test_without_held_out_poses(self, copied, sighted):
        source = copied(sighted["pose"], HOLDOUT, lambda r: r.update(models={}, configurations=0))
        with pytest.raises(NothingToShowError, match=r"^no held-out configuration was"):
            errors_pictures.draw_held_out_errors(source)


class TestErrorByJoint:
    @pytest.mark.parametrize("kind", ["pose", "points"])
    def test_a_row_of_poses_fitted_and_one_of_those_held_out(self, sighted, kind):
        source = sighted[kind]
        joints, case = source.joints(), source.general()
        rows = case.residuals
        q = joints.of(rows.pose.tolist(), rows.load_N.tolist())
        figure = by_joint.draw_error_by_joint(source)
        n = len(joints.slides)
        assert len(figure.axes) == 2 * n
        fitted = figure.axes[0].lines[0]
        np.testing.assert_allclose(fitted.get_xdata(), np.degrees(q[:, 0]))
        assert len(rows) == sum(source.poses()["kind"] == "grid")
        labels = [axes.get_ylabel().partition("\n")[0] for axes in figure.axes[::n]]
        assert labels == ["calibrated model, fitted", "calibrated model, held out"]
        assert any("poses, calibrated model;" in text for text in texts_of(figure))
        assert not any("before" in text for text in texts_of(figure))
        assert all(len(axes.get_xticks()) == 2 for axes in figure.axes)

    def test_a_sliding_joint_is_in_millimetres(self, sighted):
        joints = sighted["points"].joints()
        assert list(joints.slides) == [False, False, True, False]
        figure = by_joint.draw_error_by_joint(sighted["points"])
        third = figure.axes[2].lines[0].get_xdata()
        poses = sighted["points"].poses()
        q3_m = poses[poses["kind"] == "grid"]["q3_m"]
        np.testing.assert_allclose(np.sort(third), np.sort(1e3 * q3_m))
        assert "joint angle [deg]; of joint 3 mm" in texts_of(figure)
        assert any("Positions alone were measured" in text for text in texts_of(figure))

    def test_what_was_discovered_has_a_row(self, learnt):
        figure = by_joint.draw_error_by_joint(learnt)
        before, after = (figure.axes[n].lines[0].get_ydata() for n in (6, 12))
        labels = [axes.get_ylabel().partition("\n")[0] for axes in figure.axes[::6]]
        assert labels == ["fitted, before", "held out, before", "held out, after"]
        assert any("before and after discovery" in text for text in texts_of(figure))
        grey = figure.axes[12].lines[1]
        beyond = learnt.held_out().models["extended"].rows.extrapolated.sum()
        assert len(grey.get_xdata()) == beyond
        assert any(
            text.startswith(f"Grey: {beyond} extrapolated poses") for text in texts_of(figure)
        )
        # Position errors are smaller there, attitudes the same: joints err less, but not by 0.3.
        assert np.abs(after).sum() < np.abs(before).sum()

    def test_an_error_of_one_joint_shows_there(self, sighted, tmp_path):
        source = sighted["pose"]
        q, chain = source.joints().q.to_numpy(), source.chain()
        error = 1e-3 * np.sin(3 * q[:, 1])
        moved = q.copy()
        moved[:, 1] += error
        T, T_moved = chain.forward(q), chain.forward(moved)
        p = np.array([0.05, 0.0, 0.1])
        at, there = (X[:, :3, :3] @ p + X[:, :3, 3] for X in (T, T_moved))
        turn = T_moved[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
                         turn[:, 1, 0] - turn[:, 0, 1]], axis=1) / 2.0  # fmt: skip
        left = PoseResiduals(q, 1e3 * (at - there), -np.degrees(axis))
        found = joint_errors(chain, left, p)
        told = np.abs(np.sin(q[:, 4])) > 0.3  # else a singular wrist tells 4 from 6 badly
        off = found[told] - error[told, None] * (np.arange(6) == 1)
        assert np.sqrt(np.mean(off**2, axis=0)).max() < 0.1 * np.sqrt(np.mean(error**2))

    def test_a_mean_is_of_poses_near_each_other(self):
        x = np.concatenate([np.linspace(0.0, 0.9, 10), [5.5]])
        middle, mean = running_mean(x, 2.0 * x, 1.0)
        np.testing.assert_allclose(middle, np.arange(6) + 0.5)
        np.testing.assert_allclose(mean[0], 0.9)
        assert np.isnan(mean[1:]).all()

    def test_thousands_of_poses_stay_light(self, copied, sighted, tmp_path):
        def many(record):
            record["residuals"] = record["residuals"] * 60

        source = copied(sighted["pose"], COMBINED, many)
        with looks():
            write_figure(
                by_joint.draw_error_by_joint(source), source.footer, tmp_path, "light", 100
            )
        for ending in ("svg", "pdf"):
            assert (tmp_path / f"light.{ending}").stat().st_size < 600e3


class TestJointErrorMaps:
    def test_the_line_runs_through_the_knots_and_the_band_is_theirs(self, learnt):
        figure = joint_maps.draw_joint_error_maps(learnt)
        first, third = figure.axes[1], figure.axes[0]
        assert first.get_title(loc="left").startswith("joint 1: rms 0.212 mrad over the turn")
        assert third.get_title(loc="left").startswith("joint 3: ")
        assert "over the measured angles; 5 % of the turn measured" in third.get_title(loc="left")
        seen, unseen = (line.get_ydata() for line in third.lines[:2])
        angle = third.lines[0].get_xdata()
        line = np.where(np.isnan(seen), unseen, seen)
        np.testing.assert_allclose(line, 0.3 * np.sin(3 * np.radians(angle)), atol=5e-3)
        effect = next(e for e in learnt.verdict().effects if e.of == "joint 3")
        at_knots = np.isin(angle, np.arange(0.0, 360.0, 15.0))
        values = [1e3 * parameter.value for parameter in effect.parameters.values()]
        np.testing.assert_allclose(line[at_knots], values, atol=1e-12)
        band = np.vstack([c.get_paths()[k].vertices for c in third.collections[1:3]
                          for k in range(len(c.get_paths()))])  # fmt: skip
        for k, std in ((4, 2e-5), (5, 3e-5)):
            ends = band[np.isclose(band[:, 0], 15.0 * k), 1]
            assert np.ptp(ends) == pytest.approx(2 * 1.96e3 * std)

    def test_angles_that_the_poses_fitted_have_not_seen_are_extrapolated(self, learnt):
        figure = joint_maps.draw_joint_error_maps(learnt)
        known, guessed = figure.axes[0].lines[:2]
        angle = known.get_xdata()
        inside = (angle > 10.2) & (angle < 27.8)
        np.testing.assert_array_equal(np.isfinite(known.get_ydata()), inside)
        np.testing.assert_array_equal(np.isfinite(guessed.get_ydata()), ~inside)
        assert guessed.get_linestyle() == ":"
        assert np.isnan(figure.axes[1].lines[0].get_ydata()).all()
        assert "0 % of the turn measured" in figure.axes[1].get_title(loc="left")

    def test_a_map_judged_by_repeats_is_drawn_without_angles_seen(self, copied, learnt):
        source = copied(learnt, "discovery/verdict.json", lambda r: r.pop("angles_seen"))
        known = joint_maps.draw_joint_error_maps(source).axes[0].lines[0]
        assert np.isfinite(known.get_ydata()).all()

    def test_says_when_there_is_no_map(self, copied, learnt):
        source = copied(learnt, "discovery/verdict.json", lambda r: r.update(effects=[]))
        with pytest.raises(NothingToShowError, match="no error that depends on a joint's angle"):
            joint_maps.draw_joint_error_maps(source)


class TestResidualField:
    @pytest.mark.parametrize("kind", ["points", "distance"])
    def test_where_effects_are_not_sought_the_calibrated_model_is_drawn(self, sighted, kind):
        source = sighted[kind]
        assert source.verdict().verdict == "not_sought"
        figure = residuals_pictures.draw_residual_field(source)
        arrows = [artist for axes in figure.axes for artist in axes.findobj(Quiver)]
        rows = source.general().residuals
        assert len(arrows) == 2
        np.testing.assert_allclose(arrows[0].X, rows.place_mm[:, 0])
        scale = -arrows[0].U / rows.position_mm[:, 0]
        np.testing.assert_allclose(scale, scale[0])

    @pytest.mark.parametrize("kind", ["points", "distance"])
    def test_views_side_by_side_are_alike_and_apart(self, sighted, kind):
        figure = residuals_pictures.draw_residual_field(sighted[kind])
        above, side = figure.axes
        assert above.get_position().y0 == side.get_position().y0
        assert above.get_position().y1 == side.get_position().y1
        for axes in figure.axes:
            across, up = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
            size = axes.get_window_extent()
            assert size.height / up == pytest.approx(size.width / across)
        assert not box_of(above).overlaps(box_of(side))
        assert box_of(side).x1 < figure.bbox.x1

    def test_of_thousands_some_are_drawn_and_the_mean_is_of_all(self, copied, sighted):
        def many(record):
            record["residuals"] = record["residuals"] * 60

        figure = residuals_pictures.draw_residual_field(copied(sighted["points"], COMBINED, many))
        rows = sighted["points"].general().residuals
        (said,) = legend_of(figure)
        mean = np.linalg.norm(rows.position_mm, axis=1).mean()
        assert said.endswith(f"mean length {mean:.3f} mm calibrated; 240 of {60 * len(rows)} drawn")
        arrows = figure.axes[0].findobj(Quiver)[0]
        assert len(arrows.X) == 240


def test_a_pose_that_is_not_in_the_table_is_named(copied, sighted):
    def stray(record):
        record["residuals"][3]["pose"] = "P999"

    source = copied(sighted["pose"], COMBINED, stray)
    with pytest.raises(Exception, match=r"not in the table of poses \(got 'P999 at 0 N'\)"):
        by_joint.draw_error_by_joint(source)


def test_the_held_out_poses_of_the_fixture_are_told_apart(learnt):
    rows = json.loads((learnt.folder / HOLDOUT).read_text("utf-8"))["models"]["extended"]["rows"]
    assert {row["extrapolated"] for row in rows} == {True, False}
