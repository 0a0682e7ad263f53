"""Marks that the pictures of a diagnosis share: legends beside the data, points with error bars, limits that say what they cut."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from gyrocal.report import style

Floats = NDArray[np.float64]

#: What stands behind.
PALE = "#BDBDBD"
_BARS: dict[str, Any] = {"fmt": "o", "markersize": 3.0, "elinewidth": 0.8, "capsize": 0.0}
#: A scale may be so many times wider than what most points need before the rest is cut off.
_STRETCH = 2.5


def legend_above(axes: Axes, markerscale: float = 1.0) -> None:
    """Legend on the right above the axes, where no data are."""
    names = axes.get_legend_handles_labels()[1]
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(names),
        borderaxespad=0.1,
        markerscale=markerscale,
    )


def bars(axes: Axes, x: Floats, y: Floats, half: Floats, colour: str, label: str | None = None) -> None:
    """Points with error bars, every one with its bar."""
    axes.errorbar(x, y, yerr=half, color=colour, label=label, **_BARS)


def zero_line(axes: Axes) -> None:
    """A line at zero, behind the data."""
    axes.axhline(0.0, color=style.GREY, linewidth=0.6)


def limit_around_zero(axes: Axes, values: Floats, share: float = 0.995) -> None:
    """A scale centred on zero for all values, or, where a few lie far out, for the others with a remark."""
    most = style.symmetric_limit(values, share)
    finite = np.abs(values[np.isfinite(values)])
    far = float(finite.max()) if finite.size else most
    limit = 1.08 * far if 0 < far < _STRETCH * most else 1.3 * most
    axes.set_ylim(-limit, limit)
    outside = int(np.count_nonzero(finite > limit))
    if outside:
        style.say_in_figure(axes, f"{outside} of {finite.size} points lie outside")
