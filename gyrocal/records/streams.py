"""Streams of different rates and files, laid on the gyro's times in bounded memory: one drive log from many."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gyrocal.errors import DataError, InputError
from gyrocal.records.csvio import Floats
from gyrocal.records.drive import DriveBlock

#: Stream -> how many values stand beside its time.
WIDTHS = {"gyro": 2, "wheels": 2, "temperature": 1, "steering": 1, "truth": 3}
#: Gyro samples wait no longer than this for a stream that is silent.
_HOLD_S = 10.0
#: Wheels that were silent for more than this many usual periods and moved meanwhile: when, nobody knows.
_GAP_PERIODS = 10.0


class Merger:
    """What is still to be merged of some streams; a row of the log for each sample of the gyro.

    Streams are tables of shape (k, 1 + values), time in s first, rows in time order: `gyro` (rate in deg/s, number
    of the segment), `wheels` (running totals of left and right, m), `temperature` (deg C), `steering` (deg),
    `truth` (x and y in m, heading in deg). Wheels, temperature and steering are interpolated; a row of truth goes
    to the first gyro sample that is not before it.

    Parameters
    ----------
    names : iterable of str
        The streams that there are; `gyro` and `wheels` have to be.
    speed_only : bool
        Both wheel totals are the vehicle's way.
    """

    def __init__(self, source: Path, names: Iterable[str], *, speed_only: bool = False) -> None:
        self._source = source
        self._speed_only = speed_only
        self._held = {name: np.empty((0, 1 + WIDTHS[name])) for name in names}
        self._until_s = dict.fromkeys(self._held, -np.inf)
        self._total_m: Floats | None = None
        self._rows = self._outside = self._late = 0
        self._period_s = np.inf
        self._last_s = -np.inf
        self._notes: list[str] = []

    def add(self, name: str, table: Floats, until_s: float | None = None) -> None:
        """Append rows of a stream; it is known up to `until_s`, by default up to its last row."""
        if len(table):
            start_s = self._until_s[name]
            joined = np.concatenate((self._held[name], table))
            back = np.flatnonzero(np.diff(joined[:, 0]) < 0)
            if back.size or table[0, 0] < start_s:
                msg = f"{self._source}: the times of {name} go backwards near {table[0, 0]:.6f} s. Repair the log."
                raise InputError(msg)
            self._held[name] = joined
            self._until_s[name] = float(table[-1, 0])
        if until_s is not None:
            self._until_s[name] = max(self._until_s[name], until_s)

    def say(self, notes: Iterable[str]) -> None:
        """Sentences that the next block carries."""
        self._notes.extend(notes)

    def behind(self) -> str:
        """The stream that is known for the shortest time."""
        return min(self._until_s, key=lambda name: self._until_s[name])

    def take(self, *, last: bool = False) -> Iterator[DriveBlock]:
        """What all streams cover by now; with `last`, all that there is.

        Raises
        ------
        DataError
            At the last: no gyro sample lies within the time of the wheels, or they came only once.
        """
        gyro, wheels = self._held["gyro"], self._held["wheels"]
        until_s = min(self._until_s.values())
        if np.isfinite(self._until_s["gyro"]):
            until_s = max(until_s, self._until_s["gyro"] - _HOLD_S)
        count = len(gyro) if last else int(np.searchsorted(gyro[:, 0], until_s, side="right"))
        if self._total_m is None and not last and len(wheels) < 2:
            count = 0
        rows, self._held["gyro"] = self._inside(gyro[:count], wheels), gyro[count:]
        if not last:
            # One row stays, so that the last block, which says what was left out, is never empty.
            self._held["gyro"] = np.concatenate((rows[-1:], self._held["gyro"]))
            rows = rows[:-1]
        if len(rows):
            yield self._block(rows, last)
        elif last:
            msg = f"{self._source}: gyro and wheels do not overlap in time; they are not of one clock. Check the time stamps."
            raise DataError(msg)

    def _inside(self, rows: Floats, wheels: Floats) -> Floats:
        """Without the samples that no wheel message encloses."""
        first_s, last_s = (wheels[0, 0], wheels[-1, 0]) if len(wheels) else (np.inf, -np.inf)
        if self._total_m is not None:
            first_s = -np.inf
        inside = (rows[:, 0] >= first_s) & (rows[:, 0] <= last_s)
        self._outside += int(np.count_nonzero(~inside))
        return rows[inside]

    def _block(self, rows: Floats, last: bool) -> DriveBlock:
        t_s = rows[:, 0]
        if not self._rows:
            self._notes.append(self._how())
        steps_m = self._steps(t_s)
        temp_c, steering_deg = (self._at(name, t_s) for name in ("temperature", "steering"))
        truth = self._truth(t_s)
        self._rows += len(rows)
        self._last_s = float(t_s[-1])
        if last:
            self._notes += self._left_out()
        notes, self._notes = tuple(self._notes), []
        for name in ("wheels", "temperature", "steering"):
            self._forget(name, t_s[-1])
        return DriveBlock(
            self._rows - len(rows) + 2,
            t_s,
            steps_m[0],
            steps_m[1],
            rows[:, 1],
            temp_c,
            truth[0],
            truth[1],
            truth[2],
            steering_deg,
            rows[:, 2].astype(np.int64),
            self._speed_only,
            notes=notes,
        )

    def _how(self) -> str:
        if len(self._held["wheels"]) < 2:
            msg = f"{self._source}: the wheels say something only once, which is no way. Check that the log is whole."
            raise DataError(msg)
        self._period_s = float(np.median(np.diff(self._held["wheels"][:1000, 0])))
        return f"wheels come every {self._period_s:.3g} s and are laid on the gyro's times by interpolation"

    def _steps(self, t_s: Floats) -> Floats:
        """Way of left and right since the row before, shape (2, n)."""
        wheels = self._held["wheels"]
        after = np.clip(np.searchsorted(wheels[:, 0], t_s), 1, len(wheels) - 1) if len(wheels) > 1 else None
        total_m = np.stack([np.interp(t_s, wheels[:, 0], wheels[:, side]) for side in (1, 2)])
        if self._total_m is None:
            self._total_m = total_m[:, 0]
        if after is not None:
            gap = (wheels[after, 0] - wheels[after - 1, 0]) > _GAP_PERIODS * self._period_s
            moved = np.any(wheels[after, 1:] != wheels[after - 1, 1:], axis=1)
            # A row at the very time of a wheel message is known, gap or not.
            total_m[:, gap & moved & (t_s < wheels[after, 0]) & (t_s > wheels[after - 1, 0])] = np.nan
        known = np.flatnonzero(np.isfinite(total_m[0]))
        steps_m = np.full(total_m.shape, np.nan)
        steps_m[:, known] = np.diff(total_m[:, known], prepend=self._total_m[:, None], axis=1)
        if known.size:
            self._total_m = total_m[:, known[-1]]
        return steps_m

    def _at(self, name: str, t_s: Floats) -> Floats:
        table = self._held.get(name)
        if table is None or len(table) == 0:
            return np.full(t_s.shape, np.nan)
        return np.asarray(np.interp(t_s, table[:, 0], table[:, 1]))

    def _truth(self, t_s: Floats) -> Floats:
        truth = np.full((3, t_s.size), np.nan)
        if "truth" in self._held:
            table = self._held["truth"]
            rows = np.searchsorted(t_s, table[:, 0])
            late = table[:, 0] <= self._last_s
            self._late += int(np.count_nonzero(late))
            # What was seen before the first sample by more than a period is not where that sample was taken.
            here = (rows < t_s.size) & ~late & (table[:, 0] >= t_s[0] - self._period_s)
            truth[:, rows[here]] = table[here, 1:].T
            self._held["truth"] = table[rows >= t_s.size]
        return truth

    def _forget(self, name: str, until_s: float) -> None:
        """Keep the last row before `until_s`, from which the next block goes on."""
        if name in self._held:
            table = self._held[name]
            self._held[name] = table[max(int(np.searchsorted(table[:, 0], until_s)) - 1, 0) :]

    def _left_out(self) -> list[str]:
        found = (
            (self._outside, "gyro samples before the first or after the last message of the wheels"),
            (self._late, f"rows of truth that came more than {_HOLD_S:g} s late"),
        )
        return [f"{count} {what} are left out" for count, what in found if count]
