"""Cells of gyro and wheels that a logger left empty: what they miss goes on between the cells beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.drive import DriveBlock

Floats = NDArray[np.float64]

#: Over a longer time nobody knows what a robot did, and it is left to what the other sensor says.
LONGEST_S = 0.5


def bridged(blocks: Iterable[DriveBlock]) -> Iterator[DriveBlock]:
    """Blocks with rates, and ways by their speeds, interpolated over short empty stretches."""
    gyro, left, right = _Channel(), _Channel(), _Channel()
    last_s = np.nan
    for block in blocks:
        dt_s = np.diff(block.t_s, prepend=last_s)
        yield replace(
            block,
            gyro_dps=gyro.filled(block.t_s, block.gyro_dps),
            left_m=_ways(left, block.t_s, dt_s, block.left_m),
            right_m=_ways(right, block.t_s, dt_s, block.right_m),
        )
        last_s = float(block.t_s[-1]) if len(block) else last_s


def _ways(speed: _Channel, t_s: Floats, dt_s: Floats, way_m: Floats) -> Floats:
    """Ways of one side, those of empty cells by its speed."""
    goes = dt_s > 0.0
    speed_mps = np.divide(way_m, dt_s, out=np.full(way_m.shape, np.nan), where=goes)
    return np.where(np.isfinite(way_m) | ~goes, way_m, speed.filled(t_s, speed_mps) * dt_s)


class _Channel:
    """Values of one channel, and the last known one before a block."""

    def __init__(self) -> None:
        self._t_s, self._value = np.empty(0), np.empty(0)

    def filled(self, t_s: Floats, values: Floats) -> Floats:
        known = np.isfinite(values)
        at_s = np.concatenate([self._t_s, t_s[known]])
        told = np.concatenate([self._value, values[known]])
        self._t_s, self._value = at_s[-1:], told[-1:]
        if known.all() or not at_s.size:
            return values
        after = np.searchsorted(at_s, t_s)
        # Before the first known value and after the last one of a block one side holds.
        until_s = np.where(after < at_s.size, at_s[np.minimum(after, at_s.size - 1)], t_s[-1])
        since_s = np.where(after > 0, at_s[np.maximum(after - 1, 0)], t_s[0])
        return np.where(known | (until_s - since_s > LONGEST_S), values, np.interp(t_s, at_s, told))
