"""Cells of gyro and wheels that a logger left empty: what they miss goes on between the cells beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.drive import DriveBlock, cut, join

Floats = NDArray[np.float64]

#: Over a longer time nobody knows what a robot did, and it is left to what the other sensor says.
LONGEST_S = 0.5


def bridged(blocks: Iterable[DriveBlock]) -> Iterator[DriveBlock]:
    """Blocks with rates, and ways by their speeds, interpolated over short empty stretches.

    The same however the log is cut: rows wait for the block that ends their stretch.
    """
    channels = (_Channel(), _Channel(), _Channel())
    last_s, waiting = np.nan, list[DriveBlock]()
    for block in blocks:
        rows = join([*waiting, block])
        whole, read = _filled(rows, channels, last_s)
        ready = min(c.ready(rows.t_s, v) for c, v in zip(channels, read, strict=True))
        waiting = (
            [replace(cut(rows, slice(ready, None)), notes=(), late_counts=0)] if ready < len(rows) else []
        )
        if ready:
            yield cut(whole, slice(ready))
            last_s = float(rows.t_s[ready - 1])
            for channel, values in zip(channels, read, strict=True):
                channel.pass_by(rows.t_s[:ready], values[:ready])
    for rows in waiting:
        yield _filled(rows, channels, last_s)[0]


def _filled(
    rows: DriveBlock, channels: tuple[_Channel, _Channel, _Channel], last_s: float
) -> tuple[DriveBlock, tuple[Floats, Floats, Floats]]:
    """Rows with what can be filled by now, and what the channels read: a rate and two speeds."""
    gyro, left, right = channels
    t_s, dt_s = rows.t_s, np.diff(rows.t_s, prepend=last_s)
    read = (rows.gyro_dps, _speeds(rows.left_m, dt_s), _speeds(rows.right_m, dt_s))
    filled = replace(
        rows,
        gyro_dps=gyro.filled(t_s, read[0]),
        left_m=_ways(rows.left_m, left.filled(t_s, read[1]), dt_s),
        right_m=_ways(rows.right_m, right.filled(t_s, read[2]), dt_s),
    )
    return filled, read


def _speeds(way_m: Floats, dt_s: Floats) -> Floats:
    return np.asarray(np.divide(way_m, dt_s, out=np.full(way_m.shape, np.nan), where=dt_s > 0.0))


def _ways(way_m: Floats, speed_mps: Floats, dt_s: Floats) -> Floats:
    """Ways of one side, those of empty cells by its speed."""
    return np.where(np.isfinite(way_m) | ~(dt_s > 0.0), way_m, speed_mps * dt_s)


class _Channel:
    """The last known value of a channel before the next rows."""

    def __init__(self) -> None:
        self._t_s, self._value = np.empty(0), np.empty(0)

    def pass_by(self, t_s: Floats, values: Floats) -> None:
        known = np.isfinite(values)
        self._t_s = np.append(self._t_s, t_s[known])[-1:]
        self._value = np.append(self._value, values[known])[-1:]

    def ready(self, t_s: Floats, values: Floats) -> int:
        """How many of the rows need none that follow: all but a short empty stretch at the end."""
        known = np.flatnonzero(np.isfinite(values))
        since_s = t_s[known[-1:]] if known.size else self._t_s
        if not since_s.size or t_s[-1] - since_s[0] > LONGEST_S:
            return int(t_s.size)
        return int(known[-1]) + 1 if known.size else 0

    def filled(self, t_s: Floats, values: Floats) -> Floats:
        known = np.isfinite(values)
        at_s = np.append(self._t_s, t_s[known])
        if known.all() or not at_s.size:
            return values
        after = np.searchsorted(at_s, t_s)
        until_s, since_s = at_s[np.minimum(after, at_s.size - 1)], at_s[np.maximum(after - 1, 0)]
        between = (after > 0) & (after < at_s.size) & (until_s - since_s <= LONGEST_S)
        line = np.interp(t_s, at_s, np.append(self._value, values[known]))
        return np.where(known | ~between, values, line)
