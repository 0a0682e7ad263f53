"""The paper's figures: error against rate (1), against temperature (2), and against both, before (3a) and after (3b)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray

from gyrocal.calibration.corrected import Examined
from gyrocal.physics.surface import Surface
from gyrocal.report import style
from gyrocal.report.levels import Floats, Level, levels
from gyrocal.units import DPS_TO_DPH

RATE_LABEL = "Gyro output ω$_g$, deg/s"
TEMPERATURE_LABEL = "Gyro temperature, °C"
ERROR_LABEL = "Error ε = ω$_g$ − ω, deg/s"

#: Curves beyond which a figure is no longer read but admired.
_MOST_CURVES = 9
_GRID = 61
#: Points of one curve beyond which they are drawn small, and the fitted line in another colour to be seen on them.
_MANY = 300


def _temperature_name(level: Level, tight: bool) -> str:
    return style.minus(f"{round(level.value):+d} °C" if tight else f"{level.low:g} to {level.high:g} °C")


def _curve(axes: Any, x: Floats, y: Floats, colour: Any, marker: str, marked: NDArray[np.bool_]) -> None:
    """Points of one level; marked ones hollow."""
    common: dict[str, Any] = {"linestyle": "", "marker": marker, "markeredgewidth": 0.6, "color": colour}
    if x.size > _MANY:
        common |= {"marker": ".", "markersize": 1.5}
    axes.plot(x[~marked], y[~marked], **common)
    axes.plot(x[marked], y[marked], markerfacecolor="white", **common)


@style.styled
def error_against_rate(data: Examined, surface: Surface) -> Figure:
    """Figure 1: error against rate, a curve for each temperature, the fitted surface as lines."""
    found, tight = levels(data.sets.temp_c, most=_MOST_CURVES, bins=7)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.6)
    axes = figure.add_subplot()
    for level, colour, marker in zip(found, style.ordered_colours(len(found)), style.MARKERS, strict=False):
        rows = level.rows
        x = data.sets.gyro_dps[rows]
        _curve(axes, x, data.sets.error_dps[rows], colour, marker, data.marked[rows])
        line = np.linspace(x.min(), x.max(), 201)
        axes.plot(line, surface.error_at_output_dps(line, level.value), color=colour, linewidth=0.9)
        axes.plot([], [], color=colour, marker=marker, label=_temperature_name(level, tight))
    axes.set_xlabel(RATE_LABEL)
    axes.set_ylabel(ERROR_LABEL)
    figure.legend(title="Gyro temperature", loc="outside right upper", reverse=True)
    return figure


@style.styled
def error_against_temperature(data: Examined, surface: Surface) -> Figure:
    """Figure 2: error against temperature at several rates, with the fitted surface as lines."""
    found, _ = levels(data.sets.rate_dps, most=max(2, data.sets.rate_dps.size // 2), bins=9)
    chosen = found
    if len(found) > _MOST_CURVES:
        picks = np.unique(np.linspace(0, len(found) - 1, _MOST_CURVES).round().astype(int))
        chosen = [found[i] for i in picks]
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.6)
    axes = figure.add_subplot()
    for level, colour, marker in zip(chosen, style.ordered_colours(len(chosen)), style.MARKERS, strict=False):
        rows = level.rows
        temp = data.sets.temp_c[rows]
        _curve(axes, temp, data.sets.error_dps[rows], colour, marker, data.marked[rows])
        line = np.linspace(data.sets.temp_c.min(), data.sets.temp_c.max(), 201)
        error = surface.output_dps(level.value, line) - level.value
        ink = style.ORANGE if rows.size > _MANY else colour
        axes.plot(line, error, color=ink, linewidth=0.9, zorder=3)
        axes.plot([], [], color=colour, marker=marker, label=style.minus(f"{level.value:+.1f} deg/s"))
    axes.set_xlabel(TEMPERATURE_LABEL)
    axes.set_ylabel(ERROR_LABEL)
    shown = "Table rate" if len(chosen) == len(found) else f"{len(chosen)} of {len(found)} table rates"
    figure.legend(title=shown, loc="outside right upper", reverse=True)
    return figure


@style.styled
def error_before(data: Examined, surface: Surface) -> Figure:
    """Figure 3a: the error over rate and temperature before calibration, data and fitted surface."""
    gyro, temp = _grid(data)
    height = surface.error_at_output_dps(gyro, temp)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.1)
    spatial: Any = figure.add_subplot(1, 2, 1, projection="3d")
    spatial.plot_surface(
        gyro,
        temp,
        height,
        cmap=style.SEQUENTIAL,
        linewidth=0,
        antialiased=True,
        alpha=0.85,
        rstride=2,
        cstride=2,
    )
    _scatter_3d(spatial, data, data.sets.error_dps)
    _dress_3d(spatial, "Error, deg/s", _height_limits(data, surface))
    flat = figure.add_subplot(1, 2, 2)
    filled = flat.contourf(gyro, temp, height, levels=15, cmap=style.SEQUENTIAL)
    lines = flat.contour(
        gyro, temp, height, levels=np.asarray(filled.levels)[::2], colors="white", linewidths=0.4
    )
    flat.clabel(lines, fontsize=5.5, fmt="%.3g")
    flat.plot(data.sets.gyro_dps, data.sets.temp_c, ".", color="white", markersize=1.2, alpha=0.7)
    _dress_map(flat)
    figure.colorbar(filled, ax=flat, label="Error before, deg/s", pad=0.02)
    return figure


@style.styled
def error_after(data: Examined, surface: Surface) -> Figure:
    """Figure 3b: the error left over rate and temperature, on the height scale of 3a and on its own."""
    gyro, temp = _grid(data)
    highest = float(np.abs(data.residual_dps).max())
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.1)
    scales = (
        ("on the height scale of 3a", 1.0, "deg/s", _height_limits(data, surface)),
        ("on its own scale", DPS_TO_DPH, "deg/h", (-highest, highest)),
    )
    for position, (title, factor, unit, limits) in enumerate(scales, start=1):
        axes: Any = figure.add_subplot(1, 2, position, projection="3d")
        axes.plot_surface(gyro, temp, np.zeros(gyro.shape), color="#BBBBBB", alpha=0.35, linewidth=0)
        _stems(axes, data, factor)
        _dress_3d(axes, f"Error left, {unit}", (limits[0] * factor, limits[1] * factor))
        axes.set_title(title, fontsize=7.5, fontweight="normal", y=1.0)
    return figure


def _stems(axes: Any, data: Examined, factor: float) -> None:
    """Each residual as a head on a thin stem from zero."""
    x, y, z = data.sets.gyro_dps, data.sets.temp_c, data.residual_dps * factor
    feet = np.stack([x, y, np.zeros_like(z)], axis=1)
    heads = np.stack([x, y, z], axis=1)
    axes.add_collection3d(Line3DCollection(np.stack([feet, heads], axis=1), colors="#999999", linewidths=0.3))
    axes.scatter(x, y, z, s=5, color=style.BLUE, linewidths=0, depthshade=False)


def _grid(data: Examined) -> tuple[Floats, Floats]:
    """Grid over the range of the data in gyro output and temperature."""
    gyro = np.linspace(data.sets.gyro_dps.min(), data.sets.gyro_dps.max(), _GRID)
    temp = np.linspace(data.sets.temp_c.min(), data.sets.temp_c.max(), _GRID)
    mesh = np.meshgrid(gyro, temp)
    return mesh[0], mesh[1]


def _height_limits(data: Examined, surface: Surface) -> tuple[float, float]:
    """Limits of the height axis that 3a and 3b share: those of the error before, data and surface."""
    heights = np.concatenate((data.sets.error_dps, surface.error_at_output_dps(*_grid(data)).ravel()))
    limit = float(np.abs(heights).max())
    return -limit, limit


def _scatter_3d(axes: Any, data: Examined, height: Floats) -> None:
    axes.scatter(
        data.sets.gyro_dps, data.sets.temp_c, height, s=2.5, color=style.INK, depthshade=False, linewidths=0
    )


def _dress_3d(axes: Any, label: str, limits: tuple[float, float]) -> None:
    axes.set_xlabel("ω$_g$, deg/s", labelpad=-4)
    axes.set_ylabel("Temp., °C", labelpad=-4)
    axes.set_zlabel(label, labelpad=-3)
    axes.set_zlim(*limits)
    axes.tick_params(pad=-2, labelsize=6)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.zaxis.set_major_locator(MaxNLocator(5))
    axes.view_init(elev=24, azim=-124)
    axes.set_box_aspect((1.25, 1.25, 0.85), zoom=0.9)


def _dress_map(axes: Any) -> None:
    axes.set_xlabel(RATE_LABEL)
    axes.set_ylabel(TEMPERATURE_LABEL)
    axes.grid(visible=False)
