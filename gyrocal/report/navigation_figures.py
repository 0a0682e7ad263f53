"""Figures of a replay: trajectories, errors, innovations, states with their uncertainty, and the table as bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from gyrocal.navigation.align import wrapped_deg
from gyrocal.navigation.replay import LogReplay
from gyrocal.navigation.table import DIRECTIONS, MEASURES, Row, Table
from gyrocal.navigation.track import CONDITIONS, Condition, Track
from gyrocal.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    MARKERS,
    ORANGE,
    SKY,
    TWO_COLUMNS_IN,
    new_figure,
    styled,
)

Floats = NDArray[np.float64]

COLOURS = dict(zip((c.id for c in CONDITIONS), (ORANGE, GREEN, SKY, BLUE), strict=True))
_CW, _CCW = ORANGE, BLUE
#: Points of a curve that a figure can show; more only make the SVG heavy.
_POINTS = 700
#: Errors that differ by more than this do not fit bars on one linear axis: the smallest would be thinner than a line.
_BAR_RANGE = 50.0

#: The constants among the nine states: index, label, factor to the label's unit.
PARAMETERS = (
    (3, "$S_R$, %", 100.0),
    (4, "$S_L$, %", 100.0),
    (5, "$\\delta D$, mm", 1000.0),
    (7, "$\\delta B_s$, %", 100.0),
    (8, "$\\delta B_{rb}$, mdeg/s", 1000.0),
)


def _thin(n: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, n - 1, min(n, _POINTS)).astype(np.int64))


def in_truth_frame(track: Track) -> tuple[Floats, Floats]:
    """Positions of a track in the frame of the truth, or its own where there is none."""
    return track.alignment.apply(track.x_m, track.y_m) if track.alignment else (track.x_m, track.y_m)


@styled
def draw_trajectories(replays: Sequence[LogReplay], table: Table) -> Figure:
    """All runs in each condition, over the truth (the paper's figure 4)."""
    present = [c for c in CONDITIONS if any(r.track(c.id) for r in replays)]
    columns = min(len(present), 4)
    figure = new_figure(TWO_COLUMNS_IN, 3.2 if columns > 2 else 4.0)
    figure.set_layout_engine("compressed")  # panels of equal scale would stand far apart
    panels = figure.subplots(1, columns, sharex=True, sharey=True, squeeze=False)[0]
    for axes, condition in zip(panels, present, strict=True):
        for replay in replays:
            _draw_truth(axes, replay)
        for replay in replays:
            track = replay.track(condition.id)
            if track is not None:
                colour = _CW if replay.direction == "cw" else _CCW
                x, y = in_truth_frame(track)
                rows = _thin(x.size)
                axes.plot(x[rows], y[rows], color=colour, linewidth=0.7, alpha=0.85)
                axes.plot(x[-1], y[-1], "o", color=colour, markersize=2.5)
        mean = table.means[-1].errors_m[condition.id]
        which = ("mean " if len(table.rows) > 1 else "") + ("return" if table.measure == "return" else "end")
        said = "" if np.isnan(mean) else f"\n{which} error\n{_length(mean)}"
        axes.set_title(condition.label.replace(", ", ",\n") + said, fontsize=6.5, fontweight="normal")
        axes.set_xlabel("x, m")
        axes.set_aspect("equal", adjustable="box")
    panels[0].set_ylabel("y, m")
    _legend_of_directions(figure, panels[0], replays)
    return figure


def _length(value_m: float) -> str:
    return f"{value_m:.2f} m" if value_m >= 1.0 else f"{100.0 * value_m:.1f} cm"


def _draw_truth(axes: Axes, replay: LogReplay) -> None:
    known = np.flatnonzero(np.isfinite(replay.truth[:, 0]))
    if known.size:
        rows = known[_thin(known.size)]
        axes.plot(*replay.truth[rows, :2].T, color=GREY, linewidth=1.8, alpha=0.35, solid_capstyle="round")


def _legend_of_directions(figure: Figure, axes: Axes, replays: Sequence[LogReplay]) -> None:
    found = [d for d in DIRECTIONS if any(r.direction == d for r in replays)]
    for direction in found:
        axes.plot([], [], color=_CW if direction == "cw" else _CCW, label=DIRECTIONS[direction])
    if any(np.isfinite(r.truth[:, 0]).any() for r in replays):
        axes.plot([], [], color=GREY, linewidth=1.8, alpha=0.5, label="truth")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)


@styled
def draw_errors(replay: LogReplay) -> Figure:
    """Heading and position error, as far as there is a truth of each, against time, with the filter's own two sigma."""
    tracks = replay.tracks
    drawn = []
    if any(t.heading_errors for t in tracks):
        drawn.append(("heading error, deg", _draw_heading_error))
    if any(t.errors and t.errors.rows for t in tracks):
        drawn.append(("position error, m", _draw_position_error))
    figure = new_figure(TWO_COLUMNS_IN, 2.0 + 1.2 * len(drawn))
    panels = figure.subplots(len(drawn), len(tracks), sharex=True, squeeze=False)
    for column, track in enumerate(tracks):
        for row, (_, draw) in enumerate(drawn):
            draw(panels[row, column], replay, track)
        panels[0, column].set_title(track.condition.label.replace(", ", ",\n"), fontsize=7.5)
        panels[-1, column].set_xlabel("t, s")
    # With and without the filter share a scale; with calibration the errors would vanish on that of those without.
    for calibrated in (False, True):
        pair = [k for k, t in enumerate(tracks) if t.condition.calibrated == calibrated]
        for row in panels[:, pair]:
            limits = np.array([axes.get_ylim() for axes in row])
            for axes in row:
                axes.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    for row, (label, _) in enumerate(drawn):
        panels[row, 0].set_ylabel(label)
    return figure


def _draw_heading_error(axes: Axes, replay: LogReplay, track: Track) -> None:
    rows = np.flatnonzero(np.isfinite(replay.truth[:, 2]))
    rows = rows[_thin(rows.size)]
    # A truth that is wrapped to +-180 deg would otherwise show whole turns as errors.
    rotation = track.alignment.rotation_deg if track.alignment else 0.0
    error = wrapped_deg(track.heading_deg[rows] + rotation - replay.truth[rows, 2])
    t_s = replay.t_s[rows] - replay.t_s[0]
    if track.condition.filtering:
        sigma = track.std[rows, 2]
        axes.fill_between(
            t_s, -2 * sigma, 2 * sigma, color=GREY, alpha=0.3, linewidth=0, label="±2σ of the filter"
        )
        axes.legend(loc="lower left")
    axes.plot(t_s, error, color=COLOURS[track.condition.id])


def _draw_position_error(axes: Axes, replay: LogReplay, track: Track) -> None:
    rows = np.flatnonzero(np.isfinite(replay.truth[:, 0]))
    rows = rows[_thin(rows.size)]
    x, y = in_truth_frame(track)
    error = np.hypot(x[rows] - replay.truth[rows, 0], y[rows] - replay.truth[rows, 1])
    t_s = replay.t_s[rows] - replay.t_s[0]
    if track.condition.filtering:
        sigma = np.hypot(track.std[rows, 0], track.std[rows, 1])
        axes.fill_between(t_s, 0.0, 2 * sigma, color=GREY, alpha=0.3, linewidth=0, label="2σ of the filter")
        axes.legend(loc="upper left")
    axes.plot(t_s, error, color=COLOURS[track.condition.id])


@styled
def draw_innovations(replay: LogReplay) -> Figure:
    """Innovations of the heading difference (eq. 13) with their two-sigma bounds, and how often they leave them."""
    tracks = [t for t in replay.tracks if t.condition.filtering]
    figure = new_figure(TWO_COLUMNS_IN, 2.4)
    panels = figure.subplots(1, len(tracks), sharex=True, sharey=True, squeeze=False)[0]
    for axes, track in zip(panels, tracks, strict=True):
        z, sigma = track.innovation_deg, track.innovation_sigma_deg
        measured = np.flatnonzero(np.isfinite(z))
        outside = float(np.mean(np.abs(z[measured]) > 2 * sigma[measured])) if measured.size else np.nan
        t_s = replay.t_s - replay.t_s[0]
        rows = measured[_thin(measured.size)]
        axes.plot(t_s[rows], z[rows], ".", markersize=1.2, color=COLOURS[track.condition.id])
        for sign in (-2, 2):
            axes.plot(t_s[rows], sign * sigma[rows], color=INK, linewidth=0.5)
        seen = np.maximum(np.quantile(np.abs(z[measured]), 0.995), 2 * np.median(sigma[measured]))
        limit = 1.4 * float(seen) if measured.size else 1.0
        axes.set_ylim(-limit, limit)
        said = f"{outside:.1%} outside ±2σ (Gaussian: 4.6 %), NIS {track.whiteness.nis:.2f}, {track.counts.gated} slips gated"
        axes.set_title(f"{track.condition.label}\n{said}", fontsize=7, fontweight="normal")
        axes.set_xlabel("t, s")
    panels[0].set_ylabel("innovation, deg")
    return figure


