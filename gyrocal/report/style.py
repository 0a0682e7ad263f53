"""How every figure looks, in one place: a journal's column widths and sizes, colour maps for all eyes, the same bytes each time."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

#: Widths of one and of two columns of a journal page, inches.
ONE_COLUMN_IN = 3.5
TWO_COLUMNS_IN = 7.16
PNG_DPI = 200

#: Perceptually uniform, legible to colour-blind eyes and in grey: magnitudes, and ordered curves.
SEQUENTIAL = "viridis"
#: Blue to red through white, no green: signed values, always centred on zero.
DIVERGING = "RdBu_r"

#: Okabe and Ito's palette (2008), told apart by colour-blind readers.
BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
SKY = "#56B4E9"
INK = "#222222"
GREY = "#8A8A8A"

MARKERS = "osD^vPX<>*hp"

_RC: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#444444",
    "axes.formatter.limits": (-4, 5),
    "axes.grid": True,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "figure.constrained_layout.use": True,
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "grid.color": "#D9D9D9",
    "grid.linewidth": 0.4,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.0,
    "lines.markersize": 3.5,
    "savefig.dpi": PNG_DPI,
    "svg.fonttype": "path",
    # Element ids would otherwise be random, and the same figure other bytes each time.
    "svg.hashsalt": "gyrocal",
    "xtick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7,
    "ytick.major.width": 0.6,
}


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw a figure in this style, whatever the user's own matplotlib settings are."""

    @functools.wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(_RC)
            return draw(*args, **kwargs)

    return wrapper


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure of a size in inches, with no window behind it."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def render(figure: Figure, kind: str) -> bytes:
    """The figure as ``png`` or ``svg``; the same figure gives the same bytes."""
    stream = io.BytesIO()
    with mpl.rc_context(_RC):
        if kind == "png":
            figure.set_dpi(PNG_DPI)
            _lay_out(figure)
            # Straight to the canvas: savefig would draw once more to see whether the layout holds.
            FigureCanvasAgg(figure).print_png(stream, metadata={"Software": None})  # type: ignore[no-untyped-call]
        else:
            _lay_out(figure)
            figure.savefig(stream, format=kind, metadata={"Date": None, "Creator": "gyrocal"}, dpi=PNG_DPI)
    return stream.getvalue()


def _lay_out(figure: Figure) -> None:
    """Work out the layout once, for all formats: each savefig would otherwise draw twice for it."""
    if isinstance(figure.get_layout_engine(), ConstrainedLayoutEngine):
        figure.draw_without_rendering()
        figure.set_layout_engine("none")


def ordered_colours(n: int) -> list[tuple[float, float, float, float]]:
    """`n` colours from cold to warm end of the sequential map, without its palest part (illegible on white)."""
    colour_map = mpl.colormaps[SEQUENTIAL]
    return [tuple(float(x) for x in colour_map(s)) for s in np.linspace(0.0, 0.88, max(n, 1))]  # type: ignore[misc]


def symmetric_limit(values: NDArray[np.float64], share: float = 0.99) -> float:
    """Limit of a colour scale centred on zero: most values fit, one outlier does not bleach the rest."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.quantile(finite, share)) if finite.size and finite.any() else 1.0


def minus(text: str) -> str:
    """`text` with the minus sign that the axes have."""
    return text.replace("-", "\N{MINUS SIGN}")


def say_in_figure(axes: Axes, text: str) -> None:
    """A short remark in the upper left corner, on white so that data behind it do not disturb."""
    axes.text(
        0.015,
        0.97,
        text,
        transform=axes.transAxes,
        va="top",
        fontsize=7,
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )
