"""Pictures of a drive's diagnosis: the heading rate that the encoders claim beyond the gyro's, before and after."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gyrocal.diagnosis.drive import BLOCK_S
from gyrocal.diagnosis.drive_result import DriveDiagnosis
from gyrocal.diagnosis.drive_series import bins_of
from gyrocal.diagnosis.folds import clustered_error
from gyrocal.diagnosis.result import NamedEffect
from gyrocal.report import style
from gyrocal.report.diagnosis_marks import NORMAL_95, bars, legend_above, limit_around_zero, zero_line
from gyrocal.report.page import Picture

Floats = NDArray[np.float64]

_BINS = 15
#: Before and after are drawn beside each other; share of the distance between bins.
_APART = 0.12


def drive_figures(found: DriveDiagnosis) -> list[tuple[Picture, Figure | None]]:
    """Every picture of a drive's page with its caption."""
    intervals = f"95 % intervals from the scatter between blocks of {BLOCK_S:g} s"
    drawn: list[tuple[Picture, Figure | None]] = [
        (
            Picture(
                "difference",
                "Encoders less gyro over time",
                "Above: heading rate by the encoders less that by the gyro, in bins. Below: the same difference summed up, "
                "which is the heading error of one against the other.",
            ),
            difference_over_time(found),
        ),
        (
            Picture(
                "coordinates",
                "Where the difference lives",
                f"Mean difference over each coordinate, before and after the named physics; {intervals}, of all bins "
                "together where a bin has fewer than three.",
            ),
            difference_by_coordinate(found),
        ),
        (
            Picture(
                "turns",
                "Encoders against gyro",
                "Heading rate by the encoders over that by the gyro; the line is equality. Slip and a wrong wheel "
                "separation tilt the cloud, a delay opens it.",
            ),
            encoders_against_gyro(found),
        ),
    ]
    for effect in found.diagnosis.effects:
        if effect.effect in _OWN and effect.effect in found.fit.law_deg:
            caption = (
                f"{effect.statement} Folded on its own coordinate with all other named physics taken out: left the "
                f"difference and the effect's law, right what is left; {intervals}."
            )
            name = effect.effect
            drawn.append(
                (
                    Picture(f"effect_{name}", f"{name}, before and after", caption),
                    effect_before_and_after(found, effect),
                )
            )
    return drawn


def _models(found: DriveDiagnosis) -> list[tuple[str, Floats, str]]:
    """Name, difference in deg/s in each bin, and colour of each model that there is to show."""
    fit = found.fit
    models = [("nominal model", fit.before_deg / fit.bins.width_s, style.ORANGE)]
    if found.diagnosis.effects:
        models.append(("with the named physics", fit.after_deg / fit.bins.width_s, style.BLUE))
    return models


