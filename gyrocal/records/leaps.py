"""Rows in which a wheel goes further than any vehicle: a damaged cell, or a counter that went round."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.records.columns import ColumnRule

Floats = NDArray[np.float64]

#: Faster than any robot that this is for, and than any vehicle with one speed, m/s.
FASTEST_ROBOT_MPS, FASTEST_VEHICLE_MPS = 30.0, 100.0
#: Of the rows in which a wheel moves, that many at least and this share at most: more of them are of another unit.
_FEWEST_MOVING, _MOST_SHARE = 20, 0.01
#: Bits of the counters of encoders; how near a leap comes to their modulus, and how much faster than the usual row it is.
_BITS, _NEAR, _SUDDEN = (15, 16, 24, 31, 32), 0.05, 20.0
#: A counter that read one number for so many rows before it leapt stood.
_STOOD = 3


class Leaps:
    """Looks for leaps in a column of distances, speeds or counts, block after block.

    Parameters
    ----------
    metres : float
        Metres of a count; of other columns 1.
    """

    def __init__(self, path: Path, rule: ColumnRule, metres: float, usual_dt_s: float) -> None:
        self._path, self._rule, self._usual_dt_s = path, rule, usual_dt_s
        self._metres, self._told_s = metres * rule.unit.factor, np.nan

    def refuse(self, first_line: int, raw: Mapping[str, Floats], steps_m: Floats, t_s: Floats) -> None:
        """Refuse the first row of a block that leaps, where few do.

        Raises
        ------
        InputError
            A cell that no vehicle makes, or a counter that goes round and has no `wrap`.
        """
        values = raw[self._rule.source]
        told = np.flatnonzero(np.isfinite(values) & np.isfinite(steps_m))
        if not told.size:
            return
        since_s = np.diff(t_s[told], prepend=t_s[told[:1]] if np.isnan(self._told_s) else self._told_s)
        self._told_s = float(t_s[told[-1]])
        went_m, since_s = np.abs(steps_m[told]), np.maximum(since_s, self._usual_dt_s)
        moving = went_m > 0.0
        if np.count_nonzero(moving) < _FEWEST_MOVING:
            return
        round_ = self._goes_round(went_m, since_s)
        leaps = np.flatnonzero((went_m > FASTEST_VEHICLE_MPS * since_s) | (round_ > 0))
        if not leaps.size or leaps.size > max(_MOST_SHARE * np.count_nonzero(moving), 2.0):
            return
        k = int(leaps[0])
        where = f"{self._path}, line {first_line + told[k]}: {self._rule.source}"
        if round_[k]:
            counts = steps_m[told[k]] / self._metres
            msg = f"{where} leaps by {counts:.0f} counts, nearly 2^{round_[k]}: the counter goes round. Map the columns with --columns, and give this one wrap = {2 ** int(round_[k])} there."
            raise InputError(msg)
        stays = self._rule.unit.total and k + 1 < told.size and k + 1 not in leaps
        msg = f"{where} is {values[told[k]]:.10g}, which is a way of {steps_m[told[k]]:,.0f} m in {since_s[k]:.3g} s, and no vehicle goes so fast. "
        raise InputError(
            msg + (self._counts_on(values[told], told + first_line, k) if stays else self._cell())
        )

    def _cell(self) -> str:
        """What to do with a single cell that is wrong."""
        empty = ": a counter goes on behind it" if self._rule.unit.total else ""
        return f"Repair the cell or leave it empty{empty}."

    def _counts_on(self, values: Floats, lines: NDArray[np.int64], k: int) -> str:
        """What to do with a counter that leaps and counts on from there; `values` in the rows that have one, before row k too."""
        since = k - 1
        while since > 0 and values[since - 1] == values[k - 1]:
            since -= 1
        if abs(values[k] * self._metres) <= FASTEST_VEHICLE_MPS * self._usual_dt_s:
            return "The counter restarts from 0 here, and the rows behind count on from that. Cut the log there, or add what it read before to each of them."
        if k - since >= _STOOD:
            return f"The counter stood from line {lines[since]} on and leaps here to what it would read. Leave its cells of lines {lines[since] + 1} to {lines[k - 1]} empty, or cut them out."
        return "The rows behind count on from there: the counter was set anew. Cut the log there, or add what it leapt by to each of them."

    def _goes_round(self, went_m: Floats, since_s: Floats) -> NDArray[np.int64]:
        """Bits of the counter that went round in each row; 0 where none did."""
        found = np.zeros(went_m.size, dtype=np.int64)
        if not (self._rule.unit.ticks and self._rule.unit.total) or self._rule.wrap is not None:
            return found
        speed = went_m / np.maximum(since_s, 1e-9)
        sudden = speed > _SUDDEN * np.median(speed[went_m > 0.0])
        for bits in _BITS:
            modulus_m = abs(self._metres) * 2.0**bits
            found[sudden & (np.abs(went_m - modulus_m) < _NEAR * modulus_m)] = bits
        return found
