"""A recording against the simulation that its user gave: what is between them, without and with the law."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from gyrocal.diagnosis.versus.answer import Compared, Versus
from gyrocal.report import style
from gyrocal.report.diagnosis_marks import PALE, legend_above, limit_around_zero, zero_line
from gyrocal.report.page import Picture
from gyrocal.units import MDPS

_PICTURE = Picture(
    "recorded_simulated",
    "Recording less simulation",
    "Means of the data sets that were compared, without and with the law, over rate and in the order of the recording. The law was "
    "fitted to them; what it brings on others is said above.",
)


def versus_picture(found: Versus) -> tuple[Picture, Figure]:
    """Recording less simulation, data set by data set, and less the law too."""
    return _PICTURE, _figure(found.compared)


@style.styled
def _figure(sets: Compared) -> Figure:
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.2)
    upper, lower = figure.subplots(2, 1)
    for axes, x in ((upper, sets.rate_dps), (lower, sets.when)):
        zero_line(axes)
        axes.plot(x, sets.apart_dps / MDPS, ".", markersize=5, color=PALE, label="recording less simulation")
        axes.plot(x, sets.left_dps / MDPS, ".", markersize=2.5, color=style.ORANGE, label="and less the law")
        limit_around_zero(axes, np.concatenate([sets.apart_dps, sets.left_dps]) / MDPS)
        axes.set_ylabel("Difference, mdeg/s")
    upper.set_xlabel("Rate, deg/s")
    lower.set_xlabel("Time, h" if sets.has_time else "Data set, in the order recorded")
    legend_above(upper, 2)
    return figure
