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
Ints = NDArray[np.int64]

#: A step of the time of so many usual ones lacks a row; in one of more than this nobody knows what the wheels did.
LACKS_A_ROW, GAP_STEPS = 1.8, 5.0
#: So many moving rows after leaps tell what became of the way.
FEWEST = 20
#: After so many leaps in a row the logger has another step, and no rows are missing.
_IN_A_ROW = 3
#: A stamp that comes late by up to half a step makes one step longer and the next as much shorter.
_REGULAR = (0.5, 1.5)


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
        course = _Course(self.usual_s)
        for block in blocks:
            step_s, leap = course.of(block.t_s)
            rows = np.where(_lacks(leap), np.round(step_s / self.usual_s), 1.0)
            yield replace(block, left_m=block.left_m * rows, right_m=block.right_m * rows)


def lost_ways(blocks: Iterable[DriveBlock], usual_s: float) -> LostWays | None:
    """What rows of a log lack; None where they lack nothing, or too little to tell.

    Parameters
    ----------
    usual_s : usual time from row to row, such as `Survey.usual_dt_s`
    """
    if usual_s <= 0.0:
        return None
    course, last_way_m = _Course(usual_s), np.nan
    sound, regular = np.zeros(2), np.zeros(2)
    moving = missing = 0
    held_m = of_one_m = of_all_m = gone_m = 0.0
    for block in blocks:
        step_s, leap = course.of(block.t_s)
        way_m = 0.5 * (np.abs(block.left_m) + np.abs(block.right_m))
        before_m = np.concatenate([[last_way_m], way_m])[:-1]
        # Behind another leap the row before holds the way of a leap itself.
        tells = (leap == 1) & np.isfinite(way_m + before_m) & (before_m > 0.0)
        rows = np.round(step_s / usual_s)
        moving += int(np.count_nonzero(tells))
        held_m += float(np.sum(way_m[tells]))
        of_one_m += float(np.sum(before_m[tells]))
        of_all_m += float(before_m[tells] @ rows[tells])
        adds = _lacks(leap) & (way_m > 0.0)
        missing += int(np.sum(rows[adds] - 1.0))
        gone_m += float(way_m[adds] @ (rows[adds] - 1.0))
        steps = step_s / usual_s
        sound += _count_and_sum(steps[(steps >= 0.0) & (steps <= GAP_STEPS) & (leap <= _IN_A_ROW)])
        regular += _count_and_sum(steps[(steps > _REGULAR[0]) & (steps < _REGULAR[1])])
        last_way_m = float(way_m[-1]) if len(block) else last_way_m
    if moving < FEWEST or not regular[0]:
        return None
    # Stamps that come late have others that come early beside them; where rows are missing time goes on without.
    late = sound[1] / (regular[1] / regular[0]) - sound[0]
    # Nearer to the way of one row than to that of all, by their ratios.
    if 2.0 * late < missing or held_m**2 >= of_one_m * of_all_m:
        return None
    return LostWays(usual_s, missing, gone_m)


def rows_missing(t_s: Floats, usual_s: float) -> int:
    """How many rows a log lacks in leaps and gaps of its time; none where the logger went over to another step."""
    step_s, in_a_row = _Course(usual_s).long(t_s)
    return int(np.sum(np.round(step_s[_lacks(in_a_row)] / usual_s) - 1.0))


class _Course:
    """Steps of the time, and which are leaps, block by block."""

    def __init__(self, usual_s: float) -> None:
        self._usual_s = usual_s
        self._last_s, self._in_a_row = np.nan, 0

    def of(self, t_s: Floats) -> tuple[Floats, Ints]:
        """Steps to the next rows, and of each that is a leap the how many-th in a row; 0 of the others."""
        step_s, in_a_row = self.long(t_s)
        # A gap is none, nor the beginning of others.
        return step_s, np.where(step_s <= GAP_STEPS * self._usual_s, in_a_row, 0)

    def long(self, t_s: Floats) -> tuple[Floats, Ints]:
        """The same with gaps, which are long as well."""
        step_s = np.diff(t_s, prepend=self._last_s)
        long = step_s > LACKS_A_ROW * self._usual_s
        at = np.arange(t_s.size)
        since = np.maximum.accumulate(np.where(long, -1 - self._in_a_row, at))
        in_a_row = np.where(long, at - since, 0)
        if t_s.size:
            self._last_s, self._in_a_row = float(t_s[-1]), int(in_a_row[-1])
        return step_s, in_a_row


def _lacks(leap: Ints) -> NDArray[np.bool_]:
    return np.asarray((leap > 0) & (leap <= _IN_A_ROW))


def _count_and_sum(steps: Floats) -> Floats:
    return np.array([steps.size, float(np.sum(steps))])
