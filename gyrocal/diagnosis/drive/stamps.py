"""Rows of a drive log that share a time stamp: a row without any time of its own would turn by nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.remarks import Note, Remark, Said
from gyrocal.navigation.lost_ways import GAP_STEPS
from gyrocal.records.drive import DriveBlock

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Share by which there is more time before a stamp than after it where rows came late.
_MORE = 0.5


def at_own_times(log: DriveBlock) -> tuple[DriveBlock, list[Note]]:
    """The log with rows that share a stamp spread evenly up to the next one, and what is said of them."""
    without = without_time(log)
    if not without.any():
        return log, []
    told = without | (np.diff(log.t_s, prepend=-np.inf) > 0.0)
    # What comes twice stays where it is, and says nothing for no time.
    times_s = spread(log.t_s[told])[np.cumsum(told) - 1]
    return replace(log, t_s=times_s), [Remark(Said.SHARED_TIMES, {"count": int(without.sum())})]


def without_time(log: DriveBlock) -> Bools:
    """Rows that have the time of the row before and say something else than it did, shape (n,)."""
    shared = np.diff(log.t_s, prepend=-np.inf) == 0.0
    moved = np.nan_to_num(np.abs(log.left_m) + np.abs(log.right_m)) > 0.0
    turned = np.nan_to_num(np.diff(log.gyro_dps, prepend=np.nan)) != 0.0
    return np.asarray(shared & (moved | turned))


def spread(t_s: Floats) -> Floats:
    """Times of rows, of which those that share one follow each other evenly until the next, or up to theirs where more time is before it.

    Over a gap they follow as closely as usual.
    """
    first = np.flatnonzero(np.diff(t_s, prepend=-np.inf) > 0.0)
    rows = np.diff(np.append(first, t_s.size))
    stamps_s = t_s[first]
    after_s = np.diff(stamps_s) / rows[:-1]
    usual_s = float(np.median(after_s)) if after_s.size else 0.0

    def of_each(each_s: Floats) -> Floats:
        return np.where(each_s < GAP_STEPS * usual_s, each_s, usual_s)

    after_s = np.append(of_each(after_s), usual_s)
    before_s = np.append(usual_s, of_each(np.diff(stamps_s) / rows[1:]))
    # A row that came late has the time of the next one, and is missed before it.
    late = (rows > 1) & (np.append(1, rows[:-1]) == 1) & (before_s > after_s * (1.0 + _MORE))
    which = np.repeat(np.arange(first.size), rows)
    place = np.arange(t_s.size) - first[which] - np.where(late, rows - 1, 0)[which]
    return np.asarray(stamps_s[which] + place * np.where(late, before_s, after_s)[which])
