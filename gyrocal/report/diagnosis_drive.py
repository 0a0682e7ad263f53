"""Pictures of a drive's diagnosis: paths before and after, and the heading rate that the encoders claim beyond the gyro's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.engine import DriveDiagnosis, Shown
from gyrocal.diagnosis.drive.laws import temperature_c
from gyrocal.diagnosis.drive.reckoning import rest_mean_dps
from gyrocal.diagnosis.result import NamedEffect
from gyrocal.physics.drive import BIAS_TEMPERATURE, GYRO_BIAS, GYRO_DELAY, SKID_SLIP, WHEEL_ASYMMETRY
from gyrocal.report import style
from gyrocal.report.diagnosis_marks import bars, legend_above, limit_around_zero, zero_line
from gyrocal.report.folds import clustered_error
from gyrocal.report.page import Picture
from gyrocal.report.remarks import statement
from gyrocal.report.words import part_words
from gyrocal.units import DEG_TO_RAD, NORMAL_95, RAD_TO_DEG

Floats = NDArray[np.float64]

#: Intervals are drawn in sums of a second; blocks of these count as independent of each other.
_SECOND_S, BLOCK_S = 1.0, 10.0
_BINS = 15
#: Before and after are drawn beside each other; share of the distance between bins.
_APART = 0.12
_STANDING_MPS = 0.01


@dataclass(frozen=True)
class Seconds:
    """The heading difference in bins of about a second, arrays of shape (m,); rates in deg/s.

    `before` is encoders less gyro as a navigator has them (bias of the rest taken off), `after` what no law explains,
    `law` what each law adds; `used` is false where a wheel slipped.
    """

    t_s: Floats
    width_s: Floats
    before: Floats
    after: Floats
    law: dict[str, Floats]
    gyro: Floats
    turn_rate: Floats
    change: Floats
    speed: Floats
    acceleration: Floats
    heading: Floats
    temp_c: Floats
    used: NDArray[np.bool_]

    @property
    def curvature(self) -> Floats:
        """Turn rate over speed, rad/m; 0 where the robot stands."""
        moving = np.abs(self.speed) > _STANDING_MPS
        return np.divide(DEG_TO_RAD * self.turn_rate, self.speed, out=np.zeros_like(self.speed), where=moving)


def seconds_of(found: DriveDiagnosis) -> Seconds:
    """Bins of a drive."""
    yaw, series = found.yaw, found.series
    nodes, c = yaw.model.frame.nodes, yaw.model.frame.conditions
    number = np.unique(np.floor((nodes.t_s - series.t_s[0]) / _SECOND_S), return_inverse=True)[1]

    def summed(x: Floats) -> Floats:
        return np.asarray(np.bincount(number, x))

    def rate(turn_rad: Floats) -> Floats:
        return np.asarray(RAD_TO_DEG * summed(turn_rad) / width)

    width = np.maximum(summed(nodes.dt_s), 1e-6)
    rest = rest_mean_dps(series)
    bias_rad = 0.0 if rest is None else DEG_TO_RAD * rest[0]
    plain = nodes.between(series.encoder_rad - series.gyro_rad)
    laws = {n: rate(yaw.law_rad(n)) for n in yaw.chosen}
    if "delay" in laws:
        # With what was taken out before the fit: the shift, and the window of the encoders.
        laws["delay"] += rate(plain - yaw.model.y)
    turn = nodes.between(np.cumsum(c.gyro_yaw_rad))
    way = summed(nodes.between(np.cumsum(c.distance_m)))
    temp = temperature_c(series)
    late = yaw.laws["delay"].column if "delay" in yaw.laws else np.zeros(turn.size)
    middle = summed(nodes.t_s) / np.bincount(number)
    used = np.ones(width.size, dtype=bool)
    used[number[yaw.model.outliers]] = False
    speed = way / width
    return Seconds(
        middle, width, rate(plain + bias_rad * nodes.dt_s), rate(yaw.left_rad), laws, rate(nodes.between(series.gyro_rad) - bias_rad * nodes.dt_s),
        rate(turn), rate(late), speed, np.gradient(speed, middle), np.cumsum(RAD_TO_DEG * summed(turn)),
        np.full(width.size, np.nan) if temp is None else np.interp(middle, series.t_s, temp), used,
    )  # fmt: skip


def drive_figures(found: DriveDiagnosis) -> list[tuple[Picture, Figure | None]]:
    """Every picture of a drive's page with its caption."""
    seconds = seconds_of(found)
    drawn: list[tuple[Picture, Figure | None]] = []
    for number, shown in enumerate(found.shown):
        part = part_words(shown.log, shown.from_share)
        caption = (
            f"{part[0].upper()}{part[1:]}: distance by the encoders along the gyro's heading, with the robot file as "
            "it is and with what was found taken out, and the truth where there is one. The figures were not fitted to it."
        )
        drawn.append((Picture(f"paths_{number + 1}", "Paths before and after", caption), paths(shown)))
    if not found.series.differential:
        return drawn
    intervals = f"95 % intervals from the scatter between blocks of {BLOCK_S:g} s"
    drawn += [
        (
            Picture(
                "difference",
                "Encoders less gyro over time",
                "Above: heading rate by the encoders less that by the gyro, by the second. Below: the same difference "
                "summed up, which is the heading error of one against the other.",
            ),
            difference_over_time(found, seconds),
        ),
        (
            Picture(
                "coordinates",
                "Where the difference lives",
                f"Mean difference over each coordinate, before and after the fitted laws; {intervals}, of all bins "
                "together where a bin has fewer than three.",
            ),
            difference_by_coordinate(seconds),
        ),
        (
            Picture(
                "turns",
                "Encoders against gyro",
                "Heading rate by the encoders over that by the gyro; the line is equality. Slip and a wrong wheel "
                "separation tilt the cloud, a delay opens it.",
            ),
            encoders_against_gyro(seconds),
        ),
    ]
    for effect in found.diagnosis.effects:
        name = next((n for n in found.yaw.named if found.yaw.laws[n].effect == effect.effect), None)
        if name is None or effect.effect not in _OWN:
            continue
        caption = (
            f"{statement(effect)} Means over its own coordinate with all other fitted laws taken out: left the "
            f"difference and the effect's law, right what is left; {intervals}."
        )
        picture = Picture(f"effect_{effect.effect}", f"{effect.effect}, before and after", caption)
        drawn.append((picture, effect_before_and_after(seconds, effect, name)))
    return drawn