@style.styled
def difference_over_time(found: DriveDiagnosis) -> Figure:
    """Difference of heading rates, and its sum, over time."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.7)
    upper, lower = figure.subplots(2, 1, sharex=True)
    t_s, width_s = found.fit.bins.t_s, found.fit.bins.width_s
    noise = found.fit.noise
    for name, rate, colour in _models(found):
        rms = float(np.sqrt(np.mean(rate[noise.used] ** 2)))
        upper.plot(t_s, rate, ".", markersize=2, color=colour, label=f"{name}: {rms:.3g} deg/s rms")
        lower.plot(t_s, np.cumsum(rate) * width_s, color=colour)
    if noise.slips.size:
        slipped = _models(found)[-1][1][noise.slips]
        upper.plot(
            t_s[noise.slips], slipped, "x", markersize=4, color=style.INK, label="slip, left out of the fit"
        )
    limit_around_zero(upper, _models(found)[0][1], 0.998)
    upper.set_ylabel("Difference, deg/s")
    legend_above(upper)
    zero_line(lower)
    lower.set_ylabel("Summed up, deg")
    lower.set_xlabel("Time, s")
    return figure


def _turn_acceleration(found: DriveDiagnosis) -> Floats:
    """Mean change of the turn rate over the delay that was found, or over a bin where there is none, deg/s^2."""
    delay_s, width_s = found.fit.model.delay_s, found.fit.bins.width_s
    ends = (0.0, delay_s) if found.fit.model.delayed else (-0.5 * width_s, 0.5 * width_s)
    later, earlier = (bins_of(found.series, end) for end in ends)
    return np.asarray((later.gyro_deg - earlier.gyro_deg) / ((ends[1] - ends[0]) * width_s))


@style.styled
def difference_by_coordinate(found: DriveDiagnosis) -> Figure:
    """Mean difference over turn rate and its change, curvature, speed, acceleration and heading."""
    bins = found.fit.bins
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.6)
    axes = figure.subplots(2, 3)
    coordinates = (
        ("Turn rate, deg/s", bins.turn_rate_dps),
        ("Change of turn rate, deg/s²", _turn_acceleration(found)),
        ("Curvature, rad/m", bins.curvature_per_m),
        ("Speed, m/s", bins.speed_mps),
        ("Acceleration, m/s²", bins.acceleration_mps2),
        ("Heading, deg", bins.heading_deg % 360.0),
    )
    models = _models(found)
    for panel, (label, x) in zip(axes.ravel(), coordinates, strict=True):
        zero_line(panel)
        for k, (name, rate, colour) in enumerate(models):
            means = _means(found, x, rate)
            if means is not None:
                place, mean, half = means
                apart = _APART * float(np.median(np.diff(place))) if place.size > 1 else 0.0
                bars(panel, place + (2 * k - 1) * apart * (len(models) - 1), mean, half, colour, name)
        panel.set_xlabel(label)
    for panel in axes[:, 0]:
        panel.set_ylabel("Difference, deg/s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def _means(found: DriveDiagnosis, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Places, means and half widths of 95 % in equal bins of x, without slips; None where x does not change.

    The outer two take what lies beyond the middle 96 %, so that none is nearly empty.
    """
    use = np.isfinite(x) & np.isfinite(y) & found.fit.noise.used
    low, high = np.quantile(x[use], [0.02, 0.98]) if use.any() else (0.0, 0.0)
    if low == high:
        return None
    edges = np.linspace(low, high, _BINS + 1)
    number = np.clip(np.searchsorted(edges, x[use], side="right") - 1, 0, edges.size - 2)
    number = np.unique(number, return_inverse=True)[1]
    blocks = np.unique(found.fit.bins.t_s[use] // BLOCK_S, return_inverse=True)[1]
    one = np.ones(number.size)
    count = np.bincount(number)
    half = NORMAL_95 * clustered_error(y[use], one, one, number, blocks)
    return (
        np.asarray(np.bincount(number, x[use]) / count),
        np.asarray(np.bincount(number, y[use]) / count),
        half,
    )


@style.styled
def encoders_against_gyro(found: DriveDiagnosis) -> Figure:
    """Heading rate by encoders over that by gyro, bin by bin, before and after."""
    fit = found.fit
    nominal = bins_of(found.series, 0.0).gyro_deg
    clouds = [(nominal, nominal + fit.before_deg)]
    if found.diagnosis.effects:
        clouds.append((fit.bins.gyro_deg, fit.bins.gyro_deg + fit.after_deg))
    figure = style.new_figure(style.TWO_COLUMNS_IN if len(clouds) > 1 else style.ONE_COLUMN_IN, 3.3)
    axes = figure.subplots(1, len(clouds), sharex=True, sharey=True, squeeze=False)[0]
    limit = 1.05 * max(float(np.max(np.abs(cloud))) for cloud in clouds) / fit.bins.width_s
    for panel, cloud, (name, _, colour) in zip(axes, clouds, _models(found), strict=True):
        gyro, encoder = (x / fit.bins.width_s for x in cloud)
        panel.plot([-limit, limit], [-limit, limit], color=style.GREY, linewidth=0.8)
        panel.plot(gyro, encoder, ".", markersize=2, color=colour)
        panel.set_aspect("equal")
        panel.set_title(name[0].upper() + name[1:])
        panel.set_xlabel("Heading rate by the gyro, deg/s")
    axes[0].set_ylabel("by the encoders, deg/s")
    return figure


#: Where each law shows: label, and its coordinate in every bin.
_OWN: dict[str, tuple[str, Callable[[DriveDiagnosis], Floats]]] = {
    "gyro_delay": ("Change of the turn rate, deg/s²", _turn_acceleration),
    "skid_slip": ("Turn rate, deg/s", lambda found: found.fit.bins.turn_rate_dps),
    "wheel_asymmetry": ("Speed, m/s", lambda found: found.fit.bins.speed_mps),
    "gyro_bias": ("Time, s", lambda found: found.fit.bins.t_s),
    "bias_temperature": ("Gyro temperature, °C", lambda found: found.fit.bins.temp_c),
}


@style.styled
def effect_before_and_after(found: DriveDiagnosis, effect: NamedEffect) -> Figure:
    """An effect on its own coordinate: the difference with all other effects taken out, and what is left."""
    fit = found.fit
    label, coordinate = _OWN[effect.effect]
    x, width_s = coordinate(found), fit.bins.width_s
    law = fit.law_deg[effect.effect] / width_s
    after = fit.after_deg / width_s
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.6)
    left, right = figure.subplots(1, 2, sharey=True, sharex=True)
    for panel, y, colour, title in (
        (left, after + law, style.ORANGE, "Before"),
        (right, after, style.BLUE, "After"),
    ):
        zero_line(panel)
        _draw_means(panel, _means(found, x, y), colour)
        panel.set_title(title)
        panel.set_xlabel(label)
    curve = _means(found, x, law)
    if curve is not None:
        left.plot(curve[0], curve[1], color=style.INK, linewidth=1.0, label=effect.effect)
        legend_above(left)
    left.set_ylabel("Difference, deg/s")
    return figure


def _draw_means(panel: Axes, means: tuple[Floats, Floats, Floats] | None, colour: str) -> None:
    if means is not None:
        bars(panel, *means, colour)
