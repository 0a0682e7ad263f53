"""Allan deviation of the record at rest, with intervals and the parts of the noise that it resolves."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from gyrocal.calibration.corrected import Floats
from gyrocal.calibration.figure import Interval, value_said
from gyrocal.calibration.noise import NoiseFigures
from gyrocal.report import style
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPS_TO_DPH

#: Flat part of the Allan deviation over the bias instability B: sqrt(2 ln 2 / pi) (IEEE 952, annex C).
_FLAT = float(np.sqrt(2.0 * np.log(2.0) / np.pi))


def _minor_label(value: float, _: object) -> str:
    """2 and 5 of each decade; more would not fit."""
    leading = value / 10.0 ** np.floor(np.log10(value) + 1e-9)
    return f"{value:g}" if round(float(leading)) in (2, 5) else ""


@style.styled
def allan_deviation(noise: NoiseFigures) -> Figure:
    """Allan deviation over averaging time, log-log, in deg/h; `noise` has points."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.6)
    axes = figure.add_subplot()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for points, marker in zip(noise.points, style.MARKERS, strict=False):
        adev = points.adev_dps * DPS_TO_DPH
        bars = np.stack((points.adev_dps - points.low_dps, points.high_dps - points.adev_dps)) * DPS_TO_DPH
        common: dict[str, Any] = {"fmt": marker, "color": style.BLUE, "ecolor": "#9BC4DE", "elinewidth": 0.9}
        label = f"measured, samples of {points.dt_s:g} s, 95 % interval"
        axes.errorbar(points.tau_s, adev, yerr=bars, label=label, **common)
    low = min(float(p.tau_s.min()) for p in noise.points)
    high = max(float(p.tau_s.max()) for p in noise.points)
    tau = np.geomspace(low, high, 101)
    if noise.model is not None:
        axes.plot(tau, noise.model_dps(tau) * DPS_TO_DPH, color=style.INK, label="fitted model")
    # The data set the frame: a line that runs far out of it would squeeze them.
    axes.set_ylim(*axes.get_ylim())
    if noise.angle_random_walk_deg_per_rt_h is not None:
        slope = DEG_PER_RT_H_TO_DPS_PER_RT_HZ * DPS_TO_DPH / np.sqrt(tau)
        name = "angle random walk {} deg/√h"
        _part(axes, tau, slope, noise.angle_random_walk_deg_per_rt_h, style.ORANGE, name)
    if noise.bias_instability_deg_per_h is not None:
        flat = np.full(tau.shape, _FLAT)
        name = f"bias instability B = {{}} deg/h; line at {_FLAT:.3f} B"
        _part(axes, tau, flat, noise.bias_instability_deg_per_h, style.GREEN, name)
    axes.set_xlabel("Averaging time τ, s")
    axes.set_ylabel("Allan deviation, deg/h")
    axes.grid(which="minor", linewidth=0.2)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(FuncFormatter(_minor_label))
    axes.legend(loc="best")
    return figure


def _part(axes: Axes, tau_s: Floats, unit: Floats, interval: Interval, colour: str, name: str) -> None:
    """Line of one part of the noise with the band of its interval."""
    value, low, high = interval
    axes.plot(tau_s, value * unit, color=colour, linestyle="--", label=name.format(value_said(*interval)))
    axes.fill_between(tau_s, low * unit, high * unit, color=colour, alpha=0.15, linewidth=0)
