"""Rows that a logger lost with the way of their wheels.

A row of metres holds the way since the row before. A counter goes on counting while rows are lost, and a logger may sum up
what they added; one that writes a row as it comes in drops their way with them. Which it is the rows after a leap of the time
tell: they hold the way of all that time, or of one row.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.drive import DriveBlock
from gyrocal.units import plural

Floats = NDArray[np.float64]

#: A step of the time of so many usual ones lacks a row; in one of more than this nobody knows what the wheels did.
LACKS_A_ROW, GAP_STEPS = 1.8, 5.0
#: So many moving rows after leaps tell what became of the way.
_FEWEST = 20


@dataclass(frozen=True)
class LostWays:
    """What rows of a log lack.

    Attributes
    ----------
    usual_s : usual time from row to row
    rows : number of rows that are missing before others that hold the way of one
    way_m : how far the wheels went meanwhile, at the speed of the row after
    """

    usual_s: float
    rows: int
    way_m: float

    def __str__(self) -> str:
        return (
            f"{self.rows} {plural(self.rows, '[row is|rows are]')} missing in motion, and with them the way of the wheels: the row after holds that of one row. "
            f"{self.way_m:.3g} m are added at its speed"
        )

    def completed(self, blocks: Iterable[DriveBlock]) -> Iterator[DriveBlock]:
        """Blocks of the log with the way of all the time that has passed in each row."""
        last_s = np.nan
        for block in blocks:
            step_s = np.diff(block.t_s, prepend=last_s)
            times = np.where(_leaps(step_s, self.usual_s), step_s / self.usual_s, 1.0)
            yield replace(block, left_m=block.left_m * times, right_m=block.right_m * times)
            last_s = float(block.t_s[-1])


class Leaps:
    """Sums over the rows after leaps of the time, block by block."""

    def __init__(self) -> None:
        self._usual_s = 0.0
        self._last_s = self._last_way_m = np.nan
        self._rows = self._missing = 0
        self._late = 0.0
        self._held_m = self._of_one_m = self._of_all_m = self._gone_m = 0.0

    def add(self, block: DriveBlock) -> None:
        """Look at the next rows."""
        if not len(block):
            return
        step_s = np.diff(block.t_s, prepend=self._last_s)
        if not self._usual_s:
            self._usual_s = float(np.median(step_s[step_s > 0])) if np.any(step_s > 0) else 0.0
        way_m = 0.5 * np.abs(block.left_m + block.right_m)
        before_m = np.append(self._last_way_m, way_m[:-1])
        leaps = _leaps(step_s, self._usual_s) & np.isfinite(way_m + before_m) & (before_m > 0.0)
        passed = step_s[leaps] / (self._usual_s or 1.0)
        sound = (step_s >= 0.0) & (step_s <= GAP_STEPS * self._usual_s)
        # Stamps that come late have others that come early beside them; where rows are missing time goes on without.
        self._late += float(np.sum(step_s[sound])) / (self._usual_s or 1.0) - np.count_nonzero(sound)
        self._rows += passed.size
        self._missing += int(np.sum(np.round(passed) - 1.0))
        self._held_m += float(np.sum(way_m[leaps]))
        self._gone_m += float(way_m[leaps] @ (passed - 1.0))
        self._of_one_m += float(np.sum(before_m[leaps]))
        self._of_all_m += float(before_m[leaps] @ passed)
        self._last_s, self._last_way_m = float(block.t_s[-1]), float(way_m[-1])

    @property
    def lost(self) -> LostWays | None:
        """What is lost; None where nothing is, or too little to tell."""
        # Nearer to the way of one row than to that of all, by their ratios.
        if (
            self._rows < _FEWEST
            or 2.0 * self._late < self._missing
            or self._held_m**2 >= self._of_one_m * self._of_all_m
        ):
            return None
        return LostWays(self._usual_s, self._missing, self._gone_m)


def lost_ways(log: DriveBlock) -> LostWays | None:
    """The same of a whole log."""
    leaps = Leaps()
    leaps.add(log)
    return leaps.lost


def _leaps(step_s: Floats, usual_s: float) -> NDArray[np.bool_]:
    return np.asarray((step_s > LACKS_A_ROW * usual_s) & (step_s <= GAP_STEPS * usual_s) & (usual_s > 0.0))
