"""What the coefficients leave: over rate and temperature, over time, and its scatter by rate."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gyrocal.calibration.corrected import Examined
from gyrocal.calibration.residuals import ScatterByRate
from gyrocal.report import style
from gyrocal.report.levels import Floats, Level, cell_edges, map_levels
from gyrocal.report.scatter import TREND_RATES, SignedScatter, odd_rates, usual_trend
from gyrocal.units import DPS_TO_DPH, NORMAL_95, S_PER_H

_RUNNING = 15
#: Data sets beyond which single bars no longer show.
_MANY = 300
#: A step in time this many times the usual one is a gap, over which no line is drawn.
_GAP = 5.0
_MEANS: dict[str, Any] = {
    "fmt": "o",
    "markersize": 2.5,
    "color": style.BLUE,
    "ecolor": "#9BC4DE",
    "elinewidth": 0.8,
}


def residual_cells(data: Examined) -> tuple[Floats, Floats, Floats, Floats]:
    """Mean residual of the data sets in each cell of rate and temperature.

    Returns
    -------
    rate_edges, temp_edges : ndarray, shape (r + 1,), (t + 1,)
    mean_dps, count : ndarray, shape (t, r); NaN where a cell is empty
    """
    rates, temps = map_levels(data.sets.rate_dps, data.sets.temp_c)
    row, column = np.empty(len(data.sets), dtype=int), np.empty(len(data.sets), dtype=int)
    for i, level in enumerate(temps):
        row[level.rows] = i
    for i, level in enumerate(rates):
        column[level.rows] = i
    cell = row * len(rates) + column
    count = np.bincount(cell, minlength=len(rates) * len(temps)).astype(float)
    total = np.bincount(cell, weights=data.residual_dps, minlength=count.size)
    mean = np.divide(total, count, out=np.full(count.size, np.nan), where=count > 0)
    shape = len(temps), len(rates)
    return cell_edges(rates), cell_edges(temps), mean.reshape(shape), count.reshape(shape)


@style.styled
def residual_map(data: Examined) -> Figure:
    """Mean residual over rate and temperature, with its means by rate (above) and by temperature (right)."""
    rate_edges, temp_edges, mean, _ = residual_cells(data)
    limit = style.symmetric_limit(mean) * DPS_TO_DPH
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.0)
    axes = figure.subplots(2, 2, width_ratios=(4, 1), height_ratios=(1, 2.6))
    above, corner, centre, right = axes.ravel()
    corner.set_visible(False)
    signed = centre.pcolormesh(
        rate_edges, temp_edges, mean * DPS_TO_DPH, cmap=style.DIVERGING, vmin=-limit, vmax=limit
    )
    centre.plot(data.sets.rate_dps, data.sets.temp_c, ".", color=style.INK, markersize=0.8, alpha=0.6)
    beyond = np.nanmax(np.abs(mean)) * DPS_TO_DPH > limit
    figure.colorbar(
        signed,
        ax=[centre, right],
        location="bottom",
        label="Mean residual, deg/h (dots: where the data sets lie)",
        extend="both" if beyond else "neither",
        aspect=50,
        pad=0.02,
    )
    rates, temps = map_levels(data.sets.rate_dps, data.sets.temp_c)
    above.errorbar(*level_means(data, rates), **_MEANS)
    above.axhline(0.0, color=style.GREY, linewidth=0.6)
    above.set_ylabel("deg/h")
    above.set_title("Mean residual by rate, 95 % interval", fontsize=7.5, fontweight="normal")
    value, mean_dph, half = level_means(data, temps)
    right.errorbar(mean_dph, value, xerr=half, **_MEANS)
    right.axvline(0.0, color=style.GREY, linewidth=0.6)
    right.set_title("by temperature, deg/h", fontsize=7.5, fontweight="normal")
    above.sharex(centre)
    right.sharey(centre)
    centre.set_xlabel("Table rate, deg/s")
    centre.set_ylabel("Gyro temperature, °C")
    centre.set_facecolor("#EFEFEF")
    centre.grid(visible=False)
    return figure


def level_means(data: Examined, found: list[Level]) -> tuple[Floats, Floats, Floats]:
    """Value of each level, mean residual there, and half its 95 % interval, deg/h.

    Not from the scatter about that mean: data sets at one temperature share the drift of the time that they were taken in.
    """
    value = np.array([level.value for level in found])
    mean = np.array([data.residual_dps[level.rows].mean() for level in found])
    variance = np.array([data.covariance_dps2[np.ix_(level.rows, level.rows)].mean() for level in found])
    return value, mean * DPS_TO_DPH, NORMAL_95 * np.sqrt(np.maximum(variance, 0.0)) * DPS_TO_DPH


@style.styled
def residual_over_time(data: Examined) -> Figure:
    """Residual of each data set over time, or over its number where the recording has no times."""
    sets = data.sets
    x: Floats = sets.t_s / S_PER_H if sets.timed else np.arange(1.0, len(sets) + 1)
    residual = data.residual_dps * DPS_TO_DPH
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.axhline(0.0, color=style.GREY, linewidth=0.6)
    _expected(upper, x, residual, NORMAL_95 * data.sigma_dps * DPS_TO_DPH)
    points = _by_temperature(upper, x, residual, data)
    figure.colorbar(points, ax=upper, label="Gyro temp., °C", pad=0.01)
    window = min(_RUNNING, max(3, len(sets) // 8))
    if len(sets) >= 2 * window:
        upper.plot(
            *_running_median(x, residual, window),
            color=style.ORANGE,
            linewidth=1.2,
            label=f"running median of {window}",
        )
    if data.marked.any():
        upper.plot(
            x[data.marked],
            residual[data.marked],
            "o",
            markersize=7,
            markerfacecolor="none",
            markeredgecolor=style.ORANGE,
            markeredgewidth=0.8,
            label="outlier or unsettled",
        )
    if upper.get_legend_handles_labels()[0]:
        upper.legend(loc="upper right", ncols=2)
    upper.set_ylabel("Residual, deg/h")
    lower.plot(x, sets.rate_dps, ".", color=style.BLUE, markersize=2.2)
    lower.set_ylabel("Rate, deg/s")
    lower.set_xlabel("Time since the run began, h" if sets.timed else "Number of the data set, in time order")
    return figure


def _expected(axes: Any, x: Floats, residual: Floats, half: Floats) -> None:
    """What scatter leads one to expect: a bar for each data set, or a band about zero where they are many."""
    if x.size > _MANY:
        axes.fill_between(x, -half, half, color="#E4E4E4", linewidth=0, label="expected, 95 %")
    else:
        axes.errorbar(x, residual, yerr=half, fmt="none", ecolor="#BBBBBB", elinewidth=0.5)


def _by_temperature(axes: Any, x: Floats, residual: Floats, data: Examined) -> Any:
    return axes.scatter(
        x,
        residual,
        c=data.sets.temp_c,
        cmap=style.SEQUENTIAL,
        s=9 if x.size <= _MANY else 4,
        linewidths=0.2,
        edgecolors="white",
        zorder=3,
    )


def _running_median(x: Floats, values: Floats, window: int) -> tuple[Floats, Floats]:
    """Running median over `window` neighbours, with a NaN wherever nothing was recorded for long."""
    half = window // 2
    padded = np.pad(values, half, mode="reflect")
    trend = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    steps = np.diff(x)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    return np.insert(x, gaps, np.nan), np.insert(trend, gaps, np.nan)


@style.styled
def scatter_figure(signed: SignedScatter, tested: ScatterByRate | None) -> Figure:
    """Scatter between data sets by rate, with its trend; rates that stand out are marked."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.4)
    axes = figure.add_subplot()
    rate, between = signed.rate_dps, signed.between_dps * DPS_TO_DPH
    bars = np.stack((signed.between_dps - signed.low_dps, signed.high_dps - signed.between_dps)) * DPS_TO_DPH
    axes.errorbar(rate, between, yerr=bars, label="between data sets at one rate, 95 % interval", **_MEANS)
    if np.isfinite(signed.expected_dps).all():
        axes.plot(
            rate,
            signed.expected_dps * DPS_TO_DPH,
            "^",
            color=style.GREEN,
            markerfacecolor="none",
            label="expected from the noise inside the data sets",
        )
    if tested is not None:
        trend = np.interp(np.abs(rate), tested.rate_dps, usual_trend(tested) * DPS_TO_DPH)
        axes.plot(
            rate,
            trend,
            color=style.GREY,
            linestyle="--",
            label=f"running median of {TREND_RATES} |rates|, ringed ones left out",
        )
        sizes = tested.rate_dps[odd_rates(tested)]
        odd = np.isclose(np.abs(rate)[:, None], sizes, rtol=1e-3, atol=1e-3).any(axis=1)
        _ring(axes, rate[odd], between[odd])
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("Table rate, deg/s")
    axes.set_ylabel("Standard deviation, deg/h")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _ring(axes: Any, x: Floats, y: Floats) -> None:
    """Ring the rates that stand out, with their values."""
    if x.size:
        ring: dict[str, Any] = {"markersize": 8, "markerfacecolor": "none", "markeredgecolor": style.ORANGE}
        axes.plot(x, y, "o", label="more than rates like it", **ring)
    for at, height in zip(x, y, strict=True):
        axes.annotate(
            style.minus(f"{at:+.1f}"),
            (at, height),
            textcoords="offset points",
            xytext=(6, 4),
            fontsize=7,
            color=style.ORANGE,
        )
