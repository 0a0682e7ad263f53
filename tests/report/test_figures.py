"""Figures: units on every axis, a curve for each temperature, nothing hidden, the same bytes each time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Path3DCollection

from gyrocal.calibration import figure
from gyrocal.calibration.corrected import Span, Timeline
from gyrocal.calibration.noise import AllanPoints, NoiseFigures
from gyrocal.calibration.summary import said
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.report import figures_error, figures_noise, figures_residual, figures_run, style
from gyrocal.report.scatter import signed_scatter
from tests.report.examples import SURFACE, examined, grid

COEFFICIENTS = Coefficients({}, SURFACE, np.diag(np.full(12, 1e-8)), Valid((-100, 100), (-10, 50)))


def timeline() -> Timeline:
    """Ten minutes of a run with one unsettled segment."""
    t_s = np.arange(0.0, 600.0, 5.0)
    spans = (
        Span(0, 300, 0.0, "soak", "ok"),
        Span(310, 400, 50.0, "rate", "unsettled"),
        Span(410, 600, -50.0, "rate", "ok"),
    )
    return Timeline(t_s, 20 + t_s / 60, t_s, 21 + t_s / 60, np.empty(0), np.empty(0), spans)


def scatter() -> Figure:
    """Scatter figure of the grid."""
    signed = signed_scatter(grid())
    assert signed is not None
    return figures_residual.scatter_figure(signed, None)


FIGURES: dict[str, Callable[[], Figure]] = {
    "figure_1": lambda: figures_error.error_against_rate(grid(), SURFACE),
    "figure_2": lambda: figures_error.error_against_temperature(grid(), SURFACE),
    "figure_3a": lambda: figures_error.error_before(grid(), SURFACE),
    "figure_3b": lambda: figures_error.error_after(grid(), SURFACE),
    "residual_map": lambda: figures_residual.residual_map(grid()),
    "residual_over_time": lambda: figures_residual.residual_over_time(grid()),
    "scatter": scatter,
    "timeline": lambda: figures_run.run_timeline(timeline()),
    "coefficients": lambda: figures_run.coefficient_figure(COEFFICIENTS),
}


#: One of each kind: curves, a map, a table.
_FAST = ("figure_1", "residual_map", "coefficients")


@pytest.mark.parametrize(
    "name", [n if n in _FAST else pytest.param(n, marks=pytest.mark.slow) for n in FIGURES]
)
def test_same_bytes_whatever_the_users_settings(name: str) -> None:
    first = FIGURES[name]()
    with mpl.rc_context({"font.size": 20, "axes.grid": False, "lines.linewidth": 9, "savefig.dpi": 50}):
        second = FIGURES[name]()
        for kind in ("png", "svg") if name == "figure_1" else ("svg",):
            a, b = style.render(first, kind), style.render(second, kind)
            assert a == b
            assert len(a) > 3000
    assert b"<dc:date>" not in style.render(first, "svg")


@pytest.mark.parametrize("name", [n for n in FIGURES if n not in ("coefficients",)])
def test_every_axis_says_its_unit(name: str) -> None:
    units = ("deg/s", "deg/h", "°C", " h", " V", "data set")
    for axes in FIGURES[name]().axes:
        if not axes.get_visible():
            continue
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert not label or any(unit in label for unit in units), label


def test_figure_1_has_a_curve_for_each_temperature() -> None:
    figure = figures_error.error_against_rate(grid(), SURFACE)
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["+50 °C", "+40 °C", "+30 °C", "+20 °C", "+10 °C", "+0 °C", "\N{MINUS SIGN}10 °C"]


def test_figure_1_bins_continuous_temperatures() -> None:
    rng = np.random.default_rng(1)
    rate = np.tile(np.linspace(-100, 100, 41), 12)
    data = examined(rate, rng.normal(0, 1e-2, rate.size), rng.uniform(37, 49, rate.size))
    (legend,) = figures_error.error_against_rate(data, SURFACE).legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == [f"{low} to {low + 2} °C" for low in range(48, 35, -2)]


def test_every_data_set_is_drawn_and_marked_ones_are_hollow() -> None:
    data = grid()
    marked = np.zeros(len(data.sets), dtype=bool)
    marked[[3, 50]] = True
    (axes,) = figures_error.error_against_rate(replace(data, marked=marked), SURFACE).axes
    points = [line for line in axes.get_lines() if line.get_linestyle() == "None"]
    solid = sum(np.size(p.get_xdata()) for p in points if p.get_markerfacecolor() != "white")
    hollow = sum(np.size(p.get_xdata()) for p in points if p.get_markerfacecolor() == "white")
    assert (solid, hollow) == (len(data.sets) - 2, 2)


def test_residual_cells_by_hand() -> None:
    rate = np.repeat([-10.0, 10.0], 4)
    temp = np.tile([0.0, 0.0, 40.0, 40.0], 2)
    residual = np.array([1.0, 3.0, 5.0, 5.0, 2.0, 2.0, -1.0, 1.0])
    rate_edges, temp_edges, mean, count = figures_residual.residual_cells(examined(rate, residual, temp))
    np.testing.assert_allclose(rate_edges, [-20, 0, 20])
    np.testing.assert_allclose(temp_edges, [-20, 20, 60])
    np.testing.assert_allclose(mean, [[2.0, 2.0], [5.0, 0.0]])
    np.testing.assert_allclose(count, 2)


def test_signed_maps_are_centred_on_zero() -> None:
    figure = figures_residual.residual_map(grid())
    meshes = [c for axes in figure.axes for c in axes.collections if c.get_array() is not None]
    limits = [mesh.get_clim() for mesh in meshes if mesh.get_cmap().name == style.DIVERGING]
    assert limits
    assert all(low == -high for low, high in limits)


def test_residuals_without_times_go_over_their_number() -> None:
    data = examined(np.linspace(-100, 100, 40), np.zeros(40))
    axes = figures_residual.residual_over_time(data).axes
    assert any("Number of the data set" in a.get_xlabel() for a in axes)


def test_unsettled_segments_are_marked() -> None:
    (legend,) = [a.get_legend() for a in figures_run.run_timeline(timeline()).axes if a.get_legend()]
    assert legend is not None
    assert "unsettled (1)" in [text.get_text() for text in legend.get_texts()]


def test_coefficient_cells_hold_value_and_error() -> None:
    axes = figures_run.coefficient_figure(COEFFICIENTS).axes[0]
    texts = [t.get_text() for t in axes.texts]
    assert len(texts) == 12
    assert texts[0] == "+0.050000\n± 0.000100"


def test_readings_at_rate_are_marked_in_the_timeline() -> None:
    rate = figures_run.run_timeline(timeline()).axes[1]
    (dots,) = [line for line in rate.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(np.asarray(dots.get_xdata(), dtype=float), np.array([355.0, 505.0]) / 3600.0)
    np.testing.assert_allclose(np.asarray(dots.get_ydata(), dtype=float), [50.0, -50.0])
    assert dots.get_markersize() >= 2.5


def test_the_coefficient_figure_alone_says_its_unit() -> None:
    axes = figures_run.coefficient_figure(COEFFICIENTS).axes[0]
    assert axes.get_title(loc="left") == "Value ± standard error, deg/s"


def test_stems_of_figure_3b_have_one_colour() -> None:
    for axes in figures_error.error_after(grid(), SURFACE).axes:
        (heads,) = [c for c in axes.collections if isinstance(c, Path3DCollection)]
        assert len(np.unique(np.asarray(heads.get_facecolor())[:, :3], axis=0)) == 1


def test_the_line_of_the_bias_instability_says_where_it_lies() -> None:
    tau = np.array([1.0, 10.0, 100.0])
    nine, every = np.full(3, 9.0), np.ones(3, dtype=np.bool_)
    points = AllanPoints(0.1, tau, 1e-3 / tau, 0.9e-3 / tau, 1.1e-3 / tau, nine, every, np.zeros(3))
    figures = {
        "angle_random_walk": figure.Figure("angle_random_walk", "deg/√h", "N", reason="not seen"),
        "bias_instability": figure.Figure("bias_instability", "deg/h", "B", 1.5, 1.0, 2.0),
    }
    noise = NoiseFigures(figures, "seen", "", (points,), None, 1000.0)
    axes = figures_noise.allan_deviation(noise).axes[0]
    (line,) = [found for found in axes.lines if "bias instability" in str(found.get_label())]
    assert line.get_label() == "bias instability B = 1.50 (1.00 to 2.00) deg/h; line at 0.664 B"
    np.testing.assert_allclose(np.asarray(line.get_ydata(), dtype=float), 1.5 * 0.664, rtol=1e-3)


def test_the_legend_has_the_digits_of_the_page() -> None:
    tau, every = np.array([1.0, 10.0]), np.ones(2, dtype=np.bool_)
    points = AllanPoints(
        0.1, tau, 1e-3 / tau, 0.9e-3 / tau, 1.1e-3 / tau, np.full(2, 9.0), every, np.zeros(2)
    )
    walk = figure.Figure("angle_random_walk", "deg/√h", "N", 0.09950, 0.0985, 0.1005)
    bias = figure.Figure("bias_instability", "deg/h", "B", reason="not seen")
    figures = {"angle_random_walk": walk, "bias_instability": bias}
    drawn = figures_noise.allan_deviation(NoiseFigures(figures, "", "", (points,), None, 1000.0))
    labels = [str(line.get_label()) for line in drawn.axes[0].lines]
    assert f"angle random walk {said(walk)} deg/√h" in labels
    assert said(walk) == "0.0995 (0.0985 to 0.1005)"


def test_figure_2_says_what_it_leaves_out_and_has_the_minus_of_the_axes() -> None:
    (legend,) = figures_error.error_against_temperature(grid(), SURFACE).legends
    assert legend.get_title().get_text() == "9 of 21 table rates"
    names = [text.get_text() for text in legend.get_texts()]
    assert "\N{MINUS SIGN}100.0 deg/s" in names
    assert not any("-" in name for name in names)
