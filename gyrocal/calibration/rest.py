"""Records at rest of a run (static segments; soaks once the temperature is steady), gathered for `inference.flicker`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from gyrocal.inference.flicker import Rest, rest_of_windows
from gyrocal.records.run import Segment, SegmentRecord

#: Kinds of segment that may be records at rest.
_KINDS = ("static", "rate", "soak")
#: Shorter records say next to nothing about drift.
_SHORTEST_S = 300.0
#: Windows of a record: enough for two decades of time, few enough for dense algebra.
_WINDOWS = 64
_FEWEST_WINDOWS = 12
_SHORTEST_WINDOW_S = 10.0
#: A window must hold this share of the samples of the fullest one.
_FULL = 0.5
#: A soak is steady from where the temperature stays this near to where it ends, °C.
_STEADY_C = 0.5


class RestWindows:
    """Means over windows of a segment at rest, gathered as its blocks pass by."""

    def __init__(self, record: SegmentRecord) -> None:
        span_s = record.t_end_s - record.t_start_s
        self.wanted = (
            record.kind in _KINDS
            and record.outcome == "ok"
            and record.rate_dps == 0.0
            and span_s >= _SHORTEST_S
        )
        self._steady_only = record.kind == "soak"
        self._start_s = record.t_start_s
        self.window_s = max(_SHORTEST_WINDOW_S, span_s / _WINDOWS)
        self._count, self._time, self._gyro = (np.zeros(_WINDOWS) for _ in range(3))
        self._warm, self._temp = np.zeros(_WINDOWS), np.zeros(_WINDOWS)
        self._offset_dps = 0.0

    def watch(self, blocks: Iterable[Segment]) -> Iterator[Segment]:
        """Pass blocks on, and add them up."""
        for block in blocks:
            if self.wanted:
                self._add(block)
            yield block

    def _add(self, block: Segment) -> None:
        good = block.good
        t_s, gyro_dps, temp_c = block.t_s[good], block.gyro_dps[good], block.gyro_temp_c[good]
        if t_s.size == 0:
            return
        if not self._count.any():
            self._offset_dps = float(gyro_dps[0])
        row = np.clip(((t_s - self._start_s) / self.window_s).astype(np.int64), 0, _WINDOWS - 1)
        warm = np.isfinite(temp_c)
        self._count += np.bincount(row, minlength=_WINDOWS)
        self._time += np.bincount(row, t_s - self._start_s, minlength=_WINDOWS)
        self._gyro += np.bincount(row, gyro_dps - self._offset_dps, minlength=_WINDOWS)
        self._warm += np.bincount(row[warm], minlength=_WINDOWS)
        self._temp += np.bincount(row[warm], temp_c[warm], minlength=_WINDOWS)

    def of(self, blocks: Iterable[Segment]) -> Rest | None:
        """What a whole segment says, from its blocks."""
        for _ in self.watch(blocks):
            pass
        return self.rest()

    def rest(self) -> Rest | None:
        """What the segment says about flicker; None where it is short, or its temperature never steady."""
        full = self._count >= _FULL * max(self._count.max(), 1.0)
        if not self.wanted or full.sum() < _FEWEST_WINDOWS:
            return None
        with np.errstate(invalid="ignore", divide="ignore"):
            temp_c = (self._temp / self._warm)[full]
        t_s, gyro_dps = (v[full] / self._count[full] for v in (self._time, self._gyro))
        if self._steady_only:
            moving = np.flatnonzero(~(np.abs(temp_c - temp_c[-1]) <= _STEADY_C))
            first = int(moving[-1]) + 1 if moving.size else 0
            t_s, gyro_dps, temp_c = t_s[first:], gyro_dps[first:], temp_c[first:]
        if t_s.size < _FEWEST_WINDOWS:
            return None
        return rest_of_windows(t_s, gyro_dps, temp_c, self.window_s)
