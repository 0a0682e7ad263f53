"""The figures of a report: what each is called, what to look for in it, and how it is drawn, or why it cannot be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from gyrocal.calibration.material import Material
from gyrocal.report import figures_error, figures_noise, figures_residual, figures_run
from gyrocal.report.scatter import signed_scatter


@dataclass(frozen=True)
class Drawing:
    """A figure to draw; where the record cannot carry it, `draw` returns a sentence that says why."""

    name: str
    title: str
    caption: str
    draw: Callable[[Material], Figure | str]


def _over_rate(draw: Callable[[Material], Figure]) -> Callable[[Material], Figure | str]:
    """A figure that needs more than one rate."""

    def drawn(m: Material) -> Figure | str:
        if m.one_rate:
            return (
                "The recording is at a single rate: there is a bias over temperature, and nothing over rate."
            )
        return draw(m)

    return drawn


def _scatter(m: Material) -> Figure | str:
    signed = signed_scatter(m.data)
    if signed is None:
        return "No three rates were measured four times or more: scatter cannot be told from shape."
    return figures_residual.scatter_figure(signed, m.tested)


def _allan(m: Material) -> Figure | str:
    if not m.noise.points:
        return f"Reason: {m.noise.statement}."
    return figures_noise.allan_deviation(m.noise)


def _timeline(m: Material) -> Figure | str:
    if m.timeline is None:
        return "The recording is a table of data sets: it holds no course in time."
    return figures_run.run_timeline(m.timeline)


DRAWINGS = (
    Drawing(
        "figure_1",
        "Figure 1. Error against rate, before calibration",
        "A point is a data set, a line the fitted surface at that temperature. Look for the cubic shape, and for how it "
        "turns with temperature. Hollow points are outliers or unsettled.",
        _over_rate(lambda m: figures_error.error_against_rate(m.data, m.coefficients.surface)),
    ),
    Drawing(
        "figure_2",
        "Figure 2. Error against temperature at several rates, before calibration",
        "Lines are the fitted surface. Look for points that leave their line at the ends: that is more than a quadratic.",
        lambda m: figures_error.error_against_temperature(m.data, m.coefficients.surface),
    ),
    Drawing(
        "figure_3a",
        "Figure 3a. Error over rate and temperature, before calibration",
        "Left the fitted surface with the data sets as dots, right the same from above; lines join equal errors.",
        _over_rate(lambda m: figures_error.error_before(m.data, m.coefficients.surface)),
    ),
    Drawing(
        "figure_3b",
        "Figure 3b. Error over rate and temperature, after calibration",
        "Each data set on a stem from zero: left on the height scale of figure 3a, right enlarged. It should look like "
        "grass, without waves.",
        _over_rate(lambda m: figures_error.error_after(m.data, m.coefficients.surface)),
    ),
    Drawing(
        "residual_map",
        "Residual over rate and temperature",
        "Mean residual in each cell; the margins show the means by rate and by temperature. Their intervals come from "
        "the covariance of the fit: scatter, drift that data sets near in time share, and coefficients. Margins that "
        "leave zero by more than that are structure that the surface does not follow.",
        _over_rate(lambda m: figures_residual.residual_map(m.data)),
    ),
    Drawing(
        "residual_over_time",
        "Residual over time",
        "Over the number of the data set where the recording has no times. Bars (or a band) are what scatter and coefficient "
        "uncertainty lead one to expect (95 %). A running median that wanders is drift; steps are events.",
        lambda m: figures_residual.residual_over_time(m.data),
    ),
    Drawing(
        "scatter_by_rate",
        "Scatter of data sets by rate",
        "Standard deviation of the residuals at each rate. A slope away from zero rate is scatter that grows with rate; "
        "ringed rates scatter more than the trend.",
        _scatter,
    ),
    Drawing(
        "allan_deviation",
        "Allan deviation at rest",
        "Gaps are not bridged, and what temperature does to the bias is removed. A slope of −1/2 is angle random walk; a "
        "floor is bias instability.",
        _allan,
    ),
    Drawing(
        "timeline",
        "Course of the run",
        "Chamber and gyro temperature, table rate and supply. The gyro should have caught up with the chamber before "
        "rates begin; unsettled segments are shaded.",
        _timeline,
    ),
    Drawing(
        "coefficients",
        "Coefficients with standard errors",
        "In deg/s, on scaled rate u (of the output, or the true rate) and temperature v. Pale cells are many standard errors from zero; dark ones could "
        "be left out.",
        lambda m: figures_run.coefficient_figure(m.coefficients),
    ),
)
