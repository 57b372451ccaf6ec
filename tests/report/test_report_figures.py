"""Every picture for every kind of analysis, and the numbers that the pictures rest on."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.text import Text
from small_models import component, document, term
from synthetic_analysis import (
    KINDS,
    drift_analysis,
    no_key_point_analysis,
    one_state_analysis,
    parameters_analysis,
    sweeps_analysis,
    two_inputs_analysis,
)

from thetacomp.machine import Axis, Sensor
from thetacomp.model.law import component_laws
from thetacomp.report import predicted_states, style
from thetacomp.report.figures import all_figures
from thetacomp.report.figures_error import error_over_position
from thetacomp.report.figures_fit import NOT_PREDICTED, fit_over_temperature
from thetacomp.report.figures_temperature import correlation_maps, temperatures_over_time
from thetacomp.report.figures_validation import before_and_after, error_over_time
from thetacomp.report.rendering import render
from thetacomp.report.sketch import machine_sketch

COMMON = {"placement", "temperatures", "fit", "before_after", "over_time"}
SECTIONS = {
    "sweeps": COMMON | {"position", "geometry", "correlations"},
    "parameters": COMMON | {"position", "correlations"},
    "drift": COMMON | {"drift", "correlations"},
    "chinese": COMMON | {"position", "geometry", "correlations"},
    "one_state": COMMON | {"position", "geometry"},
    "nasty_names": COMMON | {"position", "geometry", "correlations"},
    "no_key_point": COMMON | {"position", "geometry", "correlations"},
    "two_inputs": COMMON | {"position", "geometry", "correlations"},
}


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_has_its_pictures(kind: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figures = all_figures(KINDS[kind]())
    assert {figure.section for figure in figures} == SECTIONS[kind]
    names = [figure.name for figure in figures]
    assert len(names) == len(set(names))
    assert all(name.isascii() and not set(name) & set('<>:"/\\|?* ') for name in names)
    for figure in figures:
        assert figure.caption
        for axes in figure.figure.axes:
            if axes.axison and axes.lines and figure.section not in ("placement", "before_after"):
                assert axes.get_ylabel(), f"{figure.name} has an axis without a label"


@pytest.mark.parametrize("kind", ["sweeps", "drift", "one_state"])
def test_rendering_gives_no_remark(kind: str) -> None:
    analysis = KINDS[kind]()
    for figure in all_figures(analysis)[:: 5 if kind == "drift" else 4]:
        rendered = render(figure)
        assert rendered.remarks == ()
        assert rendered.missing == ()
        assert rendered.png.startswith(b"\x89PNG")


def test_settings_of_matplotlib_stay_as_they_were() -> None:
    import matplotlib

    before = matplotlib.rcParams["svg.fonttype"], matplotlib.rcParams["font.size"]
    machine_sketch(one_state_analysis())
    assert (matplotlib.rcParams["svg.fonttype"], matplotlib.rcParams["font.size"]) == before


def boxes_of_texts(axes: Axes) -> list[tuple[str, object]]:
    figure = axes.get_figure()
    assert figure is not None
    figure.draw_without_rendering()  # type: ignore[union-attr]
    return [(t.get_text(), t.get_window_extent()) for t in axes.findobj(Text) if t.get_visible() and t.get_text()]


def test_labels_of_fifteen_sensors_do_not_overlap() -> None:
    with_rc = style.styled(lambda: boxes_of_texts(machine_sketch(sweeps_analysis())[0].figure.axes[0]))
    labels = [(text, box) for text, box in with_rc() if text.startswith("theta_")]
    assert len(labels) == 15
    for i, (one, a) in enumerate(labels):
        for other, b in labels[i + 1 :]:
            assert not a.overlaps(b), f"{one} and {other} overlap"  # type: ignore[attr-defined]


def test_table_of_the_sketch_names_every_sensor() -> None:
    texts = {t.get_text() for t in machine_sketch(sweeps_analysis())[0].figure.axes[1].texts}
    assert {f"theta_{k}" for k in range(1, 16)} <= texts
    assert "W axis feed screw nut" in texts


def test_sketch_of_other_machines() -> None:
    analysis = sweeps_analysis(campaigns=("a",), states=3)
    lathe = analysis.folder.machine.model_copy(
        update={
            "axes": tuple(Axis(name=n, direction="+X", travel_mm=(0.0, 500.0)) for n in ("X", "Y", "W", "Z")),
        }
    )
    blocks = machine_sketch(replace(analysis, folder=replace(analysis.folder, machine=lathe)))[0]
    assert "One block" in blocks.caption
    sensors = tuple(
        Sensor(id=s.id, role=s.role, at_mm=(k * 100.0, k * 50.0, 20.0 * k))
        for k, s in enumerate(analysis.folder.machine.sensors)
    )
    placed = analysis.folder.machine.model_copy(update={"sensors": sensors})
    to_scale = machine_sketch(replace(analysis, folder=replace(analysis.folder, machine=placed)))[0]
    assert "to scale" in to_scale.caption
    assert machine_sketch(analysis)[0].caption.startswith("Floor-type")


def test_sensors_without_reading_are_told() -> None:
    assert "without a reading" in machine_sketch(parameters_analysis())[0].caption
    assert "without a reading" not in machine_sketch(sweeps_analysis())[0].caption


def test_campaigns_of_one_axis_each_share_a_picture_and_repeated_ones_do_not() -> None:
    assert [f.name for f in error_over_position(parameters_analysis())] == ["error_over_position"]
    names = [f.name for f in error_over_position(sweeps_analysis())]
    assert names == ["error_over_position_2026-03-02", "error_over_position_2026-03-09"]


def test_error_over_position_draws_points_or_lines() -> None:
    lines_only = error_over_position(parameters_analysis())[0].figure.axes[0]
    assert not lines_only.collections
    measured = error_over_position(sweeps_analysis(campaigns=("a",)))[0].figure.axes[0]
    assert sum(len(c.get_offsets()) for c in measured.collections) == 9 * 2 * 13  # states, directions, stations


def test_columns_follow_the_axes_of_the_machine() -> None:
    analysis = parameters_analysis()
    analysis = replace(analysis, separations=analysis.separations[::-1])
    titles = [axes.get_title(loc="left") for axes in error_over_position(analysis)[0].figure.axes[:3]]
    assert [title[:3] for title in titles] == ["EXX", "EXY", "EXW"]


def test_missing_values_do_not_break_a_picture() -> None:
    analysis = parameters_analysis()
    part = analysis.separations[2]
    gap = part.intercept_um.copy()
    gap[3] = np.nan
    holed = replace(part, intercept_um=gap)
    analysis = replace(analysis, separations=(*analysis.separations[:2], holed, *analysis.separations[3:]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for draw in (error_over_position, fit_over_temperature, error_over_time):
            for figure in draw(analysis):
                figure.figure.draw_without_rendering()


def test_heat_map_shows_every_number_and_hatches_the_gap() -> None:
    analysis = parameters_analysis()
    figure = next(f for f in correlation_maps(analysis) if f.name == "correlation_parameters").figure
    numbers = [t.get_text() for t in figure.axes[0].texts]
    finite = analysis.parameter_correlations.value[np.isfinite(analysis.parameter_correlations.value)]
    assert len(numbers) == len(finite) == 18 * 14 - 1
    assert f"{finite[0]:.2f}" == numbers[0]
    assert figure.axes[0].patch.get_hatch()


def test_heat_map_of_nothing_but_the_diagonal_is_left_out() -> None:
    analysis = parameters_analysis()
    table = analysis.sensor_correlations
    diagonal = np.where(np.eye(14, dtype=bool), 1.0, np.nan)
    analysis = replace(analysis, sensor_correlations=replace(table, value=diagonal))
    assert [f.name for f in correlation_maps(analysis)] == ["correlation_parameters"]


def test_published_tables_are_drawn_beside_the_computed_ones() -> None:
    analysis = parameters_analysis()
    folder = replace(analysis.folder, parameter_correlations=analysis.parameter_correlations)
    names = [f.name for f in correlation_maps(replace(analysis, folder=folder))]
    assert names == ["correlation_parameters_given", "correlation_parameters", "correlation_sensors"]


def test_fit_marks_a_state_outside_the_band() -> None:
    analysis = parameters_analysis()
    part = analysis.separations[0]
    far = part.intercept_um.copy()
    far[4] += 500.0
    analysis = replace(analysis, separations=(replace(part, intercept_um=far), *analysis.separations[1:]))
    axes = fit_over_temperature(analysis)[0].figure.axes[0]
    rings = [c for c in axes.collections if isinstance(c, PathCollection) and len(c.get_offsets()) == 1]
    assert len(rings) == 1
    assert float(np.asarray(rings[0].get_offsets())[0, 1]) == pytest.approx(far[4])
    assert f"{part.t_s[4] / 3600.0:.1f} h" in {t.get_text() for t in axes.texts}


def test_one_campaign_is_drawn_over_degrees_and_several_over_the_rise() -> None:
    one = fit_over_temperature(sweeps_analysis(campaigns=("a",)))[0].figure.axes[4]
    several = fit_over_temperature(sweeps_analysis())[0].figure.axes[4]
    assert one.get_xlabel() == "theta_15 (°C)"
    assert several.get_xlabel() == "rise of theta_15 since the reference (K)"


def test_a_component_without_a_sensor_is_drawn_over_time_and_told() -> None:
    figure = next(f for f in fit_over_temperature(no_key_point_analysis()) if f.name == "fit_Y")
    for axes in figure.figure.axes[:6]:
        assert NOT_PREDICTED in {" ".join(t.get_text().split()) for t in axes.texts}
        assert "R²" not in axes.get_title(loc="left")
    part = next(s for s in no_key_point_analysis().separations if s.component == "EXY")
    dots = next(c for c in figure.figure.axes[0].collections if isinstance(c, PathCollection))
    np.testing.assert_allclose(np.asarray(dots.get_offsets())[:, 0], part.t_s / 3600.0)
    assert NOT_PREDICTED in figure.caption
    assert "nothing is compensated" in figure.caption


def test_two_inputs_are_drawn_as_measured_against_predicted() -> None:
    analysis = two_inputs_analysis()
    figure = fit_over_temperature(analysis)[0]
    axes = figure.figure.axes[0]
    part = analysis.separations[0]
    predicted = predicted_states.predict_states(analysis, part)
    assert predicted is not None
    dots = next(c for c in axes.collections if isinstance(c, PathCollection))
    np.testing.assert_allclose(dots.get_offsets(), np.column_stack([predicted.intercept_um, part.intercept_um]))
    diagonal = next(line for line in axes.lines if len(line.get_xdata()) == 13)  # type: ignore[arg-type]
    np.testing.assert_array_equal(diagonal.get_xdata(), diagonal.get_ydata())
    assert "predicted from 2 sensors" in axes.get_xlabel()
    assert "diagonal" in figure.caption


def test_a_term_that_chance_explains_is_named_so() -> None:
    """y = x + noise of 30 sd: the t value is far below 2, so R² in-sample says nothing."""
    weak = term(0.0, 1.0, sd=30.0) | {"covariance": [[1, 0], [0, 4.0]], "r_squared": 0.1}
    strong = weak | {"covariance": [[1, 0], [0, 0.01]]}
    worse_than_mean = strong | {"r_squared": -0.2}
    alone = [
        document({}, {"DX": component("DX", t, None, {"a": 20.0})}, {"a": (0.0, 9.0)})
        for t in (weak, strong, worse_than_mean)
    ]
    laws = [component_laws(one.control)["DX"] for one in alone]
    assert [predicted_states.explains(law, 0) for law in laws] == [False, True, False]
    analysis = parameters_analysis()
    law = analysis.model.control["X"]
    exx = law.components["EXX"]
    noise = replace(exx.band, sd=(100.0 * exx.band.sd[0] * abs(exx.terms[0].coefficients[0]), exx.band.sd[1]))
    weaker = law.model_copy(update={"components": law.components | {"EXX": exx.model_copy(update={"band": noise})}})
    model = analysis.model.model_copy(update={"control": {**analysis.model.control, "X": weaker}})
    titles = [a.get_title(loc="left") for a in fit_over_temperature(replace(analysis, model=model))[0].figure.axes[:2]]
    assert titles[0] == "EXX intercept · not explained"
    assert titles[1].startswith("EXX slope · R² in-sample ")


def test_campaigns_are_told_apart_over_time() -> None:
    figure = error_over_time(sweeps_analysis())[0].figure
    looks = {(line.get_marker(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert [len(set(look)) for look in zip(*looks, strict=True)] == [2, 2]  # by marker and by line style
    assert {"2026-03-02", "2026-03-09"} <= {t.get_text() for t in figure.legends[0].get_texts()}


def test_what_got_worse_is_red_and_a_dominated_panel_is_logarithmic() -> None:
    analysis = parameters_analysis()
    harmed = replace(
        next(r for r in analysis.validation if r.model == "default"), max_before_um=1.0, max_after_um=900.0
    )
    rows = tuple(harmed if r.model == "default" and r.component == harmed.component else r for r in analysis.validation)
    axes = before_and_after(replace(analysis, validation=rows))[0].figure.axes[0]
    assert [line.get_color() for line in axes.lines].count(style.WORSE) == 1
    assert axes.get_xscale() == "log"


def test_before_and_after_shows_the_held_out_figures() -> None:
    analysis = parameters_analysis()
    axes = before_and_after(analysis)[0].figure.axes[0]
    drawn = {round(float(x), 6) for line in axes.lines for x in np.ravel(line.get_xdata())}
    for row in analysis.validation:
        if row.model in ("default", "clock", "one_sensor"):
            assert round(row.max_after_um, 6) in drawn
            assert round(row.max_before_um, 6) in drawn


def test_long_recordings_are_thinned_but_keep_their_peaks() -> None:
    t = np.arange(11115.0)
    value = np.sin(t / 900.0)
    value[5000] = 7.0
    few_t, few = style.thin(t, value)
    assert len(few) <= 602
    assert few.max() == 7.0
    assert (few_t[0], few_t[-1]) == (0.0, 11114.0)
    assert style.highest(t, value)[1].max() == 7.0
    assert len(style.highest(t, value)[1]) == 120
    figure = temperatures_over_time(drift_analysis(campaigns=1))[0].figure
    assert max(len(line.get_xdata()) for line in figure.axes[0].lines) <= 602  # type: ignore[arg-type]


def test_spread_keeps_distance_and_order() -> None:
    placed = style.spread(np.array([5.0, 5.1, 5.05, 9.9]), 1.0, 0.0, 10.0)
    assert np.argsort(placed).tolist() == [0, 2, 1, 3]
    assert np.diff(np.sort(placed)).min() >= 1.0 - 1e-12
    assert placed.min() >= 0.0
    assert placed.max() <= 10.0
    # Least squares: three labels that want 5.05 on average sit round it.
    assert placed[:3].mean() == pytest.approx(5.05)
    assert style.spread(np.array([]), 1.0, 0.0, 1.0).size == 0


def test_prediction_is_the_stored_equation() -> None:
    analysis = parameters_analysis()
    part = analysis.separations[0]
    law = component_laws(analysis.model.control)[part.component]
    slope = law.component.terms[1]
    predicted = predicted_states.predict_states(analysis, part)
    assert predicted is not None
    theta = analysis.folder.campaign(part.campaign).temperatures.at(part.t_s)[:, 0]
    rise = theta - law.law.zero[law.inputs.index("theta_15")]
    expected = slope.constant + slope.coefficients[0] * rise
    np.testing.assert_allclose(predicted.slope_um_per_m, expected)


def test_prediction_moves_with_p0_but_the_line_does_not() -> None:
    analysis = parameters_analysis()
    part = analysis.separations[0]
    moved = replace(
        part,
        p0_mm=part.p0_mm + 500.0,
        intercept_um=part.intercept_um + 0.5 * part.slope_um_per_m,
    )
    ends = []
    for p in (part, moved):
        predicted = predicted_states.predict_states(analysis, p)
        assert predicted is not None
        assert predicted.slope_um_per_m is not None
        ends.append(predicted.intercept_um + predicted.slope_um_per_m * (part.p_max_mm - p.p0_mm) / 1000.0)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_band_is_the_textbook_prediction_interval() -> None:
    # Straight line through n points: t * s * sqrt(1 + 1/n + (x - mean)^2 / Sxx), Student's t with n - 2 degrees.
    from scipy.stats import t as student_t

    x, s, n = np.arange(6.0), 2.0, 6
    sxx = float(((x - x.mean()) ** 2).sum())
    inverse = np.linalg.inv(np.array([[n, x.sum()], [x.sum(), (x**2).sum()]]))
    fit = term(0.0, 1.0, sd=s) | {"covariance": (s**2 * inverse).tolist()}
    model = document({}, {"DX": component("DX", fit, None, {"a": 0.0}, dof=n - 2)}, {"a": (0.0, 9.0)})
    expected = student_t.ppf(0.975, n - 2) * s * np.sqrt(1.0 + 1.0 / n + (4.0 - x.mean()) ** 2 / sxx)
    assert predicted_states.half_band(component_laws(model.control)["DX"], 0, np.array([[4.0]]))[0] == pytest.approx(
        expected
    )


def test_file_labels_are_plain() -> None:
    assert style.file_label("第一次热机", 3) == "campaign-3"
    assert style.file_label("A < B/..", 1) == "A-B"
    assert style.short("abcdefgh", 5) == "abcd…"
