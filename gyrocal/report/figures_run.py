"""The run's course in time, its noise, and the coefficients with their uncertainty."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gyrocal.calibration.corrected import Floats, Timeline
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.surface import SHAPE
from gyrocal.report import style
from gyrocal.units import S_PER_H

_FILLS = {"unsettled": (style.ORANGE, 0.25, "///"), "failed": ("#444444", 0.35, "xxx")}

#: Kinds of segment that give data sets.
_DATA_SETS = ("rate", "static")


@style.styled
def run_timeline(timeline: Timeline) -> Figure:
    """Chamber and gyro temperature, table rate and, where it was logged, supply over time; unsettled segments marked."""
    with_supply = timeline.supply_v.size > 1
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.3 if with_supply else 3.6)
    panels = figure.subplots(
        3 if with_supply else 2, 1, sharex=True, height_ratios=(2, 1.3, 0.8)[: 3 if with_supply else 2]
    )
    warm, rate = panels[0], panels[1]
    if timeline.chamber_temp_c.size:
        warm.plot(
            timeline.chamber_t_s / S_PER_H,
            timeline.chamber_temp_c,
            color=style.SKY,
            linewidth=0.8,
            label="chamber air",
        )
    warm.plot(timeline.gyro_temp_t_s / S_PER_H, timeline.gyro_temp_c, color=style.ORANGE, label="gyro")
    warm.set_ylabel("Temperature, °C")
    x, y = _rate_steps(timeline)
    rate.plot(x, y, color=style.BLUE, linewidth=1.5, solid_capstyle="butt")
    # A data set lasts seconds of a run of hours: its line alone is a dot that nobody sees.
    sets = [s for s in timeline.spans if s.kind in _DATA_SETS]
    middle_h = [0.5 * (s.start_s + s.end_s) / S_PER_H for s in sets]
    rate.plot(middle_h, [s.rate_dps for s in sets], "o", color=style.BLUE, markersize=2.5)
    rate.set_ylabel("Table rate, deg/s")
    if with_supply:
        panels[2].plot(timeline.supply_t_s / S_PER_H, timeline.supply_v, color=style.GREEN, linewidth=0.6)
        panels[2].set_ylabel("Supply, V")
    marked = []
    for outcome, (colour, alpha, hatch) in _FILLS.items():
        spans = [s for s in timeline.spans if s.outcome == outcome]
        for span in spans:
            for axes in panels:
                axes.axvspan(
                    span.start_s / S_PER_H,
                    span.end_s / S_PER_H,
                    color=colour,
                    alpha=alpha,
                    hatch=hatch,
                    linewidth=0,
                )
            axes = panels[1]
            axes.plot(
                0.5 * (span.start_s + span.end_s) / S_PER_H, span.rate_dps, "v", color=colour, markersize=4
            )
        if spans:
            marked.append(Patch(color=colour, alpha=alpha, hatch=hatch, label=f"{outcome} ({len(spans)})"))
    panels[-1].set_xlabel("Time since the run began, h")
    warm.legend(handles=[*warm.get_legend_handles_labels()[0], *marked], loc="upper right", ncols=4)
    warm.margins(y=0.18)
    return figure


def _rate_steps(timeline: Timeline) -> tuple[Floats, Floats]:
    """Corners of the rate over time, h and deg/s: constant in a segment, NaN between segments."""
    x = [edge for s in timeline.spans for edge in (s.start_s, s.end_s, s.end_s)]
    y = [edge for s in timeline.spans for edge in (s.rate_dps, s.rate_dps, np.nan)]
    return np.array(x) / S_PER_H, np.array(y)


@style.styled
def coefficient_figure(coefficients: Coefficients) -> Figure:
    """The twelve coefficients with their standard errors; shade: how far each is from zero."""
    value = coefficients.surface.coefficients_dps
    sigma = np.sqrt(np.maximum(np.diag(coefficients.covariance_dps2), 0.0)).reshape(SHAPE)
    size = np.abs(value) / np.maximum(sigma, np.finfo(float).tiny)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.6)
    axes = figure.add_subplot()
    top = max(float(size.max()), 10.0)
    norm = LogNorm(1.0, top, clip=True)
    image = axes.imshow(size, cmap=style.SEQUENTIAL, norm=norm, aspect="auto")
    colours = mpl.colormaps[style.SEQUENTIAL]
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            dark = sum(colours(norm(size[i, j]))[:3]) < 1.5
            fitted = value[i, j] != 0 or sigma[i, j] > 0
            text = f"{value[i, j]:+.6f}\n± {sigma[i, j]:.6f}" if fitted else "not fitted"
            axes.text(
                j, i, text, ha="center", va="center", fontsize=7.5, color="white" if dark else style.INK
            )
    axes.set_xticks(range(SHAPE[1]), [f"$v^{j}$" for j in range(SHAPE[1])])
    axes.set_yticks(range(SHAPE[0]), [f"$u^{i}$" for i in range(SHAPE[0])])
    axes.set_xlabel("Power of scaled temperature v")
    of = "output" if coefficients.surface.direction == "output" else "true rate"
    axes.set_ylabel(f"Power of scaled {of} u")
    axes.set_title("Value ± standard error, deg/s", fontsize=7.5, fontweight="normal")
    axes.grid(visible=False)
    axes.tick_params(length=0)
    figure.colorbar(image, ax=axes, label="|value| / standard error", pad=0.02)
    return figure