def estimated(replay: LogReplay) -> list[tuple[int, str, float]]:
    """Those of `PARAMETERS` that a filter of the replay estimates: the drive model has no scale of the gyro beside the track."""
    stds = [t.std[0] for t in replay.tracks if t.condition.filtering]
    return [p for p in PARAMETERS if any(std[p[0]] > 0.0 for std in stds)]


@styled
def draw_states(replay: LogReplay) -> Figure:
    """The constants that the filter estimates, with two sigma, in each condition with the filter."""
    tracks = [t for t in replay.tracks if t.condition.filtering]
    drawn = estimated(replay)
    figure = new_figure(TWO_COLUMNS_IN, 3.0)
    panels = figure.subplots(1, len(drawn), sharex=True, squeeze=False)[0]
    t_s = replay.t_s - replay.t_s[0]
    rows = _thin(t_s.size)
    for axes, (index, label, factor) in zip(panels, drawn, strict=True):
        for track in tracks:
            if track.std[0, index] == 0.0:
                continue
            value, sigma = factor * track.states[rows, index], factor * track.std[rows, index]
            colour = COLOURS[track.condition.id]
            axes.fill_between(
                t_s[rows], value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.18, linewidth=0
            )
            axes.plot(t_s[rows], value, color=colour, label=track.condition.label)
        axes.set_title(label)
        axes.set_xlabel("t, s")
        axes.tick_params(labelsize=6)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@styled
def draw_bars(table: Table) -> Figure:
    """Table II as bars from zero, or as dots on a logarithmic axis where bars would vanish; dashed: block means."""
    blocks = [m for m in table.means if m.direction != "all"]
    present = [c for c in CONDITIONS if any(np.isfinite(r.errors_m[c.id]) for r in table.rows)]
    figure = new_figure(TWO_COLUMNS_IN, 2.6)
    runs = {m.direction: [r for r in table.rows if r.direction == m.direction] for m in blocks}
    shares = [max(len(runs[m.direction]), 2) for m in blocks]
    panels = figure.subplots(1, len(blocks), sharey=True, squeeze=False, width_ratios=shares)[0]
    logarithmic = bars_vanish(table)
    for axes, mean in zip(panels, blocks, strict=True):
        _draw_block(axes, runs[mean.direction], mean, present, logarithmic)
    if logarithmic:
        panels[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panels[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        panels[0].yaxis.set_minor_locator(NullLocator())
    panels[0].set_ylabel(f"{MEASURES[table.measure].split(',')[0]}, cm")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def bars_vanish(table: Table) -> bool:
    """Whether the errors of a table span so much that the smallest would not be seen as bars from zero."""
    errors = np.array([e for r in table.rows for e in r.errors_m.values() if np.isfinite(e) and e > 0.0])
    return bool(errors.size and errors.max() > _BAR_RANGE * errors.min())


def bars_caption(table: Table) -> str:
    """What a caption must say of `draw_bars` of this table."""
    directions = [r.direction for r in table.rows]
    lines = "; dashed: mean of the block" if len(directions) > len(set(directions)) else ""
    return (", on a logarithmic axis" if bars_vanish(table) else "") + lines


def _draw_block(
    axes: Axes, runs: Sequence[Row], mean: Row, present: Sequence[Condition], logarithmic: bool
) -> None:
    width = 0.8 / max(len(present), 1)
    for k, condition in enumerate(present):
        at = np.arange(len(runs)) + (k - 0.5 * (len(present) - 1)) * width
        errors_cm = [100.0 * r.errors_m[condition.id] for r in runs]
        colour = COLOURS[condition.id]
        if logarithmic:
            axes.plot(at, errors_cm, MARKERS[k], color=colour, markersize=4, label=condition.label)
        else:
            axes.bar(at, errors_cm, width, color=colour, label=condition.label)
        if len(runs) > 1:
            axes.axhline(100.0 * mean.errors_m[condition.id], color=colour, linewidth=0.8, linestyle="--")
    if logarithmic:
        axes.set_yscale("log")
    axes.set_xticks(np.arange(len(runs)), [r.name.replace("$", r"\$") for r in runs])
    axes.set_xlim(-0.7, len(runs) - 0.3)
    axes.set_title(DIRECTIONS[mean.direction])
    axes.grid(visible=False, axis="x")