@style.styled
def paths(shown: Shown) -> Figure:
    """Reckoned paths before and after, and the truth."""
    figure = style.new_figure(style.ONE_COLUMN_IN, 3.5)
    panel = figure.subplots()
    known = np.isfinite(shown.truth)
    if known.any():
        panel.plot(
            shown.truth[known].real,
            shown.truth[known].imag,
            ".",
            markersize=2,
            color=style.INK,
            label="truth",
        )
    for path, error, colour, name in (
        (shown.before, shown.before_m, style.ORANGE, "robot file"),
        (shown.after, shown.after_m, style.BLUE, "improved"),
    ):
        said = f"{name}: {error:.3g} m rms" if np.isfinite(error) else name
        panel.plot(path.real, path.imag, color=colour, linewidth=0.8, label=said)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("x, m")
    panel.set_ylabel("y, m")
    # Above the whole figure: the panel alone is not as wide as the names. Points of truth are too small to be told there.
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=2, markerscale=3.0)
    return figure


@style.styled
def difference_over_time(found: DriveDiagnosis, seconds: Seconds) -> Figure:
    """Difference of heading rates, and its sum, over time."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.7)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for name, rate, colour in _models(seconds):
        rms = float(np.sqrt(np.mean(rate[seconds.used] ** 2)))
        upper.plot(seconds.t_s, rate, ".", markersize=2, color=colour, label=f"{name}: {rms:.3g} deg/s rms")
        lower.plot(seconds.t_s, np.cumsum(rate * seconds.width_s), color=colour)
    slipped = ~seconds.used
    if slipped.any():
        label = "slip, left out of the fit"
        upper.plot(
            seconds.t_s[slipped], seconds.after[slipped], "x", markersize=4, color=style.INK, label=label
        )
    limit_around_zero(upper, seconds.before, 0.998)
    upper.set_ylabel("Difference, deg/s")
    legend_above(upper)
    zero_line(lower)
    lower.set_ylabel("Summed up, deg")
    lower.set_xlabel("Time, s")
    return figure


def _models(seconds: Seconds) -> list[tuple[str, Floats, str]]:
    return [
        ("robot file", seconds.before, style.ORANGE),
        ("with the fitted laws", seconds.after, style.BLUE),
    ]


@style.styled
def difference_by_coordinate(seconds: Seconds) -> Figure:
    """Mean difference over turn rate and its change, curvature, speed, acceleration and heading."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.6)
    axes = figure.subplots(2, 3)
    coordinates = (
        ("Turn rate, deg/s", seconds.turn_rate),
        ("Change of turn rate, deg/s²", seconds.change),
        ("Curvature, rad/m", seconds.curvature),
        ("Speed, m/s", seconds.speed),
        ("Acceleration, m/s²", seconds.acceleration),
        ("Heading, deg", seconds.heading % 360.0),
    )
    models = _models(seconds)
    for panel, (label, x) in zip(axes.ravel(), coordinates, strict=True):
        zero_line(panel)
        for k, (name, rate, colour) in enumerate(models):
            means = _means(seconds, x, rate)
            if means is not None:
                place, mean, half = means
                apart = _APART * float(np.median(np.diff(place))) if place.size > 1 else 0.0
                bars(panel, place + (2 * k - 1) * apart, mean, half, colour, name)
        panel.set_xlabel(label)
    for panel in axes[:, 0]:
        panel.set_ylabel("Difference, deg/s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def _means(seconds: Seconds, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Places, means and half widths of 95 % in equal bins of x, without slips; None where x does not change.

    The outer two take what lies beyond the middle 96 %, so that none is nearly empty.
    """
    use = np.isfinite(x) & np.isfinite(y) & seconds.used
    low, high = np.quantile(x[use], [0.02, 0.98]) if use.any() else (0.0, 0.0)
    if low == high:
        return None
    edges = np.linspace(low, high, _BINS + 1)
    number = np.clip(np.searchsorted(edges, x[use], side="right") - 1, 0, edges.size - 2)
    number = np.unique(number, return_inverse=True)[1]
    blocks = np.unique(seconds.t_s[use] // BLOCK_S, return_inverse=True)[1]
    one = np.ones(number.size)
    count = np.bincount(number)
    half = NORMAL_95 * clustered_error(y[use], one, one, number, blocks)
    return (
        np.asarray(np.bincount(number, x[use]) / count),
        np.asarray(np.bincount(number, y[use]) / count),
        half,
    )


@style.styled
def encoders_against_gyro(seconds: Seconds) -> Figure:
    """Heading rate by encoders over that by gyro, by the second, before and after."""
    figure = style.new_figure(style.TWO_COLUMNS_IN, 3.3)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    clouds = [
        (gyro, gyro + rate, name, colour)
        for gyro, (name, rate, colour) in zip(
            (seconds.gyro, seconds.turn_rate), _models(seconds), strict=True
        )
    ]
    limit = 1.05 * max(float(np.max(np.abs(cloud[:2]))) for cloud in clouds)
    for panel, (gyro, encoder, name, colour) in zip(axes, clouds, strict=True):
        panel.plot([-limit, limit], [-limit, limit], color=style.GREY, linewidth=0.8)
        panel.plot(gyro, encoder, ".", markersize=2, color=colour)
        panel.set_aspect("equal")
        panel.set_title(name[0].upper() + name[1:])
        panel.set_xlabel("Heading rate by the gyro, deg/s")
    axes[0].set_ylabel("by the encoders, deg/s")
    return figure


#: Where each law shows: label, and its coordinate in every bin.
_OWN: dict[str, tuple[str, Callable[[Seconds], Floats]]] = {
    GYRO_DELAY.id: ("Change of the turn rate, deg/s²", lambda s: s.change),
    SKID_SLIP.id: ("Turn rate, deg/s", lambda s: s.turn_rate),
    WHEEL_ASYMMETRY.id: ("Speed, m/s", lambda s: s.speed),
    GYRO_BIAS.id: ("Time, s", lambda s: s.t_s),
    BIAS_TEMPERATURE.id: ("Gyro temperature, °C", lambda s: s.temp_c),
}


@style.styled
def effect_before_and_after(seconds: Seconds, effect: NamedEffect, name: str) -> Figure:
    """An effect on its own coordinate: the difference with all other laws taken out, and what is left."""
    label, coordinate = _OWN[effect.effect]
    x, law = coordinate(seconds), seconds.law[name]
    figure = style.new_figure(style.TWO_COLUMNS_IN, 2.6)
    left, right = figure.subplots(1, 2, sharey=True, sharex=True)
    for panel, y, colour, title in (
        (left, seconds.after + law, style.ORANGE, "Before"),
        (right, seconds.after, style.BLUE, "After"),
    ):
        zero_line(panel)
        _draw_means(panel, _means(seconds, x, y), colour)
        panel.set_title(title)
        panel.set_xlabel(label)
    curve = _means(seconds, x, law)
    if curve is not None:
        left.plot(curve[0], curve[1], color=style.INK, linewidth=1.0, label=effect.effect)
        legend_above(left)
    left.set_ylabel("Difference, deg/s")
    return figure


def _draw_means(panel: Axes, means: tuple[Floats, Floats, Floats] | None, colour: str) -> None:
    if means is not None:
        bars(panel, *means, colour)
