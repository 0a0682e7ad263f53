"""Pictures of a drive's diagnosis: the heading rate that the encoders claim beyond the gyro's, before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gyrocal.diagnosis.drive import BLOCK_S
from gyrocal.diagnosis.drive_result import DriveDiagnosis
from gyrocal.diagnosis.folds import clustered_error
from gyrocal.report import style
from gyrocal.report.page import Picture

Floats = NDArray[np.float64]

_BINS = 15
_95 = 1.96


def drive_figures(found: DriveDiagnosis) -> list[tuple[Picture, Figure | None]]:
    """Every picture of a drive's page with its caption."""
    return [
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
                "Mean difference over each coordinate with 95 % intervals from the scatter between blocks of "
                f"{BLOCK_S:g} s, before and after the named physics.",
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
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    t_s, width_s = found.fit.bins.t_s, found.fit.bins.width_s
    for name, rate, colour in _models(found):
        rms = float(np.sqrt(np.mean(rate**2)))
        upper.plot(t_s, rate, ".", markersize=2, color=colour, label=f"{name}: {rms:.3g} deg/s rms")
        lower.plot(t_s, np.cumsum(rate) * width_s, color=colour, label=name)
    limit = 1.2 * style.symmetric_limit(_models(found)[0][1], 0.998)
    upper.set_ylim(-limit, limit)
    upper.set_ylabel("Difference, deg/s")
    upper.legend(loc="upper right", ncols=2, markerscale=3)
    lower.axhline(0.0, color=style.GREY, linewidth=0.6)
    lower.set_ylabel("Summed up, deg")
    lower.set_xlabel("Time, s")
    return figure


@style.styled
def difference_by_coordinate(found: DriveDiagnosis) -> Figure:
    """Mean difference over turn rate, speed, acceleration and heading."""
    bins = found.fit.bins
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.4)
    axes = figure.subplots(2, 2)
    coordinates = (
        ("Turn rate, deg/s", bins.turn_rate_dps),
        ("Speed, m/s", bins.speed_mps),
        ("Acceleration, m/s²", bins.acceleration_mps2),
        ("Heading, deg", bins.heading_deg % 360.0),
    )
    for panel, (label, x) in zip(axes.ravel(), coordinates, strict=True):
        panel.axhline(0.0, color=style.GREY, linewidth=0.6)
        for name, rate, colour in _models(found):
            _means(panel, x, rate, bins.t_s, colour, name)
        panel.set_xlabel(label)
        panel.set_ylabel("Difference, deg/s")
    axes[0, 0].legend()
    return figure


def _means(panel: Axes, x: Floats, y: Floats, t_s: Floats, colour: str, name: str) -> None:
    """Means in equal bins of x; the outer two take what lies beyond the middle 96 %, so that none is nearly empty."""
    use = np.isfinite(x) & np.isfinite(y)
    low, high = np.quantile(x[use], [0.02, 0.98])
    if low == high:
        return
    edges = np.linspace(low, high, _BINS + 1)
    number = np.clip(np.searchsorted(edges, x[use], side="right") - 1, 0, edges.size - 2)
    number = np.unique(number, return_inverse=True)[1]
    blocks = np.unique(t_s[use] // BLOCK_S, return_inverse=True)[1]
    one = np.ones(number.size)
    count = np.bincount(number)
    half = _95 * clustered_error(y[use], one, one, number, blocks)
    panel.errorbar(
        np.bincount(number, x[use]) / count,
        np.bincount(number, y[use]) / count,
        yerr=np.nan_to_num(half),
        fmt="o",
        markersize=3,
        elinewidth=0.8,
        color=colour,
        label=name,
    )


@style.styled
def encoders_against_gyro(found: DriveDiagnosis) -> Figure:
    """Heading rate by encoders over that by gyro, bin by bin."""
    bins = found.fit.bins
    gyro, encoder = bins.gyro_deg / bins.width_s, bins.encoder_deg / bins.width_s
    figure = style.new_figure(style.ONE_COLUMN_IN, 3.2)
    axes = figure.subplots()
    limit = 1.05 * float(np.nanmax(np.abs(gyro), initial=1e-9))
    axes.plot([-limit, limit], [-limit, limit], color=style.GREY, linewidth=0.8, label="equal")
    axes.plot(gyro, encoder, ".", markersize=2, color=style.BLUE)
    axes.set_xlabel("Heading rate by the gyro, deg/s")
    axes.set_ylabel("by the encoders, deg/s")
    axes.legend()
    return figure
