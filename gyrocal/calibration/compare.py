"""Runs of a unit beside each other: what changed from the first to the last, and whether it is more than noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from gyrocal.calibration.calibrate import Calibration
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.figures import common_span, figures_between
from gyrocal.calibration.pooled import repeatability
from gyrocal.calibration.provenance import refuse_twice
from gyrocal.calibration.static import StaticFigures
from gyrocal.errors import DataError
from gyrocal.inference.multiple import holm
from gyrocal.units import NORMAL_95

#: Rate at which a unit that did not change is said to have, over all figures together.
ALARM_RATE = 0.01


@dataclass(frozen=True)
class Change:
    """One figure over the runs.

    Attributes
    ----------
    figures : tuple of Figure, one a run
    change, low, high : last less first, with its 95 % interval; None where one of them has no number
    p_value : of no change, after Holm's procedure over the figures
    """

    figures: tuple[Figure, ...]
    change: float | None
    low: float | None
    high: float | None
    p_value: float

    @property
    def repeatability(self) -> Figure:
        """How much the figure differs from run to run, beyond the error within them."""
        return repeatability(self.figures)

    @property
    def changed(self) -> bool:
        """Whether it is more than noise."""
        return self.p_value < ALARM_RATE


def compare_runs(runs: Sequence[Calibration]) -> tuple[Change, ...]:
    """Figures before compensation of every run, in the order given, over what the runs have in common.

    Raises
    ------
    DataError
        Fewer than two runs, or one that is given twice.
    """
    _refuse_few([run.recording.source for run in runs])
    # Of the same rates and temperatures: a scale factor with a slope has another middle where a run was a tenth of a °C warmer.
    span = common_span([run.fit.sets for run in runs])
    listed = [figures_between(run.fit, span) | dict(run.noise.figures) for run in runs]
    return changes_between(listed)


def compare_at_rest(runs: Sequence[StaticFigures]) -> tuple[Change, ...]:
    """The same of runs at rest: their noise, mean and drift.

    Raises
    ------
    DataError
        Fewer than two runs, or one that is given twice.
    """
    _refuse_few([run.source for run in runs])
    return changes_between([dict(run.noise.figures) | run.figures for run in runs])


def _refuse_few(sources: Sequence[Path]) -> None:
    if len(sources) < 2:
        raise DataError("One run is given, and a comparison takes two: give more.")
    refuse_twice(sources)


def changes_between(listed: Sequence[Mapping[str, Figure]]) -> tuple[Change, ...]:
    """Figures by name of every run, in order, and what is more than noise between the first and the last."""
    names = [name for name in listed[0] if all(name in figures for figures in listed)]
    raw = [_change(tuple(figures[name] for figures in listed)) for name in names]
    tested = np.array([c.change is not None for c in raw])
    p_values = np.array([c.p_value for c in raw])
    p_values[tested] = holm(p_values[tested])
    return tuple(replace(c, p_value=p) for c, p in zip(raw, p_values.tolist(), strict=True))


def _change(figures: tuple[Figure, ...]) -> Change:
    first, last = figures[0].interval, figures[-1].interval
    if first is None or last is None:
        return Change(figures, None, None, None, 1.0)
    change = last[0] - first[0]
    # Each end of an interval is a half width of its own: the one that faces the other run counts.
    facing = (
        (first[0] - first[1], last[2] - last[0]) if change < 0 else (first[2] - first[0], last[0] - last[1])
    )
    half = math.hypot(*facing)
    std = half / NORMAL_95
    p_value = 1.0 if std == 0 else 2.0 * float(stats.norm.sf(abs(change) / std))
    return Change(figures, change, change - half, change + half, float(np.clip(p_value, 0.0, 1.0)))
