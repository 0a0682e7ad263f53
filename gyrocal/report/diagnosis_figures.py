"""Pictures of a diagnosis: recorded against simulated, where the excess lives, and each effect before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from gyrocal.diagnosis.result import Diagnosis, NamedEffect, Rows
from gyrocal.report import style
from gyrocal.report.diagnosis_marks import PALE, bars, legend_above, limit_around_zero, zero_line
from gyrocal.report.folds import Floats, Fold, bin_rows, fold_of
from gyrocal.report.levels import cell_edges, map_levels
from gyrocal.report.sentences import counted, has_times
from gyrocal.report.words import fixed
from gyrocal.units import MDPS, NORMAL_95, S_PER_H, decimals

_BIN_TIME_S = 60.0
#: Before and after are drawn beside each other, so that neither hides the other; share of a bin.
_APART = 0.14
#: Length of the linear part of a logarithmic axis to either side of zero, in decades.
_LINEAR_DECADES = 1.0


def _hours(rows: Rows) -> Floats:
    return np.asarray((rows.t_s - rows.t_s[0]) / S_PER_H)


@style.styled
def recorded_and_simulated(diagnosis: Diagnosis, rows: Rows) -> Figure:
    """Error of the gyro as recorded and as the model simulates it over the same sequence; below, the difference."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.2)
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, 1))
    x, label = _time_axis(diagnosis, rows)
    simulated = np.zeros(rows.t_s.size)
    if diagnosis.surface is not None:
        surface = diagnosis.surface.surface
        simulated = surface.output_dps(rows.rate_dps, rows.temp_c) - rows.rate_dps
    upper.plot(x, simulated + rows.before_dps, ".", markersize=5, color=PALE, label="recorded")
    upper.plot(x, simulated, ".", markersize=1.2, color=style.BLUE, label="simulated: surface alone")
    upper.set_ylabel("Output - rate, deg/s")
    legend_above(upper, 2)
    set_x, set_y = _per_set(x, rows.before_dps, rows)
    zero_line(middle)
    if set_x.size < x.size:
        middle.plot(x, rows.before_dps / MDPS, ".", markersize=0.8, color=PALE, label="row", rasterized=True)
    middle.plot(set_x, set_y / MDPS, ".", markersize=2.5, color=style.ORANGE, label=counted(diagnosis).means)
    # Ramps are segments too; within them the minute means show what lives there.
    limit_around_zero(middle, np.concatenate([set_y, _smoothed(rows.before_dps, rows)]) / MDPS)
    middle.set_ylabel("Recorded -\nsimulated, mdeg/s")
    legend_above(middle, 2)
    lower.plot(x, rows.temp_c, ".", markersize=0.8, color=style.INK)
    lower.set_ylabel("Gyro, °C")
    lower.set_xlabel(label)
    return figure


def _time_axis(diagnosis: Diagnosis, rows: Rows) -> tuple[Floats, str]:
    if has_times(diagnosis):
        return _hours(rows), "Time, h"
    return np.arange(1.0, rows.t_s.size + 1), "Data set, in the order recorded"


def _per_set(x: Floats, values: Floats, rows: Rows) -> tuple[Floats, Floats]:
    """Mean place and weighted mean value of each segment."""
    _, number = np.unique(rows.set_index, return_inverse=True)
    weight = 1.0 / rows.white_std_dps**2
    total = np.bincount(number, weight)
    place = np.bincount(number, x * weight) / total
    return np.asarray(place), np.asarray(np.bincount(number, values * weight) / total)


def _smoothed(values: Floats, rows: Rows) -> Floats:
    """Means over a minute (or a data set): the scale of a picture, without the noise of single rows."""
    minute = ((rows.t_s - rows.t_s[0]) // _BIN_TIME_S).astype(np.int64)
    _, number = np.unique(minute * (rows.set_index.max() + 1) + rows.set_index, return_inverse=True)
    weight = 1.0 / rows.white_std_dps**2
    return np.asarray(np.bincount(number, values * weight) / np.bincount(number, weight))


def has_surface(rows: Rows) -> bool:
    """Whether data sets at more than one rate are there to map."""
    chosen = rows.is_set & np.isfinite(rows.before_dps)
    return bool(chosen.any() and np.ptp(rows.rate_dps[chosen]) > 0)


def turning(rows: Rows) -> NDArray[np.bool_]:
    """Rows with a known table angle while the table turns, shape (n,)."""
    return np.asarray(np.isfinite(rows.angle_deg) & (rows.rate_dps != 0) & np.isfinite(rows.before_dps))


@style.styled
def residual_maps(diagnosis: Diagnosis, rows: Rows) -> Figure:
    """Mean residual of the data sets over rate and temperature, before and after."""
    chosen = rows.is_set & np.isfinite(rows.before_dps)
    panels = [("Surface alone", rows.before_dps)]
    if diagnosis.effects:
        panels.append(("Surface and named physics", rows.after_dps))
    maps = [_cells(rows, values, chosen) for _, values in panels]
    limit = style.symmetric_limit(maps[0][2]) / MDPS
    figure = style.new_figure(style.TWO_COLUMNS_IN if len(panels) > 1 else 4.5, 2.9)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for panel, (title, _), (rates, temps, mean) in zip(axes, panels, maps, strict=True):
        drawn = panel.pcolormesh(
            rates, temps, mean / MDPS, cmap=style.DIVERGING, vmin=-limit, vmax=limit, rasterized=True
        )
        panel.set_title(f"{title}: {np.sqrt(np.nanmean(mean**2)) / MDPS:.2f} mdeg/s rms")
        panel.set_xlabel("Table rate, deg/s")
        panel.set_facecolor("#EFEFEF")
        panel.grid(visible=False)
    axes[0].set_ylabel("Gyro temperature, °C")
    figure.colorbar(drawn, ax=list(axes), label="Mean residual, mdeg/s", extend="both", pad=0.01)
    return figure


def _cells(rows: Rows, values: Floats, chosen: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    _, number = np.unique(rows.set_index[chosen], return_inverse=True)
    weight = 1.0 / rows.white_std_dps[chosen] ** 2
    total = np.bincount(number, weight)
    rate, temp, mean = (
        np.asarray(np.bincount(number, v[chosen] * weight) / total)
        for v in (rows.rate_dps, rows.temp_c, values)
    )
    rates, temps = map_levels(rate, temp)
    table = np.full((len(temps), len(rates)), np.nan)
    for i, level in enumerate(temps):
        for j, column in enumerate(rates):
            inside = np.intersect1d(level.rows, column.rows)
            if inside.size:
                table[i, j] = mean[inside].mean()
    return cell_edges(rates), cell_edges(temps), table


@style.styled
def residual_over_time(diagnosis: Diagnosis, rows: Rows) -> Figure:
    """Minute means of the residual over time, before and after."""
    panels = [("Surface alone", rows.before_dps, style.ORANGE)]
    if diagnosis.effects:
        panels.append(("Surface and named physics", rows.after_dps, style.BLUE))
    figure = style.new_figure(style.TWO_COLUMNS_IN, 1.9 * len(panels) + 0.3)
    axes = figure.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    x, label = _time_axis(diagnosis, rows)
    minutes = _smoothed(x, rows)
    held = _smoothed(rows.is_set.astype(np.float64), rows) > 0.5
    means = counted(diagnosis).means if minutes.size == x.size else "minute means"
    for panel, (title, values, colour) in zip(axes, panels, strict=True):
        y = _smoothed(values, rows) / MDPS
        zero_line(panel)
        if not held.all():
            panel.plot(
                minutes[~held], y[~held], ".", color=style.GREY, markersize=2, label="ramps, soaks and rests"
            )
            panel.plot(minutes[held], y[held], ".", color=colour, markersize=3, label="data sets")
        else:
            panel.plot(minutes, y, ".", color=colour, markersize=3)
        panel.set_title(f"{title}: {np.sqrt(np.mean(y**2)):.3g} mdeg/s rms of {means}")
        panel.set_ylabel("Residual, mdeg/s")
        if not held.all():
            legend_above(panel, 2)
    limit_around_zero(axes[0], _smoothed(rows.before_dps, rows) / MDPS, 0.998)
    axes[-1].set_xlabel(label)
    return figure


@style.styled
def residual_over_angle(diagnosis: Diagnosis, rows: Rows) -> Figure:
    """The residual over one turn of the table, each data set's mean taken out."""
    use = turning(rows)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.8)
    constant, with_rate = figure.subplots(1, 2)
    bins, x = bin_rows(rows.angle_deg[use] % 360.0)
    _, sets = np.unique(rows.set_index[use], return_inverse=True)
    weight = 1.0 / rows.white_std_dps[use] ** 2
    apart = _APART * 360.0 / x.size if diagnosis.effects else 0.0
    models = [("surface alone", rows.before_dps, style.ORANGE, -apart)]
    if diagnosis.effects:
        models.append(("surface and named physics", rows.after_dps, style.BLUE, apart))
    for panel, gain, unit in (
        (constant, np.full(use.sum(), MDPS), "Residual, mdeg/s"),
        (with_rate, MDPS * rows.rate_dps[use] / 100.0, "Residual ÷ rate,\nmdeg/s at 100 deg/s"),
    ):
        zero_line(panel)
        information = np.bincount(bins, gain**2 * weight)
        for name, values, colour, shift in models:
            v = values[use]
            v = v - (np.bincount(sets, v * weight) / np.bincount(sets, weight))[sets]
            mean = np.bincount(bins, v * gain * weight) / information
            bars(panel, x + shift, mean, NORMAL_95 / np.sqrt(information), colour, name)
        panel.set_xlabel("Table angle, deg")
        panel.set_ylabel(unit)
        panel.set_xticks(range(0, 361, 60))
    constant.set_title("Same size at every rate")
    with_rate.set_title("Growing with rate")
    figure.legend(*constant.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


@style.styled
def before_and_after(folded: Fold, effect: NamedEffect) -> Figure:
    """An effect on its own coordinate: the residual before with the effect's law, and what is left after."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.6)
    left, right = figure.subplots(1, 2, sharey=True, sharex=True)
    half = NORMAL_95 * folded.std_error
    before, after, noise = folded.rms()
    places = decimals(noise)
    for panel, y, colour, title, rms in (
        (left, folded.before, style.ORANGE, "Before", before),
        (right, folded.after, style.BLUE, "After", after),
    ):
        zero_line(panel)
        bars(panel, folded.x, y, half, colour)
        panel.set_title(f"{title}: rms {fixed(rms, places)}")
        panel.set_xlabel(folded.coordinate.label)
    within = folded.coordinate.linear_within
    if within > 0:
        left.set_xscale("symlog", linthresh=within, linscale=_LINEAR_DECADES)
        decades = 10.0 ** np.arange(np.ceil(np.log10(within)), np.log10(np.abs(folded.x).max()) + 0.5)
        left.set_xticks([*-decades[::-1], 0.0, *decades])
        left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        left.xaxis.set_minor_locator(NullLocator())
        for panel in (left, right):
            panel.axvspan(-within, within, color=PALE, alpha=0.3, linewidth=0, zorder=0)
        right.patches[-1].set_label(f"± {within:.2g}, on a linear scale")
        legend_above(right)
    order = np.argsort(folded.x)
    left.plot(folded.x[order], folded.law[order], color=style.INK, linewidth=1.0, label=effect.effect)
    legend_above(left)
    left.set_ylabel(f"Residual, {folded.coordinate.unit}")
    return figure


def effect_figure(diagnosis: Diagnosis, effect: NamedEffect) -> Figure | None:
    """Picture of one named effect; None where the record has no coordinate to fold it on."""
    folded = fold_of(diagnosis, effect)
    return None if folded is None else before_and_after(folded, effect)
