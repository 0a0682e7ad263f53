"""The record of a drive: rows in time order, in blocks of bounded memory, and its CSV."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.csvio import Floats, format_columns

_NOTHING = np.empty(0)


@dataclass(frozen=True)
class DriveBlock:
    """Consecutive rows of a drive log, arrays of shape (n,); NaN where the log has none.

    Attributes
    ----------
    first_line : int
        Line of the first row in the file, for messages.
    t_s : ndarray, s
    left_m, right_m : ndarray, m
        Distance of each side since the row before.
    gyro_dps, gyro_temp_c : ndarray, deg/s, deg C
    truth_x_m, truth_y_m, truth_heading_deg : ndarray
        REP 103: x forward at the start when the truth is in the robot's frame; heading counter-clockwise.
    steering_deg : ndarray, deg
        Steering angle, counter-clockwise (to the left) positive.
    segment : ndarray of int
        Number of the segment: it grows by one where the clock stepped, and times go on without the step.
    speed_only : bool
        The log has one distance or speed of the vehicle: `left_m` and `right_m` are both that, and their
        difference says nothing of turns.
    late_counts : int
        Rows in which a counter tells nothing: the way is in the row whose count comes next.
    notes : tuple of str
        What the reader bridged, closed or left out in these rows, in words.
    """

    first_line: int
    t_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    gyro_temp_c: Floats
    truth_x_m: Floats
    truth_y_m: Floats
    truth_heading_deg: Floats
    steering_deg: Floats = field(default_factory=lambda: _NOTHING)
    segment: NDArray[np.int64] = field(default_factory=lambda: _NOTHING.astype(np.int64))
    speed_only: bool = False
    late_counts: int = 0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Columns that were not given hold nothing: no angle, one segment."""
        if self.steering_deg.size == 0:
            object.__setattr__(self, "steering_deg", np.full(self.t_s.shape, np.nan))
        if self.segment.size == 0:
            object.__setattr__(self, "segment", np.zeros(self.t_s.shape, dtype=np.int64))

    def __len__(self) -> int:
        return int(self.t_s.size)


#: Said of a log with a steering angle, which nothing evaluates.
UNUSED_STEERING = "the steering angle is read and kept, but not used: turns are those of gyro and wheels"

_NO_ARRAYS = ("first_line", "speed_only", "late_counts", "notes")
_ARRAYS = tuple(f.name for f in fields(DriveBlock) if f.name not in _NO_ARRAYS)


def join(blocks: Iterable[DriveBlock]) -> DriveBlock:
    """Blocks that follow each other, as one."""
    parts = list(blocks)
    if len(parts) == 1:
        return parts[0]
    joined: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _ARRAYS}
    notes = tuple(note for p in parts for note in p.notes)
    return replace(parts[0], late_counts=sum(p.late_counts for p in parts), notes=notes, **joined)


def cut(block: DriveBlock, rows: slice) -> DriveBlock:
    """Some rows of a block."""
    kept: dict[str, Any] = {name: getattr(block, name)[rows] for name in _ARRAYS}
    return replace(block, first_line=block.first_line + (rows.start or 0), **kept)


def format_drive_log(log: DriveBlock, metres_per_tick: float | None = None) -> str:
    """CSV text of a drive log, in metres or in whole cumulative ticks; what is not there is left out."""
    columns: dict[str, tuple[Floats, str]] = {"t_s": (log.t_s, "%.4f")}
    if log.speed_only:
        columns["speed_m"] = (log.left_m, "%.6f")
    for side, step_m in () if log.speed_only else (("left", log.left_m), ("right", log.right_m)):
        if metres_per_tick is None:
            columns[f"{side}_m"] = (step_m, "%.6f")
        else:
            columns[f"{side}_ticks"] = (np.cumsum(np.round(step_m / metres_per_tick)), "%.0f")
    columns |= {
        "gyro_dps": (log.gyro_dps, "%.6f"),
        "gyro_temp_c": (log.gyro_temp_c, "%.3f"),
    }
    optional: dict[str, tuple[Floats, str]] = {
        "steering_deg": (log.steering_deg, "%.4f"),
        "truth_x_m": (log.truth_x_m, "%.4f"),
        "truth_y_m": (log.truth_y_m, "%.4f"),
        "truth_heading_deg": (log.truth_heading_deg, "%.4f"),
    }
    columns |= {name: (v, fmt) for name, (v, fmt) in optional.items() if np.any(np.isfinite(v))}
    return format_columns(columns)
